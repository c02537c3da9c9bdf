"""Topics with rates of their own, joined by time: rows at a rate, with a value of each channel or none.

At each time of the grid a channel has, by `fill`, the value before it (``hold``), that between its neighbours
(``linear``), or the nearest one (``none``); if that lies farther away than the tolerance, it has none: the row has no
partner. So a sensor that stops is missing, not filled for ever. Rows without all channels are left out by whoever reads
them, and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fame.config.values import ConfigValue
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.processor import Samples

FILLS = ("hold", "linear", "none")
KEYS = {
    "Rate": "of the rows, Hz",
    "Tolerance": "how far away (s) a value may be (1.5 / Rate)",
    "Fill": "`hold` takes the value before (default), `linear` lies between two, `none` takes the nearest one",
}


class Join(NamedTuple):
    """How to join: Hz, s, and one of `FILLS`."""

    rate: float
    tolerance: float
    fill: str = FILLS[0]


def join_of(value: ConfigValue) -> Join:
    """Read the keys `KEYS`. Raises ConfigError."""
    parts = value.mapping(KEYS)
    rate = value.required("Rate", "50").number(above=0, maximum=1e6)
    tolerance = parts["Tolerance"].number(above=0) if "Tolerance" in parts else 1.5 / rate
    fill = parts["Fill"].choice(FILLS, "a fill") if "Fill" in parts else FILLS[0]
    return Join(rate, tolerance, fill)


def grid(first: float, last: float, rate: float) -> Floats:
    """Return the times of rows from `first` to `last` (s), at whole numbers of periods."""
    return np.arange(np.ceil(first * rate - 1e-6), np.floor(last * rate + 1e-6) + 1) / rate


def values_at(times: Floats, stamps: Floats, values: Floats, join: Join) -> Floats:
    """Return the values (times, channels) at some times of samples (n, channels) with growing stamps; NaN where none is
    near."""
    if not len(stamps):
        return np.full((len(times), values.shape[1]), np.nan)
    after = np.minimum(np.searchsorted(stamps, times + 1e-9, side="right"), len(stamps) - 1)
    before = np.where(stamps[after] <= times + 1e-9, after, np.maximum(after - 1, 0))
    since, until = times - stamps[before], stamps[after] - times
    limit = join.tolerance + 1e-9
    if join.fill == "linear":
        span = stamps[after] - stamps[before]
        share = np.where(span > 0, since / np.where(span > 0, span, 1.0), 0.0)[:, None]
        found = values[before] * (1 - share) + values[after] * share
        near = (np.abs(since) <= 1e-9) | ((since > 0) & (since <= limit) & (until >= 0) & (until <= limit))
    elif join.fill == "none":
        nearest = np.where(np.abs(until) < np.abs(since), after, before)
        found, near = values[nearest], np.abs(stamps[nearest] - times) <= limit
    else:
        found, near = values[before], (since >= -1e-9) & (since <= limit)
    return np.where(near[:, None], found, np.nan)


def joined_table(stamps: Floats, cells: Floats, join: Join) -> tuple[Floats, Floats]:
    """Return the rows, stamps and cells (rows, channels), of a run whose cells are NaN where a channel has no value."""
    known = np.isfinite(stamps)
    times = grid(float(stamps[known].min()), float(stamps[known].max()), join.rate) if known.any() else np.zeros(0)
    columns = []
    for column in cells.T:
        own = known & np.isfinite(column)
        columns.append(values_at(times, stamps[own], column[own, None], join)[:, 0])
    return times, np.stack(columns, axis=1)


class Joiner:
    """Joins what arrives live. A row is given when each input has a sample after it, or when it is older than the
    tolerance; `report` is told of rows without a partner, which are left out, and `missing` counts them."""

    def __init__(self, join: Join, report: Callable[[str, str], object]) -> None:
        self.missing: int = 0
        self._join, self._report = join, report
        self._kept: dict[str, Samples] = {}
        self._next: float | None = None

    def feed(self, inputs: Mapping[str, Samples]) -> dict[str, Samples]:
        """Take samples by name of the input, and return the rows that are due, with the same stamps for all inputs."""
        for name, new in inputs.items():
            old = self._kept.get(name)
            if len(new):
                both = old is not None and len(old) and old.channels().shape[1] == new.channels().shape[1]
                self._kept[name] = new if not both or old is None else _appended(old, new)
        kept = [self._kept.get(name) for name in inputs]
        last = [float(each.stamps[-1]) for each in kept if each is not None]
        if not last:
            return dict(inputs)
        if self._next is None:
            self._next = min(float(each.stamps[0]) for each in kept if each is not None)
        ready = min(last) if len(last) == len(inputs) else -np.inf
        times = grid(self._next, max(ready, max(last) - self._join.tolerance), self._join.rate)
        if not len(times):
            return {name: samples.replace(samples.values[:0], samples.stamps[:0]) for name, samples in inputs.items()}
        self._next = float(times[-1]) + 0.5 / self._join.rate
        found = {name: self._at(times, self._kept.get(name)) for name in inputs}
        whole = np.all([np.isfinite(rows).all(axis=1) for rows in found.values()], axis=0)
        if not whole.all():
            self.missing += int((~whole).sum())
            silent = [name for name, rows in found.items() if not np.isfinite(rows[-1]).all()]
            text = f"{self.missing} rows have no partner in time ({', '.join(silent) or 'some'}): not judged"
            self._report(f"join {silent}", text)
        self._forget(float(times[-1]))
        return {
            name: Samples(rows[whole], times[whole], self._kept[name].names if name in self._kept else ())
            for name, rows in found.items()
        }

    def _at(self, times: Floats, samples: Samples | None) -> Floats:
        if samples is None:
            return np.full((len(times), 1), np.nan)
        return values_at(times, samples.stamps, samples.channels(), self._join)

    def _forget(self, last: float) -> None:
        """Keep only what rows after `last` (s) may need, and one sample at least."""
        for name, samples in self._kept.items():
            first = max(0, int(np.searchsorted(samples.stamps, last - 2 * self._join.tolerance)) - 1)
            first = min(first, len(samples) - 1)
            self._kept[name] = samples.replace(samples.values[first:], samples.stamps[first:])


def _appended(old: Samples, new: Samples) -> Samples:
    values = np.concatenate((old.channels(), new.channels()))
    return Samples(values, np.concatenate((old.stamps, new.stamps)), new.names)
