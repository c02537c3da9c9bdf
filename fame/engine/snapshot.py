"""The state of an engine as data, and back (docs/semantics.md).

Scopes, waits and mailboxes are identified by their integer keys, nodes by their keys in the program, which is
identified by its hash: a state fits only that program. Functions, classes and modules among the variables are left out.
Waiting scripts start again (`Engine.restart`); scripts that were being cancelled count as ended. Timers belong to the
host, which keeps their due times by the keys of the waits. `fame.engine.state_fields` has the fields.

Invariant: ``snapshot(restore(program, snapshot(engine), ...)) == snapshot(engine)``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from fame.engine.adhoc import NEXT, SWEEP
from fame.engine.compensation import CANCELLED, ROLL_BACK, UNDO
from fame.engine.data import Variables, is_data
from fame.engine.encoding import Convert, Data, decode, encode, no_data
from fame.engine.faults import FAILED
from fame.engine.host import Host
from fame.engine.interpreter import Engine
from fame.engine.program import Node, Program
from fame.engine.repair import AT_INCIDENT
from fame.engine.state import Instance, Mailbox, Scope, Wait, pass_on, scopes_of
from fame.engine.state_fields import (
    ENGINE,
    INSTANCE,
    MAILBOX,
    SCOPE,
    WAIT,
    Reader,
    StateWriter,
    VariableTable,
    reading,
    writing,
)
from fame.engine.steps import ABANDONED, FINISH
from fame.engine.waiting import HAND_ON
from fame.errors import MissionError

OF_NO_PROGRAM: tuple[Node, ...] = (FINISH, ABANDONED, FAILED, UNDO, ROLL_BACK, CANCELLED, NEXT, SWEEP, HAND_ON)
"""Nodes that belong to every engine, not to a program."""

_TABLES = {"instances": INSTANCE, "scopes": SCOPE, "waits": WAIT, "boxes": MAILBOX}
_write = {name: writing(fields) for name, fields in _TABLES.items()}
_read = {name: reading(fields) for name, fields in _TABLES.items()}
_write_engine, _read_engine = writing(ENGINE), reading(ENGINE)


# ---- to data -------------------------------------------------------------------------------------


def snapshot(engine: Engine, *, dump: Convert = no_data, dicts: VariableTable | None = None) -> Data:
    """Return the state of an engine between two stimuli, as data for JSON.

    `dump` makes plain data of other values (messages, arrays). Raises MissionError for values that it cannot. `dicts`
    numbers and writes the dicts of variables, by default anew for each snapshot.
    """
    if engine.ready:
        raise RuntimeError("a snapshot is taken between two stimuli")
    scopes = all_scopes(engine)
    waits = all_waits(scopes)
    boxes = dict.fromkeys(box for scope in scopes for box in (scope.mail or {}).values())
    boxes |= dict.fromkeys(wait.box for wait in waits if wait.box is not None)
    dicts = dicts or _Dicts()
    to = StateWriter(dicts, engine.program.body_keys, dump)
    found = {"instances": engine.instances.values(), "scopes": scopes, "waits": waits, "boxes": boxes}
    tables = {name: [write(item, to) for item in found[name]] for name, write in _write.items()}
    return {**_once(engine, to), **tables, "variables": dicts.written(dump)}


def without_instances(engine: Engine, dump: Convert = no_data) -> Data:
    """Return the part of a snapshot that is there without running instances too."""
    return _once(engine, StateWriter(_Dicts(), {}, dump))


def _once(engine: Engine, to: StateWriter) -> Data:
    """Return the fields of the engine itself."""
    data = _write_engine(engine, to)
    data["program"], data["observed"] = engine.program.hash, engine.program.observed
    return data


class _Dicts:
    """The dicts of variables, by number: scopes share dicts, and inner dicts refer to outer ones."""

    def __init__(self) -> None:
        self.found: list[dict[str, Any]] = []

    def number(self, variables: dict[str, Any]) -> int:
        """Return the number of a dict; its outer dicts are numbered first."""
        if isinstance(variables, Variables):
            self.number(variables.outer)
        for number, known in enumerate(self.found):
            if known is variables:
                return number
        self.found.append(variables)
        return len(self.found) - 1

    def written(self, dump: Convert) -> list[Data]:
        """Return all numbered dicts."""
        return [
            {
                "outer": self.number(item.outer) if isinstance(item, Variables) else None,
                "own": {name: encode(value, dump) for name, value in item.items() if is_data(name, value)},
            }
            for item in self.found
        ]


def all_scopes(engine: Engine) -> list[Scope]:
    """Return every scope, outer before inner."""
    return [scope for instance in engine.instances.values() for scope in scopes_of(instance.root)]


def all_waits(scopes: list[Scope]) -> list[Wait]:
    """Return every wait in some scopes, owners before the waits that are armed for them."""
    found = [child for scope in scopes for child in scope.children if isinstance(child, Wait)]
    found += [arm for scope in scopes for arm in scope.arms]
    for wait in found:  # which grows
        found += wait.arms
    return found


# ---- from data -----------------------------------------------------------------------------------


def restore(
    program: Program,
    data: Data,
    host: Host,
    new_variables: Callable[[], dict[str, Any]] = dict,
    *,
    load: Convert = no_data,
) -> Engine:
    """Return the engine of a snapshot. No token moves, and the host is not called, until `Engine.restart`.

    The engine never changes `data`: any number of engines can be restored from it.

    `load` is the inverse of `dump`. Raises MissionError for the state of another program.
    """
    if (data["program"], data["observed"]) != (program.hash, program.observed):
        raise MissionError(f"the state is one of program {data['program']}, not of {program.hash}")
    nodes = {**program.by_key, **{node.key: node for node in OF_NO_PROGRAM}}
    of = Reader(Engine(program, host, new_variables), nodes, _dicts(data, new_variables, load), load, {}, {})
    _objects(data, of)
    _derived(data, of)
    return of.engine


def _dicts(data: Data, new_variables: Callable[[], dict[str, Any]], load: Convert) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for item in data["variables"]:
        own = {name: decode(value, load) for name, value in item["own"].items()}
        outer = item["outer"]
        found.append({**new_variables(), **own} if outer is None else Variables(found[outer], own))
    return found


def _objects(data: Data, of: Reader) -> None:
    """Make all objects by key, then set their fields, which refer to them."""
    objects, nodes = of.objects, of.nodes
    for item in data["instances"]:
        of.instances[item["key"]] = Instance(item["key"], of.engine.program, {})
    for item in data["scopes"]:
        objects[item["key"]] = Scope(item["key"], None, None, None, {})
    for item in data["waits"]:
        objects[item["key"]] = Wait(item["key"], nodes[item["node"]], objects[item["scope"]], item["token"])
    for item in data["boxes"]:
        objects[item["key"]] = Mailbox(item["key"], nodes[item["node"]], objects[item["scope"]])
    for name, read in _read.items():
        table = of.instances if name == "instances" else objects
        for item in data[name]:
            read(table[item["key"]], item if name != "boxes" else {"passed": False, **item}, of)
    _read_engine(of.engine, {"untaken": {}, **data}, of)


def _derived(data: Data, of: Reader) -> None:
    """Set what follows from the fields."""
    engine = of.engine
    engine.instances, engine.restored = of.instances, engine.counter
    for item in data["scopes"]:
        scope = of.objects[item["key"]]
        scope.counts = scope.instance.counts
        scope.instance.scopes += 1
        pass_on(scope)
    for item in data["boxes"]:
        box = of.objects[item["key"]]
        box.messages = deque(box.messages, box.catch.queue)
        for key in item.get("waits", ()):  # written by an older version: these were not among the listeners
            engine.listeners.setdefault(of.objects[key].catch.topic, {})[of.objects[key]] = None
    for wait in engine.incidents:
        wait.catch = AT_INCIDENT
    for node, kept in engine.waiting_starts.items():
        assert node.catch is not None
        engine.waiting_starts[node] = deque(kept, node.catch.queue)
