"""Assign the pools of a model to robots, and find the topics that connect them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool, assign_pools, expected_robots, matches, pools_of, shared_topics
from fame.bpmn.topics import TopicUse
from fame.errors import DeploymentError
from fame.robot.endpoints import direct_topic


def assign_robots(
    definitions: Definitions, robots: Sequence[str], *, found: bool, only: Sequence[str]
) -> dict[str, Pool]:
    """The pool of each robot. Of `robots` that were `found`, not named, some may belong to another model; with `only`
    some of them, pools may stay without a robot.

    Raises DeploymentError and ConfigError for robots that are missing, ModelError for pools that cannot be assigned.
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
    """For each robot, the public topics at which another robot of the collaboration has the opposite end.

    Each topic comes with that end: ``publisher`` or ``subscriber``.
    """
    users: dict[str, dict[str, TopicUse]] = {}  # topic -> robot -> how it uses it
    for robot, pool in assigned.items():
        for topic, use in shared_topics(definitions, [pool], library).items():
            if not topic.startswith("~/"):
                users.setdefault(topic, {})[robot] = use
    promised: dict[str, dict[str, str]] = {robot: {} for robot in assigned}
    for topic, uses in users.items():
        for robot, use in uses.items():
            others = {other: theirs for other, theirs in uses.items() if other != robot}
            promised[robot] |= _promised(topic, use, others)
    return promised


def _promised(topic: str, use: TopicUse, others: Mapping[str, TopicUse]) -> dict[str, str]:
    """The opposite ends that others have at a topic of one robot, and at those on which it addresses one of them."""
    ends: dict[str, str] = {}
    if use.addresses:
        ends |= {direct_topic(topic, other): "subscriber" for other in sorted(others) if others[other].takes_messages}
    if use.throws and any(theirs.catches for theirs in others.values()):
        ends[topic] = "subscriber"
    elif use.catches and not use.throws and any(theirs.throws for theirs in others.values()):
        ends[topic] = "publisher"
    return ends
