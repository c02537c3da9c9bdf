"""Messages: made from mappings and bare values, and turned back into them.

Types are named ``geometry_msgs/msg/Twist``, or ``geometry_msgs/Twist`` for short: those of ROS 2 Jazzy's common
interfaces, and those that `register` and `register_files` add. A message is an object with one attribute per field; it
must not be changed once it was published. The functions that fill messages are made once per type and kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, cast

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import typesystem
from fame.middleware.classes import Message, message_class
from fame.middleware.definitions import Definition, Field
from fame.middleware.primitives import Converter, Misfit, converter, describe, expected, listed
from fame.middleware.typesystem import action, register, register_files, service

__all__ = [
    "Message",
    "action",
    "bare",
    "create",
    "default_payload",
    "fields",
    "goal_type",
    "is_action",
    "is_wrapper",
    "message_type",
    "register",
    "register_files",
    "service",
    "to_mapping",
    "type_name",
    "types",
]

_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def create(type: str, value: Any = None) -> Message:
    """A message of a type.

    `value` is None for one of defaults, a mapping with some of the fields, or a message of that type, which is returned
    as it is. A type whose only field is ``data`` (``std_msgs/msg/String``) takes the value of that field, times and
    durations take a number of seconds. Values in another form are converted: ``"true"``, ``"1.5"``, ``3.0`` for an
    integer. Raises MessageError with the path of the field for a value that does not fit, and for an unknown field.
    """
    try:
        return _class(type)() if value is None else cast(Message, _filler(type)(value))
    except Misfit as misfit:
        raise MessageError(misfit.text, type=typesystem.definition(type).name, field=misfit.path) from None


def to_mapping(message: Message) -> dict[str, Any]:
    """The message as plain data (dict, list, str, int, float, bool), as `create` and JSON take it."""
    return {name: plain(getattr(message, attribute)) for name, attribute, plain in _reader(message.__msgtype__)}


def bare(message: Message) -> Any:
    """The value of a wrapper such as ``std_msgs/msg/String``; any other message as it is."""
    return message.data if is_wrapper(message.__msgtype__) else message


def default_payload(type: str) -> Any:
    """The plain data of a message of defaults; of a wrapper the bare value."""
    data = to_mapping(create(type))
    return data["data"] if is_wrapper(type) else data


def message_type(name: str) -> type[Message]:
    """The class of a type. Raises MessageError for an unknown one, with similar names."""
    return _class(name)


def type_name(message: Message) -> str:
    """``pkg/msg/Type`` of a message. Raises MessageError for an object that is not a message."""
    if not isinstance(message, Message):
        raise MessageError(f"expected a message, got {describe(message)}")
    return message.__msgtype__


def goal_type(type: str) -> str | None:
    """The message type of an action's goals; None for a type of another kind. Raises MessageError if it is unknown."""
    return f"{action(type)}_Goal" if is_action(type) else None


def is_action(type: str) -> bool:
    """Whether a full type is that of an action, ``pkg/action/Name``."""
    return "/action/" in type


def types() -> list[str]:
    """The full names of all types, sorted."""
    return typesystem.names()


@cache
def fields(type: str) -> Mapping[str, str]:
    """Field -> its type, as a `.msg` file writes it: ``float64[36]``, ``geometry_msgs/msg/Point[]``."""
    return MappingProxyType({field.name: str(field) for field in typesystem.definition(type).fields})


@cache
def is_wrapper(type: str) -> bool:
    """Whether ``data`` is the only field of a type: its messages wrap a single value."""
    return typesystem.definition(type).is_wrapper


# ---- from values to messages -----------------------------------------------------------------------------------------

_class = cache(message_class)


@cache
def _filler(name: str) -> Converter:
    """The function that makes a message of the type from any value. It raises Misfit."""
    content = typesystem.definition(name)
    cls = _class(name)
    convert = {field.name: _converter(field) for field in content.fields}
    attributes = {field.name: field.attribute for field in content.fields if field.name != field.attribute}
    from_other = _from_other(content, cls, convert)

    def fill(value: Any) -> Any:
        if value.__class__ is cls:
            return value
        if value.__class__ is not dict and not isinstance(value, Mapping):
            return from_other(value)
        given = {}
        step = ""
        try:
            for step, item in value.items():
                given[step] = convert[step](item)
        except KeyError:  # of `convert`: a converter raises nothing but Misfit
            known = ", ".join(convert) or "none"
            raise Misfit(f"there is no such field; those of {content.name} are {known}", str(step)) from None
        except Misfit as misfit:
            raise misfit.below(step) from None
        for field, attribute in attributes.items():
            if field in given:
                given[attribute] = given.pop(field)
        return cls(**given)

    return fill


def _from_other(content: Definition, cls: type[Message], convert: Mapping[str, Converter]) -> Converter:
    """The function that makes a message from a value that is not a mapping."""
    if content.name in _TIMES:
        return lambda value: _time(cls, convert, value)
    if content.is_wrapper:
        single = convert["data"]

        def wrap(value: Any) -> Message:
            try:
                return cls(single(value))  # type: ignore[call-arg]
            except Misfit as misfit:
                raise misfit.below("data") from None

        return wrap

    def refuse(value: Any) -> Message:
        raise expected(f"{content.name} or a mapping with {', '.join(convert) or 'nothing'}", value)

    return refuse


def _converter(field: Field) -> Converter:
    if not field.is_message:
        return converter(field)
    fill = _filler(field.base)
    return fill if field.shape == "single" else listed(fill, field)


def _time(cls: type[Message], convert: Mapping[str, Converter], value: Any) -> Message:
    """A time or duration of a number of seconds, to the nanosecond."""
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise expected("seconds, or a mapping with sec and nanosec", value)
    whole = math.floor(value)
    carry, rest = divmod(round((value - whole) * SECOND), SECOND)
    return cls(convert["sec"](whole + carry), rest)  # type: ignore[call-arg]


# ---- from messages to plain data -------------------------------------------------------------------------------------


@cache
def _reader(name: str) -> tuple[tuple[str, str, Callable[[Any], Any]], ...]:
    """(name, attribute, function that makes it plain) of each field."""
    return tuple((field.name, field.attribute, _to_plain(field)) for field in typesystem.definition(name).fields)


def _to_plain(field: Field) -> Callable[[Any], Any]:
    if field.is_message:
        return to_mapping if field.shape == "single" else _plain_messages
    return _plain


def _plain_messages(messages: Any) -> list[dict[str, Any]]:
    return [to_mapping(message) for message in messages]


def _plain(value: Any) -> Any:
    tolist = getattr(value, "tolist", None)  # of numpy's arrays and numbers
    return value if tolist is None else tolist()
