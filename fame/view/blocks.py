"""Cuts a run into blocks that the page loads one by one, each of which can be shown without those before it.

A block begins with the state at its start: tokens, counts, variables, waits. Then come columns of events and lists of
changes, in order of time. Whatever an instant the page shows, it is the state at the start of a block and what the
block has up to that instant. The page replays blocks as `State` does here; a test compares both.

Times are ns since the start of the run. Robots, elements and kinds of events are numbers.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from fame.bpmn.model import CallActivity, SubProcess
from fame.log.channels import EVENTS, GROUND, KEY, VARIABLES, WAITING, WORLD
from fame.robot.plain_values import json_text
from fame.view.catalogue import NOWHERE, Catalogue

WHATS: tuple[str, ...] = ("start", "enter", "leave", "take", "cancel", "fail", "end", "log", "report", "answer")
"""Kinds of events; an event has the number of its kind."""
_WHAT = {what: number for number, what in enumerate(WHATS)}
_START, _ENTER, _LEAVE, _TAKE, _CANCEL, _FAIL, _END = range(7)
COMPLETED, FAILED, CANCELLED = range(3)
SIZE = 3000
"""Events after which a block is full. Replaying one takes the page less than a millisecond."""
ITEMS = 4000
"""Changes of variables, waits and poses after which a block is full."""

Change = list[Any]


class TokenKey(NamedTuple):
    """Where tokens are: robot, instance, scope and element, by number."""

    robot: int
    instance: int
    scope: int
    element: int


@dataclass(slots=True)
class ScopeInfo:
    """A scope: the file of its elements, the scope around it, the element that opened it, how deep it is."""

    instance: int
    file: int
    parent: int = NOWHERE
    opener: int = NOWHERE
    depth: int = 0


@dataclass(slots=True)
class State:
    """The state of a run at an instant.

    tokens     where -> [number of tokens, since when]
    counts     (robot, element) -> [completed, failed, cancelled]
    scopes     (robot, scope) -> what is known of it
    variables  (robot, scope) -> name -> [value, since when]
    waits      robot -> key of a waiting token -> what it waits for
    instances  (robot, instance) -> its root scope; ``poses``: robot -> its last pose; ``world``: name -> what changed
    """

    tokens: dict[TokenKey, list[int]] = field(default_factory=dict)
    counts: defaultdict[tuple[int, int], list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0, 0]))
    scopes: dict[tuple[int, int], ScopeInfo] = field(default_factory=dict)
    variables: dict[tuple[int, int], dict[str, list[Any]]] = field(default_factory=dict)
    waits: dict[int, dict[str, Any]] = field(default_factory=dict)
    poses: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)

    def count(self, robot: int, element: int, outcome: int, by: int = 1) -> None:
        """One more execution of an element with an outcome."""
        self.counts[robot, element][outcome] += by

    def event(self, time: int, key: TokenKey, what: int) -> None:
        """An event happened."""
        held = self.tokens.get(key)
        if what == _ENTER:
            if held is None:
                self.tokens[key] = [1, time]
            else:
                held[0] += 1
        elif what == _TAKE:
            self.count(key.robot, key.element, COMPLETED)
        elif what in (_LEAVE, _CANCEL, _FAIL):
            self._left(key, held, what)
        elif what == _END:
            self._ended(key)

    def _left(self, key: TokenKey, held: list[int] | None, what: int) -> None:
        if held is not None:
            held[0] -= 1
            if not held[0]:
                del self.tokens[key]
        elif what == _FAIL:  # an error end event has completed and then fails: it counts as a failure
            self.count(key.robot, key.element, COMPLETED, -1)
        outcome = {_LEAVE: COMPLETED, _CANCEL: CANCELLED, _FAIL: FAILED}[what]
        self.count(key.robot, key.element, outcome)

    def _ended(self, key: TokenKey) -> None:
        """An instance ended, and with it whatever it still did."""
        for other in [other for other in self.tokens if other[:2] == key[:2]]:
            self.count(other.robot, other.element, CANCELLED, self.tokens.pop(other)[0])
        for place in [place for place, info in self.scopes.items() if (place[0], info.instance) == key[:2]]:
            del self.scopes[place]

    def forget_closed_scopes(self) -> None:
        """Drop the scopes that hold no token, and whose inner scopes hold none."""
        needed: set[tuple[int, int]] = set()
        for key in self.tokens:
            place = (key.robot, key.scope)
            while place in self.scopes and place not in needed:
                needed.add(place)
                place = (key.robot, self.scopes[place].parent)
        roots = {place for place, info in self.scopes.items() if info.parent == NOWHERE}
        self.scopes = {place: info for place, info in self.scopes.items() if place in needed or place in roots}

    def to_json(self) -> dict[str, Any]:
        """The state, fit for JSON."""
        return {
            "tokens": [[*key, *held] for key, held in self.tokens.items()],
            "counts": [[*key, *counts] for key, counts in self.counts.items() if any(counts)],
            "scopes": [_scope_row(place, info) for place, info in self.scopes.items()],
            "variables": [[*place, dict(values)] for place, values in self.variables.items()],
            "waits": [[robot, list(waits.values())] for robot, waits in self.waits.items()],
            "poses": [[robot, pose] for robot, pose in self.poses.items()],
            "world": dict(self.world),
        }


def _scope_row(place: tuple[int, int], info: ScopeInfo) -> list[int]:
    return [*place, info.instance, info.parent, info.opener, info.depth]


COLUMNS = ("t", "r", "i", "s", "e", "w")
"""Of events: time, robot, instance, scope, element, kind."""


class Block:
    """One block: the state at its start, and the events and changes after it."""

    number: int
    start: int
    end: int
    key: Mapping[str, Any]

    def __init__(self, number: int, start: int, key: Mapping[str, Any]) -> None:
        self.number, self.start, self.end, self.key = number, start, start, key
        self.columns: dict[str, list[int]] = {name: [] for name in COLUMNS}
        self.details: dict[int, Any] = {}
        self.lists: dict[str, list[Change]] = {name: [] for name in LISTS}

    @property
    def events(self) -> int:
        """The number of its events."""
        return len(self.columns["t"])

    @property
    def full(self) -> bool:
        """Whether it is large enough."""
        return self.events >= SIZE or sum(map(len, self.lists.values())) >= ITEMS

    def to_json(self, sent: Mark | None = None) -> dict[str, Any]:
        """Everything in it, fit for JSON, or what has come since `sent`."""
        first, lists = (0, dict.fromkeys(LISTS, 0)) if sent is None else sent
        found: dict[str, Any] = {"number": self.number, "start": self.start, "end": self.end, "first": first}
        found["at"] = dict(lists)
        if sent is None:
            found["key"] = self.key
        found |= {name: values[first:] for name, values in self.columns.items()}
        found["d"] = {str(place): detail for place, detail in self.details.items() if place >= first}
        return found | {name: values[lists[name] :] for name, values in self.lists.items()}

    def mark(self) -> Mark:
        """The current size, for `to_json`."""
        return Mark(self.events, {name: len(values) for name, values in self.lists.items()})


LISTS = ("scopes", "variables", "waits", "messages", "poses", "world")
"""Changes besides events; each begins with its time, but for scopes."""


class Mark(NamedTuple):
    """The part of a block that a page has: number of events, and of entries of each list."""

    events: int
    lists: Mapping[str, int]


class Packer:
    """Cut events and changes, given in order of time, into blocks."""

    state: State

    def __init__(self, catalogue: Catalogue, robots: Iterable[str] = ()) -> None:
        self.catalogue = catalogue
        self.robots: list[str] = []
        self._robot: dict[str, int] = {}
        for robot in robots:
            self.robot(robot)
        self.state = State()
        self.blocks: list[Block] = [Block(0, 0, self.state.to_json())]

    @property
    def end(self) -> int:
        """The time of the last entry."""
        return self.blocks[-1].end

    def robot(self, name: str) -> int:
        """The number of a robot."""
        number = self._robot.setdefault(name, len(self.robots))
        if number == len(self.robots):
            self.robots.append(name)
        return number

    def _block(self, time: int) -> Block:
        """The block for a new entry. Entries of one instant are in one block."""
        block = self.blocks[-1]
        if block.full and time > block.end:
            self.state.forget_closed_scopes()
            block = Block(len(self.blocks), time, self.state.to_json())
            self.blocks.append(block)
        block.end = max(block.end, time)
        return block

    # ---- what happened -----------------------------------------------------------------------------------------------

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """A message of one of the channels of a recording (docs/recordings.md)."""
        if topic == EVENTS:
            for group in data["events"]:
                self.events(time, data["robot"], group["instance"], group["scope"], group["marks"])
        elif topic == VARIABLES:
            for change in data["changes"]:
                if change.get("gone"):
                    self.close_scope(time, data["robot"], change["scope"])
                else:
                    values, gone = change.get("set", {}), change.get("unset", ())
                    self.variables(time, data["robot"], change["scope"], values, gone)
        elif topic == WAITING:
            self.waits(time, data["robot"], data["tokens"], data["gone"])
        elif topic == KEY:
            self.key(time, data)
        elif topic == WORLD:
            for entity in data["entities"]:
                self.pose(time, entity["id"], scene_value(entity, "appearance"))
        elif topic == GROUND:
            self.world(time, "ground", scene_value(data["entities"][0], "ground"))

    def events(self, time: int, robot: str, instance: int, scope: int, marks: Iterable[Sequence[Any]]) -> None:
        """Add events of a scope: (element, what) or (element, what, detail)."""
        block, state = self._block(time), self.state
        number, columns = self.robot(robot), block.columns
        t, r, i, s, e, w = (columns[name] for name in COLUMNS)
        info: ScopeInfo | None = None
        for element, word, *detail in marks:
            what = _WHAT.get(word)
            if what is None:
                continue
            if info is None or what == _END:
                info = self._scope(block, number, instance, scope, element, what)
            place = self.catalogue.number(info.file, element) if element else NOWHERE
            if detail and detail[0] is not None:
                block.details[len(t)] = detail[0]
            t.append(time)
            r.append(number)
            i.append(instance)
            s.append(scope)
            e.append(place)
            w.append(what)
            state.event(time, TokenKey(number, instance, scope, place), what)

    def key(self, time: int, data: Mapping[str, Any]) -> None:
        """Set the complete state of robots, as in ``/fame/key``: for a robot that joins later, and after a gap."""
        self.state = State(poses=self.state.poses, world=self.state.world)
        for name, robot in data["robots"].items():
            self._synchronise(time, self.robot(name), robot)
        block = Block(len(self.blocks), time, self.state.to_json())
        if not self.blocks[-1].events and len(self.blocks) == 1:
            block.number = 0
            self.blocks[0] = block
        else:
            self.blocks.append(block)

    def _synchronise(self, time: int, robot: int, data: Mapping[str, Any]) -> None:
        state = self.state
        for token in data["tokens"]:
            number = next(iter(self.catalogue.candidates(token["element"])), NOWHERE)
            place = TokenKey(robot, token["instance"], token["scope"], number)
            held = state.tokens.setdefault(place, [0, token["since"]])
            held[0] += 1
            openers = [next(iter(self.catalogue.candidates(id)), NOWHERE) for id in token["path"]]
            file = self.catalogue.elements[number].file if number != NOWHERE else 0
            opener = openers[-1] if openers else NOWHERE
            state.scopes[robot, token["scope"]] = ScopeInfo(token["instance"], file, NOWHERE, opener, len(openers))
            state.waits.setdefault(robot, {})[token["key"]] = {**token, "e": number}
        for change in data["variables"]:
            values = {name: [value, time] for name, value in change.get("set", {}).items()}
            state.variables[robot, change["scope"]] = values
        for id, counts in data["counts"].items():
            number = next(iter(self.catalogue.candidates(id)), NOWHERE)
            completed = counts.get("leave", 0) + counts.get("take", 0)
            state.counts[robot, number] = [completed, counts.get("fail", 0), counts.get("cancel", 0)]

    def variables(self, time: int, robot: str, scope: int, values: Mapping[str, Any], gone: Iterable[str] = ()) -> None:
        """Add changed and removed variables of a scope."""
        number = self.robot(robot)
        known = self.state.variables.setdefault((number, scope), {})
        known.update((name, [value, time]) for name, value in values.items())
        removed = [name for name in gone if known.pop(name, None) is not None]
        self._block(time).lists["variables"].append([time, number, scope, dict(values), removed])

    def close_scope(self, time: int, robot: str, scope: int) -> None:
        """The variables of a scope are gone with it."""
        number = self.robot(robot)
        if self.state.variables.pop((number, scope), None) is not None:
            self._block(time).lists["variables"].append([time, number, scope, None, []])

    def waits(self, time: int, robot: str, tokens: Sequence[Mapping[str, Any]], gone: Sequence[str] = ()) -> None:
        """Add changes of what the tokens of a robot wait for."""
        number = self.robot(robot)
        known = self.state.waits.setdefault(number, {})
        for key in gone:
            known.pop(key, None)
        shown = [{**token, "e": self._place(number, token)} for token in tokens]
        known.update((token["key"], token) for token in shown)
        self._block(time).lists["waits"].append([time, number, shown, list(gone)])

    def message(self, time: int, topic: str, sender: str, content: Any) -> None:
        """Add a published message. Large values are shortened."""
        self._block(time).lists["messages"].append([time, topic, sender, json.loads(json_text(content))])

    def pose(self, time: int, robot: str, pose: Mapping[str, Any]) -> None:
        """Set the ``appearance`` of a simulated robot (docs/recordings.md)."""
        number = self.robot(robot)
        self.state.poses[number] = pose
        self._block(time).lists["poses"].append([time, number, pose])

    def world(self, time: int, name: str, value: Any) -> None:
        """Set the state of the ground."""
        self.state.world[name] = value
        self._block(time).lists["world"].append([time, name, value])

    def _place(self, robot: int, token: Mapping[str, Any]) -> int:
        """The element that a token waits at."""
        info = self.state.scopes.get((robot, token["scope"]))
        if info is not None:
            return self.catalogue.number(info.file, token["element"])
        return next(iter(self.catalogue.candidates(token["element"])), NOWHERE)

    # ---- scopes ------------------------------------------------------------------------------------------------------

    def _scope(self, block: Block, robot: int, instance: int, scope: int, element: str, what: int) -> ScopeInfo:
        """What is known of a scope; of a new one, what its first element tells."""
        info = self.state.scopes.get((robot, scope))
        if info is None:
            info = self._new_scope(robot, instance, element, what)
            if what not in (_END,) and scope:
                self.state.scopes[robot, scope] = info
                block.lists["scopes"].append(_scope_row((robot, scope), info))
        return info

    def _new_scope(self, robot: int, instance: int, element: str, what: int) -> ScopeInfo:
        elements, candidates = self.catalogue.elements, self.catalogue.candidates(element)
        if not candidates:
            return ScopeInfo(instance, 0)
        if what in (_START, _END):
            return ScopeInfo(instance, elements[candidates[0]].file)
        openers = [key for key in reversed(self.state.tokens) if key[:2] == (robot, instance)]
        for key in openers:
            opened = elements[key.element].element
            inside = self.catalogue.called.get(key.element) if isinstance(opened, CallActivity) else key.element
            for candidate in candidates:
                if inside is not None and elements[candidate].body == inside:
                    around = self.state.scopes.get((robot, key.scope))
                    depth = around.depth + 1 if around is not None else 1
                    return ScopeInfo(instance, elements[candidate].file, key.scope, key.element, depth)
        return self._unopened(robot, instance, candidates)

    def _unopened(self, robot: int, instance: int, candidates: Sequence[int]) -> ScopeInfo:
        """A scope that no token opened: that of an event sub-process, or one whose opener is not recorded."""
        elements = self.catalogue.elements
        roots = [
            (place, info)
            for place, info in self.state.scopes.items()
            if place[0] == robot and info.instance == instance
        ]
        for candidate in candidates:
            file, _, body = elements[candidate]
            if body != NOWHERE and isinstance(elements[body].element, SubProcess):
                for place, info in reversed(roots):
                    if info.file == file:
                        return ScopeInfo(instance, file, place[1], body, info.depth + 1)
        file = elements[candidates[0]].file
        return ScopeInfo(instance, file, roots[0][0][1] if roots else NOWHERE, NOWHERE, 1 if roots else 0)


def scene_value(entity: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A value of FAME's own in the metadata of a scene entity."""
    found: dict[str, Any] = json.loads(next((pair["value"] for pair in entity["metadata"] if pair["key"] == key), "{}"))
    return found
