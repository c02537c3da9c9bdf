"""Judge the properties of a team from a log: a recording (``.mcap``), or events alone (``.jsonl``, ``.csv``).

A recording has its models and the values that properties read: variables, the signals, positions in a simulated world;
messages of sensors and batteries if all topics were recorded. A log of events alone needs a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.bpmn.library import closure
from fame.bpmn.model import CallActivity, Definitions, Process
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.log.channels import EVENTS, KEY, VARIABLES, WORLD
from fame.log.conversion import models_of
from fame.log.reading import rows_of
from fame.log.recording import RecordedMessage, Recording, scene_values
from fame.middleware.interface import ENGINE
from fame.properties import Judge, Judgement, Monitor, Property, compile
from fame.properties.conditions import Pose, Source
from fame.properties.vocabulary import Closure, Vocabulary, vocabulary

BATTERY = "sensor_msgs/msg/BatteryState"


def judge_log(
    path: str | Path,
    properties: Sequence[Property],
    model: Definitions | None = None,
    *,
    team: Vocabulary | None = None,
) -> list[Judgement]:
    """The judgements about a log; `model` is that of a log of events alone, `team` what is known of the team of a run.

    Raises ConfigError for a file that is no log, and for properties that name what its team does not have.
    """
    if Path(path).suffix.lower() == ".mcap":
        with Recording(path) as recording:
            return _Replay(recording, properties, team).judgements()
    if model is None:
        raise ConfigError("has no model: expected one beside the properties, NAME.bpmn of NAME.properties.yaml",
                          file=str(path))  # fmt: skip
    return _judge_events(path, properties, model)


def _judge_events(path: str | Path, properties: Sequence[Property], model: Definitions) -> list[Judgement]:
    with rows_of(path) as rows:
        events = [row for row in rows if row.get("robot")]
        robots = {str(row["robot"]): str(row["element"]) for row in events if row["what"] == "start"}
        judge = Judge(_compiled(properties, robots, [model]))
        last = max((round(float(row["time"]) * SECOND) for row in events), default=0)
        running: set[tuple[str, str]] = set()
        for row in events:
            time, robot, what, detail = round(float(row["time"]) * SECOND), row["robot"], row["what"], row.get("detail")
            instance = str(robot), str(row["instance"])
            if what in ("start", "end"):
                running.add(instance) if what == "start" else running.discard(instance)
            if not (time == last and _is_stop(what, detail)):
                judge.event(time, robot, row.get("element", ""), what, detail)
    return judge.finish(last, complete=not running)


def _is_stop(what: str, detail: Any) -> bool:
    """Whether this may be done to stop a run, if it happens at its end."""
    return what == "cancel" or (what == "end" and detail == "cancelled")


def _compiled(
    properties: Sequence[Property], processes: Mapping[str, str], models: Sequence[Definitions]
) -> list[Monitor]:
    """The monitors of properties for robots with these processes (ids). Raises ConfigError."""
    known = {process.id: (model, process) for model in reversed(models) for process in model.processes}

    def find(home: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
        here = home.process(call.called) if call.called else None
        return (home, here) if here is not None else known.get(call.called)

    closures: dict[str, Closure] = {robot: closure(*known[id], find) for robot, id in processes.items() if id in known}
    team = vocabulary(closures, models)
    return [compile(each, team) for each in properties]


class _Replay:
    """A recording that is given to a judge."""

    def __init__(self, recording: Recording, properties: Sequence[Property], team: Vocabulary | None) -> None:
        self._recording = recording
        last = recording.state(recording.end)
        played = {robot: state.process for robot, state in last.robots.items()}
        played |= {robot: runs[0].process for robot, runs in recording.runs.items() if runs}
        if team is None:
            self._judge = Judge(_compiled(properties, played, models_of(recording)))
        else:
            self._judge = Judge([compile(each, team) for each in properties])
            for robot in team.robots.keys() - last.robots.keys():
                self._judge.lose(robot, f"nothing of {robot} was recorded")
        self._scopes: dict[str, dict[int, dict[str, Any]]] = {}  # by robot and instance: variables of the process
        self._reads: dict[str, list[Source]] = {}
        for source in self._judge.sources:
            if source.kind == "variable":
                self._reads.setdefault(source.subject, []).append(source)
        self._batteries = {one.subject for one in self._judge.sources if one.kind == "battery"}
        self._poses = {one.subject for one in self._judge.sources if one.kind == "pose"}
        self._end = int(recording.metadata.get("end", recording.end))
        ended = recording.metadata.get("ended")
        running = any(status == "running" for one in last.robots.values() for _, status in one.instances.values())
        self._complete = ended == "complete" or (ended is None and not running)
        self._seen: set[str] = set()

    def judgements(self) -> list[Judgement]:
        """Give everything to the judge, and ask it."""
        for message in self._recording.messages():
            if message.topic == EVENTS:
                self._take_events(message)
            elif message.topic == VARIABLES:
                self._take_variables(message)
            elif message.topic == WORLD:
                self._take_world(message)
            elif message.topic == KEY:
                self._take_gaps(message.json())
            elif not message.topic.startswith("/fame/"):
                self._take_message(message)
        return self._judge.finish(self._end, complete=self._complete)

    def _take_events(self, message: RecordedMessage) -> None:
        data = message.json()
        robot = str(data["robot"])
        self._seen.add(robot)
        for mark in (mark for group in data["events"] for mark in group["marks"]):
            element, what, detail = (*mark, None)[:3]
            if not (message.time == self._end and _is_stop(what, detail)):
                self._judge.event(message.time, robot, element, what, detail)
        self._read(message.time, robot)

    def _take_variables(self, message: RecordedMessage) -> None:
        data = message.json()
        instances = self._scopes.setdefault(str(data["robot"]), {})
        for change in data["changes"]:
            if change["path"]:
                continue
            if change.get("gone"):
                instances.pop(change["instance"], None)
                continue
            variables = instances.setdefault(change["instance"], {})
            variables.update(change.get("set", {}))
            for name in change.get("unset", ()):
                variables.pop(name, None)
        self._read(message.time, str(data["robot"]))

    def _read(self, time: int, robot: str) -> None:
        """Sample the variables of the instance that started last."""
        instances = self._scopes.get(robot, {})
        for source in self._reads.get(robot, ()) if instances else ():
            variables = instances[max(instances)]
            if source.name in variables:
                self._judge.sample(time, source, variables[source.name])

    def _take_world(self, message: RecordedMessage) -> None:
        for robot, look in scene_values(message.json()) if self._poses else ():
            if robot in self._poses:
                place = Pose(look["x"], look["y"], look.get("altitude", 0.0))
                self._judge.sample(message.time, Source("pose", robot), place)

    def _take_message(self, message: RecordedMessage) -> None:
        sender, _, name = message.node.strip("/").rpartition("/")
        if message.topic in self._judge.topics:
            content = self._recording.decode(message)
            self._judge.message(message.time, sender if name == ENGINE else "", message.topic, content)
        if sender in self._batteries and self._recording.topics[message.topic].type == BATTERY:
            charge = self._recording.decode(message)["percentage"]
            self._judge.sample(message.time, Source("battery", sender), charge)

    def _take_gaps(self, data: Mapping[str, Any]) -> None:
        """What was lost, and robots that were in the middle of their missions when the recording began."""
        for robot, lost in data.get("gaps", {}).items():
            if lost:
                self._judge.lose(robot, f"{lost} batches of {robot} were lost")
        for robot in data["robots"].keys() - self._seen:
            if data["robots"][robot]["instances"]:
                self._judge.lose(robot, f"the recording does not have the beginning of {robot}")
        self._seen |= data["robots"].keys()
