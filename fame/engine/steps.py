"""What happens when a token comes to a node, and when what it waits for is there.

A *step* gets a token in motion and gives the node that it moves to at once, or None: it rests, waits in line, or is
gone. A *fire* function is called when the stimulus of a rest has come. Both are plain functions that the compiler puts
into nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine.host import BpmnError
from fame.engine.state import Node, Rest, Scope
from fame.engine.variables import UNDEFINED, Variables, plain

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

# ---- passing on ----------------------------------------------------------------------------------


def pass_on(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """None events, plain tasks, merges, sequence flows of an unobserved program."""
    return node.next


def flow(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A sequence flow; these are nodes in observed programs alone."""
    engine.tell(scope.instance.key, scope.key, node.id, "take")
    return node.next


def observed(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The step of an element in an observed program, around its own."""
    engine.tell(scope.instance.key, scope.key, node.id, "enter")
    act = node.act
    assert act is not None
    following = act(engine, scope, node)
    if following is not None:
        engine.tell(scope.instance.key, scope.key, node.id, "leave")
    return following


def observed_end(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The same, of an element at which the token ends: it has completed before what it ends."""
    engine.tell(scope.instance.key, scope.key, node.id, "enter")
    engine.tell(scope.instance.key, scope.key, node.id, "leave")
    act = node.act
    assert act is not None
    return act(engine, scope, node)


def opening(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """First node of a body: arm what listens as long as the scope lives."""
    engine.open_scope(scope)
    return node.next


def assign(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Data objects at an association of an activity or throwing event: before it starts, after it has ended."""
    variables = scope.variables
    try:
        for name, source in node.inputs:
            value = source(variables)
            if value is not UNDEFINED:
                variables[name] = value
    except Exception as error:
        engine.fail(scope, node, error)
        return None
    return onward(engine, scope, node.next)


def onward(engine: Engine, scope: Scope, following: Node | None) -> Node | None:
    """Variables changed: conditional events may fire, and end or hold the scope that the token is in."""
    if engine.conditions:
        engine.check_conditions()
        if scope.state:
            if scope.state > 0 and following is not None:
                scope.held.append(following)
            return None
    return following


# ---- tasks ---------------------------------------------------------------------------------------


def script(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A script task: over at once, or suspended."""
    try:
        suspended = node.run(scope.variables)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed(engine, scope, node, error)
    if suspended is None:
        if engine.conditions:
            return onward(engine, scope, node.next)
        return node.next
    return suspend(engine, scope, node, suspended)


def evaluate(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A task that evaluates an expression, or calls a service that is a function, and may keep the result."""
    try:
        value = node.run(scope.variables)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed(engine, scope, node, error)
    if hasattr(value, "send") and hasattr(value, "throw"):
        return suspend(engine, scope, node, value)
    if node.variable:
        scope.variables[node.variable] = value
    return onward(engine, scope, node.next)


def failed(engine: Engine, scope: Scope, node: Node, error: BaseException) -> Node | None:
    """A step that counts as it is entered has not completed after all."""
    scope.counts[node.index] -= 1
    engine.fail(scope, node, error)
    return None


def suspend(engine: Engine, scope: Scope, node: Node, suspended: Any) -> Node | None:
    """A script waits: its token rests, and the host drives it on."""
    scope.counts[node.index] -= 1
    rest = engine.rest(node, scope)
    if rest.alive:  # a conditional boundary event may have fired as it was armed
        engine.rests[rest.key] = rest
        rest.started = True
        engine.host.run(rest.key, suspended)
    else:
        suspended.close()
    if engine.conditions:
        engine.check_conditions()
    return None


def restart(engine: Engine, rest: Rest) -> None:
    """A script that a suspension cancelled starts again, with the variables as they are now."""
    scope, node = rest.scope, rest.node
    engine.rests.pop(rest.key, None)
    rest.key, rest.started = engine.new_key(), False
    try:
        suspended = node.run(scope.variables)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        engine.withdraw(rest)
        engine.fail(scope, node, error)
        return
    if suspended is None:
        engine.withdraw(rest)
        engine.complete(scope, node)
    else:
        engine.rests[rest.key] = rest
        rest.started = True
        engine.host.run(rest.key, suspended)


def wait(engine: Engine, scope: Scope, node: Node) -> None:
    """A user, manual or receive task, or a catching event: the token rests until its stimulus comes."""
    rest = engine.rest(node, scope)
    if rest.alive:
        engine.arm(rest)


def fire_catch(engine: Engine, rest: Rest, message: Any) -> None:
    """What a resting token waits for is there."""
    engine.withdraw(rest)
    engine.complete(rest.scope, rest.node)


# ---- throwing ------------------------------------------------------------------------------------


def throw(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """Publish; own catchers hear it once the tokens ahead of it rest, then this token goes on."""
    try:
        value = node.run(scope.variables) if node.run is not None else None
        message = engine.host.publish(node.topic, None if value is UNDEFINED else value)
    except Exception as error:
        return failed(engine, scope, node, error)
    ready = engine.ready
    ready.append((None, (node.topic, message)))
    ready.append((node.next, scope))
    if node.act is not None:
        engine.tell(scope.instance.key, scope.key, node.id, "leave")
    return None


def send(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A message for another process: own catchers do not hear it."""
    try:
        value = node.run(scope.variables) if node.run is not None else None
        engine.host.publish(node.topic, None if value is UNDEFINED else value)
    except Exception as error:
        return failed(engine, scope, node, error)
    return node.next


def raise_error(engine: Engine, scope: Scope, node: Node) -> None:
    """An error end event."""
    engine.fail(scope, node, BpmnError(node.code or ""))


def escalate(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """An escalation climbs like an error; the thrower goes on unless an interrupting event caught it."""
    from fame.engine.interpreter import matching

    place: Scope | None = scope
    while place is not None:
        if place.body is not None:
            handler = matching(place.body.escalations, node.code)
            if handler is not None:
                begin_handler(engine, place, handler, node.code)
                break
        if place.node is not None and place.node.kind == "handler" and place.parent is not None:
            place = place.parent
        inner, place = place, place.parent
        catcher = matching(inner.node.escalations, node.code) if inner.node is not None else None
        if catcher is not None and place is not None:
            engine.note_error(catcher, place, node.code or "", "")
            if catcher.interrupting:
                engine.kill(inner)
            else:
                place.tokens += 1
            engine.count(place, catcher)
            assert catcher.next is not None
            engine.proceed(catcher.next, place)
            break
    else:
        engine.host.report(node.id, f"escalation {node.code or 'without code'} was not caught")
    if scope.state:
        if scope.state > 0 and node.next is not None:
            scope.held.append(node.next)
        return None
    return node.next


# ---- gateways ------------------------------------------------------------------------------------


def exclusive(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The first flow whose condition is true, else the default flow, else an error."""
    variables = scope.variables
    try:
        for condition, target in node.out:
            if condition is None or condition(variables):
                return target  # type: ignore[no-any-return]
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed(engine, scope, node, error)
    if node.default is None:
        return failed(engine, scope, node, no_flow())
    return node.default


def no_flow() -> BpmnError:
    """What a gateway without a way out throws."""
    return BpmnError("no_flow", "no condition is true and there is no default flow")


def fork(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A token for each way out: of a parallel gateway, or of any element with several flows."""
    out = node.out
    scope.tokens += len(out) - 1
    push = engine.ready.append
    for target in out[1:]:
        push((target, scope))
    return out[0]  # type: ignore[no-any-return]


def inclusive(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """A token for each flow whose condition is true, else the default flow, else an error."""
    variables = scope.variables
    try:
        chosen = [target for condition, target in node.out if condition is None or condition(variables)]
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed(engine, scope, node, error)
    if not chosen:
        if node.default is None:
            return failed(engine, scope, node, no_flow())
        return node.default
    scope.tokens += len(chosen) - 1
    for target in chosen[1:]:
        engine.ready.append((target, scope))
    return chosen[0]  # type: ignore[no-any-return]


def arrive(engine: Engine, scope: Scope, port: Node) -> Node | None:
    """A token at one incoming flow of a parallel join. Counts per flow; the last number is that of the empty flows."""
    joins = scope.joins
    if joins is None:
        joins = scope.joins = {}
    join = port.join
    assert join is not None
    need = join.need
    counts = joins.get(join)
    if counts is None:
        counts = joins[join] = [0] * need + [need]
    counts[port.need] += 1
    if counts[port.need] == 1:
        counts[need] -= 1
        if not counts[need]:
            for slot in range(need):
                counts[slot] -= 1
            counts[need] = counts[:need].count(0)
            if counts[need] == need:
                del joins[join]
            scope.tokens -= need - 1
            return join
    return None


def arrive_inclusive(engine: Engine, scope: Scope, port: Node) -> None:
    """A token at one incoming flow of an inclusive join: it is decided when nothing else can move."""
    if scope.joins is None:
        scope.joins = {}
    join = port.join
    assert join is not None
    scope.joins.setdefault(join, [0] * join.need)[port.need] += 1
    engine.inclusive[scope] = None


def decide_inclusive(engine: Engine) -> bool:
    """Let the inclusive joins through that wait for no other token (standard 13.4.3). Whether there was one."""
    moved = False
    for scope in tuple(engine.inclusive):
        joins = [join for join in scope.joins or () if join.masks]
        if not joins:
            del engine.inclusive[scope]
        elif not scope.state:
            for join in joins:
                if inclusive_ready(scope, join):
                    counts = (scope.joins or {}).pop(join)
                    arrived = [slot for slot, count in enumerate(counts) if count]
                    left = [max(0, count - 1) for count in counts]
                    if any(left):
                        assert scope.joins is not None
                        scope.joins[join] = left
                    scope.tokens -= len(arrived) - 1
                    engine.ready.append((join, scope))
                    moved = True
                    break
    return moved


def inclusive_ready(scope: Scope, join: Node) -> bool:
    """No token elsewhere in the scope reaches an empty flow of the join, but such as reach a filled one too."""
    counts = (scope.joins or {})[join]
    filled = sum(1 << slot for slot, count in enumerate(counts) if count)
    tokens = [child.node.id for child in scope.children if child.node is not None and holds_token(child)]
    tokens += [node.id for node in scope.held]
    tokens += [other.id for other in scope.joins or () if other is not join]
    return all(not (reach := join.masks.get(id, 0)) & ~filled or reach & filled for id in tokens)


def holds_token(child: Scope | Rest) -> bool:
    """Whether it stands for a token of its scope that can go on in it."""
    if isinstance(child, Rest):
        return child.token
    return child.node is not None and child.node.kind != "handler"


def choose(engine: Engine, scope: Scope, node: Node) -> None:
    """An event-based gateway or multiple event: the first stimulus wins; of queued messages the oldest arrival."""
    mail = scope.mail or {}
    kept = [mail[item] for item in node.alternatives if item in mail and mail[item].messages]
    rest = engine.rest(node, scope)
    if not rest.alive:
        return
    if kept:
        oldest = min(kept, key=lambda box: box.messages[0][0])
        alternative = Rest(engine.new_key(), oldest.node, scope, False, rest)
        engine.wake(alternative, oldest.messages.popleft()[1])
        return
    for item in node.alternatives:
        if rest.alive:
            engine.guard(item, scope, rest)


def fire_alternative(engine: Engine, rest: Rest, message: Any) -> None:
    """One of the alternatives has come."""
    gateway = rest.owner
    assert isinstance(gateway, Rest)
    engine.withdraw(gateway)
    if gateway.node is not rest.node.guard:  # the gateway is an element of its own; a multiple event is not
        engine.count(rest.scope, gateway.node)
    engine.complete(rest.scope, rest.node)


# ---- scopes --------------------------------------------------------------------------------------


def enter(engine: Engine, scope: Scope, node: Node) -> None:
    """A sub-process or call activity."""
    from fame.engine.interpreter import DEPTH

    if scope.depth >= DEPTH:
        engine.fail(scope, node, RecursionError(f"calls deeper than {DEPTH}"))
        return
    variables = scope.variables
    if node.own:
        try:
            inner = {name: source(variables) for name, source in node.inputs}
        except Exception as error:
            engine.fail(scope, node, error)
            return
        inner = {name: value for name, value in inner.items() if value is not UNDEFINED}
        if node.shares:
            variables = Variables(variables, inner)
        else:
            outer, variables = variables, engine.new_variables()
            variables.update({**plain(outer), **inner} if node.all_in else inner)
    assert node.body is not None
    child = engine.child(scope, node, node.body, variables)
    for boundary in node.armed:
        engine.guard(boundary, scope, child)
        if child.state < 0:
            return
    engine.ready.append((node.body.opening, child))


def leave(engine: Engine, scope: Scope, node: Node, inner: Scope) -> None:
    """A sub-process or called process has ended: its results go out, and the token goes on."""
    if node.outputs or node.all_out:
        try:
            results = [(name, source(inner.variables)) for name, source in node.outputs]
            for name, value in (*(plain(inner.variables).items() if node.all_out else ()), *results):
                if value is not UNDEFINED:
                    scope.variables[name] = value
        except Exception as error:
            engine.fail(scope, node, error)
            return
        if engine.conditions:
            engine.check_conditions()
            if scope.state < 0:
                return
    engine.complete(scope, node)


def end(engine: Engine, scope: Scope, node: Node) -> None:
    """A token ends; with the last one, the scope."""
    scope.tokens -= 1
    if not scope.tokens:
        engine.finish(scope)


def terminate(engine: Engine, scope: Scope, node: Node) -> None:
    """Ends the innermost body; of a handler that suspends its scope, that scope with it."""
    if scope.parent is not None and scope.parent.suspender is scope:
        scope = scope.parent
    if scope.parent is None:
        engine.host.make_safe("terminated")
    engine.proceed(FINISH, engine.replace(scope, scope.handles))


def finish(engine: Engine, scope: Scope, node: Node) -> None:
    """What a terminate goes on with when all that it cancelled is out."""
    engine.finish(scope)


def conclude_failed(engine: Engine, scope: Scope, node: Node) -> None:
    """What an uncaught error goes on with."""
    engine.close_scope(scope)
    engine.conclude(scope.instance, "failed")


FINISH = Node("", "(finish)", finish)
FAILED = Node("", "(failed)", conclude_failed)


# ---- boundary events and event sub-processes ------------------------------------------------------------------


def fire_boundary(engine: Engine, rest: Rest, message: Any) -> None:
    """A boundary event: it cancels its activity, or runs beside it."""
    scope, node, owner = rest.scope, rest.node, rest.owner
    assert owner is not None
    engine.count(scope, node)
    if node.interrupting:
        if isinstance(owner, Scope):
            engine.kill(owner)
        else:
            owner.scope.children.pop(owner, None)
            engine.cancel_rest(owner)
    else:
        scope.tokens += 1
    assert node.next is not None
    engine.proceed(node.next, scope)


def fire_handler(engine: Engine, rest: Rest, message: Any) -> None:
    """The start of an event sub-process was triggered."""
    begin_handler(engine, rest.scope, rest.node, None)


def begin_handler(engine: Engine, scope: Scope, start: Node, code: str | None) -> None:
    """Run an event sub-process: in place of its scope, while that is suspended, or beside it."""
    handler = start.guard
    if start.resume:
        inner = alongside(engine, scope, handler)
        scope.suspender = inner
        engine.suspend(scope)
    elif start.interrupting:
        inner = engine.replace(scope, handler)
    else:
        inner = alongside(engine, scope, handler)
    if code is not None:
        engine.note_error(start, inner, code, "")
    open_handler(engine, inner, start)


def alongside(engine: Engine, scope: Scope, handler: Node) -> Scope:
    """A handler's scope inside the scope that it handles, with a token of its own there."""
    scope.tokens += 1
    return engine.child(scope, handler, None, scope.variables)


def open_handler(engine: Engine, scope: Scope, start: Node) -> None:
    """The handler starts when all that was cancelled for it is out."""
    handler = start.guard
    if handler.act is not None:
        engine.tell(scope.instance.key, scope.key, handler.id, "enter")
        engine.tell(scope.instance.key, scope.key, start.id, "enter")
        engine.tell(scope.instance.key, scope.key, start.id, "leave")
    scope.body = handler.body
    engine.open_scope(scope)
    scope.counts[start.slot] += 1
    assert start.next is not None
    engine.proceed(start.next, scope)
