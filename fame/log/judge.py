"""Judge the properties of a team from a log: a recording (``.mcap``), events alone, or a bag of ROS.

A recording has its models and the values that properties read: variables, the signals, positions in a simulated world;
messages of sensors and batteries if all topics were recorded. A log of events alone needs a model.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import pools_of
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.log.channels import EVENTS, PROPERTIES, VARIABLES
from fame.log.event_logs import read_event_log
from fame.log.recorded_events import EventRow, RecordedEvents
from fame.log.recording import RecordedMessage, Recording, models_of
from fame.log.team_judge import TeamJudge, team_of
from fame.properties import Judge, Judgement, Monitor, Property, compile
from fame.properties.vocabulary import Vocabulary
from fame.robot.events import ENDED

_NO_ORDER = "the log lacks the order of one instant"


def judge_log(
    path: str | Path,
    properties: Sequence[Property],
    model: Definitions | None = None,
    *,
    team: Vocabulary | None = None,
    apart: int = 0,
    columns: Mapping[str, str] = MappingProxyType({}),
    is_open: bool = False,
) -> list[Judgement]:
    """Return the judgements about a log; `model` is that of a log of events alone, `team` what is
    known of the team of a run.

    `columns` are the names in an XES of another tool (`fame.log.xes_reading.COLUMNS`).
    `apart` (ns): how far the clocks of two robots of a recording may be apart. Each robot is also judged that much
    later; what is violated only as the clocks stand is not known. So is what an incomplete recording does not violate,
    unless it `is_open`: its run has written all of it, and ends it once it is judged.
    Raises ConfigError for a file that is no log, and for properties that name what its team does not have.
    """
    if Path(path).suffix.lower() == ".mcap":
        with Recording(path) as recording:
            judgements = _replay(recording, properties, model, team)
            for robot in sorted(team.robots) if team is not None and apart else ():
                others = _replay(recording, properties, model, team, late={robot: apart})
                judgements = [_unordered(one, apart) if one.verdict == "violated" != other.verdict else one
                         for one, other in zip(judgements, others, strict=True)]  # fmt: skip
            if is_open or not recording.lack:
                return judgements
            lacking = f"the recording is {recording.lack}"
            return [_not_known(one, lacking) if one.verdict != "violated" else one for one in judgements]
    if model is None:
        raise ConfigError("has no model: expected one beside the properties, NAME.bpmn of NAME.properties.yaml",
                          file=str(path))  # fmt: skip
    return _judge_events(Path(path), properties, model, columns)


def _unordered(judgement: Judgement, apart: int) -> Judgement:
    return _not_known(judgement, f"violated as the clocks stand, and not if they are {apart / SECOND:g} s apart")


def _not_known(judgement: Judgement, text: str) -> Judgement:
    return replace(judgement, verdict="not known", slack=None, time=None, text=text, began=None, elements=())


def _judge_events(
    path: Path, properties: Sequence[Property], model: Definitions, columns: Mapping[str, str]
) -> list[Judgement]:
    log = read_event_log(path, model, columns)
    robots, files = team_of_model(model)
    team = team_of({**robots, **log.processes}, files or [model])
    monitors = [compile(each, team) for each in properties]
    happened = any(row["what"] not in ("start", "end", ENDED) for row in log.rows)
    missing = team.robots.keys() - (log.processes.keys() if happened else set())
    judgements = _judged_rows(log, log.rows, monitors, missing)
    if log.reordered:
        others = _judged_rows(log, log.reordered, monitors, missing)
        judgements = [one if one.verdict == other.verdict else _not_known(one, _NO_ORDER)
                 for one, other in zip(judgements, others, strict=True)]  # fmt: skip
    for place, monitor in enumerate(monitors):
        named = [row for row in log.rows if _concerns(monitor, row)]
        if not all(log.has_order(list(rows)) for _, rows in groupby(named, itemgetter("time"))):
            judgements[place] = _not_known(judgements[place], _NO_ORDER)
        lacking = next((text for _, element, what in monitor.events if (text := log.lacks(element, what))), "")
        if lacking:
            judgements[place] = _not_known(judgements[place], f"such a log does not say {lacking}")
    return judgements


def _concerns(monitor: Monitor, row: EventRow) -> bool:
    reactions = monitor.events.get((row["robot"], row.get("element", ""), row["what"]), ())
    return any(each.fits(row["what"], row.get("detail")) for each in reactions)


def _judged_rows(
    log: RecordedEvents, rows: Iterable[EventRow], monitors: Sequence[Monitor], missing: Iterable[str]
) -> list[Judgement]:
    judge = Judge(monitors)
    last = max((row["time"] for row in rows), default=0)
    for robot in sorted(log.partly):
        judge.lose(robot, f"the log does not have all of {robot}")
    for robot in sorted(missing):
        judge.lose(robot, f"nothing of {robot} is in the log")
    at_end = [row for row in rows if row["time"] == last]
    stopped = dict.fromkeys(log.cancelled, True)
    kept = [row for row in at_end[::-1] if not _is_stop(stopped, row["robot"], row["instance"], row)]
    for row in (*(row for row in rows if row["time"] < last), *kept[::-1]):
        judge.event(row["time"], row["robot"], row.get("element", ""), row["what"], row.get("detail"))
    return judge.finish(last, complete=log.complete)


def _is_stop(stopped: dict[Any, bool], robot: str, instance: Any, mark: Mapping[str, Any]) -> bool:
    """Whether an event of the last instant stopped a run: an instance that was cancelled, and what ran in it.

    To be asked from the last one on: `stopped` keeps for each instance whether all after it was part of that.
    """
    ends = mark["what"] == "end" and mark.get("detail") == "cancelled"
    stopped[robot, instance] = stopped.get((robot, instance), ends) and (ends or mark["what"] == "cancel")
    return stopped[robot, instance]


def _without_stop(messages: Iterable[RecordedMessage]) -> dict[str, deque[dict[str, Any]]]:
    """The events of each robot in the last instant, without those that stopped the run."""
    by_robot, stopped = defaultdict[str, deque[dict[str, Any]]](deque), dict[Any, bool]()
    for data in reversed([message.json() for message in messages]):
        robot, groups = str(data["robot"]), deque[dict[str, Any]]()
        for group in reversed(data["events"]):
            marks = deque[Any]()
            for mark in reversed(group["marks"]):
                named = dict(zip(("element", "what", "detail"), mark, strict=False))
                if not _is_stop(stopped, robot, group["instance"], named):
                    marks.appendleft(mark)
            groups.appendleft({**group, "marks": marks})
        by_robot[robot].appendleft({**data, "events": groups})
    return by_robot


def _replay(
    recording: Recording, properties: Sequence[Property], model: Definitions | None, team: Vocabulary | None,
    late: Mapping[str, int] = MappingProxyType({}),
) -> list[Judgement]:  # fmt: skip
    """Pass all of a recording to a judge, and ask it. `late`: by how much a robot's messages are taken later (ns)."""
    last = recording.state(recording.end)
    judge = TeamJudge(properties, team, measured="clocks" in recording.metadata)
    if team is None:
        processes, models = team_of_model(model)
        processes |= {robot: state.process for robot, state in last.robots.items()}
        processes |= {robot: each[0].process for robot, each in recording.runs.items() if each}
        judge.meet(processes, [*models_of(recording), *models])
    end = int(recording.metadata.get("end", recording.end))
    ended = recording.metadata.get(ENDED)
    at_end = _without_stop(recording.messages((EVENTS,), start=end))
    for time, message in _delayed(recording, late):
        if not message.topic.startswith("/fame/"):
            type = recording.topics[message.topic].type
            judge.message(time, message.topic, type, message.node, partial(recording.decode, message))
        elif message.topic != PROPERTIES:
            data = message.json()
            if message.topic == EVENTS and message.time >= end:
                data = at_end[str(data["robot"])].popleft()
            judge.put(message.topic, time, data)
    return judge.finish(
        end + max(late.values(), default=0), complete=ended == "complete" or (ended is None and not last.runs)
    )


def _delayed(recording: Recording, late: Mapping[str, int]) -> Iterable[tuple[int, RecordedMessage]]:
    """The messages of a recording and when they are taken: those of some robots later (ns)."""
    if not late:
        return ((message.time, message) for message in recording.messages())
    delayed = list[tuple[int, RecordedMessage]]()
    for message in recording.messages():
        robot = message.node.strip("/").rpartition("/")[0]
        if message.topic in (EVENTS, VARIABLES):
            robot = str(message.json()["robot"])
        delayed.append((message.time + late.get(robot, 0), message))
    return sorted(delayed, key=lambda one: one[0])


def team_of_model(model: Definitions | None) -> tuple[dict[str, str], list[Definitions]]:
    """Return the robots that a model names and their processes (ids), and its files; nothing without a model."""
    if model is None:
        return {}, []
    pools, library = pools_of(model), Library()
    homes = {home.file: home for pool in pools for home, _ in library.closure(model, pool.process)}
    return {pool.name: pool.process.id for pool in pools if not pool.multi_instance}, list(homes.values())
