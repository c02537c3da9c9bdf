"""The state of an engine as data, and back (docs/semantics.md).

Scopes, waits and mailboxes are identified by their integer keys, nodes by their keys in the program, which is
identified by its hash: a state fits only that program. Functions, classes and modules among the variables are left out.
Waiting scripts start again (`Engine.restart`); scripts that were being cancelled count as ended. Timers belong to the
host, which keeps their due times by the keys of the waits.

Invariant: ``snapshot(restore(program, snapshot(engine), ...)) == snapshot(engine)``.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, Protocol

from fame.engine.adhoc import NEXT, SWEEP
from fame.engine.compensation import CANCELLED, ROLL_BACK, UNDO
from fame.engine.data import Variables
from fame.engine.faults import FAILED
from fame.engine.host import Host
from fame.engine.interpreter import Engine
from fame.engine.program import Body, Node, Program
from fame.engine.repair import AT_INCIDENT
from fame.engine.state import Continuation, Gathered, Instance, Mailbox, Record, Scope, Wait, scopes_of
from fame.engine.steps import ABANDONED, FINISH
from fame.engine.waiting import HAND_ON
from fame.errors import MissionError

Data = dict[str, Any]
Convert = Callable[[Any], Any]
OF_NO_PROGRAM: tuple[Node, ...] = (FINISH, ABANDONED, FAILED, UNDO, ROLL_BACK, CANCELLED, NEXT, SWEEP, HAND_ON)
"""Nodes that belong to every engine, not to a program."""
_ERROR = ("text", "element", "file", "line", "code")


def no_data(value: Any) -> Any:
    """Reject values that cannot be serialised. Raises MissionError."""
    raise MissionError(f"a {type(value).__name__} cannot be kept in a snapshot: it is not plain data")


# ---- to data -------------------------------------------------------------------------------------


def snapshot(engine: Engine, *, dump: Convert = no_data, dicts: VariableTable | None = None) -> Data:
    """The state of an engine between two stimuli, as data for JSON.

    `dump` makes plain data of other values (messages, arrays). Raises MissionError for values that it cannot. `dicts`
    numbers and writes the dicts of variables, by default anew for each snapshot.
    """
    if engine.ready:
        raise RuntimeError("a snapshot is taken between two stimuli")
    scopes = all_scopes(engine)
    waits = all_waits(scopes)
    boxes = {box.key: box for scope in scopes for box in (scope.mail or {}).values()}
    boxes |= {wait.box.key: wait.box for wait in waits if wait.box is not None}
    dicts = dicts or _Dicts()
    homes = engine.program.body_keys
    return {
        **without_instances(engine, dump),
        "instances": [_instance(instance, dicts) for instance in engine.instances.values()],
        "scopes": [_scope(scope, dicts, homes, dump) for scope in scopes],
        "waits": [_wait(wait) for wait in waits],
        "boxes": [_box(box, dump) for box in boxes.values()],
        "listeners": {topic: [item.key for item in found] for topic, found in engine.listeners.items()},
        "variables": dicts.written(dump),
    }


def without_instances(engine: Engine, dump: Convert = no_data) -> Data:
    """The part of a snapshot that is there without running instances too."""
    return {
        "program": engine.program.hash,
        "observed": engine.program.observed,
        "counter": engine.counter,
        "conditions": [wait.key for wait in engine.conditions],
        "named": list(engine.waits),
        "inclusive": [scope.key for scope in engine.inclusive],
        "untaken": dict(engine.untaken),
        "incidents": [[wait.key, *found] for wait, found in engine.incidents.items()],
        "held": None if engine.held is None else _keys_alive(*engine.held),
        "continuations": [_continuation(item) for item in dict.fromkeys(engine.cancelling.values())],
        "starts": {str(key): node.key for key, node in engine.armed_starts.items()},
        "waiting_starts": {
            node.key: [[number, encode(message, dump)] for number, message in kept]
            for node, kept in engine.waiting_starts.items()
        },
        "gathered": {
            node.key: [[encode(keys, dump), _messages(found, dump)] for keys, found in sets]
            for node, sets in engine.gathered.items()
        },
    }


def _keys_alive(scopes: list[Scope], waits: list[Wait]) -> list[list[int]]:
    return [[scope.key for scope in scopes if scope.alive], [wait.key for wait in waits if wait.alive]]


def _messages(found: Mapping[Node, Any], dump: Convert) -> list[Any]:
    return [[part.key, encode(message, dump)] for part, message in found.items()]


class VariableTable(Protocol):
    """The dicts of variables in a snapshot."""

    def number(self, variables: dict[str, Any]) -> int:
        """The number of a dict, greater than those of its outer dicts."""

    def written(self, dump: Convert) -> list[Data]:
        """All dicts, as `restore` reads them (a table of the host can have another form)."""


class _Dicts:
    """The dicts of variables, by number: scopes share dicts, and inner dicts refer to outer ones."""

    def __init__(self) -> None:
        self.found: list[dict[str, Any]] = []

    def number(self, variables: dict[str, Any]) -> int:
        """The number of a dict; its outer dicts are numbered first."""
        if isinstance(variables, Variables):
            self.number(variables.outer)
        for number, known in enumerate(self.found):
            if known is variables:
                return number
        self.found.append(variables)
        return len(self.found) - 1

    def written(self, dump: Convert) -> list[Data]:
        """All numbered dicts."""
        return [
            {
                "outer": self.number(item.outer) if isinstance(item, Variables) else None,
                "own": {name: encode(value, dump) for name, value in item.items() if is_data(name, value)},
            }
            for item in self.found
        ]


def is_data(name: str, value: Any) -> bool:
    """Whether a variable is data, by the rule of `fame.engine.data.plain`."""
    return not (name.startswith("__") or callable(value) or isinstance(value, ModuleType))


def all_scopes(engine: Engine) -> list[Scope]:
    """Every scope, outer before inner."""
    return [scope for instance in engine.instances.values() for scope in scopes_of(instance.root)]


def all_waits(scopes: list[Scope]) -> list[Wait]:
    """Every wait in some scopes, owners before the waits that are armed for them."""
    found = [child for scope in scopes for child in scope.children if isinstance(child, Wait)]
    found += [arm for scope in scopes for arm in scope.arms]
    for wait in found:  # which grows
        found += wait.arms
    return found


def _instance(instance: Instance, dicts: VariableTable) -> Data:
    error = instance.error
    return {
        "key": instance.key,
        "root": instance.root.key,
        "counts": list(instance.counts),
        "variables": dicts.number(instance.root_variables),
        "error": None if error is None else {name: getattr(error, name) for name in _ERROR},
    }


def _scope(scope: Scope, dicts: VariableTable, homes: Mapping[Body, str], dump: Convert) -> Data:
    return {
        "key": scope.key,
        "instance": scope.instance.key,
        "parent": scope.parent and scope.parent.key,
        "node": scope.node and scope.node.key,
        "body": None if scope.body is None else homes[scope.body],
        "variables": dicts.number(scope.variables),
        "tokens": scope.tokens,
        "state": scope.state,
        "depth": scope.depth,
        "children": [child.key for child in scope.children],
        "arms": [arm.key for arm in scope.arms],
        "joins": None if scope.joins is None else {node.key: list(counts) for node, counts in scope.joins.items()},
        "mail": None if scope.mail is None else [box.key for box in scope.mail.values()],
        "handles": [node.key for node in scope.handles],
        "suspender": scope.suspender and scope.suspender.key,
        "mark": scope.mark,
        "held": [node.key for node in scope.held],
        "items": encode(scope.items, dump),
        "done": None if scope.done is None else [_record(record, dicts) for record in scope.done],
    }


def _record(record: Record, dicts: VariableTable) -> list[Any]:
    return [record.node.key, dicts.number(record.variables), [_record(inner, dicts) for inner in record.inner]]


def _wait(wait: Wait) -> Data:
    return {
        "key": wait.key,
        "node": wait.node.key,
        "scope": wait.scope.key,
        "owner": wait.owner and wait.owner.key,
        "token": wait.token,
        "true": wait.true,
        "started": wait.started,
        "paused": wait.paused,
        "due": wait.due,
        "arms": [arm.key for arm in wait.arms],
        "box": wait.box and wait.box.key,
    }


def _box(box: Mailbox, dump: Convert) -> Data:
    return {
        "key": box.key,
        "node": box.node.key,
        "scope": box.scope.key,
        "messages": [[number, encode(message, dump)] for number, message in box.messages],
        "passed": box.passed,
    }


def _continuation(continuation: Continuation) -> Data:
    return {"node": continuation.node.key, "scope": continuation.scope.key}


_KNOWN = frozenset({bool, int, str, type(None)})


def encode(value: Any, dump: Convert = no_data) -> Any:
    """A value as data for JSON. Types that JSON lacks become an object with one key that begins with ``$``."""
    if value is None or isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, float):
        return {"$float": repr(float(value))}
    if isinstance(value, bytes):
        return {"$bytes": value.hex()}
    if isinstance(value, list):
        return list(value) if _is_plain(value) else [encode(item, dump) for item in value]
    if isinstance(value, tuple | set | frozenset):
        items = value if isinstance(value, tuple) else sorted(value, key=repr)
        return {f"${type(value).__name__}": [encode(item, dump) for item in items]}
    if isinstance(value, dict):
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return {key: encode(item, dump) for key, item in value.items()}
        return {"$dict": [[encode(key, dump), encode(item, dump)] for key, item in value.items()]}
    return {"$object": encode(dump(value), dump)}


def _is_plain(items: list[Any]) -> bool:
    """Whether JSON has the types of all items. Maps have many thousands of items: a call for each is too slow."""
    kinds = set(map(type, items))
    return kinds <= _KNOWN or (kinds == {float} and all(map(math.isfinite, items)))


# ---- from data -----------------------------------------------------------------------------------


def restore(
    program: Program,
    data: Data,
    host: Host,
    new_variables: Callable[[], dict[str, Any]] = dict,
    *,
    load: Convert = no_data,
) -> Engine:
    """The engine of a snapshot. No token moves, and the host is not called, until `Engine.restart`.

    The engine never changes `data`: any number of engines can be restored from it.

    `load` is the inverse of `dump`. Raises MissionError for the state of another program.
    """
    if (data["program"], data["observed"]) != (program.hash, program.observed):
        raise MissionError(f"the state is one of program {data['program']}, not of {program.hash}")
    return _Restoring(program, data, host, new_variables, load).engine


class _Restoring:
    """Restores an engine: first all objects by key, then their references."""

    def __init__(
        self, program: Program, data: Data, host: Host, new_variables: Callable[[], dict[str, Any]], load: Convert
    ) -> None:
        self.data, self.load = data, load
        self.engine = Engine(program, host, new_variables)
        self.nodes = {**program.by_key, **{node.key: node for node in OF_NO_PROGRAM}}
        self.dicts = self._variables(new_variables)
        self.instances = {item["key"]: self._instance(item) for item in data["instances"]}
        self.scopes: dict[int, Scope] = {}
        for item in data["scopes"]:
            self.scopes[item["key"]] = self._scope(item)
        self.waits = {item["key"]: self._wait(item) for item in data["waits"]}
        self.boxes = {item["key"]: self._box(item) for item in data["boxes"]}
        self.everything: dict[int, Any] = {**self.scopes, **self.waits, **self.boxes}
        for item in data["scopes"]:
            self._connect_scope(self.scopes[item["key"]], item)
        for item in data["waits"]:
            self._connect_wait(self.waits[item["key"]], item)
        self._tables()

    def _variables(self, new_variables: Callable[[], dict[str, Any]]) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        for item in self.data["variables"]:
            own = {name: decode(value, self.load) for name, value in item["own"].items()}
            if item["outer"] is None:
                found.append({**new_variables(), **own})
            else:
                found.append(Variables(found[item["outer"]], own))
        return found

    def _instance(self, item: Data) -> Instance:
        instance = Instance(item["key"], self.engine.program, self.dicts[item["variables"]])
        instance.counts = list(item["counts"])
        if item["error"] is not None:
            fields = dict(item["error"])
            instance.error = MissionError(fields.pop("text"), **fields)
        return instance

    def _scope(self, item: Data) -> Scope:
        parent = self.scopes.get(item["parent"])
        node = self.nodes.get(item["node"])
        scope = Scope(item["key"], parent, node, self._body(item["body"]), self.dicts[item["variables"]])
        scope.instance = self.instances[item["instance"]]
        scope.counts = scope.instance.counts
        scope.instance.scopes += 1
        if parent is None:
            scope.instance.root = scope
        scope.tokens, scope.state, scope.depth, scope.mark = item["tokens"], item["state"], item["depth"], item["mark"]
        scope.handles = tuple(self.nodes[key] for key in item["handles"])
        scope.held = tuple(self.nodes[key] for key in item["held"])
        scope.items = decode(item["items"], self.load)
        scope.done = None if item["done"] is None else [self._record(record) for record in item["done"]]
        if item["joins"] is not None:
            scope.joins = {self.nodes[key]: list(counts) for key, counts in item["joins"].items()}
        return scope

    def _record(self, item: list[Any]) -> Record:
        return Record(self.nodes[item[0]], self.dicts[item[1]], [self._record(inner) for inner in item[2]])

    def _body(self, key: str | None) -> Body | None:
        if key is None:
            return None
        return self.nodes[key].body if key else self.engine.program.body

    def _wait(self, item: Data) -> Wait:
        wait = Wait(item["key"], self.nodes[item["node"]], self.scopes[item["scope"]], item["token"])
        wait.true, wait.started, wait.paused, wait.due = item["true"], item["started"], item["paused"], item["due"]
        return wait

    def _box(self, item: Data) -> Mailbox:
        box = Mailbox(item["key"], self.nodes[item["node"]], self.scopes[item["scope"]])
        box.messages.extend((number, decode(message, self.load)) for number, message in item["messages"])
        box.passed = item.get("passed", False)
        return box

    def _connect_scope(self, scope: Scope, item: Data) -> None:
        scope.children = {self.everything[key]: None for key in item["children"]}
        scope.arms = tuple(self.waits[key] for key in item["arms"])
        scope.suspender = self.scopes.get(item["suspender"])
        if item["mail"] is not None:
            scope.mail = {self.boxes[key].node: self.boxes[key] for key in item["mail"]}

    def _connect_wait(self, wait: Wait, item: Data) -> None:
        wait.owner = self.everything.get(item["owner"])
        wait.arms = tuple(self.waits[key] for key in item["arms"])
        wait.box = self.boxes.get(item["box"])

    def _tables(self) -> None:
        engine, data = self.engine, self.data
        engine.counter, engine.untaken = data["counter"], Counter(data.get("untaken"))
        engine.instances = self.instances
        engine.listeners = {
            topic: {self.everything[key]: None for key in keys} for topic, keys in data["listeners"].items()
        }
        engine.conditions = {self.waits[key]: None for key in data["conditions"]}
        engine.waits = {key: self.waits[key] for key in data["named"]}
        engine.inclusive = {self.scopes[key]: None for key in data["inclusive"]}
        for key, code, text in data["incidents"]:
            self.waits[key].catch = AT_INCIDENT
            engine.incidents[self.waits[key]] = code, text
        if data["held"] is not None:
            scopes, waits = data["held"]
            engine.held = [self.scopes[key] for key in scopes], [self.waits[key] for key in waits]
        engine.armed_starts = {int(key): self.nodes[node] for key, node in data["starts"].items()}
        for key, kept in data["waiting_starts"].items():
            node = self.nodes[key]
            assert node.catch is not None
            messages = ((number, decode(message, self.load)) for number, message in kept)
            engine.waiting_starts[node] = deque(messages, maxlen=node.catch.queue)
        for key, sets in data["gathered"].items():
            engine.gathered[self.nodes[key]] = [self._gathered(*found) for found in sets]
        for item in data["boxes"]:
            for key in item.get("waits", ()):  # written by an older version: these were not among the listeners
                engine.listeners.setdefault(self.waits[key].catch.topic, {})[self.waits[key]] = None
        for item in data["continuations"]:
            engine.ready.append((self.nodes[item["node"]], self.scopes[item["scope"]]))

    def _gathered(self, keys: Any, found: list[Any]) -> Gathered:
        messages = {self.nodes[part]: decode(message, self.load) for part, message in found}
        return decode(keys, self.load), messages


def decode(data: Any, load: Convert = no_data) -> Any:
    """The inverse of `encode`."""
    if isinstance(data, list):
        return [decode(item, load) for item in data]
    if not isinstance(data, dict):
        return data
    if len(data) == 1:
        ((kind, inner),) = data.items()
        if kind in _DECODERS:
            return _DECODERS[kind](inner, load)
    return {key: decode(item, load) for key, item in data.items()}


_DECODERS: dict[str, Callable[[Any, Convert], Any]] = {
    "$float": lambda inner, load: float(inner),
    "$bytes": lambda inner, load: bytes.fromhex(inner),
    "$tuple": lambda inner, load: tuple(decode(inner, load)),
    "$set": lambda inner, load: set(decode(inner, load)),
    "$frozenset": lambda inner, load: frozenset(decode(inner, load)),
    "$dict": lambda inner, load: {decode(key, load): decode(value, load) for key, value in inner},
    "$object": lambda inner, load: load(decode(inner, load)),
}
