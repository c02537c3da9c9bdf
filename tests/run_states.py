"""States of a run from the key of a block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.view.state import RunState, ScopeInfo, TokenKey


def run_state(key: Mapping[str, Any]) -> RunState:
    """The state that a key tells, but for the files of scopes. What is left out is empty."""
    state = RunState()
    for *place, number, since in key.get("tokens", ()):
        state.tokens[TokenKey(*place)] = [number, since]
    for robot, element, *counts in key.get("counts", ()):
        state.counts[robot, element] = list(counts)
    for robot, scope, instance, parent, opener, depth in key.get("scopes", ()):
        state.scopes[robot, scope] = ScopeInfo(instance, 0, parent, opener, depth)
    state.variables = {(robot, scope): dict(values) for robot, scope, values in key.get("variables", ())}
    state.waits = {robot: {token["key"]: token for token in tokens} for robot, tokens in key.get("waits", ())}
    state.ends = {robot: tuple(ends) for robot, *ends in key.get("ends", ())}
    return state
