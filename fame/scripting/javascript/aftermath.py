"""What becomes of callbacks whose script is over: they live as long as their scope, and an error of theirs fails it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fame.bpmn.model import Body, SubProcess
from fame.engine import Engine, faults, steps
from fame.engine.state import Node, Scope, scopes_of


def is_alive(engine: Engine, variables: dict[str, Any]) -> bool:
    """Whether they are the variables of a scope that still is."""
    return any(scope.variables is variables for scope in _scopes(engine))


def fail(engine: Engine, variables: dict[str, Any], element: str, error: BaseException) -> None:
    """The script of that element has failed after its token went on: the error climbs from its scope outwards.

    Boundary events of the element itself do not catch it, since there is no token at it. The caller runs the engine.
    """
    holder = next((body for body, ids in _bodies(engine) if element in ids), "")
    scopes = [scope for scope in _scopes(engine) if scope.variables is variables]
    inside = [scope for scope in scopes if scope.body is not None and scope.body.id == holder]
    if scopes:
        faults.fail(engine, (inside or scopes)[-1 if inside else 0], _no_token(engine, element), error)


def _scopes(engine: Engine) -> Iterator[Scope]:
    for instance in engine.instances.values():
        yield from scopes_of(instance.root)


def _bodies(engine: Engine) -> Iterator[tuple[str, set[str]]]:
    """Id of each process and sub-process, and the ids of the elements in it."""
    for process in engine.program.sources:
        body: Body = process.body
        yield process.id, {node.id for node in body.nodes}
        for node in body.walk():
            if isinstance(node, SubProcess):
                yield node.id, {inner.id for inner in node.body.nodes}


def _no_token(engine: Engine, element: str) -> Node:
    """A node that stands for the element, and has no boundary events."""
    real = next((node for node in engine.program.nodes if node.id == element), None)
    node = Node(element, element, steps.pass_on, line=real.line if real else 0, file=real.file if real else "")
    node.act = steps.pass_on if engine.program.observed else None
    return node
