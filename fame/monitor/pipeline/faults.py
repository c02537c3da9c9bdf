"""Faults that are put into undisturbed runs, to measure what a detector sees.

A fault of each kind and size begins in the middle of a run, in a channel that changes from run to run. Sizes are in
deviations of the channel over all runs, or shares of the run. What belongs to several channels (a step of the task, two
wires) is put into all that move, on their common scale.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fame.monitor.arrays import Floats, Whole, moves
from fame.monitor.pipeline.processor import Samples


class Onset(NamedTuple):
    """Where a fault is put: the row where it begins, the channel, another one that moves (or the same, if none does),
    how large it is, and a source of chance."""

    onset: int
    channel: int
    other: int
    size: float
    random: np.random.Generator


Inject = Callable[[Floats, Onset], Any]
"""Changes scaled values (n, channels) in place, or returns others."""


class InjectedFault(NamedTuple):
    """A kind of fault: two `sizes`, in `unit`."""

    inject: Inject
    sizes: tuple[float, float]
    unit: str

    def text(self, size: float) -> str:
        return f"{100 * size:g} %{self.unit}" if self.unit.startswith(" ") else f"{size:g} {self.unit}"


def _rows(values: Floats, place: Onset) -> slice:
    """Return the rows of a fault that lasts a share of the run."""
    return slice(place.onset, place.onset + max(1, round(place.size * len(values))))


def _sign(place: Onset) -> float:
    return float(place.random.choice((-1, 1)))


def _spike(values: Floats, place: Onset) -> None:
    values[place.onset : place.onset + 3, place.channel] += place.size * _sign(place)


def _offset(values: Floats, place: Onset) -> None:
    values[place.onset :, place.channel] += place.size * _sign(place)


def _stuck(values: Floats, place: Onset) -> None:
    values[_rows(values, place), place.channel] = values[place.onset, place.channel]


def _swing(low: float, high: float) -> Inject:
    """Return a vibration between two shares of the rate of samples."""

    def inject(values: Floats, place: Onset) -> None:
        phase = 2 * np.pi * place.random.uniform(low, high) * np.arange(len(values) - place.onset)
        values[place.onset :, place.channel] += place.size * np.sin(phase)

    return inject


def _late(values: Floats, place: Onset) -> None:
    shift = min(max(1, round(place.size * len(values))), place.onset)
    values[place.onset :, place.channel] = values[place.onset - shift : len(values) - shift, place.channel].copy()


def _swapped(values: Floats, place: Onset) -> None:
    rows, pair = _rows(values, place), [place.channel, place.other]
    values[rows, pair] = values[rows, pair[::-1]]


def _decoupled(values: Floats, place: Onset) -> None:
    rows = _rows(values, place)
    values[rows, place.channel] = values[rows, place.channel][::-1].copy()


def _seam(values: Floats, place: Onset) -> tuple[int, int]:
    """Return where a step of the task begins and ends: the ends of a part of this length that are most alike."""
    length = max(1, round(place.size * len(values)))
    begins = np.arange(place.onset, max(place.onset + 1, len(values) - length - 1))
    apart = ((values[begins] - values[np.minimum(begins + length, len(values) - 1)]) ** 2).sum(axis=1)
    begin = int(begins[apart.argmin()])
    return begin, begin + length


def _missing(values: Floats, place: Onset) -> Floats:
    begin, end = _seam(values, place)
    return np.delete(values, slice(begin, end), axis=0)


def _extra(values: Floats, place: Onset) -> Floats:
    begin, end = _seam(values, place)
    return np.insert(values, begin, values[begin:end], axis=0)[: len(values)]


def _heavier(values: Floats, place: Onset) -> None:
    """A quarter of the run, in which a part is carried, has another level in two channels."""
    end = place.onset + len(values) // 4
    values[place.onset : end, [place.channel, place.other]] += place.size * _sign(place)


def _worn(values: Floats, place: Onset) -> None:
    values[place.onset :, place.channel] *= 1 + place.size


def _dropout(values: Floats, place: Onset) -> None:
    values[_rows(values, place), place.channel] = np.nan


FAULTS: Mapping[str, InjectedFault] = {
    "spike": InjectedFault(_spike, (2, 4), "deviations, 3 samples"),
    "offset": InjectedFault(_offset, (0.25, 0.5), "deviations"),
    "stuck": InjectedFault(_stuck, (0.05, 0.5), " of the run"),
    "vibration": InjectedFault(_swing(0.08, 0.2), (0.15, 0.3), "deviations"),
    "oscillation": InjectedFault(_swing(0.02, 0.06), (0.15, 0.3), "deviations"),
    "late": InjectedFault(_late, (0.01, 0.02), " of the run"),
    "swapped": InjectedFault(_swapped, (0.05, 0.5), " of the run"),
    "decoupled": InjectedFault(_decoupled, (0.05, 0.5), " of the run"),
    "missing step": InjectedFault(_missing, (0.03, 0.1), " of the run"),
    "extra step": InjectedFault(_extra, (0.03, 0.1), " of the run"),
    "wrong object": InjectedFault(_heavier, (0.25, 0.5), "deviations"),
    "wear": InjectedFault(_worn, (0.1, 0.4), " more movement"),
    "dropout": InjectedFault(_dropout, (0.01, 0.05), " of the run at 0"),
}
"""By name. A dropout reads 0 in the unit of the data."""
CASES = tuple((kind, size) for kind, fault in FAULTS.items() for size in fault.sizes)


RUNS, VALUES = 12, 30_000_000
"""Runs into which faults are put, at most; and values (samples x channels) in all of them, if there are two or more."""


class Tried:
    """What detectors say of runs with faults, each by one that has not learned the run; a channel has to move."""

    def __init__(self, runs: Sequence[Samples]) -> None:
        every = np.concatenate([run.channels() for run in runs])
        self._runs, self._mean, self._scale = runs, every.mean(axis=0), every.std(axis=0)
        self._moving = np.flatnonzero(moves(self._scale, self._mean))
        self._scale = np.where(self._scale > 0, self._scale, 1.0)
        most = int(min(RUNS, len(runs), max(2, VALUES * len(runs) / (len(CASES) * every.size))))
        self._chosen = set(np.linspace(0, len(runs) - 1, most).round().astype(int).tolist())
        self._losses: dict[tuple[tuple[str, float], int], Samples] = {}

    def put(self, number: int, losses: Callable[[Samples], Samples]) -> None:
        """Put every fault into a run, and keep what `losses` gives from the onset on, if it is one of the chosen.

        A fault that changes nothing, such as two swapped wires of one channel, does not count for this run.
        """
        run = self._runs[number]
        for case in CASES if number in self._chosen and len(run) else ():
            changed = faulty(run, number, case, self._moving, self._mean, self._scale)
            if changed is None:
                continue
            loss = losses(changed)
            since = loss.stamps - run.stamps[len(run) // 2]
            kept = Samples(loss.values[since >= 0].astype(np.float32), since[since >= 0])
            self._losses[case, number] = kept

    def found(self, thresholds: Sequence[float]) -> dict[str, Any]:
        """Return, as conditions of a model, for each kind and size (text) how many were found of how many, and the
        median time until then (s), None if none was."""
        counts, latencies = dict.fromkeys(CASES, 0), list[float]()
        for (case, _), loss in self._losses.items():
            above = (loss.values > np.asarray(thresholds)).any(axis=1)
            if above.any():
                counts[case] += 1
                latencies.append(float(loss.stamps[above.argmax()]))
        tried = Counter(case for case, _ in self._losses)
        told = [[case[0], FAULTS[case[0]].text(case[1]), count, tried[case]] for case, count in counts.items()]
        return {"found": told, "latency": float(np.median(latencies)) if latencies else None}


def faulty(
    run: Samples, number: int, case: tuple[str, float], moving: Whole, mean: Floats, scale: Floats
) -> Samples | None:
    """Put a fault into the middle of a run, in one of the channels that are `moving`; None if that changes nothing."""
    kind, size = case
    random = np.random.default_rng([number, list(FAULTS).index(kind)])
    before = (run.channels() - mean) / scale
    values = before.copy()
    channel, other = (int(moving[(number + n) % len(moving)]) for n in (0, 1))
    changed = FAULTS[kind].inject(values, Onset(len(values) // 2, channel, other, size, random))
    values = values if changed is None else changed
    if np.array_equal(values, before, equal_nan=True):
        return None
    return run.replace(np.nan_to_num(values * scale + mean, nan=0.0), run.stamps[: len(values)])
