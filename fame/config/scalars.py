"""The one reader of scalars: a text means the same in payloads, data objects, files, options and parameters.

It is the core schema of YAML 1.2: ``on``, ``NO`` and ``12:30`` are texts, ``010`` is 10, ``1e3`` is a number. Earlier
releases read files and options as YAML 1.1; where that gives another value, `note_change` says so for one release.
"""

from __future__ import annotations

import re
import warnings
from functools import cache, lru_cache
from typing import Any

from fame.errors import ValueChanged

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_WORDS: dict[str, Any] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_WORDS |= {f"{sign}.{word}": float(f"{sign}inf") for sign in ("", "+", "-") for word in ("inf", "Inf", "INF")}
_WORDS |= {f".{word}": float("nan") for word in ("nan", "NaN", "NAN")}

_PLAIN_NUMBER = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?")
PLAIN = "tag:fame:plain"
"""The tag of plain scalars."""


def scalar(text: str) -> Any:
    """Return the value of a plain scalar (YAML 1.2.2, section 10.3.2).

    >>> scalar("2"), scalar("1e3"), scalar("true"), scalar("on"), scalar("~")
    (2, 1000.0, True, 'on', None)
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) < 4000 else float(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return int(text, 0) if _BASED.fullmatch(text) else text


@cache
def core_loader() -> Any:
    """Return the class of PyYAML's loader that reads plain scalars by `scalar`, and quoted ones as texts."""
    import yaml  # an engine that waits for its process does without

    class Core(yaml.SafeLoader):
        yaml_implicit_resolvers = {}  # noqa: RUF012 - the loader's way to have resolvers of its own

    Core.add_implicit_resolver("tag:yaml.org,2002:merge", re.compile("<<"), ["<"])
    Core.add_implicit_resolver(PLAIN, re.compile(""), None)
    Core.add_constructor(PLAIN, lambda loader, node: scalar(node.value))
    return Core


def note_change(text: str, place: str, new: Any, old: Any) -> None:
    """Warn of a text whose value is another than in earlier releases. `place` is its ``FILE:LINE: KEY``."""
    if repr(old) != repr(new):
        text = f"`{text}` is now {_shown(new)}; earlier releases read {_shown(old)}"
        warnings.warn(f"{place}: {text}".removeprefix(": "), ValueChanged, stacklevel=2)


def note_scalar(text: str, file: str, line: int, path: str) -> None:
    """Warn of a plain scalar of a file or option that was another value as YAML 1.1."""
    if text[:1] in "yYnNoO+-.0123456789" and not _PLAIN_NUMBER.fullmatch(text) and path != "epoch":  # takes both
        place = ": ".join(filter(None, (file and f"{file}:{line}", path)))
        note_change(text, place, scalar(text), earlier(text))


@lru_cache(maxsize=1024)
def earlier(text: str) -> Any:
    """Return what earlier releases read: YAML 1.1; the text itself where that fails."""
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text


def _shown(value: Any) -> str:
    if value is None or isinstance(value, bool | int | float):
        return "nothing" if value is None else str(value).lower()
    return f"the {'text' if isinstance(value, str) else type(value).__name__} {str(value)!r}"
