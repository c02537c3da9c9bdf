"""Judge the properties of a team from a log: a recording (``.mcap``), events alone, or a bag of ROS.

A recording has its models and the values that properties read: variables, the signals, positions in a simulated world;
messages of sensors and batteries if all topics were recorded. A log of events alone needs a model.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fame.bpmn.library import Library, closure
from fame.bpmn.model import CallActivity, Definitions, Process
from fame.bpmn.pools import pools_of
from fame.clock import SECOND
from fame.errors import ConfigError
from fame.log.channels import CLOCKS, EVENTS, KEY, PROPERTIES, VARIABLES, WORLD
from fame.log.conversion import models_of
from fame.log.event_logs import read_event_log
from fame.log.recorded_events import EventRow, RecordedEvents
from fame.log.recording import RecordedMessage, Recording, scene_values
from fame.log.team_state import TeamState
from fame.middleware.interface import ENGINE, TopicInfo
from fame.properties import Judge, Judgement, Monitor, Property, compile
from fame.properties.conditions import RobotPosition, ValueSource, field_of
from fame.properties.vocabulary import Closure, RobotTerms, Vocabulary, vocabulary
from fame.robot.events import ENDED
from fame.robot.plain_values import with_numbers
from fame.robot.robot_state import RobotState

_NO_ORDER = "the log lacks the order of one instant"
BATTERY = "sensor_msgs/msg/BatteryState"


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
            found = _replay(recording, properties, model, team)
            for robot in sorted(team.robots) if team is not None and apart else ():
                others = _replay(recording, properties, model, team, late={robot: apart})
                found = [_unordered(one, apart) if one.verdict == "violated" != other.verdict else one
                         for one, other in zip(found, others, strict=True)]  # fmt: skip
            if is_open or not recording.lack:
                return found
            lacking = f"the recording is {recording.lack}"
            return [_not_known(one, lacking) if one.verdict != "violated" else one for one in found]
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
    team = _team_of({**robots, **log.processes}, files or [model])
    monitors = [compile(each, team) for each in properties]
    missing = team.robots.keys() - log.processes.keys()
    found = _judged_rows(log, log.rows, monitors, missing)
    if log.reordered:
        others = _judged_rows(log, log.reordered, monitors, missing)
        found = [one if one.verdict == other.verdict else _not_known(one, _NO_ORDER)
                 for one, other in zip(found, others, strict=True)]  # fmt: skip
    for place, one in enumerate(monitors):
        named = [row for row in log.rows if _concerns(one, row)]
        if not all(log.has_order(list(rows)) for _, rows in groupby(named, itemgetter("time"))):
            found[place] = _not_known(found[place], _NO_ORDER)
        lacking = next((text for _, element, what in one.events if (text := log.lacks(element, what))), "")
        if lacking:
            found[place] = _not_known(found[place], f"such a log does not say {lacking}")
    return found


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
    found, stopped = defaultdict[str, deque[dict[str, Any]]](deque), dict[Any, bool]()
    for data in reversed([message.json() for message in messages]):
        robot, groups = str(data["robot"]), deque[dict[str, Any]]()
        for group in reversed(data["events"]):
            marks = deque[Any]()
            for mark in reversed(group["marks"]):
                named = dict(zip(("element", "what", "detail"), mark, strict=False))
                if not _is_stop(stopped, robot, group["instance"], named):
                    marks.appendleft(mark)
            groups.appendleft({**group, "marks": marks})
        found[robot].appendleft({**data, "events": groups})
    return found


def _team_of(processes: Mapping[str, str], models: Sequence[Definitions]) -> Vocabulary:
    """The vocabulary of robots with these processes (ids)."""
    known = {process.id: (model, process) for model in reversed(models) for process in model.processes}

    def find(home: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
        here = home.process(call.called) if call.called else None
        return (home, here) if here is not None else known.get(call.called)

    closures: dict[str, Closure] = {robot: closure(*known[id], find) for robot, id in processes.items() if id in known}
    return vocabulary(closures, models)


class TeamJudge:
    """Gives the messages of a recording to a judge, in the order of time, while it is made or when it is read.

    `team` is what is known of the team of a run; without it, `meet` has to be called before the first message.
    `measured`: whether the doubt of clocks comes with the messages; a clock is not known until then. `whole`: whether
    what a robot did before the first message counts.
    """

    judge: Judge

    def __init__(
        self, properties: Sequence[Property], team: Vocabulary | None = None, *, measured: bool, whole: bool = True
    ) -> None:
        self._properties, self._measured, self._whole = properties, measured, whole
        self._seen: set[str] = set()
        self._heard: dict[str, int] = {}  # when each robot did something (ns)
        self._expected: set[str] = set()
        self._robots: dict[str, RobotState] = {}  # what each has done so far
        self._taken_up: dict[str, dict[str, Any]] = {}  # what robots had done that were not seen since
        self.judge = Judge([])
        if team is not None:
            self._use(Judge([compile(each, team) for each in properties]), team)

    def meet(self, processes: Mapping[str, str], models: Sequence[Definitions]) -> None:
        """Use the names of robots with these processes (ids). Raises ConfigError for a property with another name."""
        team = _team_of(processes, models)
        monitors = [compile(each, team) for each in self._properties]
        if self._expected - team.robots.keys():
            return  # of what was taken up, some robots are still to come
        if self._expected:
            self.judge.adopt(monitors)
        self._use(self.judge if self._expected else Judge(monitors), team)

    def kept(self) -> dict[str, Any]:
        """Return what it has to keep, as plain data: another one goes on from it (`take_up`),
        perhaps in another process."""
        team = self._team.part({(robot, element) for robot, element, _ in self._named})
        done = {robot: self._done(robot, state) for robot, state in self._robots.items()}
        return {
            "robots": {robot: asdict(terms) for robot, terms in team.robots.items()},
            "pools": dict(team.pools),
            "judge": self.judge.kept(),
            "done": {**self._taken_up, **done},
        }

    def take_up(self, kept: Mapping[str, Any]) -> None:
        """Go on from what another one has kept."""
        team = Vocabulary({robot: RobotTerms(**terms) for robot, terms in kept["robots"].items()}, kept["pools"])
        self._use(Judge([compile(each, team) for each in self._properties]), team)
        self.judge.take_up(kept["judge"])
        self._taken_up = dict(kept["done"])

    def _done(self, robot: str, state: RobotState) -> dict[str, Any]:
        """What a robot has done of what properties name, as far as its state has it."""
        named = [(element, what) for one, element, what in self._named if one == robot]
        done: dict[str, Any] = {f"{what} {id}": state.marks_of(id)[what] for id, what in named}
        if any(what in ("start", "end") for _, what in named):
            done["instances"] = {str(number): status for number, (_, status) in state.instances.items()}
        return done

    def _missed(self, robot: str, state: RobotState) -> bool:
        """Whether a robot with this state may have done something that properties name and this judge did not see."""
        if any(one == robot and what == "log" for one, _, what in self._named):
            return True
        if any(source.subject == robot for source in self.judge.sources):
            return True
        before = self._taken_up.get(robot) or self._done(robot, self._robots.get(robot, RobotState()))
        return any(value and value != before.get(name) for name, value in self._done(robot, state).items())

    def _use(self, judge: Judge, team: Vocabulary) -> None:
        self.judge, self._team = judge, team
        self._named = {key for one in judge.monitors for key in one.events}
        for robot in sorted(team.robots.keys() - self._expected):
            judge.doubt(robot, None)
        self._expected |= team.robots.keys()
        self._reads: dict[str, list[ValueSource]] = {}
        for source in judge.sources:
            if source.kind == "variable":
                self._reads.setdefault(source.subject, []).append(source)
        self._batteries = {one.subject for one in judge.sources if one.kind == "battery"}
        self._poses = {one.subject for one in judge.sources if one.kind == "pose" and not one.name}

    def _see(self, robots: Iterable[str]) -> None:
        """Note that something of robots was recorded."""
        for robot in sorted({*robots} - self._seen):
            self._seen.add(robot)
            if not self._measured:
                self.judge.doubt(robot, 0)

    def finish(self, time: int, *, complete: bool) -> list[Judgement]:
        """Return the judgements at the end of what was recorded."""
        for robot in sorted(self._expected - self._seen):
            self.judge.lose(robot, f"nothing of {robot} was recorded")
        return self.judge.finish(time, complete=complete)

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Take a message of FAME's own channels."""
        self.judge.advance(time)
        if topic == EVENTS:
            self._take_events(time, data)
        elif topic == VARIABLES:
            self._take_variables(time, data)
        elif topic == WORLD:
            self._take_world(time, data)
        elif topic == KEY:
            self._take_gaps(data)
        elif topic == CLOCKS:
            self.judge.doubt(data["robot"], data["doubt"])

    def _take_events(self, time: int, data: Mapping[str, Any]) -> None:
        robot, marks = str(data["robot"]), [mark for group in data["events"] for mark in group["marks"]]
        if marks and all(mark[1] == "report" for mark in marks):  # by who records
            return
        self._see([robot])
        self._heard[robot] = time
        self._robots.setdefault(robot, RobotState()).apply(EVENTS, data, time)
        for mark in marks:
            element, what, detail = (*mark, None)[:3]
            self.judge.event(time, robot, element, what, detail)
        self._read(time, robot)

    def _take_variables(self, time: int, data: Mapping[str, Any]) -> None:
        robot, changes = str(data["robot"]), data["changes"]
        state = self._robots.setdefault(robot, RobotState())
        state.apply(VARIABLES, {"changes": [{**each, "gone": False} for each in changes]}, time)
        self._read(time, robot)  # also what an instance has set as it ended
        state.apply(VARIABLES, {"changes": [each for each in changes if each.get("gone")]}, time)

    def _read(self, time: int, robot: str) -> None:
        """Sample the variables of the instance that started last."""
        state = self._robots.get(robot)
        if state is not None and robot in self._reads:
            whole = {scope.instance: scope.values for scope in state.scopes.values() if not scope.parent}
            if whole:
                values, names = whole[max(whole)], {source.name for source in self._reads[robot]}
                sampled = {name: with_numbers(values[name]) for name in names & values.keys()}
                self.judge.variables(time, self._reads[robot], max(whole), sampled)

    def _take_world(self, time: int, data: Mapping[str, Any]) -> None:
        for robot, look in scene_values(data) if self._poses else ():
            if robot in self._poses:
                place = RobotPosition(look["x"], look["y"], look.get("altitude", 0.0))
                self.judge.sample(time, ValueSource("pose", robot), place)

    def message(self, time: int, topic: str, type: str, node: str, content: Callable[[], Any]) -> None:
        """Take a message of the mission, which `node` (full name) published."""
        sender, _, name = node.strip("/").rpartition("/")
        if topic in self.judge.topics:
            self.judge.message(time, sender if name == ENGINE else "", topic, content())
        if sender in self._batteries and type == BATTERY:
            self.judge.sample(time, ValueSource("battery", sender), field_of(content(), ("percentage",)))

    def _take_gaps(self, data: Mapping[str, Any]) -> None:
        """What was lost, and robots that were in the middle of their missions when the recording began."""
        for robot, lost in data.get("gaps", {}).items():
            state = RobotState.from_key(data["robots"][robot])
            known = self._robots.get(robot, RobotState())
            if not state.process and TeamState(robots={robot: known}).runs:
                why = f"the engine of {robot} restarted, and its mission is lost"
                self.judge.lose(robot, why, self._heard.get(robot, 0))
            elif (lost or robot in self._taken_up) and self._missed(robot, state):
                why = f"{lost} batches of {robot} were lost" if lost else f"{robot} was not watched for a while"
                self.judge.lose(robot, why, self._heard.get(robot, 0))
            self._taken_up.pop(robot, None)
            self._robots[robot] = state
        for robot in sorted(data["robots"].keys() - self._seen):
            if self._whole and data["robots"][robot]["instances"]:
                self.judge.lose(robot, f"the recording does not have the beginning of {robot}")
        for robot in data["robots"].keys() - self._robots.keys():
            self._robots[robot] = RobotState.from_key(data["robots"][robot])
        self._see(data["robots"])


def reads(judge: Judge, info: TopicInfo) -> bool:
    """Return whether a judge needs the messages of a topic: properties name it, or the battery that publishes it."""
    batteries = (ValueSource("battery", name.split("/")[1]) for name in info.publishers if info.types[:1] == (BATTERY,))
    return info.name in judge.topics or any(battery in judge.sources for battery in batteries)


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
    found = list[tuple[int, RecordedMessage]]()
    for message in recording.messages():
        robot = message.node.strip("/").rpartition("/")[0]
        if message.topic in (EVENTS, VARIABLES):
            robot = str(message.json()["robot"])
        found.append((message.time + late.get(robot, 0), message))
    return sorted(found, key=lambda one: one[0])


def team_of_model(model: Definitions | None) -> tuple[dict[str, str], list[Definitions]]:
    """Return the robots that a model names and their processes (ids), and its files; nothing without a model."""
    if model is None:
        return {}, []
    pools, library = pools_of(model), Library()
    homes = {home.file: home for pool in pools for home, _ in library.closure(model, pool.process)}
    return {pool.name: pool.process.id for pool in pools if not pool.multi_instance}, list(homes.values())
