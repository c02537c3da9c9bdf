"""Waits of tokens, boundary events and start events of event sub-processes: arming, disarming and firing.

The trigger of a wait arms it: in the table of listeners (signal, message), as a timer of the host, or in the list of
conditions. A disarmed wait is in none of them. The table at the end has the functions of each trigger.

An event with a queue has a `Mailbox` among the listeners of its topic, which keeps what no token takes. A BPMN message
is kept once for the whole robot: when the token of its event has passed, any other that waits can take it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fame.engine.data import correlates, correlation
from fame.engine.engine_state import EngineState
from fame.engine.host import is_from_outside
from fame.engine.program import NO_TRIGGER, Catch, Node, Trigger, nothing
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
    event = wait.catch
    take, fire = event.take, event.fire
    if take is not None:
        try:
            take(wait.scope.variables, message)
        except BaseException as error:
            event.give_up(engine, wait, error)
            return
    fire(engine, wait)
    if take is not None and engine.conditions:
        check_conditions(engine)


def fire(engine: EngineState, wait: Wait) -> None:
    """Fire a wait; a suspended wait becomes due instead."""
    if not wait.alive:
        return
    if wait.paused:
        wait.due = wait.due or engine.new_key()
        if wait.catch.trigger is TIMER:
            count_missed(engine, wait.key)
        return
    react = wait.catch.fire
    react(engine, wait)


# ---- topics --------------------------------------------------------------------------------------


def listen(engine: EngineState, wait: Wait) -> None:
    """Add a wait to the listeners of its topic, and give it what is kept for it."""
    catch = wait.catch
    topic = catch.topic
    listeners = engine.listeners.get(topic)
    if listeners is None:
        engine.listeners[topic] = {wait: None}
    else:
        listeners[wait] = None
    if topic in engine.program.selective:
        if catch.queue and mailbox_of(wait) is None:  # a boundary event or event sub-process: the queue is this wait's
            wait.box = open_mailbox(engine, wait.node, wait.scope)
        take_kept(engine, wait)


def stop_listening(engine: EngineState, wait: Wait) -> None:
    """Remove a wait from the listeners of its topic; its queue still keeps messages."""
    catch = wait.catch
    _remove_listener(engine, catch.topic, wait)
    if catch.queue and catch.trigger is MESSAGE and not (wait.alive or wait.box):
        box = mailbox_of(wait)
        if box is not None and box.scope is wait.scope:  # else the activity is repeated: see `pass_activity`
            _pass(engine, box)


def take_kept(engine: EngineState, wait: Wait) -> None:
    """Deliver the messages kept for a wait, the oldest first; of alternatives, the one for the oldest message wins."""
    catch = wait.catch
    if not catch.queue and catch.topic not in engine.program.shared:
        return
    owner = wait.owner
    is_alternative = isinstance(owner, Wait) and owner.catch.trigger is NO_TRIGGER
    while wait.alive and not wait.paused:
        rivals = owner.arms if is_alternative and isinstance(owner, Wait) else (wait,)
        candidates = [(kept, box, rival) for rival in rivals for kept, box in _kept_for(engine, rival)]
        if not candidates:
            return
        kept, box, taker = min(candidates, key=lambda item: item[0][0])
        box.messages.remove(kept)
        if box.catch.trigger is MESSAGE:
            engine.untaken[box.catch.topic] -= 1
        take(engine, taker, kept[1])


def _kept_for(engine: EngineState, wait: Wait) -> Iterator[tuple[tuple[int, Any], Mailbox]]:
    """Yield the oldest message for a wait in its own queue, and in each whose token has passed."""
    catch = wait.catch
    own = mailbox_of(wait) if catch.queue else None
    for box in engine.listeners.get(catch.topic, ()):
        if isinstance(box, Mailbox) and (box is own or (box.passed and catch.trigger is MESSAGE)):
            kept = next((item for item in box.messages if fits(catch, wait.scope, item[1])), None)
            if kept is not None:
                yield kept, box


def fits(catch: Catch, scope: Scope, message: Any) -> bool:
    """Return whether a message correlates, in a scope. It sets no key."""
    return not catch.keys or correlation(catch.keys, scope.variables, message) is not None


def take(engine: EngineState, wait: Wait, message: Any) -> bool:
    """Deliver a message to a wait, if it correlates with it. The first message sets the keys."""
    if not correlates(wait.catch.keys, wait.scope.variables, message):
        return False
    catch(engine, wait, message)
    return True


def keep(engine: EngineState, boxes: list[Mailbox], message: Any) -> bool:
    """Keep a BPMN message in the first queue with room that it is for; if all are full, the first loses its oldest."""
    open_for = [box for box in boxes if box.alive and fits(box.catch, box.scope, message)]
    box = next((box for box in open_for if len(box.messages) < box.catch.queue), open_for[0] if open_for else None)
    if box is not None:
        box.messages.append((engine.new_key(), message))
    return box is not None


def pass_activity(engine: EngineState, activity: Scope, scope: Scope) -> None:
    """Let others take what is kept in `scope` for an activity with a scope of its own, whose token has left."""
    for box in (scope.mail or {}).values():
        if activity.node is not None and activity.node.id == box.node.id and box.catch.trigger is MESSAGE:
            _pass(engine, box)


def _pass(engine: EngineState, box: Mailbox) -> None:
    """Mark the queue of an event whose token has left: others can take its messages."""
    box.passed = True
    if box.messages:
        engine.ready.append((HAND_ON, box.scope))


def _hand_on(engine: EngineState, scope: Scope, node: Node) -> None:
    """Deliver the messages of a scope's queues whose token has passed to waits elsewhere."""
    left = [(kept, box) for box in (scope.mail or {}).values() if box.passed for kept in box.messages]
    for kept, box in sorted(left, key=lambda item: item[0][0]):
        for wait in tuple(engine.listeners.get(box.catch.topic, ())):
            if isinstance(wait, Mailbox) or wait.catch.trigger is not MESSAGE or not wait.alive or wait.paused:
                continue
            if box.alive and fits(wait.catch, wait.scope, kept[1]):
                box.messages.remove(kept)
                engine.untaken[box.catch.topic] -= 1
                take(engine, wait, kept[1])
                break


HAND_ON = Node("", "(hand on)", _hand_on)
"""An entry of the ready queue that is not a token: it delivers messages kept by events whose token has passed."""


def mailbox_of(wait: Wait) -> Mailbox | None:
    """Return the queue of a wait's event: its own, that of its scope, or (activity repeated) of an outer scope."""
    home = wait.catch.home or wait.node
    scope: Scope | None = wait.scope if wait.box is None else None
    while scope is not None:
        if scope.mail is not None and home in scope.mail:
            return scope.mail[home]
        scope = scope.parent
    return wait.box


def open_mailbox(engine: EngineState, node: Node, scope: Scope) -> Mailbox:
    """Open the queue of an event."""
    box = Mailbox(engine.new_key(), node, scope)
    engine.listeners.setdefault(box.catch.topic, {})[box] = None
    return box


def close_mailbox(engine: EngineState, box: Mailbox) -> None:
    box.alive = False
    _remove_listener(engine, box.catch.topic, box)


def _remove_listener(engine: EngineState, topic: str, listener: Listener) -> None:
    listeners = engine.listeners.get(topic)
    if listeners is not None:
        listeners.pop(listener, None)
        if not listeners:
            del engine.listeners[topic]


# ---- timers --------------------------------------------------------------------------------------


def set_timer(engine: EngineState, wait: Wait) -> None:
    catch = wait.catch
    engine.waits[wait.key] = wait
    try:
        engine.host.set_timer(wait.key, catch.timer, str(catch.value(wait.scope.variables)))
    except BaseException as error:
        catch.give_up(engine, wait, error)


def cancel_timer(engine: EngineState, wait: Wait) -> None:
    engine.missed.pop(wait.key, None)
    if engine.waits.pop(wait.key, None) is not None:
        engine.host.cancel_timer(wait.key)


def set_timer_again(engine: EngineState, wait: Wait) -> None:
    """Set the timer of a handler again if it has fired. Other timers run on while they are suspended."""
    if wait.catch.resume and wait.key not in engine.waits:
        set_timer(engine, wait)


def count_missed(engine: EngineState, key: int) -> None:
    """Count that a timer came due while it was suspended."""
    engine.missed[key] += 1


def report_missed(engine: EngineState, key: int, node: Node) -> None:
    """Report that a timer fires once for several times that were missed."""
    if (times := engine.missed.pop(key, 0)) > 1:
        engine.host.report(node.id, f"came due {times} times while suspended: fires once")


# ---- conditions ----------------------------------------------------------------------------------


def watch_condition(engine: EngineState, wait: Wait) -> None:
    """Evaluate a condition now and whenever variables may have changed.

    After a suspension, too, it has to become true; that of a handler that has ended is armed again.
    """
    if wait.catch.resume:
        wait.true = False
    engine.conditions[wait] = None
    engine.unsettled = True
    check_condition(engine, wait)


def ignore_condition(engine: EngineState, wait: Wait) -> None:
    engine.conditions.pop(wait, None)


def check_conditions(engine: EngineState) -> None:
    """Evaluate the armed conditional events, in the order of arming, after variables have changed."""
    for wait in tuple(engine.conditions):
        if wait.alive and not wait.paused:
            check_condition(engine, wait)


def check_condition(engine: EngineState, wait: Wait) -> None:
    """Fire a conditional event if its condition becomes true. It is false if a name is not set, or if it fails."""
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
