"""Waits of tokens, boundary events and start events of event sub-processes: arming, disarming and firing.

The trigger of a wait arms it: in the table of listeners (signal, message), as a timer of the host, or in the list of
conditions. A disarmed wait is in none of them. The table at the end has the functions of each trigger.
"""

from __future__ import annotations

from typing import Any

from fame.engine.engine_state import EngineState
from fame.engine.host import is_from_outside
from fame.engine.program import Node, Trigger, nothing
from fame.engine.state import Listener, Mailbox, Scope, Wait

# ---- arming --------------------------------------------------------------------------------------


def wait_at(engine: EngineState, node: Node, scope: Scope) -> Wait:
    """Let a token wait, and arm the boundary events of its activity."""
    wait = Wait(engine.new_key(), node, scope, True)
    scope.children[wait] = None
    if node.boundary is not None:
        arm_all(engine, node.boundary.armed, scope, wait)
    return wait


def arm_all(engine: EngineState, nodes: tuple[Node, ...], scope: Scope, owner: Scope | Wait) -> None:
    """Arm boundary events or alternatives, while their owner is alive."""
    for node in nodes:
        if owner.alive:
            armed = Wait(engine.new_key(), node, scope, False, owner)
            owner.arms += (armed,)
            armed.catch.trigger.arm(engine, armed)


def arm(engine: EngineState, wait: Wait) -> None:
    """Arm a wait by its trigger."""
    wait.catch.trigger.arm(engine, wait)


def disarm(engine: EngineState, wait: Wait) -> None:
    """Disarm a wait, and the waits that are armed for it."""
    wait.alive = False
    disarm_trigger = wait.catch.trigger.disarm
    disarm_trigger(engine, wait)
    if wait.box is not None:
        close_mailbox(engine, wait.box)
    if wait.arms:
        for armed in wait.arms:
            disarm(engine, armed)
        wait.arms = ()


def withdraw(engine: EngineState, wait: Wait) -> None:
    """Remove a wait from its scope, and disarm it."""
    wait.scope.children.pop(wait, None)
    disarm(engine, wait)


# ---- waking --------------------------------------------------------------------------------------


def catch(engine: EngineState, wait: Wait, message: Any) -> None:
    """Store a message in the variables, and fire the wait."""
    take = wait.catch.take
    if take is not None:
        try:
            take(wait.scope.variables, message)
        except BaseException as error:
            wait.catch.give_up(engine, wait, error)
            return
    fire = wait.catch.fire
    fire(engine, wait)
    if take is not None and engine.conditions:
        check_conditions(engine)


def fire(engine: EngineState, wait: Wait) -> None:
    """Fire a wait; a suspended wait becomes due instead."""
    if not wait.alive:
        return
    if wait.paused:
        wait.due = wait.due or engine.new_key()
        return
    react = wait.catch.fire
    react(engine, wait)


# ---- topics --------------------------------------------------------------------------------------


def listen(engine: EngineState, wait: Wait) -> None:
    """Add a wait to the listeners of its topic, or take the first message of its queue."""
    topic = wait.catch.topic
    if not wait.catch.queue:
        listeners = engine.listeners.get(topic)
        if listeners is None:
            engine.listeners[topic] = {wait: None}
        else:
            listeners[wait] = None
        return
    box = _mailbox_of(wait)
    if box is None:  # a boundary event or event sub-process: its queue belongs to this wait
        box = wait.box = wait.box or open_mailbox(engine, wait.node, wait.scope)
    box.waits[wait] = None
    while box.messages and wait in box.waits:
        catch(engine, wait, box.messages.popleft()[1])


def stop_listening(engine: EngineState, wait: Wait) -> None:
    """Remove a wait from the listeners of its topic; its queue still keeps messages."""
    if wait.catch.queue:
        box = wait.box or _mailbox_of(wait)
        if box is not None:
            box.waits.pop(wait, None)
    else:
        _remove_listener(engine, wait.catch.topic, wait)


def _mailbox_of(wait: Wait) -> Mailbox | None:
    """The queue of a wait's event: that of its scope, or of an outer scope if the activity is repeated."""
    scope: Scope | None = wait.scope
    while scope is not None:
        if scope.mail is not None and wait.node in scope.mail:
            return scope.mail[wait.node]
        scope = scope.parent
    return None


def open_mailbox(engine: EngineState, node: Node, scope: Scope) -> Mailbox:
    """Open the queue of an event."""
    box = Mailbox(engine.new_key(), node, scope)
    engine.listeners.setdefault(box.catch.topic, {})[box] = None
    return box


def close_mailbox(engine: EngineState, box: Mailbox) -> None:
    """Close a queue."""
    box.alive = False
    _remove_listener(engine, box.catch.topic, box)


def _remove_listener(engine: EngineState, topic: str, listener: Listener) -> None:
    """Remove a listener, and its topic with the last one."""
    listeners = engine.listeners.get(topic)
    if listeners is not None:
        listeners.pop(listener, None)
        if not listeners:
            del engine.listeners[topic]


# ---- timers --------------------------------------------------------------------------------------


def set_timer(engine: EngineState, wait: Wait) -> None:
    """Set a timer of the host."""
    catch = wait.catch
    engine.waits[wait.key] = wait
    try:
        engine.host.set_timer(wait.key, catch.timer, str(catch.value(wait.scope.variables)))
    except BaseException as error:
        catch.give_up(engine, wait, error)


def cancel_timer(engine: EngineState, wait: Wait) -> None:
    """Cancel a timer of the host."""
    if engine.waits.pop(wait.key, None) is not None:
        engine.host.cancel_timer(wait.key)


def set_timer_again(engine: EngineState, wait: Wait) -> None:
    """Set the timer of a handler that has fired again. Other timers run on while they are suspended."""
    if wait.catch.resume and wait.key not in engine.waits:
        set_timer(engine, wait)


# ---- conditions ----------------------------------------------------------------------------------


def watch_condition(engine: EngineState, wait: Wait) -> None:
    """Evaluate a condition now and whenever variables may have changed; its previous value counts as false."""
    wait.true = False
    engine.conditions[wait] = None
    engine.unsettled = True
    check_condition(engine, wait)


def ignore_condition(engine: EngineState, wait: Wait) -> None:
    """Stop evaluating a condition."""
    engine.conditions.pop(wait, None)


def check_conditions(engine: EngineState) -> None:
    """Evaluate the armed conditional events, in the order of arming, after variables have changed."""
    for wait in tuple(engine.conditions):
        if wait.alive and not wait.paused:
            check_condition(engine, wait)


def check_condition(engine: EngineState, wait: Wait) -> None:
    """Fire a conditional event if its condition becomes true; with a name that is not set it is false."""
    try:
        value = bool(wait.catch.value(wait.scope.variables))
    except (NameError, LookupError, AttributeError):
        value = False
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and is_from_outside(error):
            raise
        engine.host.report(wait.node.id, f"condition failed: {error}")
        value = False
    rises = value and not wait.true
    wait.true = value
    if rises:
        fire(engine, wait)


# ---- several together ----------------------------------------------------------------------------


def arm_parts(engine: EngineState, wait: Wait) -> None:
    """Arm all the triggers of a parallel multiple event."""
    arm_all(engine, wait.catch.parts, wait.scope, wait)


def arm_missing_parts(engine: EngineState, wait: Wait) -> None:
    """Arm all the triggers again after a suspension, if none is armed."""
    if not wait.arms:
        arm_parts(engine, wait)


# ---- the table -----------------------------------------------------------------------------------

SIGNAL = Trigger("signal", arm=listen, disarm=stop_listening, suspend=stop_listening, resume=listen)
MESSAGE = Trigger("message", arm=listen, disarm=stop_listening, suspend=stop_listening, resume=listen)
TIMER = Trigger("timer", arm=set_timer, disarm=cancel_timer, suspend=nothing, resume=set_timer_again)
CONDITION = Trigger(
    "condition", arm=watch_condition, disarm=ignore_condition, suspend=ignore_condition, resume=watch_condition
)
ALL = Trigger("all", arm=arm_parts, disarm=nothing, suspend=nothing, resume=arm_missing_parts)
