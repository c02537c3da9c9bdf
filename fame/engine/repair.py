"""Repair of a running process: incidents, and changes of tokens and variables by people.

An *incident* is a token at an element whose error nothing has caught. If the host wants incidents
(`EngineState.on_incident`), such an error does not fail its instance: the token waits until a person repairs it. A
boundary event, or the start of an event sub-process, that cannot be evaluated is one too, without a token.
`retry` executes the element again; `skip` goes on behind it; `move` moves a token to another element of its scope.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from fame.engine import scopes, waiting
from fame.engine.data import own_copy
from fame.engine.engine_state import EngineState
from fame.engine.program import Catch, Node, Trigger, nothing
from fame.engine.state import Instance, Scope, Wait, scopes_of
from fame.engine.steps import Branch
from fame.errors import MissionError


def _forget(engine: EngineState, wait: Wait) -> None:
    """Forget an incident that is over."""
    engine.incidents.pop(wait, None)


INCIDENT = Trigger("incident", arm=nothing, disarm=_forget, suspend=nothing, resume=nothing)
AT_INCIDENT = Catch(INCIDENT, nothing, lambda engine, wait, error: None)
"""The `Catch` of a token at an incident."""


def keep_failed(engine: EngineState, scope: Scope, node: Node, text: str, code: str) -> None:
    """Keep the token of an element that has failed."""
    wait = Wait(engine.new_key(), node, scope, True)
    wait.catch = AT_INCIDENT
    scope.children[wait] = None
    engine.incidents[wait] = (code, text)
    assert engine.on_incident is not None
    engine.on_incident(wait)


def keep_armed(engine: EngineState, wait: Wait, text: str, code: str) -> None:
    """Keep an armed event that holds no token and could not be evaluated, as an incident; nothing triggers it."""
    wait.alive, wait.box, wait.catch = True, None, AT_INCIDENT
    if wait.owner is wait.scope:  # the start of an event sub-process
        wait.scope.children[wait] = None
    engine.incidents[wait] = (code, text)
    assert engine.on_incident is not None
    engine.on_incident(wait)


def keep_script(engine: EngineState, wait: Wait, text: str, code: str) -> None:
    """Cancel the script of a wait, and keep its token."""
    scopes.cancel_script(engine, wait)
    waiting.withdraw(engine, wait)
    keep_failed(engine, wait.scope, wait.node, text, code)


def retry(engine: EngineState, element: str, values: Mapping[str, Any]) -> None:
    """Set variables, and execute (or arm) an element at which there is an incident again. Raises MissionError."""
    wait = next((wait for wait in engine.incidents if wait.node.id == element), None)
    if wait is None:
        there = ", ".join(wait.node.id for wait in engine.incidents) or "none"
        raise MissionError(f"has no incident; incidents are at: {there}", element=element)
    for name, value in values.items():
        wait.scope.variables[name] = value
    if wait.token:
        waiting.withdraw(engine, wait)
        engine.ready.append((wait.node, wait.scope))
    else:
        _arm_again(engine, wait)


def _arm_again(engine: EngineState, wait: Wait) -> None:
    """Arm an event that holds no token. While it is suspended only a timer is: others are armed at the end of that."""
    _forget(engine, wait)
    assert wait.node.catch is not None
    wait.catch = wait.node.catch
    if wait.catch.trigger is waiting.TIMER or not wait.paused:
        waiting.arm(engine, wait)


def set_variables(engine: EngineState, values: Mapping[str, Any], instance: int | None = None) -> None:
    """Set variables of the running instances, or of one. Raises MissionError if none runs."""
    instances = [each for each in engine.instances.values() if instance in (None, each.key)]
    if not instances:
        which = "no instance" if instance is None else f"no instance {instance}"
        raise MissionError(f"{which} is running, so there are no variables to set", element=engine.program.process)
    for each in instances:
        for name, value in values.items():
            each.root.variables[name] = own_copy(value)


def unset(engine: EngineState, names: Iterable[str]) -> list[str]:
    """Return those of some names that no instance has as a variable."""
    return [name for name in names if not any(name in each.root.variables for each in engine.instances.values())]


def move(engine: EngineState, source: str, target: str) -> None:
    """Cancel the work of a token at an element, and start another element of the scope. Raises MissionError."""
    token, scope = token_at(engine, source)
    entry = scope.body.entries.get(target) if scope.body is not None else None
    if entry is None:
        there = ", ".join(sorted(scope.body.entries)) if scope.body is not None else "none"
        raise MissionError(f"is not in the scope of {source}; elements there are: {there}", element=target)
    if isinstance(scope.items, dict) and scope.items.get("busy") == source:  # of a sequential ad-hoc sub-process
        scope.items["busy"] = ""
    _go_on(engine, token, scope, _arrival(scope, token, entry))


def _arrival(scope: Scope, token: Wait | Scope, entry: Node) -> Node:
    """Return where a token that is moved to an element arrives.

    At a join: by an incoming flow that it can reach, else by any; the first without a token.
    """
    spec, node = entry.spec, token.node
    if not isinstance(spec, Branch) or not spec.ports or node is None or node is entry:
        return entry
    if node in spec.ports:
        return node
    reached, counts = spec.reach().get(node.id, 0), (scope.joins or {}).get(entry, [0] * spec.need)
    return min(spec.ports, key=lambda port: (not reached >> port.spec.number & 1, bool(counts[port.spec.number])))


def skip(engine: EngineState, element: str) -> str:
    """Cancel the work of a token at an element, and go on behind it without results; by the default flow if it splits.

    Returns the id of what comes next. Raises MissionError if there is no token, or no default flow.
    """
    token, scope = token_at(engine, element)
    node = token.node
    assert node is not None
    split = node if isinstance(node.spec, Branch) else node.next
    branch = split.spec if split is not None and isinstance(split.spec, Branch) and split.id == element else None
    following = node.next if branch is None or not branch.ways else branch.default
    if following is None:
        raise MissionError("cannot be skipped: it has no default flow; move its token", element=element)
    _go_on(engine, token, scope, following)
    return following.id


def _go_on(engine: EngineState, token: Wait | Scope, scope: Scope, following: Node) -> None:
    """Cancel the work of a token, and continue it at another node."""
    scope.children.pop(token, None)
    cancelling = scopes.cancel_wait(engine, token) if isinstance(token, Wait) else scopes.kill(engine, token)
    scopes.proceed(engine, following, scope, cancelling)


def token_at(engine: EngineState, element: str) -> tuple[Wait | Scope, Scope]:
    """Return the first token at an element, one that waits or the scope of an activity, and the scope around it.

    Raises MissionError if no token is there.
    """
    for token in _tokens_at(engine, element):
        scope = _around(token)
        assert scope is not None
        return token, scope
    tokens = [token for instance in engine.instances.values() for token in _tokens(instance)]
    there = sorted({token.node.id for token in tokens if token.node is not None})
    raise MissionError(f"has no token; tokens are at: {', '.join(there) or 'none'}", element=element)


def _tokens(instance: Instance) -> list[Wait | Scope]:
    """Return the waits and scopes of an instance that hold a token of the scope around them."""
    inside = [child for scope in scopes_of(instance.root) for child in scope.children]
    return [child for child in inside if isinstance(child, Scope) or child.token]


def others_at(engine: EngineState, element: str) -> int:
    """Return the number of tokens at an element, without the first and those inside it."""
    first, *others = (*_tokens_at(engine, element), None)
    return sum(token is not None and not _is_inside(token, first) for token in others)


def _tokens_at(engine: EngineState, element: str) -> Iterator[Wait | Scope]:
    for instance in engine.instances.values():
        yield from (token for token in _tokens(instance) if token.node is not None and token.node.id == element)


def _around(token: Wait | Scope) -> Scope | None:
    return token.scope if isinstance(token, Wait) else token.parent


def _is_inside(token: Wait | Scope, other: Wait | Scope | None) -> bool:
    scope = _around(token)
    while scope is not None and scope is not other:
        scope = scope.parent
    return scope is not None
