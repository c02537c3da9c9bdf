"""One run of a scenario, while it lasts."""

from __future__ import annotations

import gc
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.bpmn.pools import pools_of, shared_topics
from fame.check.gate import refuse_literals
from fame.clock import EPOCH, SECOND, Scheduler, WallScheduler, date_text
from fame.errors import ConfigError, MissionError
from fame.middleware.local import LocalMiddleware
from fame.monitor.services import SERVICES
from fame.robot import Event, RobotNode, make_mission
from fame.robot.events import Observer, combine_observers
from fame.scenario.film_captions import Captions
from fame.scenario.outcome import at_rest, mistyped_topics, never_started, robot_result, status_of
from fame.scenario.plan import Completion, Fault
from fame.scenario.result import Progress, Result
from fame.scripting import heartbeat

if TYPE_CHECKING:
    from fame.scenario.plan import Plan
    from sim2d.world import World

_SLICE = 1.0  # simulated s between two looks at the wall clock
_PROGRESS = 0.1  # wall s between two reports


_THRESHOLDS = 100_000, 20, 100
"""A young generation that is larger than all the messages under way at an instant."""


class Run:
    """One run of a scenario, while it lasts."""

    def __init__(
        self,
        scenario: Plan,
        real_time: bool,
        observer: Observer | None,
        progress: Callable[[Progress], object] | None,
        record: bool = False,
        strict: bool = False,
        on_interrupt: Callable[[], object] | None = None,
    ) -> None:
        self.scenario, self.progress, self.on_interrupt = scenario, progress, on_interrupt
        refuse_literals(scenario.definitions, scenario.processes(), scenario.library, strict=strict)
        self.scheduler: Scheduler = WallScheduler() if real_time else Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.interrupted = self._stuck = False
        self.reports: list[Event] = []
        cast = {robot: pool.process for robot, pool in scenario.cast.items()}
        self.captions = Captions(scenario.closures(), cast) if record or progress else None
        captions = self.captions.add if self.captions is not None else None
        self._logs = observer
        self.observer = combine_observers([hears for hears in (captions, observer) if hears is not None])
        self.dead: set[str] = set()
        self.world, self.recorder = self._build_world(record)
        try:
            self.nodes = self._build_nodes(strict)
            self._check_faults()
        except BaseException:
            if self.world is not None:
                self.world.close()
            raise

    def _build_nodes(self, strict: bool) -> list[RobotNode]:
        """An engine for each robot, loaded."""
        scenario, bodies = self.scenario, self.world.robots if self.world is not None else {}
        shared = shared_topics(scenario.definitions, pools_of(scenario.definitions), scenario.library)
        nodes = [
            RobotNode(
                robot,
                make_mission(scenario.definitions, pool.process, library=scenario.library, shared=shared),
                built_in_services=SERVICES,
                scheduler=self.scheduler,
                middleware=self.middleware,
                observer=self.observer,
                on_report=self.reports.append,
                safe_state=bodies[robot].SAFE_STATE if robot in bodies else (),
                safe_suspended=bodies[robot].SAFE_SUSPENDED if robot in bodies else (),
                strict=strict,
                epoch=scenario.epoch,
                until=round(scenario.duration * SECOND),
            )
            for robot, pool in scenario.cast.items()
        ]
        for node in nodes:
            node.load()
        return nodes

    def _check_faults(self) -> None:
        for fault in self.scenario.faults:
            body = self.world.robots.get(fault.robot) if self.world is not None else None
            kinds = ("engine", *(body.FAULTS if body is not None else ()))
            if fault.kind not in kinds:
                text = f"unknown fault {fault.kind!r} of {fault.robot}; known are: {', '.join(kinds)}"
                raise ConfigError(text, file=self.scenario.file)

    def _build_world(self, record: bool) -> tuple[World | None, Any]:
        if self.scenario.world is None:
            return None, None
        from sim2d.record import Recorder
        from sim2d.world import World

        world = World(
            self.scenario.world, seed=self.scenario.seed, scheduler=self.scheduler, middleware=self.middleware
        )
        recorder = Recorder(world) if record else None
        watch_world = getattr(self.observer, "watch_world", None)
        if watch_world is not None:
            from sim2d.scene import SceneRecorder

            watch_world(partial(SceneRecorder, world))
        world.watchers.append(lambda _: self.scheduler.stop() if self._over() else None)
        return world, recorder

    def _over(self) -> bool:
        """Something has run, nothing runs any more, and nothing will start by itself."""
        return any(node.started for node in self.nodes) and not any(
            node.engine.instances or node.pending_starts for node in self.nodes
        )

    def result(self) -> Result:
        """Let it go on until it is over, stop everything safely, and say how it went."""
        begun = time.monotonic()
        with self._interruptible(), heartbeat(), seldom_collected():
            self._work(begun)
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
        ending = "" if at_rest(robots) else "nothing can move any more" if self._stuck else "not over"
        world = self.world.summary() if self.world is not None else None
        if self.recorder is not None:
            self.recorder.finish(self.world)
        names = {node.node.full_name: node.name for node in self.nodes}
        for end, text in mistyped_topics(self.middleware.graph()):
            if end in names:
                self.reports.append(Event(self.scheduler.now, names[end], 0, 0, "", "log", text))
        self._stop()
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
            record=self.recorder.record if self.recorder is not None else None,
            labels=tuple(self.captions.labels) if self.captions is not None else (),
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """The first Ctrl-C ends the run after the stimulus that is at work; a second one does what it always does."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(number: int, frame: Any) -> None:
            self.interrupted = True
            self.scheduler.stop()
            signal.signal(signal.SIGINT, former)
            if self.on_interrupt is not None:
                self.on_interrupt()

        former = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, former)

    def _work(self, begun: float) -> None:
        """Run until the mission is over or its time is up."""
        if self._logs is not None and self.scenario.epoch != EPOCH:
            self._logs(Event(0, "", 0, 0, "", "epoch", date_text(self.scenario.epoch)))
        if self.world is not None:
            self.world.start()
        for node in self.nodes:
            node.start()
        for fault in self.scenario.faults:
            self.scheduler.after(round(fault.time * SECOND), partial(self._break, fault))
        for done in self.scenario.completions:
            self.scheduler.after(round(done.time * SECOND), partial(self._complete, done))
        end, told = round(self.scenario.duration * SECOND), begun
        going = True
        while going:
            if self.world is None and self.scheduler.next_time() is None:
                self._stuck = True
                break
            self.scheduler.run(min(end, self._next_look()))
            if self.progress is not None and (now := time.monotonic()) - told >= _PROGRESS:
                told = now
                self._tell()
            going = self.scheduler.now < end and not self._over() and not self.interrupted
        if self.progress is not None:
            self._tell()

    def _next_look(self) -> int:
        """When to look next whether it is over (ns).

        A world looks after each of its steps. Without one it is after all that happens at one instant: what somebody
        said last is still heard, and no time goes by that nobody used.
        """
        if isinstance(self.scheduler, WallScheduler):
            return self.scheduler.now + round(_PROGRESS * SECOND)
        due = self.scheduler.next_time() if self.world is None else None
        return self.scheduler.now + round(_SLICE * SECOND) if due is None else due

    def _tell(self) -> None:
        assert self.progress is not None
        assert self.captions is not None
        at = {node.name: self.captions.now.get(node.name, "") for node in self.nodes}
        self.progress(Progress(self.scheduler.now / SECOND, self.scenario.duration, at))

    def _break(self, fault: Fault) -> None:
        """A fault comes true."""
        self.reports.append(Event(self.scheduler.now, fault.robot, 0, 0, "", "report", f"fault: {fault.kind}"))
        if fault.kind != "engine":
            assert self.world is not None
            self.world.fault(fault.robot, fault.kind)
        elif fault.robot not in self.dead:
            self.dead.add(fault.robot)
            self._kill(next(node for node in self.nodes if node.name == fault.robot))

    def _complete(self, done: Completion) -> None:
        """Somebody does it, if there is something to do."""
        text, place = "somebody completed it", len(self.reports)  # what comes of it is told after it
        try:
            next(node for node in self.nodes if node.name == done.robot).complete(done.element, done.values)
        except MissionError as error:
            text = f"somebody wanted to complete it: {error.text}"
        self.reports.insert(place, Event(self.scheduler.now, done.robot, 0, 0, done.element, "report", text))

    def _kill(self, node: RobotNode) -> None:
        """Take an engine away as if its process had ended: it says nothing more, and what it was at has failed."""
        for instance in node.engine.instances.values():
            element = next((rest.node.id for rest in instance.waits()), "")
            text = f"its engine died at {self.scheduler.now / SECOND:g} s"
            instance.error = MissionError(text, robot=node.name, element=element, code="engine")
            instance.status = "failed"
            root, process = instance.root.key, node.mission.process.id
            if self.observer is not None:
                self.observer(Event(self.scheduler.now, node.name, instance.key, root, process, "end", "failed"))
        node.host.failed += len(node.engine.instances)
        node.engine.instances.clear()
        node.node.close()  # first of all, so that no script says a last word
        node.close()

    def close(self) -> None:
        """Take everything apart without having moved."""
        for node in self.nodes:
            node.close()
        if self.world is not None:
            self.world.close()

    def _stop(self) -> None:
        """Bring every robot that lives to its safe state and leave."""
        for node in self.nodes:
            if node.name not in self.dead:
                node.stop()
        self.close()


@contextmanager
def seldom_collected() -> Iterator[None]:
    """What there is now is not looked at, what is made meanwhile seldom; afterwards all is as before."""
    former = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(*_THRESHOLDS)
    try:
        yield
    finally:
        gc.set_threshold(*former)
        gc.unfreeze()
