"""Deliveries: which catching events a message on a topic reaches."""

from __future__ import annotations

from typing import Any

from fame.engine import starts
from fame.engine.data import correlates
from fame.engine.engine_state import EngineState
from fame.engine.state import Listener, Mailbox, Wait
from fame.engine.waiting import MESSAGE, catch


def deliver(engine: EngineState, topic: str, message: Any) -> None:
    """One delivery reaches every catcher armed at its beginning once, in the order of arming; start events last.

    Of those that wait for a BPMN message only the first that correlates gets it (standard 8.3.2).
    """
    taken = False
    listeners = tuple(engine.listeners.get(topic, ()))
    if listeners:
        for listener in listeners:
            if listener.catch.trigger is MESSAGE:
                if taken or not _is_for(listener, message):
                    continue
                taken = True
            if isinstance(listener, Mailbox):
                _put(engine, listener, message)
            elif listener.alive and not listener.paused:
                catch(engine, listener, message)
    for node in engine.program.starts.get(topic, ()):
        if not (
            taken if node.catch is not None and node.catch.trigger is MESSAGE else starts.is_awaited(node, listeners)
        ):
            starts.trigger(engine, node, message)


def _is_for(listener: Listener, message: Any) -> bool:
    """Whether a BPMN message correlates with a listener that has not been disarmed or suspended meanwhile."""
    if not listener.alive or (isinstance(listener, Wait) and listener.paused):
        return False
    return correlates(listener.catch.keys, listener.scope.variables, message)


def _put(engine: EngineState, box: Mailbox, message: Any) -> None:
    """A message for those that wait at a queue, else into it."""
    if not box.alive:
        return
    if not box.waits:
        box.messages.append((engine.new_key(), message))
        return
    waits = tuple(box.waits)
    for wait in waits[:1] if box.catch.trigger is MESSAGE else waits:
        if wait.alive and not wait.paused:
            catch(engine, wait, message)
