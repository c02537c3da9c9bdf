"""The page of a recording. A thread reads the recording and makes its blocks."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from math import inf
from operator import attrgetter
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from fame.bpmn.model import Definitions, Human
from fame.bpmn.reader import read
from fame.clock import SECOND
from fame.closing import Closing
from fame.errors import ConfigError, FameError, ModelError
from fame.fast_json import json_value
from fame.log import Recording
from fame.log.channels import CLOCKS, EVENTS, GROUND, KEY, PROPERTIES, VARIABLES, WAITING, WORLD
from fame.log.recording import RecordedMessage, team_order
from fame.log.team_state import shift_times
from fame.view.blocks import Block, BlockStore, Packer
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.mission import Chip, mission_json, place_of

_OWN = (EVENTS, VARIABLES, WAITING, WORLD, GROUND, PROPERTIES, CLOCKS)


class _Run(NamedTuple):
    """A robot runs a process (id) of some files of the catalogue after a time (ns)."""

    time: int
    robot: str
    process: str
    files: Sequence[int]


class Replay(Closing):
    """The source of a page that shows a recording. Raises ConfigError for a file that cannot be shown.

    `branch` answers the command *Branch here* of the page: with the files that would run, or, once these are agreed to,
    with the address of the page of the new run. It raises FameError. `monitor` is what a model of monitoring says of
    the recording (`fame.monitor.judge_report.on_page`), and `label` answers *Alarm was false*.
    """

    catalogue: Catalogue

    def __init__(
        self,
        path: str | Path,
        *,
        branch: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None,
        monitor: Mapping[str, Any] | None = None,
        label: Callable[[Mapping[str, Any]], Mapping[str, Any]] | None = None,
    ) -> None:
        self._branch, self._path, self._monitor, self._label = branch, Path(path), monitor, label
        with ExitStack() as opened:
            try:
                self._recording = opened.enter_context(Recording(path))
                self._store = opened.enter_context(BlockStore())
                self._ahead = opened.enter_context(self._recording.reopen())  # for what is asked for before it is read
                self._look()
            except _MALFORMED as error:
                text = f"has messages of another form than those of FAME ({type(error).__name__}: {error})"
                raise ConfigError(text, file=str(path)) from None
            self._opened = opened.pop_all()
        self._done = 0
        self._reading = 0.0
        self._failure = ""  # why the rest cannot be shown
        self._lock = threading.Lock()
        self._ahead_lock = threading.Lock()
        self._asked = 0  # answers that are being made
        self._pause_until = 0.0  # of the reader, on the monotonic clock
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, name="fame view: reader", daemon=True)
        self._thread.start()

    def _look(self) -> None:
        """Look at what the page needs first."""
        self.notices: list[str] = list(self._recording.warnings)
        self.catalogue = Catalogue(self._models())
        self._offset = self._recording.start if self._recording.start > _LONGEST else 0
        self._runs = self._read_runs()
        self._packer = Packer(self.catalogue, self._robots(), self._numbers(self._recording.models))
        self._packer.store = self._store
        self._elements = len(self.catalogue.elements)
        self._topics = [topic for topic in self._recording.topics if topic != KEY]

    def close(self) -> None:
        """Stop reading."""
        self._closed.set()
        self._thread.join()
        with self._ahead_lock:
            self._opened.close()
        gc.unfreeze()

    def wait(self) -> None:
        """Wait until everything is read."""
        self._thread.join()

    @property
    def blocks(self) -> Sequence[Block]:
        """What has been read."""
        return self._packer.blocks

    @property
    def missions(self) -> list[int]:
        """The files of the catalogue that robots ran, by number: not those that were only called."""
        numbers = {definitions.file: number for number, definitions in enumerate(self.catalogue.files)}
        named = [run.models[0] for each in self._recording.runs.values() for run in each if run.models]
        return sorted({numbers[name] for name in named if name in numbers}) or [*numbers.values()][:1]

    def _models(self) -> list[Definitions]:
        files = []
        for name, source in self._recording.models.items():
            try:
                files.append(read(source, file=name))
            except ModelError as error:
                self.notices.append(f"{name} is not shown: {error}")
        return files

    def _read_runs(self) -> list[_Run]:
        """What the robots ran, the latest first."""
        try:
            found = self._recording.runs
        except ConfigError as error:
            self.notices.append(error.text)
            return []
        runs = [
            _Run(time, robot, process, self._numbers(names))
            for robot, each in found.items()
            for time, process, names in each
        ]
        return sorted(runs, key=attrgetter("time"), reverse=True)

    def _numbers(self, names: Iterable[str]) -> Sequence[int]:
        """The numbers of models in the catalogue; NOWHERE for those that cannot be read."""
        numbers = {definitions.file: number for number, definitions in enumerate(self.catalogue.files)}
        return [numbers.get(name, NOWHERE) for name in names]

    def _switch(self, packer: Packer, pending: list[_Run], time: int) -> None:
        """Take from `pending` what robots run at a time (ns)."""
        while pending and pending[-1].time < max(time, self._recording.start + 1):
            run = pending.pop()
            packer.run(packer.robot(run.robot), run.files)

    def _drawings(self, robot: str) -> dict[str, Any]:
        """The pool of a robot with models of its own, and its drawings by the time (ns) after which each is shown."""
        packer, places = Packer(self.catalogue, [robot]), list[tuple[int, dict[str, Any]]]()
        for run in reversed(self._runs):
            if run.robot == robot:
                packer.run(0, run.files)
                places.append((run.time - self._offset, place_of(packer, 0, run.process)))
        return {**places[-1][1], "planes": [(time, place["plane"]) for time, place in places]} if places else {}

    def _robots(self) -> list[str]:
        """The robots: those of the world in its order, which gives them their colours, then the others."""
        return team_order(self._recording.robots, self._recording.world(self._recording.end))

    def _read(self) -> None:
        recording, packer = self._recording, self._packer
        length, pending, failure = max(recording.end - recording.start, 1), self._runs.copy(), ""
        try:
            for number, message in enumerate(recording.messages()):
                while self._pause_until > monotonic() and not self._closed.is_set():
                    self._closed.wait(_PAUSE / 4)
                if self._closed.is_set():
                    return
                if pending:
                    self._switch(packer, pending, message.time)
                if message.topic == KEY:  # the first has what was before the recording; most others repeat the rest
                    if not packer.begun or message.data.startswith(_GAPS):
                        self._put(packer, message)
                elif message.topic in _OWN:
                    self._put(packer, message)
                else:
                    self._message(message)
                if number % 256 == 0:
                    gc.freeze()  # blocks have no cycles: looking through millions of values would delay all answers
                    with self._lock:
                        self._done = max(0, len(packer.blocks) - 1)
                        self._reading = (message.time - recording.start) / length
        except Exception as error:  # whatever it is: the page must not take what was read for the whole
            text = str(error) if isinstance(error, FameError) else f"{type(error).__name__}: {error}"
            failure = f"the rest of the recording cannot be shown: {text}"
            self.notices.append(failure)
        with self._lock:
            self._done, self._reading, self._failure = len(packer.blocks), 1.0, failure

    def _put(self, packer: Packer, message: RecordedMessage) -> None:
        """A message of FAME's own channels."""
        content = shift_times(message.topic, json_value(message.data), -self._offset)
        packer.put(message.topic, message.time - self._offset, content)

    def _message(self, message: RecordedMessage) -> None:
        """A message of the mission."""
        try:
            content = self._recording.decode(message)
        except FameError as error:
            content = {"$cut": f"cannot be read: {error}"}
        sender = message.node.strip("/").partition("/")[0]
        self._packer.message(message.time - self._offset, message.topic, sender, content)

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        recording = self._recording
        with self._lock:
            done, reading, version = self._done, self._reading, self._failure
        found = mission_json(
            "recording",
            self._title(),
            self.catalogue,
            self._packer.robots,
            chips=self._chips(),
            notices=self.notices,
            blocks=self._packer.index(0, done),
            end=recording.end - self._offset,
            reading=reading,
            control=[*self._acts()],
            empty=["The recording has no models", "It shows timeline, variables and log, but no diagrams."],
            messages=not {*self._topics} <= {*_OWN},
            version=version,
        )
        if self._monitor is not None:
            found["monitor"] = {**self._monitor, "begin": self._offset}
        for robot in found["robots"]:
            robot |= self._drawings(robot["name"])
        return found

    def _title(self) -> str:
        scenario = self._recording.metadata.get("scenario", "")
        return Path(scenario).stem if scenario else self._path.stem

    def _chips(self) -> list[Chip]:
        about = self._recording.metadata
        chips: list[Chip] = [("recording", "", f"{self._path.name}, recorded by: {about.get('command', 'unknown')}")]
        if "seed" in about:
            chips.append((f"seed {about['seed']}", "", "seed of all noise"))
        if self._monitor is not None:
            chips.append(_verdict(self._monitor))
        return chips

    def plane(self, number: int) -> Mapping[str, Any]:
        return self.catalogue.plane_json(number)

    def block(self, number: int) -> bytes:
        with self._lock:
            if not 0 <= number < self._done:
                raise LookupError(number)
        return self._packer.blocks[number].to_bytes()

    def at(self, time: int) -> Mapping[str, Any]:
        """Return a block around an instant that has not been read yet, made of the last key before
        it. Raises LookupError.

        When something began is known no earlier than from that key.
        """
        first, moment = self._offset, time + self._offset
        with self._answering(), self._ahead_lock:
            recording = self._ahead
            key = recording.last(KEY, moment)
            if key is None:
                raise LookupError(time)
            packer = Packer(self.catalogue, self._packer.robots, self._numbers(recording.models))
            begin, pending = key.time - first, self._runs.copy()
            self._switch(packer, pending, key.time)
            ground = recording.ground(key.time)
            if ground:
                packer.world(begin, "ground", ground)
            for robot, pose in recording.world(key.time).items():
                packer.pose(begin, robot, pose)
            self._put(packer, key)
            until, past, last = time + SECOND, 0, key.time
            for message in recording.messages(_OWN, key.time, moment + SECOND):
                past += message.time > moment
                if past > _BEYOND and message.time > last:  # what happened in one instant stays together
                    until = message.time - first - 1
                    break
                last = message.time
                self._switch(packer, pending, message.time)
                self._put(packer, message)
        block = [block for block in packer.blocks if block.start <= time or block is packer.blocks[0]][-1]
        return {**block.to_json(), "number": NOWHERE, "until": until if block is packer.blocks[-1] else block.end}

    @contextmanager
    def _answering(self) -> Iterator[None]:
        """Make the reader pause while an answer is made, and until the page has drawn it."""
        with self._lock:
            self._asked += 1
            self._pause_until = inf
        try:
            yield
        finally:
            with self._lock:
                self._asked -= 1
                if not self._asked:
                    self._pause_until = monotonic() + _PAUSE

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        with self._lock:
            now = done, reading, failure = self._done, self._reading, self._failure
        if known == now:
            return known, []
        first, _, told = known if known is not None else (0, 0.0, "")
        news: dict[str, Any] = {
            "type": "index",
            "blocks": self._packer.index(first, done),
            "end": self._recording.end - self._offset,
            "reading": reading,
        }
        if len(self.catalogue.elements) > self._elements:
            news |= {"from": self._elements, "elements": self.catalogue.elements_json(self._elements)}
        return now, [news] if told == failure else [news, {"type": "reload", "version": failure}]

    def tasks(self, element: str) -> list[Human]:
        return self.catalogue.tasks(element)

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        act = self._acts().get(str(command.get("do")))
        if act is None:
            raise FameError("a recording cannot be controlled")
        return act(command)

    def _acts(self) -> dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]:
        """Return what a page can ask for, by the name of the command."""
        acts = {}
        if self._branch is not None and "seed" in self._recording.metadata:
            acts["branch"] = self._branch
        if self._label is not None and self._monitor is not None and self._monitor["alarms"]:
            acts["label"] = self._label
        return acts


def _verdict(monitor: Mapping[str, Any]) -> Chip:
    count, verdicts = len(monitor["alarms"]), monitor["verdicts"]
    if count:
        return f"{count} alarm{'s' if count > 1 else ''}", "failed", "; ".join(monitor["alarms"][0]["text"])
    known = bool(verdicts) and "not judged" not in verdicts
    return "no alarm" if known else "not judged", "completed" if known else "", f"by {monitor['model']}"


_GAPS = b'{"gaps"'
"""How a key begins that has more than the changes before it: of a robot that is new, or after batches were lost."""
_MALFORMED = (LookupError, TypeError, ValueError, AttributeError)
"""What messages of another form raise."""
_BEYOND = 100
"""Most messages of an answer after the instant that is asked for: the cursor may move on a little."""
_PAUSE = 0.08
"""Seconds that the reader leaves the processor to a page that has got an answer and draws it."""
_LONGEST = 365 * 24 * 3600 * SECOND
"""A recording whose times are later than this (ns) counts from another epoch: the page counts from its start."""
