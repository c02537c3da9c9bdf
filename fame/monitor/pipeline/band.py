"""The band of the training runs: what each channel did, over the time since the start; and what deviates from it.

It decides nothing: it tells a reader what to expect where a detector raises an alarm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fame.dataclasses import dataclass
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.elements import active
from fame.monitor.pipeline.processor import Samples

_TIMES = 200
"""Times at which a band is kept, at most."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """A channel in an alarm: its `share` of what exceeded, its value that lies farthest from the band, with the time
    (s from the start of the run), the band there, NaN without one, and the active element of the mission."""

    channel: str
    share: float
    time: float
    value: float
    low: float
    high: float
    element: str = ""

    @property
    def text(self) -> str:
        """The explanation in a sentence."""
        where = f" in {self.element}" if self.element else ""
        if np.isnan(self.low):
            return f"{self.channel}{where}: the training has no values for this time"
        band = f"{self.low:.4g} to {self.high:.4g}"
        if self.low <= self.value <= self.high:
            return f"{self.channel}{where}: unusual course within the values of the training ({band})"
        return f"{self.channel}{where}: {self.value:.4g} at {self.time:.3g} s; in training {band}"


@dataclass(frozen=True, slots=True)
class Band:
    """The smallest, median and largest values (times, channels) of the training runs around `times` (s on
    the axis of phases); of runs that do not repeat, those of all samples, with one time."""

    times: Floats
    low: Floats
    middle: Floats
    high: Floats

    def at(self, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Return low, middle and high (n, channels) at times (n,); NaN behind the end of the training runs."""
        place = np.searchsorted((self.times[1:] + self.times[:-1]) / 2, times)
        step = np.inf if len(self.times) == 1 else self.times[-1] - self.times[-2]
        known = (times <= self.times[-1] + step)[:, None]
        low, middle, high = (np.where(known, part[place], np.nan) for part in (self.low, self.middle, self.high))
        return low, middle, high

    def explain(
        self, run: Samples, times: Floats, channels: Sequence[int], shares: Sequence[float]
    ) -> tuple[Explanation, ...]:
        """Explain an alarm by a part of a run, whose stamps are s since its start and have `times` on the axis of
        phases: one explanation per channel."""
        low, _, high = self.at(times)
        names, _ = active(run.stamps, run.elements)
        found = []
        for channel, share in zip(channels, shares, strict=True):
            values, least, most = run.values[:, channel], low[:, channel], high[:, channel]
            outside = np.nan_to_num(np.maximum(least - values, values - most), nan=-np.inf)
            row = int(outside.argmax())
            time, value, bottom, top = (float(part[row]) for part in (run.stamps, values, least, most))
            found.append(Explanation(run.names[channel], share, time, value, bottom, top, str(names[row])))
        return tuple(found)

    @classmethod
    def of(cls, runs: Sequence[Samples], times: Sequence[Floats] | None) -> Band:
        """Return the band of runs with values (n, channels), each with `times` of its samples (n,), NaN in no known
        phase; None if runs do not repeat."""
        values = np.concatenate([run.channels() for run in runs])
        since = np.zeros(len(values)) if times is None else np.concatenate(list(times))
        known = np.isfinite(since)
        values, since = values[known], since[known]
        period = float(np.median(np.diff(np.concatenate([run.stamps for run in runs]))))
        step = max(float(since.max(initial=0)) / _TIMES, period)
        rows = np.round(since / step).astype(np.int64)
        order = np.argsort(rows, kind="stable")
        kinds, first = np.unique(rows[order], return_index=True)
        parts = np.split(values[order], first[1:])
        low, middle, high = (np.array([of(part, axis=0) for part in parts]) for of in (np.min, np.median, np.max))
        return cls(np.asarray(kinds * step, dtype=np.float64), low, middle, high)
