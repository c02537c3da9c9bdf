"""The state of an engine as one hashable value (its form), the way back, and the stimuli that it accepts.

Two engines have the same form if they behave the same from now on. Keys are replaced by numbers in the order of a walk:
scopes and waits are ordered by the position of their nodes in the program, and by age only where one node has several.
Where the order of arming matters it is part of the form: listeners of one topic, armed conditions, and all keys while
something is suspended. Counts of visits and the counter of keys are not part of the form.

Invariant: ``canonical(revived(form)) == form``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from fame.engine.data import Variables
from fame.engine.host import Host
from fame.engine.interpreter import Engine
from fame.engine.program import USER, Body, Node, Program
from fame.engine.revival import Content, Given, Revival
from fame.engine.snapshot import OF_NO_PROGRAM, is_data
from fame.engine.state import Mailbox, Record, Scope, Wait
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
        self.contents: list[Content] = []
        self._content_numbers: dict[Form, int] = {}
        self.given: dict[int, Given] = {}
        """The dicts of variables of the engine that was restored last, by id."""
        self.program, self.encode, self.decode, self.kept = program, encode, decode, kept
        self.nodes: tuple[Node, ...] = (*program.nodes, *OF_NO_PROGRAM)
        self.numbers: dict[Node, int] = {node: number for number, node in enumerate(self.nodes)}
        self.bodies: list[Body] = [program.body, *(node.body for node in program.nodes if node.body is not None)]
        self.body_numbers: dict[Body, int] = {body: place for place, body in reversed(list(enumerate(self.bodies)))}

    def walk(self, engine: Engine) -> Walk:
        """A walk over an engine that is not running, which gives its form. No script may be ending."""
        if engine.ready or engine.cancelling or engine.held is not None:
            raise RuntimeError("a form is taken between two stimuli, when nothing is being cancelled or held")
        return Walk(self, engine)

    def content(self, own: Form) -> int:
        """The number of the content of a dict of variables: (name, code), sorted."""
        number = self._content_numbers.get(own)
        if number is None:
            number = self._content_numbers[own] = len(self.contents)
            self.contents.append(Content(number, own, self))
        return number

    def revived(self, form: Form, host: Host, new_variables: Callable[[], dict[str, Any]], *, moves: int) -> Engine:
        """A new engine of that form; `moves` as of `Engine`."""
        return Revival(self, form, Engine(self.program, host, new_variables, moves=moves)).engine


# ---- to the form -------------------------------------------------------------------------------------


_KEY = attrgetter("key")


class Walk:
    """One walk over an engine, which gives its form.

    scopes  all scopes, outer before inner
    """

    scopes: list[Scope]

    def __init__(self, forms: Forms, engine: Engine) -> None:
        self.forms, self.engine, self.nodes = forms, engine, forms.numbers
        self.number: dict[Any, int] = {}  # scope, wait or mailbox -> number, from 1
        self.scopes = []
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
        """The form of the engine, and the numbers of its keys."""
        engine, nodes, number = self.engine, self.nodes, self.number
        for box in self.boxes:
            number[box] = len(number) + 1
        starts = sorted(engine.armed_starts.items(), key=lambda item: nodes[item[1]])
        keys = {wait.key: number[wait] for wait in self.waits}
        first = len(number) + 1
        keys.update((key, first + place) for place, (key, _) in enumerate(starts))
        mail = self._mail_ranks() if self.boxes or engine.waiting_starts else {}
        listeners = tuple(
            (topic, tuple([number[each] for each in found])) for topic, found in sorted(engine.listeners.items())
        )
        form = (
            tuple([(number[one.root], self._dict(one.root_variables)) for one in engine.instances.values()]),
            tuple([self._scope(scope) for scope in self.scopes]),
            self._waits(),
            tuple([self._box(box, mail) for box in self.boxes]) if self.boxes else (),
            listeners,
            tuple([number[wait] for wait in engine.conditions]) if engine.conditions else (),
            tuple(sorted([number[wait] for wait in engine.waits.values()])),
            tuple(sorted([number[scope] for scope in engine.inclusive])) if engine.inclusive else (),
            tuple([nodes[node] for _, node in starts]),
            self._waiting_starts(mail) if engine.waiting_starts else (),
            self._gathered() if engine.gathered else (),
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
        given = forms.given.get(id(variables))
        changed = given.changed() if given is not None else None
        if given is None or changed is None:
            codes = self._codes(variables, variables)
        else:
            known, fresh = given.content.known, self._codes(variables, changed)
            if all(known.get(name) == fresh.get(name) for name in changed):  # both None for what is not in the form
                return given.content.number
            codes = {name: code for name, code in known.items() if name not in changed} | fresh
        return forms.content(tuple(sorted(codes.items())))

    def _codes(self, variables: dict[str, Any], names: Iterable[str]) -> dict[str, Hashable]:
        """The codes of those of these variables that belong to the form."""
        encode, kept = self.forms.variable, self.forms.kept
        found = dict[str, Hashable]()
        for name in names:
            if kept(name) and is_data(name, value := variables[name]):
                found[name] = encode(name, value)
        return found

    def dissolve(self) -> None:
        """Take the engine apart, so that it is freed at once: its parts refer to each other."""
        del self.engine.emit
        for instance in self.engine.instances.values():
            del instance.root
        for scope in self.scopes:
            scope.children.clear()
            scope.arms, scope.mail, scope.suspender = (), None, None
        for wait in self.waits:
            wait.arms, wait.box = (), None

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

    def _waits(self) -> Form:
        nodes, number = self.nodes, self.number
        found = []
        for wait in self.waits:
            scope, owner, arms, box = wait.scope, wait.owner, wait.arms, wait.box
            found.append((
                nodes[wait.node],
                number[scope],
                wait.token,
                number[owner] if owner is not None else 0,
                wait in scope.children,
                wait.started,
                wait.true,
                wait.paused,
                1 + sum(0 < other.due < wait.due for other in self.waits) if wait.due else 0,
                tuple([number[arm] for arm in arms]) if arms else (),
                number[box] if box is not None else 0,
            ))  # fmt: skip
        return tuple(found)

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


def waiting_elements(engine: Engine) -> Iterator[tuple[str, str]]:
    """(id, topic or "") of each element that holds a token, in the order of entry; an element may come twice."""
    for instance in engine.instances.values():
        topics = {}
        for wait in instance.waits():
            topics[wait.node.id] = wait.catch.topic
        for element in instance.waiting:
            yield element, topics.get(element, "")
