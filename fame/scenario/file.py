"""What a scenario file says: a model, a world, a seed, a duration, folders of behaviours, what somebody does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from fame.clock import EPOCH, parse_epoch
from fame.engine.data import is_variable
from fame.errors import ConfigError
from fame.scenario.plan import Completion

if TYPE_CHECKING:
    from fame.config.values import ConfigValue
    from sim2d.config import WorldConfig

DURATION = 600.0
"""Simulated seconds after which a run ends if nobody says otherwise."""

_KEYS = ("model", "world", "seed", "duration", "epoch", "library", "computers", "complete")

_COMPLETE = "{at: 12, robot: REX, element: Task_Sign, values: {approved: true}}"


@dataclass(frozen=True, slots=True)
class Said:
    """What a scenario file says. `computers` play pools too, but have no body in the world.

    `completions`: each with its line.
    """

    model: Path
    world: WorldConfig | None = None
    computers: tuple[str, ...] = ()
    seed: int = 0
    duration: float = DURATION
    epoch: datetime = EPOCH
    library: tuple[Path, ...] = ()
    completions: tuple[tuple[Completion, int], ...] = ()


def read_scenario(path: Path) -> Said:
    from fame.config.loader import read_document
    from sim2d.config import read_world, world_config

    document = read_document(path, "scenario")
    keys = document.mapping(_KEYS)
    model = document.required("model", "FILE.bpmn").text()
    world = None
    if "world" in keys and isinstance(keys["world"].data, str):
        world = read_world(path.parent / keys["world"].data)
    elif "world" in keys:
        world = world_config(keys["world"])
    folders = keys["library"].items() if "library" in keys else []
    return Said(
        model=path.parent / model,
        world=world,
        computers=_computers(keys["computers"], world) if "computers" in keys else (),
        seed=keys["seed"].integer(minimum=0) if "seed" in keys else 0,
        duration=keys["duration"].number(above=0) if "duration" in keys else DURATION,
        epoch=_epoch(keys["epoch"]) if "epoch" in keys else EPOCH,
        library=tuple(path.parent / folder.text() for folder in folders),
        completions=tuple(map(_completion, keys["complete"].items())) if "complete" in keys else (),
    )


def _epoch(value: ConfigValue) -> datetime:
    """YAML makes a date of most of what looks like one."""
    try:
        return parse_epoch(value.data.isoformat() if isinstance(value.data, date) else value.text())
    except ValueError as error:
        raise value.error(f"{error}; expected a date, or now") from None


def _computers(value: ConfigValue, world: WorldConfig | None) -> tuple[str, ...]:
    taken = {robot.name for robot in world.robots} if world is not None else set()
    for item in value.items():
        if item.text() in taken:
            raise item.error(f"expected a name of its own, got {item.text()!r}, which is taken")
        taken.add(item.text())
    return tuple(item.text() for item in value.items())


def _completion(value: ConfigValue) -> tuple[Completion, int]:
    keys = value.mapping(("at", "robot", "element", "values"))
    for key in ("at", "robot", "element"):
        if key not in keys:
            raise value.error(f"expected the key {key}, as in {_COMPLETE}")
    values = keys["values"].mapping() if "values" in keys else {}
    for name, value in values.items():
        if not is_variable(name):
            raise value.error(f"expected the name of a variable, got {name!r}")
    done = Completion(
        robot=keys["robot"].text(),
        time=keys["at"].number(minimum=0),
        element=keys["element"].text(),
        values={name: value.data for name, value in values.items()},
    )
    return done, value.line


def read_scenario_world(path: Path) -> tuple[WorldConfig | None, int]:
    """The world of a scenario file, or of a file that is a world itself, and its seed. Raises ConfigError."""
    from fame.config.loader import read_document
    from sim2d.config import read_world

    if path.suffix.lower() in (".bpmn", ".xml"):
        raise ConfigError("expected a world, or a scenario that has one (.yaml), got a model", file=str(path))
    data = read_document(path).data
    if isinstance(data, Mapping) and "model" in data:
        said = read_scenario(path)
        return said.world, said.seed
    return read_world(path), 0
