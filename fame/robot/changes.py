"""Changes in one robot: events, variables, and what its tokens wait for.

A `ChangeTracker` hears what happens in one engine. At the end of the instant (`flush`) it compares variables and
waiting tokens with what it knew, and gives away what is different, as plain data that `marshal` takes: JSON is made of
it elsewhere (`fame.robot.change_text`), in recordings by another process, so that a run is slowed down little.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from itertools import compress, count
from operator import is_not
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.engine.program import Node
from fame.engine.state import Instance, Scope, Trail, Wait
from fame.robot.change_text import Changes, Group, ScopeChange, Token, encode, name_text
from fame.robot.plain_values import PLAIN, differs, is_changeable, plain, snapshot_of

if TYPE_CHECKING:
    from fame.robot.events import Event
    from fame.robot.node import RobotNode

Put = Callable[[int, Changes], object]
"""Takes a time (ns) and what has changed until then."""

_MANY = 1000
"""Number of groups of marks that are kept without a reader; then they are only counted."""
_KNOWN = 10_000
"""Scopes whose place is kept as JSON."""
_NO_SCRIPT = (0, None, None)
"""The state of a wait that is neither suspended nor for a script."""


class ChangeTracker:
    """Finds the changes in the engine of `node`. `put` gets every change.

    While it is not `active`, it gives nothing but marks, to be counted; after that, the next `flush` gives everything.
    """

    active: bool = True

    def __init__(self, node: RobotNode, put: Put) -> None:
        self.robot: str = node.name
        self._node, self._waiting, self._put = node, node.waiting, put
        self._groups: list[Group] = []
        self._scopes: dict[int, _ScopeVariables] = {}  # by the key of the scope that owns them
        self._tokens: dict[Hashable, tuple[object, int]] = {}  # waiting tokens: what is compared, since when (ns)
        self._graph_due = 0  # when to look again who publishes (ns)
        self._places: dict[int, str] = {}
        self._waits: dict[Node, str] = {}  # what is the same for every token there

    # ---- what happens ------------------------------------------------------------------------------------------------

    def event(self, event: Event) -> None:
        """Take an event, which need not be a step of a token."""
        self._groups.append((event.instance, event.scope, (event[4:],)))

    def trail(self, trail: Trail) -> None:
        """Tokens moved."""
        for scope, marks in trail:
            self._groups.append((scope.instance.key, scope.key, marks))
        if not self.active and len(self._groups) > _MANY:
            self.give_groups(0)

    def give_groups(self, time: int) -> None:
        """Pass on the events until `time` (ns) alone."""
        groups, self._groups = self._groups, []
        if groups:
            self._put(time, (groups, (), (), (), ()))

    # ---- what is different -------------------------------------------------------------------------------------------

    def flush(self, time: int) -> None:
        """Pass on all changes until `time` (ns), the end of an instant."""
        groups, self._groups = self._groups, []
        if time >= self._graph_due:
            self._graph_due = time + SECOND
            if self._waiting.refresh_publishers():
                self._waits.clear()
                self._tokens = {key: (None, since) for key, (_, since) in self._tokens.items()}
        owners, waits, joins = _look(self._node.engine.instances.values())
        scopes, gone = self._compare_variables(owners)
        tokens, left = self._compare_tokens(time, waits, joins)
        if groups or scopes or gone or tokens or left:
            self._put(time, (groups, scopes, gone, tokens, left))

    def _compare_variables(self, owners: Sequence[Scope]) -> tuple[list[ScopeChange], list[int]]:
        """What changed in scopes with variables of their own, and the keys of those that are gone."""
        known, changes = self._scopes, list[ScopeChange]()
        for scope in owners:
            variables, where = known.get(scope.key), ""
            if variables is None:
                variables = known[scope.key] = _ScopeVariables(scope)
                where = variables.where
            change = variables.change()
            if change is not None or where:
                changes.append((scope.key, where, *(change or ((), (), ()))))
        gone: list[int] = []
        if len(known) > len(owners):
            there = {scope.key for scope in owners}
            gone = [key for key in known if key not in there]
            for key in gone:
                del known[key]
        return changes, gone

    def _compare_tokens(
        self, time: int, waits: Sequence[Wait], joins: Sequence[tuple[Scope, Node]]
    ) -> tuple[list[Token], list[str]]:
        """The tokens that are new or wait for something else, and the keys of those that are gone."""
        before, now, fresh = self._tokens, dict[Hashable, tuple[object, int]](), list[Token]()
        waiting, places = self._waiting, self._places
        for wait in waits:
            is_simple = not (wait.started or wait.paused or wait.key in waiting.uncorrelated)
            state, known = _NO_SCRIPT if is_simple else waiting.state(wait), before.get(wait.key)
            if known is None or known[0] != state:
                known = state, known[1] if known is not None else waiting.since(wait, time)
                miss = waiting.last_miss(wait) if waiting.missed or waiting.uncorrelated else None
                place = places.get(wait.scope.key) or self._place(wait.scope)
                text = (self._waits.get(wait.node) if is_simple else None) or self._details(wait, state)
                fresh.append((str(wait.key), place, wait.node.id, known[1], text, miss))
            now[wait.key] = known
        for scope, join in joins:
            key = f"{scope.key}@{join.id}"
            known = before.get(key)
            if known is None or known[0] is None:
                known = _NO_SCRIPT, known[1] if known is not None else time
                place = places.get(scope.key) or self._place(scope)
                fresh.append((key, place, join.id, known[1], _JOIN, None))
            now[key] = known
        self._tokens = now
        return fresh, [str(key) for key in before if key not in now]

    def _place(self, scope: Scope) -> str:
        """The position of a scope, as members of a JSON object."""
        body: Scope | None = scope
        while body is not None and body.body is None:
            body = body.parent
        if len(self._places) >= _KNOWN:
            self._places.clear()
        text = self._places[scope.key] = (
            f'"instance":{scope.instance.key},"scope":{scope.key},"path":{_path_text(scope)},'
            f'"body":{name_text(body.body.id if body is not None and body.body is not None else "")}'
        )
        return text

    def _details(self, wait: Wait, state: object) -> str:
        """What a token waits for, as members of a JSON object."""
        text = encode(self._waiting.details(wait))[1:-1]
        if state == _NO_SCRIPT:
            self._waits[wait.node] = text
        return text


_JOIN = '"kind":"join","text":"tokens on its other flows"'


class _ScopeVariables:
    """The variables of a scope as they were at the last look."""

    def __init__(self, scope: Scope) -> None:
        self.where: str = f'{{"instance":{scope.instance.key},"scope":{scope.key},"path":{_path_text(scope)}'
        self._variables = scope.variables
        self._names: list[str] = []
        self._values: list[Any] = []
        self._hidden: frozenset[int] = frozenset()  # places of names with two leading underscores
        self._copies: dict[int, Any] = {}  # place -> a copy of a value that may be changed in place

    def change(self) -> tuple[Sequence[str] | None, Sequence[int], Sequence[Any]] | None:
        """The names, if they are others than at the last look; places and plain values that may have changed.

        None if nothing has changed.
        """
        names, values = list(self._variables), list(dict.values(self._variables))
        has_new_names = names != self._names
        if has_new_names:
            self._rename(names)
        before, self._values = self._values, values
        places = list(compress(count(), map(is_not, values, before)))
        if self._copies:
            self._compare_copies(values, places)
        if not self._hidden.isdisjoint(places):
            places = [place for place in places if place not in self._hidden]
        if not (places or has_new_names):
            return None
        found = [values[at] if values[at].__class__ in PLAIN else self._plain(at, values[at]) for at in places]
        return names if has_new_names else None, places, found

    def _rename(self, names: list[str]) -> None:
        """Take other names: each keeps its value and its copy."""
        values = dict(zip(self._names, self._values, strict=True))
        copies = {self._names[place]: copied for place, copied in self._copies.items()}
        self._names, self._values = names, [values.get(name, _NOTHING) for name in names]
        self._copies = {place: copies[name] for place, name in enumerate(names) if name in copies}
        self._hidden = frozenset(place for place, name in enumerate(names) if name[:2] == "__")

    def _compare_copies(self, values: list[Any], places: list[int]) -> None:
        """Change `places` of other objects to those of values that differ, also by changes in place."""
        for place, copied in list(self._copies.items()):
            if differs(values[place], copied):
                del self._copies[place]
                if place not in places:
                    places.append(place)
            elif place in places:
                places.remove(place)

    def _plain(self, place: int, value: Any) -> Any:
        """The plain form of a value."""
        found = plain(value)
        if is_changeable(value) and not (found.__class__ is bytes and found.startswith(_CUT_ARRAY)):
            self._copies[place] = snapshot_of(value)
        return found


_NOTHING = object()
"""The value of a variable that was not there."""
_CUT_ARRAY = b'{"$cut":"array of'
"""How the JSON of a large array begins: it tells nothing that a change in place could make different."""


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


def _path_text(scope: Scope) -> str:
    """The path of a scope as JSON."""
    return f"[{','.join(map(name_text, path_of(scope)))}]"


def path_of(scope: Scope) -> Iterator[str]:
    """The ids of the activities that a scope is inside, the outermost first."""
    ids: list[str] = []
    around: Scope | None = scope
    while around is not None:
        if around.node is not None and around.node.id and ids[-1:] != [around.node.id]:
            ids.append(around.node.id)
        around = around.parent
    return reversed(ids)
