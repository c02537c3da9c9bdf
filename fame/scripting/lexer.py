"""Tokens of ``${...}`` and ``=...`` expressions."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Literal

_TOKEN = re.compile(
    r"""(?P<space>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<number>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)
      | (?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')
      | (?P<name>[^\W\d]\w*|`[^`]+`)
      | (?P<operator>\*\*|\.\.|&&|\|\||==|!=|<=|>=|[-+*/%<>=!?:.,()\[\]{}]|@(?=\s*"))
    """,
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(
    r"\\(u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{6}|.)", re.DOTALL
)
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f"}


Kind = Literal["number", "text", "name", "operator", "end"]


class ExpressionError(ValueError):
    """An expression is wrong. `place` is the index of the letter where."""

    def __init__(self, text: str, place: int = 0) -> None:
        super().__init__(text)
        self.place = place


@dataclass(frozen=True, slots=True)
class Token:
    """One token: `value` is its number or text, its name, or its sign. An `end` stands after the last."""

    kind: Kind
    value: str | int | float
    place: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else f"`{self.value}`"


def tokenize(text: str) -> list[Token]:
    """The tokens of a text and an end. Raises ExpressionError."""
    tokens: list[Token] = []
    place = 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            what = "a text without an end" if text[place] in "\"'" else f"`{text[place]}`"
            raise ExpressionError(f"{what} was not expected here", place)
        if match.lastgroup != "space":
            tokens.append(_token(match, place))
        place = match.end()
    tokens.append(Token("end", "", len(text)))
    return tokens


def _token(match: re.Match[str], place: int) -> Token:
    text = match.group()
    match match.lastgroup:
        case "number":
            return Token("number", int(text) if text.isdecimal() and len(text) < 4000 else float(text), place)
        case "text":
            return Token("text", _ESCAPE.sub(_unescape, text[1:-1]), place)
        case "name":
            return Token("name", text.strip("`"), place)
        case _:
            return Token("operator", text, place)


def _unescape(match: re.Match[str]) -> str:
    code = match.group(1)
    if len(code) == 1:  # a letter that is no escape is one of a regular expression, such as \\d
        return _ESCAPED.get(code, match.group() if code.isalnum() else code)
    if len(code) == 11:  # two halves of UTF-16 are one letter
        return bytes.fromhex(code[1:5] + code[7:]).decode("utf-16-be")
    point = int(code[1:], 16)
    return chr(point) if point <= sys.maxunicode else code
