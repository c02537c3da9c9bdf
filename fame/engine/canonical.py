"""The state of an engine as one hashable value (its form), the way back, and the stimuli that it accepts.

Two engines have the same form if they behave the same from now on. Keys are replaced by numbers in the order of a walk:
scopes and waits are ordered by the position of their nodes in the program, and by age only where one node has several.
Where the order of arming matters it is part of the form: listeners of one topic, armed conditions, and all keys while
something is suspended. Counts of visits and the counter of keys are not part of the form.

Invariant: ``canonical(revived(form)) == form``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from fame.engine.data import Variables
from fame.engine.host import Host
from fame.engine.interpreter import Engine
from fame.engine.program import USER, Body, Node, Program
from fame.engine.snapshot import OF_NO_PROGRAM, is_data
from fame.engine.state import Instance, Mailbox, Record, Scope, Wait
from fame.engine.tasks import SCRIPT

Form = tuple[Any, ...]
"""The hashable form of an engine."""
Keys = dict[int, int]
"""Key in the engine -> number in its form, of waits and armed start events."""


@dataclass(frozen=True, slots=True)
class Stimuli:
    """The stimuli that an engine accepts now.

    scripts  waits of running scripts and services, by key
    timers   nodes of pending timers, by key
    people   user and manual tasks that wait for somebody
    topics   topics with a listener, start events included
    offers   elements of ad-hoc sub-processes that can start
    """

    scripts: dict[int, Wait]
    timers: dict[int, Node]
    people: tuple[Wait, ...]
    topics: frozenset[str]
    offers: tuple[str, ...]


def stimuli(engine: Engine) -> Stimuli:
    """The stimuli that can change the state of an engine that is not running."""
    scripts, timers = {}, {}
    for key, wait in engine.waits.items():
        if wait.catch.trigger is SCRIPT:
            if wait.started and not wait.paused:
                scripts[key] = wait
        else:
            timers[key] = wait.node
    timers.update(engine.armed_starts)
    waits = [wait for instance in engine.instances.values() for wait in instance.waits()]
    people = tuple(wait for wait in waits if wait.catch.trigger is USER and not wait.paused and not wait.due)
    topics = frozenset((*engine.listeners, *engine.program.starts))
    offers = tuple(engine.offers()) if any(wait.scope.body and wait.scope.body.adhoc for wait in waits) else ()
    return Stimuli(scripts, timers, people, topics, offers)


class Forms:
    """The forms of the engines of one program.

    encode    value of a message or another part of the state -> hashable
    decode    the inverse; gives a new object if the value is mutable
    variable  (name, value) of a variable -> hashable; as `encode` by default
    kept      whether a variable belongs to the form; by default all that are data
    constant  whether `decode` always gives the same immutable value
    """

    program: Program
    encode: Callable[[Any], Hashable]
    decode: Callable[[Any], Any]
    kept: Callable[[str], bool]

    def __init__(
        self,
        program: Program,
        encode: Callable[[Any], Hashable],
        decode: Callable[[Any], Any],
        kept: Callable[[str], bool] = lambda name: True,
        variable: Callable[[str, Any], Hashable] | None = None,
        constant: Callable[[Hashable], bool] = lambda code: False,
    ) -> None:
        self.variable: Callable[[str, Any], Hashable] = variable or (lambda name, value: encode(value))
        self.constant = constant
        self.counts: list[int] = [0] * len(program.elements)
        """Completions of elements, summed over all restored engines."""
        self.contents: list[_Content] = []
        self._content_numbers: dict[Form, int] = {}
        self.given: dict[int, tuple[dict[str, Any], _Content]] = {}
        """The dicts of variables of the engine that was restored last, by id, with their contents at that time."""
        self.program, self.encode, self.decode, self.kept = program, encode, decode, kept
        self.nodes: tuple[Node, ...] = (*program.nodes, *OF_NO_PROGRAM)
        self.numbers: dict[Node, int] = {node: number for number, node in enumerate(self.nodes)}
        self.bodies: list[Body] = [program.body, *(node.body for node in program.nodes if node.body is not None)]
        self.body_numbers: dict[Body, int] = {body: place for place, body in reversed(list(enumerate(self.bodies)))}

    def canonical(self, engine: Engine) -> tuple[Form, Keys]:
        """The form of an engine that is not running, and the numbers of its keys. No script may be ending."""
        if engine.ready or engine.cancelling or engine.held is not None:
            raise RuntimeError("a form is taken between two stimuli, when nothing is being cancelled or held")
        return _Walk(self, engine).form()

    def content(self, own: Form) -> int:
        """The number of the content of a dict of variables: (name, code), sorted."""
        number = self._content_numbers.get(own)
        if number is None:
            number = self._content_numbers[own] = len(self.contents)
            self.contents.append(_Content(own, self))
        return number

    def revived(self, form: Form, host: Host, new_variables: Callable[[], dict[str, Any]], *, moves: int) -> Engine:
        """A new engine of that form; `moves` as of `Engine`."""
        return _Revival(self, form, Engine(self.program, host, new_variables, moves=moves)).engine


class _Content:
    """The content of a dict of variables. `codes`: those of the mutable values, decoded for each engine.

    constants  the immutable values with their codes
    """

    __slots__ = ("codes", "constants", "values")

    def __init__(self, own: Form, forms: Forms) -> None:
        self.values = {name: forms.decode(code) for name, code in own if forms.constant(code)}
        self.constants = {name: (self.values[name], code) for name, code in own if name in self.values}
        self.codes = [(name, code) for name, code in own if name not in self.values]


# ---- to the form -------------------------------------------------------------------------------------


_KEY = attrgetter("key")


class _Walk:
    """One walk over an engine, which gives its form."""

    def __init__(self, forms: Forms, engine: Engine) -> None:
        self.forms, self.engine, self.nodes = forms, engine, forms.numbers
        self.number: dict[Any, int] = {}  # scope, wait or mailbox -> number, from 1
        self.scopes: list[Scope] = []
        self.waits: list[Wait] = []
        self.boxes: list[Mailbox] = []
        self.dicts: dict[int, int] = {}
        self.variables: list[Hashable] = []
        self.suspended = False
        for instance in engine.instances.values():
            self._collect(instance.root)
        waits, number = self.waits, self.number
        for wait in waits:  # which grows
            number[wait] = len(number) + 1
            if wait.arms:
                waits.extend(wait.arms)
            if wait.box is not None:
                self._collect_box(wait.box)

    def _collect(self, root: Scope) -> None:
        nodes, waits, stack = self.nodes, self.waits, [root]
        while stack:
            scope = stack.pop()
            self.number[scope] = len(self.number) + 1
            self.scopes.append(scope)
            self.suspended |= scope.suspender is not None
            children = scope.children
            ordered = sorted(children, key=lambda child: nodes[child.node]) if len(children) > 1 else children  # type: ignore[index]  # children have a node
            inner = []
            for child in ordered:
                if child.__class__ is Wait:
                    waits.append(child)
                else:
                    inner.append(child)
            if scope.arms:
                waits.extend(scope.arms)
            for box in (scope.mail or {}).values():
                self._collect_box(box)
            stack.extend(reversed(inner))  # type: ignore[arg-type]

    def _collect_box(self, box: Mailbox) -> None:
        if box not in self.boxes:
            self.boxes.append(box)

    def form(self) -> tuple[Form, Keys]:
        engine, nodes, number = self.engine, self.nodes, self.number
        for box in self.boxes:
            number[box] = len(number) + 1
        starts = sorted(engine.armed_starts.items(), key=lambda item: nodes[item[1]])
        keys = {wait.key: number[wait] for wait in self.waits}
        first = len(number) + 1
        keys.update((key, first + place) for place, (key, _) in enumerate(starts))
        mail = self._mail_ranks()
        listeners = tuple(
            (topic, tuple([number[each] for each in found])) for topic, found in sorted(engine.listeners.items())
        )
        form = (
            tuple([(number[one.root], self._dict(one.root_variables)) for one in engine.instances.values()]),
            tuple([self._scope(scope) for scope in self.scopes]),
            tuple([self._wait(wait) for wait in self.waits]),
            tuple([self._box(box, mail) for box in self.boxes]) if self.boxes else (),
            listeners,
            tuple([number[wait] for wait in engine.conditions]) if engine.conditions else (),
            tuple(sorted([number[wait] for wait in engine.waits.values()])),
            tuple(sorted([number[scope] for scope in engine.inclusive])) if engine.inclusive else (),
            tuple([nodes[node] for _, node in starts]),
            self._waiting_starts(mail),
            self._gathered(),
            tuple([number[each] for each in sorted(number, key=_KEY)]) if self.suspended else (),
            tuple(self.variables),
        )
        return form, keys

    def _dict(self, variables: dict[str, Any]) -> int:
        """The number of a dict of variables; outer dicts come first."""
        place = self.dicts.get(id(variables))
        if place is not None:
            return place
        outer = self._dict(variables.outer) if isinstance(variables, Variables) else -1
        place = self.dicts[id(variables)] = len(self.variables)
        self.variables.append((outer, self._content(variables)))
        return place

    def _content(self, variables: dict[str, Any]) -> int:
        """The number of the content of a dict of variables."""
        forms = self.forms
        encode, kept = forms.variable, forms.kept
        given = forms.given.get(id(variables))
        known = given[1].constants if given is not None else {}
        own = []
        for name in sorted(variables):
            value = variables[name]
            constant = known.get(name)
            if constant is not None and constant[0] is value:
                own.append((name, constant[1]))
            elif kept(name) and is_data(name, value):
                own.append((name, encode(name, value)))
        return forms.content(tuple(own))

    def _scope(self, scope: Scope) -> Hashable:
        nodes, number = self.nodes, self.number
        joins = scope.joins
        rare: Hashable = None
        if scope.mail or scope.handles or scope.suspender or scope.held or scope.items is not None or scope.done:
            rare = (
                tuple([number[box] for box in scope.mail.values()]) if scope.mail is not None else None,
                tuple([nodes[node] for node in scope.handles]),
                number[scope.suspender] if scope.suspender is not None else 0,
                tuple([nodes[node] for node in scope.held]),
                self.forms.encode(scope.items),
                None if scope.done is None else tuple(map(self._record, scope.done)),
            )
        return (
            number[scope.parent] if scope.parent is not None else 0,
            nodes[scope.node] if scope.node is not None else -1,
            self.forms.body_numbers[scope.body] if scope.body is not None else -1,
            self._dict(scope.variables),
            scope.tokens,
            scope.state,
            tuple([number[arm] for arm in scope.arms]) if scope.arms else (),
            tuple(sorted([(nodes[join], tuple(counts)) for join, counts in joins.items()])) if joins else (),
            rare,
        )

    def _record(self, record: Record) -> Hashable:
        return (self.nodes[record.node], self._dict(record.variables), tuple(map(self._record, record.inner)))

    def _wait(self, wait: Wait) -> Hashable:
        number, owner = self.number, wait.owner
        due = 0
        if wait.due:
            due = 1 + sum(0 < other.due < wait.due for other in self.waits)
        return (
            self.nodes[wait.node],
            number[wait.scope],
            wait.token,
            number[owner] if owner is not None else 0,
            wait in wait.scope.children,
            wait.started,
            wait.true,
            wait.paused,
            due,
            tuple([number[arm] for arm in wait.arms]) if wait.arms else (),
            number[wait.box] if wait.box is not None else 0,
        )

    def _box(self, box: Mailbox, ranks: dict[int, int]) -> Hashable:
        encode, number = self.forms.encode, self.number
        return (
            self.nodes[box.node],
            number[box.scope],
            tuple([(ranks[key], encode(message)) for key, message in box.messages]),
            tuple([number[wait] for wait in box.waits]),
        )

    def _mail_ranks(self) -> dict[int, int]:
        """The order of arrival of queued messages."""
        kept = [key for box in self.boxes for key, _ in box.messages]
        kept += [key for messages in self.engine.waiting_starts.values() for key, _ in messages]
        return {key: rank + 1 for rank, key in enumerate(sorted(kept))}

    def _waiting_starts(self, ranks: dict[int, int]) -> Form:
        encode, nodes = self.forms.encode, self.nodes
        found = self.engine.waiting_starts.items()
        return tuple(
            sorted((nodes[node], tuple((ranks[key], encode(message)) for key, message in kept)) for node, kept in found)
        )

    def _gathered(self) -> Form:
        encode, nodes = self.forms.encode, self.nodes
        return tuple(
            (nodes[whole], tuple((encode(keys), tuple((nodes[one], encode(m)) for one, m in found.items()))
                                 for keys, found in sets))
            for whole, sets in sorted(self.engine.gathered.items(), key=lambda item: nodes[item[0]])
        )  # fmt: skip


# ---- from the form -------------------------------------------------------------------------------------


class _Revival:
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
        self.keys: list[int] = list(range(count + 1))
        for rank, number in enumerate(order):
            self.keys[number] = rank + 1
        engine.counter = count + len(starts)
        self.all: list[Any] = [None]
        roots = dict(instances)
        for number, item in enumerate(scopes, 1):
            self.all.append(self._scope(number, item, roots))
        for item in waits:
            self.all.append(self._wait(len(self.all), item))
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

    def _dict(self, outer: int, content: _Content) -> dict[str, Any]:
        if outer >= 0:
            values = content.values | {name: self.forms.decode(code) for name, code in content.codes}
            return Variables(self.dicts[outer], values)
        variables = self.engine.new_variables()
        variables.update(content.values)
        for name, code in content.codes:
            variables[name] = self.forms.decode(code)
        self.forms.given[id(variables)] = variables, content
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

    def _wait(self, number: int, item: Form) -> Wait:
        node, place, token, _, child, started, true, paused, due, _, _ = item
        scope = self.all[place]
        wait = Wait(self.keys[number], self.nodes[node], scope, token)
        wait.started, wait.true, wait.paused, wait.due = started, true, paused, due
        if child:
            scope.children[wait] = None
        return wait

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


def waiting_elements(engine: Engine) -> Iterator[tuple[str, str]]:
    """(id, topic or "") of each element that holds a token, in the order of entry; an element may come twice."""
    for instance in engine.instances.values():
        topics = {}
        for wait in instance.waits():
            topics[wait.node.id] = wait.catch.topic
        for element in instance.waiting:
            yield element, topics.get(element, "")
