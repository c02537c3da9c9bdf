"""Properties in an exploration: the states of their monitors are a part of each state of the team.

What a monitor reacts to is observed on the way (`ExplorationHost.observe`): a step in which such an event occurs, or a
variable that it reads gets another value, is no silent step, and no independent one. Conditions are judged after each
step, as if it were an instant. Time stands still, so nothing is said about bounds; nor about distances, batteries and
messages, nor about elements inside behaviours that the exploration does not look into.

A robot that calls ``watch_property`` has a monitor, too (`Watch`). It decides when ``/violated/NAME`` may come, which
otherwise comes from outside at any time: after a violation; with a bound also while something is pending; and at any
time while the robot watches what an exploration does not judge.

A property is *refuted* by a run that violates it, by one that ends while an event is still to come, or by one that goes
on for ever and can never come to it. It is *proved* if there is no such run in a search that has seen all states.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from typing import Any, ClassVar, Literal

from fame.check.explore.graph import Explored
from fame.check.explore.local import VALUE, Local, Observed
from fame.check.explore.trace import Runs, Step
from fame.check.explore.transitions import THROWN
from fame.check.explore.values import holds_unknown
from fame.dataclasses import dataclass, replace
from fame.properties import Monitor, Verdict
from fame.properties.conditions import LastValues, ValueSource, subjects
from fame.properties.judgement import ABSENT, SEVERAL
from fame.properties.monitor import Happening, State
from fame.properties.parts import OPEN, UNKNOWN, Part, PartState

Proof = Literal["proved", "not triggered", "refuted", "not known"]
PROOFS: tuple[Proof, ...] = ("refuted", "not known", "not triggered", "proved")
"""Of several deliveries the first of these counts."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What an exploration says about a property.

    verdict   ``not triggered``: it is proved, but in no run was there anything to judge
    text      why it is refuted or not known, and what the search could not do because of it
    run       the steps of a run to a violation, through as few explored states as possible
    delivery  how messages were delivered in that run
    """

    name: str
    sentence: str
    verdict: Proof
    text: str = ""
    run: tuple[Step, ...] = ()
    delivery: str = "run"

    def __str__(self) -> str:
        return f"property {self.name} {'was' if self.verdict == 'not triggered' else 'is'} {self.verdict}" + (
            f": {self.text}" if self.text else ""
        )


WatchState = tuple[State | None, bool, tuple[str, ...]]
"""The state of the monitor while the robot watches, whether the signal was thrown, and which robots have taken it."""


@dataclass(frozen=True, slots=True)
class Watch:
    """A call of ``watch_property``: `robot` watches while at `element`; `judged`: whether all that it needs is seen."""

    monitor: Monitor
    robot: str
    element: str
    judged: bool = True

    initial: ClassVar[WatchState] = None, False, ()

    @property
    def topic(self) -> str:
        return f"/violated/{self.monitor.spec.name}"

    @property
    def events(self) -> set[tuple[str, str]]:
        """(element, what) of the events that it needs."""
        own = {(self.element, what) for what in ("enter", "leave", "cancel", "fail")}
        return own | {(element, what) for _, element, what in self.monitor.events}

    def step(self, state: WatchState, event: Happening) -> WatchState:
        """Return the state after an event."""
        watched, thrown, taken = state
        robot, element, what, _ = event
        if what == THROWN:
            return (watched, True, (*taken, robot)) if element == self.topic else state
        if (robot, element) == (self.robot, self.element):
            return (_plain(self.monitor.initial), False, ()) if what == "enter" else (None, thrown, taken)
        if watched is not None and self.judged:
            watched = _plain(self.monitor.step(watched, 0, event))
        return watched, thrown, taken

    def throws(self, state: WatchState, robot: str) -> bool:
        """Return whether its signal may reach a robot now."""
        watched, thrown, taken = state
        if robot in taken or thrown or watched is None:
            return thrown and robot not in taken
        parts = zip(self.monitor.parts, watched, strict=True)
        words = {part.verdict(one).word for part, one in parts}
        return not self.judged or "violated" in words or (self.monitor.timed and "pending" in words)


class Monitors:
    """The monitors of a team that an exploration can judge. Their joint states have numbers, from 0.

    The last part of a joint state are the numbers of the values of `sources`, None for those without one.

    reasons   why the exploration cannot judge each of `all`; empty if it can
    thrown    the topics of `watches`
    observed  (element, what) of the events that they need, of any robot
    apart     robots that a property tells apart from others of their pool
    """

    def __init__(
        self, monitors: Sequence[Monitor], robots: Mapping[str, Local], several: Set[str], watches: Iterable[Watch] = ()
    ) -> None:
        self.all: tuple[Monitor, ...] = tuple(monitors)
        self.reasons: tuple[str, ...] = tuple(_unjudged(one, robots) for one in monitors)
        self.monitors: tuple[Monitor, ...] = tuple(
            one for one, why in zip(monitors, self.reasons, strict=True) if not why
        )
        self.names: tuple[str, ...] = tuple(robots)
        self.watches: tuple[Watch, ...] = tuple(
            replace(one, judged=not (_hidden(one.monitor, robots) or one.monitor.sources)) for one in watches
        )
        self.thrown: frozenset[str] = frozenset(one.topic for one in self.watches)
        self.observed: frozenset[tuple[str, str]] = frozenset(
            (element, what) for one in self.monitors for _, element, what in one.events
        )
        self._several = several
        read = {source for one in self.monitors for source in one.sources}
        self.sources: tuple[ValueSource, ...] = tuple(sorted(read))
        self._places = {(one.subject, one.name): place for place, one in enumerate(self.sources)}
        self._values = next(iter(robots.values())).values
        self._robots = robots
        self._opaque = [f"{name}'s {id}" for name, local in robots.items() for id in sorted(local.host.opaque)]
        midway = ((name, *one) for name, local in robots.items() for one in sorted(local.host.midway.items()))
        self._midway = [f"{name}'s {id} publishes on {topic} before it ends, in an exploration when it ends"
                        for name, id, topic in midway]  # fmt: skip
        named = (robot for one in self.monitors for robot in self._apart(one))
        self.apart: frozenset[str] = frozenset(robots if self.watches else named)
        self.states: list[tuple[Any, ...]] = []
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._steps: dict[tuple[int, int, Observed], int] = {}
        self._read: dict[int, int] = {}
        self._renamed: dict[tuple[int, tuple[tuple[int, int], ...]], int] = {}
        unset = (None,) * len(self.sources)
        initial = (*(one.initial for one in self.monitors), *(one.initial for one in self.watches), unset)
        self._number(self._after_reading(initial))

    def _apart(self, monitor: Monitor) -> list[str]:
        """The robots that a property tells apart from others of their pool."""
        values = (value.subject.text for value in subjects(monitor.spec))
        return sorted({*(event.robot.text for event in monitor.spec.occurrences), *values} & self._several)

    def _may_fail(self, monitor: Monitor) -> str:
        """What may fail besides, of what a property asks whether it fails; empty for nothing."""
        fails = [(robot, element) for (robot, element, what), reactions in monitor.events.items()
                 if what == "fail" or (what == "end" and any(one.detail == "failed" for one in reactions))]  # fmt: skip
        for robot, element in fails:  # an error event keeps the exceptions of guarded scripts from the robot
            local = self._robots[robot]
            uncaught = local.host.skipped.keys() - local.host.guarded if element == local.program.process else {element}
            if id := min(uncaught & local.host.skipped.keys(), default=""):
                text = local.host.skipped[id]
                return f"{robot}'s {id} may raise an error: an exploration does not execute `{text}`"
        return ""

    def _number(self, states: tuple[Any, ...]) -> int:
        number = self._numbers.setdefault(states, len(self.states))
        if number == len(self.states):
            self.states.append(states)
        return number

    def step(self, number: int, robot: int, events: Observed) -> int:
        """Return the joint state after events of a robot, in their order."""
        key = (number, robot, events)
        after = self._steps.get(key)
        if after is None:
            states = self.states[number]
            for element, what, detail in events:
                if what == VALUE:
                    values, place = states[-1], self._places.get((self.names[robot], element))
                    if place is not None:
                        states = (*states[:-1], (*values[:place], detail, *values[place + 1 :]))
                    continue
                event = (self.names[robot], element, what, detail)
                pairs, watches = zip(self.monitors, states), zip(self.watches, states[len(self.monitors) :])  # noqa: B905
                states = (
                    *(_plain(one.step(state, 0, event)) for one, state in pairs),
                    *(one.step(state, event) for one, state in watches),
                    states[-1],
                )
            after = self._steps[key] = self._number(states)
        return after

    def read(self, number: int) -> int:
        """Return the joint state after the conditions were read."""
        if not self.sources:
            return number
        after = self._read.get(number)
        if after is None:
            after = self._read[number] = self._number(self._after_reading(self.states[number]))
        return after

    def _after_reading(self, joint: tuple[Any, ...]) -> tuple[Any, ...]:
        *states, numbers = joint
        pairs = zip(self.sources, numbers, strict=True)
        values = {source: self._values.value(one) for source, one in pairs if one is not None}
        unknown = {source for source, value in values.items() if holds_unknown(value)}
        for place, monitor in enumerate(self.monitors):
            parts = zip(monitor.parts, states[place], strict=True)
            states[place] = _plain(tuple(_read(part, state, values, unknown) for part, state in parts))
        return (*states, numbers)

    def throws(self, number: int, robot: int, topic: str) -> bool:
        """Return whether a message on a topic may come to a robot from outside: that of a watch
        only when it may throw it."""
        watches = zip(self.watches, self.states[number][len(self.monitors) : -1], strict=True)
        return topic not in self.thrown or any(
            one.topic == topic and one.throws(state, self.names[robot]) for one, state in watches
        )

    def renamed(self, number: int, places: Mapping[int, int]) -> int:
        """Return the joint state when equal robots change places."""
        key = (number, tuple(sorted(places.items())))
        after = self._renamed.get(key)
        if after is None:
            names = {self.names[old]: self.names[new] for old, new in places.items()}
            *states, values = self.states[number]  # without watches, which keep all robots apart
            last = dict(zip(self.sources, values, strict=True))
            back = {new: old for old, new in names.items()}
            moved = (last[one._replace(subject=back.get(one.subject, one.subject))] for one in self.sources)
            exchanged = (_exchanged(one, state, names) for one, state in zip(self.monitors, states, strict=True))
            after = self._renamed[key] = self._number((*exchanged, tuple(moved)))
        return after

    def judge(self, runs: Runs, *, exhaustive: bool) -> Iterator[Judged]:
        """Yield what the explored states say about each property."""
        explored, product = runs.explored, runs.product
        numbers = [product.monitored(state) for state in explored.states]
        places = iter(range(len(self.monitors)))
        for monitor, unjudged in zip(self.all, self.reasons, strict=True):
            name, sentence = monitor.spec.name, monitor.spec.sentence
            if unjudged:
                yield Judged(name, sentence, "not known", unjudged)
                continue
            place = next(places)
            at, why = _refuted(monitor, [self.states[number][place] for number in numbers], explored)
            apart = self._apart(monitor)
            said = [f"it names {', '.join(apart)}, so that no robots of the pool were taken for equal"] if apart else []
            if at is not None:
                run = tuple(runs.to(at).steps)
                shortest = not product.options.reduced and not explored.failures
                why += ", no other in fewer steps" if shortest else ", others perhaps in fewer steps"
                yield Judged(name, sentence, "refuted", "; ".join([why, *said]), run, product.options.delivery)
                continue
            verdict: Proof = "proved"
            if not exhaustive:
                verdict, said = "not known", ["not all states were explored", *said]
            elif monitor.absent:
                verdict, said = "not known", [ABSENT, *said]
            elif doubt := _doubtful(monitor, [self.states[number][place] for number in numbers], explored):
                verdict, said = "not known", [doubt, *said]
            elif skipped := self._may_fail(monitor):
                verdict, said = "not known", [skipped, *said]
            elif all(monitor.verdict(self.states[number][place]).word == "not triggered" for number in {*numbers}):
                verdict = "not triggered"
            if self._opaque and exhaustive:
                verdict = "not known"
                said = [f"{', '.join(self._opaque)} may raise an error, and is not executed in an exploration", *said]
            if self._midway and exhaustive:
                verdict, said = "not known", [*self._midway, *said]
            yield Judged(name, sentence, verdict, "; ".join(said))


def _refuted(monitor: Monitor, states: Sequence[State], explored: Explored) -> tuple[int | None, str]:
    """The first state that refutes a property, and why; None if none does."""
    verdicts: dict[State, Verdict] = {state: monitor.verdict(state) for state in {*states}}
    at = next((at for at, state in enumerate(states) if verdicts[state].word == "violated"), None)
    if at is not None:
        return at, "a run violates it"
    ends = sorted({*explored.final, *explored.stuck})
    at = next((at for at in ends if monitor.verdict(monitor.finish(states[at], 0)).word == "violated"), None)
    if at is not None:
        return at, "a run ends without it"
    going = [at for at, state in enumerate(states) if verdicts[state].word != "pending"]
    failing = [at for at, _, _ in explored.failures if at >= 0]
    leads = explored.leading_to([*going, *ends, *explored.unexplored(), *failing])
    at = next((at for at in range(len(states)) if not leads[at]), None)
    return at, "a run goes on for ever without it"


def _read(part: Part, state: PartState, values: LastValues, unknown: Set[ValueSource]) -> PartState:
    """The state of a part after its condition was read, where it is open."""
    if part.condition is None or state[0] != OPEN:
        return state
    return (
        part.lose(state) if part.condition.sources & unknown else part.sample(state, 0, part.condition.read(values, 0))
    )


def _doubtful(monitor: Monitor, states: Sequence[State], explored: Explored) -> str:
    """Why it is not known whether a run violates a property that no run surely does; empty if it is known."""
    parts = [part for state in {*states} for part in state]
    if any(phase == UNKNOWN or triggered == 2 for phase, _, _, _, triggered in parts):
        return "the exploration does not know a value that it reads" if monitor.spec.condition else SEVERAL
    ends = {states[at] for at in (*explored.final, *explored.stuck)}
    without = monitor.spec.condition and any(part[4] == 3 for state in ends for part in state)
    return "a run ends in which what it reads never has a value" if without else ""


def _plain(state: State) -> State:
    """The state of a monitor without its slack, which decides nothing."""
    return tuple((phase, since, memory, None, triggered) for phase, since, memory, _, triggered in state)


def _exchanged(monitor: Monitor, state: State, names: Mapping[str, str]) -> State:
    """The state of a monitor when robots have other names."""
    bindings = [part.binding for part in monitor.parts]
    exchanged = list(state)
    for binding, one in zip(bindings, state, strict=True):
        exchanged[bindings.index({pool: names.get(robot, robot) for pool, robot in binding.items()})] = one
    return tuple(exchanged)


def is_judged(monitor: Monitor) -> bool:
    """Return whether an exploration may judge a property, if it sees all that it names."""
    return not (monitor.timed or monitor.reads_messages or any(one.kind != "variable" for one in monitor.sources))


def _unjudged(monitor: Monitor, robots: Mapping[str, Local]) -> str:
    """Why an exploration cannot judge a property; empty if it can."""
    return "it has a bound, and an exploration has no clock" if monitor.timed else _hidden(monitor, robots)


def _hidden(monitor: Monitor, robots: Mapping[str, Local]) -> str:
    """What a property needs that an exploration does not see; empty for nothing."""
    if any(one.kind != "variable" for one in monitor.sources):
        return "an exploration judges no values but those of variables"
    if monitor.reads_messages:
        return "an exploration does not judge fields of messages"
    for robot, element, what in monitor.events:
        local = robots[robot]
        if what == "log":
            return "an exploration does not judge reports"
        if element != local.program.process and element not in local.liveness.elements:
            return f"{element} is inside a behaviour that the exploration does not look into"
    return ""
