"""Waits of tokens, boundary events and start events of event sub-processes, and what ends them.

A wait is armed by its trigger: in the table of listeners (signal, message), at a timer of the host, in the list of
conditions. What is disarmed is in none of them. How each trigger arms, disarms, is suspended and resumed is in the
table at the end.
"""

from __future__ import annotations

from typing import Any

from fame.engine.engine_state import EngineState
from fame.engine.host import is_from_outside
from fame.engine.program import Node, Trigger, nothing
from fame.engine.state import Listener, Mailbox, Scope, Wait

# ---- arming --------------------------------------------------------------------------------------


def wait_at(engine: EngineState, node: Node, scope: Scope) -> Wait:
    """A token begins to wait, and the boundary events of its activity are armed."""
    wait = Wait(engine.new_key(), node, scope, True)
    scope.children[wait] = None
    if node.boundary is not None:
        arm_all(engine, node.boundary.armed, scope, wait)
    return wait


def arm_all(engine: EngineState, nodes: tuple[Node, ...], scope: Scope, owner: Scope | Wait) -> None:
    """Arm boundary events or alternatives, as long as what they are armed for is alive."""
    for node in nodes:
        if owner.alive:
            armed = Wait(engine.new_key(), node, scope, False, owner)
            owner.arms += (armed,)
            armed.catch.trigger.arm(engine, armed)


def arm(engine: EngineState, wait: Wait) -> None:
    """Let its trigger wake it."""
    wait.catch.trigger.arm(engine, wait)


def disarm(engine: EngineState, wait: Wait) -> None:
    """Disarm everything that could wake it, and everything that is armed because of it."""
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
    """A token waits no more, or what was armed fires for the last time."""
    wait.scope.children.pop(wait, None)
    disarm(engine, wait)


# ---- waking --------------------------------------------------------------------------------------


def catch(engine: EngineState, wait: Wait, message: Any) -> None:
    """A message has come to one that waits for it."""
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
    """What it waits for is there; one that is suspended remembers it."""
    if not wait.alive:
        return
    if wait.paused:
        wait.due = wait.due or engine.new_key()
        return
    react = wait.catch.fire
    react(engine, wait)


# ---- topics --------------------------------------------------------------------------------------


def listen(engine: EngineState, wait: Wait) -> None:
    """Add it to the listeners of its topic; a message that its queue kept is there at once."""
    topic = wait.catch.topic
    if not wait.catch.queue:
        listeners = engine.listeners.get(topic)
        if listeners is None:
            engine.listeners[topic] = {wait: None}
        else:
            listeners[wait] = None
        return
    box = _mailbox_of(wait)
    if box is None:  # of a boundary event or event sub-process: it lives as long as this wait
        box = wait.box = wait.box or open_mailbox(engine, wait.node, wait.scope)
    box.waits[wait] = None
    while box.messages and wait in box.waits:
        catch(engine, wait, box.messages.popleft()[1])


def stop_listening(engine: EngineState, wait: Wait) -> None:
    """Messages reach it no more, though its queue still keeps them."""
    if wait.catch.queue:
        box = wait.box or _mailbox_of(wait)
        if box is not None:
            box.waits.pop(wait, None)
    else:
        _remove_listener(engine, wait.catch.topic, wait)


def _mailbox_of(wait: Wait) -> Mailbox | None:
    """The queue of the event that it waits at: that of its scope, or of the one around an activity that repeats."""
    scope: Scope | None = wait.scope
    while scope is not None:
        if scope.mail is not None and wait.node in scope.mail:
            return scope.mail[wait.node]
        scope = scope.parent
    return None


def open_mailbox(engine: EngineState, node: Node, scope: Scope) -> Mailbox:
    """Keep messages for an event."""
    box = Mailbox(engine.new_key(), node, scope)
    engine.listeners.setdefault(box.catch.topic, {})[box] = None
    return box


def close_mailbox(engine: EngineState, box: Mailbox) -> None:
    """Keep no more messages."""
    box.alive = False
    _remove_listener(engine, box.catch.topic, box)


def _remove_listener(engine: EngineState, topic: str, listener: Listener) -> None:
    """The opposite of listening; a topic without listeners is forgotten."""
    listeners = engine.listeners.get(topic)
    if listeners is not None:
        listeners.pop(listener, None)
        if not listeners:
            del engine.listeners[topic]


# ---- timers --------------------------------------------------------------------------------------


def set_timer(engine: EngineState, wait: Wait) -> None:
    """Ask the host for a timer."""
    catch = wait.catch
    engine.waits[wait.key] = wait
    try:
        engine.host.set_timer(wait.key, catch.timer, str(catch.value(wait.scope.variables)))
    except BaseException as error:
        catch.give_up(engine, wait, error)


def cancel_timer(engine: EngineState, wait: Wait) -> None:
    """The host need not fire it."""
    if engine.waits.pop(wait.key, None) is not None:
        engine.host.cancel_timer(wait.key)


def set_timer_again(engine: EngineState, wait: Wait) -> None:
    """A timer runs on while it is suspended; that of the handler itself, which has fired, is set anew."""
    if wait.catch.resume and wait.key not in engine.waits:
        set_timer(engine, wait)


# ---- conditions ----------------------------------------------------------------------------------


def watch_condition(engine: EngineState, wait: Wait) -> None:
    """Evaluate its condition now, and whenever variables may have changed; what it was before counts as false."""
    wait.true = False
    engine.conditions[wait] = None
    engine.unsettled = True
    check_condition(engine, wait)


def ignore_condition(engine: EngineState, wait: Wait) -> None:
    """Evaluate its condition no more."""
    engine.conditions.pop(wait, None)


def check_conditions(engine: EngineState) -> None:
    """Variables changed: evaluate armed conditional events, in the order of arming."""
    for wait in tuple(engine.conditions):
        if wait.alive and not wait.paused:
            check_condition(engine, wait)


def check_condition(engine: EngineState, wait: Wait) -> None:
    """A conditional event fires when its condition becomes true; a name that is not set yet is not true."""
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
    """The same after a suspension, if they have all come before it."""
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
