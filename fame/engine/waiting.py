"""What waits: tokens at rest, boundary events, starts of event sub-processes; and the deliveries that wake them.

A rest is armed by its kind: in the table of listeners (signal, message), at a timer of the host, in the list of
conditions. What is disarmed is in none of them. A delivery is offered to whoever listened when it began.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine import faults, gateways, scopes, starts
from fame.engine.data import correlates
from fame.engine.state import Listener, Mailbox, Node, Rest, Scope

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

# ---- arming --------------------------------------------------------------------------------------


def rest(engine: Engine, node: Node, scope: Scope) -> Rest:
    """A token comes to rest, and the boundary events of its activity are armed."""
    resting = Rest(engine.new_key(), node, scope, True)
    scope.children[resting] = None
    if node.armed:
        guard(engine, node.armed, scope, resting)
    return resting


def guard(engine: Engine, nodes: tuple[Node, ...], scope: Scope, owner: Scope | Rest) -> None:
    """Arm boundary events or alternatives, as long as what they guard is there."""
    for node in nodes:
        if owner.alive:
            armed = Rest(engine.new_key(), node, scope, False, owner)
            owner.arms += (armed,)
            arm(engine, armed)


def arm(engine: Engine, resting: Rest) -> None:
    """Make a rest hear what it waits for; a user needs no arming."""
    act = _ARM.get(resting.node.kind)
    if act is not None:
        act(engine, resting)


def watch(engine: Engine, resting: Rest) -> None:
    """Look at its condition whenever variables may have changed, and now."""
    engine.conditions[resting] = None
    engine.alert = True
    check_condition(engine, resting)


def gather(engine: Engine, resting: Rest) -> None:
    """Arm all that it waits for together."""
    guard(engine, resting.node.alternatives, resting.scope, resting)


def set_timer(engine: Engine, resting: Rest) -> None:
    """Let the host tell when it is due."""
    node = resting.node
    engine.rests[resting.key] = resting
    try:
        engine.host.set_timer(resting.key, node.timer, str(node.run(resting.scope.variables)))
    except BaseException as error:
        give_up(engine, resting, error)


def listen(engine: Engine, resting: Rest) -> None:
    """Let it hear its topic; a message that its queue kept is there at once."""
    node = resting.node
    if not node.queue:
        listeners = engine.listeners.get(node.topic)
        if listeners is None:
            engine.listeners[node.topic] = {resting: None}
        else:
            listeners[resting] = None
        return
    box = box_of(resting)
    if box is None:  # of a boundary event or event sub-process: it lives as long as this rest
        box = resting.box = resting.box or mailbox(engine, node, resting.scope)
    box.rests[resting] = None
    while box.messages and resting in box.rests:
        catch(engine, resting, box.messages.popleft()[1])


_ARM = {"signal": listen, "message": listen, "timer": set_timer, "condition": watch, "all": gather}


def box_of(resting: Rest) -> Mailbox | None:
    """The queue of the event that it waits at: that of its scope, or of the one around an activity that repeats."""
    scope: Scope | None = resting.scope
    while scope is not None:
        if scope.mail is not None and resting.node in scope.mail:
            return scope.mail[resting.node]
        scope = scope.parent
    return None


def mailbox(engine: Engine, node: Node, scope: Scope) -> Mailbox:
    """Keep messages for an event."""
    box = Mailbox(engine.new_key(), node, scope)
    engine.listeners.setdefault(node.topic, {})[box] = None
    return box


def drop(engine: Engine, box: Mailbox) -> None:
    """Keep no more messages."""
    box.alive = False
    unlisten(engine, box.node.topic, box)


def unlisten(engine: Engine, topic: str, listener: Listener) -> None:
    """The opposite of listening; a topic that nobody listens to is forgotten."""
    listeners = engine.listeners.get(topic)
    if listeners is not None:
        listeners.pop(listener, None)
        if not listeners:
            del engine.listeners[topic]


def disarm(engine: Engine, resting: Rest) -> None:
    """Whatever could wake it, and whatever is armed because of it, is forgotten."""
    resting.alive = False
    act = _DISARM.get(resting.node.kind)
    if act is not None:
        act(engine, resting)
    if resting.box is not None:
        drop(engine, resting.box)
    if resting.arms:
        for armed in resting.arms:
            disarm(engine, armed)
        resting.arms = ()


def deafen(engine: Engine, resting: Rest) -> None:
    """It hears its topic no more, though its queue still does; or nobody looks at its condition."""
    node = resting.node
    if node.queue:
        box = resting.box or box_of(resting)
        if box is not None:
            box.rests.pop(resting, None)
    elif node.topic:
        unlisten(engine, node.topic, resting)
    else:
        engine.conditions.pop(resting, None)


def forget(engine: Engine, resting: Rest) -> None:
    """The host names it no more; a timer is cancelled."""
    if engine.rests.pop(resting.key, None) is not None and resting.node.kind == "timer":
        engine.host.cancel_timer(resting.key)


_DISARM = {"signal": deafen, "message": deafen, "condition": deafen, "timer": forget, "script": forget}


# ---- deliveries ----------------------------------------------------------------------------------


def deliver(engine: Engine, topic: str, message: Any) -> None:
    """One delivery reaches every catcher armed at its beginning once, in the order of arming; start events last.

    Of those that wait for a BPMN message only the first that correlates gets it (standard 8.3.2).
    """
    taken = False
    listeners = tuple(engine.listeners.get(topic, ()))
    if listeners:
        for listener in listeners:
            if listener.node.kind == "message":
                if taken or not hears(listener) or not correlates(listener.node, listener.scope.variables, message):
                    continue
                taken = True
            if isinstance(listener, Mailbox):
                put(engine, listener, message)
            elif listener.alive and not listener.paused:
                catch(engine, listener, message)
    for node in engine.program.starts.get(topic, ()):
        if not (taken if node.kind == "message" else starts.awaited(node, listeners)):
            starts.trigger(engine, node, message)


def hears(listener: Listener) -> bool:
    """Whether it has neither been disarmed nor suspended since the delivery began."""
    return listener.alive and not (listener.__class__ is Rest and listener.paused)


def put(engine: Engine, box: Mailbox, message: Any) -> None:
    """A message for those who wait at a queue, else into it."""
    if not box.alive:
        return
    if not box.rests:
        box.messages.append((engine.new_key(), message))
        return
    waiting = tuple(box.rests)
    for resting in waiting[:1] if box.node.kind == "message" else waiting:
        if resting.alive and not resting.paused:
            catch(engine, resting, message)


def catch(engine: Engine, resting: Rest, message: Any) -> None:
    """A message has come to one who waits for it."""
    take = resting.node.take
    if take is not None:
        try:
            take(resting.scope.variables, message)
        except BaseException as error:
            give_up(engine, resting, error)
            return
    act = resting.node.fire
    assert act is not None
    act(engine, resting)
    if take is not None and engine.conditions:
        check_conditions(engine)


def fire(engine: Engine, resting: Rest) -> None:
    """What a rest waits for is there; one that is suspended remembers it."""
    if not resting.alive:
        return
    if resting.paused:
        resting.due = resting.due or engine.new_key()
        return
    act = resting.node.fire
    assert act is not None
    act(engine, resting)


def give_up(engine: Engine, resting: Rest, error: BaseException) -> None:
    """What a rest waits for, or what it brought, could not be evaluated: the token leaves as an error."""
    holder = resting.owner if resting.node.fire in (gateways.fire_alternative, gateways.fire_part) else resting
    assert isinstance(holder, Rest)
    scopes.withdraw(engine, holder)
    faults.fail(engine, resting.scope, resting.node, error)


# ---- conditions ----------------------------------------------------------------------------------


def check_conditions(engine: Engine) -> None:
    """Variables changed: armed conditional events, in the order of arming."""
    for resting in tuple(engine.conditions):
        if resting.alive and not resting.paused:
            check_condition(engine, resting)


def check_condition(engine: Engine, resting: Rest) -> None:
    """A conditional event fires when its condition becomes true; a name that is not set yet is not true."""
    try:
        value = bool(resting.node.run(resting.scope.variables))
    except (NameError, LookupError, AttributeError):
        value = False
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and faults.is_from_outside(error):
            raise
        engine.host.report(resting.node.id, f"condition failed: {error}")
        value = False
    rises = value and not resting.true
    resting.true = value
    if rises:
        fire(engine, resting)
