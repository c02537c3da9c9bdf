"""Values as data for JSON, and back. Types that JSON lacks become an object with one key that begins with ``$``."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from fame.errors import MissionError
from fame.text import sorted_set

Data = dict[str, Any]
Convert = Callable[[Any], Any]


def no_data(value: Any) -> Any:
    """Reject values that cannot be serialised. Raises MissionError."""
    raise unstorable(value, "it is not plain data")


def unstorable(value: Any, reason: str) -> MissionError:
    """Return the error of a value that cannot be serialised."""
    return MissionError(f"a {type(value).__name__} cannot be kept in a snapshot: {reason}")


_GREATEST = 2**2048
"""Greatest integer that is written in digits: Python may be set to refuse texts of more than 640 digits."""
_KNOWN = frozenset({bool, int, str, type(None)})


_PLAIN: tuple[type, ...] = (bool, int, str, float, bytes, list, dict, set, frozenset)
_EXACT = frozenset({*_PLAIN, tuple, type(None)})


def only_plain(value: Any) -> Any:
    """Return a value of a class that is derived of a plain one. Raises MissionError for others."""
    return value if isinstance(value, _PLAIN) else no_data(value)


def encode(value: Any, dump: Convert = only_plain) -> Any:
    """Return a value as data for JSON. `dump` makes data of values of other types, and may raise MissionError, as this
    does for a value that is nested too deep, or whose own code fails. A value of a derived class, as of `int`, that it
    returns as it is becomes one of the plain class."""
    try:
        return _encode(value, dump)
    except RecursionError:
        raise MissionError("a value cannot be kept in a snapshot: it is nested too deep") from None
    except (MissionError, MemoryError):
        raise
    except Exception as error:  # of the code of a library
        raise unstorable(value, f"{type(error).__name__}: {error}") from error


def _encode(value: Any, dump: Convert) -> Any:
    if type(value) not in _EXACT and (data := dump(value)) is not value:
        return {"$object": _encode(data, dump)}
    if isinstance(value, int) and not -_GREATEST <= value <= _GREATEST:
        return {"$int": f"{value:x}"}
    if value is None or isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, float):
        return {"$float": repr(float(value))}
    if isinstance(value, bytes):
        return {"$bytes": value.hex()}
    if isinstance(value, list):
        return list(value) if _is_plain(value) else [_encode(item, dump) for item in value]
    if isinstance(value, set | frozenset) or type(value) is tuple:
        kind = "tuple" if isinstance(value, tuple) else "set" if isinstance(value, set) else "frozenset"
        items = value if kind == "tuple" else sorted_set(value)
        return {f"${kind}": [_encode(item, dump) for item in items]}
    if isinstance(value, dict):
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return {key: _encode(item, dump) for key, item in value.items()}
        return {"$dict": [[_encode(key, dump), _encode(item, dump)] for key, item in value.items()]}
    return no_data(value)


def _is_plain(items: list[Any]) -> bool:
    """Return whether JSON has the types of all items: a call for each of many thousands of items is too slow."""
    kinds = set(map(type, items))
    if kinds == {float}:
        return all(map(math.isfinite, items))
    numbers = [item for item in items if item.__class__ is int] if int in kinds and kinds <= _KNOWN else ()
    return kinds <= _KNOWN and (not numbers or (min(numbers) >= -_GREATEST and max(numbers) <= _GREATEST))


def decode(data: Any, load: Convert = no_data) -> Any:
    """Return the value of some data: the inverse of `encode`."""
    if isinstance(data, list):
        return [decode(item, load) for item in data]
    if not isinstance(data, dict):
        return data
    if len(data) == 1:
        ((kind, inner),) = data.items()
        if kind in _DECODERS:
            return _DECODERS[kind](inner, load)
    return {key: decode(item, load) for key, item in data.items()}


_DECODERS: dict[str, Callable[[Any, Convert], Any]] = {
    "$float": lambda inner, load: float(inner),
    "$int": lambda inner, load: int(inner, 16),
    "$bytes": lambda inner, load: bytes.fromhex(inner),
    "$tuple": lambda inner, load: tuple(decode(inner, load)),
    "$set": lambda inner, load: set(decode(inner, load)),
    "$frozenset": lambda inner, load: frozenset(decode(inner, load)),
    "$dict": lambda inner, load: {decode(key, load): decode(value, load) for key, value in inner},
    "$object": lambda inner, load: load(decode(inner, load)),
}
