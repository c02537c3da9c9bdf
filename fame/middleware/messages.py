"""Messages: their classes, and how they are made from mappings and bare values and turned back into them.

Types are named ``geometry_msgs/msg/Twist``, or ``geometry_msgs/Twist`` for short: those of ROS 2 Jazzy's common
interfaces, and those that `register` and `register_files` add. A message is an object with one attribute per field; it
must not be changed once it was published. The functions that fill messages are made once per type and kept.

The class of a type is a dataclass with slots, made when first asked for. ``Vector3()`` has the defaults of ROS,
``Vector3(x=1.0)`` takes values as they are (`create` converts and checks). Messages compare by value and show
themselves in one short line. Constants of the type are attributes of the class (``Range.ULTRASOUND``). Fields of
several numbers are numpy arrays of one dimension; those of several texts or messages are lists.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from keyword import iskeyword
from operator import attrgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, cast

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import typesystem
from fame.middleware.definitions import EMPTY_FIELD, Definition, Field
from fame.middleware.primitives import Converter, Misfit, converter, describe, expected, listed, zero
from fame.middleware.typesystem import (
    action as action,
    register as register,
    register_files as register_files,
    service as service,
)

_QUATERNION = "geometry_msgs/msg/Quaternion"
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_lock = threading.RLock()


class Message:
    """Base class of all messages. ``__msgtype__`` is the full name of the type.

    A field is an attribute of its name in the `.msg` file, ``__field_names__``. One that is a keyword of Python
    (``class``) is read as ``class_``, too, which is how Python can spell it.
    """

    __slots__: tuple[str, ...] = ()
    __msgtype__: ClassVar[str]
    __field_names__: ClassVar[tuple[str, ...]]
    __hash__: ClassVar[None] = None  # type: ignore[assignment]

    if TYPE_CHECKING:  # the fields are known at run time only

        def __getattr__(self, name: str) -> Any: ...
        def __setattr__(self, name: str, value: Any) -> None: ...

    def __eq__(self, other: object) -> bool:
        if other.__class__ is not self.__class__:
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in self.__slots__)

    def __repr__(self) -> str:
        """Every field of the message; of messages inside it, those that differ from their defaults."""
        return _show(self, whole=True)


def create(type: str, value: Any = None) -> Message:
    """Return a message of a type.

    `value` is None for one of defaults, a mapping with some of the fields, or a message of that type, which is
    returned as it is if all its values are of their types. A type whose only field is ``data``
    (``std_msgs/msg/String``) takes the value of that field, times and durations take a number of seconds, a quaternion
    takes a yaw (rad). Values in another form are converted: ``"true"``, ``"1.5"``, ``3.0`` for an integer. Raises
    MessageError with the path of the field for a value that does not fit, and for an unknown field.
    """
    try:
        return message_type(type)() if value is None else cast(Message, _filler(type)(value))
    except Misfit as misfit:
        raise MessageError(misfit.text, type=typesystem.definition(type).name, field=misfit.path) from None


def to_mapping(message: Message) -> dict[str, Any]:
    """Return the message as plain data (dict, list, str, int, float, bool), as `create` and JSON take it."""
    return {name: plain(getattr(message, attribute)) for name, attribute, plain in _reader(message.__msgtype__)}


def bare(message: Message) -> Any:
    """Return the value of a wrapper such as ``std_msgs/msg/String``; any other message as it is."""
    return message.data if is_wrapper(message.__msgtype__) else message


def default_payload(type: str) -> Any:
    """Return the plain data of a message of defaults; of a wrapper the bare value."""
    data = to_mapping(create(type))
    return data["data"] if is_wrapper(type) else data


@cache
def message_type(name: str) -> type[Message]:
    """Return the class of a type. Raises MessageError, with similar names, if it is unknown or contains such a type."""
    content = typesystem.definition(name)
    typesystem.check_references(content)
    with _lock:  # one class per type, whichever thread asks first
        return _class(content.name)


def type_name(message: Message) -> str:
    """``pkg/msg/Type`` of a message. Raises MessageError for an object that is not a message."""
    if not isinstance(message, Message):
        raise MessageError(f"expected a message, got {describe(message)}")
    return message.__msgtype__


def goal_type(type: str) -> str | None:
    """Return the message type of an action's goals; None for a type of another kind. Raises
    MessageError if it is unknown."""
    return f"{action(type)}_Goal" if is_action(type) else None


def is_action(type: str) -> bool:
    """Return whether a full type is that of an action, ``pkg/action/Name``."""
    return "/action/" in type


def types() -> list[str]:
    """Return the full names of all types, sorted."""
    return typesystem.names()


@cache
def fields(type: str) -> Mapping[str, str]:
    """Field -> its type, as a `.msg` file writes it: ``float64[36]``, ``geometry_msgs/msg/Point[]``."""
    return MappingProxyType({field.name: str(field) for field in typesystem.definition(type).fields})


@cache
def is_wrapper(type: str) -> bool:
    """Return whether ``data`` is the only field of a type: its messages wrap a single value."""
    return typesystem.definition(type).is_wrapper


# ---- the classes of messages -----------------------------------------------------------------------------------------


def nanoseconds(time: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/msg/Time."""
    return int(time.sec) * SECOND + int(time.nanosec)


@cache
def _class(name: str) -> type[Message]:
    content = typesystem.definition(name)
    fields = [(field.attribute, str(field), _with_default(field, content)) for field in content.fields]
    names = tuple(field.name for field in content.fields)
    keywords = {name: _keyword(f"{name}_") for name in filter(iskeyword, names)}
    about = {"__field_names__": names, "__msgtype__": name, "__module__": __name__, "__doc__": f"``{name}``."}
    return dataclasses.make_dataclass(
        name.rpartition("/")[2],
        fields or [(EMPTY_FIELD, "uint8", dataclasses.field(default=0))],
        bases=(Message,),
        namespace={**content.constants, **keywords, **about},
        eq=False,
        repr=False,
        slots=True,
    )


def _keyword(attribute: str) -> property:
    return property(lambda message: getattr(message, attribute))


def _with_default(field: Field, content: Definition) -> Any:
    """The dataclass field with the default that `content` gives it, or that of ROS: zeros, messages of defaults."""
    factory: Callable[[], Any]
    if not field.is_message:
        default = content.defaults.get(field.name, zero(field))
        try:
            value = converter(field)(default)
        except Misfit as misfit:
            text = f"its default does not fit: {misfit.text}"
            raise MessageError(text, type=content.name, field=field.name) from None
        if field.shape == "single":
            return dataclasses.field(default=value)
        factory = value.copy
    elif field.shape == "single":
        factory = _class(field.base)
    else:
        factory = partial(_several, _class(field.base), field.size if field.shape == "array" else 0)
    return dataclasses.field(default_factory=factory)


def _several(make: Callable[[], Message], number: int) -> list[Message]:
    return [make() for _ in range(number)]


def _same(one: Any, other: Any) -> bool:
    if hasattr(one, "dtype") or hasattr(other, "dtype"):
        import numpy

        return numpy.array_equal(one, other)
    return bool(one == other)


def _show(message: Message, *, whole: bool = False) -> str:
    default = type(message)()
    shown = (
        f"{name}={_show_value(getattr(message, name))}"
        for name in message.__slots__
        if name != EMPTY_FIELD and (whole or not _same(getattr(message, name), getattr(default, name)))
    )
    return f"{type(message).__name__}({', '.join(shown)})"


def _show_value(value: Any) -> str:
    if isinstance(value, Message):
        return _show(value)
    if not isinstance(value, str) and hasattr(value, "__len__"):
        first = [value[number] for number in range(min(len(value), 4))]
        items = [_show_value(item.item() if hasattr(item, "item") else item) for item in first]
        return f"[{', '.join(items)}{f', ... {len(value)} in all' if len(value) > 4 else ''}]"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


# ---- from values to messages -----------------------------------------------------------------------------------------


@cache
def _filler(name: str) -> Converter:
    """The function that makes a message of the type from any value. It raises Misfit."""
    content = typesystem.definition(name)
    cls = message_type(name)
    settle = _settler(content, cls)
    convert = {field.name: _converter(field) for field in content.fields}
    convert |= {
        field.name: partial(_converted_copy, convert[field.name]) for field in content.fields if field.shape != "single"
    }
    attributes = {field.name: field.attribute for field in content.fields if field.name != field.attribute}
    from_other = _from_other(content, cls, convert)

    def fill(value: Any) -> Any:
        if value.__class__ is cls:
            return settle(value)
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


def _settler(content: Definition, cls: type[Message]) -> Converter:
    """The function that returns a message as any wire carries it: the same one, or one with the values of its types."""
    fields = [(field.attribute, _converter(field)) for field in content.fields]

    def settle(message: Any) -> Any:
        try:
            if _is_settled(content.name)(message):
                return message
        except (AttributeError, Misfit):
            pass  # the walk below says where
        settled = {}
        attribute = ""
        try:
            for attribute, convert in fields:
                settled[attribute] = convert(getattr(message, attribute, None))
        except Misfit as misfit:
            raise misfit.below(attribute) from None
        return cls(**settled)

    return settle


@cache
def _is_settled(name: str) -> Callable[[Message], bool]:
    """The function that tells whether a message, with those in it, has values of its types. Raises Misfit if not."""
    leaves = list(_leaves(typesystem.definition(name), ""))
    get = attrgetter("__class__", "__class__", *(path for path, _ in leaves))  # of two or more a tuple
    classes = tuple(map(type, get(message_type(name)())))
    further = enumerate((field for _, field in leaves), 2)
    tests = [(at, _converter(field)) for at, field in further if str(field) not in ("float64", "bool")]

    def is_settled(message: Message) -> bool:
        values = get(message)
        if tuple(map(type, values)) != classes:
            return False
        for at, test in tests:  # noqa: SIM110 - a generator takes twice as long
            if test(values[at]) is not values[at]:
                return False
        return True

    return is_settled


def _leaves(content: Definition, above: str) -> Iterator[tuple[str, Field]]:
    """The fields that are no single message, with the way to them."""
    for field in content.fields:
        if field.is_message and field.shape == "single":
            yield from _leaves(typesystem.definition(field.base), f"{above}{field.attribute}.")
        else:
            yield f"{above}{field.attribute}", field


def _converted_copy(convert: Converter, value: Any) -> Any:
    """As `convert`, but never the list that is given, which may be changed afterwards."""
    items = convert(value)
    return items.copy() if items is value else items


def _from_other(content: Definition, cls: type[Message], convert: Mapping[str, Converter]) -> Converter:
    """The function that makes a message from a value that is not a mapping."""
    if content.name in _TIMES:
        return lambda value: _time(cls, convert, value)
    if content.name == _QUATERNION:
        return lambda value: _yaw(cls, value)
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


def _yaw(cls: type[Message], value: Any) -> Message:
    """The quaternion of a rotation about z (rad)."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Misfit(f"expected a mapping with x, y, z and w, or a yaw in rad, got {describe(value)}")
    return cls(z=math.sin(value / 2), w=math.cos(value / 2))  # type: ignore[call-arg]


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
    """(name, attribute, function to plain data) of each field."""
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
