"""Robot types by name: built in, installed by a package, or a class of the user's own.

A `type:` of a world file is

    car                one that comes with FAME
    rover              an entry point of the group ``fame.robots`` of an installed package
    my_robots:Rover    a class of a module that can be imported
    rover.py:Rover     a class of a file beside the world file

The class is a `sim2d.robot.SimulatedRobot`; it is imported when a world has one.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

from fame.config.loader import find_object
from fame.errors import ConfigError
from fame.text import suggestion
from sim2d.robot import SimulatedRobot

GROUP = "fame.robots"
"""Group of the entry points by which packages register robot types."""
BUILT_IN = {
    "car": "robots.vehicles:Car",
    "drone": "robots.drone:Drone",
    "mh5": "robots.arm.cutter:Cutter",
    "tractor": "robots.vehicles:Tractor",
    "ur5e": "robots.arm.handler:Handler",
}
"""Where the types are that come with FAME, in the form of an entry point."""


def robot_types() -> dict[str, str]:
    """All registered types, each with its ``module:Class``."""
    return {**{entry.name: entry.value for entry in entry_points(group=GROUP)}, **BUILT_IN}


def robot_class(type: str, folder: Path = Path()) -> type[SimulatedRobot]:
    """The class of a robot type; ``file.py:Class`` is relative to `folder`. Raises ConfigError."""
    place = type if ":" in type else robot_types().get(type)
    if place is None:
        raise ConfigError(f"expected a robot type, got {type!r}; {_registered(type)}")
    found = find_object(place, folder)
    missing = list(_missing(found))
    if missing:
        raise ConfigError(f"expected a class of robots (sim2d.robot), got {type!r}, which has no {', '.join(missing)}")
    return found  # type: ignore[no-any-return]


def absolute(type: str, folder: Path) -> str:
    """The type for a process in another folder: a ``file.py:Class`` with the whole path of its file."""
    file, colon, name = type.rpartition(":")
    return f"{(folder / file).resolve()}:{name}" if colon and file.endswith(".py") else type


def _registered(type: str) -> str:
    """The registered types, or the closest one."""
    known = suggestion(type, robot_types())
    return known if known.endswith("?") else f"{known}, module:Class, file.py:Class"


def _missing(found: object) -> Iterator[str]:
    """The members of a robot class that an object does not have."""
    for name in ("Parameters", "SAFE_STATE", "SAFE_SUSPENDED", "FAULTS", "move", "sense", "close"):
        if not hasattr(found, name):
            yield name
