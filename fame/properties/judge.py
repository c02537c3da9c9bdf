"""Judge a team by many monitors: give it the events and values of a run, ask it for judgements.

What happens is given in order. All of an instant comes first; its values count as they are at its end, which is when
something later is given, or `advance` is called. A message that a robot throws comes before the event that threw it.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fame.properties.conditions import STALE, RobotPosition, ValueSource, pose_of
from fame.properties.judgement import ABSENT, SEVERAL, Judgement
from fame.properties.monitor import Happening, Monitor
from fame.properties.parts import OPEN, SECOND, UNCERTAIN, UNKNOWN, VIOLATED, Part, PartState, Verdict

if TYPE_CHECKING:
    from fame.engine.state import Trail

_PLAIN = frozenset((RobotPosition, float, int, str))
"""Types of values that are compared before anything else is done."""
_FOREVER = 1 << 62
"""The doubt (ns) of a clock that was not measured."""
_Thrown = list[Any]
"""The messages of which an event has thrown one."""
_NO_MESSAGE: _Thrown = [None]
_Place = tuple[int, int]
"""The number of a monitor, and that of one of its parts."""


class Judge:
    """Monitors and their states. `on_violation` is called once for each property that is violated, at once.

    All before `now` (ns) is judged. `watch` gets each change: a time (ns), not earlier than those before, and the
    judgement about the robots concerned.
    """

    now: int
    monitors: Sequence[Monitor]
    sources: Sequence[ValueSource]
    topics: frozenset[str]

    def __init__(self, monitors: Sequence[Monitor], on_violation: Callable[[Judgement], object] | None = None) -> None:
        self.values: dict[ValueSource, Any] = {}
        self._owners: dict[ValueSource, int] = {}  # variables -> the instance that had them last
        self.watch: Callable[[int, Judgement], object] | None = None
        self._states: list[list[PartState]] = [list(one.initial) for one in monitors]
        self.now = 0
        self._doubts: dict[str, int | None] = {}
        self._messages: dict[tuple[str, str], deque[Any]] = defaultdict(deque)
        self._unsure: dict[tuple[str, str], list[_Thrown]] = defaultdict(list)  # as `_messages`, for each event
        self._held: list[tuple[int, int, Happening, _Thrown]] = []  # number, time, event: until the instant is over
        self._holding: set[int] = set()  # their monitors
        self._began: dict[_Place, tuple[int, str, str]] = {}
        self._broken: dict[_Place, tuple[str, str, str]] = {}  # robot, element, values
        self._reasons: dict[int, str] = {}
        self._measured: dict[ValueSource, int] = {}  # when the last position came from a topic, the oldest first
        self._curves: dict[_Place, tuple[int, float]] = {}  # when a condition was watched last, and its slack then
        self._on_violation, self._told = on_violation, set[int]()
        self._use(monitors)

    def _use(self, monitors: Sequence[Monitor]) -> None:
        self.monitors = monitors
        self.sources = sorted({source for one in monitors for source in one.sources})
        self.topics = frozenset(_topics(monitors))
        self._due: int | None = 0 if any(one.timed for one in monitors) else None
        self._watched: dict[str, dict[str, dict[str, list[int]]]] = {}
        self._readers: dict[ValueSource, list[_Place]] = defaultdict(list)
        self._poses = [source for source in self.sources if source.kind == "pose" and source.name]
        self._clocks: dict[_Place, tuple[int, int]] = {}
        for number, monitor in enumerate(monitors):
            self._index(number, monitor)
        self._dirty = dict.fromkeys(place for places in self._readers.values() for place in places)

    def adopt(self, monitors: Sequence[Monitor]) -> None:
        """Go on with monitors of the same properties, in the same order, for a team that has more robots."""
        for number, (old, new) in enumerate(zip(self.monitors, monitors, strict=True)):
            known = {_identity(part): place for place, part in enumerate(old.parts)}
            moved = {place: known.get(_identity(part)) for place, part in enumerate(new.parts)}
            kept = self._states[number]
            self._states[number] = [
                part.initial if moved[place] is None else kept[moved[place]]  # type: ignore[index]
                for place, part in enumerate(new.parts)
            ]
            for table in (self._began, self._broken, self._curves):
                self._move(table, number, moved)
        self._use(monitors)

    @staticmethod
    def _move(table: dict[_Place, Any], number: int, moved: Mapping[int, int | None]) -> None:
        old = {place: table.pop((number, place)) for other, place in [*table] if other == number}
        table.update({(number, new): old[place] for new, place in moved.items() if place in old})

    def _index(self, number: int, monitor: Monitor) -> None:
        for robot, element, what in monitor.events:
            words = self._watched.setdefault(robot, {}).setdefault(element, {})
            words.setdefault(what, []).append(number)
        for part, machine in enumerate(monitor.parts):
            for source in sorted(machine.condition.sources) if machine.condition else ():
                self._readers[source].append((number, part))

    def kept(self) -> list[Any]:
        """Return what it has to keep, as plain data: a judge of the same monitors goes on from it (`take_up`)."""
        began = [(*place, *what) for place, what in self._began.items()]
        return [[list(each) for each in self._states], began, dict(self._doubts)]

    def take_up(self, kept: Sequence[Any]) -> None:
        """Go on from what another one has kept."""
        states, began, doubts = kept
        self._states = [list(each) for each in states]
        self._began = {(number, part): (since, robot, element) for number, part, since, robot, element in began}
        for robot, doubt in doubts.items():
            self.doubt(robot, doubt)

    # ---- what happens ------------------------------------------------------------------------------------------------

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Take what happened in an engine at one instant."""
        watched = self._watched.get(robot)
        if watched is None:
            return
        for _, marks in trail:
            for element, what, detail in marks:
                if element in watched and what in watched[element]:
                    self.event(time, robot, element, what, detail)

    def event(self, time: int, robot: str, element: str, what: str, detail: Any = None) -> None:
        """Take an event; what concerns no property costs little."""
        element = "" if what == "log" else element
        numbers = self._watched.get(robot, {}).get(element, {}).get(what)
        if numbers is None:
            return
        if time > self.now:
            self.advance(time)
        happening, thrown = (robot, element, what, detail), dict[str, _Thrown]()
        for number in numbers:
            topics = {one.topic for one in self.monitors[number].events[robot, element, what] if one.topic}
            topic = topics.pop() if len(topics) == 1 else ""  # which of several it needs, a monitor does not say
            if topic and topic not in thrown:
                thrown[topic] = self._thrown(robot, topic)
            messages = thrown.get(topic, _NO_MESSAGE)
            if number in self._holding or not messages:
                self._holding.add(number)
                self._held.append((number, time, happening, messages))
            else:
                self._react(number, time, happening, messages)

    def _thrown(self, robot: str, topic: str) -> _Thrown:
        """The message on a topic that an event threw; empty, until the instant is over, if several wait for events."""
        waiting, unsure = self._messages[robot, topic], self._unsure[robot, topic]
        if unsure or len(waiting) > 1:
            unsure.append([])
            return unsure[-1]
        return [waiting.popleft()] if waiting else _NO_MESSAGE

    def _release(self) -> None:
        """Let the events be judged that waited to know which of the messages of this instant they threw.

        In their order, if all messages were thrown by events; else each event may have thrown each of them.
        """
        for place, events in self._unsure.items():
            waiting = self._messages.pop(place, deque())
            for at, messages in enumerate(events):
                few = [None] if len(waiting) < len(events) else waiting
                messages += [waiting[at]] if len(waiting) == len(events) else few
        held, self._held = self._held, []
        self._unsure.clear()
        self._holding.clear()
        for number, time, happening, messages in held:
            self._react(number, time, happening, messages)

    def _react(self, number: int, time: int, happening: Happening, messages: _Thrown) -> None:
        """Step a monitor at an event that threw one of these messages."""
        roles_of = [list(self.monitors[number].roles(happening, message)) for message in messages]
        if any(one != roles_of[0] for one in roles_of):
            for part in sorted({part for one in roles_of for part, _, _ in one}):
                self._lose(number, part, "not all messages of an instant were thrown by events: which, is not known")
            return
        for part, roles, key in roles_of[0]:
            if roles:
                self._step((number, part), time, roles, key, happening[0], happening[1])
            else:
                self._lose(number, part, "the message that an event threw is not known")

    def message(self, time: int, robot: str, topic: str, message: Any) -> None:
        """Take a message on a topic (full name) of `topics`; `robot` published it, empty: somebody else."""
        if time > self.now:
            self.advance(time)
        self._messages[robot, topic].append(message)
        source = ValueSource("topic", topic)
        if source in self._readers:
            self.sample(time, source, message)
        for pose in self._poses:
            if pose.name == topic:
                self.sample(time, pose, pose_of(message))
                self._measured.pop(pose, None)
                self._measured[pose] = time

    def sample(self, time: int, source: ValueSource, value: Any) -> None:
        """Take the value of a source; None if it is lost."""
        if time > self.now:
            self.advance(time)
        if value.__class__ in _PLAIN and self.values.get(source) == value:
            return  # a value holds until it changes
        self.values[source] = value
        self._dirty.update(dict.fromkeys(self._readers.get(source, ())))

    def variables(self, time: int, sources: Iterable[ValueSource], instance: int, variables: Mapping[str, Any]) -> None:
        """Sample variables of the instance of a robot that started last: one that it has removed is as NaN."""
        for source in sources:
            if source.name in variables:
                self._owners[source] = instance
                self.sample(time, source, variables[source.name])
            elif self._owners.get(source) == instance:
                self.sample(time, source, math.nan)

    def lose(self, robot: str | None, reason: str, since: int | None = None) -> None:
        """Events of a robot were lost, perhaps all after the time `since` (ns): what needs them is not known.

        None: events and messages of everybody.
        """
        for number, monitor in enumerate(self.monitors):
            subjects = {*(key[0] for key in monitor.events), *(one.subject for one in monitor.sources)}
            if robot is None or robot in subjects:
                for part in range(len(monitor.parts)):
                    state = self._states[number][part]
                    if since is not None and state[0] == VIOLATED and state[2] > since and _lacks(monitor):
                        self._states[number][part] = UNKNOWN, state[1], None, state[3], 2
                        self._reasons.setdefault(number, reason)
                    self._lose(number, part, reason)

    def _lose(self, number: int, part: int, reason: str) -> None:
        self._reasons.setdefault(number, reason)
        self._states[number][part] = self.monitors[number].parts[part].lose(self._states[number][part])

    def doubt(self, robot: str, doubt: int | None) -> None:
        """The clock of a robot may be wrong by `doubt` (ns) from now on; None: nobody knows by how much."""
        self._doubts[robot] = doubt
        self._clocks.clear()
        self._due = 0 if any(one.timed for one in self.monitors) else None

    def _doubt(self, place: _Place) -> tuple[int, int]:
        """The doubt (ns) between two events of a part, and between one of them and the clock of this judge."""
        doubts = self._clocks.get(place)
        if doubts is None:
            events = self.monitors[place[0]].events.items()
            robots = {key[0] for key, reactions in events if any(each.part == place[1] for each in reactions)}
            known = (self._doubts.get(robot, 0) for robot in robots)
            first, second = (*sorted((_FOREVER if each is None else each for each in known), reverse=True), 0, 0)[:2]
            doubts = self._clocks[place] = (first + second if len(robots) > 1 else 0, first + second)
        return doubts

    # ---- time --------------------------------------------------------------------------------------------------------

    @property
    def due(self) -> int | None:
        """The next time (ns) after which `advance` has to be called even if nothing happens; None: never."""
        times = (
            state[1] + part.bound + (self._doubt((number, place))[1] if self._doubts else 0)
            for number, monitor in enumerate(self.monitors)
            for place, (part, state) in enumerate(zip(monitor.parts, self._states[number], strict=True))
            if part.bound is not None and state[0] == OPEN
        )
        return min(times, default=None)

    def advance(self, time: int) -> None:
        """All instants before `time` (ns) are over."""
        if time <= self.now:
            return
        while self._measured and (lost := next(iter(self._measured.values())) + STALE + 1) < time:
            old = next(iter(self._measured))
            del self._measured[old]
            self.sample(lost, old, None)
        if self._held:
            self._release()
        if self._dirty:
            self._read()
        if self._messages:
            self._messages.clear()
        if self._due is not None and self._due < time:
            self._expire(time - 1)
        self.now = time

    def _read(self) -> None:
        dirty, self._dirty = self._dirty, {}
        for number, part in dirty:
            machine, state = self.monitors[number].parts[part], self._states[number][part]
            if state[0] == OPEN and machine.condition is not None:
                reading = machine.condition.read(self.values, self.now)
                unread = reading is None or reading[0] is None
                if unread and (names := machine.condition.unknown(self.values, self.now)):
                    self._reasons.setdefault(number, f"{names[0]} is not known at {self.now / SECOND:g} s")
                self._put((number, part), machine.sample(state, self.now, reading), self.now, "", "")
                if self.watch is not None and reading is not None and reading[1] is not None:
                    self._draw((number, part), reading[1])

    def _draw(self, place: _Place, slack: float) -> None:
        """Tell the current slack of a condition, at most once a second."""
        assert self.watch is not None
        last, before = self._curves.get(place, (-SECOND, 0.0))
        if self.now - last >= SECOND and slack != before:
            self._curves[place] = self.now, slack
            self.watch(self.now, replace(self._part_judgement(place), slack=slack))

    def _expire(self, time: int) -> None:
        """Tell monitors with a bound that `time` is over."""
        for number, monitor in enumerate(self.monitors):
            for part, machine in enumerate(monitor.parts) if monitor.timed else ():
                state = self._states[number][part]
                doubt = self._doubt((number, part))[1] if self._doubts else 0
                new = machine.expire(state, time, doubt)
                if new is not state:
                    self._put((number, part), new, (new[2] or 0) + doubt, "", "")
        self._due = self.due

    def _step(self, place: _Place, time: int, roles: int, key: Any, robot: str, element: str) -> None:
        number, part = place
        machine, state = self.monitors[number].parts[part], self._states[number][part]
        doubt = self._doubt(place)[0] if self._doubts and machine.bound is not None else 0
        new = machine.step(state, time, roles, key, doubt)
        if machine.condition is not None:
            self._dirty[place] = None
        if new is not state:
            if new[4] == UNCERTAIN > state[4]:
                apart = f"a bound is within the doubt of the clocks{_seconds(doubt)}"
                self._reasons.setdefault(number, SEVERAL if machine.each else apart)
            self._put(place, new, time, robot, element)
            due = machine.deadline(new)
            if due is not None and (self._due is None or due < self._due):
                self._due = due

    def _put(self, place: _Place, new: PartState, time: int, robot: str, element: str) -> None:
        """Keep a new state, and the event that led to it; `time` (ns) is when that is noticed."""
        number, part = place
        old, self._states[number][part] = self._states[number][part], new
        if new[0] == VIOLATED:
            condition = self.monitors[number].parts[part].condition
            values = " and ".join(condition.shown(self.values, self.now)) if condition is not None else ""
            self._broken[place] = robot, element, values
            if self._on_violation is not None and number not in self._told:
                self._told.add(number)
                self._on_violation(self._part_judgement(place))
        elif new[0] == OPEN and (old[0] != OPEN or old[1] != new[1]):
            self._began[place] = new[1], robot, element
        if self.watch is not None and (new[0], new[1]) != (old[0], old[1]):
            judgement = self._part_judgement(place)
            left = old[1] + (self.monitors[number].parts[part].bound or 0) - time
            answered = judgement.verdict != "violated" and old[0] == OPEN and self.monitors[number].timed
            self.watch(time, replace(judgement, slack=left / SECOND) if answered and left >= 0 else judgement)

    def _part_judgement(self, place: _Place) -> Judgement:
        number, part = place
        machine = self.monitors[number].parts[part]
        judgement = self._judgement(number, machine.verdict(self._states[number][part], part))
        return replace(judgement, robots=tuple(machine.binding.values()))

    # ---- judgements --------------------------------------------------------------------------------------------------

    def finish(self, time: int, *, complete: bool) -> list[Judgement]:
        """Return the judgements at the end of a run at `time` (ns). `complete`: nothing can come any more.

        Otherwise the run was cut, and what is pending stays so. What is given later is not judged.
        """
        self.advance(time)
        self.advance(self.now + 1)
        for number, monitor in enumerate(self.monitors):
            for part, machine in enumerate(monitor.parts) if complete else ():
                state = self._states[number][part]
                new = machine.finish(state, time)
                if new is not state:
                    self._put((number, part), new, time, "", "")
        self._watched, self._readers, self._due = {}, {}, None
        return self.judgements()

    def judgements(self, ended: int | None = None) -> list[Judgement]:
        """Return the judgements so far, in the order of the properties; those if nothing came
        after `ended` (ns), if given."""
        return [self._judgement(number, self._verdict(number, ended)) for number in range(len(self.monitors))]

    def declared(self) -> Iterator[dict[str, Any]]:
        """Yield each property before anything happened, JSON-serialisable: `names` has (robot,
        element) of its events."""
        for number, monitor in enumerate(self.monitors):
            named = ((robot, element) for robot, element, _ in monitor.events if element)
            names = [[*each] for each in (*named, *monitor.about)]
            yield {**self._judgement(number, self._verdict(number)).to_json(), "names": names}

    def _verdict(self, number: int, ended: int | None = None) -> Verdict:
        monitor, states = self.monitors[number], tuple(self._states[number])
        return monitor.verdict(states if ended is None else monitor.finish(states, ended))

    def _judgement(self, number: int, verdict: Verdict) -> Judgement:
        made, parts = self.monitors[number].spec, self.monitors[number].parts
        place = number, verdict.part
        began = self._began.get(place) if verdict.word in ("violated", "pending") else None
        broken = self._broken.get(place, ("", "", ""))
        ends = [began[1:]] if began is not None else []
        ends.append(broken[:2])
        decides = verdict.word in ("violated", "pending")
        robots = tuple(parts[verdict.part].binding.values()) if decides and parts else ()
        elements = tuple(each for each in dict.fromkeys(ends) if each[1])
        if decides and not elements:  # values broke it: it is drawn where its annotation is
            about = self.monitors[number].about
            elements = tuple(each for each in about if each[0] in robots) or about
        return Judgement(
            made.name,
            made.sentence,
            verdict.word,
            verdict.slack,
            None if verdict.time is None else verdict.time / SECOND,
            self._why(number, verdict, began, broken),
            robots,
            None if began is None else began[0] / SECOND,
            elements,
        )

    def _why(
        self, number: int, verdict: Verdict, began: tuple[int, str, str] | None, broken: tuple[str, str, str]
    ) -> str:
        """Why a property is violated, pending or not known."""
        if self.monitors[number].absent:
            return ABSENT
        made = self.monitors[number].spec
        part = self.monitors[number].parts[verdict.part] if self.monitors[number].parts else None
        if verdict.word == "not known":
            return self._reasons.get(number) or (
                "its values were not sampled" if made.condition else "events were lost"
            )
        if verdict.word not in ("violated", "pending") or part is None:
            return ""
        robots = f" ({', '.join(part.binding.values())})" if part.binding else ""
        at = "" if verdict.time is None else f"{verdict.time / SECOND:g} s"
        after = ""
        if began is not None and part.opens:
            opened = made.opens.text if made.opens is not None else f"{began[1]} starts"
            after = f"{opened} at {began[0] / SECOND:g} s, and "
        event = made.main.text if made.main is not None else ""
        if made.pattern == "exists":
            text = f"{after}not: {event}" + (f" by {at}" if at else "")
        elif made.condition:
            text = f"{after}at {at} {broken[2]}"
        else:
            text = f"{after}{event} at {at}" + (f" ({broken[0]})" if made.main and made.main.some else "")
        return text + robots


def _topics(monitors: Iterable[Monitor]) -> Iterable[str]:
    for monitor in monitors:
        yield from (source.subject for source in monitor.sources if source.kind == "topic")
        yield from (source.name for source in monitor.sources if source.kind == "pose" and source.name)
        yield from (each.topic for reactions in monitor.events.values() for each in reactions if each.topic)


def _lacks(monitor: Monitor) -> bool:
    """Whether what violates it is that an event has not come."""
    return monitor.spec.pattern in ("exists", "only after", "each time only after")


def _identity(part: Part) -> tuple[Any, ...]:
    """What a part is about."""
    return *part.binding.items(), part.condition.sources if part.condition else None


def _seconds(doubt: int) -> str:
    return ", which were not measured" if doubt >= _FOREVER else f" ({doubt / SECOND:.3g} s)"
