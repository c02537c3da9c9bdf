"""How ranges and points lie to each other (DMN 1.5, table 78). A point is a range from itself to itself."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from fame.scripting.feel.values import Range, order
from fame.scripting.signatures import functions


def _less(left: Any, right: Any) -> bool:
    found = order(operator.lt, left, right)
    if found is None:
        raise TypeError(f"{left!r} and {right!r} have no order")
    return found


def _same(left: Any, right: Any) -> bool:
    return not _less(left, right) and not _less(right, left)


def _before(a: Range, b: Range) -> bool:
    return _less(a.high, b.low) or (_same(a.high, b.low) and not (a.with_high and b.with_low))


def _meets(a: Range, b: Range) -> bool:
    return a.with_high and b.with_low and _same(a.high, b.low)


def _begins_no_later(a: Range, b: Range) -> bool:
    return _less(a.low, b.low) or (_same(a.low, b.low) and (a.with_low or not b.with_low))


def _ends_no_earlier(a: Range, b: Range) -> bool:
    return _less(b.high, a.high) or (_same(a.high, b.high) and (a.with_high or not b.with_high))


def _overlaps(a: Range, b: Range) -> bool:
    return not _before(a, b) and not _before(b, a)


def _overlaps_before(a: Range, b: Range) -> bool:
    return _overlaps(a, b) and not _begins_no_later(b, a) and _ends_no_earlier(b, a)


def _finishes(a: Range, b: Range) -> bool:
    return _same(a.high, b.high) and a.with_high == b.with_high and _begins_no_later(b, a)


def _starts(a: Range, b: Range) -> bool:
    return _same(a.low, b.low) and a.with_low == b.with_low and _ends_no_earlier(b, a)


def _includes(a: Range, b: Range) -> bool:
    return _begins_no_later(a, b) and _ends_no_earlier(a, b)


def _coincides(a: Range, b: Range) -> bool:
    return _includes(a, b) and _includes(b, a)


def _swapped(relation: Callable[[Range, Range], bool]) -> Callable[[Range, Range], bool]:
    return lambda a, b: relation(b, a)


def _relation(relation: Callable[[Range, Range], bool]) -> Callable[[Any, Any], bool]:
    def of(*values: Any) -> bool:
        a, b = (value if isinstance(value, Range) else Range(value, value) for value in values)
        return relation(a, b)

    return of


_RELATIONS: dict[str, Callable[[Range, Range], bool]] = {
    "before": _before,
    "after": _swapped(_before),
    "meets": _meets,
    "met by": _swapped(_meets),
    "overlaps": _overlaps,
    "overlaps before": _overlaps_before,
    "overlaps after": _swapped(_overlaps_before),
    "finishes": _finishes,
    "finished by": _swapped(_finishes),
    "includes": _includes,
    "during": _swapped(_includes),
    "starts": _starts,
    "started by": _swapped(_starts),
    "coincides": _coincides,
}

RANGES = functions(
    {f"{name}(range1: value, range2: value)": _relation(relation) for name, relation in _RELATIONS.items()}
)
"""Name -> its signatures."""
