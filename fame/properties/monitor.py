"""Compile a property to a monitor: a small deterministic machine whose state is plain data.

A pool's name in a sentence means each of its robots: the property has a part for each choice of them (`Part.binding`),
and holds if all of its parts do. The state of a monitor is a tuple with the state of each part::

    (phase, since, memory, slack, triggered)

phase      WAITING for the scope, OPEN, ANSWERED (open, and nothing left to do), CLOSED for good, VIOLATED, UNKNOWN
since      ns: when the scope, or the oldest trigger that is not answered, began
memory     of the pattern: a count, whether the other event came, the keys that wait; when it was violated (ns)
slack      the least so far: s of a bound, the unit of a condition, or how many times are left
triggered  0, 1 when there was something to judge, 2 when something was lost and only a violation is certain, 3 while
           a condition has no value yet

States are hashable and can be kept and restored. Without a bound nothing depends on time: a host that gives 0 for every
step has finitely many states. Times are ns; events of one time are judged in the order in which they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Literal, NamedTuple, TypeAlias

from fame.dataclasses import dataclass, replace
from fame.properties.conditions import (
    Condition,
    LastValues,
    Reading,
    ValueSource,
    conditions_of,
    field_of,
    measured,
    meets,
    subjects,
)
from fame.properties.sentence import FieldTest, Occurrence, Property, Word
from fame.properties.vocabulary import Vocabulary

WAITING, OPEN, ANSWERED, CLOSED, VIOLATED, UNKNOWN = range(6)
OPENS, CLOSES, MAIN, OTHER, FAILS, CANCELS = 1, 2, 4, 8, 16, 32
"""The roles of an event in a sentence, added up. The last two say how a start ended, of ``each`` patterns."""
SECOND = 1_000_000_000

PartState: TypeAlias = tuple[int, int, Any, float | None, int]
State: TypeAlias = tuple[PartState, ...]
VerdictWord = Literal["holds", "violated", "pending", "not triggered", "not known"]
Happening = tuple[str, str, str, Any]
"""An event for a monitor: robot, element, what, detail, with the words of `fame.engine`, or ``log``."""
_UNKNOWN_KEY = object()


class Verdict(NamedTuple):
    """A verdict and the slack at the tightest instant (None without one).

    `time` (ns): of the violation; when a pending one is due, None without a bound. `part`: which one decided.
    """

    word: VerdictWord
    slack: float | None = None
    time: int | None = None
    part: int = 0


@dataclass(frozen=True, slots=True)
class Part:
    """A property for certain robots. Steps are pure functions of its state.

    binding     pool -> robot
    opens, closes   whether its scope begins, or ends, with an event
    bound       ns; `count` of ``at most``; `keyed`: events belong together by a key
    each        each start of an element or instance has an end of its own; which of them ends is not told
    condition   of ``always`` and ``never``
    """

    pattern: str
    binding: Mapping[str, str]
    opens: bool = False
    closes: bool = False
    bound: int | None = None
    count: int = 0
    keyed: bool = False
    each: bool = False
    condition: Condition | None = None

    @property
    def initial(self) -> PartState:
        """The state before anything happened."""
        return (WAITING, 0, None, None, 0) if self.opens else self._opened(0, None, None)

    def _opened(self, time: int, slack: float | None, key: Any) -> PartState:
        memory: Any = 0 if self.pattern == "at most" else None
        if self.keyed:
            memory = ((key, time),) if self.pattern == "exists" else ()
        return OPEN, time, memory, slack, int(self.condition is None and self.pattern in _JUDGED_WHEN_OPEN)

    def step(self, state: PartState, time: int, roles: int, key: Any = None, doubt: int = 0) -> PartState:
        """Return the state after an event with these `roles` at `time`; `key`: its field, of keyed patterns.

        `doubt` (ns): how far its time and that of what opened the scope may be apart from what they are; an answer so
        close to the bound is not known.
        """
        phase = state[0]
        if phase >= CLOSED:
            return state
        if phase == OPEN and self.bound is not None and time > state[1] + self.bound + doubt:
            return self._violated(state, state[1] + self.bound)
        if roles & CLOSES and phase != WAITING:
            if phase == OPEN and self.pattern == "exists":
                return self._violated(state, time)
            triggered = 2 if state[4] == 3 else state[4]
            state = (WAITING if self.opens else CLOSED, 0, None, state[3], triggered)
        elif phase == OPEN and roles & (MAIN | OTHER):
            new = _INSIDE[self.pattern](self, state, time, roles, key)
            if doubt and self._is_doubtful(state, new, time, key, doubt):
                new = *new[:3], state[3], 2
            state = new
        if roles & OPENS and state[0] <= ANSWERED:
            return self._open(state, time, key)
        return state

    def _open(self, state: PartState, time: int, key: Any) -> PartState:
        phase, since, memory, slack, triggered = state
        if self.each:
            failed, first, *starts = memory or (False, 0)
            begun = (failed, first, *starts, time) if starts else (failed, time, time)
            return OPEN, begun[2], begun, slack, max(triggered, 1)
        anew = self.closes and self.pattern in _JUDGED_FROM_LAST
        if phase in (WAITING, ANSWERED) or anew:
            opened = self._opened(time, slack, key)
            return (*opened[:4], max(triggered, opened[4]))
        if self.keyed and self.pattern == "exists" and all(key != known for known, _ in memory):
            return phase, since, (*memory, (key, time)), slack, triggered
        return state

    def _is_doubtful(self, old: PartState, new: PartState, time: int, key: Any, doubt: int) -> bool:
        """Whether an event answered what waits so close to the bound that it may be on the other side of it."""
        if self.bound is None or new is old:
            return False
        asked = next(begun for known, begun in old[2] if known == key) if self.keyed else old[1]
        return bool(abs(asked + self.bound - time) <= doubt)

    def expire(self, state: PartState, time: int, doubt: int = 0) -> PartState:
        """Return the state when the instant `time` is over; `doubt` (ns) as for `step`."""
        if self.bound is not None and state[0] == OPEN and time >= state[1] + self.bound + doubt:
            return self._violated(state, state[1] + self.bound)
        return state

    def sample(self, state: PartState, time: int, reading: Reading) -> PartState:
        """Return the state after its condition was read."""
        phase, since, memory, slack, triggered = state
        if phase != OPEN:
            return state
        if reading is None:
            return phase, since, memory, slack, _WITHOUT_VALUE[triggered]
        holds, own = reading
        if holds is None:
            return phase, since, memory, slack, 2
        if own is not None and (slack is None or own < slack):
            slack = own
        if not holds:
            return self._violated((phase, since, memory, slack, triggered), time)
        return phase, since, memory, slack, 2 if triggered == 2 else 1

    def _violated(self, state: PartState, time: int) -> PartState:
        slack = state[3] if self.condition is not None else None
        return VIOLATED, state[1], time, slack, 1

    def lose(self, state: PartState) -> PartState:
        """Return the state after events or values were lost: what is not certain any more is not known."""
        phase, since, memory, slack, _ = state
        if phase >= CLOSED:
            return state
        if self.pattern in ("always", "never", "at most") and not (self.opens or self.closes):
            return phase, since, memory, slack, 2
        return UNKNOWN, since, memory, slack, 2

    def finish(self, state: PartState, time: int) -> PartState:
        """Return the state when nothing can come any more."""
        state = self.expire(state, time)
        return self._violated(state, time) if state[0] == OPEN and self.pattern == "exists" else state

    def verdict(self, state: PartState, number: int = 0) -> Verdict:
        """Return the verdict so far."""
        phase, _, memory, slack, triggered = state
        if phase == VIOLATED:
            return Verdict("violated", slack, memory, number)
        if phase == UNKNOWN or triggered >= 2:
            return Verdict("not known", slack, None, number)
        if phase == OPEN and self.pattern == "exists":
            return Verdict("pending", slack, self.deadline(state), number)
        if not triggered:
            return Verdict("not triggered", slack, None, number)
        return Verdict("holds", slack, None, number)

    def deadline(self, state: PartState) -> int | None:
        """When (ns) it has to be told that time has passed; None: never."""
        return state[1] + self.bound if state[0] == OPEN and self.bound is not None else None


# ---- patterns: what an event does while the scope is open ------------------------------------------------------------

_WITHOUT_VALUE = (3, 2, 2, 3)
"""What becomes of `triggered` when the condition has no value: none yet, or no more."""
_JUDGED_WHEN_OPEN = ("never", "at most", "exists")
"""Patterns that are judged as soon as their scope is open; the others need an event or a value in it."""
_JUDGED_FROM_LAST = ("only after", "each time only after")
"""Patterns that hold in every open scope if they hold in the one that was opened last, and only then."""


def _never(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    return part._violated(state, time) if roles & MAIN else state


def _at_most(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, count, slack, triggered = state
    if not roles & MAIN:
        return state
    left = part.count - count - 1
    if left < 0:
        return part._violated(state, time)
    return phase, since, count + 1, left if slack is None else min(slack, left), triggered


def _only_after(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, came, slack, triggered = state
    if roles & MAIN:
        if not came:
            return part._violated(state, time)
        triggered = 1
    return phase, since, came or bool(roles & OTHER), slack, triggered


def _each_time_only_after(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, fresh, slack, triggered = state
    fresh = fresh or ()
    if roles & MAIN:
        if key not in fresh:
            return part._violated(state, time)
        fresh, triggered = tuple(each for each in fresh if each != key), 1
    if roles & OTHER and key not in fresh:
        fresh = (*fresh, key)
    return phase, since, fresh, slack, triggered


def _exists(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, memory, slack, triggered = state
    if not roles & MAIN:
        return state
    if part.each:
        return _each_ends(part, state, time, roles)
    if part.keyed:
        asked = next((begun for known, begun in memory if known == key), None)
        if asked is None:
            return state
        memory = tuple(each for each in memory if each[0] != key)
    else:
        asked, memory = since, None
    if part.bound is not None:
        left = (asked + part.bound - time) / SECOND
        slack = left if slack is None or left < slack else slack
    if memory:
        return phase, memory[0][1], memory, slack, triggered
    return ((ANSWERED if part.closes else WAITING) if part.opens else CLOSED), since, None, slack, triggered


def _each_ends(part: Part, state: PartState, time: int, roles: int) -> PartState:
    """One of what started has ended, and nobody knows which.

    If it is the oldest each time, all are as early as they can be: what is late then is late. They are surely in time
    if all that overlap have ended before the first of them would be late. What has failed may be kept as an incident,
    and be cancelled later: another end, of something that has ended.
    """
    _, _, (failed, first, *starts), slack, triggered = state
    if roles & CANCELS and failed:
        triggered = 2
    failed = failed or bool(roles & FAILS)
    if len(starts) > 1:
        return OPEN, starts[1], (failed, first, *starts[1:]), slack, triggered
    if part.bound is not None:
        left = (first + part.bound - time) / SECOND
        slack = left if slack is None or left < slack else slack
        triggered = 2 if left < 0 else triggered
    return WAITING, 0, (failed, 0), slack, triggered


_INSIDE: Mapping[str, Callable[[Part, PartState, int, int, Any], PartState]] = {
    "never": _never,
    "always": lambda part, state, time, roles, key: state,
    "at most": _at_most,
    "only after": _only_after,
    "each time only after": _each_time_only_after,
    "exists": _exists,
}


# ---- monitors --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Reaction:
    """An event has `roles` in a part, if its detail is `detail` (of a report: has it in its text; None: any), and its
    message on `topic` (full name) meets `where`. `same`: the field whose value is the key."""

    part: int
    roles: int
    detail: str | None = None
    where: tuple[FieldTest, ...] = ()
    same: tuple[str | int, ...] = ()
    topic: str = ""

    def fits(self, what: str, detail: Any) -> bool:
        """Return whether this is the event."""
        if self.detail is None:
            return True
        return self.detail in str(detail) if what == "log" else str(detail) == self.detail


@dataclass(frozen=True, slots=True)
class Monitor:
    """The monitor of a property.

    parts     one for each choice of robots; `initial` is the state before anything happened
    events    (robot, element, what) -> what this event does
    sources   the values that it reads
    about     (robot, element) of the elements with which its annotation is associated
    absent    whether a name in it means none of the robots that are there: nothing is known then
    """

    spec: Property
    parts: tuple[Part, ...]
    events: Mapping[tuple[str, str, str], tuple[Reaction, ...]]
    about: tuple[tuple[str, str], ...] = ()
    absent: bool = False

    @property
    def initial(self) -> State:
        """The state before anything happened."""
        return tuple(part.initial for part in self.parts)

    @property
    def sources(self) -> frozenset[ValueSource]:
        """The values that it reads."""
        return frozenset(source for part in self.parts if part.condition for source in part.condition.sources)

    @property
    def timed(self) -> bool:
        """Whether it has a bound, so that verdicts need a clock."""
        return self.spec.bound is not None

    @property
    def reads_messages(self) -> bool:
        """Whether events need their messages: a monitor that gets none gives not known."""
        return any(each.where or each.same for reactions in self.events.values() for each in reactions)

    def step(
        self,
        state: State,
        time: int,
        event: Happening | None = None,
        message: Any = None,
        values: LastValues | None = None,
    ) -> State:
        """Return the state after an event, with the message that it threw; after new `values`; or
        when the instant is over.

        All events of an instant come first, then its values, then the call with neither.
        """
        if event is not None:
            parts = list(state)
            for number, roles, key in self.roles(event, message):
                part = self.parts[number]
                lost = key is _UNKNOWN_KEY
                parts[number] = part.lose(parts[number]) if lost else part.step(parts[number], time, roles, key)
            return tuple(parts)
        if values is not None:
            return tuple(
                part.sample(one, time, part.condition.read(values, time)) if part.condition else one
                for part, one in zip(self.parts, state, strict=True)
            )
        return tuple(part.expire(one, time) for part, one in zip(self.parts, state, strict=True))

    def roles(self, event: Happening, message: Any) -> Iterator[tuple[int, int, Any]]:
        """(number of the part, roles, key) of an event; one for each part that it concerns."""
        robot, element, what, detail = event
        found: dict[int, tuple[int, Any]] = {}
        for reaction in self.events.get((robot, element, what), ()):
            if not reaction.fits(what, detail):
                continue
            met: bool | None = True
            if reaction.where:
                met = meets(message, reaction.where)
            key = measured(field_of(message, reaction.same)) if reaction.same else None
            if met is None or (reaction.same and key is None):
                found[reaction.part] = 0, _UNKNOWN_KEY
            elif met and found.get(reaction.part, (0, None))[1] is not _UNKNOWN_KEY:
                before, known = found.get(reaction.part, (0, None))
                found[reaction.part] = before | reaction.roles, key if reaction.same else known
        for number, (roles, key) in found.items():
            yield number, roles, key

    def finish(self, state: State, time: int) -> State:
        """Return the state when nothing can come any more."""
        return tuple(part.finish(one, time) for part, one in zip(self.parts, state, strict=True))

    def verdict(self, state: State) -> Verdict:
        """Return the verdict so far: the gravest of its parts, with the least slack and the earliest time."""
        if self.absent:
            return Verdict("not known")
        verdicts = [part.verdict(one, number) for number, (part, one) in enumerate(zip(self.parts, state, strict=True))]
        return _overall(verdicts)

    def deadline(self, state: State) -> int | None:
        """Return the next time (ns) at which it has to be told that an instant is over; None: never."""
        due = (part.deadline(one) for part, one in zip(self.parts, state, strict=True))
        return min((time for time in due if time is not None), default=None)


_GRAVITY: Sequence[VerdictWord] = ("violated", "not known", "pending", "holds", "not triggered")


def _overall(verdicts: Sequence[Verdict]) -> Verdict:
    """The verdict about several parts."""
    if not verdicts:
        return Verdict("not triggered")
    first = min(verdicts, key=lambda one: (_GRAVITY.index(one.word), one.time is None, one.time or 0))
    slacks = [one.slack for one in verdicts if one.slack is not None]
    return first._replace(slack=min(slacks, default=None))


# ---- compile ---------------------------------------------------------------------------------------------------------


def compile(property: Property, vocabulary: Vocabulary) -> Monitor:
    """Return the monitor of a property for the robots of a collaboration.

    Raises ConfigError, with file, line and column, for a robot, element, topic, variable or field that is not there.
    """
    made = _from_start(property)
    parts: list[Part] = []
    events: dict[tuple[str, str, str], list[Reaction]] = {}
    bindings = _bindings(made, vocabulary)
    for names in bindings:
        for condition in conditions_of(made, vocabulary, names) if made.condition else [None]:
            part = Part(
                made.pattern,
                names,
                made.opens is not None,
                made.closes is not None,
                made.bound,
                made.count,
                bool(made.same),
                _is_each(made),
                condition,
            )
            _react(made, vocabulary, names, len(parts), events)
            parts.append(part)
    terms = vocabulary.robots
    about = tuple((one, id) for one in terms for id in made.about if id in terms[one].own or id in terms[one].called)
    return Monitor(made, tuple(parts), {key: tuple(found) for key, found in events.items()}, about, not bindings)


def _from_start(made: Property) -> Property:
    """``F within T`` counts from the start of the instance of the robot that does F."""
    if made.pattern != "exists" or made.bound is None or made.opens is not None or made.main is None:
        return made
    start = Occurrence(made.main.robot, "starts", Word(""), made.main.some, text=f"{made.main.robot.text} starts")
    return replace(made, opens=start)


def _is_each(made: Property) -> bool:
    """Whether it says of something that starts that it ends."""
    begin, end = made.opens, made.main
    if made.pattern != "exists" or begin is None or end is None or begin.some or end.some:
        return False
    same = (begin.robot.text, begin.target.text) == (end.robot.text, end.target.text)
    return same and begin.verb == "starts" and end.verb == "ends"


def _bindings(made: Property, vocabulary: Vocabulary) -> list[dict[str, str]]:
    """Every choice of a robot for each pool that is named without ``some`` or ``any two``."""
    names = [event.robot for event in made.occurrences if not event.some]
    for value in subjects(made):
        names += [value.subject] if value.kind != "distance" else [value.subject, value.other] if value.other else []
    pools: dict[str, tuple[str, ...]] = {}
    for name in names:
        robots = vocabulary.robots_of(name, made)
        if name.text not in vocabulary.robots:
            pools[name.text] = robots
    return [dict(zip(pools, chosen, strict=True)) for chosen in product(*pools.values())]


def _react(
    made: Property,
    vocabulary: Vocabulary,
    binding: Mapping[str, str],
    part: int,
    events: dict[tuple[str, str, str], list[Reaction]],
) -> None:
    """Add what events do in a part."""
    keyed = {OPENS, MAIN} if made.pattern == "exists" else {MAIN, OTHER}
    other = CLOSES if made.pattern == "never" else OTHER
    for role, event in ((OPENS, made.opens), (CLOSES, made.closes), (MAIN, made.main), (other, made.other)):
        if event is None:
            continue
        bound = binding.get(event.robot.text)
        for robot in (bound,) if bound and not event.some else vocabulary.robots_of(event.robot, made):
            same = made.same if role in keyed else ()
            fields = [(test.path, test.offset) for test in event.where] + (
                [(same, event.target.offset)] if same else []
            )
            topic = event.target.text
            topic = (f"/{robot}{topic[1:]}" if topic.startswith("~") else topic) if fields else ""
            for path, offset in fields:
                vocabulary.check_topic_field(topic, path, made, offset)
            instance = event.verb not in ("throws", "catches", "reports") and not event.target.text
            for element in vocabulary.elements(robot, event, made):
                for what, detail in _marks(event, instance):
                    how = _HOW.get(what, 0) if event.verb == "ends" else 0
                    reaction = Reaction(part, role | how, detail, event.where, same, topic)
                    events.setdefault((robot, element, what), []).append(reaction)


_HOW = {"fail": FAILS, "cancel": CANCELS}
"""Mark of an element -> the role that says how it ended."""


def _marks(event: Occurrence, instance: bool) -> Sequence[tuple[str, str | None]]:
    """The marks of the engine, with their detail, that an event means."""
    if event.verb == "reports":
        return (("log", event.target.text or None),)
    if instance:
        ends = {"completes": ("completed",), "fails": ("failed",), "is cancelled": ("cancelled",)}
        if event.verb == "starts":
            return (("start", None),)
        return tuple(("end", word) for word in ends.get(event.verb, ("completed", "failed", "cancelled")))
    if event.verb == "ends":
        return ("leave", None), ("fail", None), ("cancel", None)
    if event.verb == "fails":
        return (("fail", event.code),)
    return ({"starts": ("enter", None), "is cancelled": ("cancel", None)}.get(event.verb, ("leave", None)),)
