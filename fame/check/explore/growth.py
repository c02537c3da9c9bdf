"""Unbounded growth: states with so many instances or tokens that they are not explored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from fame.engine import Engine
from fame.engine.program import LoopInstance
from fame.engine.state import Scope

MOST_INSTANCES = 4
"""Instances of a process at a time beyond which it counts as growing without bound."""
MOST_AT_ONE_PLACE = 3
"""Tokens and handlers at one element of one scope beyond which they count as growing without bound."""


def growth(engine: Engine, scopes: Iterable[Scope]) -> tuple[str, str] | None:
    """Return what grows without bound in the state that an engine is in: ``instances`` of a
    process, ``tokens`` at an element.

    None if nothing does.
    """
    if len(engine.instances) > MOST_INSTANCES and engine.program.instances is None:
        return "instances", engine.program.process
    for scope in scopes:
        if len(scope.children) > MOST_AT_ONE_PLACE and (crowded := _crowded(scope)):
            return "tokens", crowded
    return None


def _crowded(scope: Scope) -> str:
    """The element of a scope at which too many tokens and handlers are, or empty; instances of loops may be many."""
    nodes = [child.node for child in scope.children if child.node is not None]
    if len(set(nodes)) > len(nodes) - MOST_AT_ONE_PLACE:
        return ""
    places = Counter(node for node in nodes if not isinstance(node.spec, LoopInstance))
    return next((node.id for node, count in places.items() if count > MOST_AT_ONE_PLACE), "")
