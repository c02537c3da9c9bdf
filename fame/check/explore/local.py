"""The transitions of one robot, computed by the engine that runs it, and remembered.

A local state is the canonical form of the robot's engine with its pending timers, by number. `Local.step` makes an
engine of a state, gives it a stimulus and notes the new state and what was sent. Where a value is unknown the step is
run once for each way: with a longer and longer list of decisions. A step whose footprint is known needs no engine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from fame.bpmn.model import Definitions, Process
from fame.check.explore.abstraction import Abstraction, Step
from fame.check.explore.footprints import Effect, Footprints, Watched
from fame.check.explore.host import MOST_DECISIONS, ExplorationHost, Flag, Outcome, Running, Send, Timer
from fame.check.explore.liveness import Dead, Liveness
from fame.check.explore.running_states import load_known
from fame.check.explore.values import UNKNOWN, Values
from fame.engine import Engine, compile_program, restore
from fame.engine.canonical import Form, Forms, Keys, Stimuli, stimuli
from fame.engine.host import BpmnError, Host
from fame.engine.migration import arm_new
from fame.engine.program import LoopInstance
from fame.engine.snapshot import Data
from fame.engine.state import Scope, Wait, scopes_of
from fame.engine.tasks import SCRIPT

Stimulus = tuple[str, Any, Any]
"""What happens to a robot: (kind, key or element or topic, code or message number).

``end`` and ``block`` of a step by key, ``timer`` by key, ``person`` and ``offer`` by element, ``hear`` and ``outside``
by topic.
"""

MOST_INSTANCES = 4
"""Instances of a process at a time beyond which it counts as growing without bound."""
MOST_AT_ONE_PLACE = 3
"""Tokens and handlers at one element of one scope beyond which they count as growing without bound."""
MOST_VALUES = 64
"""Values of one variable, after which further ones are unknown."""
MOST_MOVES = 20_000
"""Moves of tokens within one step, after which it is a livelock."""
MOST_WAYS = 300
"""Ways that one step may go."""


class Way(NamedTuple):
    """One way that a step may go: the new state, what was sent, what is to be reported, whether an instance begins.

    `quiet`: nothing was published, not even for the robot itself.
    """

    state: int
    sent: tuple[Send, ...]
    flags: tuple[Flag, ...]
    begins: bool
    quiet: bool = True


@dataclass(frozen=True, slots=True)
class View:
    """What the product needs to know of a local state.

    own        stimuli that may come at any time, and the `elements` that they are for ("": for a topic)
    listens    topics that it takes now
    hears      those of them on which a message may have an effect: it is not just dropped as a start trigger
    listeners  how many tokens and handlers listen to each topic
    instances  how many instances run
    waiting    (element, topic or "") of each token
    """

    own: tuple[Stimulus, ...]
    elements: tuple[str, ...]
    listens: frozenset[str]
    hears: frozenset[str]
    listeners: tuple[tuple[str, int], ...]
    instances: int
    waiting: tuple[tuple[str, str], ...]


Timers = tuple[tuple[int, int, float, float | None], ...]
"""Pending timers: (key, group, offset, period)."""
State = tuple[Form, Timers]


class Local:
    """The states of one robot, or of several that nothing tells apart, by number from 0."""

    robot: str
    process: Process
    values: Values
    host: ExplorationHost
    forms: Forms

    def __init__(self, robot: str, definitions: Definitions, process: Process, model: Abstraction, values: Values, *,
                 kept: frozenset[str], fields: frozenset[str], robots: tuple[str, ...],
                 ordered: bool, observed: bool = False) -> None:  # fmt: skip
        self.robot, self.process, self.values = robot, process, values
        self.host = ExplorationHost(robot, model.types, values, model.steps, model.matters, fields, robots, ordered)
        self.kept = kept
        self.host.kept = kept.__contains__
        host: Host = self.host
        explored = model.process(definitions, process)
        self.body = explored.body
        file = definitions.file
        self.program = compile_program(explored, host=host, library=model.find, file=file, observed=observed)
        catches = [node.catch for node in self.program.nodes if node.catch is not None]
        self.topics: frozenset[str] = frozenset(catch.topic for catch in catches if catch.topic)
        self.host.own_topics = self.topics
        self.outside: tuple[str, ...] = tuple(sorted(self.topics & model.outside))
        self._seen: dict[str, set[int]] = {}
        self.widened: set[str] = set()
        self.forms = Forms(
            self.program, values.number, values.value, kept.__contains__, self._variable, values.is_constant
        )
        self.elements: dict[str, Any] = {node.id: node for node in reversed(self.program.nodes) if node.id}
        self._entered: set[str] = set()
        self.cut: set[str] = set()
        self.steps = 0
        self._numbers: dict[State, int] = {}
        self._states: list[State] = []
        self._topic_sets: dict[frozenset[str], frozenset[str]] = {}
        self.views: list[View] = []
        self._views: dict[tuple[int, Timers], View] = {}
        self._liveness = Liveness(definitions, process, model, kept)
        self._dead: dict[int, Dead] = {}  # control state -> variables that nothing reads any more
        self._live: dict[tuple[int, int], int] = {}  # (control state, content) -> content without their values
        self._memo: dict[tuple[int, Stimulus], tuple[Way, ...]] = {}
        self._footprints = Footprints(self.forms.contents.codes)
        self._watched: Watched | None = None

    def __len__(self) -> int:
        return len(self._states)

    # ---- steps ---------------------------------------------------------------------------------------

    def start(self, given: Data | None = None) -> tuple[Way, ...]:
        """The ways in which the robot may start, or go on from a snapshot of this program."""
        return self._explored(*self._first(given))

    def step(self, state: int, stimulus: Stimulus) -> tuple[Way, ...]:
        """The ways that a stimulus may go in a state."""
        key = (state, stimulus)
        found = self._memo.get(key)
        if found is None:
            found = self._memo[key] = self._new_step(state, stimulus)
        return found

    def computed(
        self, state: int, stimulus: Stimulus, keep: Callable[[Way, Outcome], object] | None = None
    ) -> tuple[Way, ...]:
        """The same, by an engine."""
        return self._explored(lambda: self.revived(state), lambda engine: self._apply(engine, stimulus), keep)

    def _new_step(self, state: int, stimulus: Stimulus) -> tuple[Way, ...]:
        """The ways of a step: by its footprint if that is known, else by an engine."""
        kind, topic, _ = stimulus
        view = self.views[state]
        if kind == "hear" and topic not in view.listens:  # the engine would drop the message
            self.steps += 1
            return (Way(state, (), (("lost" if view.instances else "unneeded", topic),), False),)
        (control, contents), timers = self._states[state]
        if not self._is_watched(contents):
            return self.computed(state, stimulus)
        content, step = contents[0], (control, timers, stimulus)
        known = self._footprints.find(step, content)
        if known is not None:
            return tuple(dict.fromkeys([self._way(content, effect) for effect in known]))
        reads, effects, before = set[str](), list[Effect](), self.steps

        def note(way: Way, outcome: Outcome) -> None:
            watched, ((after, left), rest) = self._watched, self._states[way.state]
            if watched is not None and not watched.whole and not outcome.begun and len(left) < 2:
                reads.update(watched.reads)
                changes = self.forms.contents.difference(content, left[0], watched.writes) if left else None
                effects.append(Effect(after, rest, changes, way.sent, way.flags, way.quiet))

        found = self.computed(state, stimulus, note)
        if len(effects) == self.steps - before and len(found) <= MOST_WAYS:  # all was noted
            self._footprints.add(step, content, reads, effects)
        return found

    def _is_watched(self, contents: tuple[int, ...]) -> bool:
        """Whether footprints of steps are noted: of one instance, without variables of inner scopes."""
        return len(contents) == 1 and self.host.traceable and not self.forms.contents.is_empty(contents[0])

    def _way(self, content: int, effect: Effect) -> Way:
        """The way that a step goes in a state with that content."""
        self.steps += 1
        control, timers, changes, sent, flags, quiet = effect
        contents = () if changes is None else (self.forms.contents.changed(content, changes),)
        state = (self._without_dead((control, contents)), timers)
        number = self._numbers.get(state)
        if number is None:
            number = self._add(state, self._views[control, timers])
        return Way(number, sent, flags, False, quiet)

    def chosen(
        self, state: int | None, stimulus: Stimulus | None, way: Way, given: Data | None = None
    ) -> list[tuple[str, int, int]]:
        """The decisions by which a step goes that way: (element, chosen, ways), for a trace.

        Without a state it is the first step, see `start`.
        """
        found: list[list[tuple[str, int, int]]] = []

        def keep(one: Way, outcome: Outcome) -> None:
            if one == way:
                found.append(outcome.choices)

        if state is None or stimulus is None:
            self._explored(*self._first(given), keep)
        else:
            self.computed(state, stimulus, keep)
        return found[0] if found else []

    def _first(self, given: Data | None) -> tuple[Callable[[], Engine], Callable[[Engine], object]]:
        """How the first step is taken."""
        if given is None:
            return self._new, lambda engine: engine.begin({})
        return lambda: self._restored(given), _go_on

    def _restored(self, data: Data) -> Engine:
        """The engine of a snapshot; of its timers no times are known."""
        self.host.reset()
        host, unknown = self.host, self.values.unknown
        outside: Host = host
        engine = restore(self.program, data, outside, host.new_variables, load=lambda value: load_known(value, unknown))
        engine.limit = engine.portion = MOST_MOVES
        pending = {key: wait.catch for key, wait in engine.waits.items() if wait.catch.trigger is not SCRIPT}
        pending |= {key: node.catch for key, node in engine.armed_starts.items() if node.catch is not None}
        host.timers = {
            key: Timer(("alone", key), 0.0, 1.0 if catch.timer == "cycle" else None) for key, catch in pending.items()
        }
        host.engine = engine
        return engine

    def _new(self) -> Engine:
        self.host.reset()
        host: Host = self.host
        self.host.engine = Engine(self.program, host, self.host.new_variables, moves=MOST_MOVES)
        return self.host.engine

    def revived(self, state: int) -> Engine:
        """An engine in a state."""
        form, timers = self._states[state]
        self.host.reset()
        host: Host = self.host
        watched = self._is_watched(form[1])
        new_variables = self._watched_variables if watched else self.host.new_variables
        engine = self.forms.revived(form, host, new_variables, moves=MOST_MOVES)
        self.host.timers = {key: Timer(group, offset, period) for key, group, offset, period in timers}
        self.host.engine = engine
        self._watched = None
        if watched:
            for instance in engine.instances.values():
                assert isinstance(instance.root_variables, Watched)
                self._watched = instance.root_variables
        return engine

    def _watched_variables(self) -> Watched:
        return Watched(self.host.new_variables())

    def _explored(
        self,
        make: Callable[[], Engine],
        apply: Callable[[Engine], object],
        keep: Callable[[Way, Outcome], object] | None = None,
    ) -> tuple[Way, ...]:
        """All ways of a step: run it with each list of decisions."""
        host, found = self.host, dict[Way, None]()
        pending: list[tuple[int, ...]] = [()]
        while pending:
            host.decisions = pending.pop()
            engine = make()
            apply(engine)
            self.steps += 1
            outcome = host.outcome
            choices = outcome.choices
            if choices:
                if len(choices) > MOST_DECISIONS:
                    self.cut.add("decisions")
                for place in range(len(host.decisions), min(len(choices), MOST_DECISIONS)):
                    _, chosen, ways = choices[place]
                    prefix = tuple(one[1] for one in choices[:place])
                    pending += [(*prefix, other) for other in range(ways) if other != chosen]
            if outcome.begun:
                self._note_begun(outcome)
            number = self.number(engine)
            if number is None:
                continue
            way = Way(
                number, tuple(outcome.sent), tuple(dict.fromkeys(outcome.flags)), bool(outcome.begun), outcome.quiet
            )
            found[way] = None
            if keep is not None:
                keep(way, outcome)
            if len(found) > MOST_WAYS:
                self.cut.add("decisions")
                break
        return tuple(found)

    @property
    def visited(self) -> set[str]:
        """The elements that a token has entered so far."""
        elements = self.program.elements
        return self._entered | {elements[slot] for slot, count in enumerate(self.forms.counts) if count}

    def _note_begun(self, outcome: Outcome) -> None:
        """Count what instances that have begun have passed; all others count together."""
        elements = self.program.elements
        for instance in outcome.begun:
            self._entered |= {elements[slot] for slot, count in enumerate(instance.counts) if count}

    def _note_entered(self, engine: Engine) -> None:
        """Note where the tokens of a new state are."""
        for instance in engine.instances.values():
            for scope in scopes_of(instance.root):
                for child in scope.children:
                    if child.node is not None and not (isinstance(child, Wait) and not child.token):
                        self._entered.add(child.node.id)

    def _apply(self, engine: Engine, stimulus: Stimulus) -> None:
        kind, what, detail = stimulus
        host = self.host
        if kind == "hear" or kind == "outside":
            if kind == "hear":
                received = what in engine.listeners or what in self.program.starts
                host.outcome.flags.append(
                    ("received" if received else "lost" if engine.instances else "unneeded", what)
                )
            engine.deliver(what, self.values.value(detail))
        elif kind == "end":
            self._end(engine, what, detail)
        elif kind == "timer":
            timer = host.timers.pop(what)
            host.fired = timer
            if timer.period is not None:
                host.timers[what] = Timer(timer.group, timer.offset + timer.period, timer.period)
            engine.timer_fired(what, last=timer.period is None)
        elif kind == "person":
            engine.complete_task(what)
        elif kind == "offer":
            engine.activate(what)
        elif kind == "block":
            engine.waits.pop(what).started = False

    def _end(self, engine: Engine, key: int, code: str | None) -> None:
        wait = engine.waits[key]
        step = _step_of(wait)
        host = self.host
        host.place = wait.node.id
        if code is None:
            host.end_step(step, wait.scope.variables)
        variable = getattr(wait.node.spec, "variable", "")
        if variable in self.kept:
            wait.scope.variables[variable] = self.values.unknown
        engine.script_ended(key, None if code is None else BpmnError(code))

    # ---- states --------------------------------------------------------------------------------------

    def number(self, engine: Engine) -> int | None:
        """The number of the state that an engine is in; None if it is one that grows without bound."""
        walk = self.forms.walk(engine)
        if self._grows(engine, walk.scopes):
            return None
        form, keys = walk.form()
        found: Stimuli | None = None
        if form[0] not in self._dead:
            found = stimuli(engine)
            tokens = [element for element, _ in found.waiting]
            tokens += [node.id for scope in walk.scopes for node in scope.held]  # which go on after a suspension
            self._dead[form[0]] = self._liveness.dead(tokens)
        form = self._without_dead(form)
        state = (form, self._timers(keys)) if self.host.timers else (form, ())
        number = self._numbers.get(state)
        if number is None:
            number = self._add(state, self._view(engine, form, keys, state[1], found))
        walk.dissolve()
        return number

    def _without_dead(self, form: Form) -> Form:
        """A form without the values that nothing reads any more."""
        control, contents = form
        (dead, unused), live = self._dead[control], self._live
        if not dead and not unused:
            return form
        left = []
        for content in contents:
            found = live.get((control, content))
            if found is None:
                found = live[control, content] = self.forms.contents.forgotten(content, dead, UNKNOWN, unused)
            left.append(found)
        return control, tuple(left)

    def _add(self, state: State, view: View) -> int:
        number = self._numbers[state] = len(self._states)
        self._states.append(state)
        self.views.append(view)
        return number

    def _variable(self, name: str, value: Any) -> int:
        """The number of a variable's value; one that has too many of them is unknown from then on."""
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

    def _grows(self, engine: Engine, scopes: Iterable[Scope]) -> bool:
        if len(engine.instances) > MOST_INSTANCES and self.program.instances is None:
            self.cut.add(f"instances\n{self.program.process}")
            return True
        for scope in scopes:
            if len(scope.children) > MOST_AT_ONE_PLACE and (crowded := _crowded(scope)):
                self.cut.add(f"tokens\n{crowded}")
                return True
        return False

    def _timers(self, keys: Keys) -> tuple[tuple[int, int, float, float | None], ...]:
        """Pending timers by key; only the order within a group counts, so each begins at 0."""
        pending = sorted(((keys[key], timer) for key, timer in self.host.timers.items() if key in keys), key=_first)
        groups: dict[Any, int] = {}
        earliest: dict[Any, float] = {}
        for _, timer in pending:
            groups.setdefault(timer.group, len(groups))
            earliest[timer.group] = min(earliest.get(timer.group, timer.offset), timer.offset)
        return tuple(
            (number, groups[timer.group], round(timer.offset - earliest[timer.group], 9), timer.period)
            for number, timer in pending
        )

    def _view(self, engine: Engine, form: Form, keys: Keys, timers: Timers, found: Stimuli | None) -> View:
        """What can happen in the state that an engine is in, which its control state and timers decide.

        `found` are the engine's stimuli, if they are known.
        """
        known = self._views.get((form[0], timers))
        if known is None:
            self._note_entered(engine)
            known = self._views[form[0], timers] = self._new_view(engine, keys, found or stimuli(engine))
        return known

    def _new_view(self, engine: Engine, keys: Keys, found: Stimuli) -> View:
        """The same; stimuli have the keys that an engine revived from the state has."""
        own: dict[Stimulus, str] = {}
        for key in sorted(found.scripts, key=keys.__getitem__):
            wait, number = found.scripts[key], keys[key]
            own["end", number, None] = wait.node.id
            for code in _step_of(wait).codes:
                own["end", number, code] = wait.node.id
        if found.timers:
            for key in sorted(self._next_timers(found.timers), key=keys.__getitem__):
                own["timer", keys[key], None] = found.timers[key].id
        for wait in found.people:
            own["person", wait.node.id, None] = wait.node.id
        for element in found.offers:
            own["offer", element, None] = element
        for topic in self.outside:
            if topic in found.topics:
                own["outside", topic, self.host.blank(topic)] = ""
        topics = self._topic_sets.setdefault(found.topics, found.topics)
        dropped = frozenset(topic for topic in topics if self._is_dropped(engine, topic))
        hears = self._topic_sets.setdefault(topics - dropped, topics - dropped)
        listeners = tuple(sorted((topic, len(listening)) for topic, listening in engine.listeners.items()))
        instances = len(engine.instances)
        return View(tuple(own), tuple(own.values()), topics, hears, listeners, instances, found.waiting)

    def _is_dropped(self, engine: Engine, topic: str) -> bool:
        """Whether a message on a topic has no effect now: it would start an instance, but as many as may run do."""
        limit = self.program.instances
        if limit is None or len(engine.instances) < limit or topic in engine.listeners:
            return False
        starts = self.program.starts[topic]
        return all(one.catch is not None and not one.catch.queue and one.spec.whole is None for one in starts)

    def _next_timers(self, alive: Container[int]) -> list[int]:
        """The timers that may fire now: of each group the earliest."""
        first: dict[Any, int] = {}
        for key, timer in self.host.timers.items():
            if key in alive:
                other = first.get(timer.group)
                if other is None or timer.offset < self.host.timers[other].offset:
                    first[timer.group] = key
        return list(first.values())

    def element(self, state: int, stimulus: Stimulus) -> str:
        """The id of the element that an own stimulus is for; "" for one of a topic."""
        view = self.views[state]
        kind = "end" if stimulus[0] == "block" else stimulus[0]
        return next(one for own, one in zip(view.own, view.elements, strict=True) if own[:2] == (kind, stimulus[1]))


def _go_on(engine: Engine) -> None:
    """What is held goes on; what a migrated state lacks is armed."""
    engine.release()
    arm_new(engine)
    engine.run()


def _step_of(wait: Wait) -> Step:
    """What takes time where a token waits."""
    made = wait.node.spec.run(wait.scope.variables)
    assert isinstance(made, Running)
    return made.step


def _crowded(scope: Scope) -> str:
    """The element of a scope at which too many tokens and handlers are, or empty; instances of loops may be many."""
    nodes = [child.node for child in scope.children if child.node is not None]
    if len(set(nodes)) > len(nodes) - MOST_AT_ONE_PLACE:
        return ""
    places = Counter(node for node in nodes if not isinstance(node.spec, LoopInstance))
    return next((node.id for node, count in places.items() if count > MOST_AT_ONE_PLACE), "")


def _first(item: tuple[int, Timer]) -> int:
    return item[0]
