"""What changes in one robot: events, variables, and what its tokens wait for, as JSON for recordings and live views.

A `ChangeTracker` hears what happens in one engine. At the end of the instant (`flush`) it compares variables and
waiting tokens with what it knew, and gives away what is different; `key` gives everything that it knows, as of the last
`flush`. The JSON is described in docs/recordings.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from operator import is_not
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.engine.program import Mark, Node
from fame.engine.state import Instance, Scope, Trail, Wait, joins_reached, scopes_of
from fame.robot.plain_values import encode, is_changeable, is_data, json_text, name_text, snapshot_of

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
"""Marks and scopes whose JSON is kept."""
_NO_SCRIPT = (0, None, None)
"""The state of a wait that is neither suspended nor for a script."""


class ChangeTracker:
    """What changes in the engine of `node`. `put` gets every change as JSON.

    While it is not `active`, it only counts; after that, the next `flush` gives everything.
    """

    active: bool = True

    def __init__(self, node: RobotNode, put: Put) -> None:
        self.robot: str = node.name
        self._node, self._put = node, put
        self._name = json_text(node.name)
        self._marks: dict[Mark, str] = {}  # as JSON
        self._events: list[str] = []
        self._fresh: list[Mark] = []  # since the last flush
        self._counted: list[Mark] = []  # before it, not yet in `_counts`
        self._counts: dict[str, dict[str, int]] = {}
        self._instances: dict[int, tuple[str, str]] = {}  # key -> process, status
        self._scopes: dict[int, _ScopeVariables] = {}  # by the key of the scope that owns them
        self._tokens: dict[Hashable, _Token] = {}
        self._graph_due = 0  # when to look again who publishes (ns)
        self._places: dict[int, str] = {}
        self._waits: dict[Node, str] = {}  # what is the same for every token there

    # ---- what happens ------------------------------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """Something happened, perhaps not a step of a token."""
        self._add(event.instance, event.scope, [event[4:]])

    def trail(self, trail: Trail) -> None:
        """Tokens moved."""
        for scope, marks in trail:
            self._add(scope.instance.key, scope.key, marks)

    def _add(self, instance: int, scope: int, marks: Sequence[Mark]) -> None:
        if not self.active:
            self._add_inactive(instance, marks)
            return
        known = self._marks
        try:
            text = ",".join([known[mark] for mark in marks])
        except (KeyError, TypeError):  # TypeError: a detail that is not hashable
            text = ",".join([self._mark(instance, mark) for mark in marks])
        self._events.append(f'{{"instance":{instance},"scope":{scope},"marks":[{text}]}}')
        self._fresh += marks

    def _add_inactive(self, instance: int, marks: Sequence[Mark]) -> None:
        self._counted += marks
        if len(self._counted) > _KNOWN:
            self._count()
        for mark in marks:
            if mark[1] in ("start", "end"):
                self._mark(instance, mark)

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
            self._counted += self._fresh
            self._fresh.clear()
        if time >= self._graph_due:
            self._graph_due = time + SECOND
            if self._node.refresh_publishers():
                self._waits.clear()
                self._tokens = {key: replace(token, state=None) for key, token in self._tokens.items()}
        running = list(self._node.engine.instances.values())
        self._flush_variables(time, running)
        self._flush_tokens(time, running)

    def _count(self) -> None:
        """Count what has happened since the last time."""
        for (element, what), number in Counter([mark[:2] for mark in self._counted]).items():
            if what in COUNTED:
                counts = self._counts.setdefault(element, {})
                counts[what] = counts.get(what, 0) + number
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
        for key, scope, element, wait in _tokens(running):
            state = self._node.wait_state(wait) if wait is not None else None
            token = before.get(key)
            if token is None or token.state != state:
                since = token.since if token is not None else self._node.waiting_since(wait, time) if wait else time
                where = f'{{"key":"{key}",{self._place(scope)},"element":{name_text(element)},"since":{since},'
                token = _Token(state, since, where + self._details(wait, state))
                fresh.append(token.text)
            now[key] = token
        gone = [f'"{key}"' for key in before if key not in now]
        self._tokens = now
        if fresh or gone:
            text = f'{{"robot":{self._name},"tokens":[{",".join(fresh)}],"gone":[{",".join(gone)}]}}'
            self._put("waiting", time, text)

    def _place(self, scope: Scope) -> str:
        """Where a scope is, as members of a JSON object."""
        text = self._places.get(scope.key)
        if text is None:
            body: Scope | None = scope
            while body is not None and body.body is None:
                body = body.parent
            if len(self._places) >= _KNOWN:
                self._places.clear()
            text = self._places[scope.key] = (
                f'"instance":{scope.instance.key},"scope":{scope.key},"path":{encode(list(path_of(scope)))},'
                f'"body":{name_text(body.body.id if body is not None and body.body is not None else "")}'
            )
        return text

    def _details(self, wait: Wait | None, state: object) -> str:
        """What a token waits for, as the last members of a JSON object."""
        if wait is None:
            return '"kind":"join","text":"tokens on its other flows"}'
        text = self._waits.get(wait.node) if state == _NO_SCRIPT else encode(self._node.wait_details(wait))[1:-1]
        if text is None:
            text = self._waits[wait.node] = encode(self._node.wait_details(wait))[1:-1]
        miss = self._node.last_miss(wait)
        if miss is None:
            return f"{text}}}"
        return f'{text},"missed":{{"time":{miss[0]},"why":{name_text(miss[1])}}}}}'

    # ---- everything --------------------------------------------------------------------------------------------------

    def key(self) -> str:
        """Everything, as of the last `flush`."""
        self._count()
        instances = [
            {"instance": key, "process": process, "status": status}
            for key, (process, status) in self._instances.items()
        ]
        variables = ",".join(f"{known.where},{known.everything()}}}" for known in self._scopes.values())
        tokens = ",".join(token.text for token in self._tokens.values())
        return (
            f'{{"process":{json_text(self._node.mission.process.id)},"instances":{encode(instances)},'
            f'"tokens":[{tokens}],"variables":[{variables}],"counts":{encode(self._counts)}}}'
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
        self._names: list[str] = []
        self._values: list[Any] = []
        self._changeable: dict[str, Any] = {}  # name -> a copy of what may be changed in place
        self._texts: dict[str, str] = {}

    def change(self) -> str:
        """What is different now, as members of a JSON object; empty if nothing is."""
        variables, texts = self._variables, self._texts
        names, values = list(variables), list(dict.values(variables))
        gone: list[str] = []
        if names == self._names:
            changed = list(compress(names, map(is_not, values, self._values)))
        else:
            before = dict(zip(self._names, self._values, strict=True))
            changed = [name for name, value in zip(names, values, strict=True) if before.get(name, before) is not value]
            self._names = names
            gone = [name for name in texts if not dict.__contains__(variables, name)]
        self._values = values
        changed += [name for name, copy in self._changeable.items() if _differs(dict.get(variables, name), copy)]
        fresh: list[str] = []
        for name in changed:
            value: Any = dict.get(variables, name)
            is_number = _is_number(value) and name[:2] != "__"  # most changes are
            if not is_number and is_changeable(value):
                self._changeable[name] = snapshot_of(value)
            elif name in self._changeable:
                del self._changeable[name]
            if is_number or is_data(name, value):
                text = repr(value) if is_number else json_text(value)
                if texts.get(name) != text:
                    texts[name] = text
                    fresh.append(f"{name_text(name)}:{text}")
        for name in gone:
            del texts[name]
            self._changeable.pop(name, None)
        parts = [f'"set":{{{",".join(fresh)}}}'] * bool(fresh) + [f'"unset":{encode(gone)}'] * bool(gone)
        return ",".join(parts)

    def everything(self) -> str:
        """All of them, as a member of a JSON object."""
        return '"set":{' + ",".join([f"{name_text(name)}:{text}" for name, text in self._texts.items()]) + "}"


def _is_number(value: Any) -> bool:
    """Whether it is a finite number."""
    kind = type(value)
    return (kind is float or kind is int) and value - value == 0


def _differs(value: Any, copy: Any) -> bool:
    """Whether a value that may be changed in place has changed; where that cannot be told cheaply, it may have."""
    if value.__class__ is not copy.__class__ or value is copy:  # there is no copy of an object or array
        return True
    try:
        return bool(value != copy)
    except Exception:  # of what a list has in it
        return True


def _tokens(running: Iterable[Instance]) -> Iterator[tuple[Hashable, Scope, str, Wait | None]]:
    """Every token that rests: its key, scope and element, and its wait unless it is at a join."""
    for instance in running:
        for wait in instance.waits():
            yield wait.key, wait.scope, wait.node.id, wait
        for scope, join, _ in joins_reached(instance.root):
            yield f"{scope.key}@{join.id}", scope, join.id, None


def path_of(scope: Scope) -> Iterator[str]:
    """The ids of the activities that a scope is inside, the outermost first."""
    ids: list[str] = []
    around: Scope | None = scope
    while around is not None:
        if around.node is not None and around.node.id and ids[-1:] != [around.node.id]:
            ids.append(around.node.id)
        around = around.parent
    return reversed(ids)


def forget_ended(instances: dict[int, tuple[str, str]]) -> None:
    """Forget the oldest of the instances that have ended, if there are many."""
    ended = [key for key, (_, status) in instances.items() if status != "running"]
    for key in ended[:-_ENDED]:
        del instances[key]
