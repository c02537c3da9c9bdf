"""Cuts a run into blocks that the page loads one by one, each of which can be shown without those before it.

A block begins with the state at its start: tokens, counts, variables, waits. Then come columns of events and lists of
changes, in order of time. At any instant the page shows the state at the start of a block, changed by what the block
has up to that instant. The page replays blocks as `RunState` does here; a test compares both.

Times are ns since the start of the run. Robots, elements and kinds of events are numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import partial
from operator import itemgetter
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

from fame.bpmn.model import SubProcess
from fame.closing import Closing
from fame.fast_json import json_bytes, json_value
from fame.log.channels import EVENTS, GROUND, KEY, PROPERTIES, VARIABLES, WAITING, WORLD
from fame.log.reading import tally
from fame.log.recording import scene_values
from fame.log.wait_reasons import wait_text
from fame.robot.plain_values import plain
from fame.robot.robot_state import ended_of
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.state import END, START, WHATS, RunState, ScopeInfo, TokenKey, scope_row

SIZE = 3000
"""Events after which a block is full. Replaying one takes the page less than a millisecond."""
ITEMS = 4000
"""Changes of variables, waits and poses after which a block is full."""
_WHAT = {what: number for number, what in enumerate(WHATS)}

ListChange = list[Any]
_Place = tuple[int, tuple[str, ...]]
"""Where a scope is: its instance, and the activities that it is inside (ids)."""

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
        found = json_value(self._stored())
        return _PARTS[name](found)

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
        found: dict[str, Any] = {"number": self.number, "start": self.start, "end": self.end, "first": first}
        found["at"] = dict(lists)
        if sent is None:
            found["key"] = self.key
        found |= {name: values[first:] for name, values in self.columns.items()}
        found["d"] = {str(place): detail for place, detail in self.details.items() if place >= first}
        return found | {name: values[lists[name] :] for name, values in self.lists.items()}

    def to_bytes(self) -> bytes:
        """Return the JSON of everything in it."""
        return json_bytes(self.to_json()) if self._stored is None else self._stored()

    def mark(self) -> BlockSize:
        """Return the current size, for `to_json`."""
        return BlockSize(self.events, {name: len(values) for name, values in self.lists.items()})


LISTS = ("scopes", "variables", "waits", "messages", "poses", "world", "properties")
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
    """Cuts events and changes, given in order of time, into blocks. `begun`: whether it had a key message."""

    state: RunState
    begun: bool

    def __init__(self, catalogue: Catalogue, robots: Iterable[str] = ()) -> None:
        self.catalogue = catalogue
        self.robots: list[str] = []
        self._robot: dict[str, int] = {}
        self._files: dict[int, Set[int]] = {}  # of robots that run files of their own
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

    def robot(self, name: str) -> int:
        number = self._robot.setdefault(name, len(self.robots))
        if number == len(self.robots):
            self.robots.append(name)
        return number

    def element(self, robot: int, id: str) -> int:
        """Return the number of an element of the files that a robot runs; NOWHERE if there is no such element."""
        return next(iter(self._candidates(robot, id)), NOWHERE)

    def _candidates(self, robot: int, id: str) -> Sequence[int]:
        """The elements with an id in the files that a robot runs; in any file if those have none."""
        found, files = self.catalogue.candidates(id), self._files.get(robot)
        own = [number for number in found if self.catalogue.elements[number].file in files] if files else ()
        return own or found

    def run(self, robot: int, files: Set[int]) -> None:
        """Note which files a robot runs from now on: other files, such as its last model, may use the same ids.

        What is known of its mission moves to the elements of these files with the same ids.
        """
        if not files or self._files.get(robot) == files:
            return
        self._files[robot] = files
        if self.blocks:
            self.state.move(robot, partial(self._moved, robot), partial(self._moved_file, robot))
            self._begin_block(self.end)

    def _moved(self, robot: int, number: int) -> int:
        """The element of the files that a robot runs with the id of another one, in a body with the same id."""
        if number < 0:
            return number
        elements = self.catalogue.elements
        _, element, body = elements[number]
        candidates = self._candidates(robot, element.id)
        inside = elements[body].element.id if body != NOWHERE else ""
        bodies = ((one, elements[one].body) for one in candidates)
        same = (one for one, around in bodies if around != NOWHERE and elements[around].element.id == inside)
        return next(same, next(iter(candidates), number))

    def _moved_file(self, robot: int, file: int) -> int:
        """The file that a robot runs in place of another one: that with the same process."""
        elements = self.catalogue.elements
        first = next((number for number, entry in enumerate(elements) if entry.file == file), NOWHERE)
        return elements[self._moved(robot, first)].file if first != NOWHERE else file

    def _block(self, time: int) -> Block:
        """The block for a new entry. Entries of one instant are in one block."""
        if not self.blocks or (self.blocks[-1].full and time > self.blocks[-1].end):
            self.state.forget_closed_scopes()
            self._begin_block(time)
        block = self.blocks[-1]
        block.end = max(block.end, time)
        return block

    def _begin_block(self, time: int) -> None:
        if self.store is not None and self.blocks:
            self.blocks[-1].store(self.store)
        self.blocks.append(Block(len(self.blocks), time, self.state.to_json()))

    # ---- what happened -----------------------------------------------------------------------------------------------

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Add a message of one of the channels of a recording (docs/recording_format.md)."""
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
            for name, pose in scene_values(data):
                self.pose(time, name, pose)
        elif topic == PROPERTIES:
            self.property(time, data)
        elif topic == GROUND:
            for name, ground in scene_values(data):
                self.world(time, name, ground)

    def events(self, time: int, robot: str, instance: int, scope: int, marks: Iterable[Sequence[Any]]) -> None:
        """Add events of a scope: (element, what) or (element, what, detail)."""
        block, state = self._block(time), self.state
        number, columns = self.robot(robot), block.columns
        t, r, i, s, e, w = (columns[name] for name in COLUMNS)
        info: ScopeInfo | None = None
        for mark in marks:
            element, what = mark[0], _WHAT.get(mark[1])
            if what is None:
                continue
            if info is None or what == END:
                info = self._scope(block, number, instance, scope, element, what)
            place = self.catalogue.number(info.file, element) if element else NOWHERE
            if len(mark) > 2 and mark[2] is not None:
                block.details[len(t)] = mark[2]
            t.append(time)
            r.append(number)
            i.append(instance)
            s.append(scope)
            e.append(place)
            w.append(what)
            if what == END:
                state.end(number, str(block.details.get(len(t) - 1, "completed")), time)
            if START < what <= END:
                state.event(time, TokenKey(number, instance, scope, place), what)

    def key(self, time: int, data: Mapping[str, Any]) -> None:
        """Set the state of robots as in ``/fame/key``: the first time of all, then of those that the changes left out.

        These have joined, started another process, or batches of them were lost.
        """
        changed = data.get("gaps", {}) if self.begun else data["robots"]
        if self.begun and not changed:
            return
        self.begun = True
        for name in changed:
            self._synchronise(time, self.robot(name), data["robots"][name])
        self._begin_block(time)
        self.blocks[-1].lists["properties"] += [[time, each] for each in self._declared]
        self._declared.clear()

    def _synchronise(self, time: int, robot: int, data: Mapping[str, Any]) -> None:
        state = self.state
        state.forget(robot)
        for change in data["variables"]:
            values = {name: [value, time] for name, value in change.get("set", {}).items()}
            state.variables[robot, change["scope"]] = values
        known = {_place(each): each["scope"] for each in data["variables"]}
        unknown: dict[_Place, int] = {}
        for token in data["tokens"]:
            number = self._place_token(robot, token, known, unknown)
            state.waits.setdefault(robot, {})[token["key"]] = _shown(token, number)
        over = all(instance["status"] != "running" for instance in data["instances"])
        statuses = [instance["status"] for instance in data["instances"] if instance["status"] != "running"]
        if statuses:
            ended = ended_of(data)
            state.ends[robot] = sum(ended.values()), ended.get("failed", 0), statuses[-1], -1
        for id, counts in data["counts"].items():
            done = tally(counts, over=over)
            number = self._number_in(robot, id, NOWHERE)
            state.counts[robot, number] = [done["completed"], done["failed"], done["cancelled"]]

    def _place_token(
        self, robot: int, token: Mapping[str, Any], known: Mapping[_Place, int], unknown: dict[_Place, int]
    ) -> int:
        """Put a waiting token, and one on each activity around it, where they are. Returns the number of its element.

        `known`: scopes that have variables. The tokens of activities are in scopes of `unknown` numbers.
        """
        state, (instance, path), since = self.state, _place(token), token["since"]
        around = outside = opener = NOWHERE
        for depth, id in enumerate((*path, token["element"])):
            number, place = self._number_in(robot, id, opener), (instance, path[:depth])
            by_path = unknown.setdefault(place, NOWHERE - 1 - len(unknown))
            scope = token["scope"] if depth == len(path) else known.get(place, by_path)
            if opener != NOWHERE and (robot, scope) not in state.scopes:
                state.add(TokenKey(robot, instance, outside, opener), since)
            info = ScopeInfo(instance, self.catalogue.elements[number].file, around, opener, depth)
            state.scopes.setdefault((robot, scope), info)
            state.scopes.setdefault((robot, by_path), info)
            around, outside, opener = scope, by_path, number
        state.add(TokenKey(robot, instance, around, opener), since)
        return opener

    def _number_in(self, robot: int, id: str, opener: int) -> int:
        """The element with an id, the one inside `opener` if there are several."""
        candidates, inside = self._candidates(robot, id), self.catalogue.called.get(opener, opener)
        found = next((one for one in candidates if self.catalogue.elements[one].body == inside), None)
        return found if found is not None else candidates[0] if candidates else self.catalogue.number(0, id)

    def variables(self, time: int, robot: str, scope: int, values: Mapping[str, Any], gone: Iterable[str] = ()) -> None:
        """Add changed and removed variables of a scope."""
        number = self.robot(robot)
        removed = self.state.change_variables(time, number, scope, values, gone)
        self._block(time).lists["variables"].append([time, number, scope, dict(values), removed])

    def close_scope(self, time: int, robot: str, scope: int) -> None:
        """Remove the variables of a scope that has ended."""
        number = self.robot(robot)
        if (number, scope) in self.state.variables:
            self.state.change_variables(time, number, scope, None)
            self._block(time).lists["variables"].append([time, number, scope, None, []])

    def waits(self, time: int, robot: str, tokens: Sequence[Mapping[str, Any]], gone: Sequence[str] = ()) -> None:
        """Add changes of what the tokens of a robot wait for."""
        number = self.robot(robot)
        shown = [_shown(token, self._place(number, token)) for token in tokens]
        self.state.change_waits(number, shown, gone)
        self._block(time).lists["waits"].append([time, number, shown, list(gone)])

    def message(self, time: int, topic: str, sender: str, content: Any) -> None:
        """Add a published message. Large values are shortened."""
        self._block(time).lists["messages"].append([time, topic, sender, plain(content)])

    def property(self, time: int, data: Mapping[str, Any]) -> None:
        """Add a change of a property: a judgement as in ``/fame/properties``, with numbers for robots and elements."""
        found = {
            name: [[self.robot(robot), self.element(self.robot(robot), id)] for robot, id in data[name]]
            for name in ("elements", "names")
            if name in data
        }
        if self.blocks:
            self._block(time).lists["properties"].append([time, {**data, **found}])
        else:  # before the first key
            self._declared.append({**data, **found})

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

    def _place(self, robot: int, token: Mapping[str, Any]) -> int:
        """The element that a token waits at."""
        info = self.state.scopes.get((robot, token["scope"]))
        if info is not None:
            return self.catalogue.number(info.file, token["element"])
        return self.element(robot, token["element"])

    # ---- scopes ------------------------------------------------------------------------------------------------------

    def _scope(self, block: Block, robot: int, instance: int, scope: int, element: str, what: int) -> ScopeInfo:
        """What is known of a scope; of a new one, what its first element tells."""
        info = self.state.scopes.get((robot, scope))
        if info is None:
            info = self._new_scope(robot, instance, element, what)
            if what != END and scope:
                self.state.scopes[robot, scope] = info
                block.lists["scopes"].append(scope_row((robot, scope), info))
        return info

    def _new_scope(self, robot: int, instance: int, element: str, what: int) -> ScopeInfo:
        elements, candidates = self.catalogue.elements, self._candidates(robot, element)
        if not candidates:
            return ScopeInfo(instance, 0)
        if what in (START, END):
            return ScopeInfo(instance, elements[candidates[0]].file)
        openers = [key for key in reversed(self.state.tokens) if key[:2] == (robot, instance)]
        for key in openers:
            inside = self.catalogue.called.get(key.element, key.element)
            for candidate in candidates:
                if elements[candidate].body == inside:
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


def _place(entry: Mapping[str, Any]) -> _Place:
    """Where a token or scope of a key message is."""
    return entry["instance"], tuple(entry["path"])


def _shown(token: Mapping[str, Any], element: int) -> dict[str, Any]:
    """A waiting token as the page has it: at an element (number), with words that need no other part of it."""
    return {**token, "e": element, "text": wait_text(token)}
