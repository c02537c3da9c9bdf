"""Judges a team by the messages of a recording, in the order of time, while it is made or when it is read.

Theory of operation. `TeamJudge` gives a `Judge` what properties are about: events, messages, and samples of variables,
batteries and positions. It also tells it where the recording is no proof, so that a judgement is not known:

- *Clocks.* Between robots whose clocks may be apart, the order of events is in doubt (`Judge.doubt`). A recording that
  measured clocks has messages that say by how much.
- *Losses.* What a robot did may be missing: batches were lost, its engine restarted, the recording began in the middle
  of its mission, or has nothing of it (`Judge.lose`). A key of the recording gives the state of the robot behind the
  gap. Nothing was missed if no property reads values or the log of the robot, and that state counts the same as the
  one before of all that properties name (`_missed`).

A judge of a live team may end, and another one, perhaps of another process, goes on from what it has `kept`: it takes
that up, and compares what each robot had done then with its state as soon as it sees the robot again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from fame.bpmn.library import closure
from fame.bpmn.model import CallActivity, Definitions, Process
from fame.log.channels import CLOCKS, EVENTS, KEY, VARIABLES, WORLD
from fame.log.recording import scene_values
from fame.log.team_state import TeamState
from fame.middleware.interface import ENGINE, TopicInfo
from fame.properties import Judge, Judgement, Property, compile
from fame.properties.conditions import RobotPosition, ValueSource, field_of
from fame.properties.vocabulary import Closure, RobotTerms, Vocabulary, vocabulary
from fame.robot.plain_values import with_numbers
from fame.robot.robot_state import RobotState

BATTERY = "sensor_msgs/msg/BatteryState"


class TeamJudge:
    """Gives the messages of a recording to a judge.

    team      what is known of the team of a run; without it, `meet` has to be called before the first message
    measured  whether the doubt of clocks comes with the messages; a clock is not known until then
    whole     whether what a robot did before the first message counts
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
        team = team_of(processes, models)
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


def team_of(processes: Mapping[str, str], models: Sequence[Definitions]) -> Vocabulary:
    """Return the vocabulary of robots with these processes (ids)."""
    known = {process.id: (model, process) for model in reversed(models) for process in model.processes}

    def find(home: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
        here = home.process(call.called) if call.called else None
        return (home, here) if here is not None else known.get(call.called)

    closures: dict[str, Closure] = {robot: closure(*known[id], find) for robot, id in processes.items() if id in known}
    return vocabulary(closures, models)


def reads(judge: Judge, info: TopicInfo) -> bool:
    """Return whether a judge needs the messages of a topic: properties name it, or the battery that publishes it."""
    batteries = (ValueSource("battery", name.split("/")[1]) for name in info.publishers if info.types[:1] == (BATTERY,))
    return info.name in judge.topics or any(battery in judge.sources for battery in batteries)
