"""Compare monitors of properties with their meaning. ``python -m tests.compare_properties --traces 10000``

The meaning is that of `property_oracle`, on the whole trace. Each random trace is judged by a property of each pattern
and scope, with and without bounds, pools, fields and what was not measured.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from random import Random
from typing import Any, NamedTuple

from property_oracle import Event, Run, Sentence, judge

from fame.properties import Judge, Property, Vocabulary, compile, parse
from fame.properties.conditions import RobotPosition, ValueSource
from fame.properties.vocabulary import RobotTerms

S = 1_000_000_000
Result = tuple[str, float | None, int | None]
POOL = ("T_1", "T_2")


def terms(robot: str) -> RobotTerms:
    elements = {"x": "X", "y": "Y", "throw": "found", "reply": "done"}
    throws = {"/found": ("throw",), "/done": ("reply",)}
    return RobotTerms(f"P_{robot[0]}", elements, {}, throws, {"/found": ("y",)}, variables=("v", "w"))


VOCABULARY = Vocabulary({robot: terms(robot) for robot in ("A", "B", *POOL)}, {"T": POOL})

EVENTS = (
    Event("A", "starts", "x"), Event("A", "completes", "x"), Event("B", "starts", "y"), Event("T", "starts", "x"),
    Event("T", "starts", "x", some=True), Event("A", "throws", "/found"), Event("B", "throws", "/done"),
    Event("A", "throws", "/found", where=(("id", ">", 1),)), Event("T", "throws", "/done"),
    Event("B", "throws", "/done", where=(("id", "!=", 2), ("id", "<=", 2))), Event("A", "fails", "x"),
    Event("A", "fails", "x", "c"), Event("B", "is cancelled", "y"), Event("A", "ends", "x"), Event("A", "starts"),
    Event("B", "completes"), Event("B", "catches", "/found"), Event("A", "reports", detail="low"),
)  # fmt: skip
CONDITIONS: tuple[tuple[tuple[str, str, Any], ...], ...] = (
    (("A.v", ">", 1),), (("A.v", "!=", "B.v"), ("B.v", "<", 3)), (("T.v", "<=", "A.v"),), (("A.battery", ">=", 0.5),),
    (("distance(T_1, T_2).", ">", 1),), (("A.v", "==", "text"),),
)  # fmt: skip


def sentences(random: Random) -> Iterator[Sentence]:
    """A sentence of each pattern in each scope, with random events: few, so that they come together."""
    few = random.sample(EVENTS, 6)
    event = lambda: random.choice(few)  # noqa: E731
    bound = lambda: random.choice((None, 1, 2, 3))  # noqa: E731
    form = lambda: random.choice(("between", "until", "last"))  # noqa: E731
    patterns = [Sentence(pattern, condition=random.choice(CONDITIONS)) for pattern in ("always", "never")]
    patterns += [Sentence(pattern, event(), event()) for pattern in ("none", "only", "each", "before")]
    patterns += [Sentence("most", event(), times=random.choice((0, 1, 2)))]
    patterns += [Sentence("exists", event(), bound=bound()) for _ in range(2)]
    found, done = Event("A", "throws", "/found"), Event("T", "throws", "/done", some=True)
    for one in patterns:
        yield one
        yield replace(one, opens=event())
        yield replace(one, opens=event(), closes=event(), form=form())
        if one.pattern != "before":
            yield replace(one, closes=event())
    for closes in (None, found, event()):
        yield Sentence("exists", done, opens=found, closes=closes, bound=bound(), same="id", form=form())
        yield Sentence("each", replace(done, some=False), found, closes=closes, same="id")
        for robot in ("A", "T"):
            ends = Event(robot, "ends", "x")
            yield Sentence("exists", ends, opens=Event(robot, "starts", "x"), closes=closes, bound=bound(), form=form())


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
    kinds = range(random.choice((0, 4)), 8)  # with values, or events alone
    for _ in range(random.randrange(50)):
        time += random.choice((0, 0, S // 2, S, 3 * S))
        items.append(_item(random, time, random.choice(kinds)))
    return items, time + random.choice((0, S, 4 * S)), random.random() < 0.5


def _item(random: Random, time: int, kind: int) -> Item:
    robot = random.choice(("A", "A", "B", *POOL))
    if kind < 2:
        value = random.choice((0, 1, 2, 3, 3, 2, "text", math.nan))
        return Item(time, source=ValueSource("variable", robot, "v"), value=value)
    if kind == 2:
        pose = RobotPosition(random.choice((0, 1, 3)), 0.0, frame=random.choice(("world", "world", "world", "map")))
        return Item(time, source=ValueSource("pose", robot), value=pose)
    if kind == 3:
        return Item(time, source=ValueSource("battery", robot), value=random.choice((0.2, 0.5, 0.9, math.nan)))
    if kind == 4:
        message = {"id": random.choice((1, 1, 2, 2, 3, 3, math.nan if random.random() < 0.3 else 3))}
        return Item(time, (robot, random.choice(("throw", "reply")), "leave", None), message)
    if kind == 5:
        event = random.choice((("start", None), ("end", "completed"), ("end", "failed")))
        return Item(time, (robot, f"P_{robot[0]}", *event))
    if kind == 6:
        return Item(time, (robot, "", "log", random.choice(("battery low", "fine"))))
    what = random.choice((("enter", None), ("leave", None), ("fail", "c"), ("fail", "d"), ("cancel", None)))
    return Item(time, (robot, random.choice(("x", "y")), *what))


# ---- the comparison --------------------------------------------------------------------------------------------------


def happened(item: Item) -> Event | None:
    """What an item of a trace is in the words of sentences."""
    if item.event is None:
        return None
    robot, element, what, detail = item.event
    if what == "log":
        return Event(robot, "reports", detail=detail)
    if element.startswith("P_"):
        return Event(robot, "starts" if what == "start" else {"completed": "completes", "failed": "fails"}[detail])
    if what == "leave" and element in ("throw", "reply"):
        fields = tuple((item.message or {}).items())
        return Event(robot, "throws", "/found" if element == "throw" else "/done", fields=fields)
    words = {"enter": "starts", "leave": "completes", "fail": "fails", "cancel": "is cancelled"}
    return Event(robot, words[what], element, detail or "")


def run_of(items: Sequence[Item], end: int, complete: bool) -> Run:
    """A trace as the oracle reads it: with the values at the end of each instant."""
    found: list[tuple[float, Event | dict[str, Any]]] = []
    values, poses = dict[str, Any](), dict[str, RobotPosition]()
    for time in sorted({0, *(item.time for item in items)}):
        for item in (item for item in items if item.time == time):
            event = happened(item)
            found += [(time / S, event)] if event else []
            if event and event.action == "completes" and event.target == "y":  # it is where /found is caught, too
                found.append((time / S, Event(event.robot, "catches", "/found")))
            source = item.source
            if source is not None and source.kind == "pose":
                poses[source.subject] = item.value
            elif source is not None:
                values[f"{source.subject}.{source.name or source.kind}"] = item.value
        if {*POOL} <= poses.keys():
            one, other = (poses[robot] for robot in POOL)
            values["distance(T_1, T_2)."] = abs(one.x - other.x) if one.frame == other.frame else math.nan
        found.append((time / S, dict(values)))
    return Run(found, end / S, complete, {"T": POOL})


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
    """Where monitors and meaning differ on a random trace.

    A monitor keeps no list of what may have been: where something is unknown, it may say so although that makes no
    difference.
    """
    random = Random(seed)
    items, end, complete = trace(random)
    run = run_of(items, end, complete)
    for sentence in sentences(random):
        text = str(sentence).replace("distance(T_1, T_2).", "distance(any two T)")
        verdict, slack, time = judged(parse(text), items, end, complete)
        right = judge(sentence, run)
        doubt = unsure(items, sentence)
        if right is None or (verdict == "not known" and doubt):
            continue
        found = verdict, None if verdict not in ("violated", "pending") or time is None else time / S
        means = right.verdict, right.time
        slacks = (slack, right.slack) if verdict == "holds" and not sentence.of_tokens else (None, None)
        if found[: 2 - doubt] != means[: 2 - doubt] or slacks[0] != slacks[1]:
            shown = "".join(f"\n    {item}" for item in items)
            yield f"seed {seed}: {text}: judged {found} {slack}, means {right}, end {end}, complete {complete}{shown}"


def unsure(items: Sequence[Item], sentence: Sentence) -> bool:
    """Whether something in a trace is not known that a sentence may read."""
    if sentence.of_tokens:
        return any(item.event is not None and item.event[2] in ("fail", "cancel") for item in items)
    if sentence.condition:
        return any(item.source is not None for item in items)
    return any(item.message is not None and math.isnan(item.message["id"]) for item in items)


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
