"""Regular expressions in a time that is known: no pattern can hold a robot up, as nested repetitions do with `re`.

A pattern is compiled to a program of small steps, which is run as a backtracking search that never tries the same step
at the same place twice (R. Cox, Regular Expression Matching: the Virtual Machine Approach, 2009). So a search takes at
most the length of the program times that of the text, and each try is counted against the budget. What one letter is,
Python's `re` decides, but for what it lacks of Java's: ``\\p{Lu}``, ``\\h``, ``\\z``, ``\\Q...\\E``. There are no
look-arounds and no references back, which cannot be had in that time.

==================  =====================================================================
step                what it does
==================  =====================================================================
("letter", r)       goes on by one letter that the expression `r` matches
("at", r)           goes on if `r` (an anchor) matches here
("split", a, b)     tries the step at distance a, and the one at b if that does not match
("jump", a)         goes on at distance a
("mark", n)         remembers the place: a group begins (n even) or ends
("end",)            is a match
==================  =====================================================================
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

from fame.scripting.budget import PASS, spend

_Step = tuple[Any, ...]
Groups = dict[int, int]
"""Places: group n is from 2n to 2n + 1; group 0 is all."""

_STEPS = 10_000
"""The longest program."""

_FLAGS = {"i": re.IGNORECASE, "s": re.DOTALL, "m": re.MULTILINE}
_ATOM = re.compile(r"\[\^?\]?(?:\\.|[^\]\\])*\]|\\[pP]\{\w+\}|\\.|[^\\\[()|*+?{]|\{(?![0-9])", re.DOTALL)
_QUOTED = re.compile(r"\\Q(.*?)(?:\\E|\Z)|\\.", re.DOTALL)
_PROPERTY = re.compile(r"\\([pP])\{(\w+)\}")
_IN_CLASS = re.compile(r"\\h|(\\[dDsSwW])-|\\.", re.DOTALL)
_UNSUPPORTED = re.compile(r"\[(?:\\.|[^\\])+?(?:\[|&&)", re.DOTALL)
"""Classes in classes, which Java unites and intersects."""
_BLANKS = r" \t\xA0\u1680\u180E\u2000-\u200A\u202F\u205F\u3000"
_CATEGORY = re.compile("L[ultmo]?|M[nce]?|N[dlo]?|P[cdseifo]?|S[mcko]?|Z[slp]?|C[cfson]?")
_ANCHORS = frozenset({"^", "$", "\\b", "\\B", "\\A", "\\Z"})
_REPEAT = re.compile(r"(?:([*+?])|\{([0-9]{1,4})(,?)([0-9]{0,4})\})(\??)")


class _Compiler:
    """Recursive descent over one pattern."""

    def __init__(self, pattern: str, flags: int) -> None:
        self._pattern, self._flags, self._place, self._groups = pattern, flags, 0, 0

    def program(self) -> tuple[_Step, ...]:
        steps = self._alternatives()
        if self._place < len(self._pattern):
            raise ValueError(f"{self._pattern!r} is not a regular expression: `)` too many")
        return (("mark", 0), *steps, ("mark", 1), ("end",))

    def _ahead(self, sign: str) -> bool:
        return self._pattern.startswith(sign, self._place)

    def _alternatives(self) -> list[_Step]:
        first = self._sequence()
        if not self._ahead("|"):
            return first
        self._place += 1
        second = self._alternatives()
        return [("split", 1, len(first) + 2), *first, ("jump", len(second) + 1), *second]

    def _sequence(self) -> list[_Step]:
        steps: list[_Step] = []
        while self._place < len(self._pattern) and not (self._ahead("|") or self._ahead(")")):
            steps += self._repeated(self._group() if self._ahead("(") else self._atom())
            if len(steps) > _STEPS:
                raise ValueError(f"{self._pattern[:40]!r}... is too long")
        return steps

    def _group(self) -> list[_Step]:
        plain = self._ahead("(?:")
        if self._ahead("(?") and not plain:
            raise ValueError(f"{self._pattern!r}: (?...) cannot be used here, but for (?:...)")
        self._place += 3 if plain else 1
        self._groups += not plain
        number = 2 * self._groups
        steps = self._alternatives()
        if not self._ahead(")"):
            raise ValueError(f"{self._pattern!r} is not a regular expression: a `)` is missing")
        self._place += 1
        return steps if plain else [("mark", number), *steps, ("mark", number + 1)]

    def _atom(self) -> list[_Step]:
        match = _ATOM.match(self._pattern, self._place)
        if match is None or re.fullmatch(r"\\[1-9]", match[0]):
            raise ValueError(f"{self._pattern!r} is not a supported regular expression")
        self._place = match.end()
        text = {"{": "\\{", "\\z": "\\Z"}.get(match[0], match[0])
        return [("at", re.compile(text, self._flags).match) if text in _ANCHORS else ("letter", self._letter(text))]

    def _letter(self, text: str) -> Callable[[str, int], object]:
        """What matches one letter. Raises ValueError for what is not supported."""
        if _UNSUPPORTED.match(text) or not all(_CATEGORY.fullmatch(name) for _, name in _PROPERTY.findall(text)):
            raise ValueError(f"{self._pattern!r} is not a supported regular expression: {text}")
        properties = [(sign == "P", name) for sign, name in _PROPERTY.findall(text)]
        if not properties:
            return re.compile(_IN_CLASS.sub(_in_class, "[\\h]" if text == "\\h" else text), self._flags).match
        inverse = text.startswith("[^")
        others = _IN_CLASS.sub(_in_class, _PROPERTY.sub("", text[1 + inverse : -1] if text[0] == "[" else text))
        other = re.compile(f"[{others}]" if others else "(?!)", self._flags).match

        def matches(text: str, place: int) -> bool:
            category = unicodedata.category(text[place]) if place < len(text) else ""
            found = any(category.startswith(name) != negated for negated, name in properties)
            return bool(category) and (found or other(text, place) is not None) != inverse

        return matches

    def _repeated(self, steps: list[_Step]) -> list[_Step]:
        match = _REPEAT.match(self._pattern, self._place)
        if match is None:
            return steps
        self._place = match.end()
        least, most = {"*": (0, None), "+": (1, None), "?": (0, 1)}.get(match[1] or "", (0, 0))
        if not match[1]:
            least = int(match[2])
            most = least if not match[3] else int(match[4]) if match[4] else None
        if (least + (most or 1)) * len(steps) > _STEPS:
            raise ValueError(f"{self._pattern!r} repeats too often")
        return _repeat(steps, least, most, lazy=bool(match[5]))


def _in_class(sign: re.Match[str]) -> str:
    """A part of a class as `re` has it."""
    return _BLANKS if sign[0] == "\\h" else f"{sign[1]}\\-" if sign[1] else sign[0]


def _repeat(steps: list[_Step], least: int, most: int | None, *, lazy: bool) -> list[_Step]:
    def either(ahead: int, beyond: int) -> _Step:
        return ("split", beyond, ahead) if lazy else ("split", ahead, beyond)

    repeated = steps * least
    if most is None:
        return [*repeated, either(1, len(steps) + 2), *steps, ("jump", -len(steps) - 1)]
    for _ in range(most - least):
        repeated = [*repeated, either(1, len(steps) + 1), *steps]
    return repeated


@lru_cache(256)
def _compiled(pattern: str, flags: str) -> tuple[_Step, ...]:
    if not set(flags) <= {*_FLAGS, "x"}:
        raise ValueError(f"{flags!r}: flags are i, s, m and x")
    pattern = _QUOTED.sub(lambda sign: sign[0] if sign[1] is None else re.escape(sign[1]), pattern)
    if "x" in flags:
        pattern = "".join(re.findall(r"\\\S|\[(?:\\.|[^\]\\])*\]|\S", pattern, re.DOTALL))
    value = 0
    for flag in flags.replace("x", ""):
        value |= _FLAGS[flag]
    try:
        return _Compiler(pattern, value).program()
    except re.error as error:
        raise ValueError(f"{pattern!r} is not a supported regular expression: {error}") from None


def matches(text: str, pattern: str, flags: str = "") -> Iterator[Groups]:
    """Yield all matches from left to right, none inside another. Raises ValueError for an invalid pattern."""
    program, start = _compiled(pattern, flags), 0
    while start <= len(text):
        span = _search(program, text, start)
        if span is None:
            return
        yield span
        start = span[1] + (span[0] == span[1])


def _search(program: tuple[_Step, ...], text: str, start: int) -> Groups | None:
    """The first match from `start` on. What came to nothing once does so again, wherever the search began."""
    tried: set[int] = set()
    for place in range(start, len(text) + 1):
        span = _match(program, text, place, tried)
        if span is not None:
            return span
    return None


def _match(program: tuple[_Step, ...], text: str, place: int, tried: set[int]) -> Groups | None:
    pending: list[tuple[int, int, Groups]] = [(0, place, {})]
    while pending:
        step, place, marks = pending.pop()
        while (key := step * (len(text) + 1) + place) not in tried:
            tried.add(key)
            spend(PASS)
            kind, *values = program[step]
            if kind == "end":
                return marks
            if kind == "mark":
                marks = {**marks, values[0]: place}
            elif kind == "split":
                pending.append((step + values[1], place, marks))
            elif not (kind == "jump" or values[0](text, place)) or (kind == "letter" and place == len(text)):
                break
            place += kind == "letter"
            step += values[0] if kind in ("split", "jump") else 1
    return None
