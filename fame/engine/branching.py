"""Where tokens part: one flow of several, all of them, or those whose condition is true (standard 13.4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fame.engine import steps
from fame.engine.engine_state import EngineState
from fame.engine.host import BpmnError, Compiled
from fame.engine.program import Node
from fame.engine.state import Scope

Way = tuple[Compiled | None, Node]
"""A sequence flow: its condition (None: always), and where it leads."""


@dataclass(slots=True)
class Branch:
    """Spec of a gateway, or of the fork behind an element with several outgoing flows.

    ways        conditional flows; `targets`: flows without conditions
    default     where the default flow leads
    need        of a join: how many flows come in
    masks       of an inclusive or complex join: by element or flow, the incoming flows that a token there can reach
    activation  of a complex gateway: its activation condition
    resets      of a complex gateway: flows that are asked again at its reset
    """

    ways: tuple[Way, ...] = ()
    targets: tuple[Node, ...] = ()
    default: Node | None = None
    need: int = 0
    masks: dict[str, int] = field(default_factory=dict)
    activation: Compiled | None = None
    resets: tuple[Way, ...] = ()


def exclusive(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """The first flow whose condition is true, else the default flow, else an error."""
    variables = scope.variables
    spec: Branch = node.spec
    try:
        for condition, target in spec.ways:
            if condition is None or condition(variables):
                return target
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    return spec.default or steps.fail_step(engine, scope, node, _no_flow())


def fork(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """A token for each way out: of a parallel gateway, or of any element with several flows."""
    targets: tuple[Node, ...] = node.spec.targets
    scope.tokens += len(targets) - 1
    push = engine.ready.append
    for target in targets[1:]:
        push((target, scope))
    return targets[0]


def inclusive(engine: EngineState, scope: Scope, node: Node) -> Node | None:
    """A token for each flow whose condition is true, else the default flow, else an error."""
    return take_all(engine, scope, node, scope.variables)


def take_all(engine: EngineState, scope: Scope, node: Node, variables: dict[str, Any]) -> Node | None:
    """The same, with conditions over some variables."""
    spec: Branch = node.spec
    try:
        chosen = [target for condition, target in spec.ways if condition is None or condition(variables)]
    except BaseException as error:
        return steps.fail_step(engine, scope, node, error)
    if not chosen:
        return spec.default or steps.fail_step(engine, scope, node, _no_flow())
    scope.tokens += len(chosen) - 1
    for target in chosen[1:]:
        engine.ready.append((target, scope))
    return chosen[0]


def _no_flow() -> BpmnError:
    """What a gateway without a way out throws."""
    return BpmnError("no_flow", "no condition is true and there is no default flow")
