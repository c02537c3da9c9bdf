"""A simulation of one process for Python code: an engine, local topics and simulated time.

It is no `fame.scenario.run.Run` of one robot: a run has a plan, a cast and an end, and belongs to a layer above. What
both have in common is one call, of `RobotNode`; a mission by hand (`fame.testing.by_hand`) is such a run. A
compiled program is kept here for further simulations of its model, of which a test may make many.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from datetime import datetime
from numbers import Integral, Real
from pathlib import Path
from random import Random
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.topics import TopicUse, topic_table
from fame.clock import EPOCH, SECOND, Scheduler
from fame.engine import Instance
from fame.errors import ConfigError, ModelError, expect
from fame.middleware.local import LocalMiddleware
from fame.randomness import SEEDS, ModuleRandom, robot_random
from fame.robot import Event, Mission, RobotNode, ServiceFunction, make_mission
from fame.robot.options import RobotOptions
from fame.text import topic_of


class Simulation:
    """Runs one process of a model in simulated time.

    A process without services and without calls of other files is compiled once for all simulations of `definitions`.

    definitions  a model, from `fame.read`, or its path
    process      its id, or the name of its pool; may be left out if the file has one that is executable
    variables    what the instance that starts by itself begins with
    services     callables by name, for service tasks: functions of the variables (a dict)
    observer     called with each `fame.robot.events.Event`; a `fame.EventLog` keeps them. Without one the run is faster
    library      folders with called processes, besides those of the model and of FAME
    robot        the robot's name and namespace
    epoch        the date of simulated second 0, with a time zone
    seed         of `robot.random`, and of the modules `random` and `numpy.random` in scripts and services

    Raises ModelError if the model cannot be executed, MessageError for topics and types that do not go together,
    ConfigError for arguments of a wrong kind.
    """

    def __init__(
        self,
        definitions: Definitions | str | Path,
        process: str | None = None,
        variables: Mapping[str, Any] | None = None,
        *,
        services: Mapping[str, ServiceFunction] | None = None,
        observer: Callable[[Event], object] | None = None,
        library: str | Path | Sequence[str | Path] = (),
        robot: str = "robot",
        strict: bool = False,
        epoch: datetime = EPOCH,
        seed: int = 0,
    ) -> None:
        from fame.bpmn.reader import read

        definitions = read(definitions)
        expect(process is None or isinstance(process, str), "process", process, "an id or the name of a pool")
        expect(isinstance(robot, str), "robot", robot, "a name")
        dated = isinstance(epoch, datetime) and epoch.tzinfo is not None
        expect(dated, "epoch", epoch, "a datetime with a time zone")
        expect(observer is None or callable(observer), "observer", observer, "a function of events")
        expect(
            services is None or (isinstance(services, Mapping) and all(map(callable, services.values()))),
            "services", services, "a mapping of names to functions",
        )  # fmt: skip
        expect(isinstance(seed, Integral) and int(seed) >= 0, "seed", seed, "a whole number from 0 on")
        _expect_values("variables", variables)
        self._seed = seed
        self.scheduler: Scheduler = Scheduler()
        self.middleware: LocalMiddleware = LocalMiddleware(self.scheduler)
        self.reports: list[Event] = []
        chosen = choose_process(definitions, process, "; fame.Scenario.load(path).run() runs all of them")
        folders, kept = Library(library), (chosen.id, observer is not None)
        mission, program = definitions.made.get(kept) or (
            make_mission(definitions, chosen, library=folders, services=services, shared=_declared(definitions)),
            None,
        )
        # to exchange the states of the modules takes longer than most stimuli
        modules = mission.random_modules
        self._random: AbstractContextManager[object] = ModuleRandom(seed, modules=modules) if modules else nullcontext()
        self.node: RobotNode = RobotNode(
            robot,
            mission,
            scheduler=self.scheduler,
            middleware=self.middleware,
            options=RobotOptions(
                observer=observer,
                on_report=self.reports.append,
                strict=strict,
                epoch=epoch,
                random=robot_random(seed, robot),
            ),
            compiled=False,
        )
        self.node.assemble(program or self.node.compile_process())
        if program is None and _is_for_all(mission):
            definitions.made[kept] = mission, self.node.engine.program
        self.node.load()
        self._outside = self.middleware.node("outside")
        self._strict = strict
        self._variables, self._begun, self._until = dict(variables or {}), False, None

    _until: float | None

    @property
    def instances(self) -> list[Instance]:
        """The instances in the order of their starts: all that run, and the last thousand of those that have ended.

        `node.started`, `node.completed` and `node.failed` count all there have been.
        """
        return self.node.instances

    @property
    def now(self) -> float:
        """Simulated seconds since the start."""
        return self.scheduler.now / SECOND

    def run(self, until: float | None = None) -> Simulation:
        """Run until nothing can move without an outside event, or until simulated second `until`."""
        number = until is None or (isinstance(until, Real) and not math.isnan(until))
        expect(number, "until", until, "a number of seconds")
        self._until = None if until == math.inf else until
        self._begin()
        with self._random:
            self._go_on()
        return self

    def signal(self, name: str, payload: Any = None) -> Simulation:
        """Send a message on topic `name` (``~/odom`` or ``/robot/odom``: the robot's own) from outside, then run
        on.

        Running on goes as far as the last `run` did: to where nothing can move, or, if that had an `until`, no further
        than the present instant. Raises MessageError if the payload does not fit the type of the topic, and for a topic
        that no event or script of the model names; a topic without a listener at the moment is not an error.
        """
        expect(isinstance(name, str), "name", name, "the name of a topic")
        self._begin()
        with self._random:
            self.node.deliver(topic_of(name), payload)
            self._go_on()
        return self

    def message(self, name: str, payload: Any = None) -> Simulation:
        """Send a BPMN message to this process and run on, as `signal` does. One catcher gets it, else a start event."""
        return self.signal(name, payload)

    def complete(self, element: str, values: Mapping[str, Any] | None = None) -> Simulation:
        """Complete a user, manual or receive task with results; then run on as `signal` does.

        Raises MissionError if no token waits there.
        """
        _expect_values("values", values)
        self._begin()
        with self._random:
            self.node.complete(element, values)
            self._go_on()
        return self

    def activate(self, element: str) -> Simulation:
        """Start an element of an open ad-hoc sub-process (again); then continue as `signal` does.

        Raises MissionError if no such sub-process is open.
        """
        self._begin()
        with self._random:
            self.node.activate(element)
            self._go_on()
        return self

    def start(self, variables: Mapping[str, Any] | None = None) -> Instance:
        """Start one more instance at the none start event. Raises MissionError if the process has none."""
        _expect_values("variables", variables)
        self._begin()
        with self._random:
            return self.node.engine.start(dict(variables or {}))

    def save(self, path: str | Path) -> None:
        """Write the state into a file, from which `load` goes on: tokens, variables, timers, queues, what has ended.

        Scripts that wait start again when the file is loaded. What is loaded draws other random numbers, from
        a seed that is made of this one and the time. Raises ConfigError for a file that cannot be written, and for a
        variable that cannot be stored.
        """
        from fame.robot.restoring import description, save

        self._begin()
        mission = self.node.mission
        header = {
            "simulation": mission.definitions.file,
            "process": mission.process.id,
            "robot": self.node.name,
            "epoch": self.node.epoch.isoformat(),
            "strict": self._strict,
            "now": self.scheduler.now,
            "seed": self._seed,
            "holds": sorted(self.node.holds),
            "observed": self.node.engine.program.observed,
            **description(self.node.engine.program),
        }
        save(self.node, Path(path), header)

    @classmethod
    def load(
        cls,
        path: str | Path,
        definitions: Definitions | str | Path | None = None,
        *,
        services: Mapping[str, ServiceFunction] | None = None,
        observer: Callable[[Event], object] | None = None,
        library: str | Path | Sequence[str | Path] = (),
    ) -> Simulation:
        """Go on from a file that `save` has written, at the simulated time that it was saved.

        The model is read again from its file, unless it is given. Raises ConfigError for a file that is damaged or is
        no such state, and for the state of another model.
        """
        from fame.robot.journal import read_segment
        from fame.robot.restoring import load

        found = read_segment(Path(path))
        header = found.header
        if "simulation" not in header:
            raise ConfigError("is the journal of an engine, not a saved simulation", file=str(path))
        if observer is not None and not header["observed"]:
            raise ConfigError("was saved by a simulation without an observer, so it can have none", file=str(path))
        simulation = cls(
            definitions if definitions is not None else header["simulation"],
            header["process"],
            services=services,
            observer=observer or ((lambda event: None) if header["observed"] else None),
            library=library,
            robot=header["robot"],
            strict=header["strict"],
            epoch=datetime.fromisoformat(header["epoch"]),
            seed=Random(f"{header.get('seed', 0)} at {header['now']}").randrange(SEEDS),
        )
        simulation.scheduler.now, simulation._begun = header["now"], True
        simulation.node.holds.update(header.get("holds", ()))
        with simulation._random:
            load(simulation.node, found)
        return simulation

    def close(self) -> None:
        """End all that goes on."""
        with self._random:
            self.node.stop()
            self.node.close()

    def _begin(self) -> None:
        if not self._begun:
            self._begun = True
            with self._random:
                self.node.start(self._variables)

    def _go_on(self) -> None:
        self.scheduler.run(None if self._until is None else max(self.scheduler.now, round(self._until * SECOND)))


def _expect_values(argument: str, values: object) -> None:
    names = all(isinstance(name, str) for name in values) if isinstance(values, Mapping) else values is None
    expect(names, argument, values, "a mapping of names to values")


def _is_for_all(mission: Mission) -> bool:
    """Whether its program is the same for each simulation of its file: without services and calls of other files."""
    return all(home is mission.definitions and not node.operation for home, node in mission.flow_nodes())


def _declared(definitions: Definitions) -> dict[str, TopicUse]:
    """Return the topics whose type some process of the file says: it holds for the process that is run, too."""
    found: dict[str, TopicUse] = {}
    for process in definitions.processes:
        with suppress(ModelError):  # reported if that one is run
            table = topic_table(definitions, [process.id])
            found.update((name, use) for name, use in table.items() if use.declared)
    return found


def choose_process(definitions: Definitions, name: str | None, advice: str = "") -> Process:
    """Return a process by id, or by the name of its pool; without a name the only one, or the only executable one.

    Raises ModelError if there is no such process, or more than one: then with `advice`.
    """
    processes = definitions.processes
    has = ", ".join(process.id for process in processes) or "none"
    if name is not None:
        pools = [pool.process for pool in definitions.participants if name in (pool.name, pool.label)]
        found = definitions.process(name) or (definitions.process(pools[0]) if pools else None)
        if found is None:
            raise ModelError(f"has no process or pool {name!r}; it has {has}", file=definitions.file)
        return found
    only = definitions.only_executable
    if only is None:
        text = f"name the process to run: the file has {has}"
        raise ModelError(text + (advice if len(processes) > 1 else ""), file=definitions.file)
    return only
