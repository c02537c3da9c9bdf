"""What the tokens of a robot wait for, in words and by topic."""

from __future__ import annotations

import reprlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.engine import waiting
from fame.engine.program import USER, Node
from fame.engine.state import Wait as EngineWait, joins_reached
from fame.middleware.interface import resolve
from fame.robot.gaps import gap_text
from fame.scripting import script_names

if TYPE_CHECKING:
    from fame.robot.node import RobotNode


SOMEBODY = "somebody to complete it"
"""What user and manual tasks wait for."""


@dataclass(frozen=True, slots=True)
class Wait:
    """An element that holds a resting token, and what it waits for, in words.

    `since` (ns) is when it was first seen there; `topics` are those whose message would move it, by full name, each
    with how many others publish on it.
    """

    robot: str
    element: str
    text: str
    since: int = 0
    topics: Mapping[str, int] = field(default_factory=dict)


def waits_of(robot: RobotNode, seen: dict[Hashable, int]) -> list[Wait]:
    """See `RobotNode.waits`. `seen` is kept from call to call: when each resting token was seen first (ns)."""
    now, publishers = robot.scheduler.now, _publishers_heard(robot)
    heard = {topic: len(names) for topic, names in publishers.items()}
    rests = [rest for instance in robot.engine.instances.values() for rest in instance.waits()]
    joins = [found for instance in robot.engine.instances.values() for found in joins_reached(instance.root)]
    keys = [*(rest.key for rest in rests), *((scope.key, join.id) for scope, join, _ in joins)]
    known = {key: seen.get(key, now) for key in keys}
    seen.clear()
    seen.update(known)
    awaited = [_awaited(robot, rest) for rest in rests]
    robot.gaps.look(now, {topic: publishers.get(topic, ()) for topics in awaited for topic in topics})
    found = []
    for rest, topics in zip(rests, awaited, strict=True):
        since = seen[rest.key]
        text = _wait_text(robot, rest, heard) + gap_text(robot.gaps.since(since, topics), now)
        found.append(Wait(robot.name, rest.node.id, text, since, {topic: heard.get(topic, 0) for topic in topics}))
    found += [
        Wait(robot.name, join.id, _join_text(join, held), seen[scope.key, join.id]) for scope, join, held in joins
    ]
    if not robot.engine.instances:
        found += [
            Wait(robot.name, robot.engine.armed_starts[key].id, f"its start, due at {due / SECOND:g} s")
            for key, due in robot.starts_due().items()
        ]
    if not robot.instances:
        for topic, nodes in robot.engine.program.starts.items():
            full = resolve(topic, robot.namespace)
            text, counts = f"its start on {_topic_text(full, heard)}", {full: heard.get(full, 0)}
            found.extend(Wait(robot.name, node.id, text, topics=counts) for node in nodes)
    return found


def _join_text(join: Node, held: list[int]) -> str:
    return f"a token on {held.count(0) or 'more'} of its {join.spec.need} flows"


def _publishers_heard(robot: RobotNode) -> dict[str, list[str]]:
    """The other nodes that publish on each topic, once for each publisher."""
    own = robot.node.full_name
    return {info.name: [name for name in info.publishers if name != own] for info in robot.middleware.graph()}


def _awaited(robot: RobotNode, rest: EngineWait) -> list[str]:
    """The topics whose message would move a token, by full name."""
    nodes = (rest.node, *rest.catch.parts)
    names = [node.catch.topic for node in nodes if node.catch is not None and node.catch.topic]
    if not names and (topic := robot.runner.awaited_topic(rest.key)):
        names = [topic]
    return [resolve(name, robot.namespace) for name in names]


def _wait_text(robot: RobotNode, rest: EngineWait, heard: Mapping[str, int]) -> str:
    catch, variables = rest.catch, rest.scope.variables
    if catch.timer:
        return f"{catch.timer} timer"
    if catch.trigger is USER:
        return SOMEBODY
    if catch.parts:
        return " or ".join(_trigger_text(robot, item, variables, heard) for item in catch.parts)
    awaited = robot.runner.awaited_topic(rest.key)
    if awaited is not None:
        return f"receive on {_topic_text(resolve(awaited, robot.namespace), heard)}"
    return robot.runner.waits(rest.key) or _trigger_text(robot, rest.node, variables, heard)


def _trigger_text(robot: RobotNode, node: Node, variables: Mapping[str, Any], heard: Mapping[str, int]) -> str:
    """What an event waits for."""
    assert node.catch is not None
    if node.catch.topic:
        return _catch_text(robot, node.catch.topic, heard)
    if node.catch.trigger is waiting.CONDITION:
        return _condition_text(robot, node, variables)
    return node.catch.trigger.name


def _condition_text(robot: RobotNode, node: Node, variables: Mapping[str, Any]) -> str:
    """The condition, and the values that it has to do with."""
    condition = robot.conditions.get((node.file, node.id))
    if condition is None:
        return waiting.CONDITION.name
    names = sorted(script_names(condition, script=False)[0])
    values = [
        f"{name} = {reprlib.repr(variables[name])}" if name in variables else f"{name} is not set" for name in names
    ]
    return f"condition {condition.text}" + (f" ({', '.join(values)})" if values else "")


def _catch_text(robot: RobotNode, topic: str, heard: Mapping[str, int]) -> str:
    """With the message that came too early, if one did: a signal is lost on who waits for it later."""
    text = _topic_text(resolve(topic, robot.namespace), heard)
    if topic not in robot.missed:
        return text
    ago = (robot.scheduler.now - robot.missed[topic]) / SECOND
    return f"{text} (its last message came {ago:.3g} s ago, when nobody waited for it)"


def _topic_text(topic: str, heard: Mapping[str, int]) -> str:
    return f"topic {topic}" + ("" if heard.get(topic) else ", which nobody else publishes")
