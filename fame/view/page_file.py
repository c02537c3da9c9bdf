"""Writes a run as one file: a page that needs no server, from a disk as from any host of static files.

It is the page of `fame.view.server`, whose modules are joined into one script, and everything that the server would
send: each part is JSON, compressed, in base64, in a script element of no script's type, which the page unpacks when it
needs it. What a recording contains is thus never markup. The file may run this script alone and load nothing.
"""

from __future__ import annotations

import gzip
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from graphlib import TopologicalSorter
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from fame.fast_json import json_bytes, json_value
from fame.text import write_file
from fame.view.page_content import SPANS, ContentEntry, PageContent, chosen, count, is_left_out, listing, often
from fame.view.replay import Replay

SIZE = 25e6
"""Bytes of a file, if nothing else is said: what most messages may have attached."""
_SAMPLE = 20
"""Blocks, of which the size of all is guessed."""
_PAGE = files("fame.view") / "page"
_IMPORT = re.compile(r'^import \{([^}]*)\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)
_LINKED = re.compile(r'^ *<(?:link rel="(?:icon|manifest|stylesheet)"|script) .*\n', re.MULTILINE)


def write_page(
    path: Path,
    replay: Replay,
    *,
    without: Iterable[str] = (),
    size: float = SIZE,
    tell: Callable[[str], None] = lambda line: None,
) -> None:
    """Write the page of a recording to a file, of at most some bytes if thinning can do that.

    `without`: what is left out (`fame.view.page_content`). `tell` gets what will be in it, line by line, before it is
    written. Raises ConfigError.
    """
    replay.wait()
    mission, numbers = replay.mission(), range(len(replay.blocks))
    counts = count(_block(replay, number) for number in numbers)
    left_out = chosen(without, counts)
    counts = Counter({entry: by for entry, by in counts.items() if not is_left_out(entry, left_out)})
    for content in _thinner(PageContent(left_out), replay, counts, size):  # one at least
        parts = [*_parts(replay, content, content.mission(mission, counts))]
        page = _page(mission["title"], parts, len(mission["planes"]) + 2)
        if len(page) <= size:
            break
    tell(f"In {path}:")
    for line in listing(mission, counts, content):
        tell(line)
    write_file(path, page)


def write_recording(path: Path, recording: Path) -> None:
    """Write the page of a file with a recording, as `write_page` does. Raises ConfigError."""
    with Replay(recording) as replay:
        write_page(path, replay)


def _thinner(content: PageContent, replay: Replay, counts: Counter[ContentEntry], size: float) -> Iterator[PageContent]:
    """Yield the content, thinned more and more, from where a sample of its blocks says that it may be small enough."""
    blocks, fits = range(len(replay.blocks)), False
    sample = blocks[:: max(1, len(blocks) // _SAMPLE)]
    length = replay.blocks[-1].end - replay.blocks[0].start if blocks else 0
    for span in SPANS:
        tried = content._replace(span=span, often=often(counts, span, length))
        packed = (_element("", json_bytes(tried.block(_block(replay, number)))) for number in sample)
        fits = fits or sum(map(len, packed)) * len(blocks) <= size * len(sample)
        if fits or span == SPANS[-1]:
            yield tried


def _block(replay: Replay, number: int) -> dict[str, Any]:
    found: dict[str, Any] = json_value(replay.block(number))
    return found


def _page(title: str, parts: Sequence[str], first: int) -> bytes:
    """The file. `first`: how many parts the first picture needs."""
    script, style = joined(), "".join(_read(name) for name in ("style.css", "team.css"))
    head = [
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(script, style)}">\n',
        f'<link rel="icon" href="data:image/svg+xml;base64,{b64encode(_read("icon.svg").encode()).decode()}">\n',
        f"<style>{style}</style>\n",
    ]
    page = _LINKED.sub("", _read("index.html")).replace("fame view</title>", f"{escape(title)}</title>")
    above, charset, rest = page.partition('<meta charset="utf-8">\n')
    before, end, after = rest.partition("</body>")
    run = f"<script>{script}</script>\n"  # before most of the data: the first picture does not wait for them
    return "".join([above, charset, *head, before, *parts[:first], run, *parts[first:], end, after]).encode()


def _parts(replay: Replay, content: PageContent, mission: Mapping[str, Any]) -> Iterator[str]:
    """What the server would send, by its address: what the first picture needs, then the other blocks."""
    yield _element("mission.json", json_bytes(mission))
    for number in range(len(mission["planes"])):
        yield _element(f"plane/{number}.json", json_bytes(replay.plane(number)))
    for number in range(len(replay.blocks)):
        yield _element(f"block/{number}.json", json_bytes(content.block(_block(replay, number))))


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
