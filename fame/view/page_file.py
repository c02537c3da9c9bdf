"""Writes a run as one file: a page that needs no server, from a disk as from any host of static files.

It is the page of `fame.view.server`, whose modules are joined into one script, and everything that the server would
send: each part is JSON, compressed, in base64, in a script element of no script's type, which the page unpacks when it
needs it. What a recording contains is thus never markup. The file may run this script alone and load nothing.
"""

from __future__ import annotations

import gzip
import re
from base64 import b64encode
from collections.abc import Iterator, Mapping
from graphlib import TopologicalSorter
from hashlib import sha256
from html import escape
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Any

from fame.fast_json import json_bytes
from fame.text import write_file
from fame.view.replay import Replay

_PAGE = files("fame.view") / "page"
_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)
_LINKED = re.compile(r'^ *<(?:link rel="(?:icon|manifest|stylesheet)"|script) .*\n', re.MULTILINE)


def write_page(path: Path, replay: Replay) -> None:
    """Write the page of a recording to a file. Raises ConfigError if that cannot be written."""
    replay.wait()
    mission = replay.mission()
    parts = _parts(replay, mission)
    first = [_element(*part) for part in islice(parts, len(mission["planes"]) + 2)]
    script, style = joined(), "".join(_read(name) for name in ("style.css", "team.css"))
    head = [
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(script, style)}">',
        f'<link rel="icon" href="data:image/svg+xml;base64,{b64encode(_read("icon.svg").encode()).decode()}">',
        f"<style>{style}</style>",
    ]
    page = _LINKED.sub("", _read("index.html")).replace("fame view</title>", f"{escape(mission['title'])}</title>")
    above, charset, rest = page.partition('<meta charset="utf-8">\n')
    before, end, after = rest.partition("</body>")
    run = f"<script>{script}</script>\n"  # before most of the data: the first picture does not wait for them
    text = [above, charset, *head, before, *first, run, *(_element(*part) for part in parts), end, after]
    write_file(path, "".join(text))


def _parts(replay: Replay, mission: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
    """What the server would send, by its address: what the first picture needs, then the other blocks."""
    yield "mission.json", json_bytes(mission)
    for number in range(len(mission["planes"])):
        yield f"plane/{number}.json", json_bytes(replay.plane(number))
    for number in range(len(mission["blocks"])):
        yield f"block/{number}.json", replay.block(number)


def _element(name: str, data: bytes) -> str:
    packed = b64encode(gzip.compress(data, mtime=0)).decode()
    return f'<script type="text/plain" id="{name}">{packed}</script>\n'


def _policy(script: str, style: str) -> str:
    """The Content-Security-Policy: this script and this style, and nothing from anywhere."""
    one, other = (f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in (script, style))
    allowed = f"script-src {one}; style-src {other}; img-src data:"
    return f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'"


def _read(name: str) -> str:
    return (_PAGE / name).read_text(encoding="utf-8")


def joined(main: str = "main") -> str:
    """Return the modules of the page as one script: each a function that gives what it exports."""
    texts: dict[str, str] = {}
    needs: dict[str, list[str]] = {}
    wanted = [main]
    while wanted:
        name = wanted.pop()
        texts[name] = _read(f"{name}.js")
        needs[name] = [found[2] for found in _IMPORT.finditer(texts[name])]
        wanted += [need for need in needs[name] if need not in texts]
    modules = [_module(name, texts[name]) for name in TopologicalSorter(needs).static_order()]
    return "".join(('"use strict";\n(() => {\n', *modules, "})();\n"))


def _module(name: str, text: str) -> str:
    exported = ", ".join(found[1] for found in _EXPORT.finditer(text))
    body = _EXPORT.sub("", _IMPORT.sub(r"const {\1} = $\2;\n", text))
    return f"const ${name} = (() => {{\n{body}return {{ {exported} }};\n}})();\n"
