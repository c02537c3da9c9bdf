"""Cuts a run into blocks that the page loads one by one, each of which can be shown without those before it.

A block begins with the state at its start: tokens, counts, variables, waits. Then come columns of events and lists of
changes, in order of time. At any instant the page shows the state at the start of a block, changed by what the block
has up to that instant, as `fame.robot.robot_state` does it; a test compares both.

Times are ns since the start of the run. Robots, elements and kinds of events are numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

from fame.bpmn.model import Definitions
from fame.closing import Closing
from fame.fast_json import json_bytes, json_value
from fame.log.channels import EVENTS, GROUND, KEY, PROPERTIES, VARIABLES, WAITING, WORLD
from fame.log.recording import scene_values
from fame.log.wait_chain import WaitChain, senders_of
from fame.log.wait_reasons import wait_text
from fame.robot.plain_values import plain
from fame.robot.robot_state import RobotState
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.state import WHATS, RunState, WaitCircle

SIZE = 3000
"""Events after which a block is full. Replaying one takes the page less than a millisecond."""
ITEMS = 4000
"""Changes of variables, waits and poses after which a block is full."""
_WHAT = {what: number for number, what in enumerate(WHATS)}

ListChange = list[Any]

COLUMNS = ("t", "r", "i", "s", "e", "w")
"""Of events: time, robot, instance, scope, element, kind."""


class BlockStore(Closing):
    """Keeps full blocks in a temporary file, packed: all topics of some minutes would fill any memory."""

    def __init__(self) -> None:
        import zstandard

        self._pack = zstandard.ZstdCompressor(level=1).compress
        self._unpack = zstandard.decompress
        self._file: IO[bytes] = TemporaryFile()  # noqa: SIM115 (`close` closes it)

    def keep(self, data: bytes) -> Callable[[], bytes]:
        """Write some bytes; return what reads them, in any thread."""
        packed, place = self._pack(data), self._file.tell()
        self._file.write(packed)
        self._file.flush()
        return lambda: self._unpack(os.pread(self._file.fileno(), len(packed), place))

    def close(self) -> None:
        self._file.close()


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
        self.lists: dict[str, list[ListChange]] = {name: [] for name in LISTS}
        self._stored: Callable[[], bytes] | None = None
        self._events: int | None = None  # of a stored one

    def store(self, store: BlockStore) -> None:
        """Leave memory: nothing comes any more. Each part is read again when it is asked for."""
        self._events, self._stored = self.events, store.keep(self.to_bytes())
        del self.key, self.columns, self.details, self.lists

    def __getattr__(self, name: str) -> Any:
        if name not in _PARTS or self._stored is None:
            raise AttributeError(name)
        content = json_value(self._stored())
        return _PARTS[name](content)

    @property
    def events(self) -> int:
        return len(self.columns["t"]) if self._events is None else self._events

    @property
    def full(self) -> bool:
        """Whether it is large enough."""
        return self.events >= SIZE or sum(map(len, self.lists.values())) >= ITEMS

    def to_json(self, sent: BlockSize | None = None) -> dict[str, Any]:
        """Everything in it, fit for JSON, or what has come since `sent`."""
        first, lists = (0, dict.fromkeys(LISTS, 0)) if sent is None else sent
        content: dict[str, Any] = {"number": self.number, "start": self.start, "end": self.end, "first": first}
        content["at"] = dict(lists)
        if sent is None:
            content["key"] = self.key
        content |= {name: values[first:] for name, values in self.columns.items()}
        content["d"] = {str(place): detail for place, detail in self.details.items() if place >= first}
        return content | {name: values[lists[name] :] for name, values in self.lists.items()}

    def to_bytes(self) -> bytes:
        """Return the JSON of everything in it."""
        return json_bytes(self.to_json()) if self._stored is None else self._stored()

    def mark(self) -> BlockSize:
        """Return the current size, for `to_json`."""
        return BlockSize(self.events, {name: len(values) for name, values in self.lists.items()})


LISTS = ("scopes", "variables", "waits", "circles", "messages", "poses", "world", "properties")
"""Changes besides events; the entries of all lists but scopes begin with their time."""


_PARTS: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "key": itemgetter("key"),
    "columns": lambda found: {name: found[name] for name in COLUMNS},
    "details": lambda found: {int(place): detail for place, detail in found["d"].items()},
    "lists": lambda found: {name: found[name] for name in LISTS},
}
"""The parts of a block, from its JSON."""


class BlockSize(NamedTuple):
    """The part of a block that a page has: number of events, and of entries of each list."""

    events: int
    lists: Mapping[str, int]


class Packer:
    """Cuts events and changes, given in order of time, into blocks. `begun`: whether it had a key message.

    `files` are the models of the run, as events number them: by default those of the catalogue.
    """

    state: RunState
    begun: bool

    def __init__(self, catalogue: Catalogue, robots: Iterable[str] = (), files: Sequence[int] | None = None) -> None:
        self.catalogue = catalogue
        self.robots: list[str] = []
        self._robot: dict[str, int] = {}
        self._all: Sequence[int] = range(len(catalogue.files)) if files is None else files
        self._files: dict[int, Sequence[int]] = {}  # of robots that run files of their own
        for robot in robots:
            self.robot(robot)
        self.state = RunState()
        self.begun = False
        self.blocks: list[Block] = []
        self.store: BlockStore | None = None
        """Where blocks go that are full; None: they stay in memory."""
        self._declared: list[Mapping[str, Any]] = []

    @property
    def end(self) -> int:
        """The time of the last entry; 0 without one."""
        return self.blocks[-1].end if self.blocks else 0

    def index(self, first: int = 0, until: int | None = None) -> list[list[int]]:
        """Number, start, end and number of events of the blocks from `first` on, before `until`."""
        return [[block.number, block.start, block.end, block.events] for block in self.blocks[first:until]]

    # ---- numbers -----------------------------------------------------------------------------------------------------

    def robot(self, name: str) -> int:
        number = self._robot.setdefault(name, len(self.robots))
        if number == len(self.robots):
            self.robots.append(name)
        return number

    def element(self, robot: int, id: str) -> int:
        """Return the number of an element of the files that a robot runs; NOWHERE if there is no such element."""
        candidates, files = self.catalogue.candidates(id), self._files.get(robot, self._all)
        own = [number for number in candidates if self.catalogue.elements[number].file in files]
        return next(iter(own or candidates), NOWHERE)

    def run(self, robot: int, files: Sequence[int]) -> None:
        """Note which files a robot runs from now on, as its events number them; NOWHERE is one that cannot be shown."""
        if files and self._files.get(robot) != files:
            self._files[robot] = files
            if self.blocks:
                self._begin_block(self.end)

    def _models(self, robot: int) -> list[Definitions]:
        """The models that a robot runs."""
        return [self.catalogue.files[file] for file in self._files.get(robot, self._all) if file != NOWHERE]

    def _number(self, robot: int, file: int, id: str) -> int:
        """The number of an element, by the number that a robot has for its file.

        A recorder may have other files than the robot, which runs one with all that it calls: then the id has to do.
        """
        if not id:
            return NOWHERE
        files = self._files.get(robot, self._all)
        here = self.catalogue.find(files[file], id) if file < len(files) else NOWHERE
        elsewhere = self.element(robot, id) if here == NOWHERE else here
        return elsewhere if elsewhere != NOWHERE else self.catalogue.number(0, id)

    def _scope_row(self, robot: int, scope: int) -> list[Any]:
        """A scope as the page gets it: robot, number, instance, scope around it, the elements in between, its depth."""
        state = self.state.robots[robot]
        known, depth = state.scopes[scope], len(state.path(scope))
        first, files = state.file_of(known.parent) if known.parent else known.file, [known.file] * len(known.inside)
        openers = [self._number(robot, *place) for place in zip([first, *files], known.inside, strict=False)]
        return [robot, scope, known.instance, known.parent or NOWHERE, openers, depth]

    def _shown(self, robot: int, token: Mapping[str, Any]) -> dict[str, Any]:
        """A waiting token as the page has it: at an element (number), with words that need no other part of it."""
        file = self.state.robot(robot).file_of(token["scope"])
        shown = {**token, "e": self._number(robot, file, token["element"]), "text": wait_text(token)}
        senders = {sender: topic for topic, found in senders_of(token).items() for sender in found}
        return {**shown, "senders": senders} if senders else shown

    # ---- blocks ------------------------------------------------------------------------------------------------------

    def _block(self, time: int) -> Block:
        """The block for a new entry. Entries of one instant are in one block."""
        if not self.blocks or (self.blocks[-1].full and time > self.blocks[-1].end):
            self._begin_block(time)
        block = self.blocks[-1]
        block.end = max(block.end, time)
        return block

    def _begin_block(self, time: int) -> None:
        if self.store is not None and self.blocks:
            self.blocks[-1].store(self.store)
        self.blocks.append(Block(len(self.blocks), time, self.key_json()))

    def key_json(self) -> dict[str, Any]:
        """Return the state, fit for JSON."""
        key: dict[str, Any] = {"poses": [[*each] for each in self.state.poses.items()], "world": dict(self.state.world)}
        key["circles"] = [[robot, circle.text] for robot, circle in self.state.circles.items()]
        rows: dict[str, list[Any]] = {
            name: key.setdefault(name, []) for name in ("tokens", "counts", "scopes", "variables", "waits", "ends")
        }
        for robot, state in self.state.robots.items():
            for (scope, element), held in state.active.items():
                instance = state.scopes[scope].instance if scope in state.scopes else 0
                rows["tokens"].append(
                    [robot, instance, scope, self._number(robot, state.file_of(scope), element), *held]
                )
            for file, element, outcomes in state.outcomes():
                if any(outcomes):
                    rows["counts"].append([robot, self._number(robot, file, element), *outcomes])
            rows["scopes"] += [self._scope_row(robot, scope) for scope in state.scopes]
            for scope, known in state.scopes.items():
                if known.values:
                    values = {name: [value, known.since[name]] for name, value in known.values.items()}
                    rows["variables"].append([robot, scope, values])
            rows["waits"].append([robot, [self._shown(robot, token) for token in state.tokens.values()]])
            if state.ended:
                last = [status for _, status in state.instances.values() if status != "running"][-1]
                number = sum(state.ended.values())
                rows["ends"].append([robot, number, state.ended.get("failed", 0), last, state.ended_at])
        return key

    # ---- what happened -----------------------------------------------------------------------------------------------

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Add a message of one of the channels of a recording (docs/recording_format.md)."""
        if topic in (EVENTS, VARIABLES, WAITING):
            _ROWS[topic](self, self._block(time), time, self.robot(data["robot"]), data)
        elif topic == KEY:
            self.key(time, data)
        elif topic == WORLD:
            for name, pose in scene_values(data):
                self.pose(time, name, pose)
        elif topic == PROPERTIES:
            self.property(time, data)
        elif topic == GROUND:
            for name, ground in scene_values(data):
                self.world(time, name, ground)

    def _events(self, block: Block, time: int, robot: int, data: Mapping[str, Any]) -> None:
        """Add events, and the scopes that open."""
        state = self.state.robot(robot)
        state.apply(EVENTS, data, time)
        for opened in data.get("opens", ()):
            block.lists["scopes"].append(self._scope_row(robot, opened["scope"]))
        columns = block.columns
        t, r, i, s, e, w = (columns[name] for name in COLUMNS)
        for group in data["events"]:
            instance, scope = group["instance"], group["scope"]
            file = state.file_of(scope)
            for mark in group["marks"]:
                what = _WHAT.get(mark[1])
                if what is None:
                    continue
                if len(mark) > 2 and mark[2] is not None:
                    block.details[len(t)] = mark[2]
                t.append(time)
                r.append(robot)
                i.append(instance)
                s.append(scope)
                e.append(self._number(robot, file, mark[0]))
                w.append(what)

    def _variables(self, block: Block, time: int, robot: int, data: Mapping[str, Any]) -> None:
        """Add changed and removed variables of scopes."""
        state, rows = self.state.robot(robot), block.lists["variables"]
        for change in data["changes"]:
            scope, values, gone = change["scope"], change.get("set", {}), change.get("unset", [])
            if change.get("gone"):
                if scope in state.scopes and state.scopes[scope].values:
                    rows.append([time, robot, scope, None, []])
            else:
                rows.append([time, robot, scope, dict(values), [*gone]])
        state.apply(VARIABLES, data, time)

    def _waits(self, block: Block, time: int, robot: int, data: Mapping[str, Any]) -> None:
        """Add changes of what tokens wait for."""
        shown = [self._shown(robot, token) for token in data["tokens"]]
        block.lists["waits"].append([time, robot, shown, [*data["gone"]]])
        self.state.robot(robot).apply(WAITING, data, time)
        if robot in self.state.circles or any(token.get("senders") for token in shown):
            for number in self._meet(robot):
                circle = self.state.circles.get(number)
                block.lists["circles"].append([time, number, circle.text if circle is not None else ""])

    def _meet(self, robot: int) -> list[int]:
        """See which robots wait for each other, as far as `robot` is one of them. Returns those that changed."""
        names, known = self.robots, self.state.circles
        states = {names[number]: state for number, state in self.state.robots.items()}
        chain = WaitChain(states, {names[number]: self._models(number) for number in self.state.robots})
        before, now = known.get(robot), chain.circle(names[robot])
        changed = []
        for name in dict.fromkeys([*(before.robots if before is not None else ()), *now]):
            number, robots = self.robot(name), chain.circle(name)
            circle = WaitCircle(robots, chain.circle_text(robots)) if robots else None
            if circle != known.pop(number, None):
                changed.append(number)
            if circle is not None:
                known[number] = circle
        return changed

    def key(self, time: int, data: Mapping[str, Any]) -> None:
        """Set the state of robots as in ``/fame/key``: the first time of all, then of those that the changes left out.

        These have joined, started another process, or batches of them were lost.
        """
        changed = data.get("gaps", {}) if self.begun else data["robots"]
        if self.begun and not changed:
            return
        self.begun = True
        for name in changed:
            self.state.robots[self.robot(name)] = RobotState.from_key(data["robots"][name], time)
        for name in changed:
            self._meet(self.robot(name))
        self._begin_block(time)
        self.blocks[-1].lists["properties"] += [[time, each] for each in self._declared]
        self._declared.clear()

    def message(self, time: int, topic: str, sender: str, content: Any) -> None:
        """Add a published message. Large values are shortened."""
        self._block(time).lists["messages"].append([time, topic, sender, plain(content)])

    def property(self, time: int, data: Mapping[str, Any]) -> None:
        """Add a change of a property: a judgement as in ``/fame/properties``, with numbers for robots and elements."""
        place = {
            name: [[self.robot(robot), self.element(self.robot(robot), id)] for robot, id in data[name]]
            for name in ("elements", "names")
            if name in data
        }
        if self.blocks:
            self._block(time).lists["properties"].append([time, {**data, **place}])
        else:  # before the first key
            self._declared.append({**data, **place})

    def pose(self, time: int, robot: str, pose: Mapping[str, Any]) -> None:
        """Set the ``appearance`` of a simulated robot (docs/recording_format.md)."""
        number = self.robot(robot)
        self.state.poses[number] = pose
        if self.blocks:  # the first block begins with all that was before it
            self._block(time).lists["poses"].append([time, number, pose])

    def world(self, time: int, name: str, value: Any) -> None:
        """Set the state of the ground."""
        self.state.world[name] = value
        if self.blocks:
            self._block(time).lists["world"].append([time, name, value])


_ROWS: Mapping[str, Callable[[Packer, Block, int, int, Mapping[str, Any]], None]] = {
    EVENTS: Packer._events,
    VARIABLES: Packer._variables,
    WAITING: Packer._waits,
}
"""What adds the rows of a message to a block."""
