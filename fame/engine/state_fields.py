"""The fields of an engine's state: tables, from which snapshots are written and read.

A field has a kind, which says how its value becomes data for JSON and comes back; None stays None. `migration` and, for
explorations, `canonical` and `revival` have code of their own for each field. tests/conformance/test_state_fields.py
fails for a field that one of them misses, and for an attribute that is in no table.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from operator import attrgetter
from typing import Any, Protocol

from fame.dataclasses import dataclass, replace
from fame.engine.encoding import Convert, Data, decode, encode
from fame.engine.interpreter import Engine
from fame.engine.program import Body, Node
from fame.engine.state import Continuation, Instance, Record
from fame.errors import MissionError


class VariableTable(Protocol):
    """The dicts of variables in a snapshot."""

    def number(self, variables: dict[str, Any]) -> int:
        """Return the number of a dict, greater than those of its outer dicts."""

    def written(self, dump: Convert) -> list[Data]:
        """Return all dicts, as `restore` reads them (a table of the host can have another form)."""


@dataclass(slots=True)
class StateWriter:
    """What fields need to become data: numbers of dicts of variables, keys of bodies, data of other values.

    `lost` makes data in place of a value that cannot become data; without it, MissionError is raised.
    """

    dicts: VariableTable
    bodies: Mapping[Body, str]
    dump: Convert
    lost: Callable[[MissionError], Data] | None = None

    def data(self, value: Any, levels: int = 2) -> Any:
        """Return the data of a value, of outer `levels` of fields and lists as much as can be. Raises MissionError."""
        try:
            return encode(value, self.dump)
        except MissionError as error:
            if self.lost is None:
                raise
            if levels and type(value) is list:
                return [self.data(item, levels - 1) for item in value]
            if levels and type(value) is dict:
                fields = [[name, self.data(item, levels - 1)] for name, item in value.items()]
                return {"$dict": fields}
            return self.lost(error)


@dataclass(slots=True)
class Reader:
    """What fields need to come back: nodes, dicts of variables by number, and objects by key."""

    engine: Engine
    nodes: Mapping[str, Node]
    dicts: list[dict[str, Any]]
    load: Convert
    instances: dict[int, Instance]
    objects: dict[int, Any]


@dataclass(frozen=True, slots=True)
class FieldCodec:
    """How a value becomes data, and comes back.

    empty    makes the data of an empty container; None: `write` makes it
    single   whether it is one reference, whose data is a key
    ordered  whether the order of a list is part of the state (in `Scope.children`, only among those at one node)
    """

    write: Callable[[Any, StateWriter], Any]
    read: Callable[[Any, Reader], Any]
    empty: Callable[[], Any] | None = None
    single: bool = False
    ordered: bool = True


def many(kind: FieldCodec, container: Callable[[Iterable[Any]], Any]) -> FieldCodec:
    """Return the codec of a container of values of a kind."""
    write, read = kind.write, kind.read

    def write_all(items: Any, to: StateWriter) -> Any:
        return [item.key for item in items] if kind.single else [write(item, to) for item in items]

    return FieldCodec(write_all, lambda data, of: container([read(item, of) for item in data]), list)


def mapping(keys: FieldCodec, values: FieldCodec) -> FieldCodec:
    """Return the codec of a dict whose keys and values have these kinds."""
    return FieldCodec(
        lambda found, to: {keys.write(key, to): values.write(value, to) for key, value in found.items()},
        lambda data, of: {keys.read(key, of): values.read(value, of) for key, value in data.items()},
        dict,
    )


def parts(*kinds: FieldCodec) -> FieldCodec:
    """Return the codec of a tuple whose parts have these kinds."""
    return FieldCodec(
        lambda found, to: [kind.write(part, to) for kind, part in zip(kinds, found, strict=True)],
        lambda data, of: tuple([kind.read(part, of) for kind, part in zip(kinds, data, strict=True)]),
    )


def _write_error(error: MissionError, to: StateWriter) -> Data:
    return {name: getattr(error, name) for name in ("text", "element", "file", "line", "code")}


def _read_error(data: Data, of: Reader) -> MissionError:
    return MissionError(data["text"], **{name: value for name, value in data.items() if name != "text"})


def _write_held(held: tuple[list[Any], list[Any]], to: StateWriter) -> Any:
    return [[item.key for item in items if item.alive] for items in held]


def _write_continuations(continuations: Mapping[int, Continuation], to: StateWriter) -> Any:
    return [{"node": item.node.key, "scope": item.scope.key} for item in dict.fromkeys(continuations.values())]


def _read_continuations(data: list[Any], of: Reader) -> dict[int, Any]:
    """Scripts that were being cancelled count as ended: their tokens go on with `Engine.continue_restored`."""
    return {-n: Continuation(0, of.nodes[one["node"]], of.objects[one["scope"]]) for n, one in enumerate(data, 1)}


VALUE = FieldCodec(lambda value, to: value, lambda data, of: data)
COUNTS = FieldCodec(lambda counts, to: counts.copy(), lambda data, of: list(data))
NUMBER = FieldCodec(lambda number, to: str(number), lambda data, of: int(data))
DATA = FieldCodec(lambda value, to: to.data(value), lambda data, of: decode(data, of.load))
ERROR = FieldCodec(_write_error, _read_error)
VARIABLES = FieldCodec(lambda variables, to: to.dicts.number(variables), lambda number, of: of.dicts[number])
NODE = FieldCodec(lambda node, to: node.key, lambda key, of: of.nodes.get(key), single=True)
BODY = FieldCodec(
    lambda body, to: to.bodies[body], lambda key, of: of.nodes[key].body if key else of.engine.program.body
)
OBJECT = FieldCodec(lambda item, to: item.key, lambda key, of: of.objects.get(key), single=True)
"""A scope, wait or mailbox."""
INSTANCE_OF = FieldCodec(lambda instance, to: instance.key, lambda key, of: of.instances[key], single=True)
NODES = many(NODE, tuple)
OBJECTS = many(OBJECT, tuple)
SET = many(OBJECT, dict.fromkeys)
MESSAGES = many(parts(VALUE, DATA), deque)
RECORDS = many(FieldCodec(lambda record, to: _record.write(_parts(record), to),
                   lambda data, of: Record(*_record.read(data, of))), list)  # fmt: skip
MAIL = FieldCodec(lambda mail, to: [box.key for box in mail.values()],
            lambda keys, of: {of.objects[key].node: of.objects[key] for key in keys}, list)  # fmt: skip
BY_KEY = FieldCodec(lambda waits, to: list(waits), lambda keys, of: {key: of.objects[key] for key in keys}, list,
              ordered=False)  # fmt: skip
INCIDENTS = FieldCodec(lambda found, to: [[wait.key, *why] for wait, why in found.items()],
                 lambda data, of: {of.objects[key]: tuple(why) for key, *why in data}, list)  # fmt: skip
HELD = FieldCodec(_write_held, parts(many(OBJECT, list), many(OBJECT, list)).read)
CONTINUATIONS = FieldCodec(_write_continuations, _read_continuations, list)
_PAIRS = many(parts(NODE, DATA), dict)
COUNTER = FieldCodec(lambda found, to: dict(found), lambda data, of: Counter(data), dict)
GATHERED = many(parts(DATA, FieldCodec(lambda found, to: _PAIRS.write(found.items(), to), _PAIRS.read)), list)


FieldTable = dict[str, FieldCodec]
"""The kind of each field of a class."""

SCOPE: FieldTable = {
    "key": VALUE, "instance": INSTANCE_OF, "parent": OBJECT, "node": NODE, "body": BODY, "variables": VARIABLES,
    "tokens": VALUE, "state": VALUE, "depth": VALUE, "children": SET, "arms": OBJECTS, "joins": mapping(NODE, COUNTS),
    "mail": MAIL, "handles": NODES, "suspender": OBJECT, "mark": VALUE, "held": NODES, "items": DATA, "done": RECORDS,
}  # fmt: skip
WAIT: FieldTable = {
    "key": VALUE, "node": NODE, "scope": OBJECT, "owner": OBJECT, "token": VALUE, "true": VALUE, "started": VALUE,
    "paused": VALUE, "due": VALUE, "arms": OBJECTS, "box": OBJECT,
}  # fmt: skip
MAILBOX: FieldTable = {"key": VALUE, "node": NODE, "scope": OBJECT, "messages": MESSAGES, "passed": VALUE}
INSTANCE: FieldTable = {
    "key": VALUE, "root": OBJECT, "counts": COUNTS, "root_variables": VARIABLES, "error": ERROR,
}  # fmt: skip
RECORD: FieldTable = {"node": NODE, "variables": VARIABLES, "inner": RECORDS}
ENGINE: FieldTable = {
    "counter": VALUE, "conditions": SET, "waits": BY_KEY, "inclusive": replace(SET, ordered=False), "untaken": COUNTER,
    "incidents": INCIDENTS, "held": HELD, "cancelling": CONTINUATIONS, "armed_starts": mapping(NUMBER, NODE),
    "waiting_starts": mapping(NODE, MESSAGES), "gathered": mapping(NODE, GATHERED), "listeners": mapping(VALUE, SET),
}  # fmt: skip
STORED = {
    "root_variables": "variables", "waits": "named", "cancelling": "continuations", "armed_starts": "starts",
}  # fmt: skip
"""Names in a snapshot of fields that have another name there."""

_record: FieldCodec = parts(*RECORD.values())
_parts: Callable[[Record], tuple[Any, ...]] = attrgetter(*RECORD)


def writing(table: FieldTable) -> Callable[[Any, StateWriter], Data]:
    """Return the function that gives the data of an object with these fields."""
    values, names = attrgetter(*table), [STORED.get(field, field) for field in table]
    kinds = [(name, kind) for name, kind in zip(names, table.values(), strict=True) if kind is not VALUE]
    references = [name for name, kind in kinds if kind.single]
    others = [(name, kind.write, kind.empty) for name, kind in kinds if not kind.single]

    def write(item: Any, to: StateWriter) -> Data:
        data = dict(zip(names, values(item)))  # noqa: B905  # fast: called for each token after each stimulus
        for name in references:
            if (holder := data[name]) is not None:
                data[name] = holder.key
        for name, convert, empty in others:
            value = data[name]
            if value or (value is not None and empty is None):
                data[name] = convert(value, to)
            elif empty is not None and value is not None:
                data[name] = empty()
        return data

    return write


def reading(table: FieldTable) -> Callable[[Any, Data, Reader], None]:
    """Return the function that sets these fields of an object from its data."""
    kinds = [(field, STORED.get(field, field), kind.read) for field, kind in table.items()]

    def read(item: Any, data: Data, of: Reader) -> None:
        for field, name, convert in kinds:
            written = data[name]
            setattr(item, field, None if written is None else convert(written, of))

    return read
