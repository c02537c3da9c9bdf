"""Variables of scopes, and how a caught message sets them.

The variables of a process are one plain dict, used as the globals of its scripts; those of an inner scope are a dict
chained to it (`Variables`).

A caught message is stored by the event's explicit mapping if there is one; else by the data objects at its output
association; else in one variable named like the topic, as the bare value if the message is a wrapper (one field
``data``). In that last case, in a model of the original FaMe, variables that a data object declares and nothing else
sets also take the fields whose names their own begin with.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from enum import Enum
from functools import cache
from numbers import Real
from operator import attrgetter
from types import ModuleType
from typing import Any

from fame.bpmn.model import DataObject, Process, Topic
from fame.engine.program import Compiled
from fame.text import as_number

BUILTINS = "__builtins__"


class UndefinedType(Enum):
    """The type of `UNDEFINED`."""

    UNDEFINED = "UNDEFINED"


UNDEFINED = UndefinedType.UNDEFINED
"""The value of a property or payload if a name in it is not set: nothing is assigned, the field is left out."""


class Temporal(str):
    """A date, a time, both, or a duration of FEEL."""

    __slots__ = ()


class Variables(dict[str, Any]):
    """Variables of a scope with variables of its own (a multi-instance activity, a mapping).

    `outer` is the dict of the scope outside, possibly a `Variables` too; `own` are its initial variables. A name that
    is known only outside is written there; every other name is written inside, or outside if it `passes_on` new names
    (a pass of a standard loop). Scripts run with this dict as globals, for which CPython calls these methods:

    ====================================  =================================================
    compiled to                           calls
    ====================================  =================================================
    LOAD_NAME, LOAD_GLOBAL                `__getitem__`, then `__missing__`
    STORE_NAME, DELETE_NAME               `__setitem__`, `__delitem__`
    STORE_GLOBAL (`global x` in a         nothing: it writes into the underlying dict, past
    function, ``:=`` in a comprehension)  all methods; `settle` corrects that afterwards
    LOAD_NAME in the body of a class      only the underlying dict, before CPython 3.13: outer
                                          variables are not visible there (but in its methods)
    ====================================  =================================================

    Invariant while no script runs in it: a name is in the underlying dict if and only if it is the scope's own.
    Iteration, `len` and `dict.items` show only its own names; `in`, `get` and `[]` also find outer names. `plain` shows
    all.
    """

    __slots__ = ("_own", "outer", "passes_on")

    def __init__(self, outer: dict[str, Any], own: Mapping[str, Any] | None = None) -> None:
        super().__init__(own or {})
        self.passes_on: bool = False
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
        if super().__contains__(name) or (name not in self.outer and not self.passes_on):
            self.define(name, value)
        else:
            self.outer[name] = value

    def __delitem__(self, name: str) -> None:
        if super().__contains__(name):
            super().__delitem__(name)
            self._own.discard(name)
        else:
            del self.outer[name]

    def update(self, values: Mapping[str, Any], /) -> None:  # type: ignore[override]
        """Set several variables, where each belongs; that of `dict` writes past `__setitem__`."""
        for name, value in values.items():
            self[name] = value

    def define(self, name: str, value: Any) -> None:
        """Set the scope's own variable `name`, also if an outer scope has one."""
        super().__setitem__(name, value)
        self._own.add(name)

    def settle(self) -> None:
        """Move what STORE_GLOBAL wrote past `__setitem__` to where it belongs."""
        for name in [name for name in self if name not in self._own]:
            value = super().__getitem__(name)
            super().__delitem__(name)
            self[name] = value


def chained(outer: dict[str, Any], own: dict[str, Any]) -> Variables:
    """Return the variables of a scope inside another one. Their class is the attribute ``inner`` of `outer`, if any."""
    kind: type[Variables] = getattr(outer, "inner", Variables)
    return kind(outer, own)


def plain(variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return all variables that are data, as a new plain dict; an inner one hides an outer one of its name."""
    shown = plain(variables.outer) if isinstance(variables, Variables) else {}
    shown.update(variables.items())
    return {name: value for name, value in shown.items() if is_data(name, value)}


def is_data(name: str, value: Any) -> bool:
    """Return whether a variable is data, and not code, which is never shown, logged or stored.

    Code are names with two leading underscores, modules, classes and callables.
    """
    return not (name.startswith("__") or callable(value) or isinstance(value, ModuleType))


def own_copy(value: Any) -> Any:
    """Return a value that does not change when somebody else, who has it too, changes it in place."""
    return deepcopy(value) if isinstance(value, list | tuple | dict | set) else value


Take = Callable[[dict[str, Any], Any], None]
Correlate = Callable[[Sequence[str], str, Any], dict[str, tuple[str, ...]]]


def is_variable(name: str) -> bool:
    return name.isidentifier() and not name.startswith("__")


def variable_name(topic: str) -> str:
    """Return the variable that a topic's message sets: its name as a Python name.

    >>> variable_name("~/odom"), variable_name("/arm/joint states")
    ('odom', 'arm_joint_states')
    """
    return re.sub(r"\W", "_", topic.removeprefix("~/").strip("/"))


def receiver(
    topic: Topic,
    objects: Sequence[DataObject],
    assignments: Sequence[tuple[str, Callable[[dict[str, Any]], Any]]],
    loose: Sequence[str] = (),
) -> Take:
    """Return the function (variables, message) that stores a message caught by one event.

    `assignments` is its compiled mapping; `loose` are variables of the process that nothing else sets (`unfilled`).
    """
    if assignments:
        return _mapped(assignments)
    names = tuple(name for item in objects for name in item.names)
    if names:
        return _matched(names, variable_name(topic.name), match)
    whole = _whole(variable_name(topic.name))
    return _both(_matched(tuple(loose), "", match_prefix), whole) if loose else whole


def unfilled(process: Process) -> tuple[str, ...]:
    """Return the variables of a process that a caught message can set by their names (``by_prefix``).

    They are those that data objects declare without a value and that no association of an element sets.
    """
    if not process.by_prefix:
        return ()
    objects = [item for body in process.body.bodies() for item in body.data_objects if item.kind == "object"]
    filled = {id for node in process.body.walk() for id in node.data_outputs}
    names = {name for item in objects if item.id in filled for name in item.names}
    pairs = [pair for item in objects for pair in item.values if pair[0] not in names]
    return tuple(dict.fromkeys(name for name, value in pairs if value.text in ("", f"${{{name}}}")))


def _mapped(assignments: Sequence[tuple[str, Callable[[dict[str, Any]], Any]]]) -> Take:
    def take(variables: dict[str, Any], message: Any) -> None:
        inner = Variables(variables, {"msg": message})
        for name, source in assignments:
            value = source(inner)
            if value is not UNDEFINED:
                variables[name] = value

    return take


def seeing_fields(source: Compiled) -> Compiled:
    """Return an expression in which the fields of the message are names, as in FEEL."""

    def evaluate(variables: dict[str, Any]) -> Any:
        message = variables["msg"]
        return source(Variables(variables, {str(name): _descend(message, (name,)) for name in field_names(message)}))

    return evaluate


def with_inputs(inputs: Sequence[tuple[str, Compiled]], source: Compiled, *, in_order: bool = False) -> Compiled:
    """Return an expression in which inputs are names as well; `in_order`: in each input, too, those before it."""

    def evaluate(variables: dict[str, Any]) -> Any:
        inner = Variables(variables)
        for name, value in inputs:
            if (item := value(inner if in_order else variables)) is not UNDEFINED:
                inner.define(name, item)
        return source(inner)

    return evaluate


def _whole(name: str) -> Take:
    def take(variables: dict[str, Any], message: Any) -> None:
        variables[name] = message.data if is_wrapper(message.__class__) else message

    return take


def _both(first: Take, second: Take) -> Take:
    def take(variables: dict[str, Any], message: Any) -> None:
        first(variables, message)
        second(variables, message)

    return take


def _matched(names: tuple[str, ...], topic: str, match: Correlate) -> Take:
    getters: dict[type, list[tuple[str, Callable[[Any], Any]]]] = {}

    def take(variables: dict[str, Any], message: Any) -> None:
        if isinstance(message, Mapping):  # from outside, on a topic without a type: no class to cache by
            for name, path in match(names, topic, message).items():
                variables[name] = _descend(message, path)
            return
        kind = message.__class__
        if kind not in getters:
            paths = match(names, topic, message)
            getters[kind] = [(name, attrgetter(".".join(path))) for name, path in paths.items()]
        for name, get in getters[kind]:
            variables[name] = get(message)

    return take


def match(names: Sequence[str], topic: str, message: Any) -> dict[str, tuple[str, ...]]:
    """Return the field (as a path) of the message for each of a data object's variables.

    A field, also one that is a message, goes to the variable of its own name, else to the first that is named
    ``<field>_...``. Of a nested field only the last name matters. The value of a wrapper goes to the variable named
    like the topic, or to the only variable.
    """
    if is_wrapper(message.__class__):
        fitting = [name for name in names if name in (topic, "data") or name.startswith("data_")]
        chosen = fitting or (names if len(names) == 1 else ())
        return dict.fromkeys(chosen[:1], ("data",))
    paths: dict[str, tuple[str, ...]] = {}
    for path in _fields(message, names):
        field = path[-1]
        free = [name for name in names if name not in paths]
        named = next((name for name in free if name == field), None)
        named = named or next((name for name in free if name.startswith(f"{field}_")), None)
        if named is not None:
            paths[named] = path
    return paths


def match_prefix(names: Sequence[str], topic: str, message: Any) -> dict[str, tuple[str, ...]]:
    """Return the top-level field, as a path, for each variable whose name begins with that of the field."""
    paths: dict[str, tuple[str, ...]] = {}
    for field in field_names(message):
        free = [name for name in names if name not in paths and name.startswith(field)]
        named = min(free, key=lambda name: (name != field, not name.startswith(f"{field}_")), default=None)
        if named is not None:
            paths[named] = (field,)
    return paths


def field_names(value: Any) -> Iterable[str]:
    """Return the keys of a mapping, or the fields of a message by their names in its `.msg` file."""
    if isinstance(value, Mapping):
        return value
    return getattr(value, "__field_names__", ()) or getattr(value, "__dataclass_fields__", ())


@cache
def is_wrapper(kind: type) -> bool:
    """Return whether messages of that class have one field ``data`` (std_msgs/msg/Bool and its like)."""
    return tuple(getattr(kind, "__dataclass_fields__", ())) == ("data",)


def _fields(message: Any, names: Sequence[str], path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the paths of the fields that a variable can take: innermost ones, and messages that one is named like."""
    for name in field_names(message):
        value = message[name] if isinstance(message, Mapping) else getattr(message, name)
        if name not in names and (isinstance(value, Mapping) or hasattr(value, "__dataclass_fields__")):
            yield from _fields(value, names, (*path, name))
        else:
            yield (*path, name)


def _descend(message: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        message = message[name] if isinstance(message, Mapping) else getattr(message, name)
    return message


def correlation(
    keys: Sequence[tuple[str, Compiled]], variables: dict[str, Any], message: Any
) -> list[tuple[str, Any]] | None:
    """Return the keys of a message that correlates with an event by these variables, else None (standard 8.3.2).

    A key that has a value must equal that of the message; a number equals the text that a typed message makes of it.
    """
    inner = Variables(variables, {"msg": message})
    try:
        values = [(name, source(inner)) for name, source in keys]
    except Exception:  # a message that lacks the key is for another receiver
        return None
    return values if all(_equals(_held(variables, name), value) for name, value in values) else None


def _equals(held: Any, value: Any) -> bool:
    if held in (UNDEFINED, value):
        return True
    number, text = (value, held) if isinstance(held, str) else (held, value)
    if isinstance(number, bool):
        return bool(text == str(number).lower())
    return isinstance(number, Real) and isinstance(text, str) and as_number(text) == number


def correlates(keys: Sequence[tuple[str, Compiled]], variables: dict[str, Any], message: Any) -> bool:
    """Return whether a message correlates with a catching event that takes it: the first sets keys without a value."""
    if not keys:
        return True
    values = correlation(keys, variables, message)
    if values is None:
        return False
    for name, value in values:
        if name not in variables and "." not in name:
            variables[name] = value
    return True


def _held(variables: Mapping[str, Any], key: str) -> Any:
    """Return the value of a correlation key in the process: a variable, or a field of one (``order.id``)."""
    value: Any = variables
    for name in (key,) if key in variables else key.split("."):
        holds = name in value if isinstance(value, Mapping) else hasattr(value, name)
        if not holds:
            return UNDEFINED
        value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    return value
