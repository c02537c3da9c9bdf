"""The state of an engine as data, and back (docs/semantics.md).

Scopes, waits and mailboxes are identified by their integer keys, nodes by their keys in the program, which is
identified by the hash of its models: a state fits only those. Where another version of the compiler has made the
program, nodes are found by their elements (`NodeFinder`). Functions, classes and modules among the variables are left
out. Waiting scripts start again (`Engine.restart`); scripts that were being cancelled count as ended. Timers belong to
the host, which keeps their due times by the keys of the waits. `fame.engine.state_fields` has the fields.

Invariant: ``snapshot(restore(program, snapshot(engine), ...)) == snapshot(engine)``.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from fame.engine.adhoc import NEXT, SWEEP
from fame.engine.compensation import CANCELLED, ROLL_BACK, UNDO
from fame.engine.data import Variables, is_data
from fame.engine.encoding import Convert, Data, decode, encode, no_data, only_plain
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


def snapshot(
    engine: Engine,
    *,
    dump: Convert = only_plain,
    dicts: VariableTable | None = None,
    lost: Callable[[MissionError], Data] | None = None,
) -> Data:
    """Return the state of an engine between two stimuli, as data for JSON.

    `dump` makes plain data of other values (messages, arrays). Raises MissionError for values that it cannot, unless
    `lost` makes data of the error, for those that are in no variable. `dicts` numbers and writes the dicts of
    variables, by default anew for each snapshot.
    """
    if engine.ready:
        raise RuntimeError("a snapshot is taken between two stimuli")
    scopes = all_scopes(engine)
    waits = all_waits(scopes)
    boxes = dict.fromkeys(box for scope in scopes for box in (scope.mail or {}).values())
    boxes |= dict.fromkeys(wait.box for wait in waits if wait.box is not None)
    dicts = dicts or _Dicts()
    to = StateWriter(dicts, engine.program.body_keys, dump, lost)
    objects = {"instances": engine.instances.values(), "scopes": scopes, "waits": waits, "boxes": boxes}
    tables = {name: [write(item, to) for item in objects[name]] for name, write in _write.items()}
    return {**_once(engine, to), **tables, "variables": dicts.written(dump)}


def without_instances(
    engine: Engine, dump: Convert = only_plain, lost: Callable[[MissionError], Data] | None = None
) -> Data:
    """Return the part of a snapshot that is there without running instances too."""
    return _once(engine, StateWriter(_Dicts(), {}, dump, lost))


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
    waits = [child for scope in scopes for child in scope.children if isinstance(child, Wait)]
    waits += [arm for scope in scopes for arm in scope.arms]
    for wait in waits:  # which grows
        waits += wait.arms
    return waits


# ---- from data -----------------------------------------------------------------------------------


def restore(
    program: Program,
    data: Data,
    host: Host,
    new_variables: Callable[[], dict[str, Any]] = dict,
    *,
    load: Convert = no_data,
    moved: dict[str, str] | None = None,
) -> Engine:
    """Return the engine of a snapshot. No token moves, and the host is not called, until `Engine.restart`.

    The engine never changes `data`: any number of engines can be restored from it.

    `load` is the inverse of `dump`. `moved` gets the keys of nodes that are others now, with those. Raises MissionError
    for the state of another model, and for what has no place in this program.
    """
    if data["observed"] != program.observed:
        raise MissionError(f"the state is one {'with' if data['observed'] else 'without'} an observer")
    if data["program"] != program.hash:
        raise MissionError(
            f"the state is one of another model: its texts, or those that it calls, have hash {data['program'][:12]}, "
            f"expected {program.hash[:12]}; bring them back, or start over"
        )
    nodes = NodeFinder(program, {} if moved is None else moved)
    nodes.expect_places(data)
    of = Reader(Engine(program, host, new_variables), nodes, _dicts(data, new_variables, load), load, {}, {})
    _objects(data, of)
    _derived(data, of)
    return of.engine


class NodeFinder(dict[str, Node]):
    """The nodes of a program by key. For a key that it does not have: the only node of the same element.

    What one version of the compiler makes of an element, another may make otherwise.
    """

    def __init__(self, program: Program, moved: dict[str, str]) -> None:
        super().__init__(program.by_key)
        self.update((node.key, node) for node in OF_NO_PROGRAM)
        self._nodes, self._moved = program.nodes, moved

    def expect_places(self, data: Data) -> None:
        """Find the places of all scopes, waits and mailboxes. Raises MissionError with all that have none."""
        incidents = {item[0] for item in data["incidents"]}
        kinds: dict[str, Callable[[Node], object]] = {
            "scopes": lambda node: hasattr(node, "ended"),
            "waits": lambda node: node.catch,
            "boxes": lambda node: node.catch,
        }
        lost = dict[str, None]()
        for name, fits in kinds.items():
            for key in {item["node"]: None for item in data[name] if item["key"] not in incidents}:
                if key is not None and not fits(self.get(key) or self._find(key, fits) or FINISH):
                    lost[element_of(key)] = None
        if lost:
            raise self._misses(lost)

    def __missing__(self, key: str) -> Node:
        by_id = self._find(key, lambda node: True)
        if by_id is None:
            raise self._misses([element_of(key)])
        return by_id

    def _find(self, key: str, fits: Callable[[Node], object]) -> Node | None:
        """Return the only node of an element that fits, and note it."""
        nodes = [node for node in self._nodes if node.id == element_of(key) and fits(node)]
        if len(nodes) != 1:
            return None
        self[key], self._moved[key] = nodes[0], nodes[0].key
        return nodes[0]

    def _misses(self, elements: Iterable[str]) -> MissionError:
        return MissionError(
            f"this FAME makes something else of {', '.join(elements)}, where the state has a token, an event or a "
            "message; end that with the FAME that wrote the state, or start over"
        )


def element_of(key: str) -> str:
    """Return the id of the element of a node, which its key begins with."""
    return re.split("[/@#]", str(key), maxsplit=1)[0]


def _dicts(data: Data, new_variables: Callable[[], dict[str, Any]], load: Convert) -> list[dict[str, Any]]:
    dicts: list[dict[str, Any]] = []
    for item in data["variables"]:
        own = {name: decode(value, load) for name, value in item["own"].items()}
        outer = item["outer"]
        dicts.append({**new_variables(), **own} if outer is None else Variables(dicts[outer], own))
    return dicts


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
        engine.waiting_starts[node] = deque(kept, node.catch.kept)
