"""Changes in one robot: events, variables, and what its tokens wait for.

A `ChangeTracker` is told what happens in one engine. At the end of the instant (`flush`) it compares variables and
waiting tokens with what it knew, and passes on the messages of what is different (docs/recording_format.md).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import compress
from operator import is_not
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.engine.data import is_data
from fame.engine.program import Mark, Node
from fame.engine.state import Instance, Scope, Trail, Wait
from fame.robot.plain_values import content_of, encoded, is_changeable, plain
from fame.robot.robot_state import EVENTS, VARIABLES, WAITING

if TYPE_CHECKING:
    from fame.robot.events import Event
    from fame.robot.node import RobotNode

PutChange = Callable[[int, str, Mapping[str, Any]], object]
"""Takes a time (ns), the topic of a channel, and the content of a message."""

_MANY = 1000
"""Groups of marks that are kept while the tracker is not active, and places of scopes."""
_NO_SCRIPT = (0, None, None)
"""The state of a wait that is neither suspended nor for a script."""
_JOIN = {"kind": "join", "text": "tokens on its other flows"}


class ChangeTracker:
    """Finds the changes in the engine of `node`. `put` gets every message.

    While it is not `active`, it passes on events alone, to be counted; the next `flush` after that passes on all.
    """

    active: bool = True

    def __init__(self, node: RobotNode, put: PutChange) -> None:
        self.robot: str = node.name
        self._node, self._waiting, self._put = node, node.waiting, put
        self._groups: list[tuple[Mapping[str, Any], Sequence[Mark]]] = []  # a place, and what happened there
        self._place = lru_cache(_MANY)(_place)
        self._where = lru_cache(_MANY)(_where)
        self._scopes: dict[int, _ScopeVariables] = {}  # by the key of the scope that owns them
        self._tokens: dict[Hashable, tuple[object, int]] = {}  # waiting tokens: what is compared, since when (ns)
        self._graph_due = 0  # when to look again who publishes (ns)
        self._waits: dict[Node, Mapping[str, Any]] = {}  # what is the same for every token there

    # ---- what happens ------------------------------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """Take an event, which need not be a step of a token."""
        self._groups.append(({"instance": event.instance, "scope": event.scope}, (event[4:],)))

    def trail(self, trail: Trail) -> None:
        """Take what tokens did, from the engine."""
        place = self._place
        self._groups += [(place(scope), marks) for scope, marks in trail]
        if not self.active and len(self._groups) > _MANY:
            self.give_events(0)

    def give_events(self, time: int) -> None:
        """Pass on the events until `time` (ns) alone."""
        groups, self._groups = self._groups, []
        if groups:
            events = [
                {**place, "marks": [mark[:2] if mark[2] is None else (*mark[:2], plain(mark[2])) for mark in marks]}
                for place, marks in groups
            ]
            self._put(time, EVENTS, {"robot": self.robot, "events": events})

    # ---- what is different -------------------------------------------------------------------------------------------

    def flush(self, time: int) -> None:
        """Pass on all changes until `time` (ns), the end of an instant."""
        self.give_events(time)
        if time >= self._graph_due:
            self._graph_due = time + SECOND
            if self._waiting.refresh_publishers():
                self._waits.clear()
                self._tokens = {key: (None, since) for key, (_, since) in self._tokens.items()}
        owners, waits, joins = _look(self._node.engine.instances.values())
        changes = self._compare_variables(owners)
        if changes:
            self._put(time, VARIABLES, {"robot": self.robot, "changes": changes})
        tokens, gone = self._compare_tokens(time, waits, joins)
        if tokens or gone:
            self._put(time, WAITING, {"robot": self.robot, "tokens": tokens, "gone": gone})

    def _compare_variables(self, owners: Sequence[Scope]) -> list[Mapping[str, Any]]:
        """What changed in scopes with variables of their own, and which of them are gone."""
        known, changes = self._scopes, list[Mapping[str, Any]]()
        for scope in owners:
            variables = known.get(scope.key)
            if variables is None:
                variables = known[scope.key] = _ScopeVariables(scope)
            change = variables.change()
            if change:
                changes.append({**variables.where, **change})
        if len(known) > len(owners):
            there = {scope.key for scope in owners}
            ended = [known.pop(key) for key in [*known] if key not in there]
            changes += [{**variables.where, **variables.change(), "gone": True} for variables in ended]
        return changes

    def _compare_tokens(
        self, time: int, waits: Sequence[Wait], joins: Sequence[tuple[Scope, Node]]
    ) -> tuple[list[Mapping[str, Any]], list[str]]:
        """The tokens that are new or wait for something else, and the keys of those that are gone."""
        before, now, fresh = self._tokens, dict[Hashable, tuple[object, int]](), list[Mapping[str, Any]]()
        waiting = self._waiting
        for wait in waits:
            failed = wait in self._node.engine.incidents
            mismatched = bool(waiting.uncorrelated) and waiting.mismatch(wait.key) is not None
            is_simple = not (failed or wait.started or wait.paused or mismatched)
            state, known = _NO_SCRIPT if is_simple else waiting.state(wait), before.get(wait.key)
            if known is None or known[0] != state:
                known = state, known[1] if known is not None else waiting.since(wait, time)
                details = (self._waits.get(wait.node) if is_simple else None) or self._details(wait, state)
                token = self._token(str(wait.key), wait.scope, wait.node, known[1], details)
                if (miss := waiting.last_miss(wait) if waiting.missed or waiting.uncorrelated else None) is not None:
                    token["missed"] = {"time": miss[0], "why": miss[1]}
                fresh.append(token)
            now[wait.key] = known
        for scope, join in joins:
            key = f"{scope.key}@{join.id}"
            known = before.get(key)
            if known is None or known[0] is None:
                known = _NO_SCRIPT, known[1] if known is not None else time
                fresh.append(self._token(key, scope, join, known[1], _JOIN))
            now[key] = known
        self._tokens = now
        return fresh, [str(key) for key in before if key not in now]

    def _token(self, key: str, scope: Scope, node: Node, since: int, details: Mapping[str, Any]) -> dict[str, Any]:
        return {"key": key, **self._where(scope), "element": node.id, "since": since, **details}

    def _details(self, wait: Wait, state: object) -> Mapping[str, Any]:
        """What a token waits for."""
        details = self._waiting.details(wait)
        if (incident := self._node.engine.incidents.get(wait)) is not None:
            return {**details, "error": incident[1]}
        if state == _NO_SCRIPT:
            self._waits[wait.node] = details
        return details


class _ScopeVariables:
    """The variables of a scope as they were at the last look."""

    def __init__(self, scope: Scope) -> None:
        self.where: Mapping[str, Any] = {**_place(scope), "path": list(path_of(scope))}
        self._variables = scope.variables
        self._values: dict[str, Any] = {}
        self._contents: dict[str, object] = {}  # of values that may change in place; None where nobody can tell
        self._shown: dict[str, object] = {}  # the keys of those that are data

    def change(self) -> dict[str, Any]:
        """Return the values that are new or changed, also in place, and the names of those that
        are gone; empty if none is."""
        before, shown, fresh = self._values, self._shown, dict[str, Any]()
        values = self._values = dict.copy(self._variables)
        gone: list[str] = []
        if list(values) != list(before):
            gone = [name for name in shown if name not in values]
            self._contents = {name: content for name, content in self._contents.items() if name in values}
            before = {name: before.get(name, _NOTHING) for name in values}
        changed = dict.fromkeys(compress(values, map(is_not, values.values(), before.values())))
        for name, content in self._contents.items():
            if content is None or content != content_of(values[name]):
                changed[name] = None
        for name in changed:
            value, known = values[name], shown.get(name)
            kind = value.__class__
            if kind is float and known.__class__ is float and value - value == 0.0:  # as most are
                if value != known:
                    shown[name] = fresh[name] = value
                continue
            self._contents.pop(name, None)
            if not is_data(name, value):
                gone += [name] * (name in shown)
                continue
            if is_changeable(value):
                self._contents[name] = content_of(value)
            plain, key = encoded(value)
            if known != key:
                shown[name], fresh[name] = key, plain
        for name in gone:
            del shown[name]
        return ({"set": fresh} if fresh else {}) | ({"unset": gone} if gone else {})


_NOTHING = object()
"""The value of a variable that was not there."""


def _where(scope: Scope) -> Mapping[str, Any]:
    """The place of a token in a scope: that of the scope, the activities around it, and the body it is in."""
    body: Scope | None = scope
    while body is not None and body.body is None:
        body = body.parent
    inside = body.body.id if body is not None and body.body is not None else ""
    return {**_place(scope), "path": list(path_of(scope)), "body": inside}


def _look(instances: Iterable[Instance]) -> tuple[list[Scope], list[Wait], list[tuple[Scope, Node]]]:
    """Scopes that own variables, waits that hold a token, joins that some flows have reached; outer before inner."""
    owners: list[Scope] = []
    waits: list[Wait] = []
    joins: list[tuple[Scope, Node]] = []
    for instance in instances:
        if instance.status != "running":
            continue
        stack = [instance.root]
        while stack:
            scope = stack.pop()
            if scope.parent is None or scope.parent.variables is not scope.variables:
                owners.append(scope)
            inner: list[Scope] = []
            for child in scope.children:
                if child.__class__ is Scope:
                    inner.append(child)
                elif child.token:  # type: ignore[union-attr]  # a wait
                    waits.append(child)  # type: ignore[arg-type]
            if scope.joins:
                joins += [(scope, join) for join, counts in scope.joins.items() if any(counts[: join.spec.need])]
            stack += reversed(inner)
    return owners, waits, joins


def _place(scope: Scope) -> dict[str, Any]:
    """The instance and the number of a scope, and the scopes whose variables it sees unless these are its own alone."""
    owners: list[int] = []
    around: Scope | None = scope
    while around is not None:
        if around.parent is None or around.parent.variables is not around.variables:
            owners.append(around.key)
        around = around.parent
    sees = {} if owners == [scope.key] else {"sees": owners}
    return {"instance": scope.instance.key, "scope": scope.key, **sees}


def path_of(scope: Scope) -> Iterator[str]:
    """Return the ids of the activities that a scope is inside, the outermost first."""
    ids: list[str] = []
    around: Scope | None = scope
    while around is not None:
        if around.node is not None and around.node.id and ids[-1:] != [around.node.id]:
            ids.append(around.node.id)
        around = around.parent
    return reversed(ids)
