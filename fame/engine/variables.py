"""Variables of inner scopes: a dict chained to that of the scope outside.

The variables of a process are one plain dict, used as the globals of its scripts. A scope with variables of its own (a
multi-instance activity, a mapping) has a `Variables`: what is known inside or new is written inside, what is known
outside only is written there. Scripts run with it as globals, and CPython then asks the methods here:

====================================  =================================================
compiled to                           asks
====================================  =================================================
LOAD_NAME, LOAD_GLOBAL                `__getitem__`, then `__missing__`
STORE_NAME, DELETE_NAME               `__setitem__`, `__delitem__`
STORE_GLOBAL (`global x` in a         nothing: it writes into the underlying dict, past
function, ``:=`` in a comprehension)  all methods; `settle` puts it right afterwards
LOAD_NAME in the body of a class      the underlying dict alone, before CPython 3.13: outer
                                      variables are out of sight there (not in its methods)
====================================  =================================================

Invariant, whenever no script is at work in it: a name is in the underlying dict if and only if it is the scope's
own. Iteration, `len` and `dict.items` show the own names alone; `in`, `get` and `[]` see through. `plain` shows all.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import ModuleType
from typing import Any

BUILTINS = "__builtins__"


class Undefined(Enum):
    """The type of `UNDEFINED`."""

    UNDEFINED = "UNDEFINED"


UNDEFINED = Undefined.UNDEFINED
"""What a property or payload evaluates to when a name in it is not set: no assignment, no field."""


class Variables(dict[str, Any]):
    """Variables of an inner scope.

    `outer` is the dict outside, itself perhaps a `Variables`; `own` are its first names.
    """

    __slots__ = ("_own", "outer")

    def __init__(self, outer: dict[str, Any], own: Mapping[str, Any] | None = None) -> None:
        super().__init__(own or {})
        self.outer: dict[str, Any] = outer
        if BUILTINS in outer:
            super().__setitem__(BUILTINS, outer[BUILTINS])
        self._own = set(self)

    def __missing__(self, name: str) -> Any:
        return self.outer[name]

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self.outer

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default

    def __setitem__(self, name: str, value: Any) -> None:
        if super().__contains__(name) or name not in self.outer:
            self.define(name, value)
        else:
            self.outer[name] = value

    def __delitem__(self, name: str) -> None:
        if super().__contains__(name):
            super().__delitem__(name)
            self._own.discard(name)
        else:
            del self.outer[name]

    def define(self, name: str, value: Any) -> None:
        """Set the scope's own variable `name`, whatever is outside."""
        super().__setitem__(name, value)
        self._own.add(name)

    def settle(self) -> None:
        """Move what STORE_GLOBAL wrote past `__setitem__` to where it belongs."""
        for name in [name for name in self if name not in self._own]:
            value = super().__getitem__(name)
            super().__delitem__(name)
            self[name] = value


def plain(variables: Mapping[str, Any]) -> dict[str, Any]:
    """All variables that are data, inner ones before outer ones, as a new plain dict.

    Names with two leading underscores, modules, classes and whatever can be called are code, not data: never shown,
    logged or stored.
    """
    shown = plain(variables.outer) if isinstance(variables, Variables) else {}
    shown.update((name, value) for name, value in variables.items() if not name.startswith("__"))
    return {name: value for name, value in shown.items() if not (callable(value) or isinstance(value, ModuleType))}
