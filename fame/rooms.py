"""The rooms around the core, and what FAME uses of them: places ``module:Name``, imported on use.

The core is every module that belongs to none of `ROOMS`. It imports no module of a room by an import statement
(tests/test_layers.py): what it uses of one is named in a table here, and `load` imports it. So a room can be taken
away; what needs it then says so in one line. Rooms import the core and each other. What other packages add to FAME
they register by entry points (docs/extending.md), which replace nothing that is named here.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

from fame.errors import UnavailableError


class Room(NamedTuple):
    """A room: the packages and modules that belong to it, what it is for, and the extra that installs what it needs."""

    modules: tuple[str, ...]
    about: str
    extra: str = ""


ROOMS: Mapping[str, Room] = {
    "monitor": Room(("fame.monitor", "robots.arm"), "learned models on the data of robots", "ml"),
}


def room_of(module: str) -> str:
    """Return the room that a module belongs to; empty for one of the core.

    >>> room_of("fame.monitor.services"), room_of("fame.robot")
    ('monitor', '')
    """
    homes = ((name, home) for name, room in ROOMS.items() for home in room.modules)
    return next((name for name, home in homes if f"{module}.".startswith(f"{home}.")), "")


def load(place: str) -> Any:
    """Return what is at a place of these tables. Raises UnavailableError if its room was taken away."""
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if (reason := missing(error)) is not None:
            raise reason from None
        raise


def install(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'fame-robots[{extra}]'"


def missing(error: BaseException) -> UnavailableError | None:
    """Return what to say of an import that failed since its room was taken away; None for any other error."""
    name = room_of(str(error.name)) if isinstance(error, ModuleNotFoundError) else ""
    if not name:
        return None
    room = ROOMS[name]
    how = install(room.extra) if room.extra else "pip install --force-reinstall fame-robots"
    return UnavailableError(f"this installation lacks {name} ({room.about}): {how}")


# ---- services --------------------------------------------------------------------------------------------------------


class BuiltInService(NamedTuple):
    """A service that service tasks can name.

    start     the place of its `fame.robot.services.StartService`
    required  variables that it needs
    results   variables that it sets when it ends by itself
    packages  what it imports of extras: a mission that lacks one is refused before it moves
    """

    start: str
    required: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()


_LEARNING = ("sklearn", "skops")
WATCH = "watch_property"
SERVICES: Mapping[str, BuiltInService] = {
    "adm_collect": BuiltInService("fame.monitor.services:CollectService", ("output", "label"), ("runs_collected",)),
    "adm_learn": BuiltInService("fame.monitor.services:adm_learn", ("config",), ("classifier",), _LEARNING),
    "adm_operate": BuiltInService("fame.monitor.services:adm_operate", ("model",), packages=_LEARNING),
    "process": BuiltInService("fame.monitor.services:process", ("configuration",)),
    "record": BuiltInService("fame.monitor.services:record", ("configuration", "output")),
    WATCH: BuiltInService("fame.log.property_watch:PropertyWatch", ("property", "sentence")),
    "train": BuiltInService("fame.monitor.services:train", ("configuration",), ("model", "thresholds"), _LEARNING),
}
"""The services of FAME by name; `fame.monitor.services` says what they do."""
