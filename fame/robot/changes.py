"""Changes in one robot: scopes that open and end, events, variables, and what its tokens wait for.

A `ChangeTracker` is told what happens in one engine. At the end of the instant (`flush`) it compares variables and
waiting tokens with what it knew, and passes on the messages of what is different (docs/recording_format.md). What a
scope is, is said once, when it opens.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from itertools import compress
from operator import is_not
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.engine.data import is_data
from fame.engine.program import Body, Handler, Mark, Node
from fame.engine.state import Instance, Scope, Trail, Wait, scopes_of
from fame.robot.plain_values import content_of, encoded, is_changeable, plain
from fame.robot.robot_state import EVENTS, VARIABLES, WAITING, RobotState, ScopeState
from fame.robot.wait_sentences import sentence

if TYPE_CHECKING:
    from fame.robot.events import Event
    from fame.robot.node import RobotNode

PutChange = Callable[[int, str, Mapping[str, Any]], object]
"""Takes a time (ns), the topic of a channel, and the content of a message."""

_MANY = 1000
"""Groups of marks that are kept while the tracker is not active."""
_NO_SCRIPT = (0, None, None)
"""The state of a wait that is neither suspended nor for a script."""
_JOIN = {"kind": "join", "text": sentence("join")}


class ChangeTracker:
    """Finds the changes in the engine of `node`. `put` gets every message; `files` are the paths of its models.

    While it is not `active`, it passes on events and ends of scopes alone, to be counted; the next `flush` after that
    passes on all.
    """

    active: bool = True

    def __init__(self, node: RobotNode, put: PutChange, files: Sequence[str]) -> None:
        self.robot: str = node.name
        self._node, self._waiting, self._put = node, node.waiting, put
        self._files = {file: number for number, file in reversed([*enumerate(files)])}
        self._home: dict[Body, int] = {}  # the number of the file that a body is of
        self._groups: list[tuple[int, int, Sequence[Mark]]] = []  # instance, scope, and what happened there
        self._open: dict[int, Scope] = {}  # scopes that are open, as far as it was said
        self._opens: list[dict[str, Any]] = []  # what is still to be said
        self._scopes: dict[int, _ScopeVariables] = {}  # by the key of the scope that owns them
        self._tokens: dict[Hashable, tuple[object, int]] = {}  # waiting tokens: what is compared, since when (ns)
        self._graph_due = 0  # when to look again who publishes (ns)
        self._waits: dict[Node, Mapping[str, Any]] = {}  # what is the same for every token there

    def begin(self) -> RobotState:
        """Return the state before the first change: of an engine that was restored, what it is in the middle of."""
        state, now = RobotState(process=self._node.mission.process.id), self._node.scheduler.now
        for instance in self._node.engine.instances.values():
            state.instances[instance.key] = instance.process, instance.status
            for scope in scopes_of(instance.root):
                self._announce(scope)
                state.scopes[scope.key] = self._describe(scope)
                for where, element in entered(scope):
                    held = state.active.setdefault((where, element), [0, now])
                    held[0] += 1
                    counts = state.counts.setdefault(state.file_of(where), {}).setdefault(element, {"enter": 0})
                    counts["enter"] += 1
        self._opens.clear()
        return state

    # ---- what happens ------------------------------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """Take an event, which need not be a step of a token."""
        self._groups.append((event.instance, event.scope, (event[4:],)))

    def trail(self, trail: Trail) -> None:
        """Take what tokens did, from the engine."""
        known = self._open
        for scope, marks in trail:
            if scope.key not in known:
                self._announce(scope)
            self._groups.append((scope.instance.key, scope.key, marks))
        if not self.active and len(self._groups) > _MANY:
            self.give_events(0)

    def give_events(self, time: int) -> None:
        """Pass on the events until `time` (ns) alone."""
        groups, self._groups = self._groups, []
        opens, self._opens = self._opens, []
        if groups or opens:
            events = [
                {"instance": instance, "scope": scope, "marks": [_mark(mark) for mark in marks]}
                for instance, scope, marks in groups
            ]
            self._put(time, EVENTS, {"robot": self.robot, **({"opens": opens} if opens else {}), "events": events})
        if not self.active and (ends := self._ended()):
            self._put(time, VARIABLES, {"robot": self.robot, "changes": [{"scope": key, "gone": True} for key in ends]})
            self._scopes = {key: variables for key, variables in self._scopes.items() if key not in ends}

    def _announce(self, scope: Scope) -> None:
        """Note what a scope is, after those around it."""
        chain, around = [scope], scope.parent
        while around is not None and around.key not in self._open:
            chain.append(around)
            around = around.parent
        for each in reversed(chain):
            self._open[each.key] = each
            self._opens.append(self._describe(each).to_json(each.key))

    def _describe(self, scope: Scope) -> ScopeState:
        parent, node = scope.parent, scope.node
        inside = [node.id] if node is not None and node.body is not None and node.body.entries else []
        inside += [handler.id for handler in scope.handles[-1:]]
        return ScopeState(scope.instance.key, parent.key if parent is not None else 0, tuple(inside), self._file(scope))

    def _file(self, scope: Scope) -> int:
        """The number of the file that the elements in a scope are of."""
        body = scope.body
        if body is None or not body.entries:  # of one element, which is repeated or has variables of its own
            return self._files.get(scope.node.file, 0) if scope.node is not None else 0
        if body not in self._home:
            self._home[body] = self._files.get(next(iter(body.entries.values())).file, 0)
        return self._home[body]

    def _ended(self) -> list[int]:
        """Forget the scopes that have ended, and return their numbers."""
        ended = [key for key, scope in self._open.items() if not scope.alive]
        for key in ended:
            del self._open[key]
        return ended

    # ---- what is different -------------------------------------------------------------------------------------------

    def flush(self, time: int) -> None:
        """Pass on all changes until `time` (ns), the end of an instant."""
        if time >= self._graph_due:
            self._graph_due = time + SECOND
            if self._waiting.refresh_publishers():
                self._waits.clear()
                self._tokens = {key: (None, since) for key, (_, since) in self._tokens.items()}
        owners, waits, joins = _look(self._node.engine.instances.values())
        changes = self._compare_variables(owners)
        tokens, gone = self._compare_tokens(time, waits, joins)
        self.give_events(time)
        if changes:
            self._put(time, VARIABLES, {"robot": self.robot, "changes": changes})
        if tokens or gone:
            self._put(time, WAITING, {"robot": self.robot, "tokens": tokens, "gone": gone})

    def _compare_variables(self, owners: Sequence[Scope]) -> list[Mapping[str, Any]]:
        """What changed in scopes with variables of their own, and which scopes have ended."""
        known, changes = self._scopes, list[Mapping[str, Any]]()
        for scope in owners:
            variables = known.get(scope.key)
            if variables is None:
                variables = known[scope.key] = _ScopeVariables(scope)
                if scope.key not in self._open:
                    self._announce(scope)
            change = variables.change()
            if change:
                changes.append({"scope": scope.key, **change})
        for key in self._ended():
            own = known.pop(key, None)
            changes.append({"scope": key, **(own.change() if own is not None else {}), "gone": True})
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
        if scope.key not in self._open:
            self._announce(scope)
        where = {"instance": scope.instance.key, "scope": scope.key}
        return {"key": key, **where, "element": node.id, "since": since, **details}

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


def _mark(mark: Mark) -> Sequence[Any]:
    return mark[:2] if mark[2] is None else (*mark[:2], plain(mark[2]))


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


def entered(scope: Scope) -> Iterable[tuple[int, str]]:
    """Where tokens have entered an element and not left it, as observers saw it: those in a scope, and its own."""
    for wait in scope.children:
        if isinstance(wait, Wait) and wait.token and wait.node.plain_step is not None:
            yield scope.key, wait.node.id
    for handler in scope.handles:
        yield scope.key, handler.id
    node = scope.node
    if node is not None and node.plain_step is not None and scope.parent is not None:
        yield (scope.key if isinstance(node.spec, Handler) else scope.parent.key), node.id
