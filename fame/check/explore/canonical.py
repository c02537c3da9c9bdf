"""The state of an engine as one hashable value (its form), the way back, and the stimuli that it accepts.

Two engines have the same form if they behave the same from now on. A form has two parts, as the state of a program has:
the *control state* (where tokens are and what is armed) and the *data* (the content of each dict of variables). Both
are given by number. A robot has few control states, however many values its variables take.

Keys are replaced by numbers in the order of a walk: scopes and waits are ordered by the position of their nodes in the
program, and by age only where one node has several. Where the order of arming matters it is part of the control state:
listeners of one topic, armed conditions, and all keys while something is suspended. Counts of visits and the counter of
keys are not part of the form.

Invariant: ``canonical(revived(form)) == form``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from operator import attrgetter
from typing import Any

from fame.check.explore.contents import Contents
from fame.check.explore.revival import Revival
from fame.dataclasses import dataclass
from fame.engine.data import Variables
from fame.engine.host import Host
from fame.engine.interpreter import Engine
from fame.engine.program import USER, Node, Program
from fame.engine.snapshot import OF_NO_PROGRAM
from fame.engine.state import Mailbox, Record, Scope, Wait, joins_reached
from fame.engine.tasks import SCRIPT

Control = tuple[Any, ...]
"""A control state, as `Walk.control` makes it."""
Form = tuple[int, tuple[int, ...]]
"""The form of an engine: number of its control state, numbers of the contents of its dicts of variables."""
Keys = dict[int, int]
"""Key in an engine -> key in an engine revived from its form, for waits that the host refers to and armed starts."""


@dataclass(frozen=True, slots=True)
class Stimuli:
    """The stimuli that an engine accepts now.

    scripts  waits of running scripts and services, by key
    timers   nodes of pending timers, by key
    people   user and manual tasks that wait for somebody
    topics   topics with a listener, start events included
    offers   elements of ad-hoc sub-processes that can start
    waiting  (id, topic or "") of each element that holds a token; an element may come twice
    """

    scripts: dict[int, Wait]
    timers: dict[int, Node]
    people: tuple[Wait, ...]
    topics: frozenset[str]
    offers: tuple[str, ...]
    waiting: tuple[tuple[str, str], ...]


def stimuli(engine: Engine) -> Stimuli:
    """Return the stimuli that can change the state of an engine that is not running."""
    scripts, timers = {}, {}
    for key, wait in engine.waits.items():
        if wait.catch.trigger is SCRIPT:
            if wait.started and not wait.paused:
                scripts[key] = wait
        else:
            timers[key] = wait.node
    timers.update(engine.armed_starts)
    people, waiting, adhoc = list[Wait](), list[tuple[str, str]](), False
    for instance in engine.instances.values():
        for wait in instance.waits():
            catch, body = wait.catch, wait.scope.body
            waiting.append((wait.node.id, catch.topic))
            if catch.trigger is USER and not wait.paused and not wait.due:
                people.append(wait)
            if body is not None and body.adhoc is not None:
                adhoc = True
        waiting += [(join.id, "") for _, join, _ in joins_reached(instance.root)]
    topics = frozenset((*engine.listeners, *engine.program.starts))
    offers = tuple(engine.offers()) if adhoc else ()
    return Stimuli(scripts, timers, tuple(people), topics, offers, tuple(waiting))


class Forms:
    """The forms of the engines of one program.

    encode    value of a message or another part of the state -> hashable
    decode    the inverse; gives a new object if the value is mutable
    kept      whether a variable belongs to the form; by default all that are data
    variable  (name, value) of a variable -> hashable; as `encode` by default
    constant  whether `decode` always gives the same immutable value
    fixed     whether nothing can change what `decode` gives
    """

    program: Program
    encode: Callable[[Any], Hashable]
    decode: Callable[[Any], Any]

    def __init__(
        self,
        program: Program,
        encode: Callable[[Any], Hashable],
        decode: Callable[[Any], Any],
        kept: Callable[[str], bool] = lambda name: True,
        variable: Callable[[str, Any], Hashable] | None = None,
        constant: Callable[[Hashable], bool] = lambda code: False,
        fixed: Callable[[Hashable], bool] = lambda code: False,
    ) -> None:
        self.program, self.encode, self.decode = program, encode, decode
        self.contents: Contents = Contents(
            encode, decode, variable or (lambda name, value: encode(value)), kept, constant, fixed
        )
        self.controls: list[Control] = []
        """The control states by number."""
        self._numbers: dict[Control, int] = {}
        self.counts: list[int] = [0] * len(program.elements)
        """Completions of elements, summed over all revived engines."""
        self.nodes: tuple[Node, ...] = (*program.nodes, *OF_NO_PROGRAM)
        self.positions: dict[Node, int] = {node: position for position, node in enumerate(self.nodes)}
        self._shared: dict[Hashable, Hashable] = {}

    def walk(self, engine: Engine) -> Walk:
        """Walk over an engine between two stimuli. Raises RuntimeError if something is being cancelled or held."""
        if engine.ready or engine.cancelling or engine.held is not None:
            raise RuntimeError("a form is taken between two stimuli, when nothing is being cancelled or held")
        return Walk(self, engine)

    def control(self, control: Control) -> int:
        """Return the number of a control state."""
        number = self._numbers.get(control)
        if number is None:
            instances, scopes, waits, *others = control
            share = self._shared.setdefault  # most scopes and waits occur in several control states
            scopes, waits = (tuple([share(each, each) for each in part]) for part in (scopes, waits))
            control = (instances, scopes, waits, *others)
            number = self._numbers[control] = len(self.controls)
            self.controls.append(control)
        return number

    def revived(self, form: Form, host: Host, new_variables: Callable[[], dict[str, Any]], *, moves: int) -> Engine:
        """Return a new engine of that form; `moves` as of `Engine`."""
        return Revival(self, form, Engine(self.program, host, new_variables, moves=moves)).engine


# ---- to the form -------------------------------------------------------------------------------------


_KEY = attrgetter("key")


class Walk:
    """One walk over an engine, which gives its form.

    scopes  all scopes, outer before inner
    waits   all waits, those of outer scopes first; armed ones after what they are armed for
    """

    suspended: bool
    forms: Forms
    engine: Engine
    scopes: list[Scope]
    waits: list[Wait]

    def __init__(self, forms: Forms, engine: Engine) -> None:
        self.forms, self.engine = forms, engine
        self.number: dict[Any, int] = {}  # scope, wait or mailbox -> number, from 1
        self.scopes, self.waits, self.suspended = [], [], False
        self.boxes: list[Mailbox] = []
        self.dicts: dict[int, int] = {}  # id of a dict of variables -> its place
        self.outer: list[int] = []
        self.contents: list[int] = []
        for instance in engine.instances.values():
            self._collect(instance.root)
        waits, number = self.waits, self.number
        for place, wait in enumerate(waits, len(self.scopes) + 1):  # which grows
            number[wait] = place
            if wait.arms:
                waits.extend(wait.arms)
            if wait.box is not None:
                self._collect_box(wait.box)
        for box in self.boxes:
            number[box] = len(number) + 1

    def _collect(self, root: Scope) -> None:
        positions, number, scopes, waits, stack = self.forms.positions, self.number, self.scopes, self.waits, [root]
        while stack:
            scope = stack.pop()
            scopes.append(scope)
            number[scope] = len(scopes)
            if scope.suspender is not None:
                self.suspended = True
            children = [*scope.children]
            if len(children) > 1:
                children.sort(key=lambda child: positions[child.node])  # type: ignore[index]  # children have a node
            inner = []
            for child in children:
                if child.__class__ is Wait:
                    waits.append(child)
                else:
                    inner.append(child)
            if scope.arms:
                waits.extend(scope.arms)
            if scope.mail:
                for box in scope.mail.values():
                    self._collect_box(box)
            if inner:
                stack.extend(reversed(inner))  # type: ignore[arg-type]

    def _collect_box(self, box: Mailbox) -> None:
        if box not in self.boxes:
            self.boxes.append(box)

    def form(self) -> tuple[Form, Keys]:
        """Return the form of the engine, and its keys in a revived engine."""
        engine, positions, number = self.engine, self.forms.positions, self.number
        keys = {key: number[wait] for key, wait in engine.waits.items()}
        named = tuple(sorted(keys.values()))
        starts: Sequence[Any] = ()
        if engine.armed_starts:
            starts = sorted(engine.armed_starts.items(), key=lambda item: positions[item[1]])
            keys.update((key, place) for place, (key, _) in enumerate(starts, len(number) + 1))
        ranks = self._ranks() if self.suspended else ()
        if ranks:
            keys = {key: ranks[place - 1] if place <= len(ranks) else place for key, place in keys.items()}
        mail = self._mail_ranks() if self.boxes or engine.waiting_starts else {}
        control = (
            tuple([(number[one.root], self._dict(one.root_variables)) for one in engine.instances.values()]),
            self._scopes(),
            self._waits(),
            tuple([self._box(box, mail) for box in self.boxes]) if self.boxes else (),
            tuple([number[each] for topic in sorted(engine.listeners) for each in engine.listeners[topic]]),
            tuple([number[wait] for wait in engine.conditions]) if engine.conditions else (),
            named,
            tuple(sorted([number[scope] for scope in engine.inclusive])) if engine.inclusive else (),
            tuple([node for _, node in starts]),
            self._waiting_starts(mail) if engine.waiting_starts else (),
            self._gathered() if engine.gathered else (),
            ranks,
            tuple(self.outer),
        )
        return (self.forms.control(control), tuple(self.contents)), keys

    def _scopes(self) -> Control:
        number, positions = self.number, self.forms.positions
        scopes = []
        for scope in self.scopes:
            joins, rare = scope.joins, None
            if scope.mail or scope.handles or scope.suspender or scope.held or scope.items is not None or scope.done:
                rare = self._rare(scope)
            scopes.append((
                number.get(scope.parent, 0),
                scope.node,
                scope.body,
                self._dict(scope.variables),
                scope.tokens,
                scope.state,
                tuple(sorted([(positions[join], tuple(counts)) for join, counts in joins.items()])) if joins else (),
                rare,
            ))  # fmt: skip
        return tuple(scopes)

    def _rare(self, scope: Scope) -> Hashable:
        """Return the fields that are empty in most scopes."""
        number = self.number
        return (
            tuple([number[box] for box in scope.mail.values()]) if scope.mail is not None else None,
            scope.handles,
            number[scope.suspender] if scope.suspender is not None else 0,
            scope.held,
            None if scope.items is None else self.forms.encode(scope.items),
            None if scope.done is None else tuple(map(self._record, scope.done)),
        )

    def _record(self, record: Record) -> Hashable:
        return (record.node, self._dict(record.variables), tuple(map(self._record, record.inner)))

    def _waits(self) -> Control:
        number, waits = self.number, self.waits
        return tuple([(
            wait.node,
            number[wait.scope],
            wait.token,
            number.get(wait.owner, 0),
            wait.started,
            wait.true,
            wait.paused,
            1 + sum(0 < other.due < wait.due for other in waits) if wait.due else 0,
            number.get(wait.box, 0),
        ) for wait in waits])  # fmt: skip

    def _box(self, box: Mailbox, ranks: dict[int, int]) -> Hashable:
        encode, number = self.forms.encode, self.number
        return (
            box.node,
            number[box.scope],
            tuple([(ranks[key], encode(message)) for key, message in box.messages]),
            box.passed,
        )

    def _mail_ranks(self) -> dict[int, int]:
        """Return the order of arrival of queued messages."""
        kept = [key for box in self.boxes for key, _ in box.messages]
        kept += [key for messages in self.engine.waiting_starts.values() for key, _ in messages]
        return {key: rank + 1 for rank, key in enumerate(sorted(kept))}

    def _waiting_starts(self, ranks: dict[int, int]) -> Hashable:
        encode, positions = self.forms.encode, self.forms.positions
        starts = sorted(self.engine.waiting_starts.items(), key=lambda item: positions[item[0]])
        return tuple([(node, tuple([(ranks[key], encode(message)) for key, message in kept])) for node, kept in starts])

    def _gathered(self) -> Hashable:
        encode, positions = self.forms.encode, self.forms.positions
        return tuple(
            (whole, tuple((encode(keys), tuple((one, encode(m)) for one, m in found.items())) for keys, found in sets))
            for whole, sets in sorted(self.engine.gathered.items(), key=lambda item: positions[item[0]])
        )

    def _ranks(self) -> tuple[int, ...]:
        """Return the place of each number in the order of age, from 1."""
        number = self.number
        ranks = [0] * len(number)
        for rank, key in enumerate(sorted(number, key=_KEY), 1):
            ranks[number[key] - 1] = rank
        return tuple(ranks)

    def _dict(self, variables: dict[str, Any]) -> int:
        """Return the place of a dict of variables; outer dicts come first."""
        place = self.dicts.get(id(variables))
        if place is not None:
            return place
        outer = self._dict(variables.outer) if isinstance(variables, Variables) else -1
        place = self.dicts[id(variables)] = len(self.outer)
        self.outer.append(outer)
        self.contents.append(self.forms.contents.number(variables))
        return place

    def dissolve(self) -> None:
        """Take the engine apart, so that it is freed at once: its parts refer to each other."""
        del self.engine.emit
        for instance in self.engine.instances.values():
            del instance.root
        for scope in self.scopes:
            scope.children.clear()
            if scope.arms:
                scope.arms = ()
            if scope.mail:
                scope.mail = None
            if scope.suspender:
                scope.suspender = None
        for wait in self.waits:
            if wait.arms:
                wait.arms = ()
            if wait.box:
                wait.box = None
