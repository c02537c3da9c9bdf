"""The transitions of one robot, computed by the engine that runs it, and remembered.

`Local.step` makes an engine of a state, gives it a stimulus and notes the new state and what was sent. Where a value is
unknown the step is run once for each way: with a longer and longer list of decisions. A step whose footprint is known
needs no engine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from fame.bpmn.model import Body, Definitions, Process
from fame.bpmn.pools import Pool
from fame.check.explore.abstraction import Abstraction
from fame.check.explore.canonical import Forms
from fame.check.explore.footprints import Effect, Footprints, Watched
from fame.check.explore.host import DOUBT, Event, ExplorationHost, Flag, Outcome, OutOfTimeError, Send
from fame.check.explore.liveness import Liveness
from fame.check.explore.remembering import Memory, remembered
from fame.check.explore.running_states import go_on, resumed
from fame.check.explore.states import CUT, States
from fame.check.explore.stimuli import Stimulus, apply
from fame.check.explore.timers import Timer
from fame.check.explore.values import UNKNOWN, Values, is_fixed
from fame.check.explore.views import View
from fame.engine import Engine, Instance, compile_program
from fame.engine.encoding import Data
from fame.engine.host import Host
from fame.engine.program import UNCOUNTED, Program

MOST_MOVES = 20_000
"""Moves of tokens within one step, after which it is a livelock."""
MOST_WAYS = 300
"""Ways that one step may go."""
MOST_ENDLESS = 4
"""Ways of one step that never end, after which no more are tried."""


Observed = tuple[Event, ...]
"""Events of one robot in one step, in their order."""
VALUE = "value"
"""The event that a variable which a property reads has another value; its detail is the number of the value."""


class Successor(NamedTuple):
    """A result of a step: the new state, what was sent, what is to be reported, whether an instance begins.

    `quiet`: nothing was published, not even for the robot itself; `events`: what properties name, in order.
    """

    state: int
    sent: tuple[Send, ...]
    flags: tuple[Flag, ...]
    begins: bool
    quiet: bool = True
    events: Observed = ()


class Local:
    """The transitions of one robot, or of several that nothing tells apart, between its `states`.

    `observed`: whether its events are observed; `reads`: the variables that properties read; `parameters`: variables
    that its process starts with.
    """

    body: Body
    unhandled: set[tuple[str, str]]
    steps: int
    robot: str
    process: Process
    values: Values
    host: ExplorationHost
    forms: Forms
    views: list[View]

    def __init__(
        self,
        definitions: Definitions,
        pool: Pool,
        model: Abstraction,
        host: ExplorationHost,
        *,
        observed: bool,
        reads: Sequence[str],
        parameters: Mapping[str, Any],
    ) -> None:
        process, values = pool.process, host.values
        self.robot, self.process, self.values, self.host, self._reads = host.robot, process, values, host, reads
        explored = model.process(definitions, process)
        self.bodies: list[Body] = model.bodies(definitions, process)
        self.host.remembered = remembered(self.bodies)
        self.host.memory = Memory(self.host.remembered)
        self.kept: frozenset[str] = model.kept[pool.name].union(self.host.remembered)
        self.host.kept, self.host.names = self.kept.__contains__, model.kept[pool.name]
        self.body, self.unhandled = explored.body, model.failures.unhandled
        file = definitions.file
        self.program: Program = compile_program(explored, host=host, library=model.find, file=file, observed=observed)
        elements = self.program.elements
        for node in self.program.nodes:
            if node.index == UNCOUNTED:  # it is counted when it completes; here also when a token comes
                node.index = len(elements)
                elements.append(node.id)
        catches = [node.catch for node in self.program.nodes if node.catch is not None]
        self.topics: frozenset[str] = frozenset(catch.topic for catch in catches if catch.topic)
        self.host.own_topics = self.topics
        self.outside: tuple[str, ...] = tuple(sorted(self.topics & model.facts.outside))
        self.liveness: Liveness = Liveness(definitions, process, model, self.kept, self.host.remembered)
        self.states: States = States(self.program, self.host, self.outside, self.liveness)
        self.forms, self.views = self.states.forms, self.states.views
        self.cut: bool = False
        """Whether ways were left out, because one step makes too many decisions."""
        self.steps = 0
        self._memo: dict[tuple[int, Stimulus], tuple[Successor, ...]] = {}
        self._decisions: dict[tuple[int | None, Stimulus | None, Successor], list[tuple[str, int, int]]] = {}
        once = not self.program.starts  # else instances share a list, which the first one may change
        self._parameters: dict[str, int] = {
            name: values.number(value) if once or is_fixed(value) else UNKNOWN for name, value in parameters.items()
        }
        self._footprints = Footprints(self.forms.contents.codes)
        self._watched: Watched | None = None

    def __len__(self) -> int:
        return len(self.states.all)

    def start(self, given: Data | None = None) -> tuple[Successor, ...]:
        """Return the ways in which the robot may start, or go on from a snapshot of this program."""
        return self._explored(*self._first(given))

    def step(self, state: int, stimulus: Stimulus) -> tuple[Successor, ...]:
        """Return the ways that a stimulus may go in a state."""
        key = (state, stimulus)
        ways = self._memo.get(key)
        if ways is None:
            ways = self._memo[key] = self._new_step(state, stimulus)
        return ways

    def step_by_engine(
        self, state: int, stimulus: Stimulus, keep: Callable[[Successor, Outcome], object] | None = None
    ) -> tuple[Successor, ...]:
        """Return the ways of `step`, by an engine; `keep` is called with each and its outcome."""
        return self._explored(lambda: self.revived(state), lambda engine: apply(engine, stimulus, self.host), keep)

    def _new_step(self, state: int, stimulus: Stimulus) -> tuple[Successor, ...]:
        """The ways of a step: by its footprint if that is known, else by an engine."""
        kind, topic, _ = stimulus
        view = self.views[state]
        if kind == "hear" and topic not in view.listens:  # the engine would drop the message
            self.steps += 1
            return (Successor(state, (), (("lost" if view.instances else "unneeded", topic),), False),)
        (control, contents), timers = self.states.all[state]
        if not self._is_watched(contents):
            return self.step_by_engine(state, stimulus)
        content, step = contents[0], (control, timers, stimulus)
        known = self._footprints.find(step, content)
        if known is not None:
            self.steps += len(known)
            after = self.states.after
            ways = [Successor(after(content, one), one.sent, one.flags, False, one.quiet, one.events) for one in known]
            return tuple(dict.fromkeys(ways))
        reads, effects, before = set[str](), list[Effect](), self.steps

        def note(way: Successor, outcome: Outcome) -> None:
            if way.state == CUT:
                return
            watched, ((after, left), rest) = self._watched, self.states.all[way.state]
            if watched is not None and not watched.whole and not outcome.begun and len(left) < 2:
                reads.update(watched.reads)
                changes = self.forms.contents.difference(content, left[0], watched.writes) if left else None
                effects.append(Effect(after, rest, changes, way.sent, way.flags, way.quiet, way.events))

        successors = self.step_by_engine(state, stimulus, note)
        if len(effects) == self.steps - before and successors[-1].state != CUT:  # all was noted
            self._footprints.add(step, content, reads, effects)
        return successors

    def _is_watched(self, contents: tuple[int, ...]) -> bool:
        """Whether footprints of steps are noted: of one instance, without variables of inner scopes."""
        return len(contents) == 1 and self.host.traceable and not self.forms.contents.is_empty(contents[0])

    def decisions(
        self, state: int | None, stimulus: Stimulus | None, way: Successor, given: Data | None = None
    ) -> list[tuple[str, int, int]]:
        """Return the decisions by which a step goes that way: (element, chosen, ways), for a trace.

        Without a state it is the first step, see `start`.
        """
        key = (state, stimulus, way)
        if key in self._decisions:  # of another run, which begins in the same way
            return self._decisions[key]
        choices: list[list[tuple[str, int, int]]] = []

        def keep(taken: Successor, outcome: Outcome) -> None:
            if taken == way:
                choices.append([one for one in outcome.choices if one[2] is not DOUBT or one[1]])

        if state is None or stimulus is None:
            self._explored(*self._first(given), keep)
        else:
            self.step_by_engine(state, stimulus, keep)
        decisions = self._decisions[key] = choices[0] if choices else []
        return decisions

    def _first(self, given: Data | None) -> tuple[Callable[[], Engine], Callable[[Engine], object]]:
        """The first step: what makes the engine, and what starts it."""
        if given is None:
            return self._new, lambda engine: engine.begin({})
        return lambda: self._resumed(given), go_on

    def _resumed(self, data: Data) -> Engine:
        self.host.reset()
        engine = self._with_parameters(resumed(self.program, data, self.host))
        engine.limit = engine.portion = MOST_MOVES
        return engine

    def _new(self) -> Engine:
        self.host.reset()
        host: Host = self.host
        return self._with_parameters(Engine(self.program, host, self.host.new_variables, moves=MOST_MOVES))

    def _with_parameters(self, engine: Engine) -> Engine:
        """The engine, now that of the host, with fresh values of the parameters that its instances start with."""
        self.host.engine = engine
        engine.parameters = {name: self.values.value(number) for name, number in self._parameters.items()}
        return engine

    def revived(self, state: int) -> Engine:
        form, timers = self.states.all[state]
        self.host.reset()
        host: Host = self.host
        watched = self._is_watched(form[1])
        new_variables = self._watched_variables if watched else self.host.new_variables
        engine = self.forms.revived(form, host, new_variables, moves=MOST_MOVES)
        self.host.timers = {key: Timer(group, offset, period) for key, group, offset, period in timers}
        if self.program.starts:  # further instances may begin
            self._with_parameters(engine)
        self.host.engine, self._watched = engine, None
        if watched:
            for instance in engine.instances.values():
                assert isinstance(instance.root_variables, Watched)
                self._watched = instance.root_variables
        return engine

    def _watched_variables(self) -> Watched:
        return Watched(self.host.new_variables(), self.host.memory)

    def _read(self, instances: Sequence[Instance]) -> dict[str, int]:
        """The numbers of the values that properties read: of the instance that has begun last, perhaps ended now."""
        if not self._reads or not instances:
            return {}
        instance = max(instances, key=lambda one: one.key)
        variables: dict[str, Any] = instance.root_variables
        late = self.host.late
        return {
            name: UNKNOWN if late & {name, ""} else self.states.variable(name, variables[name])
            for name in self._reads if name in variables
        }  # fmt: skip

    def _explored(
        self,
        make: Callable[[], Engine],
        act: Callable[[Engine], object],
        keep: Callable[[Successor, Outcome], object] | None = None,
    ) -> tuple[Successor, ...]:
        """All ways of a step: run it with each list of decisions. Raises OutOfTimeError."""
        host, successors, cut, endless = self.host, dict[Successor, None](), False, 0
        pending: list[tuple[int, ...]] = [()]
        while pending:
            host.decisions = pending.pop()
            engine = make()
            last = [*engine.instances.values()][-1:]
            before = self._read(last)
            act(engine)
            if host.stop():  # and the step may not have gone to its end
                raise OutOfTimeError
            self.steps += 1
            outcome = host.outcome
            choices = outcome.choices
            endless += any(one.error is not None and one.error.code == "livelock" for one in outcome.over)
            if endless > MOST_ENDLESS:
                cut = True
                break
            if choices:
                cut |= len(choices) > outcome.most
                for place in range(len(host.decisions), min(len(choices), outcome.most)):
                    if place in outcome.settled:
                        continue
                    _, chosen, ways = choices[place]
                    prefix = tuple(one[1] for one in choices[:place])
                    pending += [(*prefix, other) for other in range(ways) if other != chosen]
            if outcome.begun:
                self.states.note_begun(outcome.begun)
            number = self.states.number(engine)
            after = self._read([*last, *engine.instances.values()])
            if not last or max(engine.instances, default=0) <= last[-1].key:  # what the instance has removed
                after |= dict.fromkeys(before.keys() - after.keys(), UNKNOWN)
            outcome.events += [(name, VALUE, value) for name, value in after.items() if value != before.get(name)]
            sent, flags = tuple(outcome.sent), tuple(dict.fromkeys(outcome.flags))
            way = Successor(
                CUT if number is None else number,
                sent,
                flags,
                bool(outcome.begun),
                outcome.quiet,
                tuple(outcome.events),
            )
            successors[way] = None
            if keep is not None:
                keep(way, outcome)
            if len(successors) > MOST_WAYS:
                cut = True
                break
        self.cut |= cut
        return (*successors, Successor(CUT, (), (), False)) if cut else tuple(successors)
