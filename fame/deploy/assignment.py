"""Which robot gets which part of a model, and at which topics it will meet which others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool, assign_pools, expected_robots, matches, pools_of, shared_topics
from fame.errors import DeploymentError
from fame.robot.endpoints import direct_topic


def assign_robots(
    definitions: Definitions, robots: Sequence[str], *, found: bool, only: Sequence[str]
) -> dict[str, Pool]:
    """Who plays which pool. Robots that were `found`, not named, may belong to others; `only` some leave pools open.

    Raises DeploymentError and ConfigError for robots that are not there, ModelError for pools that cannot be played.
    """
    pools = pools_of(definitions)
    if found:
        robots = [robot for robot in robots if any(matches(robot, pool) for pool in pools)]
    unknown = [name for name in only if name not in robots]
    wanted = ", ".join(expected_robots(pool) for pool in pools)
    if unknown:
        there = f"there are {', '.join(robots)}" if robots else "there is none"
        text = f"no engine of a robot named {', '.join(unknown)}; of those that the model wants ({wanted}) {there}"
        raise DeploymentError(text)
    if only:
        pools = [pool for pool in pools if any(matches(robot, pool) for robot in robots)]
    assigned = assign_pools(pools, robots, file=definitions.file)
    if not assigned:
        raise DeploymentError(f"no engine of a robot that the model wants: {wanted}")
    return assigned


def promises(definitions: Definitions, assigned: Mapping[str, Pool], library: Library) -> dict[str, dict[str, str]]:
    """For each robot, the public topics whose opposite end another robot of the collaboration has."""
    ends: dict[str, tuple[set[str], set[str]]] = {}
    addressing: dict[str, set[str]] = {}
    taking: dict[str, set[str]] = {}
    for robot, pool in assigned.items():
        for name, use in shared_topics(definitions, [pool], library).items():
            if not name.startswith("~/"):
                throws, catches = ends.setdefault(name, (set(), set()))
                if use.throws:
                    throws.add(robot)
                if use.catches:
                    catches.add(robot)
                if use.addresses:
                    addressing.setdefault(name, set()).add(robot)
                if use.takes_messages:
                    taking.setdefault(name, set()).add(robot)
    found: dict[str, dict[str, str]] = {robot: {} for robot in assigned}
    for name, senders in addressing.items():
        for robot in senders:
            others = taking.get(name, set()) - {robot}
            found[robot].update((direct_topic(name, other), "subscriber") for other in sorted(others))
    for name, (throws, catches) in ends.items():
        for robot in throws:
            if catches - {robot}:
                found[robot][name] = "subscriber"
        for robot in catches - throws:
            if throws - {robot}:
                found[robot][name] = "publisher"
    return found
