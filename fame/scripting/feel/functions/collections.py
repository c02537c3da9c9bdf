"""The functions of FEEL about lists, contexts and null."""

from __future__ import annotations

import math
import operator
import statistics
from collections.abc import Callable, Iterator
from functools import cmp_to_key, reduce
from typing import Any

from fame.scripting.budget import spend
from fame.scripting.data import fields_of, is_list, is_number, plain, product, quotient
from fame.scripting.feel.syntax import Lambda
from fame.scripting.feel.values import equal, field_of, identity, order
from fame.scripting.signatures import functions


def _items(values: tuple[Any, ...]) -> list[Any]:
    """The items of a list, or the arguments."""
    return list(plain(values[0])) if len(values) == 1 and is_list(values[0]) else list(values)


def _numbers(values: tuple[Any, ...]) -> list[Any]:
    items = _items(values)
    if not items or not all(map(is_number, items)):
        raise TypeError(f"{items!r} are no numbers")
    return items


def _of_numbers(function: Callable[[list[Any]], Any]) -> Callable[..., Any]:
    return lambda *values: function(_numbers(values))


def _extreme(compare: Callable[[Any, Any], bool]) -> Callable[..., Any]:
    """The smallest or greatest of ordered values: numbers, texts, dates, durations."""

    def better(best: Any, item: Any) -> Any:
        is_better = order(compare, item, best)
        if is_better is None:
            raise TypeError(f"{item!r} and {best!r} have no order")
        return item if is_better else best

    def extreme(*values: Any) -> Any:
        items = _items(values)
        return reduce(better, items, items[0]) if items else None

    return extreme


def _stddev(items: list[Any]) -> float:
    mean = math.fsum(items) / len(items)
    return math.sqrt(math.fsum((item - mean) ** 2 for item in items) / (len(items) - 1))


def _mode(*values: Any) -> list[Any]:
    items = _items(values)
    return sorted(statistics.multimode(_numbers((items,)))) if items else []


def _all(*values: Any) -> bool | None:
    items = _items(values)
    return False if any(item is False for item in items) else True if all(item is True for item in items) else None


def _any(*values: Any) -> bool | None:
    items = _items(values)
    return True if any(item is True for item in items) else False if all(item is False for item in items) else None


def _index(items: list[Any], position: Any) -> int:
    """The index of a position, counted from 1 or from -1 at the end. Raises IndexError."""
    place = int(position)
    if place == 0 or abs(place) > len(items):
        raise IndexError(f"the list has no place {position}")
    return place - 1 if place > 0 else len(items) + place


def _sublist(items: list[Any], start: Any, length: Any = None) -> list[Any]:
    first = _index(items, start)
    return items[first:] if length is None else items[first : first + max(0, int(length))]


def _insert(items: list[Any], position: Any, item: Any) -> list[Any]:
    place = _index([*items, item] if position > 0 else items, position)
    return [*items[:place], item, *items[place:]]


def _remove(items: list[Any], position: Any) -> list[Any]:
    place = _index(items, position)
    return items[:place] + items[place + 1 :]


def _replace(items: list[Any], which: Any, item: Any) -> list[Any]:
    """At a place, or wherever a function of the old and the new item says so."""
    if isinstance(which, Lambda):
        return [item if which.apply(old, item) is True else old for old in items]
    place = _index(items, which)
    return [*items[:place], item, *items[place + 1 :]]


def _places(items: list[Any], match: Any) -> list[int]:
    return [place for place, item in enumerate(items, 1) if equal(item, match) is True]


def _first_of_each(items: list[Any]) -> list[Any]:
    found: dict[Any, Any] = {}
    for item in items:
        found.setdefault(identity(item), item)
    return list(found.values())


def _duplicates(items: list[Any]) -> list[Any]:
    seen: dict[Any, list[Any]] = {}
    for item in items:
        seen.setdefault(identity(item), []).append(item)
    return [same[0] for same in seen.values() if len(same) > 1]


def _flat(items: list[Any]) -> Iterator[Any]:
    for item in items:
        spend(1)
        if is_list(item):
            yield from _flat(list(plain(item)))
        else:
            yield item


def _partition(items: list[Any], size: Any) -> list[list[Any]]:
    if int(size) < 1:
        raise ValueError(f"expected a size of 1 or more, got {size}")
    return [items[place : place + int(size)] for place in range(0, len(items), int(size))]


def _sort(items: list[Any], precedes: Any = None) -> list[Any]:
    """By a function of two items; without one, in ascending order."""
    if precedes is not None and not isinstance(precedes, Lambda):
        raise TypeError(f"{precedes!r} is not a function")

    def before(left: Any, right: Any) -> bool:
        found = order(operator.lt, left, right) if precedes is None else precedes.apply(left, right)
        if found is None:
            raise TypeError(f"{left!r} and {right!r} have no order")
        return found is True

    return sorted(items, key=cmp_to_key(lambda a, b: -1 if before(a, b) else 1 if before(b, a) else 0))


def _join(items: list[Any], delimiter: Any = None, prefix: Any = None, suffix: Any = None) -> str:
    texts = [item for item in items if item is not None]
    if not all(isinstance(text, str) for text in (*texts, delimiter or "", prefix or "", suffix or "")):
        raise TypeError("only texts can be joined")
    return (prefix or "") + (delimiter or "").join(texts) + (suffix or "")


def _is_empty(value: Any) -> bool:
    if not is_list(value):
        raise TypeError(f"{value!r} is not a list")
    return len(value) == 0


_ANY_OF_ALL: dict[str, Callable[..., Any]] = {"all": _all, "and": _all, "any": _any, "or": _any}
_OF_NUMBERS: dict[str, Callable[[list[Any]], Any]] = {
    "sum": sum,
    "product": lambda items: reduce(product, items),
    "mean": lambda items: quotient(sum(items), len(items)),
    "median": statistics.median,
    "stddev": _stddev,
}

COLLECTIONS = functions(
    {
        "list contains(list: list, element: any)": lambda items, item: bool(_places(items, item)),
        "count(list: list)": len,
        "min(list...: any)": _extreme(operator.lt),
        "max(list...: any)": _extreme(operator.gt),
        **{f"{name}(list...: any)": _of_numbers(function) for name, function in _OF_NUMBERS.items()},
        "mode(list...: any)": _mode,
        **{f"{name}(list...: any)": function for name, function in _ANY_OF_ALL.items()},
        "sublist(list: list, start position: number, length?: number)": _sublist,
        "append(list: list, items...: any)": lambda items, *more: [*items, *more],
        "concatenate(lists...: list)": lambda *lists: [item for items in lists for item in items],
        "insert before(list: list, position: number, newItem: any)": _insert,
        "remove(list: list, position: number)": _remove,
        "list replace(list: list, position: value, newItem: any)": _replace,
        "reverse(list: list)": lambda items: items[::-1],
        "index of(list: list, match: any)": _places,
        "union(lists...: list)": lambda *lists: _first_of_each([item for items in lists for item in items]),
        "distinct values(list: list)": _first_of_each,
        "duplicate values(list: list)": _duplicates,
        "flatten(list: list)": lambda items: list(_flat(items)),
        "sort(list: list, precedes?: any)": _sort,
        "string join(list: list, delimiter?: any, prefix?: any, suffix?: any)": _join,
        "is empty(list: value)": _is_empty,
        "partition(list: list, size: number)": _partition,
    }
)
"""Name -> its signatures."""


# ---- contexts and null -----------------------------------------------------------------------------------------------


def _get(context: Any, keys: Any) -> Any:
    """The entry at a key, or at a path of keys."""
    if not is_list(keys):
        return None if is_list(context) else field_of(context, keys)
    return reduce(_get, plain(keys), context) if len(keys) else None


def _entries(context: Any) -> list[dict[str, Any]]:
    return [{"key": key, "value": value} for key, value in fields_of(context).items()]


def _put(context: Any, keys: Any, value: Any) -> dict[str, Any]:
    """The context with another value under a key, or under a path of keys (DMN 1.5, table 81); null is an empty one."""
    first, *rest = plain(keys) if is_list(keys) else [keys]
    entries = fields_of(context)
    if not isinstance(first, str):
        raise TypeError(f"{first!r} is not a key")
    return {**entries, first: _put(entries.get(first), rest, value) if rest else value}


def _merge(contexts: list[Any]) -> dict[str, Any]:
    return {key: value for context in contexts for key, value in fields_of(context).items()}


def _merge_all(*contexts: Any) -> dict[str, Any]:
    """Merge several contexts, or a list of them."""
    return _merge([context for item in contexts for context in (plain(item) if is_list(item) else [item])])


def _made(entries: list[Any]) -> dict[str, Any]:
    """The context made of a list of contexts with `key` and `value`."""
    found = {entry["key"]: entry["value"] for entry in map(fields_of, entries)}
    if not all(isinstance(key, str) for key in found):
        raise TypeError("expected a text as key")
    return found


def _assert(value: Any, condition: Any, cause: Any = "the condition is not met") -> Any:
    if condition is not True:
        raise AssertionError(str(cause))
    return value


CONTEXTS = functions(
    {
        "get value(context: value, key: value)": _get,
        "get value(m: value, key: value)": _get,
        "get entries(context: value)": _entries,
        "get entries(m: value)": _entries,
        "context put(context: any, key: value, value: any)": _put,
        "put(context: any, key: value, value: any)": _put,
        "context merge(contexts: list)": _merge,
        "put all(contexts...: value)": _merge_all,
        "context(entries: list)": _made,
        "is defined(value: any)": lambda value: value is not None,
        "get or else(value: any, default: any)": lambda value, default: default if value is None else value,
        "assert(value: any, condition: any, cause?: any)": _assert,
    }
)
"""Name -> its signatures."""
