"""Places robots on free ground: any number of a kind, where chance will have them."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2d.config import WorldConfig
from sim2d.grid import Grid, inflate, rasterise
from sim2d.randomness import generator
from sim2d.robot import RobotConfig

_APART = 0.3
"""m between two robots at least, as if each were a disc around its outline."""


def place(config: WorldConfig, name: str, count: int, seed: int) -> tuple[RobotConfig, ...]:
    """All robots of a world if there shall be `count` robots ``<name>_1``, ``<name>_2``, ... in it.

    Those that the file has keep their places; the others get the parameters of the last of them, and free ground
    where the `seed` will have it. A robot ``<name>_<n>`` with n above `count` is left out. Raises ConfigError if the
    file has no such robot to copy, and if the ground is full.
    """
    group = re.compile(re.escape(name) + r"_[0-9]+")
    models = [robot for robot in config.robots if group.fullmatch(robot.name)]
    if not models:
        text = f"expected a robot {name}_1 to copy for {name}={count}; robots are: "
        raise config.source.error("robots", text + (", ".join(robot.name for robot in config.robots) or "none"))
    names = [f"{name}_{number}" for number in range(1, count + 1)]
    kept = [robot for robot in config.robots if robot not in models or robot.name in names]
    missing = [other for other in names if all(robot.name != other for robot in kept)]
    return (*kept, *_placed(config, kept, models[-1], missing, seed))


def _placed(
    config: WorldConfig, kept: list[RobotConfig], model: RobotConfig, names: list[str], seed: int
) -> list[RobotConfig]:
    """Copies of `model` with these names, apart from all that is solid and from each other."""
    solid = [thing.shape for thing in (*config.obstacles, *config.targets)]
    radius = _radius(model)
    grid = inflate(rasterise(config.bounds, solid, config.resolution), radius + _APART / 2 + config.resolution / 2)
    for robot in kept:
        _occupy(grid, robot, _radius(robot) + radius + _APART)
    random = generator(seed, "placement", model.name.rpartition("_")[0])
    placed = []
    for number, name in enumerate(names):
        free = np.flatnonzero(~grid.occupied)
        if not len(free):
            raise config.source.error(
                "robots", f"expected room for {len(names)} more robots like {model.name}, got room for {number}"
            )
        row, column = divmod(int(random.choice(free)), grid.occupied.shape[1])
        at = tuple(
            round(start + (cell + 0.5) * grid.resolution, 4)
            for start, cell in zip(grid.origin, (column, row), strict=True)
        )
        robot = replace(model, name=name, at=at, heading=round(float(random.uniform(-math.pi, math.pi)), 4))
        _occupy(grid, robot, 2 * radius + _APART)
        placed.append(robot)
    return placed


def _radius(robot: RobotConfig) -> float:
    p = robot.parameters
    sides = (p.length, p.width) if hasattr(p, "length") else (p.base, p.base)  # an arm stands on a square
    return math.hypot(*sides) / 2


def _occupy(grid: Grid, robot: RobotConfig, radius: float) -> None:
    """Leave no free cell whose middle is within `radius` (m) of a robot."""
    reach = math.ceil(radius / grid.resolution) + 1
    column, row = (
        math.floor((place - start) / grid.resolution) for place, start in zip(robot.at, grid.origin, strict=True)
    )
    rows, columns = (slice(max(0, middle - reach), middle + reach + 1) for middle in (row, column))
    around: NDArray[np.bool_] = grid.occupied[rows, columns]
    y = grid.origin[1] + (np.arange(rows.start, rows.start + around.shape[0]) + 0.5) * grid.resolution
    x = grid.origin[0] + (np.arange(columns.start, columns.start + around.shape[1]) + 0.5) * grid.resolution
    around |= np.hypot(x[np.newaxis, :] - robot.at[0], y[:, np.newaxis] - robot.at[1]) <= radius
