"""From the form of an engine (see `fame.check.explore.canonical`) back to an engine, many times from one form.

Scopes, waits and mailboxes are made in the order of their numbers; parents and owners have smaller numbers than what
they hold. Values that nothing can change are shared by all engines of a form.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fame.engine.data import chained
from fame.engine.interpreter import Engine
from fame.engine.state import Instance, Mailbox, Record, Scope, Wait, pass_on

if TYPE_CHECKING:
    from fame.check.explore.canonical import Control, Form, Forms


class Revival:
    """Restores an engine from its form."""

    forms: Forms
    engine: Engine

    def __init__(self, forms: Forms, form: Form, engine: Engine) -> None:
        self.forms, self.engine = forms, engine
        control, contents = form
        (instances, scopes, waits, boxes, listeners, conditions, named, inclusive, starts, waiting, gathered, ranks,
         outer) = forms.controls[control]  # fmt: skip
        self.dicts: list[dict[str, Any]] = []
        self._dicts(outer, contents)
        count = len(scopes) + len(waits) + len(boxes)
        self.keys: Sequence[int] = (0, *ranks) if ranks else range(count + 1)
        engine.counter = count + len(starts)
        self.all: list[Any] = [None]
        self._scopes(scopes, dict(instances))
        self._waits(waits)
        if boxes:
            self._boxes(boxes, scopes, waits)
        everything, table = self.all, engine.listeners
        for number in listeners:
            listener = everything[number]
            topic = listener.catch.topic
            if topic in table:
                table[topic][listener] = None
            else:
                table[topic] = {listener: None}
        for number in named:
            wait = everything[number]
            engine.waits[wait.key] = wait
        if conditions:
            engine.conditions = {everything[one]: None for one in conditions}
        if inclusive:
            engine.inclusive = {everything[one]: None for one in inclusive}
        if starts:
            engine.armed_starts = dict(enumerate(starts, count + 1))
        if waiting or gathered:
            self._starts(waiting, gathered)

    def _dicts(self, outer: Sequence[int], numbers: Sequence[int]) -> None:
        contents, dicts = self.forms.contents, self.dicts
        contents.forget()
        for place, number in zip(outer, numbers, strict=True):
            values = contents.values(number)
            if place < 0:
                variables = self.engine.new_variables()
                dict.update(variables, values)
            else:
                variables = chained(dicts[place], values)
            contents.give(variables, number)
            dicts.append(variables)

    def _scopes(self, scopes: Control, roots: dict[int, int]) -> None:
        everything, keys, dicts, forms = self.all, self.keys, self.dicts, self.forms
        unusual = []
        for number, (parent, node, body, variables, tokens, state, joins, rare) in enumerate(scopes, 1):
            outer = everything[parent]
            scope = Scope(keys[number], outer, node, body, dicts[variables])
            scope.tokens, scope.state = tokens, state
            pass_on(scope)
            if parent:
                outer.children[scope] = None
            else:
                instance = Instance(scope.key, forms.program, dicts[roots[number]])
                instance.counts = forms.counts
                scope.instance, scope.counts, instance.root = instance, instance.counts, scope
                self.engine.instances[scope.key] = instance
            scope.instance.scopes += 1
            if joins:
                scope.joins = {forms.nodes[join]: list(counts) for join, counts in joins}
            if rare is not None:
                unusual.append((scope, rare))
            everything.append(scope)
        for scope, rare in unusual:
            self._rare(scope, rare)

    def _rare(self, scope: Scope, rare: Control) -> None:
        _, scope.handles, suspender, scope.held, items, done = rare
        scope.items = None if items is None else self.forms.decode(items)
        scope.done = None if done is None else [self._record(each) for each in done]
        if suspender:
            scope.suspender, scope.mark = self.all[suspender], self.all[suspender].key

    def _record(self, item: Control) -> Record:
        node, variables, inner = item
        return Record(node, self.dicts[variables], [self._record(each) for each in inner])

    def _waits(self, waits: Control) -> None:
        everything, keys = self.all, self.keys
        for node, place, token, owner, started, true, paused, due, _ in waits:
            scope = everything[place]
            wait = Wait(keys[len(everything)], node, scope, token)
            wait.started, wait.true, wait.paused, wait.due = started, true, paused, due
            armed_for = wait.owner = everything[owner]
            if owner and owner != place:  # a boundary event or an alternative
                armed_for.arms += (wait,)
            else:
                scope.children[wait] = None
            everything.append(wait)

    def _boxes(self, boxes: Control, scopes: Control, waits: Control) -> None:
        everything, decode = self.all, self.forms.decode
        for node, scope, messages, passed in boxes:
            box = Mailbox(self.keys[len(everything)], node, everything[scope])
            box.messages.extend((rank, decode(message)) for rank, message in messages)
            box.passed = passed
            everything.append(box)
        for number, item in enumerate(scopes, 1):
            if item[-1] is not None and item[-1][0] is not None:
                everything[number].mail = {everything[box].node: everything[box] for box in item[-1][0]}
        for number, item in enumerate(waits, len(scopes) + 1):
            if item[-1]:
                everything[number].box = everything[item[-1]]

    def _starts(self, waiting: Control, gathered: Control) -> None:
        engine, decode = self.engine, self.forms.decode
        for node, kept in waiting:
            messages = ((rank, decode(message)) for rank, message in kept)
            engine.waiting_starts[node] = deque(messages, maxlen=node.catch.kept)
        for whole, sets in gathered:
            engine.gathered[whole] = [
                (decode(keys), {one: decode(message) for one, message in found}) for keys, found in sets
            ]
