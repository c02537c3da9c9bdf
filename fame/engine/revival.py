"""From the form of an engine (see `fame.engine.canonical`) back to an engine, many times from one form.

Scopes, waits and mailboxes are made in the order of their numbers, then connected. Values that nothing can change are
shared by all engines of a form.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from itertools import compress
from operator import is_, is_not
from typing import TYPE_CHECKING, Any

from fame.engine.data import Variables
from fame.engine.interpreter import Engine
from fame.engine.state import Instance, Mailbox, Record, Scope, Wait

if TYPE_CHECKING:
    from fame.engine.canonical import Form, Forms


class Content:
    """The content of a dict of variables.

    known   all codes
    values  the immutable values
    lists   the items of lists of immutable values, which are copied for each engine
    codes   codes of the other mutable values, decoded for each engine
    """

    __slots__ = ("codes", "known", "lists", "number", "values")

    def __init__(self, number: int, own: Form, forms: Forms) -> None:
        self.number, self.known = number, dict(own)
        self.values: dict[str, Any] = {}
        self.lists: dict[str, Sequence[Any]] = {}
        self.codes: dict[str, Any] = {}
        for name, code in own:
            value = forms.decode(code)
            if forms.constant(code):
                self.values[name] = value
            elif value.__class__ is list and all(forms.constant(forms.encode(item)) for item in value):
                self.lists[name] = tuple(value)
            else:
                self.codes[name] = code

    def made(self, forms: Forms) -> dict[str, Any]:
        """The variables of a new engine."""
        copies = {name: list(items) for name, items in self.lists.items()}
        return self.values | copies | {name: forms.decode(code) for name, code in self.codes.items()}


class Given:
    """A dict of variables as it was when its engine was restored: what is the same object now has the same code."""

    __slots__ = ("content", "names", "values", "variables")

    def __init__(self, variables: dict[str, Any], content: Content) -> None:
        self.variables, self.content = variables, content
        self.names, self.values = list(variables), list(dict.values(variables))

    def changed(self) -> Mapping[str, object] | None:
        """The names of variables that may have another code now; None if it cannot be told, since some are gone."""
        names, count = list(self.variables), len(self.names)
        if names[:count] != self.names:
            return None
        found: dict[str, Any] = dict.fromkeys(compress(names, map(is_not, dict.values(self.variables), self.values)))
        for name, items in self.content.lists.items():
            value = self.variables[name]
            if name not in found and not (len(value) == len(items) and all(map(is_, value, items))):
                found[name] = None
        return found | dict.fromkeys(names[count:]) | self.content.codes


class Revival:
    """Restores an engine from its form."""

    def __init__(self, forms: Forms, form: Form, engine: Engine) -> None:
        self.forms, self.engine, self.nodes = forms, engine, forms.nodes
        (instances, scopes, waits, boxes, listeners, conditions, named, inclusive, starts, waiting, gathered, order,
         variables) = form  # fmt: skip
        self.dicts: list[dict[str, Any]] = []
        forms.given = {}
        for outer, content in variables:
            self.dicts.append(self._dict(outer, forms.contents[content]))
        count = len(scopes) + len(waits) + len(boxes)
        self.keys: Sequence[int] = range(count + 1)
        if order:
            ranks = {number: rank for rank, number in enumerate(order, 1)}
            self.keys = [ranks.get(number, number) for number in self.keys]
        engine.counter = count + len(starts)
        self.all: list[Any] = [None]
        roots = dict(instances)
        for number, item in enumerate(scopes, 1):
            self.all.append(self._scope(number, item, roots))
        self._waits(waits)
        for item in boxes:
            self.all.append(self._box(len(self.all), item))
        self._connect(scopes, waits, boxes)
        everything = self.all
        engine.listeners = {topic: {everything[one]: None for one in found} for topic, found in listeners}
        engine.conditions = {everything[one]: None for one in conditions}
        engine.waits = {everything[one].key: everything[one] for one in named}
        engine.inclusive = {everything[one]: None for one in inclusive}
        engine.armed_starts = {count + 1 + place: self.nodes[node] for place, node in enumerate(starts)}
        if waiting or gathered:
            self._starts(waiting, gathered)

    def _dict(self, outer: int, content: Content) -> dict[str, Any]:
        values = content.made(self.forms)
        variables = self.engine.new_variables() | values if outer < 0 else Variables(self.dicts[outer], values)
        self.forms.given[id(variables)] = Given(variables, content)
        return variables

    def _scope(self, number: int, item: Form, roots: dict[int, int]) -> Scope:
        parent, node, body, variables, tokens, state, _, joins, rare = item
        nodes = self.nodes
        scope = Scope(
            self.keys[number],
            self.all[parent],
            nodes[node] if node >= 0 else None,
            self.forms.bodies[body] if body >= 0 else None,
            self.dicts[variables],
        )
        scope.tokens, scope.state = tokens, state
        if not parent:
            instance = Instance(scope.key, self.engine.program, self.dicts[roots[number]])
            instance.counts = self.forms.counts
            scope.instance, scope.counts, instance.root = instance, instance.counts, scope
            self.engine.instances[scope.key] = instance
        else:
            self.all[parent].children[scope] = None
        scope.instance.scopes += 1
        if joins:
            scope.joins = {nodes[join]: list(counts) for join, counts in joins}
        if rare is not None:
            _, handles, _, held, items, done = rare
            scope.handles = tuple(nodes[each] for each in handles)
            scope.held = tuple(nodes[each] for each in held)
            scope.items = self.forms.decode(items)
            scope.done = None if done is None else [self._record(each) for each in done]
        return scope

    def _record(self, item: Form) -> Record:
        node, variables, inner = item
        return Record(self.nodes[node], self.dicts[variables], [self._record(each) for each in inner])

    def _waits(self, waits: Form) -> None:
        everything, keys, nodes = self.all, self.keys, self.nodes
        for node, place, token, _, child, started, true, paused, due, _, _ in waits:
            scope = everything[place]
            wait = Wait(keys[len(everything)], nodes[node], scope, token)
            wait.started, wait.true, wait.paused, wait.due = started, true, paused, due
            if child:
                scope.children[wait] = None
            everything.append(wait)

    def _box(self, number: int, item: Form) -> Mailbox:
        node, scope, messages, waits = item
        box = Mailbox(self.keys[number], self.nodes[node], self.all[scope])
        box.messages.extend((rank, self.forms.decode(message)) for rank, message in messages)
        box.waits = {self.all[each]: None for each in waits}
        return box

    def _connect(self, scopes: Form, waits: Form, boxes: Form) -> None:
        everything = self.all
        for number, item in enumerate(scopes, 1):
            scope = everything[number]
            if item[6]:
                scope.arms = tuple([everything[arm] for arm in item[6]])
            if item[8] is not None:
                mail, _, suspender, _, _, _ = item[8]
                if mail is not None:
                    scope.mail = {everything[box].node: everything[box] for box in mail}
                if suspender:
                    scope.suspender, scope.mark = everything[suspender], everything[suspender].key
        for number, item in enumerate(waits, len(scopes) + 1):
            wait = everything[number]
            if item[3]:
                wait.owner = everything[item[3]]
            if item[9]:
                wait.arms = tuple([everything[arm] for arm in item[9]])
            if item[10]:
                wait.box = everything[item[10]]

    def _starts(self, waiting: Form, gathered: Form) -> None:
        engine, nodes, decode = self.engine, self.nodes, self.forms.decode
        for number, kept in waiting:
            node = nodes[number]
            assert node.catch is not None
            messages = ((rank, decode(message)) for rank, message in kept)
            engine.waiting_starts[node] = deque(messages, maxlen=node.catch.queue)
        for whole, sets in gathered:
            engine.gathered[nodes[whole]] = [
                (decode(keys), {nodes[one]: decode(message) for one, message in found}) for keys, found in sets
            ]
