"""A mission under test: a model or scenario in simulated time, driven step by step.

Nothing runs before the first `advance` or `run_until`: until then behaviours can be replaced, topics and services faked
and variables set. What is signalled before then arrives at time 0, when all robots have started. Everything is
deterministic; nothing sleeps.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.bpmn.model import Definitions
from fame.clock import SECOND
from fame.config.values import Source
from fame.dataclasses import dataclass, replace
from fame.engine.state import scopes_of
from fame.errors import ConfigError, FameError
from fame.log.recorder import About, Recorder, recording_to
from fame.middleware import messages
from fame.middleware.interface import resolve
from fame.middleware.local import LocalNode, LocalPublisher
from fame.robot import Event, RobotNode
from fame.robot.events import Observer, combine_observers
from fame.scenario import Fault, Scenario
from fame.scenario.run import Run
from fame.scenario.settings import ALL, with_parameters
from fame.testing.elements import Elements
from fame.testing.expectations import Expectation, PropertyExpectation, check_seconds
from fame.testing.failure import ExpectationError, failure, save_diagrams
from fame.testing.fakes import Fakes
from fame.testing.late_recording import LateFile
from fame.testing.stubs import Stub, StubLibrary
from fame.testing.taken_over import TakenOver
from fame.testing.trace import Trace
from fame.text import suggestion, topic_of

if TYPE_CHECKING:
    from fame.check.explore import Exploration
    from fame.properties import Judgement
    from fame.testing.by_hand import MissionByHand

WITHIN = 600.0
"""Default time limit of `run_until` (simulated s)."""


@dataclass(frozen=True, slots=True)
class Published:
    """A message that a process has published: simulated s, robot, message."""

    time: float
    robot: str
    message: Any

    @property
    def value(self) -> Any:
        """The message; of a wrapper such as std_msgs/msg/String the bare value."""
        return messages.bare(self.message)


class MissionUnderTest:
    """A loaded mission. Robots are named first where there are several; elements by label or id.

    Methods raise ConfigError for unknown robots, elements and topics, with similar ones; expectations that do not hold
    raise ExpectationError, which shows the state of the mission.
    """

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        self.scenario: Scenario = scenario
        self.elements: Elements = Elements(scenario.definitions, scenario.cast, scenario.library)
        self.trace: Trace = Trace(dict.fromkeys(scenario.cast, scenario.definitions.file))
        self.library: StubLibrary = StubLibrary(scenario.library)
        self._folder = folder
        self._pending: list[Callable[[], object]] = []
        self._published: dict[str, list[Published]] = {}
        self.expected_properties: set[str] = set()
        self._run: Run | None = None
        self._resources = ExitStack()
        self._recording = LateFile()
        self._saved: list[str] | None = None
        self.fakes: Fakes = Fakes(self)
        self.is_played: bool = False  # whether the test stubs, fakes, sends or sets something, unlike `fame run`

    # ---- what it is ------------------------------------------------------------------------------------------------

    @property
    def robots(self) -> Sequence[str]:
        """The names of all robots."""
        return list(self.scenario.cast)

    @property
    def begun(self) -> bool:
        """Whether it has begun to run."""
        return self._run is not None

    @property
    def untouched(self) -> bool:
        """Whether nothing has run, and the test has done nothing that will happen when it begins."""
        return self._run is None and not self._pending

    @property
    def run(self) -> Run:
        """The run, which begins now if it has not."""
        if self._run is None:
            self._begin()
        assert self._run is not None
        return self._run

    @property
    def now(self) -> float:
        """Simulated seconds since the start."""
        return self._run.scheduler.now / SECOND if self._run is not None else 0.0

    @property
    def world(self) -> Any:
        """The simulated world (`sim2d.world.World`), None if the mission has none."""
        return self.run.world

    @property
    def reports(self) -> Sequence[Event]:
        """What robots and scripts have reported."""
        return self._run.reports if self._run is not None else ()

    def node(self, robot: str = "") -> RobotNode:
        """Return the node of a robot, with its engine."""
        name = self.robot(robot)
        return next(node for node in self.run.nodes if node.name == name)

    @property
    def outside(self) -> LocalNode:
        """The node of the fakes."""
        self.run  # noqa: B018 (begins)
        return self._outside

    def variables(self, robot: str = "") -> dict[str, Any]:
        """Return the variables of a robot's last process instance."""
        instances = self.node(robot).instances
        return dict(instances[-1].variables) if instances else {}

    def files(self) -> list[Definitions]:
        """Return the models of what runs: that of the mission first, then those of called processes."""
        return self.scenario.closures()

    def robot(self, name: str = "") -> str:
        """Return the name of a robot; without one the only robot. Raises ConfigError."""
        if not name and len(self.robots) == 1:
            return self.robots[0]
        if name not in self.scenario.cast:
            text = f"unknown robot {name!r}; {suggestion(name, self.robots)}" if name else "name the robot first"
            raise ConfigError(text if name else f"{text}: robots are {', '.join(self.robots)}")
        return name

    # ---- what drives it --------------------------------------------------------------------------------------------

    def advance(self, seconds: float) -> MissionUnderTest:
        """Let this many simulated seconds pass."""
        check_seconds("advance", seconds)
        run = self.run
        end = run.scheduler.now + round(seconds * SECOND)
        while run.scheduler.now < end:
            run.scheduler.run(end)
        run.scheduler.run(end)
        return self

    def run_until(
        self,
        robot: str = "",
        *,
        at: str | None = None,
        completed: str | bool | None = None,
        published: str | None = None,
        condition: Callable[[], object] | None = None,
        within: float = WITHIN,
    ) -> MissionUnderTest:
        """Run until a token comes to an element (or takes a flow), a robot has completed, a topic has a message (of
        `robot`, if it is named), or a condition holds. The first call counts from the start of the mission.

        Raises ExpectationError if that does not happen `within` simulated seconds.
        """
        __tracebackhide__ = True
        given = [at, completed or None, published, condition]
        if sum(value is not None for value in given) != 1:
            raise ConfigError("run_until: expected one of at=, completed=, published=, condition=")
        if robot and (condition is not None or isinstance(completed, str)):
            raise ConfigError(f"run_until: expected no robot besides condition= or completed=ROBOT, got {robot!r}")
        check_seconds("run_until", within)
        if at is not None:
            self._run_to(self.robot(robot), at, within)
        elif completed:
            name = self.robot(completed if isinstance(completed, str) else robot)
            if not self.go_on(lambda: self.has_completed(name), within):
                raise failure(self, f"{name}: expected to complete within {within:g} s")
        elif published is not None:
            senders = [self.robot(robot)] if robot else self.robots
            seen = self._count(published, senders) if self.begun else 0
            if not self.go_on(lambda: self._count(published, senders) > seen, within):
                sender = f" of {robot}" if robot else ""
                raise failure(self, f"expected a message{sender} on {published} within {within:g} s")
        elif condition is not None and not self.go_on(condition, within):
            raise failure(self, f"expected the condition to hold within {within:g} s")
        return self

    def _count(self, topic: str, senders: Sequence[str]) -> int:
        return sum(one.robot in senders for one in self.published(topic))

    def _run_to(self, robot: str, at: str, within: float) -> None:
        __tracebackhide__ = True
        ids = self.elements.find(robot, at)
        seen = len(self.trace.arrivals(robot, ids)) if self.begun else 0

        def there() -> bool:
            return self.is_at(robot, ids) or len(self.trace.arrivals(robot, ids)) > seen

        if not self.go_on(there, within):
            shown = " or ".join(self.elements.shown(robot, id) for id in sorted(ids))
            raise failure(self, f"{robot}: expected to come to {shown} within {within:g} s")

    def go_on(self, condition: Callable[[], object], within: float) -> bool:
        """Run until a condition holds, instant by instant, at most `within` simulated s; whether it holds."""
        scheduler = self.run.scheduler
        end = scheduler.now + round(within * SECOND)
        while not condition():
            due = scheduler.next_time()
            if due is None or due > end:
                if due is not None:
                    scheduler.run(end)
                return bool(condition())
            scheduler.run(due)
        return True

    def is_at(self, robot: str, ids: frozenset[str]) -> bool:
        """Return whether a token of a robot waits at one of these elements, or in one of them."""
        for instance in self.node(robot).engine.instances.values():
            inside = (scope.node.id for scope in scopes_of(instance.root) if scope.node is not None)
            if not ids.isdisjoint((*instance.waiting, *inside)):
                return True
        return False

    def has_completed(self, robot: str) -> bool:
        """Return whether a robot has completed its process, and runs nothing."""
        node = self.node(robot)
        return node.completed > 0 and not node.engine.instances

    # ---- what people and other robots do ---------------------------------------------------------------------------

    def signal(self, *where_and_what: Any, **fields: Any) -> MissionUnderTest:
        """Publish a message from outside: ``signal("/done")``, ``signal("/go", {"x": 1})``, ``signal("/go", x=1.0)``.

        With a robot first, ``signal("REX", "~/odom", ...)``, only its process gets it. The topic of a signal has its
        name. Raises MessageError if the payload does not fit.
        """
        robot, topic, payload = self._addressed(where_and_what, fields)
        return self._do(partial(self._publish, robot, topic, payload))

    def message(self, *where_and_what: Any, **fields: Any) -> MissionUnderTest:
        """Send a BPMN message from outside; arguments as of `signal`."""
        return self.signal(*where_and_what, **fields)

    def complete(self, *where: str, **values: Any) -> MissionUnderTest:
        """Complete a user, manual or receive task that waits, with results: ``complete("Sign", approved=True)``."""
        robot, element = self._split(where)
        ids = self.elements.find(robot, element)
        return self._do(partial(self._complete, robot, ids, values))

    def set(self, robot: str = "", **variables: Any) -> MissionUnderTest:
        """Set process variables; before the mission begins as `fame run --set` does, in the place of its defaults.

        Without a robot for all that run. Raises ConfigError for a variable that the model does not have, before it
        begins; MissionError if none runs.
        """
        self.is_played = True
        if self._run is None:
            self._set_parameters({self.robot(robot) if robot else ALL: variables})
            return self
        nodes = [self.node(name) for name in ([robot] if robot else self.robots)]
        for node in [one for one in nodes if one.engine.instances] or nodes:
            node.engine.set_variables(variables)
            node.runner.poll()
        return self.settle()

    def _set_parameters(self, variables: Mapping[str, Mapping[str, Any]]) -> None:
        old = self.scenario
        cast, chosen = with_parameters(old.cast, old.definitions, old.library, variables, Source(old.file))
        merged = {robot: {**old.variables.get(robot, {}), **chosen.get(robot, {})} for robot in old.cast}
        self.scenario = replace(old, cast=cast, variables=merged)

    def take_over(self, robot: str = "", *, who: str = "a person") -> TakenOver:
        """Suspend a robot's mission and steer it, as a person does; see `fame.testing.taken_over`."""
        self.is_played = True
        return TakenOver(self, self.robot(robot), who)

    def fault(self, *where: str) -> MissionUnderTest:
        """Inject a fault now: ``fault("REX", "engine")``, or a fault of the robot's type. Raises ConfigError."""
        robot, kind = self._split(where)
        return self._do(lambda: self.run.inject(Fault(robot, self.now, kind)))

    # ---- what a test plays -----------------------------------------------------------------------------------------

    def stub(
        self,
        behaviour: str,
        *,
        after: float = 0.0,
        sets: Any = None,
        raises: Any = None,
        signals: Any = None,
    ) -> Stub:
        """Replace a behaviour (the called element of call activities): it takes `after` simulated s, then ends.

        `sets` are the variables that it sets, or a function of the variables that gives them; `signals` the payloads of
        signals that it throws, by name; `raises` the code of a BPMN error. A list is for successive calls; its last
        value is repeated. Returns the stub, whose `calls` have robot and variables of each call.
        """
        if self._run is not None:
            raise ConfigError(
                f"stub({behaviour!r}): expected before the mission begins: what it calls is compiled then"
            )
        self.is_played = True
        return self.library.stub(self.files(), behaviour, after=after, sets=sets, raises=raises, signals=signals)

    def fake_topic(self, topic: str, type: str = "", **given: Any) -> Any:
        """Add a fake publisher; see `fame.testing.fakes.FakeTopic`."""
        self.is_played = True
        return self.fakes.topic(topic, type, **given)

    def fake_service(self, name: str, type: str, **given: Any) -> Any:
        """Add a fake service; see `fame.testing.fakes.FakeService`."""
        self.is_played = True
        return self.fakes.service(name, type, **given)

    def fake_action(self, name: str, type: str, **given: Any) -> Any:
        """Add a fake action server; see `fame.testing.fakes.FakeAction`."""
        self.is_played = True
        return self.fakes.action(name, type, **given)

    def person(self, tasks: Mapping[str, Mapping[str, Any] | None], *, robot: str = "", after: float = 0.0) -> None:
        """Complete tasks `after` simulated s, like a person, whenever a token waits there: task -> results.

        Without a robot those of every robot that has such a task. Raises ConfigError for a task that none has.
        """
        self.is_played = True
        for name, its in self._owners(tasks, robot).items():
            self.fakes.person(name, its, after)

    def _owners(self, tasks: Mapping[str, Any], robot: str) -> dict[str, dict[str, Any]]:
        """The tasks of each robot, by its name."""
        names = [self.robot(robot)] if robot or len(self.robots) == 1 else self.robots
        found: dict[str, dict[str, Any]] = {}
        for task, values in tasks.items():
            owners = []
            for name in names:
                with suppress(ConfigError):
                    self.elements.find(name, task)
                    owners.append(name)
            for name in owners:
                found.setdefault(name, {})[task] = values
            if not owners and len(names) == 1:
                self.elements.find(names[0], task)  # raises, with similar ones
            if not owners:
                raise ConfigError(f"person: no robot has an element {task!r}; robots are {', '.join(names)}")
        return found

    # ---- what is expected ------------------------------------------------------------------------------------------

    def expect(self, robot: str = "") -> Expectation:
        """Return the expectations of a robot."""
        return Expectation(self, self.robot(robot))

    def expect_property(self, name: str) -> PropertyExpectation:
        """Return the expectations of a property of the scenario. Raises ConfigError if it has none of this name."""
        judging = self.run.judging
        known = [each.name for each in self.run.scenario.properties]
        if judging is None or name not in known:
            raise ConfigError(f"the mission judges no property {name!r}; {suggestion(name, known)}")
        self.expected_properties.add(name)
        return PropertyExpectation(self, name)

    def check_properties(self) -> None:
        """Raise ExpectationError for a property that is violated, unless the test has said what it expects of it.

        If nothing can come any more, what is pending is violated, as at the end of a run.
        """
        for judgement in self.judgements():
            if judgement.verdict == "violated" and judgement.name not in self.expected_properties:
                raise failure(self, str(judgement))

    def undecided(self) -> list[Judgement]:
        """Return the judgements that are pending or not known, without those of which the test has
        said what it expects."""
        words = ("pending", "not known")
        return [one for one in self.judgements() if one.verdict in words and one.name not in self.expected_properties]

    def unused(self) -> list[str]:
        """Return the stubs and fakes that the mission has not used."""
        return [*self.library.unused(), *self.fakes.unused()]

    def judgements(self) -> list[Judgement]:
        """Return how each property of the scenario is judged now."""
        judging = self._run.judging if self._run is not None else None
        return judging.judgements(complete=self.is_complete) if judging is not None else []

    @property
    def is_complete(self) -> bool:
        """Whether nothing can come any more, unless the test does something."""
        return self.run.over or self.run.stuck

    def published(self, topic: str) -> list[Published]:
        """Return what processes have published on a topic, with times, in order. Raises
        ConfigError for an unknown topic."""
        full = resolve(topic, self.robots[0] if len(self.robots) == 1 else "")
        known = self.run.middleware.topics
        if full not in known:
            raise ConfigError(f"no process uses the topic {full}; {suggestion(full, sorted(known))}")
        others = set(known[full].info().publishers)
        if full not in self._published and others and others.isdisjoint(self._engines):
            raise ConfigError(f"no process publishes on {full}: {', '.join(sorted(others))} does")
        return list(self._published.get(full, ()))

    # ---- life ------------------------------------------------------------------------------------------------------

    def make_run(self, observer: Observer) -> Run:
        """Return the run that is driven."""
        plan = replace(self.scenario, library=self.library)
        return Run(plan, False, observer, None, services=self.library.services)

    def _begin(self) -> None:
        metadata = {"seed": str(self.scenario.seed), "scenario": Path(self.scenario.file).name, "command": "pytest"}
        stream = recording_to(lambda: self._recording, self.files(), About(metadata=metadata), "signals")
        self._recorder: Recorder = self._resources.enter_context(stream)
        observer = combine_observers([self.trace, self._recorder])
        assert observer is not None
        self._run = self.make_run(observer)
        self._outside = self._run.middleware.node("test")
        self._engines = {node.node.full_name: node.name for node in self._run.nodes}
        self._run.middleware.tap(self._record)
        self.fakes.begin()
        self._run.begin()
        self._run.scheduler.run(0)
        pending, self._pending = self._pending, []
        for action in pending:
            action()
        self._run.scheduler.run(0)

    def _record(self, publisher: LocalPublisher) -> Callable[[Any], object] | None:
        """Keep what a process publishes."""
        robot = self._engines.get(publisher.node.full_name)
        if robot is None:
            return None
        kept, scheduler = self._published.setdefault(publisher.topic, []), self.run.scheduler
        return lambda message: kept.append(Published(scheduler.now / SECOND, robot, message))

    def _do(self, action: Callable[[], object]) -> MissionUnderTest:
        """Act now, or when the mission begins."""
        self.is_played = True
        if self._run is None:
            self._pending.append(action)
            return self
        action()
        return self.settle()

    def settle(self) -> MissionUnderTest:
        """Run everything that is due at the present instant."""
        if self._run is not None:
            self._run.scheduler.run(self._run.scheduler.now)
        return self

    def _addressed(self, given: Sequence[Any], fields: Mapping[str, Any]) -> tuple[str, str, Any]:
        """Robot (or empty), topic and payload."""
        robot = given[0] if len(given) > 1 and isinstance(given[0], str) and given[0] in self.scenario.cast else ""
        rest = given[1:] if robot else given
        if not rest or len(rest) > 2 or not isinstance(rest[0], str) or (len(rest) == 2 and fields):
            raise ConfigError(f"expected a topic and its payload or fields, got {', '.join(map(repr, given))}")
        topic = topic_of(rest[0])
        return robot, topic, rest[1] if len(rest) == 2 else dict(fields) or None

    def _split(self, where: Sequence[str]) -> tuple[str, str]:
        """The robot, which may be named before the other argument, and that."""
        if len(where) not in (1, 2):
            raise ConfigError(
                f"expected one argument, or a robot before it, got {', '.join(map(repr, where)) or 'none'}"
            )
        return self.robot(where[0] if len(where) > 1 else ""), where[-1]

    def _publish(self, robot: str, topic: str, payload: Any) -> None:
        if robot or topic.startswith("~"):
            self.node(robot).deliver(topic, payload)
            return
        known = self.run.middleware.topics
        if topic not in known:
            raise ConfigError(f"no process uses the topic {topic}; {suggestion(topic, sorted(known))}")
        publisher = self._outside.publisher(topic, known[topic].type)
        publisher.publish(messages.create(known[topic].type, payload))

    def _complete(self, robot: str, ids: frozenset[str], values: Mapping[str, Any]) -> None:
        waits = [wait.element for wait in self.node(robot).waiting_tokens() if wait.element in ids]
        self.node(robot).complete(waits[0] if waits else min(ids), values)

    def save(self) -> list[str]:
        """Save the recording and the diagrams of the run, once. Returns a line for each file."""
        if self._saved is None:
            self._saved = []
            if self._run is not None:
                try:
                    self._saved = [f"saved: {path}" for path in self._write()]
                except (OSError, FameError) as error:  # a full disk or a message that no wire takes hides no failure
                    self._saved = [f"not saved: {error}"]
        return self._saved

    def _write(self) -> Iterator[Path]:
        self._folder.mkdir(parents=True, exist_ok=True)
        recording = self._folder / "run.mcap"
        recording.write_bytes(self.recorded())
        yield recording
        yield from save_diagrams(self, self._folder)

    def recorded(self) -> bytes:
        """Return the recording of the run so far (MCAP). It is not recorded further."""
        if self._saved is None:
            self._saved = []
        self._resources.close()
        return self._recording.content()

    def close(self) -> None:
        """End the mission, and let go of its world: a physics space must not outlive pymunk's functions at exit."""
        if self._run is not None:
            self._run.stop()
        self._resources.close()
        self._run, self._pending = None, []
        self.trace.close()
        for name in ("_recorder", "_outside"):
            self.__dict__.pop(name, None)
        self.fakes = Fakes(self)


class MissionLoader:
    """The fixture ``mission``: loads missions, relative to the file of the test or to the folder of pytest.

    `folder` is where a failed mission is saved, `library` are folders with called processes.
    """

    def __init__(self, folder: Callable[[], Path], search: Sequence[Path] = (), library: Sequence[Path] = ()) -> None:
        self.loaded: list[MissionUnderTest] = []
        self._folder, self._search, self._library = folder, search, library

    def load(self, path: str | Path, **options: Any) -> MissionUnderTest:
        """Load a model (.bpmn) or a scenario (.yaml); `options` are those of `fame.Scenario.load`: seed, faults ...

        A model alone has robots without a world. Raises ConfigError and ModelError.
        """
        mission = MissionUnderTest(self._scenario(path, options), self._place())
        self.loaded.append(mission)
        return mission

    def by_hand(self, path: str | Path, *, lenient: bool = False, **options: Any) -> MissionByHand:
        """Load a mission that runs step by step; see `fame.testing.by_hand`."""
        from fame.testing.by_hand import MissionByHand

        mission = MissionByHand(self._scenario(path, options), self._place(), lenient=lenient)
        self.loaded.append(mission)
        return mission

    def explore(self, path: str | Path, *, allow_partial: bool = False, **options: Any) -> Exploration:
        """Explore a model or scenario; `options` are those of `fame.explore`.

        Raises ExpectationError after an error that is not accepted, and if not all states were explored, unless
        `allow_partial`.
        """
        from fame.scenario.explore.exploration import explore

        result = explore(self._found(path), **self._options(options))
        if result.status == "failed" or (result.status == "partial" and not allow_partial):
            shown = [(str(one), one.run) for one in result.findings if one.level == "error"]
            refuted = (one for one in result.properties if one.verdict == "refuted")
            shown += [(f"property {one.name} is refuted: {one.sentence}", one.run) for one in refuted]
            lines = [line for text, run in shown for line in (text, *(f"  {step}" for step in run))]
            raise ExpectationError("\n".join([result.summary(), *(lines or [result.partly()])]))
        return result

    def _scenario(self, path: str | Path, options: Mapping[str, Any]) -> Scenario:
        return Scenario.load(self._found(path), **self._options(options))

    def _options(self, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """With the library of all missions, unless the test names another."""
        return {"library": self._library, **given} if self._library else given

    def _found(self, path: str | Path) -> Path:
        return next((folder / path for folder in self._search if (folder / path).is_file()), Path(path))

    def _place(self) -> Path:
        """Where the next mission is saved if it fails."""
        number = f"-{len(self.loaded) + 1}" if self.loaded else ""
        return self._folder() / f"mission{number}"

    def close(self) -> None:
        """End all missions."""
        worlds = any(mission.begun and mission.world is not None for mission in self.loaded)
        for mission in reversed(self.loaded):  # each gives back the random numbers of what was before it
            mission.close()
        if worlds:
            gc.collect()  # a world and its robots refer to each other
