"""The functions of FEEL about contexts, and about null."""

from __future__ import annotations

from functools import reduce
from typing import Any

from fame.scripting.data import fields_of, is_list, plain
from fame.scripting.feel.values import field_of
from fame.scripting.signatures import functions


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
        raise TypeError(f"{first!r} is no key")
    return {**entries, first: _put(entries.get(first), rest, value) if rest else value}


def _merge(contexts: list[Any]) -> dict[str, Any]:
    return {key: value for context in contexts for key, value in fields_of(context).items()}


def _merge_all(*contexts: Any) -> dict[str, Any]:
    """Of several contexts, or of a list of them."""
    return _merge([context for item in contexts for context in (plain(item) if is_list(item) else [item])])


def _made(entries: list[Any]) -> dict[str, Any]:
    """Of a list of contexts with `key` and `value`."""
    found = {entry["key"]: entry["value"] for entry in map(fields_of, entries)}
    if not all(isinstance(key, str) for key in found):
        raise TypeError("a key is no text")
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
