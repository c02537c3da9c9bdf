"""Gateways: where tokens part and meet (standard 13.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.engine import activities, faults, scopes, waiting
from fame.engine.host import BpmnError
from fame.engine.state import Node, Rest, Scope
from fame.engine.variables import Variables

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

NAMES = ("activationCount", "waitingForStart")
"""The variables that the conditions of complex gateways see besides those of their scope."""

# ---- parting -------------------------------------------------------------------------------------


def exclusive(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The first flow whose condition is true, else the default flow, else an error."""
    variables = scope.variables
    try:
        for condition, target in node.out:
            if condition is None or condition(variables):
                return target  # type: ignore[no-any-return]
    except BaseException as error:
        return activities.failed(engine, scope, node, error)
    return node.default or activities.failed(engine, scope, node, no_flow())


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
    return take_all(engine, scope, node, scope.variables)


def take_all(engine: Engine, scope: Scope, node: Node, variables: dict[str, Any]) -> Node | None:
    """What takes every flow whose condition is true of some variables."""
    try:
        chosen = [target for condition, target in node.out if condition is None or condition(variables)]
    except BaseException as error:
        return activities.failed(engine, scope, node, error)
    if not chosen:
        return node.default or activities.failed(engine, scope, node, no_flow())
    scope.tokens += len(chosen) - 1
    for target in chosen[1:]:
        engine.ready.append((target, scope))
    return chosen[0]  # type: ignore[no-any-return]


def no_flow() -> BpmnError:
    """What a gateway without a way out throws."""
    return BpmnError("no_flow", "no condition is true and there is no default flow")


# ---- meeting -------------------------------------------------------------------------------------


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
    slot = port.need
    counts[slot] += 1
    if counts[slot] == 1:
        counts[need] -= 1
        if not counts[need]:
            counts.pop()
            if max(counts) == 1:
                del joins[join]
            else:
                left = [count - 1 for count in counts]
                joins[join] = [*left, left.count(0)]
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
    passed = False
    for scope in tuple(engine.inclusive):
        joins = [join for join, held in (scope.joins or {}).items() if waits(join, held)]
        if not joins:
            del engine.inclusive[scope]
        elif not scope.state:
            for join in joins:
                if may_pass(engine, scope, join):
                    (pass_through if join.run is None else reset)(engine, scope, join)
                    passed = True
                    break
    return passed


def waits(join: Node, held: list[int]) -> bool:
    """Whether it is an inclusive join, or a complex gateway before its reset."""
    return bool(join.masks) and (join.run is None or any(held[join.need :]))


def may_pass(engine: Engine, scope: Scope, join: Node) -> bool:
    """No token elsewhere in the scope reaches an empty flow of the join, but such as reach a filled one too."""
    counts = (scope.joins or {})[join]
    filled = 0
    for number, count in enumerate(counts):
        filled |= bool(count) << number % join.need
    tokens = [child.node for child in scope.children if child.node is not None and holds_token(child)]
    tokens += [engine.leaving[key].node for key in scope.leaving]
    if scope.body is not None and scope.body.adhoc is not None:  # tokens that wait for their turn
        tokens += [engine.program.by_key[key] for key in scope.items["todo"]]
    tokens += [other for other, held in (scope.joins or {}).items() if other is not join and any(held[: other.need])]
    return all(not (reached := reach(join, node)) & ~filled or reached & filled for node in tokens)


def reach(join: Node, node: Node) -> int:
    """The incoming flows of a join that a token at a node reaches; at a port of the join it is on one already."""
    return 1 << node.need if node.join is join else join.masks.get(node.id, 0)


def holds_token(child: Scope | Rest) -> bool:
    """Whether it stands for a token of its scope that can go on in it."""
    if isinstance(child, Rest):
        return child.token
    return child.node is not None and child.node.kind != "handler"


def pass_through(engine: Engine, scope: Scope, join: Node) -> None:
    """One token of each filled flow goes on as one."""
    joins = scope.joins
    assert joins is not None
    counts = joins.pop(join)
    left = [max(0, count - 1) for count in counts]
    if any(left):
        joins[join] = left
    scope.tokens -= sum(1 for count in counts if count) - 1
    engine.ready.append((join, scope))


def arrive_complex(engine: Engine, scope: Scope, port: Node) -> Node | None:
    """A token at one incoming flow of a complex gateway (standard 13.4.5).

    It passes when its activation condition is true, of ``activationCount``: how many flows have a token. One token of
    each of these is consumed. Then it waits for its reset: for a token of each other flow from which one can still
    come, as an inclusive join does. Numbers: tokens per flow, then whether one was consumed, 0 for all before that.
    """
    if scope.joins is None:
        scope.joins = {}
    join = port.join
    assert join is not None
    counts = scope.joins.setdefault(join, [0] * (2 * join.need))
    counts[port.need] += 1
    if any(counts[join.need :]):
        engine.inclusive[scope] = None
        return None
    return activate(engine, scope, join)


def activate(engine: Engine, scope: Scope, join: Node) -> Node | None:
    """The complex gateway itself, if its activation condition is true."""
    assert scope.joins is not None
    counts, need = scope.joins[join], join.need
    filled = [slot for slot in range(need) if counts[slot]]
    known = {"activationCount": len(filled), "waitingForStart": True}
    try:
        passes = bool(filled) and join.run(Variables(scope.variables, known))
    except BaseException as error:
        faults.fail(engine, scope, join, error)
        return None
    if not passes:
        return None
    for slot in filled:
        counts[slot] -= 1
        counts[need + slot] = 1
    scope.tokens -= len(filled) - 1
    if len(filled) == need:
        reset(engine, scope, join)
    else:
        engine.inclusive[scope] = None
    return join


def reset(engine: Engine, scope: Scope, join: Node) -> None:
    """What came late is swallowed, and the gateway waits anew; what is left may activate it at once.

    Flows whose condition names ``waitingForStart`` are asked again, now that it is false; the others are taken when the
    gateway is activated alone.
    """
    assert scope.joins is not None
    counts, need = scope.joins[join], join.need
    late = [slot for slot in range(need) if counts[slot] and not counts[need + slot]]
    for slot in late:
        counts[slot] -= 1
    counts[need:] = [0] * need
    if not any(counts):
        del scope.joins[join]
    variables = Variables(scope.variables, {"waitingForStart": False})
    try:
        chosen = [target for condition, target in join.resets if condition(variables)]
    except BaseException as error:
        faults.fail(engine, scope, join, error)
        return
    engine.ready.extend((target, scope) for target in chosen)
    scope.tokens += len(chosen) - len(late)
    if join in scope.joins and activate(engine, scope, join) is not None:
        engine.ready.append((join, scope))
    if not scope.tokens:
        scopes.finish(engine, scope)


def part(engine: Engine, scope: Scope, node: Node) -> Node | None:
    """The flows of a complex gateway with conditions that name ``waitingForStart``: one for each that is true."""
    return take_all(engine, scope, node, Variables(scope.variables, {"waitingForStart": True}))


# ---- event-based ---------------------------------------------------------------------------------


def choose(engine: Engine, scope: Scope, node: Node) -> None:
    """An event-based gateway or multiple event: the first stimulus wins; of queued messages the oldest arrival."""
    rest = waiting.rest(engine, node, scope)
    if not rest.alive:
        return
    mail = scope.mail or {}
    kept = [mail[item] for item in node.alternatives if item in mail and mail[item].messages]
    if kept:
        oldest = min(kept, key=lambda box: box.messages[0][0])
        alternative = Rest(engine.new_key(), oldest.node, scope, False, rest)
        waiting.catch(engine, alternative, oldest.messages.popleft()[1])
    else:
        waiting.guard(engine, node.alternatives, scope, rest)


def fire_part(engine: Engine, rest: Rest) -> None:
    """One of the triggers of a parallel multiple event has come; with the last of them, the event."""
    event = rest.owner
    assert isinstance(event, Rest)
    event.arms = tuple(other for other in event.arms if other is not rest)
    waiting.disarm(engine, rest)
    if not event.arms:
        waiting.fire(engine, event)
        if event.alive and not event.paused:  # it does not interrupt: it waits for all of them again
            waiting.arm(engine, event)


def fire_alternative(engine: Engine, rest: Rest) -> None:
    """One of the alternatives has come."""
    gateway = rest.owner
    assert isinstance(gateway, Rest)
    scopes.withdraw(engine, gateway)
    if gateway.node is rest.node.guard:  # a multiple event: the alternative is the event itself
        scopes.complete(engine, rest.scope, rest.node)
        return
    scopes.count(engine, rest.scope, gateway.node)
    if rest.node.act is not None:
        engine.tell(rest.scope, (rest.node.via, "take", None))
        engine.tell(rest.scope, rest.node.entered)
    scopes.complete(engine, rest.scope, rest.node)
