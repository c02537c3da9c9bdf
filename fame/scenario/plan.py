"""The content of a scenario: robots and their pools, world, faults, completions; reading scenario files."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.pools import Pool, matches, pools_of
from fame.clock import EPOCH, parse_epoch
from fame.config.loader import read_document
from fame.config.values import Source
from fame.dataclasses import dataclass, field, replace
from fame.engine.data import is_variable
from fame.errors import ConfigError, MessageError
from fame.text import similar_file, suggestion, topic_of

if TYPE_CHECKING:
    from fame.config.values import ConfigValue
    from fame.middleware.network import NetworkConfig
    from fame.properties.sentence import PoseTopic, Property
    from sim2d.config import WorldConfig


@dataclass(frozen=True, slots=True)
class Fault:
    """A permanent fault of a robot at simulated second `time`.

    `kind`: ``engine``, which ends without a safe state, or a kind of fault of the robot's type.
    """

    robot: str
    time: float
    kind: str

    @classmethod
    def of(cls, text: str) -> Fault:
        """Return a fault as people write it: ``Tractor_2@40:engine``. Raises ConfigError."""
        match = re.fullmatch(r"(\S.*)@([0-9]+\.?[0-9]*):(\w+)", text)
        if match is None:
            raise ConfigError(f"expected a fault ROBOT@SECOND:KIND, as in Tractor_2@40:engine, got {text!r}")
        return cls(match[1], float(match[2]), match[3])


@dataclass(frozen=True, slots=True)
class Completion:
    """The completion of a user, manual or receive task by a person at simulated second `time`.

    `element` is its id or label; `values` are the variables that are set. If no token waits there at that time, nothing
    happens except a report.
    """

    robot: str
    time: float
    element: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class OutsideSignal:
    """A message that somebody outside of the team publishes at simulated second `time`.

    `type` and `qos` are those of the topic in the model, empty in a file that is not checked yet.
    """

    topic: str
    time: float
    payload: Any = None
    type: str = ""
    qos: Mapping[str, str] = field(default_factory=dict)


def published_from_outside(signal: OutsideSignal) -> str:
    """Return what is reported of a signal."""
    return f"{signal.topic} is published from outside"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A checked scenario. `cast` has the pool of each robot; `faults` are injected, `completions` done by people,
    `signals` published from outside.

    `duration` is in simulated s; `epoch` is the date of simulated second 0; `variables` has what the process of a robot
    starts with; `network` is between the robots; `types` are folders of message types, which are registered;
    `properties` are judged.
    """

    file: str
    definitions: Definitions
    library: Library
    cast: Mapping[str, Pool]
    world: WorldConfig | None
    seed: int
    duration: float
    faults: tuple[Fault, ...] = ()
    completions: tuple[Completion, ...] = ()
    signals: tuple[OutsideSignal, ...] = ()
    epoch: datetime = EPOCH
    variables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    network: NetworkConfig | None = None
    types: tuple[Path, ...] = ()
    properties: tuple[Property, ...] = ()

    def processes(self) -> list[Process]:
        """Return the processes that the robots run, each once."""
        return list({pool.process.id: pool.process for pool in self.cast.values()}.values())

    def closures(self) -> list[Definitions]:
        """Return the files of all processes: that of the model first, then those of called processes."""
        files = {self.definitions.file: self.definitions}
        for pool in self.cast.values():
            files.update((home.file, home) for home, _ in self.library.closure(self.definitions, pool.process))
        return list(files.values())


DURATION = 600.0
"""Default duration of a run, simulated s."""

KEYS = {
    "model": "the .bpmn file",
    "world": "a world: its file, or its keys here",
    "seed": "random seed (0)",
    "duration": "maximum duration, simulated s (600)",
    "epoch": "the date at simulated second 0, for date timers, `robot.date`, `now()` and `today()`; or `now` "
    "(1970-01-01T00:00Z)",
    "library": "folders with called processes",
    "types": "folders with .msg, .srv and .action files in ROS packages, for every command that reads the scenario; a "
    "file that cannot be read is left out, and the error that its type is unknown names it",
    "computers": "pools without a body in the world, such as a monitor",
    "complete": "tasks to complete, each with the keys below",
    "signal": "messages from outside of the team, each with the keys below",
    "network": "the network between the robots, with the keys below",
    "variables": "mission parameters: `{speed: 0.5, REX: {speed: 0.7}}` sets the variable `speed` of every robot, and "
    "that of REX, instead of the model's data objects",
    "properties": "properties of the team by name, each a sentence: every run judges them",
    "poses": "where `distance` gets positions from: `{REX: /REX/pose, Tractor: ~/odom}` names the topic of a robot, or "
    "of each robot of a pool (without it: from the simulated world)",
}
"""Of a scenario file, with their meanings."""
SIGNAL_KEYS = {
    "at": "simulated second; the run does not end before the last one",
    "name": "topic, without its first slash or with it",
    "payload": "the message, of the type in the model; without it, an empty one",
}
COMPLETE_KEYS = {
    "at": "simulated second",
    "robot": "the robot",
    "element": "id or label of a user, manual or receive task; if no token waits there at that time, this is reported "
    "and has no effect",
    "values": "results, by variable",
}

_COMPLETE = "{at: 12, robot: REX, element: Task_Sign, values: {approved: true}}"
_SIGNAL = "{at: 12, name: go, payload: {x: 1.0}}"


@dataclass(frozen=True, slots=True)
class ScenarioFile:
    """The content of a scenario file. `computers` run pools too, but have no body in the world.

    `completions` and `signals` have their key path each; `source` has the line of each key.
    """

    model: Path
    world: WorldConfig | None = None
    computers: tuple[str, ...] = ()
    seed: int = 0
    duration: float = DURATION
    epoch: datetime = EPOCH
    library: tuple[Path, ...] = ()
    types: tuple[Path, ...] = ()
    completions: tuple[tuple[Completion, str], ...] = ()
    signals: tuple[tuple[OutsideSignal, str], ...] = ()
    network: NetworkConfig | None = None
    variables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    properties: tuple[Property, ...] = ()
    poses: tuple[PoseTopic, ...] = ()
    source: Source = field(default_factory=Source)


def known_to_check(content: ScenarioFile, model: Definitions) -> dict[str, Any]:
    """Return what a scenario tells `fame.check.check`: variables that processes are given, topics on which it sends."""
    from fame.scenario.settings import ALL

    given = {
        pool.process.id: frozenset(
            name
            for robot, values in content.variables.items()
            if robot == ALL or matches(robot, pool)
            for name in values
        )
        for pool in pools_of(model)
    }
    return {"given": given, "outside": [signal.topic for signal, _ in content.signals]}


def _beside(path: Path, name: ConfigValue) -> Path:
    """A file that a scenario names, without ``folder/..`` in its path, unless a link makes that another file."""
    whole = path.parent / name.text()
    if not os.path.isfile(whole):  # False for a name that is too long, too
        refused = name.expected("a file, relative to the folder of the scenario")
        raise name.error(f"{refused.text}{similar_file(whole)}")
    plain = Path(os.path.normpath(whole))
    return plain if whole.exists() and plain.exists() and plain.samefile(whole) else whole


def _document(path: Path, changes: Mapping[str, Any]) -> ConfigValue:
    document = read_document(path, "scenario")
    return replace(document, data=changed(document.data, changes, str(path))) if changes else document


def read_scenario(path: Path, changes: Mapping[str, Any] = MappingProxyType({})) -> ScenarioFile:
    """Read a scenario file, with other values at the paths of `changes`, and register its message types.

    Raises ConfigError with file, line and key.
    """
    from fame.properties.files import poses_of, properties_of
    from fame.scenario.settings import read_network, read_variables
    from sim2d.config import KEYS as WORLD_KEYS, read_world, world_config

    document = _document(path, changes)
    for key, value in document.mapping().items():
        if key in WORLD_KEYS and key not in KEYS:
            raise value.error("is a key of the world: expected it below world, with more spaces before it")
    keys = document.mapping(KEYS)
    model = document.required("model", "FILE.bpmn")
    types = tuple(_registered(path, item) for item in keys["types"].items()) if "types" in keys else ()
    world = None
    if "world" in keys and isinstance(keys["world"].data, str):
        world = read_world(_beside(path, keys["world"]))
    elif "world" in keys:
        world = world_config(keys["world"])
    folders = keys["library"].items() if "library" in keys else []
    return ScenarioFile(
        model=_beside(path, model),
        world=world,
        computers=_computers(keys["computers"], world) if "computers" in keys else (),
        seed=keys["seed"].integer(minimum=0) if "seed" in keys else 0,
        duration=keys["duration"].number(above=0) if "duration" in keys else DURATION,
        epoch=_epoch(keys["epoch"]) if "epoch" in keys else EPOCH,
        library=tuple(path.parent / folder.text() for folder in folders),
        types=types,
        completions=tuple(map(_completion, _all(keys["complete"]))) if "complete" in keys else (),
        signals=tuple(map(_signal, _all(keys["signal"]))) if "signal" in keys else (),
        network=read_network(keys["network"]) if "network" in keys else None,
        variables=read_variables(keys["variables"]) if "variables" in keys else {},
        properties=properties_of(keys["properties"]) if "properties" in keys else (),
        poses=poses_of(keys.get("poses")),
        source=document.source,
    )


def named_files(path: Path, changes: Mapping[str, Any] = MappingProxyType({})) -> list[tuple[str, Path]]:
    """Return the files that a scenario (or a model alone) names, each with its folder in
    recordings; nothing is imported.

    ``scenario``, ``models``, ``world``, ``code`` (own types of robots); ``module`` is a module by its name, no file.
    Raises ConfigError.
    """
    if path.suffix.lower() not in (".yaml", ".yml"):
        return [("models", path)]
    document = _document(path, changes)
    keys = document.mapping()
    found = [("scenario", path), ("models", _beside(path, document.required("model", "FILE.bpmn")))]
    world, folder = keys.get("world"), path.parent
    if world is not None and isinstance(world.data, str):
        file = _beside(path, world)
        found.append(("world", file))
        world, folder = read_document(file, "world"), file.parent
    robots = world.mapping().get("robots") if world is not None else None
    for robot in robots.mapping().values() if robots is not None else ():
        kind = robot.mapping().get("type")
        name, colon, _ = kind.data.rpartition(":") if kind is not None and isinstance(kind.data, str) else ("", "", "")
        if colon:
            found.append(("code", folder / name) if name.endswith(".py") else ("module", Path(name)))
    return list(dict.fromkeys(found))


def _registered(path: Path, folder: ConfigValue) -> Path:
    """A folder of message types, or a file of one, which is registered now."""
    from fame.middleware.messages import register_files

    whole = path.parent / folder.text()
    try:
        register_files(whole)
    except MessageError as error:
        raise folder.error(str(error)) from None
    return whole


def _epoch(value: ConfigValue) -> datetime:
    """Parse a date; a space may stand before the time of day, as YAML 1.1 has it."""
    try:
        return parse_epoch(re.sub(r"(?<=\d) (?=\d)", "T", value.text()))
    except ValueError as error:
        raise value.error(f"{error}; expected a date, or now") from None


def _computers(value: ConfigValue, world: WorldConfig | None) -> tuple[str, ...]:
    taken = {robot.name for robot in world.robots} if world is not None else set()
    for item in value.items():
        if item.text() in taken:
            raise item.error(f"expected a name of its own, got {item.text()!r}, which is taken")
        taken.add(item.text())
    return tuple(item.text() for item in value.items())


def _all(value: ConfigValue) -> Sequence[ConfigValue]:
    """The items of a list; a mapping is the only one."""
    return [value] if isinstance(value.data, Mapping) else value.items()


def _signal(value: ConfigValue) -> tuple[OutsideSignal, str]:
    keys = value.mapping(SIGNAL_KEYS)
    for key in ("at", "name"):
        if key not in keys:
            raise value.error(f"expected the key {key}, as in {_SIGNAL}")
    name = keys["name"].text()
    payload = keys["payload"].data if "payload" in keys else None
    return OutsideSignal(topic_of(name), keys["at"].number(minimum=0), payload), value.path


def _completion(value: ConfigValue) -> tuple[Completion, str]:
    keys = value.mapping(COMPLETE_KEYS)
    for key in ("at", "robot", "element"):
        if key not in keys:
            raise value.error(f"expected the key {key}, as in {_COMPLETE}")
    values = keys["values"].mapping() if "values" in keys else {}
    for name, item in values.items():
        if not is_variable(name):
            raise item.error(f"expected the name of a variable, got {name!r}")
    done = Completion(
        robot=keys["robot"].text(),
        time=keys["at"].number(minimum=0),
        element=keys["element"].text(),
        values={name: item.data for name, item in values.items()},
    )
    return done, value.path


def read_scenario_world(path: Path) -> tuple[WorldConfig | None, int]:
    """Read the world and the seed of a scenario file, or of a world file (seed 0). Raises ConfigError."""
    from sim2d.config import read_world

    if path.suffix.lower() in (".bpmn", ".xml"):
        raise ConfigError("expected a world, or a scenario that has one (.yaml), got a model", file=str(path))
    data = read_document(path).data
    if isinstance(data, Mapping) and "model" in data:
        content = read_scenario(path)
        return content.world, content.seed
    return read_world(path), 0


def changed(data: Any, changes: Mapping[str, Any], file: str) -> Any:
    """Return the data of a scenario with other values at some paths. Raises ConfigError for a path
    that does not exist."""
    data = copy.deepcopy(data)
    for path, value in changes.items():
        *way, last = path.split(".")
        if not way and last not in KEYS:
            raise ConfigError(f"unknown key {last!r}; {suggestion(last, KEYS)}", file=file, element=path)
        place = data
        for number, key in enumerate(way):
            entry = _entry(place, key)
            if entry is None and isinstance(place, dict) and way[0] in ("variables", "network"):
                entry = place[key] = {}  # these may be missing from the file
            if not isinstance(entry, dict | list):
                raise ConfigError(f"the scenario has no {'.'.join(way[: number + 1])}", file=file, element=path)
            place = entry
        if isinstance(place, list):
            raise ConfigError(
                f"the scenario has a list at {'.'.join(way)}: name one of its items", file=file, element=path
            )
        place[last] = value
    return data


def _entry(place: Any, key: str) -> Any:
    """The value of a key; of a list the item with this name, or at this place."""
    if isinstance(place, dict):
        return place.get(key)
    if isinstance(place, list):
        named = next((item for item in place if isinstance(item, dict) and item.get("name") == key), None)
        return named if named is not None or not key.isdecimal() or int(key) >= len(place) else place[int(key)]
    return None
