"""The order of the elements of a mission: what a run left out, repeated, or did in another order or for another time.

Learned from the training runs: which element follows which, how often each occurs in a run, with which one runs begin
and end, and how long a visit lasts. A run is judged by its changes alone, so it needs no detector: `element` columns of
any table tell them, and so does a mission live, where a fault is told when it is certain (`OrderWatch`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from fame.monitor.pipeline.processor import ActiveElements, Samples

FEWEST = 4
"""Runs below which no order is learned."""
_SLACK_OF_RANGE, _SLACK_OF_LONGEST = 3.0, 0.5
"""A visit is too long or too short if it lies beyond the training's by more than this many of their range, and by more
than this share of their longest."""

Visits = list[tuple[str, float, float]]
"""Element, begin (s), and how long it lasted (s)."""


class OrderFault(NamedTuple):
    """What is wrong with a run. What it is about stays the same while the run goes on; the text may not.

    kind     new, left out, times, order or time
    visit    the visit of the run, from 1; 0: none in particular
    """

    kind: str
    element: str
    visit: int
    text: str

    @property
    def about(self) -> tuple[str, str, int]:
        return self.kind, self.element, self.visit


def visits(run: Samples) -> Visits:
    """Return the visits of elements that samples of a run see: a part of a recording has the changes of all of it."""
    if not len(run):
        return []
    first, last = float(run.stamps[0]), float(run.stamps[-1])
    ends = [*(begin for begin, _ in run.elements[1:]), last]
    seen = zip(run.elements, ends, strict=True)
    return [(name, begin, end - begin) for (begin, name), end in seen if name and begin <= last and end > first]


def learned(runs: Sequence[Samples]) -> dict[str, Any]:
    """Return what is usual in runs, as plain data; nothing if one has no elements."""
    if not all(run.elements for run in runs):
        return {}
    every = [visits(run) for run in runs]
    counts = [Counter(name for name, *_ in each) for each in every]
    names = list(dict.fromkeys(name for each in every for name, *_ in each))
    pairs = {(a[0], b[0]) for each in every for a, b in zip([("", 0, 0), *each], [*each, ("", 0, 0)], strict=True)}
    lasted = {name: [long for each in every for n, _, long in each if n == name] for name in names}
    return {
        "often": {name: [min(count[name] for count in counts), max(count[name] for count in counts)] for name in names},
        "pairs": sorted(map(list, pairs)),
        "lasts": {name: [min(times), max(times)] for name, times in lasted.items()},
    }


def judged(run: Samples, usual: dict[str, Any]) -> list[str]:
    """Return what is wrong with the order of a run's elements, in sentences; nothing without elements or an order."""
    return [fault.text for fault in faults(visits(run), usual)] if usual and run.elements else []


def faults(seen: Visits, usual: dict[str, Any], *, ended: bool = True) -> list[OrderFault]:
    """Return what is wrong with the visits of a run; before it has `ended`, what is certain already."""
    count, pairs = Counter(name for name, *_ in seen), {(a, b) for a, b in usual["pairs"]}
    coming = set() if ended else _later(seen[-1][0] if seen else "", pairs)
    found = [
        OrderFault("left out", name, 0, f"{name} was left out")
        for name, (least, _) in usual["often"].items()
        if least and not count[name] and name not in coming
    ]
    for name, number in count.items():
        least, most = usual["often"].get(name, [0, 0])
        if not most:
            found.append(OrderFault("new", name, 0, f"{name} is new: no training run had it"))
        elif number > most or (number < least and name not in coming):
            in_training = least if least == most else f"{least} to {most}"
            found.append(OrderFault("times", name, 0, f"{name} came {number} times; in training {in_training}"))
    wrong = [] if found else list(_wrong_order(seen, pairs, ended))
    return [*found, *wrong, *_wrong_times(seen, usual["lasts"], ended)]


def _later(name: str, pairs: set[tuple[str, str]]) -> set[str]:
    """Return the elements that can still come after one; all after one that no training run had."""
    found = {b for a, b in pairs if a == name} or {b for _, b in pairs}
    while more := {b for a, b in pairs if a in found and a} - found:
        found |= more
    return found


def _wrong_order(seen: Visits, pairs: set[tuple[str, str]], ended: bool) -> Iterator[OrderFault]:
    names = ["", *(name for name, *_ in seen), *([""] if ended else [])]
    for number, (before, after) in enumerate(pairwise(names), start=1):
        if (before, after) in pairs:
            continue
        text = f"{after} came after {before}"
        if not before:
            text = f"the run began with {after}" if after else "the run had no element"
        elif not after:
            text = f"the run ended with {before}"
        yield OrderFault("order", after, number, text)


def _wrong_times(seen: Visits, lasts: dict[str, list[float]], ended: bool) -> Iterator[OrderFault]:
    """Yield which visits lasted too long or too short; not the first and the last, which a recording may cut. The last
    one of a run that has not ended may be too long already."""
    for number, (name, _, long) in enumerate(seen[1 : -1 if ended else None], start=2):
        if name in lasts:
            least, most = lasts[name]
            slack = max(_SLACK_OF_RANGE * (most - least), _SLACK_OF_LONGEST * most)
            lasting = number == len(seen)
            if long > most + slack or (long < least - slack and not lasting):
                text = f"{name} lasted {long:.3g} s; in training {least:.3g} to {most:.3g} s"
                yield OrderFault("time", name, number, text)


class OrderWatch:
    """Judges the order of elements while they change, each run by itself: a fault is told once, when it is certain. How
    often an element comes is one fault of a run; each visit in a wrong order, or of a wrong time, is one.

    A run ends when no element is active; without such a pause, when one that runs begin with comes again, or after one
    that runs end with. A run whose begin was not seen is judged only if it begins as the training runs do.
    """

    def __init__(self, usual: dict[str, Any]) -> None:
        self._usual = usual
        self._pairs = {(a, b) for a, b in usual["pairs"]}
        self._taken: tuple[float, str] | None = None  # the last change
        self._seen: Visits = []
        self._told = set[tuple[str, str, int]]()
        self._whole = True  # all of this run was seen

    def feed(self, changes: ActiveElements, now: float, lost: float) -> list[tuple[float, str]]:
        """Take the changes of the active element, until `now` (s), which were not known up to `lost` (s). Return new
        faults with their stamps (s)."""
        begin = changes.index(self._taken) + 1 if self._taken in changes else 0
        found: list[tuple[float, str]] = []
        for stamp, name in changes[begin:]:
            found += self._take(stamp, name, stamp <= lost)
        self._taken = changes[-1] if changes else None
        if self._seen:
            self._last(max(now, self._seen[-1][1]))
            found += self._new(now, ended=False)
        return found

    def _take(self, stamp: float, name: str, lost: bool) -> list[tuple[float, str]]:
        found: list[tuple[float, str]] = []
        if self._seen:
            self._last(stamp)
            if lost or not name or self._begins(name):
                found = [] if lost else self._new(stamp, ended=True)
                self._seen, self._told = [], set()
        if name:
            if not self._seen:
                self._whole = not lost or ("", name) in self._pairs
            self._seen.append((name, stamp, 0.0))
            found += self._new(stamp, ended=False)
        return found

    def _begins(self, name: str) -> bool:
        """Return whether a new run begins with this element."""
        last, most = self._seen[-1][0], self._usual["often"].get(name, [0, 0])[1]
        again = sum(each == name for each, *_ in self._seen) >= most
        after_end = (last, "") in self._pairs and (last, name) not in self._pairs
        return ("", name) in self._pairs and (again or after_end)

    def _last(self, stamp: float) -> None:
        name, begin, _ = self._seen[-1]
        self._seen[-1] = name, begin, stamp - begin

    def _new(self, stamp: float, *, ended: bool) -> list[tuple[float, str]]:
        found = faults(self._seen, self._usual, ended=ended) if self._whole else []
        new = [(stamp, fault.text) for fault in found if fault.about not in self._told]
        self._told.update(fault.about for fault in found)
        return new


def order_of(runs: Sequence[Samples], asked: float) -> dict[str, Any]:
    """Return as conditions of a model the `order` that is usual, and what is told of it (`order_text`). Where more runs
    differ from the others than false alarms were asked for, nothing is usual."""
    usual = learned(runs) if len(runs) >= FEWEST else {}
    if not usual:
        return {}
    # the others are FEWEST - 1 at least: were FEWEST asked of them, too, no run of FEWEST could ever differ
    others = (learned([*runs[:number], *runs[number + 1 :]]) for number in range(len(runs)))
    differ = sum(bool(judged(run, each)) for run, each in zip(runs, others, strict=True))
    # a new run is as likely to differ as any of these: (differ + 1) of (runs + 1), which few runs never bring to a rate
    # as low as asked for; if none differs, nothing speaks against the order
    keeps = differ <= asked * (len(runs) + 1) - 1 or not differ
    text = f"{differ} of {len(runs)} runs differ from the order of the others: it is {'' if keeps else 'not '}judged"
    return {"order": usual if keeps else {}, "order_text": text}
