"""Compile a property to a monitor: a small deterministic machine whose state is plain data.

A pool's name in a sentence means each of its robots: the property has a part for each choice of them (`Part.binding`),
and holds if all of its parts do. The state of a monitor is a tuple with the state of each part, of which
`fame.properties.parts` has the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, TypeAlias

from fame.dataclasses import dataclass, replace
from fame.properties.conditions import LastValues, ValueSource, conditions_of, field_of, measured, meets, subjects
from fame.properties.parts import (
    CANCELS,
    CLOSES,
    FAILS,
    MAIN,
    OPENS,
    OTHER,
    Part,
    PartState,
    Verdict,
    VerdictWord,
)
from fame.properties.sentence import FieldTest, Occurrence, Property, Word
from fame.properties.vocabulary import Vocabulary

State: TypeAlias = tuple[PartState, ...]
Happening = tuple[str, str, str, Any]
"""An event for a monitor: robot, element, what, detail, with the words of `fame.engine`, or ``log``."""
_UNKNOWN_KEY = object()


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
                part.sample(own, time, part.condition.read(values, time)) if part.condition else own
                for part, own in zip(self.parts, state, strict=True)
            )
        return tuple(part.expire(one, time) for part, one in zip(self.parts, state, strict=True))

    def roles(self, event: Happening, message: Any) -> Iterator[tuple[int, int, Any]]:
        """(number of the part, roles, key) of an event; one for each part that it concerns."""
        robot, element, what, detail = event
        by_part: dict[int, tuple[int, Any]] = {}
        for reaction in self.events.get((robot, element, what), ()):
            if not reaction.fits(what, detail):
                continue
            met: bool | None = True
            if reaction.where:
                met = meets(message, reaction.where)
            key = measured(field_of(message, reaction.same)) if reaction.same else None
            if met is None or (reaction.same and key is None):
                by_part[reaction.part] = 0, _UNKNOWN_KEY
            elif met and by_part.get(reaction.part, (0, None))[1] is not _UNKNOWN_KEY:
                before, known = by_part.get(reaction.part, (0, None))
                by_part[reaction.part] = before | reaction.roles, key if reaction.same else known
        for number, (roles, key) in by_part.items():
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
    for names in _bindings(made, vocabulary):
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
    absent = not all(vocabulary.robots_of(name, made) for name, _ in _names(made))
    return Monitor(made, tuple(parts), {key: tuple(each) for key, each in events.items()}, about, absent)


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


def _names(made: Property) -> Iterator[tuple[Word, bool]]:
    """Yield each name of a robot or pool, and whether it is ``some``, or ``any two``, of a pool."""
    for event in made.occurrences:
        yield event.robot, event.some
    for value in subjects(made):
        yield value.subject, value.kind == "distance" and value.other is None
        if value.other is not None:
            yield value.other, False


def _bindings(made: Property, vocabulary: Vocabulary) -> list[dict[str, str]]:
    """Every choice of a robot for each pool that is named without ``some`` or ``any two``."""
    chosen = [name for name, some in _names(made) if not some]
    pools = {name.text: vocabulary.robots_of(name, made) for name in chosen if name.text not in vocabulary.robots}
    return [dict(zip(pools, robots, strict=True)) for robots in product(*pools.values())]


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
