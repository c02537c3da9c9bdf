"""Gateways: where tokens part and meet (standard 13.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.engine import activities, scopes, waiting
from fame.engine.host import BpmnError
from fame.engine.state import Node, Rest, Scope
from fame.engine.variables import Variables

if TYPE_CHECKING:
    from fame.engine.interpreter import Engine

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
    variables = scope.variables
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
    for scope in tuple(engine.inclusive):
        joins = [join for join in scope.joins or () if join.masks]
        if not joins:
            del engine.inclusive[scope]
        elif not scope.state:
            for join in joins:
                if may_pass(engine, scope, join):
                    pass_through(engine, scope, join)
                    break
    return bool(engine.ready)


def may_pass(engine: Engine, scope: Scope, join: Node) -> bool:
    """No token elsewhere in the scope reaches an empty flow of the join, but such as reach a filled one too."""
    counts = (scope.joins or {})[join]
    filled = sum(1 << slot for slot, count in enumerate(counts) if count)
    tokens = [child.node.id for child in scope.children if child.node is not None and holds_token(child)]
    tokens += [engine.leaving[key].node.id for key in scope.leaving]
    tokens += [other.id for other, held in (scope.joins or {}).items() if other is not join and any(held[: other.need])]
    return all(not (reach := join.masks.get(id, 0)) & ~filled or reach & filled for id in tokens)


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

    It passes when its activation condition is true, of ``activationCount``: how many flows have a token. Then one token
    of each other flow is swallowed, and it waits anew. Numbers: tokens per flow, then whether one is to be swallowed.
    """
    joins = scope.joins
    if joins is None:
        joins = scope.joins = {}
    join = port.join
    assert join is not None
    need = join.need
    counts = joins.setdefault(join, [0] * (2 * need))
    counts[port.need] += 1
    if any(counts[need:]):
        swallow(engine, scope, join, counts)
        return None
    filled = [slot for slot in range(need) if counts[slot]]
    try:
        passes = join.run(Variables(scope.variables, {"activationCount": len(filled)}))
    except BaseException as error:
        return activities.failed(engine, scope, port, error)
    if not passes:
        return None
    for slot in range(need):
        counts[slot if slot in filled else need + slot] += -1 if slot in filled else 1
    scope.tokens -= len(filled) - 1
    if not any(counts):
        del joins[join]
    return join


def swallow(engine: Engine, scope: Scope, join: Node, counts: list[int]) -> None:
    """Tokens of flows that came too late for their activation end here."""
    late = [slot for slot in range(join.need) if counts[slot] and counts[join.need + slot]]
    for slot in late:
        counts[slot] -= 1
        counts[join.need + slot] -= 1
    if not any(counts):
        assert scope.joins is not None
        del scope.joins[join]
    for _ in late:
        scopes.end_token(engine, scope)


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
    event.arms.remove(rest)
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
        engine.tell(rest.scope.instance.key, rest.scope.key, rest.node.via, "take")
        engine.tell(rest.scope.instance.key, rest.scope.key, rest.node.id, "enter")
    scopes.complete(engine, rest.scope, rest.node)
