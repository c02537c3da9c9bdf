"""Exclusive, parallel, inclusive and complex gateways (standard 13.4): their joins and how they are compiled.

Splits are steps that other elements share: see `fame.engine.steps`.
"""

from __future__ import annotations

from functools import partial

from fame.bpmn import model
from fame.dataclasses import dataclass
from fame.engine import faults, scopes, steps
from fame.engine.data import Variables
from fame.engine.engine_state import EngineState
from fame.engine.program import Handler, Node, StepFunction
from fame.engine.scope_compiler import ScopeCompiler, jumping_to
from fame.engine.state import Scope, Wait
from fame.engine.steps import Branch

NAMES = ("activationCount", "waitingForStart")
"""Extra variables in the conditions of complex gateways."""


@dataclass(slots=True)
class JoinPort:
    """Spec of one incoming flow of a join. `number`: its index; `need`: the number of incoming flows."""

    join: Node
    number: int
    need: int


# ---- parallel ------------------------------------------------------------------------------------


def arrive(engine: EngineState, scope: Scope, port: Node) -> Node | None:
    """Take a token at one incoming flow of a parallel join.

    The state of a join is the number of tokens of each flow, then the number of flows without a token.
    """
    joins = scope.joins
    if joins is None:
        joins = scope.joins = {}
    spec: JoinPort = port.spec
    join, need = spec.join, spec.need
    counts = joins.get(join)
    if counts is None:
        counts = joins[join] = [0] * need + [need]
    slot = spec.number
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


# ---- inclusive -----------------------------------------------------------------------------------


def arrive_inclusive(engine: EngineState, scope: Scope, port: Node) -> None:
    """Take a token at one incoming flow of an inclusive join, which is decided when no other token can move."""
    if scope.joins is None:
        scope.joins = {}
    spec: JoinPort = port.spec
    scope.joins.setdefault(spec.join, [0] * spec.need)[spec.number] += 1
    engine.inclusive[scope] = None


def decide_inclusive(engine: EngineState) -> bool:
    """Pass the inclusive joins that no other token can reach (standard 13.4.3). Returns whether there was one."""
    passed = False
    for scope in tuple(engine.inclusive):
        joins = [join for join, held in (scope.joins or {}).items() if _is_undecided(join, held)]
        if not joins:
            del engine.inclusive[scope]
        elif not scope.state:
            for join in joins:
                if _may_pass(engine, scope, join):
                    (_pass_through if join.spec.activation is None else _reset)(engine, scope, join)
                    passed = True
                    break
    return passed


def _is_undecided(join: Node, held: list[int]) -> bool:
    """Return whether it is an inclusive join, or a complex gateway before its reset."""
    spec: Branch = join.spec
    return bool(spec.masks) and (spec.activation is None or any(held[spec.need :]))


def _may_pass(engine: EngineState, scope: Scope, join: Node) -> bool:
    """Return whether every other token of the scope that reaches an empty flow of the join reaches a filled one."""
    counts = (scope.joins or {})[join]
    filled = 0
    for number, count in enumerate(counts):
        filled |= bool(count) << number % join.spec.need
    tokens: list[Node] = [child.node for child in scope.children if child.node is not None and _holds_token(child)]
    tokens += [engine.cancelling[key].node for key in scope.cancelling]
    if scope.body is not None and scope.body.adhoc is not None:  # tokens that wait for their turn
        tokens += [engine.program.by_key[key] for key in scope.items["todo"]]
    tokens += [
        other for other, held in (scope.joins or {}).items() if other is not join and any(held[: other.spec.need])
    ]
    return all(not (reached := _reach(join, node)) & ~filled or reached & filled for node in tokens)


def _reach(join: Node, node: Node) -> int:
    """Return the incoming flows of a join that a token at a node can reach, as a bit mask."""
    if isinstance(node.spec, JoinPort) and node.spec.join is join:
        return 1 << node.spec.number
    spec: Branch = join.spec
    return spec.masks.get(node.id, 0)


def _holds_token(child: Scope | Wait) -> bool:
    """Return whether a child represents a token that can continue in the scope around it."""
    if isinstance(child, Wait):
        return child.token
    return child.node is not None and not isinstance(child.node.spec, Handler)


def _pass_through(engine: EngineState, scope: Scope, join: Node) -> None:
    """Merge one token of each filled flow into one, which continues."""
    joins = scope.joins
    assert joins is not None
    counts = joins.pop(join)
    left = [max(0, count - 1) for count in counts]
    if any(left):
        joins[join] = left
    scope.tokens -= sum(1 for count in counts if count) - 1
    engine.ready.append((join, scope))


def masks(content: model.Body, join: model.Gateway) -> dict[str, int]:
    """Return for each element and flow of a body which incoming flows of a join a token there can reach (bit mask)."""
    before: dict[str, list[str]] = {}
    for flow in content.flows:
        before.setdefault(flow.target, []).append(flow.id)
        before[flow.id] = [flow.source]
    for node in content.nodes:
        if node.place == "boundary":
            before.setdefault(node.id, []).append(node.attached_to)
        elif node.place == "catch":
            before.setdefault(node.id, []).extend(jumping_to(content, node))
    branches: dict[str, int] = {"": 0}
    for number, flow_id in enumerate(join.incoming):
        pending, seen = [flow_id], {join.id}
        while pending:
            id = pending.pop()
            if id not in seen:
                seen.add(id)
                branches[id] = branches.get(id, 0) | 1 << number
                pending.extend(before.get(id, ()))
    return branches


# ---- complex -------------------------------------------------------------------------------------


def arrive_complex(engine: EngineState, scope: Scope, port: Node) -> Node | None:
    """Take a token at one incoming flow of a complex gateway (standard 13.4.5).

    It passes when its activation condition over ``activationCount``, the number of flows with a token, is true. One
    token of each of these flows is consumed. Then it waits for its reset: for a token of each other flow from which one
    can still come, as an inclusive join does. Its state is the number of tokens of each flow, then for each flow
    whether a token was consumed (0 for all before the activation).
    """
    if scope.joins is None:
        scope.joins = {}
    spec: JoinPort = port.spec
    counts = scope.joins.setdefault(spec.join, [0] * (2 * spec.need))
    counts[spec.number] += 1
    if any(counts[spec.need :]):
        engine.inclusive[scope] = None
        return None
    try:
        return _activate(engine, scope, spec.join)
    except BaseException as error:
        counts[spec.number] -= 1  # this token is not there yet: it can come again
        faults.fail(engine, scope, port, error)
        return None


def _activate(engine: EngineState, scope: Scope, join: Node) -> Node | None:
    """Activate a complex gateway if its activation condition is true. Returns its node if so. Raises what it raises."""
    assert scope.joins is not None
    spec: Branch = join.spec
    assert spec.activation is not None
    counts, need = scope.joins[join], spec.need
    filled = [slot for slot in range(need) if counts[slot]]
    known = {"activationCount": len(filled), "waitingForStart": True}
    if not (filled and spec.activation(Variables(scope.variables, known))):
        return None
    for slot in filled:
        counts[slot] -= 1
        counts[need + slot] = 1
    scope.tokens -= len(filled) - 1
    if len(filled) == need:
        _reset(engine, scope, join)
    else:
        engine.inclusive[scope] = None
    return join


def _reset(engine: EngineState, scope: Scope, join: Node) -> None:
    """Reset a complex gateway: drop late tokens and wait again. The remaining tokens can activate it at once.

    Conditions that name ``waitingForStart`` are evaluated again, now that it is false; other outgoing flows are taken
    only at activation.
    """
    assert scope.joins is not None
    spec: Branch = join.spec
    counts, need = scope.joins[join], spec.need
    late = [slot for slot in range(need) if counts[slot] and not counts[need + slot]]
    for slot in late:
        counts[slot] -= 1
    counts[need:] = [0] * need
    if not any(counts):
        del scope.joins[join]
    variables = Variables(scope.variables, {"waitingForStart": False})
    try:
        chosen = [target for condition, target in spec.resets if condition is not None and condition(variables)]
        engine.ready.extend((target, scope) for target in chosen)
        scope.tokens += len(chosen) - len(late)
        if join in scope.joins and _activate(engine, scope, join) is not None:
            engine.ready.append((join, scope))
    except BaseException as error:
        faults.fail(engine, scope, join, error, again=False)
        return
    if not scope.tokens:
        scopes.finish(engine, scope)


def part(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """Split at the activation of a complex gateway with conditions that name ``waitingForStart``."""
    return steps.take_all(engine, scope, node, Variables(scope.variables, {"waitingForStart": True}))


# ---- compiling -----------------------------------------------------------------------------------

_ARRIVALS: dict[str, StepFunction] = {
    "parallel": arrive,
    "inclusive": arrive_inclusive,
    "complex": arrive_complex,
}


def make(context: ScopeCompiler, gateway: model.Gateway) -> None:
    """Make a gateway; a join has a port for each incoming flow."""
    spec = Branch()
    node = context.counted(context.node(gateway, steps.pass_on, spec=spec))
    context.place(gateway, node)
    context.leads[gateway.id] = partial(_lead_on, context, gateway, node)
    joins = len(gateway.incoming) > 1 or (gateway.activation is not None and gateway.incoming)
    if gateway.kind in _ARRIVALS and joins:
        spec.need = len(gateway.incoming)
        if gateway.kind == "complex":
            if gateway.activation is None:
                context.refuse("a complex gateway that joins needs an activation condition", gateway)
            spec.activation = context.expression(gateway.activation, gateway)
        for number, flow in enumerate(gateway.incoming):
            port = JoinPort(node, number, spec.need)
            context.ports[flow] = context.node(gateway, _ARRIVALS[gateway.kind], f"/{number}", port)
            context.ports[flow].part_of = node
        spec.ports = tuple(context.ports[flow] for flow in gateway.incoming)
    spec.reach = partial(masks, context.content, gateway)
    if gateway.kind in ("inclusive", "complex"):
        spec.masks = spec.reach()


def _lead_on(context: ScopeCompiler, gateway: model.Gateway, node: Node, flows: list[model.SequenceFlow]) -> None:
    """Link a gateway to the targets of its outgoing flows."""
    spec: Branch = node.spec
    if not flows:
        node.next = context.node(gateway, steps.end, "/end")
    elif gateway.kind == "parallel":
        spec.targets, node.next = tuple(context.target(flow) for flow in flows), context.target(flows[0])
        node.step = steps.fork if len(flows) > 1 else steps.pass_on
    elif len(flows) == 1 and flows[0].condition is None:
        node.next = context.target(flows[0])
    else:
        node.step = steps.exclusive if gateway.kind == "exclusive" else steps.inclusive
        context.branch(spec, gateway, flows)
        if gateway.kind == "complex":
            asked = [flow for flow in flows if flow.id != gateway.default]
            spec.resets = tuple(way for way, flow in zip(spec.ways, asked, strict=True) if _asks_for_phase(flow))
            node.step = part if spec.resets else node.step
    context.watch(node)


def _asks_for_phase(flow: model.SequenceFlow) -> bool:
    """Return whether the condition of a flow behind a complex gateway distinguishes its activation from its reset."""
    return flow.condition is not None and "waitingForStart" in flow.condition.text
