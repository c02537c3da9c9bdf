"""What changes in one robot: events, variables, and what its tokens wait for, as JSON for recordings and live views.

A `ChangeTracker` hears what happens in one engine. At the end of the instant (`flush`) it compares variables and
waiting tokens with what it knew, and gives away what is different; `key` gives everything that it knows, as of the last
`flush`. The JSON is described in docs/recordings.md.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fame.engine.program import Mark
from fame.engine.state import Instance, Scope, Trail, Wait, joins_reached, scopes_of
from fame.robot.plain_values import is_data, json_text, snapshot_of

if TYPE_CHECKING:
    from fame.robot.events import Event
    from fame.robot.node import RobotNode

Put = Callable[[str, int, str], object]
"""Takes a channel (``events``, ``variables``, ``waiting``), a time (ns) and JSON."""


_ENDED = 20
"""Ended instances that a robot's state keeps."""
COUNTED = frozenset(("enter", "leave", "take", "cancel", "fail"))
"""Marks that are counted by element."""
_KNOWN = 10_000
"""Marks whose JSON is kept."""


class ChangeTracker:
    """What changes in the engine of `node`. `put` gets every change as JSON."""

    def __init__(self, node: RobotNode, put: Put) -> None:
        self.robot: str = node.name
        self._node, self._put = node, put
        self._name = json_text(node.name)
        self._marks: dict[Mark, str] = {}  # as JSON
        self._events: list[str] = []
        self._counted: list[Mark] = []
        self._counts: dict[str, Counter[str]] = {}
        self._instances: dict[int, tuple[str, str]] = {}  # key -> process, status
        self._scopes: dict[int, _ScopeVariables] = {}  # by the key of the scope that owns them
        self._tokens: dict[Hashable, _Token] = {}

    # ---- what happens ------------------------------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """Something happened, perhaps not a step of a token."""
        self._add(event.instance, event.scope, [event[4:]])

    def trail(self, trail: Trail) -> None:
        """Tokens moved."""
        for scope, marks in trail:
            self._add(scope.instance.key, scope.key, marks)

    def _add(self, instance: int, scope: int, marks: Sequence[Mark]) -> None:
        known = self._marks
        try:
            text = ",".join([known[mark] for mark in marks])
        except (KeyError, TypeError):  # TypeError: a detail that is not hashable
            text = ",".join([self._mark(instance, mark) for mark in marks])
        self._events.append(f'{{"instance":{instance},"scope":{scope},"marks":[{text}]}}')
        self._counted += marks

    def _mark(self, instance: int, mark: Mark) -> str:
        element, what, detail = mark
        text = json_text([element, what] if detail is None else [element, what, detail])
        if what in COUNTED and len(self._marks) < _KNOWN:
            self._marks[mark] = text
        elif what == "start":
            self._instances[instance] = element, "running"
        elif what == "end":
            self._instances[instance] = element, str(detail)
            forget_ended(self._instances)
        return text

    # ---- what is different -------------------------------------------------------------------------------------------

    def flush(self, time: int) -> None:
        """Give away what has changed until `time` (ns), the end of an instant."""
        if self._events:
            self._put("events", time, f'{{"robot":{self._name},"events":[{",".join(self._events)}]}}')
            self._events.clear()
            self._count()
        running = list(self._node.engine.instances.values())
        self._flush_variables(time, running)
        self._flush_tokens(time, running)

    def _count(self) -> None:
        for mark in self._counted:
            if mark[1] in COUNTED:
                counts = self._counts.get(mark[0])
                if counts is None:
                    counts = self._counts[mark[0]] = Counter()
                counts[mark[1]] += 1
        self._counted.clear()

    def _flush_variables(self, time: int, running: Sequence[Instance]) -> None:
        changes, seen = [], set()
        for scope in (scope for instance in running for scope in scopes_of(instance.root)):
            if scope.parent is None or scope.parent.variables is not scope.variables:
                known = self._scopes.get(scope.key)
                if known is None:
                    known = self._scopes[scope.key] = _ScopeVariables(scope)
                seen.add(scope.key)
                change = known.change()
                if change:
                    changes.append(f"{known.where},{change}}}")
        changes += [f'{self._scopes.pop(key).where},"gone":true}}' for key in self._scopes.keys() - seen]
        if changes:
            self._put("variables", time, f'{{"robot":{self._name},"changes":[{",".join(changes)}]}}')

    def _flush_tokens(self, time: int, running: Sequence[Instance]) -> None:
        before, now, fresh = self._tokens, {}, []
        for key, scope, node, wait in _tokens(running):
            state = self._node.wait_state(wait) if wait is not None else None
            token = before.get(key)
            if token is None or token.state != state:
                details = {"kind": "join"} if wait is None else self._node.wait_details(wait)
                since = time if token is None else token.since
                token = _Token(state, since, _token_text(key, scope, node, since, details))
                fresh.append(token.text)
            now[key] = token
        gone = [json_text(_key_text(key)) for key in before if key not in now]
        self._tokens = now
        if fresh or gone:
            text = f'{{"robot":{self._name},"tokens":[{",".join(fresh)}],"gone":[{",".join(gone)}]}}'
            self._put("waiting", time, text)

    # ---- everything --------------------------------------------------------------------------------------------------

    def key(self) -> str:
        """Everything, as of the last `flush`."""
        instances = [
            {"instance": key, "process": process, "status": status}
            for key, (process, status) in self._instances.items()
        ]
        variables = ",".join(f"{known.where},{known.everything()}}}" for known in self._scopes.values())
        tokens = ",".join(token.text for token in self._tokens.values())
        return (
            f'{{"process":{json_text(self._node.mission.process.id)},"instances":{json_text(instances)},'
            f'"tokens":[{tokens}],"variables":[{variables}],"counts":{_encoded(self._counts)}}}'
        )


@dataclass(slots=True)
class _Token:
    """A token that waits: what is compared, since when (ns), and its JSON."""

    state: object
    since: int
    text: str


class _ScopeVariables:
    """The variables of a scope as they were at the last comparison."""

    def __init__(self, scope: Scope) -> None:
        self.where: str = (
            f'{{"instance":{scope.instance.key},"scope":{scope.key},"path":{json_text(list(path_of(scope)))}'
        )
        self._variables = scope.variables
        self._values: dict[str, Any] = {}
        self._texts: dict[str, str] = {}

    def change(self) -> str:
        """What is different now, as members of a JSON object; empty if nothing is."""
        variables = self._variables
        try:
            if dict.__eq__(variables, self._values):
                return ""
        except Exception:  # values that cannot be compared, as arrays
            pass
        fresh = {}
        for name, value in variables.items():
            if name in self._values and _is_same(value, self._values[name]):
                continue
            if is_data(name, value):
                text = json_text(value)
                if self._texts.get(name) != text:
                    fresh[name] = self._texts[name] = text
        gone = [name for name in self._texts if not dict.__contains__(variables, name)]
        for name in gone:
            del self._texts[name]
        self._values = {name: snapshot_of(value) for name, value in variables.items()}
        parts = [f'"set":{_object(fresh)}'] * bool(fresh) + [f'"unset":{json_text(gone)}'] * bool(gone)
        return ",".join(parts)

    def everything(self) -> str:
        """All of them, as a member of a JSON object."""
        return f'"set":{_object(self._texts)}'


def _is_same(value: Any, other: Any) -> bool:
    if value is other and value.__class__ not in (list, dict, set):
        return True
    try:
        return bool(value == other)
    except Exception:
        return False


def _object(members: Mapping[str, str]) -> str:
    return "{" + ",".join(f"{json_text(name)}:{text}" for name, text in members.items()) + "}"


def _tokens(running: Iterable[Instance]) -> Iterator[tuple[Hashable, Scope, str, Wait | None]]:
    """Every token that rests: its key, scope and element, and its wait unless it is at a join."""
    for instance in running:
        for wait in instance.waits():
            yield wait.key, wait.scope, wait.node.id, wait
        for scope, join, _ in joins_reached(instance.root):
            yield (scope.key, join.id), scope, join.id, None


def path_of(scope: Scope) -> Iterator[str]:
    """The ids of the activities that a scope is inside, the outermost first."""
    ids: list[str] = []
    around: Scope | None = scope
    while around is not None:
        if around.node is not None and around.node.id and ids[-1:] != [around.node.id]:
            ids.append(around.node.id)
        around = around.parent
    return reversed(ids)


def _token_text(key: Hashable, scope: Scope, element: str, since: int, details: Mapping[str, Any]) -> str:
    body: Scope | None = scope
    while body is not None and body.body is None:
        body = body.parent
    token = {
        "key": _key_text(key),
        "instance": scope.instance.key,
        "scope": scope.key,
        "path": list(path_of(scope)),
        "body": body.body.id if body is not None and body.body is not None else "",
        "element": element,
        "since": since,
        **details,
    }
    return json_text(token)


def _key_text(key: Hashable) -> str:
    return "@".join(map(str, key)) if isinstance(key, tuple) else str(key)


def forget_ended(instances: dict[int, tuple[str, str]]) -> None:
    """Forget the oldest of the instances that have ended, if there are many."""
    ended = [key for key, (_, status) in instances.items() if status != "running"]
    for key in ended[:-_ENDED]:
        del instances[key]


_encoded = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode
