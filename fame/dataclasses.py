"""Dataclasses whose methods are compiled when they are first asked for.

`dataclasses.dataclass` compiles up to seven methods of each class where it is declared. A process of one task declares
120 classes: that was 27 % of all instructions of `fame check`. In such a run a third of the classes are made, and
hardly one is compared or shown.
"""

from __future__ import annotations

import dataclasses
from dataclasses import (
    MISSING as MISSING,
    FrozenInstanceError,
    asdict as asdict,
    field as field,
    fields as fields,
    is_dataclass as is_dataclass,
    replace as replace,
)
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn


class _Method:
    """A method of a dataclass with slots, which puts the one of the standard library in its place."""

    __slots__ = ("cls", "frozen", "name")

    def __init__(self, cls: type, name: str, frozen: bool) -> None:
        self.cls, self.name, self.frozen = cls, name, frozen

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        cls, name = self.cls, self.name
        alike: Any = dataclasses.make_dataclass(
            cls.__name__,
            [(each.name, each.type, each) for each in fields(cls)],
            namespace={"__post_init__": None} if hasattr(cls, "__post_init__") else {},
            init=name == "__init__",
            repr=name == "__repr__",
            eq=name == "__eq__",
            unsafe_hash=name == "__hash__",
            frozen=self.frozen and name == "__init__",
        )
        method = vars(alike)[name]
        method.__qualname__, method.__module__ = f"{cls.__qualname__}.{name}", cls.__module__
        setattr(cls, name, method)
        return method.__get__(instance, owner)


def _refuse_to_set(self: object, name: str, value: object) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_to_delete(self: object, name: str) -> NoReturn:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


def _state(self: Any) -> list[Any]:
    return [getattr(self, each.name) for each in fields(self)]


def _set_state(self: Any, state: list[Any]) -> None:
    for each, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, each.name, value)


_OF_FROZEN = {"__setattr__": _refuse_to_set, "__delattr__": _refuse_to_delete, "__getstate__": _state,
              "__setstate__": _set_state}  # fmt: skip


def _params(base: type) -> Any:
    """What a base says of how it was declared; of a plain class that it is not frozen."""
    return getattr(base, "__dataclass_params__", SimpleNamespace(frozen=False))


def _declared(cls: type, frozen: bool, eq: bool, repr: bool, kw_only: bool) -> type:
    """The dataclass of a class, with slots."""
    own = {name for name, value in vars(cls).items() if name != "__hash__" or value is not None}
    cls.__doc__ = cls.__doc__ or cls.__name__  # else it is made of the signature, for which all is compiled
    frozen_bases: list[Any] = [params for base in cls.__mro__[1:] if (params := _params(base)).frozen]
    for params in frozen_bases:  # the methods that freeze are `_OF_FROZEN`
        params.frozen = False
    try:
        made: Any = dataclasses.dataclass(cls, init=False, eq=False, repr=False, slots=True, kw_only=kw_only)
    finally:
        for params in frozen_bases:
            params.frozen = True
    made.__dataclass_params__.frozen = frozen  # which the standard library asks of the bases of a class of a user
    compiled = ["__init__", *["__repr__"] * repr, *["__eq__"] * eq, *["__hash__"] * (eq and frozen)]
    methods: dict[str, Any] = {name: _Method(made, name, frozen) for name in compiled}
    if eq and not frozen:
        methods["__hash__"] = None
    for name, method in {**methods, **(_OF_FROZEN if frozen else {})}.items():
        if name not in own:
            setattr(made, name, method)
    return made  # type: ignore[no-any-return]


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, slots=False, eq=True, repr=True, kw_only=False):
        """Declare a dataclass as `dataclasses.dataclass` does."""

        def declare(cls: type) -> type:
            if slots:
                return _declared(cls, frozen, eq, repr, kw_only)
            return dataclasses.dataclass(cls, frozen=frozen, eq=eq, repr=repr, kw_only=kw_only)

        return declare if cls is None else declare(cls)
