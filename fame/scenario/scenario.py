"""The scenario: a plan that is read from files, checked, and can be run in one process."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from datetime import datetime
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

from fame.bpmn.library import Library
from fame.bpmn.linked_forms import form_of, left_out, unfit_values
from fame.bpmn.model import CallActivity, Definitions, FlowNode, Task, ids_named
from fame.bpmn.pools import Pool, assign_pools, expected_robots, matches, pools_of, robot_names, shared_topics
from fame.check.scope import Finding, find_scope, of_error
from fame.check.service_topics import all_service_places
from fame.check.value_kinds import Sample, kind_of, kinds_of
from fame.clock import Scheduler
from fame.config.values import Source
from fame.errors import ConfigError, FameError, MessageError, ModelError, UnavailableError, expect
from fame.middleware.errors import type_conflict
from fame.middleware.interface import TopicInfo, resolve
from fame.middleware.local import LocalMiddleware
from fame.robot import Event, make_mission
from fame.scenario.plan import Completion, Fault, OutsideSignal, Plan, ScenarioFile, read_scenario
from fame.scenario.result import Progress, Result, mistyped_topics
from fame.scenario.run import Pace, Run
from fame.scenario.settings import by_robot, check_network, with_parameters
from fame.scripting.effects import Direction, computed_topics
from fame.text import suggestion

if TYPE_CHECKING:
    from fame.middleware.network import NetworkConfig
    from fame.properties.sentence import Property
    from fame.robot.services import ServiceTopic
    from sim2d.config import WorldConfig


_Services: TypeAlias = "Sequence[Sequence[ServiceTopic] | None]"
"""The topics of each service of a robot, by full name; None if they are not known."""
_LATEST = 1e9
"""Maximum simulated time, s."""
_MOST = 100_000
"""Maximum number of robots of a pool; a thousand were measured."""


class Scenario(Plan):
    """A plan that is read from files and can be run."""

    __slots__ = ()

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        seed: int | None = None,
        duration: float | None = None,
        epoch: datetime | None = None,
        semantics: str | None = None,
        library: str | Path | Sequence[str | Path] = (),
        robots: Mapping[str, int] = MappingProxyType({}),
        faults: Sequence[Fault] = (),
        completions: Sequence[Completion] = (),
        network: NetworkConfig | None = None,
        variables: Mapping[str, Any] = MappingProxyType({}),
        changes: Mapping[str, Any] = MappingProxyType({}),
        model: Definitions | None = None,
    ) -> Scenario:
        """Load a scenario file (.yaml), or a model (.bpmn), whose robots are then engines without a world.

        `seed`, `duration` (simulated s), `epoch` (with a time zone) and `semantics` override the files; `library` adds
        folders. `robots` is the number of robots of multi-instance pools, by pool (for a model alone the default is the
        minimum of its multiplicity); robots beyond those of the file are copies of its last one, placed by the seed.
        `faults` are injected; `completions` are added to those of the file. `network` adds links and partitions to the
        file's; `variables` are mission parameters as there, of all robots or by robot, and override the file.
        `changes` are other values of the file, by path (`world.robots.REX.at`); `model` is taken for that of the file.

        Raises ConfigError and ModelError with file, line, expected and actual value.
        """
        from fame.bpmn.reader import read

        _expect_arguments(path, seed, duration, epoch, robots, faults, completions)
        expect(isinstance(variables, Mapping), "variables", variables, "a mapping of names to values")
        if network is not None:
            from fame.middleware.network import NetworkConfig

            expect(isinstance(network, NetworkConfig), "network", network, "a fame.middleware.network.NetworkConfig")
        path = Path(path)
        content = _scenario_file(path, changes)
        definitions = read(content.model) if model is None else model
        definitions = with_semantics(definitions, semantics) if semantics is not None else definitions
        folders = Library([*Library(library).folders, *content.library])
        pools = pools_of(definitions)
        for pool in pools:
            folders.closure(definitions, pool.process)
        seed = content.seed if seed is None else seed
        world, cast = _assign(content, pools, robots, seed, str(path))
        _check_faults(faults, cast, str(path))
        wanted = [*content.completions, *((done, "") for done in completions)]
        nodes = {robot: _tasks(folders, definitions, pool) for robot, pool in cast.items()}
        completions = tuple(_completions(wanted, nodes, content))
        joined = _joined(content, network, list(cast))
        values = _merged(content.variables, by_robot(variables))
        cast, chosen = with_parameters(cast, definitions, folders, values, content.source)
        return cls(
            file=str(path),
            definitions=definitions,
            library=folders,
            cast=cast,
            world=world,
            seed=seed,
            duration=content.duration if duration is None else duration,
            faults=tuple(faults),
            completions=completions,
            signals=_signals(content, definitions, folders, cast),
            epoch=content.epoch if epoch is None else epoch,
            network=joined,
            variables=chosen,
            types=content.types,
            properties=_properties(content, definitions, folders, cast),
        )

    def run(
        self,
        *,
        real_time: bool = False,
        observer: Callable[[Event], object] | None = None,
        progress: Callable[[Progress], object] | None = None,
        strict: bool = False,
        on_interrupt: Callable[[], object] | None = None,
        pace: Pace | None = None,
        hold_errors: bool = False,
    ) -> Result:
        """Run the scenario, in simulated time unless `real_time`.

        `observer` is called with every event. The first Ctrl-C calls `on_interrupt` and ends the run after the current
        step; the second ends it at once. `pace` decides when the run goes on. With `hold_errors` an uncaught error
        does not fail a mission: it is an incident, and its robot holds.

        Raises ModelError, MessageError and ConfigError for errors before the mission begins; later errors are in the
        result.
        """
        return Run(
            self, real_time, observer, progress, strict, on_interrupt, pace=pace, hold_errors=hold_errors
        ).result()


def _properties(
    content: ScenarioFile, definitions: Definitions, library: Library, cast: Mapping[str, Pool]
) -> tuple[Property, ...]:
    """The properties of a file, and those beside and in its model that it does not have itself.

    Raises ConfigError, ModelError.
    """
    from fame.properties.diagram import drawn_properties
    from fame.properties.files import beside

    pools = pools_of(definitions)
    for pose in content.poses:
        if not any(pose.robot == pool.name or matches(pose.robot, pool) for pool in pools):
            known = [*cast, *(pool.name for pool in pools if pool.multi_instance)]
            raise pose.error(f"unknown robot or pool {pose.robot!r}; {suggestion(pose.robot, known)}")
    properties: dict[str, Property] = {}
    for property in (*content.properties, *beside(content.model), *drawn_properties(definitions, library, cast)):
        properties.setdefault(property.name, replace(property, poses=content.poses or property.poses))
    return tuple(properties.values())


def _joined(content: ScenarioFile, added: NetworkConfig | None, robots: Sequence[str]) -> NetworkConfig | None:
    """The network of a file with links and partitions of its caller. Raises ConfigError for unknown robots."""
    own = content.network
    check_network(own, robots, content.source)
    check_network(added, robots, Source(content.source.file))
    if own is None or added is None:
        return own or added
    return replace(own, links=(*own.links, *added.links), partitions=(*own.partitions, *added.partitions))


def _expect_arguments(
    path: object,
    seed: object,
    duration: object,
    epoch: object,
    robots: object,
    faults: Sequence[object],
    completions: Sequence[object],
) -> None:
    """Raise ConfigError for an argument of `Scenario.load` of the wrong kind."""
    expect(isinstance(path, str | PathLike), "path", path, "that of a scenario or model")
    expect(seed is None or (isinstance(seed, Integral) and int(seed) >= 0), "seed", seed, "a whole number from 0 on")
    seconds = duration is None or (isinstance(duration, Real) and 0 < float(duration) <= _LATEST)
    expect(seconds, "duration", duration, "a number of seconds above 0, up to 1e9")
    numbers = isinstance(robots, Mapping) and all(
        isinstance(each, Integral) and int(each) >= 0 for each in robots.values()
    )
    expect(numbers, "robots", robots, "a mapping of pools to numbers from 0 on")
    for fault in faults:
        valid = isinstance(fault, Fault) and isinstance(fault.time, Real) and 0 <= float(fault.time) < _LATEST
        expect(valid, "faults", fault, 'a Fault("REX", 40.0, "engine"), at a second from 0 on')
    dated = epoch is None or (isinstance(epoch, datetime) and epoch.tzinfo is not None)
    expect(dated, "epoch", epoch, "a datetime with a time zone")
    for done in completions:
        expect(isinstance(done, Completion), "completions", done, 'a Completion("REX", 12.0, "Task_Sign")')


def _assign(
    content: ScenarioFile, pools: Sequence[Pool], robots: Mapping[str, int], seed: int, file: str
) -> tuple[WorldConfig | None, dict[str, Pool]]:
    """The world with the wanted number of robots, and the pool of each robot and computer. Raises ConfigError."""
    counts = _counts(pools, robots, file)
    world = _populated(content.world, counts, seed) if content.world is not None else None
    bodies = [robot.name for robot in world.robots] if world is not None else []
    names = [*bodies, *content.computers] if world is not None or content.computers else robot_names(pools, counts)
    expected = [pool for pool in pools if counts.get(pool.name) != 0]
    for name in bodies if content.world is not None else []:
        if not any(matches(name, pool) for pool in expected):
            known = ", ".join(expected_robots(pool) for pool in expected)
            text = f"expected a robot of a pool ({known}), got {name!r}"
            raise content.source.error(f"world.robots.{name}", text)
    try:
        cast = assign_pools(expected, names, file=file)
    except ConfigError as error:
        raise content.source.error("world.robots" if world is not None else "", error.text) from None
    _check_numbers(pools, cast, file)
    return world, cast


def _counts(pools: Sequence[Pool], robots: Mapping[str, int], file: str) -> dict[str, int]:
    """The wanted number of robots of each pool, by its name as drawn. Raises ConfigError."""
    counts = {}
    for name, count in robots.items():
        pool = next((pool for pool in pools if pool.name.casefold() == name.casefold()), None)
        if pool is None:
            known = ", ".join(pool.name for pool in pools)
            raise ConfigError(f"unknown pool {name!r} in {name}={count}; pools are: {known}", file=file)
        if not pool.multi_instance:
            text = f"expected a multi-instance pool in {name}={count}, got pool {pool.name!r}, which is a single robot"
            raise ConfigError(text, file=file)
        if count > _MOST:
            raise ConfigError(f"expected at most {_MOST} robots, got {name}={count}", file=file)
        counts[pool.name] = count
    return counts


def _populated(world: WorldConfig, counts: Mapping[str, int], seed: int) -> WorldConfig:
    """The world with `counts` robots for each of these pools. Raises ConfigError if the ground is full."""
    from sim2d.grid import place

    for name, count in counts.items():
        prefixes = (robot.name[: len(name)] for robot in world.robots if robot.name[len(name) :].startswith("_"))
        own = next((prefix for prefix in prefixes if prefix.casefold() == name.casefold()), name)
        world = replace(world, robots=place(world, own, count, seed))
    return world


def _scenario_file(path: Path, changes: Mapping[str, Any]) -> ScenarioFile:
    """Read a scenario file, or take a model alone. Raises ConfigError for other files."""
    if path.suffix.lower() in (".yaml", ".yml"):
        return read_scenario(path, changes)
    if path.suffix.lower() in (".bpmn", ".xml"):
        if changes:
            raise ConfigError("expected a scenario (.yaml) to change, got a model", file=str(path))
        return ScenarioFile(model=path, source=Source(str(path)))
    raise ConfigError("expected a scenario (.yaml) or a model (.bpmn)", file=str(path))


def _check_faults(faults: Sequence[Fault], cast: Mapping[str, Pool], file: str) -> None:
    """Raise ConfigError for a fault of an unknown robot."""
    for fault in faults:
        if fault.robot not in cast:
            text = f"unknown robot {fault.robot!r} in --fault; robots are: {', '.join(cast)}"
            raise ConfigError(text, file=file)


def _check_numbers(pools: Sequence[Pool], cast: Mapping[str, Pool], file: str) -> None:
    """Raise ConfigError for more robots of a multi-instance pool than its model allows."""
    for pool in pools:
        playing = sum(played.name == pool.name for played in cast.values())
        if pool.multi_instance and pool.maximum is not None and playing > pool.maximum:
            text = (
                f"expected at most {pool.maximum} robots for pool {pool.name!r} (its participantMultiplicity), "
                f"got {playing}"
            )
            raise ConfigError(text, file=file)


def _tasks(library: Library, definitions: Definitions, pool: Pool) -> list[tuple[Definitions, FlowNode]]:
    """The user, manual and receive tasks of a pool's process and all processes that it calls, with their files."""
    processes = library.closure(definitions, pool.process)
    nodes = ((home, node) for home, process in processes for node in process.body.walk())
    return [(home, node) for home, node in nodes if node.tag in ("userTask", "manualTask", "receiveTask")]


def _completions(
    wanted: Sequence[tuple[Completion, str]],
    nodes: Mapping[str, Sequence[tuple[Definitions, FlowNode]]],
    content: ScenarioFile,
) -> Iterator[Completion]:
    """The completions, each with the id of its task.

    Raises ConfigError for an unknown robot, an element that is not one task to complete, and values that do not fit.
    """
    for done, place in wanted:
        if done.robot not in nodes:
            text = f"unknown robot {done.robot!r} in the completion of {done.element}; robots are: {', '.join(nodes)}"
            raise content.source.error(f"{place}.robot" if place else "", text)
        tasks = [node for _, node in nodes[done.robot]]
        ids = ids_named(tasks, done.element)
        if len(ids) != 1:
            known = ", ".join(dict.fromkeys(node.display_name for node in tasks))
            text = f"expected a user, manual or receive task of {done.robot}, got {done.element!r}; " + (
                f"this is the label of {', '.join(ids)}" if ids else f"it has {known or 'none'}"
            )
            raise content.source.error(f"{place}.element" if place else "", text)
        if wrong := unfit_values(nodes[done.robot], ids[0], done.values):
            raise content.source.error(f"{place}.values" if place else "", f"{done.element}: {wrong}")
        yield replace(done, element=ids[0])


def _signals(
    content: ScenarioFile, definitions: Definitions, library: Library, cast: Mapping[str, Pool]
) -> tuple[OutsideSignal, ...]:
    """The signals of a scenario with types. Raises ConfigError for a topic that no robot uses, and a wrong payload."""
    if not content.signals:
        return ()
    from fame.middleware import messages

    known = _topics(definitions, library, cast)
    signals = []
    for signal, place in content.signals:
        if signal.topic not in known:
            text = f"no robot uses the topic {signal.topic}; {suggestion(signal.topic, sorted(known))}"
            raise content.source.error(f"{place}.name", text)
        type, qos = known[signal.topic]
        try:
            messages.create(type, signal.payload)
        except MessageError as error:
            raise content.source.error(
                f"{place}.payload" if signal.payload is not None else place, str(error)
            ) from None
        signals.append(replace(signal, type=type, qos=qos))
    return tuple(signals)


def _topics(
    definitions: Definitions, library: Library, cast: Mapping[str, Pool]
) -> dict[str, tuple[str, Mapping[str, str]]]:
    """The topics of events and scripts of all robots: full name -> type and policies of QoS."""
    shared = shared_topics(definitions, pools_of(definitions), library.declared)
    topics: dict[str, tuple[str, Mapping[str, str]]] = {}
    for robot, pool in cast.items():
        mission = make_mission(definitions, pool.process, library=library, shared=shared)
        for _, topic in mission.script_topics:
            if topic.type is not None and topic.direction in ("publish", "subscribe"):
                topics[resolve(topic.name, robot)] = topic.type, {}
        topics |= {resolve(name, robot): (use.type, use.qos) for name, use in mission.types.items()}
    return topics


def with_semantics(definitions: Definitions, semantics: str) -> Definitions:
    """Return the model with all processes of one semantics, ``standard`` or ``original``. Raises ConfigError."""
    if semantics not in ("standard", "original"):
        raise ConfigError(f"expected semantics standard or original, got {semantics!r}")
    processes = tuple(replace(process, semantics=semantics) for process in definitions.processes)  # type: ignore[arg-type]
    return replace(definitions, processes=processes)


def scenario_findings(
    path: Path, *, library: Sequence[Path] = (), strict: bool = False, model: Definitions | None = None
) -> list[Finding]:
    """Return the first error of a scenario file (or of a model with properties), its world and its robots, if there is
    one, and properties that can never be judged; `library` adds folders, `model` is taken for that of the file.

    Errors that `fame.check.check` finds in the model are found here too, so check the model first. A world that cannot
    be built because a package is missing is a warning.
    """
    try:
        run = Run(Scenario.load(path, library=library, model=model), False, None, None, strict=strict)
        never = list(run.judging.never_judged()) if run.judging is not None else []
        services = _services(run)
        unmatched = [Finding("warning", text, str(path)) for text in _unmatched_topics(run, services)]
        unmatched += [
            *_other_types(run, services, str(path)),
            *_unreachable_goals(run),
            *_without_effect(run, services, str(path)),
            *_other_kinds(run, str(path)),
            *_left_out(run, str(path)),
        ]
        run.close()
    except (ConfigError, ModelError) as error:
        return [of_error(error)]
    except UnavailableError as error:
        return [Finding("warning", f"cannot be checked: {error}", str(path))]
    except FameError as error:
        return [Finding("error", str(error), str(path))]
    return [
        Finding(
            "warning",
            f"can never be judged: {why}",
            monitor.spec.place.file,
            monitor.spec.place.line,
            monitor.spec.name,
        )
        for monitor, why in never
    ] + unmatched


def world_topics(world: WorldConfig | None, seed: int = 0) -> list[TopicInfo]:
    """Return the topics of the robots of a world. Raises ConfigError and UnavailableError if it cannot be built."""
    if world is None:
        return []
    from sim2d.world import World

    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    with closing(World(world, seed=seed, scheduler=scheduler, middleware=middleware)):
        return list(middleware.graph())


def _services(run: Run) -> list[_Services]:
    """Return the topics of the services of each robot, in the order of `run.nodes`."""
    scope = find_scope(run.scenario.definitions, run.scenario.library)
    wanted = {node.mission.process.id for node in run.nodes}
    places = {root.bpmn.id: all_service_places(root) for root in scope.processes if root.bpmn.id in wanted}
    return [
        [place.topics and [one._replace(name=resolve(one.name, node.namespace)) for one in place.topics]
         for place in places[node.mission.process.id]]
        for node in run.nodes
    ]  # fmt: skip


def _other_types(run: Run, services: Sequence[_Services], file: str) -> Iterator[Finding]:
    """Find topics that a service takes or sends with another type than others have."""
    known = {info.name: (info.types[0], {*info.publishers, *info.subscribers}) for info in run.middleware.graph()}
    for node, its in zip(run.nodes, services, strict=True):
        for one in (one for service in its for one in service or ()):
            type, users = known.setdefault(one.name, (one.type, {f"a service of {node.name}"}))
            if type != one.type:
                text = f"does not start: {type_conflict(one.name, type, sorted(users), one.type)}"
                yield Finding("error", text, one.file or file, one.line)


def _unmatched_topics(run: Run, services: Sequence[_Services]) -> Iterator[str]:
    """Yield what robots and computers wait for although nothing has it, and names that may be mistyped."""
    outside = {sent.topic for sent in run.scenario.signals}
    graph = [info for info in run.middleware.graph() if "/bpmn_" not in info.name and info.name not in outside]
    bodies: Collection[str] = run.world.robots if run.world is not None else ()
    if any(None in its for its in services):
        return  # what a pipeline publishes is not known here, nor in whose namespace
    served = [[(one.name, one.throws) for service in its for one in service or ()] for its in services]
    published = {name for its in served for name, throws in its if throws}
    here = {info.name for info in run.middleware.graph() if info.publishers} | published | outside
    thrown, taken = _computed(run, "publish"), _computed(run, "subscribe")
    for node, its in zip(run.nodes, served, strict=True):
        if run.world is None:
            continue
        engine, prefix = node.node.full_name, f"/{node.namespace}/"
        missing = [name for name, throws in its if not throws and name not in here and "/bpmn_" not in name]
        own = {info.name.removeprefix(prefix): info for info in graph
               if info.name.startswith(prefix) and info.name not in published}  # fmt: skip
        there = ", ".join(name for name, info in own.items() if info.publishers)
        waits = [info.name for info in own.values() if not info.publishers and engine in info.subscribers]
        for name in dict.fromkeys(name for name in (*waits, *missing) if not name.startswith(thrown)):
            known = _elsewhere(name, here) or (f"; there are: {there}" if there else "")
            yield f"{node.name} waits for {name}, which nothing here publishes{known}"
        unsure = [info for info in own.values() if info.subscribers or not info.name.startswith(taken)]
        if node.name in bodies:
            yield from (f"{node.name} {text}" for end, text in mistyped_topics(unsure, 0.6) if end == engine)


def _computed(run: Run, direction: Direction) -> tuple[str, ...]:
    """How the full names begin of topics that scripts compute; empty: any."""
    scripts = [(node.namespace, [one for _, one in node.mission.flow_nodes()]) for node in run.nodes]
    found = ((begins, space) for space, nodes in scripts for begins in computed_topics(nodes, direction))
    return tuple(begins and resolve(begins, space) for begins, space in found)


def _elsewhere(name: str, here: Iterable[str]) -> str:
    """Return a hint at the topic of another robot that ends alike, or an empty text."""
    own = name.split("/", 2)[-1]
    others = sorted(other for other in here if other.count("/") > 1 and other.split("/", 2)[-1] == own)
    return f"; did you mean {others[0]}? `namespace` of a monitor names its robot" if others else ""


def _without_effect(run: Run, services: Sequence[_Services], file: str) -> Iterator[Finding]:
    """Find what has no effect: after the end of the run, on topics that no robot uses."""
    scenario, network = run.scenario, run.scenario.network
    says = [(f"{one.element} of {one.robot} is completed", one.time) for one in scenario.completions]
    for what, time in (*says, *((f"{one.topic} is published", one.time) for one in scenario.signals)):
        if time > (scenario.duration or math.inf):
            text = f"{what} at {time:g} s, which is after the end of the run ({scenario.duration:g} s)"
            yield Finding("warning", text, file)
    topics = sorted({info.name for info in run.middleware.graph() if "/bpmn_" not in info.name}
                    | {one.name for its in services for service in its for one in service or ()})  # fmt: skip
    unknown = any(None in its for its in services)
    computed = ("",) if unknown else (*_computed(run, "publish"), *_computed(run, "subscribe"))
    for link in network.links if network is not None else ():
        if link.topic and link.topic not in topics and not link.topic.startswith(computed):
            text = f"network: no robot uses the topic {link.topic}; {suggestion(link.topic, topics)}"
            yield Finding("warning", text, file)


def _left_out(run: Run, file: str) -> Iterator[Finding]:
    """Find completions without what the form of their task requires and nothing sets."""
    scope = find_scope(run.scenario.definitions, run.scenario.library)
    for done in run.scenario.completions:
        node = next(one for one in run.nodes if one.name == done.robot)
        root = next(one for one in scope.processes if one.bpmn.id == node.mission.process.id)
        for key in left_out(node.mission.flow_nodes(), done.element, done.values):
            if not kinds_of(scope, root, key.partition(".")[0]):
                text = f"completes {done.element} of {done.robot} without {key}, which its form requires"
                yield Finding("warning", text, file)


def _other_kinds(run: Run, file: str) -> Iterator[Finding]:
    """Find mission parameters, and answers to tasks without a form, that are of another kind than what the model sets
    their variables to."""
    scope = find_scope(run.scenario.definitions, run.scenario.library)
    roots = {pool.bpmn.id: pool for pool in scope.processes}
    given = [(robot, "variables:", values) for robot, values in run.scenario.variables.items()]
    for done in run.scenario.completions:
        node = next(one for one in run.nodes if one.name == done.robot)
        tasks = ((home, task) for home, task in node.mission.flow_nodes() if task.id == done.element)
        if not any(isinstance(task, Task) and form_of(home, task.human) for home, task in tasks):
            given.append((done.robot, f"completes {done.element} of {done.robot} with", done.values))
    for robot, doing, values in given:
        root = roots[run.scenario.cast[robot].process.id]
        for name, value in values.items():
            known, kind = kind_of(scope, root, name), Sample(root, root.bpmn, value).kind
            if known and kind and known != kind:
                text = f"{doing} {name} = {value!r}, {kind}; elsewhere it is {known}"
                yield Finding("warning", text, file)


def _unreachable_goals(run: Run) -> Iterator[Finding]:
    """Find constant goals of calls outside the ground of the world, or inside an obstacle."""
    if run.scenario.world is None or run.world is None:
        return
    from sim2d.grid import rasterise

    world = run.scenario.world
    grid = rasterise(world.bounds, [thing.shape for thing in world.obstacles], world.resolution)
    for node in (one for one in run.nodes if one.name in run.world.robots):
        for home, process in node.mission.processes():
            bodies = (process.body, *(inner.body for inner in process.body.walk() if inner.body is not None))
            objects = {one.id: dict(one.values) for body in bodies for one in body.data_objects}
            for call in (one for one in process.body.walk() if isinstance(one, CallActivity)):
                given = {name: value.text for id in call.data_inputs for name, value in objects.get(id, {}).items()}
                with suppress(KeyError, ValueError, OverflowError):  # not constant
                    x, y = float(given["x_goal"]), float(given["y_goal"])
                    inside = grid.has(*grid.cell((x, y)))
                    where = "inside an obstacle" if inside else f"outside the ground ({grid.extent})"
                    if not grid.is_free((x, y)):
                        text = f"{node.name} is sent to x={x:g} y={y:g}, {where}"
                        yield Finding("warning", text, home.file, call.line, call.id)


def _merged(
    of_file: Mapping[str, Mapping[str, Any]], given: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Mission parameters by robot: those of the file, overridden by those that are given."""
    return {robot: {**of_file.get(robot, {}), **given.get(robot, {})} for robot in dict.fromkeys((*of_file, *given))}
