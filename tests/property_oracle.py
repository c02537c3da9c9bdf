"""A judge of properties from docs/property_sentences.md alone: as slow and as plain as its tables.

Every scope of a run is listed, and every way in which what is not known may have been; the verdict is not known where
these ways differ. It imports nothing of FAME.
"""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

OPERATORS = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq, "!=": operator.ne
}  # fmt: skip
ENDS = ("completes", "fails", "is cancelled")
ORDER = ("violated", "not known", "pending", "holds", "not triggered")
WORLDS = 1000
"""Most ways of what is not known that are tried."""


@dataclass(frozen=True)
class Event:
    """EVENT of a sentence, or one that happened: `detail` is its error code or text, `fields` the message thrown.

    Of a sentence, `where` has (field, operator, constant), and `robot` may be a pool.
    """

    robot: str
    action: str
    target: str = ""
    detail: str = ""
    some: bool = False
    where: tuple[tuple[str, str, Any], ...] = ()
    fields: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        at = "at " if self.action in ENDS[1:] and self.target else ""
        target = json.dumps(self.detail) if self.action == "reports" else at + self.target
        code = f" with {json.dumps(self.detail)}" if self.detail and self.action == "fails" else ""
        where = " and ".join(f"{field} {sign} {json.dumps(constant)}" for field, sign, constant in self.where)
        text = f"{'some ' * self.some}{self.robot} {self.action} {target}".rstrip()
        return text + code + (f" where {where}" if where else "")


@dataclass(frozen=True)
class Sentence:
    """F and E are the events of a pattern, `opens` and `closes` those of its scope; `bound` is in s.

    pattern     always, never (condition), none (never F), before, only, each, most, exists
    condition   (value, operator, value) ...: texts with a dot name values
    """

    pattern: str
    f: Event | None = None
    e: Event | None = None
    condition: tuple[tuple[str, str, Any], ...] = ()
    opens: Event | None = None
    closes: Event | None = None
    bound: float | None = None
    times: int = 0
    same: str = ""
    form: str = "between"

    def __str__(self) -> str:
        bound = "" if self.bound is None else f" within {self.bound:g} s"
        same = f" with the same {self.same}" if self.same else ""
        shown = " and ".join(f"{a} {sign} {_shown(b)}" for a, sign, b in self.condition)
        text = {
            "always": f"always {shown}", "never": f"never {shown}", "none": f"never {self.f}",
            "before": f"never {self.f} before {self.e}", "only": f"{self.f} only after {self.e}",
            "each": f"{self.f} each time only after {self.e}{same}", "most": f"{self.f} at most {self.times} times",
            "exists": f"{'' if self.opens else 'exists '}{self.f}{bound}{same}",
        }[self.pattern]  # fmt: skip
        if self.opens is None or self.closes is None:
            text = f"after {self.opens}, {text}" if self.opens else text
            return f"{text} until {self.closes}" if self.closes else text
        forms = {
            "between": f"between {self.opens} and {self.closes}, {text}",
            "until": f"after {self.opens} until {self.closes}, {text}",
            "last": f"after {self.opens}, {text} until {self.closes}",
        }
        return forms["until" if self.form == "last" and self.pattern == "before" else self.form]

    @property
    def events(self) -> list[Event]:
        return [each for each in (self.f, self.e, self.opens, self.closes) if each]

    @property
    def of_tokens(self) -> bool:
        """Whether it is about each token: ``after R starts X, R ends X``."""
        if self.pattern != "exists" or self.opens is None or self.f is None or self.opens.some or self.f.some:
            return False
        begins, ends = self.opens, self.f
        named = (begins.robot, begins.target) == (ends.robot, ends.target)
        return named and (begins.action, ends.action) == ("starts", "ends")


def _shown(value: Any) -> str:
    return value if isinstance(value, str) and "." in value else json.dumps(value)


@dataclass(frozen=True)
class Run:
    """What happened at which second: events, and the values at the end of each instant. `complete`: nothing can come
    any more; else it was cut at `end`. `pool`: name -> robots."""

    items: Sequence[tuple[float, Event | dict[str, Any]]]
    end: float
    complete: bool
    pool: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Finding:
    verdict: str
    time: float | None = None
    slack: float | None = None


class _Open(Exception):
    """A question that this world has no answer to yet."""


class _World:
    def __init__(self, answers: dict[Any, Any]) -> None:
        self.answers = answers

    def choose(self, question: Any, options: Sequence[Any]) -> Any:
        if len(options) == 1:
            return options[0]
        if question not in self.answers:
            raise _Open(question, options)
        return self.answers[question]

    def decide(self, question: Any, answer: bool | None) -> bool:
        return bool(self.choose(question, (True, False) if answer is None else (answer,)))


def judge(sentence: Sentence, run: Run) -> Finding | None:
    """What a sentence comes to in a run; None where there are too many ways to try."""
    found = []
    for world in _bindings(sentence, run):
        results, todo = list[Finding](), [dict[Any, Any]()]
        while todo:
            answers = todo.pop()
            try:
                results.append(_in_world(world, run, _World(answers)))
            except _Open as asked:
                todo += [{**answers, asked.args[0]: option} for option in asked.args[1]]
            if len(results) + len(todo) > WORLDS:
                return None
        same = len({each.verdict for each in results}) == 1
        latest = max(results, key=lambda each: each.time or 0)
        found.append(results[0] if len(results) == 1 else latest if same else Finding("not known"))
    return _gravest(found)


def _bindings(sentence: Sentence, run: Run) -> Iterator[Sentence]:
    """The sentence for each choice of robots for the pools that it names without some."""
    values = " ".join(str(part) for each in sentence.condition for part in each if "(" not in str(part))
    names = [
        pool
        for pool in run.pool
        if f"{pool}." in values or any(each.robot == pool and not each.some for each in sentence.events)
    ]
    for robots in product(*(run.pool[name] for name in names)):
        chosen = dict(zip(names, robots, strict=True))

        def bound(event: Event | None, chosen: dict[str, str] = chosen) -> Event | None:
            return event and (event if event.some else replace(event, robot=chosen.get(event.robot, event.robot)))

        def named(value: Any, chosen: dict[str, str] = chosen) -> Any:
            head, dot, rest = value.partition(".") if isinstance(value, str) else ("", "", "")
            return f"{chosen[head]}.{rest}" if dot and head in chosen else value

        condition = tuple((named(a), sign, named(b)) for a, sign, b in sentence.condition)
        f, e, opens, closes = (bound(each) for each in (sentence.f, sentence.e, sentence.opens, sentence.closes))
        yield replace(sentence, f=f, e=e, opens=opens, closes=closes, condition=condition)


def _gravest(found: Sequence[Finding]) -> Finding:
    word = min((each.verdict for each in found), key=ORDER.index, default="not triggered")
    times = [each.time for each in found if each.verdict == word and each.time is not None]
    slacks = [each.slack for each in found if each.slack is not None]
    return Finding(word, min(times, default=None), min(slacks, default=None))


def compare(left: Any, sign: str, right: Any) -> bool | None:
    """None: not known, with NaN and for the order of what is no number."""
    if any(isinstance(each, float) and math.isnan(each) for each in (left, right)):
        return None
    if sign not in ("==", "!=") and (isinstance(left, str) or isinstance(right, str)):
        return None
    return bool(OPERATORS[sign](left, right))


def all_of(parts: Sequence[bool | None]) -> bool | None:
    return False if False in parts else None if None in parts else True


def _in_world(sentence: Sentence, run: Run, world: _World) -> Finding:
    def is_(event: Event | None, number: int) -> bool:
        happened = run.items[number][1]
        if event is None or isinstance(happened, dict) or not _matches(event, happened, run):
            return False
        fields = dict(happened.fields)
        return world.decide(
            (event, number), all_of([compare(fields[name], sign, value) for name, sign, value in event.where])
        )

    numbers = range(len(run.items))
    begins = [(run.items[number][0], number + 1) for number in numbers if is_(sentence.opens, number)]
    if sentence.opens is None:
        begins = [(0.0, 0)]
        if sentence.pattern == "exists" and sentence.bound is not None and sentence.f is not None:
            start = Event(sentence.f.robot, "starts", some=sentence.f.some)
            begins = [(run.items[number][0], number + 1) for number in numbers if is_(start, number)]
    elif sentence.closes is None and sentence.pattern not in ("exists", "before"):
        begins = begins[:1]
    owner = _owners(sentence, run, is_, world) if sentence.of_tokens else {}
    found = []
    for since, first in begins:
        close = next((number for number in numbers[first:] if is_(sentence.closes, number)), None)
        scope = _Scope(sentence, run, world, is_, since, first, close, owner)
        found.append(scope.condition() if sentence.condition else scope.events())
    return _gravest(found)


def _matches(event: Event, happened: Event, run: Run) -> bool:
    robots = run.pool[event.robot] if event.some and event.robot in run.pool else (event.robot,)
    if happened.robot not in robots:
        return False
    if event.action == "reports":
        return happened.action == "reports" and event.detail in happened.detail
    same = happened.action in ENDS if event.action == "ends" else happened.action == event.action
    return same and happened.target == event.target and event.detail in ("", happened.detail)


def _owners(
    sentence: Sentence, run: Run, is_: Callable[[Event | None, int], bool], world: _World
) -> dict[int, int | None]:
    """End -> start of the token that it may be of. What has failed may be cancelled later: that ends nothing."""
    opened, owner, failed = list[int](), dict[int, int | None](), False
    for number, (_, happened) in enumerate(run.items):
        if is_(sentence.opens, number):
            opened.append(number)
        elif is_(sentence.f, number) and opened and isinstance(happened, Event):
            options: list[int | None] = [*opened]
            options += [None] if failed and happened.action == "is cancelled" else []
            failed = failed or happened.action == "fails"
            owner[number] = world.choose(("token", number), options)
            opened = [each for each in opened if each != owner[number]]
    return owner


@dataclass(frozen=True)
class _Scope:
    """A pattern between two items of a run."""

    sentence: Sentence
    run: Run
    world: _World
    is_: Callable[[Event | None, int], bool]
    since: float
    first: int
    close: int | None
    owner: dict[int, int | None]

    def condition(self) -> Finding:
        negated, slacks = self.sentence.pattern == "never", list[float]()
        instants = judged = 0
        for number in range(self.first, self.last):
            time, values = self.run.items[number]
            if isinstance(values, Event):
                continue
            instants += 1
            parts, lost, least = [], False, list[float]()
            for left, sign, right in self.sentence.condition:
                a, b = (values.get(each) if isinstance(each, str) and "." in each else each for each in (left, right))
                parts.append(None if a is None or b is None else compare(a, sign, b))
                lost = lost or (parts[-1] is None and None not in (a, b)) or a != a or b != b
                if sign not in ("==", "!=") and parts[-1] is not None:
                    least.append(float(b - a if sign[0] == "<" else a - b))
            true = all_of(parts)
            if true is None and not lost:
                continue  # it has no value yet
            judged += 1
            if self.world.decide(("condition", self.first, number), true) == negated:
                return Finding("violated", time)
            if least and None not in parts:
                slacks.append(-min(least) if negated else min(least))
        if instants and not judged and not self.world.decide(("no value", self.first), None):
            return Finding("violated", 0)
        return Finding("holds" if instants else "not triggered", slack=min(slacks, default=None))

    def events(self) -> Finding:
        sentence, count, seen = self.sentence, 0, list[int]()
        if sentence.pattern == "exists":
            return self.existence()
        for number in range(self.first, self.last):
            time, is_e = self.run.items[number][0], self.is_(sentence.e, number)
            if is_e and sentence.pattern == "before":
                break
            if self.is_(sentence.f, number):
                count += 1
                alone = not any(self.pair(number, each) for each in seen)
                over = sentence.pattern == "most" and count > sentence.times
                if over or sentence.pattern in ("none", "before") or (alone and sentence.pattern in ("only", "each")):
                    return Finding("violated", time)
                if sentence.pattern == "each":
                    seen = [each for each in seen if not self.pair(number, each)]
            if is_e:
                seen.append(number)
        if sentence.pattern in ("only", "each") and not count:
            return Finding("not triggered")
        return Finding("holds", slack=sentence.times - count if sentence.pattern == "most" and count else None)

    @property
    def last(self) -> int:
        return len(self.run.items) if self.close is None else self.close

    def pair(self, one: int, other: int) -> bool:
        """Whether the messages of two events have the same value in the field of the sentence."""
        if not self.sentence.same:
            return True
        messages = [self.run.items[number][1] for number in (one, other)]
        values = [dict(each.fields)[self.sentence.same] for each in messages if isinstance(each, Event)]
        return self.world.decide(("same", *sorted((one, other))), compare(values[0], "==", values[1]))

    def existence(self) -> Finding:
        due = math.inf if self.sentence.bound is None else self.since + self.sentence.bound
        for number in range(self.first, self.last):
            time = self.run.items[number][0]
            own = self.owner.get(number) == self.first - 1 if self.sentence.of_tokens else True
            if time <= due and own and self.is_(self.sentence.f, number) and self.pair(self.first - 1, number):
                return Finding("holds", slack=None if math.isinf(due) else due - time)
        end = self.run.end if self.close is None else self.run.items[self.close][0]
        if self.close is not None or self.run.complete or end >= due:
            return Finding("violated", min(end, due))
        return Finding("pending", None if math.isinf(due) else due)
