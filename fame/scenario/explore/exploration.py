"""Explore every reachable state of a model or scenario, with its number of robots (`fame.check.explore`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeGuard

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool, assign_pools, pools_of, robot_names
from fame.check.explore import Exploration, Request, explore_from, explore_team
from fame.errors import ConfigError, FameError, expect
from fame.properties.diagram import drawn_properties
from fame.properties.files import beside
from fame.properties.sentence import Property
from fame.scenario.explore.run import with_run
from fame.scenario.scenario import Scenario, world_topics

if TYPE_CHECKING:
    from fame.deploy.migration import Foreseen

MOST = 1000
"""Robots of a pool, above which nothing is explored."""
FEWEST = 2
"""Robots of a multi-instance pool, where nothing else says how many."""
BUDGET = 2.5
"""How long a migrated state is explored at most, s: meanwhile the robots are held."""
LEAST = 1.0
"""How long a run of the scenario may take at least, s."""


def explore(
    model: str | Path | Definitions | Scenario,
    *,
    robots: Mapping[str, int] = MappingProxyType({}),
    library: str | Path | Sequence[str | Path] = (),
    delivery: str | Sequence[str] = ("run", "fast"),
    timers: str = "any",
    faults: bool = False,
    reduced: bool = True,
    limit: int = 200_000,
    seconds: float | None = None,
    properties: Sequence[Property] | None = None,
    samples: bool = True,
    first: bool = False,
    progress: Callable[[int, int], object] = lambda states, frontier: None,
) -> Exploration:
    """Explore the reachable states of a collaboration, and return the findings.

    model     a scenario (.yaml), a model (.bpmn) or what `fame.Scenario.load` or `fame.read` gave
    robots    number of robots of a multi-instance pool, by its name; else as many as the scenario has, else the minimum
              of the multiplicity, at least 2
    delivery  ``run``, ``fast`` or ``any``, or several of them
    timers    ``any`` order, or ``ordered`` by their durations
    faults    also what single faults lead to
    reduced   leave out orders of steps that make no difference
    limit     states of all deliveries together
    seconds   time for all of them; the result then depends on the machine
    properties  what is proved or refuted; by default those of the scenario, of ``NAME.properties.yaml`` beside the
              model, and the deadlines drawn in it
    samples   if a limit ends a search, also explore the order of `fame run`, fewer robots, and random runs, and run
              the scenario itself, whose world decides how long behaviours take
    first     explore these parts first, and end at the first error
    progress  called now and then with the number of states of a delivery, and of those still to be explored

    Raises ModelError and ConfigError as `fame.Scenario.load` does.
    """
    deliveries = (delivery,) if isinstance(delivery, str) else tuple(delivery)
    expect(timers in ("any", "ordered"), "timers", timers, "any or ordered")
    request = Request(
        delivery=deliveries,  # type: ignore[arg-type]  # checked by `explore_team`
        ordered=timers == "ordered",
        faults=faults,
        reduced=reduced,
        limit=limit,
        seconds=seconds,
        samples=samples,
        first=first,
        progress=progress,
    )
    if _is_scenario(model):
        model = Scenario.load(model, robots=robots, library=library)
    scenario = model if isinstance(model, Scenario) else None
    definitions, folders, cast = cast_of(model, robots, library)
    if scenario is not None:
        request = replace(request, sources=_sources(scenario), variables=scenario.variables)
    said = scenario.properties if scenario is not None else _said(definitions, folders, cast)
    request = replace(request, properties=tuple(said if properties is None else properties))
    begun = time.monotonic()
    result = explore_team(definitions, folders, cast, request)
    if scenario is None or result.exhaustive or result.failed or not samples:
        return result
    return with_run(result, scenario, None if seconds is None else max(seconds - (time.monotonic() - begun), LEAST))


def _said(definitions: Definitions, library: Library, cast: Mapping[str, Pool]) -> tuple[Property, ...]:
    """The properties beside a model, and the deadlines drawn in it. Raises ConfigError."""
    if not definitions.file:
        return ()
    return (*beside(Path(definitions.file)), *drawn_properties(definitions, library, cast))


def _sources(scenario: Scenario) -> frozenset[str]:
    """The topics on which the signals and the simulated robots of a scenario publish. Raises ConfigError."""
    given = {one.topic for one in scenario.signals}
    return frozenset(given | {one.name for one in world_topics(scenario.world, scenario.seed) if one.publishers})


def _is_scenario(model: str | Path | Definitions | Scenario) -> TypeGuard[str | Path]:
    return not isinstance(model, Definitions | Scenario) and Path(model).suffix.lower() in (".yaml", ".yml")


def explore_found(definitions: Definitions, library: Library, robots: Mapping[str, Pool]) -> Exploration:
    """Explore a collaboration with the robots that were found for it (robot -> pool).

    A pool without a robot has as many as `explore` takes; properties are those that `explore` takes for a model.
    Raises ModelError and ConfigError.
    """
    there = {pool.name for pool in robots.values()}
    missing = [pool for pool in pools_of(definitions) if pool.name not in there]
    others = assign_pools(missing, robot_names(missing, {}, FEWEST), file=definitions.file)
    cast = {**robots, **others}
    return explore_team(definitions, library, cast, Request(properties=_said(definitions, library, cast)))


def objection(explored: Exploration, *, partial: bool = False) -> str:
    """Return why a team should not migrate to the explored state: the first error, or a search
    that was cut; else empty.

    With `partial` a search that was cut is accepted.
    """
    errors = [one.text for one in explored.findings if one.level == "error"]
    return errors[0] if errors else explored.partly() if explored.status == "partial" and not partial else ""


def explore_migrated(
    definitions: Definitions,
    library: Library,
    pools: Mapping[str, Pool],
    foreseen: Mapping[str, Foreseen],
    *,
    seconds: float | None = None,
) -> Exploration:
    """Explore what may follow once what robots run has gone over to a model; robots that run nothing start it.

    `seconds`: how long at most (`BUDGET`). Raises FameError if that cannot be explored.
    """
    states = {robot: dict(one.state) for robot, one in foreseen.items() if one.state}
    large = [robot for robot, one in foreseen.items() if one.tokens and not one.state]
    if large:
        raise FameError(f"the migrated state cannot be explored: that of {', '.join(large)} is too large to be sent")
    try:
        return explore_from(
            definitions,
            library,
            pools,
            states,
            Request(delivery=("run",), seconds=BUDGET if seconds is None else seconds),
        )
    except FameError as error:
        raise FameError(f"the migrated state cannot be explored: {error}") from None


def cast_of(
    model: str | Path | Definitions | Scenario, robots: Mapping[str, int], library: str | Path | Sequence[str | Path]
) -> tuple[Definitions, Library, dict[str, Pool]]:
    """Return the model, its library, and robot -> pool. Raises ModelError and ConfigError."""
    for name, count in robots.items():
        expect(0 < count <= MOST, f"robots of {name}", count, f"1 to {MOST}")
    if isinstance(model, Scenario):
        return model.definitions, model.library, dict(model.cast)
    from fame.bpmn.reader import read

    definitions = read(model)
    pools = pools_of(definitions)
    multiple = {pool.name.casefold(): pool.name for pool in pools if pool.multi_instance}
    for name in robots:
        if name.casefold() not in multiple:
            known = ", ".join(multiple.values()) or "none"
            raise ConfigError(f"unknown multi-instance pool {name!r}; there are: {known}", file=definitions.file)
    counts = {multiple[name.casefold()]: count for name, count in robots.items()}
    folders = Library(library)
    for pool in pools:
        folders.closure(definitions, pool.process)
    return definitions, folders, assign_pools(pools, robot_names(pools, counts, FEWEST), file=definitions.file)
