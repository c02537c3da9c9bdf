"""The pools of a collaboration, and which robot plays which pool.

A pool belongs to the robot whose namespace is its name, ignoring case; a multi-instance pool to every namespace
``<Pool>_<digits>`` (FAME paper, section 3.3). A file without a collaboration is one pool, named after its process: the
one that is executable.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.topics import TopicUse, topics_of_processes
from fame.dataclasses import dataclass
from fame.errors import ConfigError, ModelError
from fame.text import NAMES, is_ros_name


@dataclass(frozen=True, slots=True)
class Pool:
    """A pool with a process. `minimum` and `maximum` are as in `fame.bpmn.model.Participant`."""

    name: str
    process: Process
    multi_instance: bool = False
    line: int = 0
    minimum: int = 1
    maximum: int | None = None


def pools_of(definitions: Definitions) -> list[Pool]:
    """Return the pools that have a process, in document order. The name of an unnamed pool is its id.

    Raises ModelError for a pool whose process the file does not have, for two pools whose names differ in case only,
    and for a file without anything to execute.
    """
    pools: list[Pool] = []
    for participant in definitions.participants:
        if not participant.process:
            continue
        process, name = definitions.process(participant.process), participant.label
        if process is None:
            text = f"the pool's process is {participant.process!r}: the file has no such process"
            raise ModelError.at(participant, text, file=definitions.file)
        if any(pool.name.casefold() == name.casefold() for pool in pools):
            raise ModelError.at(
                participant,
                f"two pools have the name {name!r} (upper and lower case are the same)",
                file=definitions.file,
            )
        numbers = participant.minimum, participant.maximum
        pools.append(Pool(name, process, participant.multi_instance, participant.line, *numbers))
    meant = definitions.only_executable
    if not definitions.participants and meant is not None:
        pools.append(Pool(meant.name or meant.id, meant, line=meant.line))
    if not pools:
        black = [participant.label for participant in definitions.participants]
        found = f"its pools are black boxes: {', '.join(black)}" if black else "it has no pool"
        if not black and definitions.processes:
            found = (
                f"it has {len(definitions.processes)} processes and no pool for them: expected one with isExecutable"
            )
            found += ' = "true", and "false" where a process is only called'
        raise ModelError(f"nothing to run: {found}", file=definitions.file)
    return pools


def shared_topics(definitions: Definitions, pools: Sequence[Pool], library: Library) -> Mapping[str, TopicUse]:
    """Return the topics of a collaboration, including called processes. Raises ModelError for a
    topic with two types."""
    return topics_of_processes(all_processes(definitions, pools, library))


def all_processes(
    definitions: Definitions, pools: Iterable[Pool], library: Library
) -> Collection[tuple[Definitions, Process]]:
    """Return the processes of some pools and those that they call, each with its file. Raises ModelError."""
    closures = (library.closure(definitions, pool.process) for pool in pools)
    return {(home.file, process.id): (home, process) for closure in closures for home, process in closure}.values()


def assign_pools(
    pools: Sequence[Pool], robots: Iterable[str], *, file: str = "", others: Sequence[str] = ()
) -> dict[str, Pool]:
    """Robot (namespace) -> its pool, in the order of the robots. `others` are robots of no pool, for messages.

    A multi-instance pool may have any number of robots, also none. Raises ConfigError for a robot without a pool, for
    another pool without a robot, and for two robots whose names differ in case only; ModelError for a pool whose name
    is not a valid robot name.
    """
    bound: dict[str, Pool] = {}
    folded: dict[str, str] = {}
    names = list(robots)
    for robot in names:
        twin = folded.setdefault(robot.casefold(), robot)
        if twin != robot:
            raise ConfigError(f"the names of robots {twin!r} and {robot!r} differ in case only", file=file)
        pool = next((pool for pool in pools if matches(robot, pool)), None)
        if pool is None:
            known = ", ".join(expected_robots(pool) for pool in pools)
            raise ConfigError(f"no pool for robot {robot!r}; the pools expect robots {known}", file=file)
        bound[robot] = pool
    for pool in pools:
        if not pool.multi_instance and pool not in bound.values():
            if not is_ros_name(f"/{pool.name}"):
                text = f"pool {pool.name!r} cannot name a robot: expected {NAMES}"
                raise ModelError(text, file=file, line=pool.line)
            there = ", ".join([*names, *others])
            have = f"the robots are {there}" if there else "there are no robots"
            raise ConfigError(f"pool {pool.name!r} has no robot {expected_robots(pool)}; {have}", file=file)
    return bound


def robot_names(pools: Iterable[Pool], counts: Mapping[str, int], least: int = 0) -> list[str]:
    """Return names for the robots of some pools: `counts` by name of the pool, else at least `least`."""
    names: list[str] = []
    for pool in pools:
        numbers = range(1, counts.get(pool.name, max(least, pool.minimum)) + 1)
        names += [f"{pool.name}_{number}" for number in numbers] if pool.multi_instance else [pool.name]
    return names


def matches(robot: str, pool: Pool) -> bool:
    """Return whether the robot with this namespace belongs to a pool."""
    if pool.multi_instance:
        return re.fullmatch(re.escape(pool.name) + r"_\d+", robot, re.IGNORECASE) is not None
    return robot.casefold() == pool.name.casefold()


def expected_robots(pool: Pool) -> str:
    """Return the names of a pool's robots, for messages."""
    return f"{pool.name}_<number>" if pool.multi_instance else pool.name
