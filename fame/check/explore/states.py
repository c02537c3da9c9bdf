"""The states of one robot, by number: the canonical form of its engine, with its pending timers.

What nothing reads any more is left out (`fame.check.explore.liveness`), and a variable that takes too many values is
unknown from then on. A state that grows without bound has no number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from fame.check.explore.canonical import Form, Forms, Keys, Stimuli, stimuli
from fame.check.explore.footprints import Effect
from fame.check.explore.growth import growth
from fame.check.explore.host import ExplorationHost
from fame.check.explore.liveness import Dead, Liveness
from fame.check.explore.timers import Timers, canonical_timers
from fame.check.explore.values import UNKNOWN, Values
from fame.check.explore.views import Interned, View, view_of
from fame.engine import Engine, Instance, Program

MOST_VALUES = 64
"""Values of one variable, after which further ones are unknown."""

BITS = 20
MASK = (1 << BITS) - 1
CUT = MASK - 1
"""The number of all states that are not explored: too many instances, tokens or ways."""

LocalState = tuple[Form, Timers]


class States:
    """The states that a program was in so far, each with its view.

    all      the states by number, from 0
    views    what can happen in each
    grown    what has grown without bound, see `growth`
    widened  variables that have too many values
    """

    program: Program
    host: ExplorationHost
    values: Values

    def __init__(self, program: Program, host: ExplorationHost, outside: Sequence[str], liveness: Liveness) -> None:
        self.program, self.host = program, host
        self.all: list[LocalState] = []
        self.views: list[View] = []
        self.grown: set[tuple[str, str]] = set()
        self.widened: set[str] = set()
        self.values = values = host.values
        self.forms: Forms = Forms(
            program, values.number, values.value, host.kept, self.variable, values.is_constant, values.is_fixed
        )
        self._outside, self._liveness = outside, liveness
        self._numbers: dict[LocalState, int] = {}
        self._views: dict[tuple[int, Timers], View] = {}
        self._topic_sets: Interned = {}
        self._dead: dict[int, Dead] = {}  # control state -> variables that nothing reads any more
        self._live: dict[tuple[int, int], int] = {}  # (control state, content) -> content without their values
        self._seen: dict[str, set[int]] = {}
        self._entered: set[str] = set()

    def number(self, engine: Engine) -> int | None:
        """Return the number of the state that an engine is in; None if it is one that grows without bound."""
        walk = self.forms.walk(engine)
        grown = growth(engine, walk.scopes)
        if grown is not None:
            self.grown.add(grown)
            return None
        form, keys = walk.form()
        accepted: Stimuli | None = None
        if form[0] not in self._dead:
            accepted = stimuli(engine)
            tokens = [element for element, _ in accepted.waiting]
            tokens += [node.id for scope in walk.scopes for node in scope.held]  # which go on after a suspension
            self._dead[form[0]] = self._liveness.dead(tokens)
        form = self._without_dead(form)
        state = (form, canonical_timers(self.host.timers, keys)) if self.host.timers else (form, ())
        number = self._numbers.get(state)
        if number is None:
            number = self._add(state, self._view(engine, form, keys, state[1], accepted))
        walk.dissolve()
        return number

    def after(self, content: int, effect: Effect) -> int:
        """Return the number of the state after a step with that effect on variables with that content."""
        control, timers, changes = effect[:3]
        contents = () if changes is None else (self.forms.contents.changed(content, changes),)
        state = (self._without_dead((control, contents)), timers)
        number = self._numbers.get(state)
        if number is None:
            number = self._add(state, self._views[control, timers])
        return number

    def _without_dead(self, form: Form) -> Form:
        """A form without the values that nothing reads any more."""
        control, contents = form
        (dead, unused), live = self._dead[control], self._live
        if not dead and not unused:
            return form
        left = []
        for content in contents:
            forgotten = live.get((control, content))
            if forgotten is None:
                forgotten = live[control, content] = self.forms.contents.forgotten(content, dead, UNKNOWN, unused)
            left.append(forgotten)
        return control, tuple(left)

    def _add(self, state: LocalState, view: View) -> int:
        number = self._numbers[state] = len(self.all)
        self.all.append(state)
        self.views.append(view)
        return number

    def variable(self, name: str, value: Any) -> int:
        """Return the number of a variable's value; one that has too many of them is unknown from then on."""
        number = self.values.number(value)
        seen = self._seen.get(name)
        if seen is None:
            seen = self._seen[name] = set()
        if number not in seen:
            if len(seen) >= MOST_VALUES:
                self.widened.add(name)
                return UNKNOWN
            seen.add(number)
        return number

    def _view(self, engine: Engine, form: Form, keys: Keys, timers: Timers, accepted: Stimuli | None) -> View:
        """What can happen in the state that an engine is in, which its control state and timers decide.

        `accepted` are the engine's stimuli, if they are known.
        """
        known = self._views.get((form[0], timers))
        if known is None:
            made = view_of(engine, keys, accepted or stimuli(engine), self.host, self._outside, self._topic_sets)
            known = self._views[form[0], timers] = made
        return known

    @property
    def visited(self) -> set[str]:
        """The elements that a token has entered so far."""
        elements = self.program.elements
        visited = (
            self._entered
            | self.host.entered
            | {elements[slot] for slot, count in enumerate(self.forms.counts) if count}
        )
        handlers = [(node.id, node.body) for source in self.program.sources for node in source.body.walk()
                    if node.triggered_by_event and node.body is not None]  # fmt: skip
        return visited | {id for id, body in handlers if any(inner.id in visited for inner in body.walk())}

    def note_begun(self, begun: Iterable[Instance]) -> None:
        """Count what instances that have begun have passed; all others count together."""
        elements = self.program.elements
        for instance in begun:
            self._entered |= {elements[slot] for slot, count in enumerate(instance.counts) if count}
