"""Judge the properties of a scenario while it runs: an observer that samples what they read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.bpmn.model import Definitions
from fame.check.variables import variable_names
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.engine.data import own_copy
from fame.engine.state import Instance, Trail
from fame.errors import MessageError
from fame.log.channels import PROPERTIES
from fame.log.property_watch import Alarm
from fame.log.team_judge import reads
from fame.log.team_state import Put
from fame.middleware import messages
from fame.middleware.interface import ENGINE, TopicInfo
from fame.properties.conditions import RobotPosition, ValueSource, field_of
from fame.properties.judge import Judge
from fame.properties.judgement import ABSENT, Judgement
from fame.properties.monitor import Monitor, compile
from fame.properties.vocabulary import CheckField, Vocabulary, vocabulary_of
from fame.robot.events import Event, Observer
from fame.robot.services import RunningService, ServiceContext
from fame.text import suggestion

if TYPE_CHECKING:
    from fame.middleware.local import LocalMiddleware
    from fame.robot import RobotNode
    from fame.scenario.plan import Plan
    from sim2d.world import World

_LOOK = SECOND // 20
BATTERY = "sensor_msgs/msg/BatteryState"


def team_vocabulary(plan: Plan, check_field: CheckField = lambda topic, path: "") -> Vocabulary:
    """Return the vocabulary of a scenario. Raises ModelError for a called process that is not found."""
    values = (value for each in plan.properties for part in each.condition for value in (part.left, part.right))
    reads = any(value.kind == "variable" for value in values)
    variables = _variables(plan.definitions, plan) if reads else {}  # to look for them takes as long as to read a model
    return vocabulary_of(
        plan.definitions, plan.library.declared, plan.cast, variables=variables, check_field=check_field
    )


def _variables(definitions: Definitions, plan: Plan) -> dict[str, frozenset[str]]:
    """The process variables of each robot, of those of which all are known."""
    known = {
        id: variable_names(definitions, id, plan.library.declared) for id in {p.process.id for p in plan.cast.values()}
    }
    names_of = {robot: known[pool.process.id] for robot, pool in plan.cast.items()}
    return {robot: names for robot, names in names_of.items() if names is not None}


def topics_read(plan: Plan) -> Callable[[TopicInfo], bool]:
    """Return what says whether the properties of a scenario read a topic. Raises as `team_vocabulary`."""
    vocabulary = team_vocabulary(plan)
    return partial(reads, Judge([compile(each, vocabulary) for each in plan.properties]))


class RunJudge(Observer):
    """Judges the properties of a plan. `begin` is called when nodes and world are there, before the first token moves.

    `report` gets each violation: a time is that of the violation, not that at which it was noticed.
    """

    judge: Judge

    def __init__(self, plan: Plan, report: Callable[[Judgement], object]) -> None:
        self._plan, self._report = plan, report
        self._nodes: dict[str, RobotNode] = {}
        self._reads: dict[str, list[ValueSource]] = {}
        self._changed: dict[str, None] = {}  # in the order of their changes
        self._instances: dict[str, list[Instance]] = {}  # the last one of each robot: it may have ended since
        self._recordings: list[Put] = []
        self._seen: dict[str, tuple[float, float, float]] = {}

    def begin(self, middleware: LocalMiddleware, world: World | None) -> None:
        """Compile the properties, and sample what they read. Raises ConfigError for an unknown name in one."""
        vocabulary = team_vocabulary(self._plan, partial(_wrong_field, middleware))
        self.judge = Judge([compile(each, vocabulary) for each in self._plan.properties], self._report)
        self._middleware, self._world = middleware, world
        for source in self.judge.sources:
            if source.kind == "variable":
                self._reads.setdefault(source.subject, []).append(source)
        self._batteries = {source.subject for source in self.judge.sources if source.kind == "battery"}
        here = (one.subject for one in self.judge.sources if one.kind == "pose" and not one.name)
        self._bodies = [robot for robot in here if self._has_body(robot)]
        if self.judge.topics or self._batteries:
            middleware.tap(self._tap)
        if world is not None and self._bodies:
            from sim2d.scene import sampling

            every = sampling(world)
            world.watchers.append(lambda world: self.look() if world.steps % every == 0 else None)

    def record(self, put: Put) -> None:
        """Give each change to a recording."""
        for data in self.judge.declared():
            put(PROPERTIES, 0, data)
        self._recordings.append(put)
        self.judge.watch = self._watch

    def _watch(self, time: int, judgement: Judgement) -> None:
        for put in self._recordings:
            put(PROPERTIES, time, judgement.to_json())

    def _has_body(self, robot: str) -> bool:
        return self._world is not None and robot in self._world.robots

    # ---- what happens ------------------------------------------------------------------------------------------------

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Take a robot; the result is called after each step of a script."""
        self._nodes[node.name] = node
        return partial(self.mark, node.name)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Take what happened at one instant."""
        self.judge.trail(time, robot, trail)
        self.mark(robot)

    def __call__(self, event: Event) -> None:
        if event.what in ("log", "end"):
            self.judge.event(event.time, event.robot, event.element, event.what, event.detail)

    def mark(self, robot: str) -> None:
        """Read the variables of a robot at the end of the instant."""
        if robot in self._reads:
            if not self._changed:
                self._middleware.scheduler.soon(self._read, Kind.WORLD)
            self._changed[robot] = None

    def _read(self) -> None:
        changed, self._changed = self._changed, {}
        now = self._middleware.scheduler.now
        for robot in changed:
            running = [*self._nodes[robot].engine.instances.values()][-1:]
            known = [*running, *self._instances.get(robot, ())]
            instance = max(known, key=lambda one: one.key, default=None)
            self._instances[robot] = running
            if instance is not None:
                sources, variables = self._reads[robot], instance.root_variables
                kept = {one.name: own_copy(variables[one.name]) for one in sources if one.name in variables}
                self.judge.variables(now, sources, instance.key, kept)

    def _tap(self, publisher: Any) -> Callable[[Any], object] | None:
        """Take the messages of a publisher, if a property reads them."""
        topic, node, scheduler = publisher.topic, publisher.node, self._middleware.scheduler
        if topic in self.judge.topics:
            robot = node.namespace if node.name == ENGINE else ""
            return lambda message: self.judge.message(scheduler.now, robot, topic, message)
        if publisher.type == BATTERY and node.namespace in self._batteries:
            source = ValueSource("battery", node.namespace)
            return lambda message: self.judge.sample(scheduler.now, source, float(message.percentage))
        return None

    def look(self) -> None:
        """Sample the positions of robots."""
        now = self._middleware.scheduler.now
        self.judge.advance(now)
        for robot in self._bodies if self._world is not None else ():
            body: Any = self._world.robots[robot]  # type: ignore[union-attr]
            # of robots of other packages only the appearance may say how high they are: it costs a drawing
            (x, y, _), altitude = (body.pose, body.altitude) if hasattr(body, "altitude") else body.appearance[:2]
            if self._seen.get(robot) != (x, y, altitude):
                self._seen[robot] = x, y, altitude
                self.judge.sample(now, ValueSource("pose", robot), pose(x, y, altitude))

    def judgements(self, *, complete: bool = False) -> list[Judgement]:
        """Return the judgements now, as if this instant were over; `complete`: and nothing came after it."""
        self._read()
        self.look()
        now = self._middleware.scheduler.now
        self.judge.advance(now + 1)
        return self.judge.judgements(now if complete else None)

    # ---- the end -----------------------------------------------------------------------------------------------------

    def finish(self, time: int, *, complete: bool) -> list[Judgement]:
        """Return the judgements at the end of the run; what is done to stop it is not judged."""
        self._read()
        self.look()
        return self.judge.finish(time, complete=complete)

    def never_judged(self) -> Iterator[tuple[Monitor, str]]:
        """Properties that no run of this team can judge, and why."""
        there = {info.name: info for info in self._middleware.graph()}
        batteries = {name.split("/")[1] for name, info in there.items() if info.types[:1] == (BATTERY,)}
        for monitor in self.judge.monitors:
            missing = [
                f"{source.subject} has no {'position' if source.kind == 'pose' else 'battery'} here"
                for source in sorted(monitor.sources)
                if (source.kind == "pose" and not source.name and source.subject not in self._bodies)
                or (source.kind == "battery" and source.subject not in batteries)
            ]
            if missing or not monitor.parts:
                yield monitor, missing[0] if missing else ABSENT


class RunWatches(Observer):
    """The properties that robots of a run watch (service ``watch_property``), each from when its task starts."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._nodes: list[RobotNode] = []
        self._watches: list[RunJudge] = []

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Take a robot."""
        self._nodes.append(node)
        return partial(self._mark, node.name)

    def _mark(self, robot: str) -> None:
        for watch in self._watches:
            watch.mark(robot)

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Take what happened at one instant."""
        for watch in self._watches:
            watch.trail(time, robot, trail)

    def __call__(self, event: Event) -> None:
        for watch in self._watches:
            watch(event)

    def start(
        self, middleware: LocalMiddleware, world: World | None, context: ServiceContext, variables: Mapping[str, Any]
    ) -> RunningService:
        alarm = Alarm(context, variables)
        plan = replace(self._plan, properties=(alarm.property,))

        def throw(judgement: Judgement) -> None:
            alarm.throw(str(judgement))
            context.changed()

        # not while an engine moves, perhaps this one
        watch = RunJudge(plan, lambda judgement: context.scheduler.soon(partial(throw, judgement)))
        watch.begin(middleware, world)
        for node in self._nodes:
            watch.watch(node)
        watch.judge.advance(context.scheduler.now)
        self._watches.append(watch)
        return _RunWatch(self._watches, watch, context.scheduler)


class _RunWatch:
    """A watch of a run. It looks for bounds that have passed 20 times a second."""

    def __init__(self, watches: list[RunJudge], watch: RunJudge, scheduler: Scheduler) -> None:
        self._watches, self._watch, self._scheduler = watches, watch, scheduler
        self._next: Entry = scheduler.after(_LOOK, self._look)

    def _look(self) -> None:
        self._next = self._scheduler.after(_LOOK, self._look)
        self._watch.judge.advance(self._scheduler.now)

    def results(self) -> None:
        """Never give results: the watch does not end by itself."""

    def close(self) -> None:
        """Watch no more."""
        self._next.cancel()
        self._watches.remove(self._watch)


def pose(x: float, y: float, altitude: float) -> RobotPosition:
    """Return a position in the world, as recordings have it."""
    return RobotPosition(round(x, 4), round(y, 4), round(altitude, 3))


def _wrong_field(middleware: LocalMiddleware, topic: str, path: tuple[str | int, ...]) -> str:
    """What is wrong with a field of a topic; empty if it is right."""
    if topic not in middleware.topics:
        return f"no robot uses topic {topic}; {suggestion(topic, sorted(middleware.topics))}"
    type = middleware.topics[topic].type
    names = path[: next((at for at, one in enumerate(path) if isinstance(one, int)), None)]
    try:
        message: Any = messages.create(type)
    except MessageError as error:
        return str(error)
    for at, name in enumerate(names):
        if field_of(message, names[: at + 1]) is None:
            inner = field_of(message, names[:at])
            known: Mapping[str, str] = (
                messages.fields(messages.type_name(inner)) if hasattr(inner, "__msgtype__") else {}
            )
            return f"{type} has no field {'.'.join(map(str, names[: at + 1]))}; {suggestion(str(name), known)}"
    return ""
