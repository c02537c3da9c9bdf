"""Starts of a process: what triggers an instance, alone or together with others (standard 13.2, 13.5.1).

A trigger begins an instance, unless as many run as may. A *parallel multiple* start event begins one when all of its
triggers have come; until then they are gathered, in sets of what correlates, where the first of each trigger counts. A
*parallel* event-based gateway begins one with the first of its events; that instance then waits for the others, and
what it waits for begins no other one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fame.engine import waiting
from fame.engine.data import correlates
from fame.engine.state import Listener, Node

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

Arrived = list[tuple[Node, Any]]
"""Triggers and their messages, in the order of arrival."""
Gathered = tuple[dict[str, Any], dict[Node, Any]]
"""Some of the triggers of a parallel multiple event: what correlates them, and messages by trigger."""


def trigger(engine: Engine, node: Node, message: Any) -> None:
    """A start event of the process was triggered."""
    if engine.held is not None:
        engine.host.report(node.id, "trigger dropped: the robot holds")
        return
    arrived: Arrived | None = [(node, message)]
    if node.join is not None and node.join.kind == "all":
        arrived, node = gather(engine, node.join, node, message), node.join
    if arrived is None:
        return
    limit = engine.program.instances
    if limit is None or len(engine.instances) < limit:
        begin(engine, node, arrived)
    elif node.queue:
        kept = engine.waiting_starts.setdefault(node, deque(maxlen=node.queue))
        kept.append((engine.new_key(), message))
    else:
        text = f"trigger dropped: {limit} instance(s) of {engine.program.process} run already"
        engine.host.report(node.id, text)


def begin_waiting(engine: Engine) -> None:
    """An instance has ended: the trigger that waited longest begins the next."""
    waiting_starts = engine.waiting_starts
    node = min(waiting_starts, key=lambda start: waiting_starts[start][0][0])
    _, message = waiting_starts[node].popleft()
    if not waiting_starts[node]:
        del waiting_starts[node]
    trigger(engine, node, message)


def begin(engine: Engine, node: Node, arrived: Arrived) -> None:
    """An instance that takes what has arrived."""
    instance = engine.open_instance(node, None)
    for event, message in arrived:
        try:
            if event.take is not None:
                event.take(instance.root_variables, message)
            correlates(event, instance.root_variables, message)
        except BaseException as error:
            engine.abandon(instance, event, f"{type(error).__name__}: {error}", "script", error)
            break
    if engine.conditions:
        waiting.check_conditions(engine)


def gather(engine: Engine, whole: Node, part: Node, message: Any) -> Arrived | None:
    """Keep one trigger of a parallel multiple event; all of them, if it was the last."""
    sets = engine.gathered.setdefault(whole, [])
    fitting = next((each for each in sets if correlates(part, each[0], message)), None)
    if fitting is None:
        fitting = ({}, {})
        correlates(part, fitting[0], message)
        sets.append(fitting)
    fitting[1].setdefault(part, message)
    if len(fitting[1]) < len(whole.alternatives):
        return None
    sets[:] = [each for each in sets if each is not fitting]
    if not sets:
        del engine.gathered[whole]
    return list(fitting[1].items())


def awaited(node: Node, listeners: Sequence[Listener]) -> bool:
    """Whether what would start a process by a parallel gateway is for an instance that waits for it."""
    return node.join is not None and any(listener.node.guard is node.join for listener in listeners)
