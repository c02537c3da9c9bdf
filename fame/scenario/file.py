"""What a scenario file says: a model, a world, a seed, a duration, folders of behaviours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim2d.config import WorldConfig

DURATION = 600.0
"""Simulated seconds after which a run ends if nobody says otherwise."""

_KEYS = ("model", "world", "seed", "duration", "library", "robots")


@dataclass(frozen=True, slots=True)
class Said:
    """What a scenario file says."""

    model: Path
    world: WorldConfig | None = None
    seed: int = 0
    duration: float = DURATION
    library: tuple[Path, ...] = ()


def read_scenario(path: Path) -> Said:
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
    return Said(
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
        said = read_scenario(path)
        return said.world, said.seed
    return read_world(path), 0
