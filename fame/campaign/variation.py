"""Variation between the runs of a campaign: distributions by path of the scenario, and how they are combined.

A path names a value of the scenario file as its keys do: ``variables.REX.speed``, ``network.loss``,
``world.robots.REX.at``; items of a list by their name (``world.weeds.dock.at``) or place. ``faults`` is one value.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.imports import require

if TYPE_CHECKING:
    from fame.config.values import ConfigValue
    from sim2d.config import WorldConfig

Design = Literal["random", "latin", "factorial"]
FAULTS, FREE = "faults", "free"
CLEARANCE = 0.4
"""Default distance of free ground from obstacles and the edge of the world (m)."""
_KINDS = ("uniform", "integer", "normal", "choice", "free")


@dataclass(frozen=True, slots=True)
class Distribution:
    """The values of one path. `numbers`: bounds of ``uniform`` and ``integer``, mean and deviation of ``normal``,
    clearance (m) of ``free``; `choices` of ``choice``."""

    path: str
    kind: Literal["uniform", "integer", "normal", "choice", "free"]
    numbers: tuple[float, ...] = ()
    choices: tuple[Any, ...] = ()

    def value(self, quantile: float, places: Sequence[tuple[float, float]]) -> Any:
        """Return the value at a quantile (0 to 1). `places` are those of free ground."""
        match self.kind:
            case "choice":
                return self.choices[min(int(quantile * len(self.choices)), len(self.choices) - 1)]
            case "uniform":
                return round(self.numbers[0] + quantile * (self.numbers[1] - self.numbers[0]), 6)
            case "integer":
                low, high = map(int, self.numbers)
                return low + min(int(quantile * (high - low + 1)), high - low)
            case "normal":
                from statistics import NormalDist

                bounded = min(max(quantile, 1e-9), 1 - 1e-9)
                return round(NormalDist(self.numbers[0], self.numbers[1]).inv_cdf(bounded), 6)
        return list(places[min(int(quantile * len(places)), len(places) - 1)])


KEYS = {
    "vary": "path in the scenario -> distribution: `{uniform: [0.5, 1.0]}`, `{normal: [0.5, 0.1]}`, "
    "`{integer: [1, 5]}`, `{choice: [a, b]}`, or `free`, a place clear of obstacles",
    "design": "`random`, `latin` (evenly spread), or `factorial`: each combination of choices (`random`)",
    "measure": "name -> expression over the variables of each robot: a column of the result",
}
"""Of a campaign file, with their meanings."""


@dataclass(frozen=True, slots=True)
class Variation:
    """The variations of a campaign, and its measures: name -> expression over the variables of each robot."""

    distributions: tuple[Distribution, ...] = ()
    design: Design = "random"
    measures: Mapping[str, str] = field(default_factory=dict)


def read_variation(path: Path) -> Variation:
    """Read a campaign file. Raises ConfigError with file, line and key."""
    from fame.config.loader import read_document

    document = read_document(path)
    keys = document.mapping(KEYS)
    vary = tuple(_distribution(name, item) for name, item in keys["vary"].mapping().items()) if "vary" in keys else ()
    design = keys["design"].choice(("random", "latin", "factorial"), "a design") if "design" in keys else "random"
    if design == "factorial":
        for distribution in vary:
            if distribution.kind != "choice":
                raise keys["vary"].error(
                    f"a factorial design has choices only, got {distribution.kind} for {distribution.path}"
                )
    measures = {name: item.text() for name, item in keys["measure"].mapping().items()} if "measure" in keys else {}
    return Variation(vary, design, measures)  # type: ignore[arg-type]


def _distribution(path: str, value: ConfigValue) -> Distribution:
    if value.data == FREE:
        return Distribution(path, "free", (CLEARANCE,))
    if not isinstance(value.data, Mapping) or len(value.data) != 1:
        raise value.expected(f"one of {', '.join(_KINDS)}, as in {{uniform: [0.5, 1.0]}}")
    ((kind, item),) = value.mapping(_KINDS).items()
    if kind == "choice":
        choices = tuple(one.data for one in item.items())
        if not choices:
            raise item.expected("one value or more")
        return Distribution(path, "choice", choices=choices)
    if kind == "free":
        return Distribution(path, "free", (item.number(above=0),))
    first, second = item.numbers(2, "two numbers, as in [0.5, 1.0]")
    if (kind == "normal" and second <= 0) or (kind != "normal" and second < first):
        raise item.expected(
            "a mean and a deviation above 0" if kind == "normal" else "two numbers, the smaller one first"
        )
    return Distribution(
        path, "normal" if kind == "normal" else "integer" if kind == "integer" else "uniform", (first, second)
    )


def points(variation: Variation, runs: int, seed: int, world: WorldConfig | None) -> Iterator[dict[str, Any]]:
    """Yield the values of each run, by path; the same seed gives the same. Raises ConfigError.

    A factorial design gives each combination in turn, and begins again after the last one.
    """
    places = {one.path: free_places(one, world) for one in variation.distributions if one.kind == "free"}
    if variation.design == "factorial":
        combinations = itertools.cycle(itertools.product(*(one.choices for one in variation.distributions)))
        for values in itertools.islice(combinations, runs):
            yield {one.path: value for one, value in zip(variation.distributions, values, strict=True)}
        return
    for row in _quantiles(variation, runs, seed):
        yield {
            distribution.path: distribution.value(quantile, places.get(distribution.path, ()))
            for distribution, quantile in zip(variation.distributions, row, strict=True)
        }


def _quantiles(variation: Variation, runs: int, seed: int) -> Iterator[Sequence[float]]:
    count = len(variation.distributions)
    if variation.design == "latin" and count:
        require("scipy")
        from scipy.stats import qmc

        yield from (list(map(float, row)) for row in qmc.LatinHypercube(count, rng=seed).random(runs))
        return
    for number in range(runs):
        generator = random.Random(f"{seed} campaign {number}")
        yield [generator.random() for _ in range(count)]


def free_places(distribution: Distribution, world: WorldConfig | None) -> list[tuple[float, float]]:
    """Return the centres of the cells of the ground that are clear of obstacles."""
    if world is None:
        raise ConfigError(f"{distribution.path}: free: the scenario has no world")
    import numpy as np

    from sim2d.grid import inflate, rasterise

    solid = [thing.shape for thing in (*world.obstacles, *world.targets)]
    grid = inflate(rasterise(world.bounds, solid, world.resolution), distribution.numbers[0])
    rows, columns = np.nonzero(~grid.occupied)
    if not len(rows):
        raise ConfigError(f"{distribution.path}: free: no ground is {distribution.numbers[0]:g} m from all obstacles")
    x, y = (grid.origin[axis] + (cells + 0.5) * grid.resolution for axis, cells in enumerate((columns, rows)))
    order = random.Random(0).sample(range(len(x)), len(x))  # so that near quantiles are not near places
    return [(round(float(x[cell]), 3), round(float(y[cell]), 3)) for cell in order]


def is_number(value: Any) -> bool:
    """Return whether a value is a number that can be compared."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
