"""A world, its robots and a collaboration in one process.

A `Scenario` is what a scenario file says, checked. `run` builds everything anew, lets it go on until the mission is
over or its duration has passed, and says how it went: the mission is over when something has run and nothing runs any
more. A robot whose process fails is brought to its safe state; the others go on, and all are stopped safely at the end.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from fame.bpmn.model import Activity, Definitions
from fame.clock import SECOND, Scheduler, WallScheduler
from fame.errors import ConfigError, MissionError
from fame.library import Library
from fame.middleware.local import LocalMiddleware
from fame.node import Event, RobotNode, Wait, mission
from fame.scripting import heartbeat
from fame.splitter import Pool, bind, pools_of, shared_topics

if TYPE_CHECKING:
    from sim2d.config import WorldConfig
    from sim2d.record import Record
    from sim2d.world import World

DURATION = 600.0
"""Simulated seconds after which a run ends if nobody says otherwise."""

_KEYS = ("model", "world", "seed", "duration", "library", "robots")
_SLICE = 1.0  # simulated s between two looks at the wall clock
_PROGRESS = 0.1  # wall s between two reports

Status = Literal["completed", "failed", "timeout", "interrupted"]


@dataclass(frozen=True, slots=True)
class Fault:
    """What breaks of a robot at simulated second `time`, for good.

    `kind`: its ``engine``, which vanishes without a safe state, or what a robot of its type can break.
    """

    robot: str
    time: float
    kind: str


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is: simulated s, and what each robot is at."""

    simulated: float
    duration: float
    robots: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class RobotResult:
    """How it went for one robot. `elements`: how many were completed; `waits`: what still waited at the end."""

    name: str
    instances: int
    completed: int
    failed: int
    elements: int
    errors: tuple[MissionError, ...]
    waits: tuple[Wait, ...]


@dataclass(frozen=True, slots=True)
class Result:
    """How a run went. `simulated` and `wall` in s; `world` is how things stand in it; `labels` caption a film.

    `ending` says why it was not over when it ended: its time was up, or nothing could move any more.
    """

    status: Status
    seed: int
    robots: tuple[RobotResult, ...]
    simulated: float
    wall: float
    reports: tuple[Event, ...]
    ending: str
    world: Mapping[str, Any] | None
    record: Record | None = field(default=None, repr=False)
    labels: tuple[tuple[float, str, str], ...] = field(default=(), repr=False)

    @property
    def exit_code(self) -> int:
        """That of the command: 0 completed, 1 not, 130 interrupted."""
        return {"completed": 0, "interrupted": 130}.get(self.status, 1)

    @property
    def messages(self) -> list[str]:
        """What went wrong, a line each, for people."""
        lines = [str(error) for robot in self.robots for error in robot.errors]
        if self.status == "timeout":
            lines.append(f"{self.ending} after {self.simulated:g} simulated seconds")
        if self.status != "completed":
            waits = [wait for robot in self.robots for wait in robot.waits]
            lines += [f"{wait.robot} waits at {wait.element} for {wait.text}" for wait in waits]
        return lines

    def to_json(self) -> dict[str, Any]:
        """Everything but the record, fit for JSON."""
        return {
            "status": self.status,
            "seed": self.seed,
            "simulated": round(self.simulated, 9),
            "wall": round(self.wall, 3),
            "robots": {
                robot.name: {
                    "instances": robot.instances,
                    "completed": robot.completed,
                    "failed": robot.failed,
                    "elements": robot.elements,
                    "errors": [_error(error) for error in robot.errors],
                    "waits": [{"element": wait.element, "for": wait.text} for wait in robot.waits],
                }
                for robot in self.robots
            },
            "world": self.world,
            "reports": [
                {"time": event.time / SECOND, "robot": event.robot, "element": event.element, "text": event.detail}
                for event in self.reports
            ],
            "messages": self.messages,
        }


def _error(error: MissionError) -> dict[str, Any]:
    keys = ("code", "element", "file", "line", "text")
    return {key: getattr(error, key) for key in keys}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What is to be run. `cast` is who plays which pool, by robot; `faults` is what will break."""

    file: str
    definitions: Definitions
    library: Library
    cast: Mapping[str, Pool]
    world: WorldConfig | None
    seed: int
    duration: float
    faults: tuple[Fault, ...] = ()

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        seed: int | None = None,
        duration: float | None = None,
        semantics: str | None = None,
        library: Sequence[str | Path] = (),
        robots: Mapping[str, int] = MappingProxyType({}),
        faults: Sequence[Fault] = (),
    ) -> Scenario:
        """A scenario file (.yaml), or a model (.bpmn), whose robots then are engines without a world.

        `seed`, `duration` (simulated s) and `semantics` override what the files say; `library` adds folders; `robots`
        is how many shall play a multi-instance pool, by its name: more than the file has are copies of its last one,
        placed by the seed; `faults` break what they name.
        Raises ConfigError and ModelError: file, line, what was found, what would be right.
        """
        from fame.bpmn.reader import read

        path = Path(path)
        if path.suffix.lower() in (".yaml", ".yml"):
            said = _read(path)
        elif path.suffix.lower() in (".bpmn", ".xml"):
            said = _Said(model=path)
        else:
            raise ConfigError("is neither a scenario (.yaml) nor a model (.bpmn)", file=str(path))
        definitions = read(said.model)
        if semantics is not None:
            definitions = with_semantics(definitions, semantics)
        found = Library([*library, *said.library])
        pools = pools_of(definitions)
        for pool in pools:
            found.closure(definitions, pool.process)
        counts = _counts(pools, robots, str(path))
        chosen = said.seed if seed is None else seed
        world = _populated(said.world, counts, chosen) if said.world is not None else None
        names = [robot.name for robot in world.robots] if world is not None else _names(pools, counts)
        cast = bind([pool for pool in pools if counts.get(pool.name) != 0], names, file=str(path))
        for fault in faults:
            if fault.robot not in cast:
                text = f"found no robot {fault.robot!r} to be at fault; the robots are {', '.join(cast)}"
                raise ConfigError(text, file=str(path))
        return cls(
            file=str(path),
            definitions=definitions,
            library=found,
            cast=cast,
            world=world,
            seed=chosen,
            duration=said.duration if duration is None else duration,
            faults=tuple(faults),
        )

    def closures(self) -> list[Definitions]:
        """The files of all that runs: that of the model first, then those of called processes."""
        files = {self.definitions.file: self.definitions}
        for pool in self.cast.values():
            files.update((home.file, home) for home, _ in self.library.closure(self.definitions, pool.process))
        return list(files.values())

    def run(
        self,
        *,
        real_time: bool = False,
        observer: Callable[[Event], object] | None = None,
        progress: Callable[[Progress], object] | None = None,
        record: bool = False,
        strict: bool = False,
    ) -> Result:
        """Run it. Simulated time unless `real_time`; `observer` gets every event; `record` keeps what pictures need.

        Raises ModelError, MessageError and ConfigError for what is wrong before anything moves; what goes wrong later
        is in the result.
        """
        return _Run(self, real_time, observer, progress, record, strict).result()


@dataclass(frozen=True, slots=True)
class _Said:
    """What a scenario file says."""

    model: Path
    world: WorldConfig | None = None
    seed: int = 0
    duration: float = DURATION
    library: tuple[Path, ...] = ()


def _read(path: Path) -> _Said:
    from sim2d.config import read_world, world_config
    from sim2d.reading import Entry, read_yaml

    data, source = read_yaml(path)
    top = Entry(data, "", source)
    keys = top.mapping(_KEYS)
    if "model" not in keys:
        raise top.error("names no model; add model: FILE.bpmn")
    world = None
    if "world" in keys and isinstance(keys["world"].value, str):
        world = read_world(path.parent / keys["world"].value)
    elif "world" in keys:
        world = world_config(data["world"], source, "world")
    folders = keys["library"].items() if "library" in keys else []
    return _Said(
        model=path.parent / keys["model"].text(),
        world=world,
        seed=keys["seed"].whole(minimum=0) if "seed" in keys else 0,
        duration=keys["duration"].number(above=0) if "duration" in keys else DURATION,
        library=tuple(path.parent / folder.text() for folder in folders),
    )


def read_scenario_world(path: Path) -> tuple[WorldConfig | None, int]:
    """The world of a scenario file, or of a file that is a world itself, and its seed. Raises ConfigError."""
    from sim2d.config import read_world
    from sim2d.reading import read_yaml

    data, _ = read_yaml(path)
    if isinstance(data, Mapping) and "model" in data:
        said = _read(path)
        return said.world, said.seed
    return read_world(path), 0


def _counts(pools: Sequence[Pool], robots: Mapping[str, int], file: str) -> dict[str, int]:
    """How many robots shall play which pool, by its name as drawn. Raises ConfigError."""
    counts = {}
    for name, count in robots.items():
        pool = next((pool for pool in pools if pool.name.casefold() == name.casefold()), None)
        if pool is None:
            known = ", ".join(pool.name for pool in pools)
            raise ConfigError(f"found no pool {name!r} for {name}={count}; the pools are {known}", file=file)
        if not pool.multi_instance:
            text = (
                f"found {name}={count}, but pool {pool.name!r} is a single robot; a multi-instance one would be right"
            )
            raise ConfigError(text, file=file)
        counts[pool.name] = count
    return counts


def _populated(world: WorldConfig, counts: Mapping[str, int], seed: int) -> WorldConfig:
    """The world with so many robots for each of these pools. Raises ConfigError if there is no room for them."""
    from sim2d.placement import place

    for name, count in counts.items():
        prefixes = (robot.name[: len(name)] for robot in world.robots if robot.name[len(name) :].startswith("_"))
        own = next((prefix for prefix in prefixes if prefix.casefold() == name.casefold()), name)
        world = replace(world, robots=place(world, own, count, seed))
    return world


def _names(pools: Sequence[Pool], counts: Mapping[str, int]) -> list[str]:
    """The robots of a scenario without a world."""
    names = []
    for pool in pools:
        numbers = range(1, counts.get(pool.name, 1) + 1)
        names += [f"{pool.name}_{number}" for number in numbers] if pool.multi_instance else [pool.name]
    return names


def with_semantics(definitions: Definitions, semantics: str) -> Definitions:
    """The same model with all processes of one semantics, ``standard`` or ``original``. Raises ConfigError."""
    if semantics not in ("standard", "original"):
        raise ConfigError(f"semantics {semantics!r}: it is standard or original")
    processes = tuple(replace(process, semantics=semantics) for process in definitions.processes)  # type: ignore[arg-type]
    return replace(definitions, processes=processes)


class _Run:
    """One run of a scenario, while it lasts."""

    def __init__(
        self,
        scenario: Scenario,
        real_time: bool,
        observer: Callable[[Event], object] | None,
        progress: Callable[[Progress], object] | None,
        record: bool,
        strict: bool,
    ) -> None:
        self.scenario, self.observer, self.progress = scenario, observer, progress
        self.scheduler: Scheduler = WallScheduler() if real_time else Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.interrupted = self._stuck = False
        self.reports: list[Event] = []
        self.captions = Captions(scenario.closures()) if record or progress else None
        self.world, self.recorder = self._build_world(record)
        watching = observer is not None or self.captions is not None
        shared = shared_topics(scenario.definitions, pools_of(scenario.definitions), scenario.library)
        self.nodes = [
            RobotNode(
                robot,
                mission(scenario.definitions, pool.process, library=scenario.library, shared=shared),
                scheduler=self.scheduler,
                middleware=self.middleware,
                observer=self._observe if watching else None,
                on_report=self.reports.append,
                safe_state=self.world.robots[robot].SAFE_STATE if self.world is not None else (),
                safe_suspended=self.world.robots[robot].SAFE_SUSPENDED if self.world is not None else (),
                strict=strict,
            )
            for robot, pool in scenario.cast.items()
        ]
        for node in self.nodes:
            node.load()
        self.dead: set[str] = set()
        self._check_faults()

    def _check_faults(self) -> None:
        for fault in self.scenario.faults:
            kinds = ("engine", *(self.world.robots[fault.robot].FAULTS if self.world is not None else ()))
            if fault.kind not in kinds:
                text = f"found the fault {fault.kind!r} for {fault.robot}; known are: {', '.join(kinds)}"
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
        world.watchers.append(lambda _: self.scheduler.stop() if self._over() else None)
        return world, recorder

    def _observe(self, event: Event) -> None:
        if self.captions is not None:
            self.captions.add(event)
        if self.observer is not None:
            self.observer(event)

    def _over(self) -> bool:
        """Something has run, and nothing runs any more."""
        return any(node.instances for node in self.nodes) and not any(node.engine.instances for node in self.nodes)

    def result(self) -> Result:
        """Let it go on until it is over, stop everything safely, and say how it went."""
        begun = time.monotonic()
        with self._interruptible(), heartbeat():
            status = self._work(begun)
        simulated = self.scheduler.now / SECOND
        waits = {
            node.name: tuple(node.waits()) if node.engine.instances or not node.started else ()
            for node in self.nodes
            if node.name not in self.dead
        }
        robots = tuple(_robot_result(node, waits.get(node.name, ())) for node in self.nodes)
        if status == "timeout" and any(robot.failed for robot in robots):
            status = "failed"
        world = self.world.summary() if self.world is not None else None
        if self.recorder is not None:
            self.recorder.finish(self.world)
        self._stop()
        return Result(
            status=status,
            seed=self.scenario.seed,
            robots=robots,
            simulated=simulated,
            wall=time.monotonic() - begun,
            reports=tuple(self.reports),
            ending="nothing can move any more" if self._stuck else "not over",
            world=world,
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

        former = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, former)

    def _work(self, begun: float) -> Status:
        """Run until the mission is over or its time is up."""
        if self.world is not None:
            self.world.start()
        for node in self.nodes:
            node.start()
        for fault in self.scenario.faults:
            self.scheduler.after(round(fault.time * SECOND), partial(self._break, fault))
        end, told = round(self.scenario.duration * SECOND), begun
        slice_ = round((_PROGRESS if isinstance(self.scheduler, WallScheduler) else _SLICE) * SECOND)
        while self.scheduler.now < end and not self._over() and not self.interrupted:
            if self.world is None and self.scheduler.next_time() is None:
                self._stuck = True
                break
            self.scheduler.run(min(end, self.scheduler.now + slice_))
            if self.progress is not None and (now := time.monotonic()) - told >= _PROGRESS:
                told = now
                self._tell()
        if self.progress is not None:
            self._tell()
        if not self._over():
            return "interrupted" if self.interrupted else "timeout"
        failed = any(instance.status == "failed" for node in self.nodes for instance in node.instances)
        return "failed" if failed else "completed"

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

    def _kill(self, node: RobotNode) -> None:
        """Take an engine away as if its process had ended: it says nothing more, and what it was at has failed."""
        for instance in node.engine.instances.values():
            element = next((rest.node.id for rest in instance.rests()), "")
            text = f"its engine died at {self.scheduler.now / SECOND:g} s"
            instance.error = MissionError(text, robot=node.name, element=element, code="engine")
            instance.status = "failed"
            root, process = instance.root.key, node.mission.process.id
            self._observe(Event(self.scheduler.now, node.name, instance.key, root, process, "end", "failed"))
        node.failed += len(node.engine.instances)
        node.engine.instances.clear()
        node.node.close()  # first of all, so that no script says a last word
        node.close()

    def _stop(self) -> None:
        """Bring every robot that lives to its safe state and leave."""
        for node in self.nodes:
            if node.name not in self.dead:
                node.stop()
                node.close()
        if self.world is not None:
            self.world.close()


def _robot_result(node: RobotNode, waits: tuple[Wait, ...]) -> RobotResult:
    instances = node.instances
    return RobotResult(
        name=node.name,
        instances=len(instances),
        completed=sum(instance.status == "completed" for instance in instances),
        failed=sum(instance.status == "failed" for instance in instances),
        elements=sum(instance.visits.total() for instance in instances),
        errors=tuple(instance.error for instance in instances if instance.error is not None),
        waits=waits,
    )


class Captions:
    """What each robot's process is at, told from events: its outermost activity, and the one entered last."""

    def __init__(self, files: Sequence[Definitions]) -> None:
        self.names = {
            node.id: node.label
            for file in reversed(files)
            for process in file.processes
            for node in process.body.walk()
            if isinstance(node, Activity)
        }
        self.active: dict[str, dict[tuple[int, int, str], None]] = {}
        self.now: dict[str, str] = {}
        self.labels: list[tuple[float, str, str]] = []

    def add(self, event: Event) -> None:
        """Take note of an event."""
        if event.what in ("enter", "leave", "cancel", "fail") and event.element not in self.names:
            return
        active = self.active.setdefault(event.robot, {})
        key = (event.instance, event.scope, event.element)
        if event.what == "enter":
            active[key] = None
        elif event.what in ("leave", "cancel", "fail"):
            active.pop(key, None)
        elif event.what == "end":
            for other in [other for other in active if other[0] == event.instance]:
                del active[other]
            self._say(event, f"({event.detail})")
            return
        else:
            return
        names = [self.names[element] for _, _, element in active]
        if names:
            self._say(event, names[0] if len(names) == 1 else f"{names[0]}: {names[-1]}")

    def _say(self, event: Event, text: str) -> None:
        if self.now.get(event.robot) != text:
            self.now[event.robot] = text
            self.labels.append((event.time / SECOND, event.robot, text))
