"""The page of a run in this process, during the run and after it: the content of a recording, as blocks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import groupby, zip_longest
from operator import itemgetter
from pathlib import Path
from typing import Any

from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.deploy.migration import Foreseen
from fame.errors import ConfigError, FameError
from fame.fast_json import json_bytes
from fame.log import Recording
from fame.log.channels import EVENTS, VARIABLES
from fame.log.recorder import Recorder
from fame.log.recording import team_order
from fame.scenario import Scenario
from fame.scenario.migrating import migrate_run
from fame.scenario.run import Run
from fame.view.catalogue import Catalogue
from fame.view.control import COMMANDS, RunControl, can_be_steered, faults_of
from fame.view.mission import Chip, mission_json, place_of
from fame.view.sink import VERSIONS, PageSink

_MOVES = frozenset(("enter", "leave", "cancel", "fail", "start", "end"))
_TICK = SECOND // 10
_COMPARED = (EVENTS, VARIABLES)
"""What a run that is repeated has in common with the recorded one."""


class LiveRun(PageSink):
    """The source of a page that shows a run. `observer` and `control` are for `Scenario.run`."""

    def __init__(self, scenario: Scenario, control: RunControl, *, title: str = "") -> None:
        bodies = [robot.name for robot in scenario.world.robots] if scenario.world is not None else []
        super().__init__(Catalogue(scenario.closures(), scenario.library.find), team_order(scenario.cast, bodies))
        self.control_of_run = control
        self._title = title or Path(scenario.file).stem
        self._scenario = scenario
        self._ended = self._failure = ""
        self._repeats = control.pause_at
        self._version = next(VERSIONS)
        self._changed = False  # whether the robots have gone over to another model
        self._time = 0
        self._lost: dict[str, int] = {}  # robots whose engine is gone, and since when (ns)
        self.observer: Recorder = Recorder(lambda: self, files=[model.file for model in self.catalogue.files])
        self._run: Run | None = None
        self.listen: Callable[[int, str, Mapping[str, Any]], object] | None = None

    # ---- the run -----------------------------------------------------------------------------------------------------

    attended = True

    def advance(self, run: Run, until: int) -> None:
        """As `fame.scenario.run.Pace` says: `control` decides."""
        if self._run is not run:  # its robots are there, and what can fail of them
            self._run, self._version = run, next(VERSIONS)
        self.control_of_run.advance(run, until)
        self._time = run.scheduler.now
        for robot in run.dead - self._lost.keys():
            self._lost[robot] = self._time

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        if topic in _COMPARED:  # parts of them are encoded
            data = json.loads(json_bytes(data))
        super().put(topic, time, data)
        self._time = max(self._time, time)
        if self.listen is not None:
            self.listen(time, topic, data)
        if topic == EVENTS:
            self._on_events(data)

    def _on_events(self, data: Mapping[str, Any]) -> None:
        marks = [mark for group in data["events"] for mark in group["marks"]]
        entered = {number for mark in marks if mark[1] == "enter" for number in self.catalogue.candidates(mark[0])}
        self.control_of_run.on_events(entered, any(mark[1] in _MOVES for mark in marks))

    def migrate(self, run: Run, plan: Scenario) -> Mapping[str, Foreseen]:
        """Let the robots go over to the model of another plan, and show it. In the thread of the run; raises FameError.

        Returns what becomes of each robot, as `fame.scenario.migrating.migrate_run` does.
        """
        files = plan.closures()
        known = self.observer.files
        known += [model.file for model in files if model.file not in known]
        return migrate_run(run, plan, partial(self._show, plan, files))

    def _show(self, plan: Scenario, files: Sequence[Definitions]) -> None:
        """Show another plan, which its robots have now: the elements of the one before stay, for what has been."""
        with self._lock:
            catalogue, packer = self.catalogue, self._packer
            numbers = {model.file: number for number, model in enumerate(catalogue.files)}
            sources = {file: catalogue.files[number].source for file, number in numbers.items()}
            new = [model for model in files if sources.get(model.file) != model.source]
            numbers |= {model.file: number for number, model in enumerate(new, len(catalogue.files))}
            catalogue.extend(new, plan.library.find)
            for robot in plan.cast:
                packer.run(packer.robot(robot), [numbers[file] for file in self.observer.files])
            self._scenario, self._changed = plan, True
            self._version = next(VERSIONS)
        self.observer.take_over(plan.cast)

    @property
    def time(self) -> int:
        """How far it has come (ns)."""
        return self._time

    def hand_over(self) -> None:
        """Give pages the controls: the run has come to where commands begin."""
        self._repeats = None
        self._version = next(VERSIONS)

    def end(self, status: str, failure: str = "") -> None:
        """End the run, with a status; `failure` says why it could not be run."""
        self._failure = failure
        if self.observer.begun and not failure:  # which may have come in the middle of a record
            self.observer.finish()
        self._ended = status
        self._version = next(VERSIONS)
        self.control_of_run.finish()

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        version = self._version  # before the content: what changes in between is news
        with self._lock:
            found = mission_json(
                "live",
                self._title,
                self.catalogue,
                self._packer.robots,
                chips=self._chips(),
                blocks=self._packer.index(),
                end=max(self._packer.end, self._time),
                control=[] if self._ended or self._repeats is not None else list(COMMANDS),
                faults=faults_of(self._run) if self._run is not None else [],
                messages=True,
                version=version,
            )
            for number, robot in enumerate(found["robots"] if self._changed else ()):
                robot |= place_of(self._packer, number, self._scenario.cast[robot["name"]].process.id)
            return found

    def _chips(self) -> list[Chip]:
        state: Chip = (
            (self._ended, self._ended, "how the run ended") if self._ended else ("live", "live", "the run lasts")
        )
        return [state, (f"seed {self._scenario.seed}", "", "seed of all noise")]

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        with self._lock:
            return self.growth(known, self._status(), self._version)

    def _status(self) -> dict[str, Any]:
        control = self.control_of_run
        return {
            "type": "run",
            "time": self._time // _TICK * _TICK if not control.paused and not self._ended else self._time,
            "paused": control.paused,
            "speed": control.speed,
            "over": bool(self._ended),
            "stopped": control.stopped,
            "repeats": self._repeats,
            "failure": self._failure,
            "breakpoints": sorted(control.breakpoints),
            "lost": dict(self._lost),
        }

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        if self._ended:
            raise FameError(self._failure or "the run is over")
        if command.get("do") in ("breakpoint", "run_to"):
            known, element = len(self.catalogue.elements), command.get("element")
            if not (isinstance(element, int) and 0 <= element < known):
                raise FameError(f"expected the number of an element from 0 to {known - 1}, got {element!r}")
        said = self.control_of_run.ask(command)
        if command["do"] != "take_over" or self._run is None:
            return {"said": said}
        return {"said": said, "steers": can_be_steered(self._run, str(command["robot"]))}


class SameRun:
    """Lets a recorded run go on again to a time (ns), and compares it with what was recorded until then.

    If both are the same, `live` then hands over to its pages. It is a `fame.scenario.run.Pace`, and raises ConfigError
    with the first difference. Reports of elements are not compared: another version of FAME has others.
    """

    attended = True

    def __init__(self, recording: Recording, time: int, live: LiveRun) -> None:
        self._file, self._time, self._live, self._reached = recording.file, time, live, False
        messages = ((each.time, each.topic, each.json()) for each in recording.messages(_COMPARED, end=time))
        steps = ((at, topic, data["robot"], found) for at, topic, data in messages if (found := _steps(topic, data)))
        self._recorded = ((at, _by_robot(all_of_it)) for at, all_of_it in groupby(steps, itemgetter(0)))
        self._now: list[_Steps] = []  # of one instant
        self._run: Run | None = None
        live.listen = self._compare

    def advance(self, run: Run, until: int) -> None:
        """Go on; once the time has come, as `live` says."""
        self._run = run
        self._live.advance(run, until)
        if not self._reached and (run.scheduler.now >= self._time or run.over):
            self._check()
            missing = next(self._recorded, None)
            if missing is not None:
                raise self._difference(*missing, {})
            self._reached, self._live.listen = True, None
            self._live.hand_over()

    def _compare(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        if topic not in _COMPARED or time > self._time or (self._run is not None and self._run.interrupted):
            return
        if found := _steps(topic, data):
            if self._now and self._now[0][0] != time:
                self._check()
            self._now.append((time, topic, data["robot"], found))

    def _check(self) -> None:
        """Compare an instant, robot by robot: versions of FAME differ in the order of robots inside one."""
        if self._now:
            time, now = self._now[0][0], _by_robot(self._now)
            at, recorded = next(self._recorded, (time, {}))
            if at != time:
                raise self._difference(min(time, at), recorded if at < time else {}, now if time < at else {})
            if recorded != now:
                raise self._difference(time, recorded, now)
            self._now.clear()

    def _difference(self, time: int, recorded: _Instant, now: _Instant) -> ConfigError:
        place = next(each for each in (*recorded, *now) if recorded.get(each) != now.get(each))
        lines = (_lines(*place, of.get(place, [])) for of in (recorded, now))
        text = f"the run again is not the recorded one: at {time / SECOND:g} s {_first_difference(*lines)}"
        return ConfigError(text, file=self._file)


_Steps = tuple[int, str, str, list[Any]]
"""Time (ns), topic and robot of a message, and what it tells."""
_Instant = Mapping[tuple[str, str], list[Any]]
"""What happened in an instant, by topic and robot."""


def _by_robot(steps: Iterable[_Steps]) -> _Instant:
    """The steps of an instant, by topic and robot."""
    by_topic: dict[tuple[str, str], list[Any]] = {}
    for _, topic, robot, told in steps:
        by_topic.setdefault((topic, robot), []).extend(told)
    return by_topic


def _steps(topic: str, data: Mapping[str, Any]) -> list[Any]:
    """The changes of a message of variables, or the events of one without reports of elements, each with its place."""
    if topic == VARIABLES:
        return [{**each, "gone": False} for each in data["changes"] if "set" in each or "unset" in each]
    return [
        ({key: value for key, value in group.items() if key != "marks"}, mark)
        for group in data["events"]
        for mark in group["marks"]
        if not (mark[0] and mark[1] == "report")
    ]


def _first_difference(recorded: list[str], now: list[str]) -> str:
    """The first difference of two messages, in words."""
    for was, is_now in zip_longest(recorded, now, fillvalue="nothing more"):
        if was != is_now:
            return f"expected {was}, got {is_now}"
    return "expected other instances or scopes"


def _lines(topic: str, robot: str, steps: list[Any]) -> list[str]:
    """The lines of what a robot did in an instant."""
    if topic == VARIABLES:
        changes = [(name, value) for change in steps for name, value in change.get("set", {}).items()]
        return [f"{robot} {line}" for name, value in changes for line in _leaves(name, value)]
    return [" ".join([robot, *(str(part) for part in mark if part)]) for _, mark in steps]


def _leaves(name: str, value: Any) -> list[str]:
    """The values inside a value, one a line."""
    if isinstance(value, dict):
        return [line for key, inner in value.items() for line in _leaves(f"{name}.{key}", inner)]
    return [f"{name} = {json.dumps(value)}"]
