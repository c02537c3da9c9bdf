"""Transfer the state of an engine to another program: a changed model continues where the old one was.

Tokens at an element with the same id and kind in both programs are transferred, to the scope that it is in now
(`fame.engine.places`); a `MigrationPlan` maps an element to another one, restarts it, or drops its tokens. Boundary
events, event sub-processes and queues are closed if the new program does not have them there; `arm_new` arms the new
ones. An event never becomes one of another kind.

`migrate` is a function of plain data: the snapshot of a state, to that of another. Nothing moves.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

from fame.bpmn import model
from fame.dataclasses import dataclass, field, replace
from fame.engine import waiting
from fame.engine.adhoc import NEXT
from fame.engine.armed_events import ArmedEvents
from fame.engine.compensation import ROLL_BACK, handler_of
from fame.engine.encoding import Data
from fame.engine.interpreter import Engine
from fame.engine.places import Misplaced, Places
from fame.engine.program import LoopInstance, Node, Program
from fame.engine.snapshot import OF_NO_PROGRAM, all_scopes
from fame.engine.state import Scope, Wait
from fame.engine.steps import ABANDONED, Branch
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

    target   the element in the new program; `reason`: why it is blocked, or what else changes with it
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
        return f"{place}: {self.fate}{to}{f' ({self.reason})' if self.reason else ''}"


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
        self._places = Places(data, old, new, self._node)
        self._scopes, self._waits, self._gone = self._places.scopes, self._places.waits, self._places.gone
        self._begin: list[Data] = []
        self._lost: dict[int, str] = {}  # scopes of elements that are gone: the only token in one may leave it
        self._forgotten: set[str] = set()
        self._at: dict[int, int] = {}  # where in `tokens` a wait or scope is
        self.tokens: list[MigratedToken] = []
        for scope in list(self._scopes.values()):  # outer ones first
            if scope["key"] not in self._gone:
                self._decide_scope(scope)
        self._check_continuations()
        renamed = self._renamed()
        for key, element in self._lost.items():
            if key not in self._gone:
                hint = f"; {{to: {renamed[element]}}} in the plan keeps its tokens" if element in renamed else ""
                self._block(element, hint=hint)
        self._move_events()
        left = {self._at[key] for key in self._places.left if key in self._at}
        self.tokens = [token for index, token in enumerate(self.tokens) if index not in left]
        self._places.move_boxes()

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
        if scope["key"] not in self._lost:
            if scope["body"] and self._places.opener(scope) is None:
                self._block(self._old.by_key[scope["body"]].id)
            self._check_handlers(scope)
            joins = [key for key, counts in (scope["joins"] or {}).items() if any(counts[: self._need(key)])]
            items = scope["items"] if isinstance(scope["items"], dict) else {}
            for key in [*joins, *scope["held"], *items.get("todo", ())]:
                self._check(key, scope)
            self._check_records(scope, scope["done"] or ())
        for child in list(scope["children"]):
            wait = self._waits.get(child)
            if wait is not None and wait["token"]:
                self._decide(wait, wait["node"], scope["key"])

    def _need(self, key: str) -> int:
        """Return the number of incoming flows of a join."""
        need: int = self._old.by_key[key].spec.need
        return need

    def _check_handlers(self, scope: Data) -> None:
        """Block the event sub-processes that have interrupted a scope, unless they are of the same one now."""
        before = None
        for key in scope["handles"]:
            element = self._old.by_key[key].id
            target = self._target(element)
            if self._node(key) is None:
                self._block(element)
            elif not self._places.is_handled_in(scope, target, before):
                self._block(element, f"{target} handles another scope in the new model")
            before = target

    def _check(self, key: str, scope: Data) -> None:
        """Block a token between elements, or at a join, unless its place is in the same scope."""
        if key in self._pseudo:
            return
        element = self._old.by_key[key].id
        target = self._target(element)
        if self._node(key) is None:
            self._block(element)
        elif not self._places.holds(scope, target):
            self._block(element, f"{target} is in another scope in the new model")

    def _decide(self, item: Data, key: str, parent: int) -> bool:
        """Decide on one token. Returns whether it stays as it is."""
        if key in self._pseudo:
            return self._is_undone(item, key)
        element = self._old.by_key[key].id
        target = self._target(element)
        if element in self._plan.abandon:
            self._leave(item, element, parent, ABANDONED.key)
            self._add(element, "abandon", item=item)
            return False
        again = element in self._plan.restart or self._has_other_alternatives(item, key)
        stays = not again and self._node(key) is not None
        reason = ""
        if target in self._new_kinds and (stays or again or element in self._plan.to):
            try:
                place, change = self._places.place(item, parent, target)
            except Misplaced as error:
                reason = str(error)
            else:
                entry = self._places.entry(self._scopes[place], target)
                if stays:
                    if not _is_wrapper(self._old.by_key[key]) or not self._has_tokens(item):
                        self._add(element, "keep", target, change, item=item)
                    return True
                if entry is not None and isinstance(entry.spec, Branch) and entry.spec.ports:
                    reason = f"{target} joins flows, and no token comes by one so: fame move it after the migration"
                elif entry is not None:
                    self._leave(item, element, place, entry.key)
                    self._add(element, "restart", target, change, item=item)
                    return False
        if item["key"] in self._scopes and element not in (*self._new_kinds, *self._plan.to, *self._plan.restart):
            self._lost[item["key"]] = element
            return True
        if parent not in self._lost:
            self._block(element, reason)
        return False

    def _is_undone(self, item: Data, key: str) -> bool:
        """Return whether a scope of no element stays: of compensation; of a transaction that is rolled back."""
        around = self._scopes[item["parent"]]
        node = self._new.by_key.get(self._node(around["node"]) or "") if key == ROLL_BACK.key else None
        if node is not None and (node.boundary is None or not node.boundary.cancels):
            self._block(node.id, f"{node.id} is being cancelled, and has no cancel boundary event in the new model")
        return True

    def _has_tokens(self, scope: Data) -> bool:
        return any(key in self._scopes or self._waits[key]["token"] for key in scope.get("children", ()))

    def _has_other_alternatives(self, item: Data, key: str) -> bool:
        """Return whether an event-based gateway, or a multiple event, waits for other events in the new program."""
        old, now = self._old.by_key[key], self._new.by_key.get(self._node(key) or "")
        if old.catch is None or not old.catch.parts or now is None or now.catch is None:
            return False
        return [self._node(part.key) for part in old.catch.parts] != [part.key for part in now.catch.parts]

    def _leave(self, item: Data, element: str, parent: int, begin: str) -> None:
        """Move a token, without the content of its activity, to another node of the new program."""
        self._places.drop(item)
        self._begin.append({"node": begin, "scope": parent})
        items = self._scopes[parent]["items"]
        if isinstance(items, dict) and items.get("busy") == element:  # of an ad-hoc sub-process: the next one may start
            self._scopes[parent]["items"] = {**items, "busy": ""}
            self._begin += [{"node": NEXT.key, "scope": parent}] if items["todo"] else []

    def _renamed(self) -> dict[str, str]:
        """Return the new sub-process of each one that is gone, where all its tokens are in that now."""
        found = dict[str, str]()
        for key, element in reversed(self._lost.items()):  # inner ones first
            homes = set[str]()
            for child in self._scopes[key]["children"]:
                token = self._scopes.get(child) or self._waits[child]
                if token.get("token", True) and token["node"] in self._old.by_key:
                    inner = self._old.by_key[token["node"]].id
                    now = found.get(inner, self._target(inner))
                    homes.add(now if inner == element else self._places.home(now))
            home = homes.pop() if len(homes) == 1 else ""
            if home not in self._old_kinds and self._new_kinds.get(home) == self._old_kinds[element]:
                found[element] = home
        return found

    def _block(self, element: str, reason: str = "", hint: str = "") -> None:
        kind = self._old_kinds.get(element)
        others = [id for id, one in self._new_kinds.items() if one == kind and id not in self._old_kinds and not reason]
        why = (reason or self._why_not(element)) + hint
        self._add(element, "blocked", self._target(element), why, tuple(sorted(others)))

    def _add(
        self, element: str, fate: Fate, target: str = "", reason: str = "", others: tuple[str, ...] = (),
        item: Data | None = None,
    ) -> None:  # fmt: skip
        if item is not None:
            self._at[item["key"]] = len(self.tokens)
        self.tokens.append(MigratedToken(element, fate, target, reason, self._names.get(element, ""), others))

    def _move_events(self) -> None:
        """Move boundary events and event sub-processes with their tokens, and say at these which are armed anew."""
        events = ArmedEvents(self._places, self._old, self._new, self._node)
        events.move(self._plan.restart)
        for key, element, text in events.changes(self._target, self._new_kinds):
            index, name = self._listed(key), self._names.get(element)
            change = text.format(f'"{name}" ({element})' if name else element)
            if index is None:
                self._add(element, "keep", reason=change)
            else:
                token = self.tokens[index]
                self.tokens[index] = replace(token, reason=", ".join(filter(None, (token.reason, change))))

    def _listed(self, key: int) -> int | None:
        """Return where in `tokens` a wait or scope is, what is in it, or what it is in."""
        inside = [key]
        for each in inside:  # which grows
            if each in self._at and each not in self._places.left:
                return self._at[each]
            inside += self._scopes[each]["children"] if each in self._scopes else ()
        return next((self._at[each] for each in self._places.around(key) if each in self._at), None)

    def _check_continuations(self) -> None:
        for item in self._data["continuations"]:
            if item["scope"] not in self._gone:
                self._check(item["node"], self._scopes[item["scope"]])

    # ---- compensation ------------------------------------------------------------------------------------------------

    def _check_records(self, scope: Data, records: Sequence[list[Any]], outer: bool = True) -> None:
        """Block completed activities that the new model would not undo, unless the plan abandons them."""
        for node, _, inner in records:
            element = self._old.by_key[node].id
            target, now = self._target(element), self._new.by_key.get(self._node(node) or "")
            undone = handler_of(self._old.by_key[node]) is not None
            why = ""
            if not undone and not inner:
                continue
            if now is None:
                why = self._why_not(element)
            elif undone and handler_of(now) is None and (not inner or scope["body"] is None):
                why = f"{target} has no compensation handler in the new model"
            elif outer and not self._places.is_inside(scope, target):
                why = f"{target} is in another scope in the new model"
            if not why:
                self._check_records(scope, inner, False)
            elif element not in self._forgotten:
                self._forgotten.add(element)
                if element in self._plan.abandon:
                    self._add(element, "abandon", "", f"is completed, and is never undone: {why}")
                else:
                    self._block(element, f"is completed, and would never be undone: {why}")

    # ---- the new state -----------------------------------------------------------------------------------------------

    def result(self) -> Data:
        data = self._data
        waits = self._kept_waits()
        kept = {item["key"] for item in waits}
        own = {item["box"] for item in waits}
        boxes = [box for box in self._places.boxes.values() if self._is_open(box, own)]
        boxes = [{**item, "node": self._node(item["node"])} for item in boxes]
        scopes = [item for item in self._scopes.values() if item["key"] not in self._gone]
        alive = kept | {item["key"] for item in boxes} | {item["key"] for item in scopes}
        held = data["held"]
        if held:
            parts = [*held[0], *self._places.made], held[1]
            held = [[key for key in part if key in alive] for part in parts]
        waits = [
            {
                **item,
                "arms": [key for key in item["arms"] if key in alive],
                "box": item["box"] if item["box"] in alive else None,
            }
            for item in waits
        ]
        return {
            **data,
            "counter": self._places.counter,
            "program": self._new.hash,
            "observed": self._new.observed,
            "instances": [{**item, "counts": self._counts(item["counts"])} for item in data["instances"]],
            "scopes": [self._scope(item, alive) for item in scopes],
            "waits": waits,
            "boxes": boxes,
            "listeners": self._listeners(waits, boxes),
            "conditions": [key for key in data["conditions"] if key in alive],
            "named": [key for key in data["named"] if key in alive],
            "inclusive": [key for key in data["inclusive"] if key in alive],
            "incidents": [item for item in data["incidents"] if item[0] in alive],
            "held": held,
            "continuations": [
                *(self._mapped(item) for item in data["continuations"] if item["scope"] in alive),
                *(item for item in self._begin if item["scope"] in alive),
            ],
            "starts": {key: mapped for key, node in data["starts"].items() if (mapped := self._node(node))},
            "waiting_starts": {m: kept for node, kept in data["waiting_starts"].items() if (m := self._node(node))},
            "gathered": self._gathered(),
            "variables": [{**item, "own": self._variables(item["own"], item["outer"])} for item in data["variables"]],
        }

    def _kept_waits(self) -> list[Data]:
        """Return the tokens that wait, and what is armed: for an owner that has it in the new program, too."""
        kept: dict[int, Data] = {}
        for item in self._waits.values():  # owners first
            node, owner = self._node(item["node"]), item["owner"]
            if item["key"] in self._gone or node is None:
                continue
            if not item["token"]:
                there = owner in kept or (owner in self._scopes and owner not in self._gone)
                if not there or self._new.by_key[node] not in self._armed_for(item):
                    continue
            kept[item["key"]] = {**item, "node": node}
        return list(kept.values())

    def _armed_for(self, item: Data) -> Sequence[Node]:
        """Return what is armed in the new program for the owner of a wait: alternatives, boundary events, handlers."""
        owner = self._scopes.get(item["owner"]) or self._waits[item["owner"]]
        node = self._places.node_of(owner)
        return (*self._places.arming(owner), *(node.catch.parts if node is not None and node.catch is not None else ()))

    def _is_open(self, box: Data, own: Collection[int | None]) -> bool:
        """Return whether a queue is there in the new program, too: of a wait that is kept, or of a scope."""
        node = self._new.by_key.get(self._node(box["node"]) or "")
        if box["key"] in self._gone or node is None or node.catch is None or not node.catch.queue:
            return False
        body = self._places.body(self._scopes[box["scope"]])
        return box["key"] in own or (body is not None and node in body.queued)

    def _mapped(self, item: Data) -> Data:
        return {**item, "node": self._node(item["node"])}

    def _scope(self, item: Data, alive: set[int]) -> Data:
        items = item["items"]
        if isinstance(items, dict) and "todo" in items:
            todo = [key for old in items["todo"] if (key := self._node(old))]
            items = {**items, "todo": todo, "busy": self._target(items["busy"])}
        mapped = {"children": [key for key in item["children"] if key in alive]}
        mapped["mail"] = item["mail"] and [key for key in item["mail"] if key in alive]
        if item["key"] in self._places.made:
            return {**item, **mapped}
        return {
            **item,
            **mapped,
            "node": self._node(item["node"]),
            "body": self._places.opener(item),
            "arms": [key for key in item["arms"] if key in alive],
            "joins": item["joins"]
            and {key: counts for old, counts in item["joins"].items() if (key := self._node(old))},
            "handles": [self._node(key) for key in item["handles"]],
            "held": [self._node(key) for key in item["held"]],
            "items": items,
            "done": item["done"] and [kept for record in item["done"] if (kept := self._record(record)) is not None],
        }

    def _record(self, record: list[Any]) -> list[Any] | None:
        """Return a record for compensation, unless it is forgotten or its activity is not in the new model."""
        node = self._node(record[0])
        inner = [kept for item in record[2] if (kept := self._record(item)) is not None]
        gone = node is None or self._old.by_key[record[0]].id in self._forgotten
        return None if gone else [node, record[1], inner]

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
        names = sorted(own, key=self._plan.rename.__contains__)  # what is renamed replaces what has its new name
        renamed = {self._plan.rename.get(name, name): own[name] for name in names}
        return renamed if outer is not None else {**self._plan.default, **renamed}


def _is_wrapper(node: Node) -> bool:
    """Return whether a scope of this node only repeats a task, or gives it variables: what is in it is listed."""
    return isinstance(node.spec, LoopInstance) or node.key.endswith(("/loop", "/own"))


def arm_new(engine: Engine) -> None:
    """Arm what is new in a migrated state: boundary events, event sub-processes, queues, timer start events."""
    for scope in all_scopes(engine):
        body, own = scope.body, int(scope.suspender is not None)
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
                    _arm(engine, wait, scope.state - own * (not wait.catch.resume))
        if scope.parent is not None and scope.node is not None:
            _arm_missing(engine, scope.node, scope.parent, scope, scope.state - own)
        for wait in [child for child in scope.children if isinstance(child, Wait) and child.token]:
            _arm_missing(engine, wait.node, wait.scope, wait, wait.paused)
    engine.arm_starts()


def _arm_missing(engine: Engine, node: Node, scope: Scope, owner: Scope | Wait, suspended: int) -> None:
    """Arm the boundary events of an activity that are not armed."""
    there = {wait.node for wait in owner.arms}
    for event in node.boundary.armed if node.boundary is not None else ():
        if event not in there and owner.alive:
            wait = Wait(engine.new_key(), event, scope, False, owner)
            owner.arms += (wait,)
            _arm(engine, wait, suspended)


def _arm(engine: Engine, wait: Wait, suspended: int) -> None:
    """Arm a wait; while suspensions hold it, only its timer or its queue: the end of them arms the rest."""
    wait.paused = suspended
    if engine.held is not None and suspended:
        engine.held[1].append(wait)
    if suspended and wait.catch.trigger is not waiting.TIMER:
        if wait.catch.queue and waiting.mailbox_of(wait) is None:
            wait.box = waiting.open_mailbox(engine, wait.node, wait.scope)
        return
    waiting.arm(engine, wait)
