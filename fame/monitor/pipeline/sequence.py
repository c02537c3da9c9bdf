"""The order of the elements of a mission: what a run left out, repeated, or did in another order or for another time.

Learned from the training runs: which element follows which, how often each occurs in a run, with which one runs begin
and end, and how long a visit lasts. A run is judged by its changes alone, so it needs no detector: `element` columns of
any table tell them, and so does a mission live.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from fame.monitor.pipeline.processor import Samples

FEWEST = 4
"""Runs below which no order is learned."""
LONGER = 3.0
"""A visit is too long, or too short, if it lies beyond the training's by this many times their range, at least by the
share `LEAST` of the longest."""
LEAST = 0.5

Visits = list[tuple[str, float, float]]
"""Element, begin (s), and how long it lasted (s)."""


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
    if not usual or not run.elements:
        return []
    seen = visits(run)
    count, pairs = Counter(name for name, *_ in seen), {(a, b) for a, b in usual["pairs"]}
    found = [f"{name} was left out" for name, (least, _) in usual["often"].items() if not count[name] and least]
    for name, number in count.items():
        least, most = usual["often"].get(name, [0, 0])
        if not most:
            found.append(f"{name} is new: no training run had it")
        elif number > most or number < least:
            found.append(f"{name} came {number} times; in training {least if least == most else f'{least} to {most}'}")
    wrong = [] if found else list(_wrong_order(seen, pairs))
    return [*found, *wrong, *_wrong_times(seen, usual["lasts"])]


def _wrong_order(seen: Visits, pairs: set[tuple[str, str]]) -> Iterator[str]:
    names = ["", *(name for name, *_ in seen), ""]
    for before, after in pairwise(names):
        if (before, after) not in pairs:
            if not before:
                yield f"the run began with {after}"
            elif not after:
                yield f"the run ended with {before}"
            else:
                yield f"{after} came after {before}"


def _wrong_times(seen: Visits, lasts: dict[str, list[float]]) -> Iterator[str]:
    """Say which visits lasted too long or too short; not the first and the last, which a recording may cut."""
    for name, _, long in seen[1:-1]:
        if name in lasts:
            least, most = lasts[name]
            slack = max(LONGER * (most - least), LEAST * most)
            if not least - slack <= long <= most + slack:
                yield f"{name} lasted {long:.3g} s; in training {least:.3g} to {most:.3g} s"


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
