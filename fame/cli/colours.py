"""Colours of what matters in a line, where the terminal has them; NO_COLOR (https://no-color.org) switches them off."""

from __future__ import annotations

import os
import re
from typing import TextIO

_RED, _GREEN, _YELLOW, _CYAN = 31, 32, 33, 36
_WORDS = {
    "error": _RED, "warning": _YELLOW, "note": _CYAN,
    "completed": _GREEN, "failed": _RED, "timeout": _YELLOW, "interrupted": _YELLOW,
}  # fmt: skip
_WORD = re.compile(rf"(?:^|(?<=: ))({'|'.join(_WORDS)})(?=: )")
"""A word that says how it is stands at the beginning of a line, or behind a place, and has a colon behind it."""


def coloured(text: str, stream: TextIO) -> str:
    """The text with the first such word of each line in its colour, if the stream is a terminal that has colours."""
    return "\n".join(map(_painted, text.split("\n"))) if _has_colours(stream) else text


def _painted(line: str) -> str:
    return _WORD.sub(lambda found: f"\x1b[1;{_WORDS[found[1]]}m{found[1]}\x1b[0m", line, count=1)


def _has_colours(stream: TextIO) -> bool:
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
