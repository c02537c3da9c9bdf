"""The class of each message type: a dataclass with slots, made when first asked for.

``Vector3()`` has the defaults of ROS, ``Vector3(x=1.0)`` takes values as they are (`fame.middleware.messages.create`
converts and checks). Messages compare by value and show themselves in one short line. Constants of the type are
attributes of the class (``Range.ULTRASOUND``). Fields of several numbers are numpy arrays of one dimension; those of
several texts or messages are lists.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING, Any, ClassVar

from fame.errors import MessageError
from fame.middleware import typesystem
from fame.middleware.definitions import EMPTY_FIELD, Definition, Field
from fame.middleware.primitives import Misfit, converter, zero

_lock = threading.RLock()


class Message:
    """What all messages have in common. ``__msgtype__`` is the full name of the type."""

    __slots__: tuple[str, ...] = ()
    __msgtype__: ClassVar[str]
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


def message_class(name: str) -> type[Message]:
    """The class of a type. Raises MessageError for a type that is not known, or holds one that is not."""
    content = typesystem.definition(name)
    typesystem.check_references(content)
    with _lock:  # one class per type, whoever asks first
        return _class(content.name)


@cache
def _class(name: str) -> type[Message]:
    content = typesystem.definition(name)
    fields = [(field.attribute, str(field), _with_default(field, content)) for field in content.fields]
    return dataclasses.make_dataclass(
        name.rpartition("/")[2],
        fields or [(EMPTY_FIELD, "uint8", dataclasses.field(default=0))],
        bases=(Message,),
        namespace={**content.constants, "__msgtype__": name, "__module__": __name__, "__doc__": f"``{name}``."},
        eq=False,
        repr=False,
        slots=True,
    )


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
