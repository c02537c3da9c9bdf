"""What a scenario file says: a model, a world, a seed, a duration, folders of behaviours, what somebody does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from fame.clock import EPOCH, parse_epoch
from fame.config.kind import meant_for
from fame.engine.data import is_variable
from fame.errors import ConfigError
from fame.scenario.result import Completion

if TYPE_CHECKING:
    from fame.config.fields import Entry
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
    from fame.config.fields import Entry, read_yaml
    from sim2d.config import read_world, world_config

    data, source = read_yaml(path)
    if other := meant_for(data, "scenario"):
        raise ConfigError(other, file=str(path))
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
    return Said(
        model=path.parent / keys["model"].text(),
        world=world,
        computers=_computers(keys["computers"], world) if "computers" in keys else (),
        seed=keys["seed"].whole(minimum=0) if "seed" in keys else 0,
        duration=keys["duration"].number(above=0) if "duration" in keys else DURATION,
        epoch=_epoch(keys["epoch"]) if "epoch" in keys else EPOCH,
        library=tuple(path.parent / folder.text() for folder in folders),
        completions=tuple(map(_completion, keys["complete"].items())) if "complete" in keys else (),
    )


def _epoch(entry: Entry) -> datetime:
    """YAML makes a date of most of what looks like one."""
    try:
        return parse_epoch(entry.value.isoformat() if isinstance(entry.value, date) else entry.text())
    except ValueError as error:
        raise entry.error(f"{error}; a date, or now, would be right") from None


def _computers(entry: Entry, world: WorldConfig | None) -> tuple[str, ...]:
    taken = {robot.name for robot in world.robots} if world is not None else set()
    for item in entry.items():
        if item.text() in taken:
            raise item.error(f"found {item.value!r}, which is there already; a name of its own would be right")
        taken.add(item.text())
    return tuple(item.text() for item in entry.items())


def _completion(entry: Entry) -> tuple[Completion, int]:
    keys = entry.mapping(("at", "robot", "element", "values"))
    for key in ("at", "robot", "element"):
        if key not in keys:
            raise entry.error(f"lacks {key}; {_COMPLETE} would be right")
    values = keys["values"].mapping() if "values" in keys else {}
    for name, value in values.items():
        if not is_variable(name):
            raise value.error(f"found {name!r}, the name of a variable would be right")
    done = Completion(
        robot=keys["robot"].text(),
        time=keys["at"].number(minimum=0),
        element=keys["element"].text(),
        values={name: value.value for name, value in values.items()},
    )
    return done, entry.source.lines.get(entry.path, 0)


def read_scenario_world(path: Path) -> tuple[WorldConfig | None, int]:
    """The world of a scenario file, or of a file that is a world itself, and its seed. Raises ConfigError."""
    from fame.config.fields import read_yaml
    from sim2d.config import read_world

    if path.suffix.lower() in (".bpmn", ".xml"):
        raise ConfigError("is a model; a world, or a scenario that has one (.yaml), would be right", file=str(path))
    data, _ = read_yaml(path)
    if isinstance(data, Mapping) and "model" in data:
        said = read_scenario(path)
        return said.world, said.seed
    return read_world(path), 0
