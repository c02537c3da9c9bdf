"""States of running robots as states to explore from.

A robot runs its whole program; what is explored has a step in place of each behaviour that touches no topic of the team
(`fame.check.explore.abstraction`). A snapshot of the one becomes a snapshot of the other: a behaviour that is being
called is a step under way, an element that waits for its repair begins again, values that cannot be read are unknown.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions, Process
from fame.check.explore.host import ExplorationHost
from fame.check.explore.timers import Timer
from fame.check.explore.values import Values
from fame.engine import Engine, compile_program, restore
from fame.engine.encoding import Data
from fame.engine.host import Host
from fame.engine.migration import arm_new
from fame.engine.program import Node, Program
from fame.engine.snapshot import OF_NO_PROGRAM
from fame.engine.tasks import SCRIPT
from fame.errors import FameError, MissionError
from fame.middleware import messages


def as_explored(data: Data, real: Program, explored: Program) -> Data:
    """Return a snapshot of the real program as one of the explored program.

    Raises MissionError for the snapshot of another model.
    """
    return _Translation(data, real, explored).result()


def resumed(program: Program, data: Data, host: ExplorationHost) -> Engine:
    """Return the engine of a snapshot of an explored program; of its timers no times are known."""
    outside: Host = host
    engine = restore(program, data, outside, host.new_variables, load=lambda value: _load_known(value, host.values))
    pending = {key: wait.catch for key, wait in engine.waits.items() if wait.catch.trigger is not SCRIPT}
    pending |= {key: node.catch for key, node in engine.armed_starts.items() if node.catch is not None}
    host.timers = {
        key: Timer(("alone", key), 0.0, 1.0 if catch.timer == "cycle" else None) for key, catch in pending.items()
    }
    return engine


def go_on(engine: Engine) -> None:
    """Continue what is held, and arm what a migrated state lacks."""
    engine.release()
    arm_new(engine)
    engine.continue_restored()


def _load_known(data: Any, values: Values) -> Any:
    """A value of what `fame.robot.stored_values.dump` made of it: a message, else the unknown one."""
    if isinstance(data, dict) and "message" in data:
        try:
            return messages.create(data["message"], data["value"])
        except FameError:
            return values.unknown
    return values.unknown


def real_program(
    definitions: Definitions, process: Process, library: Library, host: Host, *, observed: bool
) -> Program:
    """Return the program that a robot runs. Raises ModelError."""
    files = {home.file: home for home, _ in library.closure(definitions, process)}

    def find(name: str, file: str, call: CallActivity) -> tuple[Process, str]:
        home, called = library.find(files[file], call)
        return called, home.file

    return compile_program(process, host=host, library=find, file=definitions.file, observed=observed)


def counterparts(real: Program, explored: Program) -> dict[str, str]:
    """Key of a node -> key of the same node of the explored program; without those inside behaviours.

    Keys are numbered where files use the same id, and the programs have not the same files.
    """
    nodes: dict[tuple[str, str], list[Node]] = defaultdict(list)
    for node in explored.nodes:
        nodes[node.file, _plain(node.key)].append(node)
    same = {node.key: node.key for node in OF_NO_PROGRAM}
    for node in real.nodes:
        others = nodes.get((node.file, _plain(node.key)))
        if others:
            same[node.key] = others.pop(0).key
    return same


def _plain(key: str) -> str:
    return key.partition("#")[0]


class _Translation:
    def __init__(self, data: Data, real: Program, explored: Program) -> None:
        self._data, self._explored = data, explored
        self._same = counterparts(real, explored)
        self._scopes = {item["key"]: item for item in data["scopes"]}
        self._steps: dict[int, Data] = {}
        self._inside: set[int] = set()
        self._incidents = {item[0] for item in data["incidents"]}
        for scope in data["scopes"]:  # outer ones first
            if scope["parent"] in self._steps or scope["parent"] in self._inside:
                self._inside.add(scope["key"])
            elif scope["node"] is not None and self._is_step(scope):
                self._steps[scope["key"]] = scope

    def _is_step(self, scope: Data) -> bool:
        """Whether a scope is a behaviour that is explored as a step."""
        node = self._explored.by_key.get(self._same.get(scope["node"], ""))
        return node is not None and node.body is None and node.catch is not None

    def _node(self, key: str | None) -> str | None:
        if key is None:
            return None
        same = self._same.get(key)
        if same is None:
            raise MissionError(f"the state has a token at {key}, which the model does not have")
        return same

    def _known(self, key: int) -> bool:
        """Whether something is there in the exploration too."""
        return key not in self._gone

    def result(self) -> Data:
        data = self._data
        left_out = self._inside | self._steps.keys()
        self._gone: set[int] = self._inside | self._incidents | {
            item["key"] for item in (*data["waits"], *data["boxes"])
            if item["scope"] in left_out
        }  # fmt: skip
        waits = [self._wait(item) for item in data["waits"] if self._known(item["key"])]
        waits += map(self._step, self._steps.values())
        scopes = [self._scope(item) for item in data["scopes"] if item["key"] not in left_out]
        return {
            **data,
            "program": self._explored.hash,
            "observed": self._explored.observed,
            "instances": [{**item, "counts": [0] * len(self._explored.elements)} for item in data["instances"]],
            "scopes": scopes,
            "waits": waits,
            "boxes": [self._box(item) for item in data["boxes"] if self._known(item["key"])],
            "listeners": {topic: self._alive(keys) for topic, keys in data["listeners"].items()},
            "conditions": self._alive(data["conditions"]),
            "named": [*self._alive(data["named"]), *self._steps],
            "inclusive": [key for key in data["inclusive"] if key not in left_out],
            "incidents": [],
            "held": data["held"] and self._held(*data["held"]),
            "continuations": [self._placed(item) for item in data["continuations"] if item["scope"] not in left_out]
            + [{"node": self._node(item["node"]), "scope": item["scope"]} for item in data["waits"]
               if item["key"] in self._incidents and item["scope"] not in left_out],
            "starts": {key: self._node(node) for key, node in data["starts"].items()},
            "waiting_starts": {self._node(node): kept for node, kept in data["waiting_starts"].items()},
            "gathered": {
                self._node(node): [[keys, [[self._node(key), one] for key, one in parts]] for keys, parts in sets]
                for node, sets in data["gathered"].items()
            },
        }  # fmt: skip

    def _alive(self, keys: list[int]) -> list[int]:
        return [key for key in keys if key not in self._gone]

    def _held(self, scopes: list[int], waits: list[int]) -> list[list[int]]:
        """What is held: a step is a wait."""
        outer = [key for key in scopes if key not in self._inside and key not in self._steps]
        return [outer, [*self._alive(waits), *(key for key in scopes if key in self._steps)]]

    def _placed(self, item: Data) -> Data:
        return {**item, "node": self._node(item["node"])}

    def _step(self, scope: Data) -> Data:
        """A behaviour that is being called, as a step under way."""
        return {
            "key": scope["key"], "node": self._node(scope["node"]), "scope": scope["parent"], "owner": None,
            "token": True, "true": False, "started": True, "paused": max(scope["state"], 0), "due": 0,
            "arms": self._alive(scope["arms"]), "box": None,
        }  # fmt: skip

    def _wait(self, item: Data) -> Data:
        box = item["box"]
        return {**item, "node": self._node(item["node"]), "arms": self._alive(item["arms"]),
                "box": box if box is None or self._known(box) else None}  # fmt: skip

    def _box(self, item: Data) -> Data:
        return {**item, "node": self._node(item["node"])}

    def _scope(self, item: Data) -> Data:
        items = item["items"]
        if isinstance(items, dict) and "todo" in items:
            items = {**items, "todo": [self._node(key) for key in items["todo"]]}
        return {
            **item,
            "node": self._node(item["node"]),
            "body": self._node(item["body"]) if item["body"] else item["body"],
            "children": self._alive(item["children"]),
            "arms": self._alive(item["arms"]),
            "joins": item["joins"] and {self._node(key): counts for key, counts in item["joins"].items()},
            "mail": item["mail"] and self._alive(item["mail"]),
            "handles": [self._node(key) for key in item["handles"]],
            "held": [self._node(key) for key in item["held"]],
            "items": items,
            "done": item["done"] and [kept for record in item["done"] if (kept := self._record(record)) is not None],
        }

    def _record(self, record: list[Any]) -> list[Any] | None:
        node = self._same.get(record[0])
        inner = [kept for item in record[2] if (kept := self._record(item)) is not None]
        return [node, record[1], inner] if node is not None else None
