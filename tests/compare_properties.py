"""Compare monitors of properties with their meaning. ``python -m tests.compare_properties --traces 10000``

The meaning is that of docs/property_sentences.md: on the whole trace, quantifier by quantifier, with no
state. Each random trace is judged by a property of each pattern and scope, with and without bounds, pools and fields.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from random import Random
from typing import Any, NamedTuple

from fame.properties import Judge, Property, Vocabulary, compile, parse
from fame.properties.conditions import RobotPosition, ValueSource
from fame.properties.sentence import Occurrence, Value
from fame.properties.vocabulary import RobotTerms

S = 1_000_000_000
POOL = ("T_1", "T_2")


def terms(robot: str) -> RobotTerms:
    elements = {"x": "X", "y": "Y", "throw": "found", "reply": "done"}
    throws = {"/found": ("throw",), "/done": ("reply",)}
    return RobotTerms(f"P_{robot[0]}", elements, {}, throws, {"/found": ("y",)}, variables=("v", "w"))


VOCABULARY = Vocabulary({robot: terms(robot) for robot in ("A", "B", *POOL)}, {"T": POOL})

EVENTS = (
    "A starts x", "A completes x", "B starts y", "T starts x", "some T starts x", "A throws /found", "B throws /done",
    "A throws /found where id > 1", "T throws /done", "A fails at x", 'A fails at x with "c"', "B is cancelled at y",
    "A ends x", "A starts", "B completes", "B catches /found", 'A reports "low"',
)  # fmt: skip
CONDITIONS = (
    "A.v > 1", "A.v != B.v and B.v < 3", "T.v <= A.v", "distance(any two T) > 1", "A.battery >= 0.5", 'A.v == "text"',
)  # fmt: skip


def sentences(random: Random) -> Iterator[str]:
    """A sentence of each pattern in each scope, with random events."""
    event = lambda: random.choice(EVENTS)  # noqa: E731
    bound = lambda: random.choice(("", f" within {random.choice((1, 2, 3))} s"))  # noqa: E731
    patterns = (
        f"always {random.choice(CONDITIONS)}", f"never {random.choice(CONDITIONS)}", f"never {event()}",
        f"{event()} only after {event()}", f"{event()} each time only after {event()}",
        f"{event()} at most {random.choice((0, 1, 2))} times", f"{event()}{bound()}", f"exists {event()}{bound()}",
    )  # fmt: skip
    for pattern in patterns:
        yield pattern
        yield f"after {event()}, {pattern}"
        yield f"{pattern} until {event()}"
        yield f"between {event()} and {event()}, {pattern}"
    yield f"never {event()} before {event()}"
    yield f"after A throws /found, some T throws /done{bound()} with the same id"
    yield "T throws /done each time only after A throws /found with the same id"
    yield f"after A starts x, A ends x{bound()}"
    yield f"after T starts x, T ends x{bound()}"


# ---- traces ----------------------------------------------------------------------------------------------------------


class Item(NamedTuple):
    """An event (robot, element, what, detail) with its message, or a value (source, value)."""

    time: int
    event: tuple[str, str, str, Any] | None = None
    message: Any = None
    source: ValueSource | None = None
    value: Any = None


def trace(random: Random) -> tuple[list[Item], int, bool]:
    """What happens, until when, and whether nothing can come any more."""
    time, items = 0, list[Item]()
    for _ in range(random.randrange(50)):
        time += random.choice((0, 0, S // 2, S, 3 * S))
        items.append(_item(random, time))
    return items, time + random.choice((0, S, 4 * S)), random.random() < 0.5


def _item(random: Random, time: int) -> Item:
    robot = random.choice(("A", "A", "B", *POOL))
    kind = random.randrange(8)
    if kind < 2:
        value = random.choice((0, 1, 2, 3, 3, None, "text", math.nan))
        return Item(time, source=ValueSource("variable", robot, "v"), value=value)
    if kind == 2:
        pose = RobotPosition(random.choice((0, 1, 3)), 0.0, frame=random.choice(("world", "world", "world", "map")))
        return Item(time, source=ValueSource("pose", robot), value=pose)
    if kind == 3:
        return Item(time, source=ValueSource("battery", robot), value=random.choice((0.2, 0.5, 0.9, math.nan)))
    if kind == 4:
        message = random.choice(({"id": 1}, {"id": 2}, {"id": 3}))
        return Item(time, (robot, random.choice(("throw", "reply")), "leave", None), message)
    if kind == 5:
        event = random.choice((("start", None), ("end", "completed"), ("end", "failed")))
        return Item(time, (robot, f"P_{robot[0]}", *event))
    if kind == 6:
        return Item(time, (robot, "", "log", random.choice(("battery low", "fine"))))
    what = random.choice((("enter", None), ("leave", None), ("fail", "c"), ("fail", "d"), ("cancel", None)))
    return Item(time, (robot, random.choice(("x", "y")), *what))


# ---- the meaning, on a whole trace -----------------------------------------------------------------------------------

Result = tuple[str, float | None, int | None]
ORDER = ("violated", "not known", "pending", "holds", "not triggered")


def meaning(made: Property, items: Sequence[Item], end: int, complete: bool) -> Result:
    """Verdict, slack and time of a property: what holds for every choice of robots for its pools."""
    names = {event.robot.text for event in made.occurrences if not event.some}
    names |= {value.subject.text for value in values_of(made) if value.kind != "topic" and not any_two(value)}
    pools = [name for name in sorted(names) if name == "T"]
    found = [
        _of_part(made, dict(zip(pools, chosen, strict=True)), items, end, complete)
        for chosen in product(POOL, repeat=len(pools))
    ]
    word, _, time = min(found, key=lambda one: (ORDER.index(one[0]), one[2] is None, one[2] or 0))
    return word, min((one[1] for one in found if one[1] is not None), default=None), time


def any_two(value: Value) -> bool:
    return value.kind == "constant" or (value.kind == "distance" and value.other is None)


def values_of(made: Property) -> list[Value]:
    return [value for part in made.condition for value in (part.left, part.right)]


def is_event(event: Occurrence | None, item: Item, robots: dict[str, str]) -> bool:
    """Whether an item of a trace is what a sentence means."""
    if event is None or item.event is None:
        return False
    robot, element, what, detail = item.event
    wanted = (robots.get(event.robot.text, event.robot.text),)
    if event.robot.text == "T" and event.some:
        wanted = POOL
    if robot not in wanted:
        return False
    if event.verb in ("throws", "catches"):
        ends = terms(robot).throws if event.verb == "throws" else terms(robot).catches
        meets = all(item.message is not None and item.message["id"] > test.constant for test in event.where)
        return what == "leave" and element in ends[event.target.text] and meets
    if event.verb == "reports":
        return what == "log" and event.target.text in detail
    if not event.target.text:
        words = {"starts": [("start", None)], "completes": [("end", "completed")], "fails": [("end", "failed")]}
        return element == f"P_{robot[0]}" and (what, detail) in words[event.verb]
    words = {"starts": "enter", "completes": "leave", "fails": "fail", "is cancelled": "cancel"}
    ends = ("leave", "fail", "cancel") if event.verb == "ends" else (words[event.verb],)
    return element == event.target.text and what in ends and event.code in (None, detail)


def _of_part(made: Property, robots: dict[str, str], items: Sequence[Item], end: int, complete: bool) -> Result:
    opens = made.opens
    if made.pattern == "exists" and made.bound is not None and opens is None:
        assert made.main is not None
        opens = Occurrence(made.main.robot, "starts", made.main.target._replace(text=""), made.main.some)
    if opens is not None and made.main is not None and made.closes is None and made.pattern == "exists":
        named = [(one.robot.text, one.target.text, one.some) for one in (opens, made.main)]
        if (opens.verb, made.main.verb) == ("starts", "ends") and named[0] == named[1] and not opens.some:
            return _of_each(made, opens, robots, items, end, complete)
    spans = _spans(made, opens, robots, items)
    if made.condition:  # in parts of the run that end together it counts in the longest
        whole = {last: first for first, last in reversed(spans)}
        return _of_condition(made, robots, items, sorted((first, last) for last, first in whole.items()), end)
    judged = [_of_span(made, robots, items, span, end, complete) for span in spans]
    violated = [time for word, _, time in judged if word == "violated" and time is not None]
    if violated:
        return "violated", None, min(violated)
    slacks = [slack for _, slack, _ in judged if slack is not None]
    pending = [time for word, _, time in judged if word == "pending"]
    word = next((one for one in ORDER if any(one == each[0] for each in judged)), "not triggered")
    due = None if word != "pending" or made.bound is None else min(time for time in pending if time is not None)
    return word, min(slacks, default=None), due


def _spans(
    made: Property, opens: Occurrence | None, robots: dict[str, str], items: Sequence[Item]
) -> list[tuple[int, int]]:
    """The parts of a run in which a pattern counts: numbers of the events before and behind each; len(items): the end.

    The rows of the table of scopes: the whole run; after the first E, of an existence after each E; with G, after each
    E until the next G.
    """
    closings = [number for number, item in enumerate(items) if is_event(made.closes, item, robots)]
    begins = [number for number, item in enumerate(items) if is_event(opens, item, robots)]
    if opens is None:
        begins = [-1]
    elif made.closes is None and made.pattern != "exists":
        begins = begins[:1]
    return [(begin, next((number for number in closings if number > begin), len(items))) for begin in begins]


def _of_span(
    made: Property, robots: dict[str, str], items: Sequence[Item], span: tuple[int, int], end: int, complete: bool
) -> Result:
    """What a pattern of events comes to between two events."""
    inside = range(span[0] + 1, span[1])
    main = [number for number in inside if is_event(made.main, items[number], robots)]
    other = [number for number in inside if is_event(made.other, items[number], robots)]
    key = lambda number: items[number].message["id"] if made.same else None  # noqa: E731
    if made.pattern == "never":
        return ("violated", None, items[main[0]].time) if main else ("holds", None, None)
    if made.pattern == "at most":
        if len(main) > made.count:
            return "violated", None, items[main[made.count]].time
        return "holds", made.count - len(main) if main else None, None
    if made.pattern == "only after":
        alone = [number for number in main if not any(one < number for one in other)]
        return ("violated", None, items[alone[0]].time) if alone else ("holds" if main else "not triggered", None, None)
    if made.pattern == "each time only after":
        for number in main:
            last = max((one for one in main if one < number and key(one) == key(number)), default=-1)
            if not any(last <= one < number and key(one) == key(number) for one in other):
                return "violated", None, items[number].time
        return "holds" if main else "not triggered", None, None
    begun = items[span[0]].time if span[0] >= 0 else 0
    limit = begun + made.bound if made.bound is not None else None
    if made.same:
        main = [number for number in main if key(number) == key(span[0])]
    answers = [items[number].time for number in main if limit is None or items[number].time <= limit]
    if answers:
        return "holds", (limit - answers[0]) / S if limit is not None else None, None
    closed = items[span[1]].time if span[1] < len(items) else None
    over = [time for time in (limit, closed) if time is not None and time <= end]
    if over:
        return "violated", None, min(over)
    return ("violated", None, end) if complete else ("pending", None, limit)


def _of_each(
    made: Property, opens: Occurrence, robots: dict[str, str], items: Sequence[Item], end: int, complete: bool
) -> Result:
    """What it comes to that each start has an end of its own, whichever of those that are open it may be.

    `choices`: for each choice so far which starts are open, and when the first of them was late.
    """
    bound, never = made.bound or 1 << 62, 1 << 63
    choices: set[tuple[tuple[int, ...], int]] = {((), never)}
    slacks, doubtful, failed, begun, judged = list[float](), False, False, 0, False
    for item in items:
        choices = {
            (opened, min([late, *(start + bound for start in opened if start + bound < item.time)]))
            for opened, late in choices
        }
        empty = not next(iter(choices))[0]
        if is_event(opens, item, robots):
            begun, judged = item.time if empty else begun, True
            choices = {((*opened, item.time), late) for opened, late in choices}
        elif is_event(made.main, item, robots) and not empty:
            assert item.event is not None
            doubtful = doubtful or (failed and item.event[2] == "cancel")
            failed = failed or item.event[2] == "fail"
            choices = {
                ((*opened[:number], *opened[number + 1 :]), late)
                for opened, late in choices
                for number in range(len(opened))
            }
            if not next(iter(choices))[0]:
                lates = [late for _, late in choices]
                if max(lates) < never:
                    break
                doubtful, choices = doubtful or min(lates) < never, {((), never)}
                slacks += [] if made.bound is None else [(begun + bound - item.time) / S]
    choices = {
        (opened, min([late, *(one + bound for one in opened if one + bound <= end)])) for opened, late in choices
    }
    certain, waiting = max(late for _, late in choices), next(iter(choices))[0]
    if certain < never:
        return "violated", None, certain
    if waiting and complete:
        return "violated", None, end
    slack = min(slacks, default=None)
    if doubtful:
        return "not known", slack, None
    if waiting:
        due = max(min(opened) for opened, _ in choices) + bound
        return "pending", slack, None if made.bound is None else due
    return "holds" if judged else "not triggered", slack, None


def _of_condition(
    made: Property, robots: dict[str, str], items: Sequence[Item], spans: Sequence[tuple[int, int]], end: int
) -> Result:
    """What a condition comes to at the end of each instant in each span."""
    slacks: list[float] = []
    known = lost = False
    for first, last in spans:
        begun = items[first].time if first >= 0 else 0
        closed = items[last].time if last < len(items) else end + 1
        times = sorted({time for time in (begun, *(item.time for item in items)) if begun <= time < closed})
        readings = [(time, _read(made, robots, items, time)) for time in times]
        for time, reading in readings:
            if reading is None:
                lost = lost or known
                continue
            known = True
            slacks += [reading[1]] if reading[1] is not None else []
            if not reading[0]:
                return "violated", min(slacks, default=None), time
        lost = lost or (bool(readings) and all(reading is None for _, reading in readings))
    least = min(slacks, default=None)
    if lost:
        return "not known", least, None
    return "holds" if known else "not triggered", least, None


def _read(made: Property, robots: dict[str, str], items: Sequence[Item], time: int) -> tuple[bool, float | None] | None:
    """Whether a condition holds at the end of an instant, and by how much."""
    last = {item.source: item.value for item in items if item.source is not None and item.time <= time}
    results = []
    for part in made.condition:
        left, right = (_value(value, robots, last) for value in (part.left, part.right))
        if left is None or right is None or left != left or right != right:  # NaN is what was not measured
            return None
        numbers = not any(isinstance(each, str) for each in (left, right))
        if part.operator in ("==", "!="):
            results.append(((left == right) == (part.operator == "=="), None))
        elif not numbers:
            return None
        else:
            slack = float(right - left if part.operator[0] == "<" else left - right)
            results.append((slack > 0 or (slack == 0 and part.operator[1:] == "="), slack))
    holds = all(one for one, _ in results)
    slack = min((one for _, one in results if one is not None), default=None)
    if made.pattern == "never":
        return not holds, None if slack is None else -slack
    return holds, slack


def _value(value: Value, robots: dict[str, str], last: dict[ValueSource, Any]) -> Any:
    if value.kind == "constant":
        return value.constant
    robot = robots.get(value.subject.text, value.subject.text)
    if value.kind == "distance":
        one, other = (last.get(ValueSource("pose", each)) for each in POOL)
        return abs(one.x - other.x) if one and other and one.frame == other.frame else None
    return last.get(ValueSource(value.kind, robot, "v" if value.kind == "variable" else ""))  # type: ignore[arg-type]


# ---- the comparison --------------------------------------------------------------------------------------------------


def judged(made: Property, items: Sequence[Item], end: int, complete: bool) -> Result:
    """What its monitor says."""
    judge = Judge([compile(made, VOCABULARY)])
    for item in items:
        if item.source is not None:
            judge.sample(item.time, item.source, item.value)
        elif item.event is not None:
            robot, element, what, detail = item.event
            if item.message is not None:
                judge.message(item.time, robot, f"/{'found' if element == 'throw' else 'done'}", item.message)
            judge.event(item.time, robot, element, what, detail)
    found = judge.finish(end, complete=complete)[0]
    return found.verdict, found.slack, None if found.time is None else round(found.time * S)


def differences(seed: int) -> Iterator[str]:
    """Where monitors and meaning differ on a random trace."""
    random = Random(seed)
    items, end, complete = trace(random)
    for sentence in sentences(random):
        made = parse(sentence)
        found, right = judged(made, items, end, complete), meaning(made, items, end, complete)
        if found != right:
            shown = "".join(f"\n    {item}" for item in items)
            yield f"seed {seed}: {sentence}: judged {found}, means {right}, end {end}, complete {complete}{shown}"


def main() -> int:
    """Compare, and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--traces", type=int, default=10_000)
    arguments = parser.parse_args()
    count = 0
    for seed in range(arguments.traces):
        for text in differences(seed):
            count += 1
            print(text)
    print(f"{arguments.traces} traces, {count} differences")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
