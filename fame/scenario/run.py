"""One run of a scenario in one process: nodes, world, faults and completions on one scheduler."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, Protocol

from fame.bpmn.pools import pools_of, shared_topics
from fame.bpmn.topics import TopicUse
from fame.check.gate import refuse_literals
from fame.clock import EPOCH, SECOND, Scheduler, WallScheduler, date_text
from fame.engine import Instance
from fame.errors import ConfigError, MissionError
from fame.middleware import messages, qos
from fame.middleware.interface import Publisher
from fame.middleware.local import LocalMiddleware, LocalNode
from fame.middleware.network import Network
from fame.randomness import RANDOM_MODULES, ModuleRandom, robot_random
from fame.robot import Event, RobotNode, ServiceFunction, make_mission
from fame.robot.events import ENDED, Observer, OnEvent, combine_observers, observer_of
from fame.robot.options import RobotOptions
from fame.rooms import RUN_JUDGE, RUN_WATCHES, WATCH, load
from fame.scenario.film_captions import Captions
from fame.scenario.plan import Completion, Fault, OutsideSignal, published_from_outside
from fame.scenario.process import signals_call
from fame.scenario.result import Progress, Result, at_rest, mistyped_topics, never_started, robot_result, status_of
from fame.scripting import heartbeat

if TYPE_CHECKING:
    from fame.log.team_state import Put
    from fame.properties import Monitor
    from fame.properties.judgement import Judgement
    from fame.scenario.plan import Plan
    from sim2d.world import World

_SLICE = 1.0  # simulated s between two progress reports at most
_PROGRESS = 0.1  # wall s between two progress reports


class Pace(Protocol):
    """The control of a run: `fame view` lets people pause it, step through it and change its speed.

    attended  whether people may act: a run in which nothing moves then waits for them, else it ends as stuck
    """

    attended: bool

    def advance(self, run: Run, until: int) -> None:
        """Run the scheduler until `until` (ns), or less. Called until the run is over."""


class RunJudging(Protocol):
    """Judges the properties of a run, which it observes: a `fame.scenario.judging.RunJudge`."""

    judge: Any

    def begin(self, middleware: LocalMiddleware, world: World | None) -> None: ...
    def record(self, put: Put) -> None: ...
    def never_judged(self) -> Iterator[tuple[Monitor, str]]: ...
    def judgements(self, *, complete: bool = False) -> list[Judgement]: ...
    def finish(self, time: int, *, complete: bool) -> list[Judgement]: ...


class Run:
    """One run of a scenario. `services` gives each robot the Python functions of its service tasks, by name.

    `pace` decides when it goes on; without one it runs as fast as its scheduler does. `hold_errors`: as `Scenario.run`.
    """

    scenario: Plan
    progress: Callable[[Progress], object] | None
    on_interrupt: Callable[[], object] | None

    def __init__(
        self,
        scenario: Plan,
        real_time: bool,
        observer: OnEvent | None,
        progress: Callable[[Progress], object] | None,
        strict: bool = False,
        on_interrupt: Callable[[], object] | None = None,
        services: Callable[[str], Mapping[str, ServiceFunction]] | None = None,
        pace: Pace | None = None,
        hold_errors: bool = False,
    ) -> None:
        self._pace, self._hold_errors, self._strict = pace, hold_errors, strict
        self._seeded = ExitStack()
        self.scenario, self.progress, self.on_interrupt = scenario, progress, on_interrupt
        self._services = services or (lambda robot: {})
        refuse_literals(scenario.definitions, scenario.processes(), scenario.library, strict=strict)
        self.scheduler: Scheduler = WallScheduler() if real_time else Scheduler()
        network = scenario.network
        self.network: Network | None = Network(network, scenario.seed, self.scheduler) if network is not None else None
        self.middleware: LocalMiddleware = LocalMiddleware(self.scheduler, network=self.network)
        self.interrupted = self._stuck = False
        self.reports: list[Event] = []
        cast = {robot: pool.process for robot, pool in scenario.cast.items()}
        self.captions: Captions | None = Captions(scenario.closures(), cast) if progress else None
        captions = self.captions.add if self.captions is not None else None
        self._logs = observer
        self.judging: RunJudging | None = None
        self._watches: Any = None  # a `fame.scenario.judging.RunWatches`
        if scenario.properties:
            self.judging = load(RUN_JUDGE)(scenario, self._on_violation)
        if _watches_properties(scenario):
            self._watches = load(RUN_WATCHES)(scenario)
        observers: list[Any] = [each for each in (captions, self.judging, self._watches, observer) if each is not None]
        self.observer: Observer | None = combine_observers(observers)
        self.dead: set[str] = set()
        self._outside, self._published = self.middleware.node("outside"), 0
        self._last_looks: list[Callable[[], None]] = []  # at the world, for recordings
        self.world: World | None = self._build_world()
        self._world_nodes: set[LocalNode] = {*self.middleware.nodes} - {self._outside}
        try:
            self.nodes: list[RobotNode] = self._build_nodes(strict)
            modules = frozenset[str]().union(*(node.mission.random_modules for node in self.nodes))
            self._random = ModuleRandom(scenario.seed, modules=RANDOM_MODULES if self.world is not None else modules)
            for fault in self.scenario.faults:
                self._check_fault(fault)
            if self.judging is not None:
                self.judging.begin(self.middleware, self.world)
                if self.observer is not None:
                    self.observer.add_channels(self.judging.record)
        except BaseException:
            if self.world is not None:
                self.world.close()
            raise

    def _build_nodes(self, strict: bool) -> list[RobotNode]:
        """Make and load a node with an engine for each robot."""
        scenario = self.scenario
        shared = shared_topics(scenario.definitions, pools_of(scenario.definitions), scenario.library.declared)
        nodes = [self._node(robot, shared, strict) for robot in scenario.cast]
        for node in nodes:
            node.load()
        return nodes

    def nodes_of(self, plan: Plan) -> list[RobotNode]:
        """Make and load the nodes of another plan with the same robots, beside those that run. Nobody observes them.

        Raises ModelError, MessageError and ConfigError for what cannot be run; nothing is left of it.
        """
        refuse_literals(plan.definitions, plan.processes(), plan.library, strict=self._strict)
        before, there = (self.scenario, self.observer), {*self.middleware.nodes}
        self.scenario, self.observer = plan, observer_of(lambda event: None) if self.observer is not None else None
        try:
            return self._build_nodes(self._strict)
        except BaseException:
            for node in {*self.middleware.nodes} - there:
                node.close()
            raise
        finally:
            self.scenario, self.observer = before

    def _node(self, robot: str, shared: Mapping[str, TopicUse], strict: bool, *, compiled: bool = True) -> RobotNode:
        """Make the node of a robot. `shared`: the topics of the collaboration."""
        plan, body = self.scenario, self.world.robots.get(robot) if self.world is not None else None
        watched = (
            {WATCH: partial(self._watches.start, self.middleware, self.world)} if self._watches is not None else {}
        )
        return RobotNode(
            robot,
            make_mission(
                plan.definitions,
                plan.cast[robot].process,
                library=plan.library,
                shared=shared,
                services=self._services(robot),
            ),
            scheduler=self.scheduler,
            middleware=self.middleware,
            compiled=compiled,
            options=RobotOptions(
                service_starts=watched,
                observer=self.observer,
                on_report=self.reports.append,
                on_end=partial(self._on_end, robot),
                safe_state=body.SAFE_STATE if body is not None else (),
                safe_suspended=body.SAFE_SUSPENDED if body is not None else (),
                strict=strict,
                epoch=plan.epoch,
                random=robot_random(plan.seed, robot),
                until=round(plan.duration * SECOND),
                hold_errors=self._hold_errors,
            ),
        )

    def fault_kinds(self, robot: str) -> tuple[str, ...]:
        """Return the kinds of faults that can be injected into a robot."""
        body = self.world.robots.get(robot) if self.world is not None else None
        return ("engine", *(body.FAULTS if body is not None else ()))

    def _check_fault(self, fault: Fault) -> None:
        if fault.kind not in (kinds := self.fault_kinds(fault.robot)):
            text = f"unknown fault {fault.kind!r} of {fault.robot}; known are: {', '.join(kinds)}"
            raise ConfigError(text, file=self.scenario.file)

    def _build_world(self) -> World | None:
        if self.scenario.world is None:
            return None
        from sim2d.world import World

        world = World(
            self.scenario.world, seed=self.scenario.seed, scheduler=self.scheduler, middleware=self.middleware
        )
        if self.observer is not None:
            from sim2d.scene import SceneRecorder

            self.observer.add_channels(
                lambda put: self._last_looks.append(partial(SceneRecorder(world, put).look, world))
            )
        world.watchers.append(lambda _: self.scheduler.stop() if self.over else None)
        return world

    def _on_violation(self, judgement: Judgement) -> None:
        """Report a violation, also in logs."""
        robot, element = next(reversed(judgement.elements), ("", ""))
        robot = robot or next(iter((*judgement.robots, *self.scenario.cast)))
        event = Event(self.scheduler.now, robot, 0, 0, element, "report", str(judgement))
        self.reports.append(event)
        if self._logs is not None:
            self._logs(event)

    def _on_end(self, robot: str, instance: Instance) -> None:
        """Report an error when it ends an instance; a summary of all comes at the end."""
        if (error := instance.error) is not None:
            self.reports.append(Event(self.scheduler.now, robot, 0, 0, error.element, "report", error.text))

    @property
    def over(self) -> bool:
        """Whether a process has run, none is running, and no timer, message or signal from outside is still to come."""
        return (
            any(node.started for node in self.nodes)
            and self._published == len(self.scenario.signals)
            and not any(node.engine.instances or node.pending_starts for node in self.nodes)
            and not self._message_to_come()
        )

    def _message_to_come(self) -> bool:
        """Whether a message, under way or promised, may still start a process or reach a robot of the world.

        What the world publishes does not count: it never ends.
        """
        live = {node.name: node for node in self.nodes if node.name not in self.dead}
        engines: dict[Any, RobotNode] = {node.node: node for node in live.values()}
        owed = (pair for node in live.values() if node.acknowledged is not None for pair in node.acknowledged.owed)
        return any(
            end.node in self._world_nodes or (end.node in engines and end.topic in engines[end.node].start_topics)
            for end in self.middleware.under_way(self._world_nodes)
        ) or any(robot in live and name in live[robot].engine.program.starts for robot, name in owed)

    @property
    def stuck(self) -> bool:
        """Whether nothing moves any more, unless somebody outside does something."""
        return self.world is None and self.scheduler.next_time() is None

    def result(self) -> Result:
        """Run until the mission is over, stop everything safely, and return the result."""
        begun = time.monotonic()
        with self._seeded, self._interruptible(), heartbeat():
            try:
                self._work(begun)
            except BaseException:
                self.stop()
                raise
        simulated = self.scheduler.now / SECOND
        waits = {
            node.name: tuple(node.waiting_tokens())
            if node.engine.instances or node.pending_starts == "due" or not node.started
            else ()
            for node in self.nodes
            if node.name not in self.dead
        }
        robots = tuple(robot_result(node, waits.get(node.name, ())) for node in self.nodes)
        unstarted = never_started(self.scenario.cast, robots)
        status = "interrupted" if self.interrupted else status_of(robots, unstarted)
        ending = "" if at_rest(robots) else "the mission is stuck: no token can move" if self._stuck else "not over"
        world = self.world.summary() if self.world is not None else None
        for look in self._last_looks:
            look()
        complete = not self.interrupted and (self.over or self._stuck)
        judgements = self.judging.finish(self.scheduler.now, complete=complete) if self.judging is not None else ()
        if self.observer is not None:
            for each in judgements:
                self.observer(Event(self.scheduler.now, "", 0, 0, "", "verdict", each.to_json()))
            self.observer(Event(self.scheduler.now, "", 0, 0, "", ENDED, "complete" if complete else "cut"))
        names = {node.node.full_name: node.name for node in self.nodes}
        for end, text in mistyped_topics(self.middleware.graph()):
            if end in names:
                self.reports.append(Event(self.scheduler.now, names[end], 0, 0, "", "log", text))
        for text in chain(self.network.losses() if self.network is not None else (), self.middleware.losses()):
            self.reports.append(Event(self.scheduler.now, "", 0, 0, "", "report", text))
        self.stop()
        return Result(
            status=status,
            seed=self.scenario.seed,
            robots=robots,
            simulated=simulated,
            wall=time.monotonic() - begun,
            reports=tuple(self.reports),
            ending=ending,
            world=world,
            epoch=self.scenario.epoch,
            never_started=unstarted,
            judgements=tuple(judgements),
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """End the run after the current stimulus when a signal asks for it; the second one raises KeyboardInterrupt."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(number: int, frame: Any) -> None:
            self.interrupted = True
            self.scheduler.stop()
            if self.on_interrupt is not None:
                self.on_interrupt()

        def on_signal(number: int, frame: Any) -> None:
            (signal.default_int_handler if self.interrupted else interrupt)(number, frame)

        with signals_call(on_signal):
            yield

    def begin(self) -> None:
        """Start the world and the processes of all robots, and schedule faults and what people do.

        Until the run is closed, the modules `random` and `numpy.random` draw from its seed.
        """
        self._seeded.enter_context(self._random)
        if self._logs is not None and self.scenario.epoch != EPOCH:
            self._logs(Event(0, "", 0, 0, "", "epoch", date_text(self.scenario.epoch)))
        if self.world is not None:
            self.world.start()
        for node in self.nodes:
            node.engine.parameters.update(self.scenario.variables.get(node.name, {}))
            node.start()
        for fault in self.scenario.faults:
            self.scheduler.after(round(fault.time * SECOND), partial(self.inject, fault))
        for done in self.scenario.completions:
            self.scheduler.after(round(done.time * SECOND), partial(self._complete, done))
        for sent in self.scenario.signals:
            publisher = self._outside.publisher(sent.topic, sent.type, qos.parse(sent.qos))
            self.scheduler.after(round(sent.time * SECOND), partial(self._publish, publisher, sent))

    def _publish(self, publisher: Publisher, sent: OutsideSignal) -> None:
        """Publish a signal in the place of somebody outside."""
        self._published += 1
        self.reports.append(Event(self.scheduler.now, "", 0, 0, "", "report", published_from_outside(sent)))
        publisher.publish(messages.create(sent.type, sent.payload))

    def _work(self, begun: float) -> None:
        """Run until the mission is over or its time is up."""
        self.begin()
        end, reported = round(self.scenario.duration * SECOND), begun
        going = True
        while going:
            if self.stuck and (self._pace is None or not self._pace.attended):
                self._stuck = True
                break
            self._advance(min(end, self._next_check()))
            if self.progress is not None and (now := time.monotonic()) - reported >= _PROGRESS:
                reported = now
                self._report_progress()
            going = self.scheduler.now < end and not self.over and not self.interrupted
        if self.progress is not None:
            self._report_progress()

    def _advance(self, until: int) -> None:
        if self._pace is None:
            self.scheduler.run(until)
        else:
            self._pace.advance(self, until)

    def _next_check(self) -> int:
        """The next time (ns) to check whether the mission is over.

        With a world this is checked after each of its steps as well. Without one it is checked after all entries of an
        instant: the last messages are delivered, and no further time passes.
        """
        if isinstance(self.scheduler, WallScheduler):
            return self.scheduler.now + round(_PROGRESS * SECOND)
        due = self.scheduler.next_time() if self.world is None else None
        return self.scheduler.now + round(_SLICE * SECOND) if due is None else due

    def _report_progress(self) -> None:
        assert self.progress is not None
        assert self.captions is not None
        at = {node.name: self.captions.now.get(node.name, "") for node in self.nodes}
        self.progress(Progress(self.scheduler.now / SECOND, self.scenario.duration, at))

    def inject(self, fault: Fault) -> None:
        """Inject a fault of a robot of this run, now. Raises ConfigError for an unknown kind."""
        self._check_fault(fault)
        self.reports.append(Event(self.scheduler.now, fault.robot, 0, 0, "", "report", f"fault: {fault.kind}"))
        if fault.kind != "engine":
            assert self.world is not None
            self.world.fault(fault.robot, fault.kind)
        elif fault.robot not in self.dead:
            self.dead.add(fault.robot)
            self._kill(next(node for node in self.nodes if node.name == fault.robot))

    def _complete(self, done: Completion) -> None:
        """Complete a task in the place of a person, and report whether a token waited there."""
        node, place = next(node for node in self.nodes if node.name == done.robot), len(self.reports)
        without = node.left_out(done.element, done.values)
        text = f"completed by a person{', ' * bool(without)}{without}"  # reported before its consequences
        try:
            node.complete(done.element, done.values)
        except MissionError as error:
            text = f"could not be completed by a person: {error.text}"
        self.reports.insert(place, Event(self.scheduler.now, done.robot, 0, 0, done.element, "report", text))

    def _kill(self, node: RobotNode) -> None:
        """End an engine as if its operating-system process had died: it is silent, and its instances have failed."""
        for instance in node.engine.instances.values():
            element = next((rest.node.id for rest in instance.waits()), "")
            text = f"its engine died at {self.scheduler.now / SECOND:g} s"
            name = next((one.name for _, one in node.mission.flow_nodes() if one.id == element), "")
            instance.error = MissionError(text, robot=node.name, element=element, code="engine", name=name)
            instance.status = "failed"
            root, process = instance.root.key, node.mission.process.id
            if self.observer is not None:
                self.observer(Event(self.scheduler.now, node.name, instance.key, root, process, "end", "failed"))
        node.host.failed += len(node.engine.instances)
        node.host.elements_done = node.elements
        node.engine.instances.clear()
        node.node.close()  # first, so that scripts that are cancelled cannot publish
        node.close()

    def close(self) -> None:
        self._seeded.close()
        for node in self.nodes:
            node.close()
        if self.world is not None:
            self.world.close()

    def stop(self) -> None:
        """Bring every robot with a live engine to its safe state, then close everything.

        What this cancels does not belong to the run: logs and recordings end with what was active.
        """
        with self._random:
            for node in self.nodes:
                if node.name not in self.dead:
                    node.stop(observed=False)
        self.close()


def _watches_properties(plan: Plan) -> bool:
    """Whether a robot watches a property."""
    bodies = (process.body for definitions in plan.closures() for process in definitions.processes)
    return any(node.operation == WATCH for body in bodies for node in body.walk())
