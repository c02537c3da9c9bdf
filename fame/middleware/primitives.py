"""Values of primitive fields: numbers, texts and lists of them, converted from values of models, scripts and JSON.

A converter takes any value and returns that of the field, or raises `Misfit`. It accepts other forms of the same value
(``"true"`` for a bool, ``"1.5"`` and ``1`` for a float, ``3.0`` for an int, a number for a string), and nothing that
would lose information. There is one converter per field, made once; the usual case passes it with one test. What is
right already is returned as it is, the same object. A float32 is rounded: 0.2 is 0.20000000298023224, as on the wire.
"""

from __future__ import annotations

import math
import numbers
import operator
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fame.middleware.definitions import Field

Converter = Callable[[Any], Any]

DTYPES = {"byte": "uint8"}
"""Primitive -> numpy dtype of a list of it, where the names differ. Lists of strings are not arrays."""

_INTEGERS = {f"{sign}int{bits}": bits for sign in ("", "u") for bits in (8, 16, 32, 64)} | {"byte": 8}
_FLOAT32 = struct.Struct("f")
_LARGEST_FLOAT32 = (2 - 2**-23) * 2.0**127


class Misfit(Exception):
    """A value that does not fit. `path` leads to it, outermost step first; `text` says what was expected and given."""

    text: str
    path: str

    def __init__(self, text: str, path: str = "") -> None:
        super().__init__(text)
        self.text, self.path = text, path

    def below(self, step: str) -> Misfit:
        """Extend the path by the field that contains the value. Returns the misfit."""
        self.path = step + self.path if not self.path or self.path.startswith("[") else f"{step}.{self.path}"
        return self


def expected(wanted: str, found: Any) -> Misfit:
    """Return the Misfit with the expected and the given value."""
    return Misfit(f"expected {wanted}, got {describe(found)}")


def describe(value: Any) -> str:
    """Return a short description of a value, for messages."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return f"a mapping with {', '.join(map(str, value))}"[:80] if value else "an empty mapping"
    if isinstance(value, (str, int, float)):
        text = repr(value)
        return text if len(text) <= 40 else f"{text[:37]}..."
    return f"a {getattr(value, '__msgtype__', type(value).__name__)}"


def zero(field: Field) -> Any:
    """Return the default of a field of primitives, where its type gives none."""
    value: Any = {"string": "", "bool": False}.get(field.base, 0)
    return value if field.shape == "single" else [value] * (field.size if field.shape == "array" else 0)


def converter(field: Field) -> Converter:
    """Return the converter of a field of primitives, single or many."""
    single = _single(field)
    if field.shape == "single":
        return single
    return listed(single, field) if field.base == "string" else _array(field, single)


def listed(convert: Converter, field: Field) -> Callable[[Any], list[Any]]:
    """Return a converter of lists, from that of their items. The length is that of the field."""

    def convert_all(value: Any) -> list[Any]:
        if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
            tolist = getattr(value, "tolist", None)
            value = tolist() if tolist is not None else value
            if not isinstance(value, list):
                raise expected(f"a list ({field})", value)
        items: list[Any] = []
        try:
            for item in value:
                items.append(convert(item))  # noqa: PERF401 (the length tells which item it was)
        except Misfit as misfit:
            raise misfit.below(f"[{len(items)}]") from None
        check_length(len(items), field)
        return value if value.__class__ is list and all(map(operator.is_, items, value)) else items

    return convert_all


def check_length(length: int, field: Field) -> None:
    """Raise Misfit if `length` is not that of an array, or over the bound of a sequence."""
    if field.shape == "array" and length != field.size:
        raise Misfit(f"expected {field.size} values ({field}), got {length}")
    if field.size and length > field.size:
        raise Misfit(f"expected at most {field.size} values ({field}), got {length}")


def _single(field: Field) -> Converter:
    if field.base == "bool":
        return _bool
    if field.base == "string":
        return _bounded_string(field.bound) if field.bound else _string
    if field.base in _INTEGERS:
        return _integer(field.base)
    return _float32 if field.base == "float32" else _float


def _bool(value: Any) -> bool:
    if value is True or value is False:
        return value
    known = {"true": True, "false": False, "1": True, "0": False}
    text = str(value).strip().lower()
    if text in known and (isinstance(value, (str, int)) or hasattr(value, "dtype")):
        return known[text]
    raise expected("true or false", value)


def _float(value: Any) -> float:
    if value.__class__ is float:
        return value
    if value.__class__ is int or (isinstance(value, (numbers.Real, str)) and not isinstance(value, bool)):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    raise expected("a number", value)


def _float32(value: Any) -> float:
    number = _float(value)
    if abs(number) > _LARGEST_FLOAT32 and not math.isinf(number):
        raise expected("a number of at most 3.4e38 (float32)", value)
    rounded: float = _FLOAT32.unpack(_FLOAT32.pack(number))[0]
    return number if rounded == number else rounded


def _integer(base: str) -> Converter:
    bits = _INTEGERS[base]
    low = -(2 ** (bits - 1)) if base.startswith("int") else 0
    high = low + 2**bits - 1
    wanted = f"an integer from {low} to {high} ({base})"

    def convert(value: Any) -> int:
        number = value if value.__class__ is int else _to_int(value)
        if number is None or not low <= number <= high:
            raise expected(wanted, value)
        return number

    return convert


def _to_int(value: Any) -> int | None:
    """The integer that a value is or denotes; None for other values."""
    if isinstance(value, bool):
        return None
    if isinstance(value, numbers.Integral):
        return operator.index(value)
    if isinstance(value, bytes) and len(value) == 1:
        return value[0]  # what `byte` is in rclpy
    try:
        if isinstance(value, str):
            return int(value)
        if isinstance(value, numbers.Real):
            return int(number) if (number := float(value)).is_integer() else None
    except (ValueError, OverflowError):
        pass
    return None


def _string(value: Any) -> str:
    text = value if value.__class__ is str else _to_string(value)
    if "\0" in text:
        raise expected("a text without NUL characters", value)
    if not text.isascii():
        _encoded(text)
    return text


def _bounded_string(bound: int) -> Converter:
    def convert(value: Any) -> str:
        text = _string(value)
        if len(_encoded(text)) > bound:
            raise expected(f"a text of at most {bound} bytes", value)
        return text

    return convert


def _to_string(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (str, int, float)):
        return str(value)
    raise expected("a text", value)


def _encoded(text: str) -> bytes:
    try:
        return text.encode()
    except UnicodeEncodeError:
        raise expected("a text of valid characters (UTF-8)", text) from None


def _array(field: Field, single: Converter) -> Converter:
    """A converter to one-dimensional numpy arrays."""
    import numpy

    dtype = numpy.dtype(DTYPES.get(field.base, field.base))
    as_list = listed(single, field)

    def convert(value: Any) -> Any:
        if isinstance(value, (bytes, bytearray, memoryview)) and dtype == numpy.uint8:
            value = numpy.frombuffer(value, numpy.uint8)
        if isinstance(value, numpy.ndarray) and value.dtype == dtype and value.ndim == 1:
            check_length(len(value), field)
            return value
        return numpy.array(as_list(value), dtype)

    return convert
