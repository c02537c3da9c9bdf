"""Runs: the steps that lead to a state of the team, in the terms of the model.

The search keeps no steps, only from which state each other was found first. A run is made again from these: the
transitions of each state are computed once more, and the one that leads on is taken. Where equal robots were sorted,
each keeps its own name through the run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterator, Sequence, Set
from typing import NamedTuple

from fame.check.explore.graph import Explored, shortest
from fame.check.explore.product import Product
from fame.check.explore.transitions import BITS, CUT, MASK, Move, Seen, Transition
from fame.check.explore.values import LENGTHS
from fame.check.explore.views import element_of
from fame.dataclasses import dataclass, field, replace
from fame.errors import display_name

_MOST_THROWS = 8
"""Messages of a step that are listed one by one."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where an element is: its file, line and label."""

    element: str
    file: str = ""
    line: int = 0
    name: str = ""

    @property
    def label(self) -> str:
        """The element in the steps of a run: its label, or its id if it has none."""
        return f'"{" ".join(self.name.split())}"' if self.name else self.element

    @property
    def display_name(self) -> str:
        """The element in a finding: label and id."""
        return display_name(self.element, self.name)


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a run.

    robot      who does it
    kind       ``end``, ``fail``, ``timer``, ``person``, ``offer``, ``outside``, ``receive``, ``miss``, ``loss``,
               ``die``, ``block`` or ``start``
    element    the element concerned, empty for a message
    detail     error code, or topic
    throws     (topic, value for people) of each message that is sent
    choices    (element, chosen, ways) of each decision about something unknown
    waits      (robot, element) of each token of the team after it
    """

    robot: str
    kind: str
    element: str = ""
    detail: str = ""
    text: str = ""
    throws: tuple[tuple[str, str], ...] = ()
    choices: tuple[tuple[str, int, int], ...] = ()
    waits: tuple[tuple[str, str], ...] = field(default=(), compare=False, repr=False)

    def __str__(self) -> str:
        return self.text


class TracedRun(NamedTuple):
    """A run: its steps, the numbers of the states after each, and the robot at each place in the end."""

    steps: list[Step]
    after: list[tuple[int, ...]]
    names: list[str]


@dataclass(slots=True)
class Runs:
    """Makes runs of what a search has found. `places` are the elements by id."""

    product: Product
    explored: Explored
    places: dict[str, Place] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.product.alone = self.product.first_arrivals = None  # they depend on what was explored at the time

    def place(self, element: str) -> Place:
        """Where an element is."""
        return self.places.get(element) or Place(element)

    def to(self, at: int, last: Transition | None = None) -> TracedRun:
        """Return the shortest run to a state; `last` follows it."""
        return self.along(self.chain(at), last=last)

    def along(self, chain: Sequence[int], error: str = "", last: Transition | None = None) -> TracedRun:
        """Return the run through some states; where one needs an uncaught error more, that of the
        element `error` if it can.

        States are several after a step behind which the search went on at once, see `Reduction.settled`.
        """
        names = list(self.product.robots)
        steps: list[Step] = []
        after: list[tuple[int, ...]] = []
        before: int | None = None
        layer, layers = 0, map(self.explored.layer, chain)
        for number, needed in zip(chain, layers, strict=True):
            transitions = self._leading(before, self.explored.states[number], error if needed > layer else None)
            layer = needed
            for transition in transitions:
                numbers = (number,) if transition is transitions[-1] else self._numbers(transition)
                self._add(steps, after, transition, names, numbers, before)
                before = transition[0]
            names = self._renamed(transition[0], names)
            before = self.explored.states[number]
        if last is not None:
            self._add(steps, after, last, names, (), before)
        return TracedRun(steps, after, names)

    def seen(self, seen: Seen) -> list[Step]:
        """Return the run to the first occurrence of something."""
        return self.to(seen.at, seen.transition).steps

    def without_loss(self, topics: Set[str], goals: Container[int]) -> list[int]:
        """Return a way to one of some states on which no robot misses a message on one of some
        topics; empty if none is known.

        It leads through the states that were explored without an uncaught error.
        """
        product = self.product

        def after(at: int) -> Iterator[int]:
            for transition in product.transitions(self.explored.states[at]) if at >= 0 else product.initial():
                for end in self._settled(transition):
                    new = product.number(end)
                    between = product.between(transition[0], end) if product.between else ()
                    if (
                        new is not None
                        and not self.explored.layer(new)
                        and not any(_misses(one, topics) for one in (transition, *between))
                    ):
                        yield new

        return shortest([-1], goals, after)[1:]

    def chain(self, at: int) -> list[int]:
        """Return the numbers of the states on the shortest way to one."""
        chain = []
        while at >= 0:
            chain.append(at)
            at = self.explored.parents[at]
        return chain[::-1]

    def _numbers(self, transition: Transition) -> tuple[int, ...]:
        """The numbers of the states to which the search went at once after a transition; empty if one is not known."""
        product = self.product
        numbers = [product.number(state) for state in self._settled(transition)]
        return tuple(one for one in numbers if one is not None) if None not in numbers else ()

    def _leading(self, before: int | None, state: int, error: str | None) -> list[Transition]:
        """The transitions from one state to the next: one, and those that followed at once.

        One without an uncaught error, or, unless `error` is None, one with an error, best with that of an element.
        """
        product = self.product
        if before is None:
            transitions = product.initial()
        else:
            transitions = product.transitions(before)
            if product.options.faults and not product.fault_of(before):
                product.add_faults(before, transitions)
        ways = [(transition, end) for transition in transitions for end in self._settled(transition)
                if product.symmetry.canonical(end) == state]  # fmt: skip
        if not ways:
            raise LookupError("no transition leads to the next state")

        def unlike(way: tuple[Transition, int]) -> tuple[int, bool]:
            _, robot, move, reactions = way[0]
            failed = [element for _, done in ((robot, move), *reactions) for element in done.failed]
            return len(failed) if error is None else 0 if error in failed else 1 if failed else 2, _misses(way[0])

        transition, end = min(ways, key=unlike)
        return [transition, *(product.between(transition[0], end) if product.between else ())]

    def _settled(self, transition: Transition) -> Sequence[int]:
        """The states to which the search went at once after a transition."""
        return self.product.settled(transition) if self.product.settled else (transition[0],)

    def _renamed(self, state: int, names: list[str]) -> list[str]:
        """The names by place, once equal robots are sorted."""
        names = list(names)
        for group in self.product.options.groups:
            order = self.product.symmetry.order(state, group)
            if order is not None:
                old = [names[robot] for robot in group]
                for place, robot in enumerate(group):
                    names[robot] = old[order[place]]
                state = self.product.symmetry.permuted(state, group, order)
        return names

    def _add(self, steps: list[Step], after: list[tuple[int, ...]], transition: Transition, names: Sequence[str],
             numbers: tuple[int, ...], before: int | None) -> None:  # fmt: skip
        for step in self._steps(transition, names, before):
            steps.append(step)
            after.append(numbers)

    def _steps(self, transition: Transition, names: Sequence[str], state: int | None) -> Iterator[Step]:
        _, robot, move, reactions = transition
        olds = self.product.locals_of(state) if state is not None else [0] * self.product.count
        for place, done in ((robot, move), *reactions):
            step = self._step(place, names[place], olds[place], done)
            if done.stimulus[0] != "loss":
                olds[place] = done.state
            if step is not None:
                yield replace(step, waits=tuple(self._waits(names, olds)))

    def _waits(self, names: Sequence[str], states: Sequence[int]) -> Iterator[tuple[str, str]]:
        for name, local, state in zip(names, self.product.locals, states, strict=True):
            for element, _ in local.views[state].waiting if state < len(local.views) else ():
                yield name, element

    def _step(self, place: int, robot: str, old: int, move: Move) -> Step | None:
        if old >= CUT:
            return None
        local, given = self.product.locals[place], self.product.options.given.get(place)
        kind, what, detail = move.stimulus
        element, code = "", ""
        match kind:
            case "end":
                element = element_of(local.views[old], move.stimulus)
                kind, code = ("end", "") if detail is None else ("fail", detail)
                text = f"{robot}'s {self._label(element)} " + (f"fails: {code}" if code else "ends")
            case "timer":
                element = element_of(local.views[old], move.stimulus)
                text = f"{robot}'s timer {self._label(element)} fires"
            case "person":
                element = what
                text = f"a person completes {robot}'s {self._label(element)}"
            case "offer":
                element = what
                text = f"a person starts {robot}'s {self._label(element)}"
            case "block":
                element = element_of(local.views[old], move.stimulus)
                text = f"{robot}'s {self._label(element)} never ends"
            case "die":
                text = f"{robot}'s engine dies"
            case "outside":
                code = what
                text = f"a message on {what} reaches {robot} from outside"
            case "loss":
                code = what
                text = f"{what} is lost on its way to {robot}"
            case "hear":
                missed = any(one in ("lost", "unneeded") for one, _ in move.successor.flags)
                kind, code = ("miss" if missed else "receive"), what
                text = f"{robot} misses {what}: it does not listen" if missed else f"{robot} receives {what}"
            case _:
                text = f"{robot} starts" if given is None else f"{robot} continues"
        throws = tuple((topic, local.values.text(number)) for topic, number, _ in move.successor.sent)
        if throws:
            text += ", " + ", ".join(f"throws {topic}" for topic in _topics([topic for topic, _ in throws]))
        failures = [what.partition("\n") for one, what in move.successor.flags if one == "error"]
        for failed, _, why in failures:
            text += f"; {self._label(failed)} fails: {why}" if failed != element else ""
        start = kind == "start"
        choices = (
            ()
            if kind == "loss"
            else local.decisions(None if start else old, None if start else move.stimulus, move.successor, given)
        )
        if start and not throws and not failures and not choices:
            return None
        for repeated, items in dict.fromkeys((where, chosen) for where, chosen, ways in choices if ways is LENGTHS):
            text += f"; {self._label(repeated)}: {items or 'no'} item{'s' * (items != 1)}"
        return Step(robot, kind, element, code, text, throws, tuple(choices))

    def _label(self, element: str) -> str:
        return self.place(element).label


def _topics(thrown: Sequence[str]) -> Iterator[str]:
    """The topics that a step throws, in order; of many, each once, with how often."""
    if len(thrown) <= _MOST_THROWS:
        yield from thrown
        return
    for topic, count in Counter(thrown).items():
        yield f"{topic}, {count:,} times" if count > 1 else topic


def _misses(transition: Transition, topics: Set[str] | None = None) -> bool:
    """Whether a robot misses a message in a transition, on one of some topics."""
    _, _, move, reactions = transition
    return any(
        done.stimulus[0] == "hear"
        and (topics is None or done.stimulus[1] in topics)
        and any(kind in ("lost", "unneeded") for kind, _ in done.successor.flags)
        for done in (move, *(done for _, done in reactions))
    )


def waiting(product: Product, state: int) -> list[tuple[int, tuple[tuple[str, str], ...]]]:
    """Return the robots that are not done in a state, by place, with (element, topic or "") of what each waits at."""
    waits = []
    for robot in range(product.count):
        old = state >> (robot * BITS) & MASK
        views = product.locals[robot].views
        if old < len(views) and views[old].instances:
            waits.append((robot, views[old].waiting))
    return waits
