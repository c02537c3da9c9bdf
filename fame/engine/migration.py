"""Transfer the state of an engine to another program: a changed model continues where the old one was.

Tokens at an element with the same id and kind in both programs are transferred; a `MigrationPlan` maps an element to
another one, restarts it, or drops its tokens. Boundary events, event sub-processes and queues are closed if the new
program does not have them; `arm_new` arms the new ones. An event never becomes one of another kind.

`migrate` is a function of plain data: the snapshot of a state, to that of another. Nothing moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from fame.bpmn import model
from fame.dataclasses import dataclass, field
from fame.engine import waiting
from fame.engine.encoding import Data
from fame.engine.interpreter import Engine
from fame.engine.program import Node, Program
from fame.engine.snapshot import OF_NO_PROGRAM, all_scopes
from fame.engine.state import RUNNING, Wait
from fame.engine.steps import ABANDONED
from fame.errors import MissionError

_NEVER_WAIT = ("start", "end", "throw", "boundary")
Fate = Literal["keep", "restart", "abandon", "blocked"]


@dataclass(frozen=True, slots=True)
class MigrationPlan:
    """How to transfer elements and variables that differ.

    to       the new id of an element; `restart`: elements to start again; `abandon`: elements whose tokens end
    rename   the new name of a variable
    default  values of variables that are not set
    """

    to: Mapping[str, str] = field(default_factory=dict)
    restart: frozenset[str] = frozenset()
    abandon: frozenset[str] = frozenset()
    rename: Mapping[str, str] = field(default_factory=dict)
    default: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MigratedToken:
    """A token and its fate.

    target   the element in the new program; `reason`: why it is blocked
    name     the label of the element
    others   new elements of its kind: possible targets of a blocked token
    """

    element: str
    fate: Fate
    target: str = ""
    reason: str = ""
    name: str = ""
    others: tuple[str, ...] = ()

    def __str__(self) -> str:
        place = f'"{self.name}" ({self.element})' if self.name else self.element
        if self.fate == "blocked":
            return f"{place}: {self.reason}"
        to = f" as {self.target}" if self.target not in ("", self.element) else ""
        return f"{place}: {self.fate}{to}"


def migrate(data: Data, old: Program, new: Program, plan: MigrationPlan) -> tuple[Data, list[MigratedToken]]:
    """Return the state in the new program, and the fate of each token.

    Raises MissionError, with all reasons, if a token cannot be transferred.
    """
    migration = _Migration(data, old, new, plan)
    blocked = [str(token) for token in migration.tokens if token.fate == "blocked"]
    if blocked:
        raise MissionError(f"the state does not fit the new model: {'; '.join(blocked)}", element=new.process)
    return migration.result(), migration.tokens


def preview(data: Data, old: Program, new: Program, plan: MigrationPlan) -> list[MigratedToken]:
    """Return the fate of each token, without migrating."""
    return _Migration(data, old, new, plan).tokens


def gone(old: Program, new: Program, plan: MigrationPlan) -> list[MigratedToken]:
    """Return a blocked token for each element of the old program where one could wait and that has no counterpart."""
    before, now = kinds(old), kinds(new)
    fresh = [id for id in now if id not in before]
    return [
        MigratedToken(node.id, "blocked", "", f"the new model has no {before[node.id]} {node.id}", node.name,
              tuple(sorted(id for id in fresh if now[id] == before[node.id])))
        for process in old.sources
        for node in process.body.walk()
        if isinstance(node, model.Activity | model.Event) and node.place not in _NEVER_WAIT
        and now.get(node.id) != before[node.id]
        and not (node.id in plan.to or node.id in plan.restart or node.id in plan.abandon)
    ]  # fmt: skip


def kinds(program: Program) -> dict[str, str]:
    """Return the kind of each element, as text."""
    return {node.id: kind_of(node) for process in program.sources for node in process.body.walk()}


def kind_of(element: model.FlowNode) -> str:
    """Return the kind of an element: tokens and subscriptions are transferred between elements of one kind."""
    match element:
        case model.Event():
            how = " ".join(type(each).__name__.removesuffix("Definition").lower() for each in element.definitions)
            return f"{element.place} event {how or 'none'}"
        case model.Gateway():
            return f"{element.kind} gateway with {len(element.incoming)} incoming flows"
        case model.Task():
            what = "repeated " if element.loop is not None else ""
            return f"{what}{'script' if element.script is not None else element.kind} task"
        case model.SubProcess():
            return f"{'repeated ' if element.loop is not None else ''}{element.kind} sub-process"
        case model.Activity():
            return f"{'repeated ' if element.loop is not None else ''}call activity"
    return type(element).__name__


class _Migration:
    def __init__(self, data: Data, old: Program, new: Program, plan: MigrationPlan) -> None:
        self._data, self._old, self._new, self._plan = data, old, new, plan
        self._old_kinds, self._new_kinds = kinds(old), kinds(new)
        self._names = {node.id: node.name for process in old.sources for node in process.body.walk()}
        self._pseudo = {node.key for node in OF_NO_PROGRAM}
        self._waits = {item["key"]: item for item in data["waits"]}
        self._scopes = {item["key"]: item for item in data["scopes"]}
        self._gone: set[int] = set()
        self._begin: list[Data] = []
        self.tokens: list[MigratedToken] = []
        for scope in data["scopes"]:  # outer ones first
            if scope["key"] not in self._gone:
                self._decide_scope(scope)
        self._check_continuations()

    # ---- which element and node -------------------------------------------------------------------------------------

    def _target(self, element: str) -> str:
        return self._plan.to.get(element, element)

    def _node(self, key: str | None) -> str | None:
        """Return the key of a node in the new program; None if it has no counterpart."""
        if key is None or key in self._pseudo:
            return key
        node = self._old.by_key.get(key)
        if node is None:
            return None
        target = self._target(node.id)
        renamed = f"{target}{key[len(node.id) :]}" if key.startswith(node.id) else key
        same_kind = self._old_kinds.get(node.id) == self._new_kinds.get(target)
        return renamed if renamed in self._new.by_key and same_kind else None

    def _why_not(self, element: str) -> str:
        target = self._target(element)
        if target not in self._new_kinds:
            return f"the new model has no element {target}"
        old, now = self._old_kinds.get(element, "nothing"), self._new_kinds[target]
        return f"{target} is a {now}, not a {old}" if old != now else f"{target} is built in another way"

    # ---- tokens ------------------------------------------------------------------------------------------------------

    def _decide_scope(self, scope: Data) -> None:
        """Decide on a scope (the token of its activity), and on the tokens in it."""
        if scope["node"] is not None and not self._decide(scope, scope["node"], scope["parent"]):
            return
        if scope["body"] and self._node(scope["body"]) is None:
            self._block(self._old.by_key[scope["body"]].id)
        for key in [*scope["handles"], *(scope["joins"] or {}), *scope["held"]]:
            if self._node(key) is None:
                self._block(self._old.by_key[key].id)
        for child in scope["children"]:
            wait = self._waits.get(child)
            if wait is not None and wait["token"]:
                self._decide(wait, wait["node"], scope["key"])

    def _decide(self, item: Data, key: str, parent: int) -> bool:
        """Decide on one token. Returns whether it stays as it is."""
        element = self._old.by_key[key].id
        target = self._target(element)
        if element in self._plan.abandon:
            self._leave(item, parent, ABANDONED.key)
            self._add(element, "abandon")
            return False
        again = element in self._plan.restart or self._has_other_alternatives(item, key)
        entry = self._entry(target, parent)
        if not again and self._node(key) is not None:
            self._add(element, "keep", target)
            return True
        if (again or element in self._plan.to) and entry is not None:
            self._leave(item, parent, entry)
            self._add(element, "restart", target)
            return False
        self._block(element)
        return False

    def _has_other_alternatives(self, item: Data, key: str) -> bool:
        """Return whether an event-based gateway, or a multiple event, waits for other events in the new program."""
        old, now = self._old.by_key[key], self._new.by_key.get(self._node(key) or "")
        if old.catch is None or not old.catch.parts or now is None or now.catch is None:
            return False
        return [self._node(part.key) for part in old.catch.parts] != [part.key for part in now.catch.parts]

    def _entry(self, element: str, parent: int) -> str | None:
        """Return the first node of an element in the new body of a scope."""
        body = self._scopes[parent]["body"]
        opener = self._node(body) if body else ""
        opened = self._new.body if opener == "" else self._new.by_key[opener].body if opener is not None else None
        return opened.entries[element].key if opened is not None and element in opened.entries else None

    def _leave(self, item: Data, parent: int, begin: str) -> None:
        """Move a token, without the content of its activity, to another node of the new program."""
        self._drop(item)
        self._begin.append({"node": begin, "scope": parent})

    def _drop(self, item: Data) -> None:
        self._gone.add(item["key"])
        for key in [*item["arms"], *item.get("children", ()), *(item.get("mail") or ())]:
            inner = self._waits.get(key) or self._scopes.get(key)
            if inner is not None:
                self._drop(inner)
            else:
                self._gone.add(key)
        if item.get("box"):
            self._gone.add(item["box"])

    def _block(self, element: str) -> None:
        kind = self._old_kinds.get(element)
        others = [id for id, other in self._new_kinds.items() if other == kind and id not in self._old_kinds]
        self._add(element, "blocked", self._target(element), self._why_not(element), tuple(sorted(others)))

    def _add(self, element: str, fate: Fate, target: str = "", reason: str = "", others: tuple[str, ...] = ()) -> None:
        self.tokens.append(MigratedToken(element, fate, target, reason, self._names.get(element, ""), others))

    def _check_continuations(self) -> None:
        for item in self._data["continuations"]:
            if item["scope"] not in self._gone and self._node(item["node"]) is None:
                self._block(self._old.by_key[item["node"]].id)

    # ---- the new state -----------------------------------------------------------------------------------------------

    def result(self) -> Data:
        data = self._data
        waits = [self._wait(item) for item in data["waits"] if item["key"] not in self._gone]
        kept_waits = {item["key"] for item in waits if item["node"] is not None}
        boxes = [{**item, "node": self._node(item["node"])} for item in data["boxes"] if item["key"] not in self._gone]
        boxes = [box for box in boxes if box["node"]]
        alive = kept_waits | {item["key"] for item in boxes}
        scopes = [self._scope(item, alive) for item in data["scopes"] if item["key"] not in self._gone]
        alive |= {item["key"] for item in scopes}
        waits = [
            {
                **item,
                "arms": [key for key in item["arms"] if key in alive],
                "box": item["box"] if item["box"] in alive else None,
            }
            for item in waits
            if item["key"] in alive
        ]
        return {
            **data,
            "program": self._new.hash,
            "observed": self._new.observed,
            "instances": [{**item, "counts": self._counts(item["counts"])} for item in data["instances"]],
            "scopes": scopes,
            "waits": waits,
            "boxes": boxes,
            "listeners": self._listeners(waits, boxes),
            "conditions": [key for key in data["conditions"] if key in alive],
            "named": [key for key in data["named"] if key in alive],
            "inclusive": [key for key in data["inclusive"] if key in alive],
            "incidents": [item for item in data["incidents"] if item[0] in alive],
            "held": data["held"] and [[key for key in part if key in alive] for part in data["held"]],
            "continuations": [
                *(self._wait(item) for item in data["continuations"] if item["scope"] in alive),
                *(item for item in self._begin if item["scope"] in alive),
            ],
            "starts": {key: mapped for key, node in data["starts"].items() if (mapped := self._node(node))},
            "waiting_starts": {m: kept for node, kept in data["waiting_starts"].items() if (m := self._node(node))},
            "gathered": self._gathered(),
            "variables": [{**item, "own": self._variables(item["own"], item["outer"])} for item in data["variables"]],
        }

    def _wait(self, item: Data) -> Data:
        return {**item, "node": self._node(item["node"])}

    def _scope(self, item: Data, alive: set[int]) -> Data:
        items = item["items"]
        if isinstance(items, dict) and "todo" in items:
            items = {**items, "todo": [key for old in items["todo"] if (key := self._node(old))]}
        scopes = self._scopes.keys() - self._gone
        return {
            **item,
            "node": self._node(item["node"]),
            "body": self._node(item["body"]) if item["body"] else item["body"],
            "children": [key for key in item["children"] if key in alive or key in scopes],
            "arms": [key for key in item["arms"] if key in alive],
            "joins": item["joins"] and {self._node(key): counts for key, counts in item["joins"].items()},
            "mail": item["mail"] and [key for key in item["mail"] if key in alive],
            "handles": [self._node(key) for key in item["handles"]],
            "held": [self._node(key) for key in item["held"]],
            "items": items,
            "done": item["done"] and [kept for record in item["done"] if (kept := self._record(record)) is not None],
        }

    def _record(self, record: list[Any]) -> list[Any] | None:
        """Return a record for compensation, unless its activity is not in the new model."""
        node = self._node(record[0])
        inner = [kept for item in record[2] if (kept := self._record(item)) is not None]
        return [node, record[1], inner] if node is not None else None

    def _counts(self, counts: list[int]) -> list[int]:
        """Return the counts of completed elements, by the slots of the new program."""
        slots: dict[str, list[int]] = {}
        for slot, element in enumerate(self._new.elements):
            slots.setdefault(element, []).append(slot)
        migrated = [0] * len(self._new.elements)
        for slot, element in enumerate(self._old.elements):
            places = slots.get(self._target(element), [])
            if slot and places:
                migrated[places.pop(0)] = counts[slot]
        return migrated

    def _listeners(self, waits: list[Data], boxes: list[Data]) -> dict[str, list[int]]:
        """Return the listeners, in their old order, on the topics of the new program."""
        nodes = {item["key"]: self._new.by_key[item["node"]] for item in (*waits, *boxes)}
        listeners: dict[str, list[int]] = {}
        for keys in self._data["listeners"].values():
            for key in keys:
                node = nodes.get(key)
                if node is not None and node.catch is not None:
                    listeners.setdefault(node.catch.topic, []).append(key)
        return listeners

    def _gathered(self) -> Data:
        gathered: Data = {}
        for node, sets in self._data["gathered"].items():
            mapped = self._node(node)
            if mapped is not None:
                gathered[mapped] = [
                    [keys, [[key, message] for part, message in parts if (key := self._node(part))]]
                    for keys, parts in sets
                ]
        return gathered

    def _variables(self, own: Data, outer: int | None) -> Data:
        renamed = {self._plan.rename.get(name, name): value for name, value in own.items()}
        return renamed if outer is not None else {**self._plan.default, **renamed}


def arm_new(engine: Engine) -> None:
    """Arm what is new in a migrated state: boundary events, event sub-processes, queues, timer start events."""
    for scope in all_scopes(engine):
        if scope.state != RUNNING:
            continue
        body = scope.body
        if body is not None:
            mail = scope.mail or {}
            for node in body.queued:
                if node not in mail:
                    mail[node] = waiting.open_mailbox(engine, node, scope)
            scope.mail = mail or None
            there = {child.node for child in scope.children if isinstance(child, Wait)}
            for node in body.armed:
                if node not in there:
                    wait = Wait(engine.new_key(), node, scope, False, scope)
                    scope.children[wait] = None
                    waiting.arm(engine, wait)
        if scope.parent is not None and scope.node is not None:
            waiting.arm_all(engine, _missing(scope.node, scope.arms), scope.parent, scope)
        for wait in [child for child in scope.children if isinstance(child, Wait) and child.token]:
            waiting.arm_all(engine, _missing(wait.node, wait.arms), wait.scope, wait)
    engine.arm_starts()


def _missing(node: Node, arms: tuple[Wait, ...]) -> tuple[Node, ...]:
    """Return the boundary events of an activity that are not armed."""
    there = {wait.node for wait in arms}
    return tuple(each for each in node.boundary.armed if each not in there) if node.boundary is not None else ()
