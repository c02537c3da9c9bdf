"""Filters and windows of samples, all channels at once.

`LowPass`, `Resample` and `Scale` turn samples into samples. The others compute something of each window: itself, RMS,
moving statistics, its spectrum. A window is `size` consecutive samples; the next begins `stride` samples later. The
result of a window carries the stamp of its last sample. A window that spans a gap, or samples of another rate than
given, is left out and reported.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.processor import Parameter, Processor, Result, Samples, per_channel

_BLOCK = 64  # samples that are filtered at a time
_LONG = 100.0  # periods of the cutoff, after which nothing is left; sums of more would cost digits, or overflow


class _PerInput(Processor):
    """Computes something of the samples of each input, by what it keeps of that input."""

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._kept: dict[str, Any] = {}

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        results = {name: self.apply(name, samples) for name, samples in inputs.items() if len(samples)}
        return {name: result for name, result in results.items() if len(result)}

    @abstractmethod
    def apply(self, name: str, samples: Samples) -> Samples:
        """Return the result of samples of an input; there is one at least."""


class LowPass(_PerInput):
    """One pole: y += a (x - y), a = 1 - exp(-2 pi fc / fs). It starts at the first sample.

    With `rate` 0, fs is taken from the stamps, sample by sample, which is right at any rate and across gaps.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("cutoff", "float", 10.0, (1e-6, None), "Hz", "fc, where the amplitude is down by 3 dB"),
        Parameter("rate", "float", 0.0, (0, None), "Hz", "fs; 0: from the stamps"),
    )
    cutoff: float
    rate: float

    def apply(self, name: str, samples: Samples) -> Samples:
        values, stamps = np.asarray(samples.values, dtype=np.float64), samples.stamps
        y, before = self._kept.get(name, (values[0], float(stamps[0])))
        if y.shape != values.shape[1:]:
            y, before = values[0], float(stamps[0])
        steps = np.full(len(stamps), 1 / self.rate) if self.rate else stamps - np.concatenate(([before], stamps[:-1]))
        steps = np.minimum(steps, _LONG / self.cutoff)
        out = np.empty_like(values)
        for first in range(0, len(stamps), _BLOCK):
            block = slice(first, first + _BLOCK)
            out[block] = _one_pole(y, values[block], -2 * np.pi * (self.cutoff * steps[block]))
            y = out[block][-1]
        self._kept[name] = (y, float(stamps[-1]))
        return samples.replace(values=out)


def _one_pole(y: Floats, values: Floats, exponents: Floats) -> Floats:
    """y_k = d_k y_(k-1) + (1 - d_k) x_k with d = exp(exponents), for all k as one product of matrices."""
    total = np.cumsum(exponents)
    decays = np.tril(np.exp(np.minimum(total[:, None] - total, 0)))  # from sample j to sample k
    flat = values.reshape(len(values), -1)
    out = (decays * -np.expm1(exponents)) @ flat + np.exp(total)[:, None] * y.reshape(1, -1)
    return np.asarray(out.reshape(values.shape))


class Resample(_PerInput):
    """Samples at a fixed rate, on multiples of 1 / rate, by linear interpolation; nothing across a gap."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rate", "float", 50.0, (1e-6, None), "Hz", "of what comes out"),
        Parameter("gap", "float", 0.1, (0, None), "s", "between two samples, above which nothing is interpolated"),
    )
    rate: float
    gap: float

    def apply(self, name: str, samples: Samples) -> Samples:
        values, stamps = np.asarray(samples.values, dtype=np.float64), samples.stamps
        begin = float(stamps[0]) - 0.5 / self.rate  # the first sample may stand on the grid itself
        last: Samples | None = self._kept.get(name)
        if last is not None and last.values.shape[1:] == values.shape[1:]:
            begin = float(last.stamps[0])
            values, stamps = np.concatenate((last.values, values)), np.concatenate((last.stamps, stamps))
        self._kept[name] = Samples(values[-1:], stamps[-1:])
        grid = self._grid(begin, stamps)
        right = np.clip(np.searchsorted(stamps, grid), 1, max(1, len(stamps) - 1))
        if len(stamps) == 1:
            return samples.replace(values=values[: len(grid)], stamps=grid)
        span = stamps[right] - stamps[right - 1]
        part = (grid - stamps[right - 1]) / span
        weight = part.reshape(-1, *[1] * (values.ndim - 1))
        out = values[right - 1] * (1 - weight) + values[right] * weight
        near = (span <= self.gap) | (part == 0) | (part == 1)
        return samples.replace(values=out[near], stamps=grid[near])

    def _grid(self, begin: float, stamps: Floats) -> Floats:
        """Return the multiples of 1 / rate after `begin`, among the stamps, but not deep in a gap: it may be years."""
        lows, highs = self._last_of(np.concatenate(([begin], stamps[:-1]))) + 1, self._last_of(stamps)
        wide = stamps - np.concatenate((stamps[:1], stamps[:-1])) > self.gap
        lows = np.where(wide, np.maximum(lows, highs), lows)  # the sample behind a gap may stand on the grid itself
        counts = np.maximum(highs - lows + 1, 0).astype(np.int64)
        ends = np.cumsum(counts)
        grid = (np.repeat(lows - (ends - counts), counts) + np.arange(counts.sum())) / self.rate
        return np.asarray(grid[grid >= stamps[0]])

    def _last_of(self, stamps: Floats) -> Floats:
        """Return the number of the last multiple of 1 / rate that is not after each stamp."""
        last = np.floor(stamps * self.rate)
        last += (last + 1) / self.rate <= stamps  # the product may have been rounded either way
        return np.asarray(last - (last / self.rate > stamps))


class Scale(_PerInput):
    """(x - offset) * factor, each one number for all channels or one per channel."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset", "floats", (0.0,), description="what is taken off"),
        Parameter("factor", "floats", (1.0,), description="what the rest is multiplied by"),
    )
    offset: tuple[float, ...]
    factor: tuple[float, ...]

    def apply(self, name: str, samples: Samples) -> Samples:
        shape = samples.values.shape
        offset, factor = per_channel(self.offset, shape, "offset"), per_channel(self.factor, shape, "factor")
        return samples.replace(values=(samples.values - offset) * factor)


TOLERANCE = 0.2
"""Relative deviation of the length of a window from what its rate gives that is tolerated."""

SIZE = Parameter("size", "int", 50, (2, 1_000_000), "samples", "length of a window")
STRIDE = Parameter("stride", "int", 1, (1, 1_000_000), "samples", "from one window to the next")
RATE = Parameter("rate", "float", 0.0, (0, None), "Hz", "that samples have to come at; 0: any")


class Windower:
    """Cuts windows out of samples as they come."""

    def __init__(self) -> None:
        self._tail: Samples | None = None
        self._first = 0  # index, since the beginning, of the tail's first sample
        self._end: int | None = None  # and of the last window's last sample

    def feed(
        self,
        samples: Samples,
        size: int,
        stride: int,
        rate: float = 0.0,
        report: Callable[[str], object] = lambda text: None,
    ) -> Samples:
        """Return the windows that these samples complete: values (k, size, ...), stamps of their last samples (k,)."""
        values, stamps = samples.values, samples.stamps
        if self._tail is not None and self._tail.values.shape[1:] == values.shape[1:]:
            values = np.concatenate((self._tail.values, values))
            stamps = np.concatenate((self._tail.stamps, stamps))
        else:
            self._first, self._end = 0, None
        due = 0 if self._end is None else self._end + stride - self._first
        ends: Whole = np.arange(max(due, size - 1), len(stamps), stride)
        if len(ends):
            self._end = self._first + int(ends[-1])
        kept = max(0, len(stamps) - (size - 1))
        self._tail, self._first = Samples(values[kept:], stamps[kept:]), self._first + kept
        ends = _of_rate(ends, stamps, size, rate, report)
        chosen = values[ends[:, None] + np.arange(1 - size, 1)]
        return Samples(chosen, stamps[ends], samples.names)


def _of_rate(ends: Whole, stamps: Floats, size: int, rate: float, report: Callable[[str], object]) -> Whole:
    """Return the windows that are as long as they should be; report the others."""
    if not rate or not len(ends):
        return ends
    length = (size - 1) / rate
    lasted = stamps[ends] - stamps[ends - (size - 1)]
    fits = np.abs(lasted - length) <= TOLERANCE * length
    if not fits.all():
        last = float(lasted[~fits][-1])
        found = (size - 1) / last if last else np.inf
        report(f"windows left out: expected samples at {rate:g} Hz without a gap, got {found:.3g} Hz")
    return ends[fits]


class _Windowed(_PerInput):
    """Computes a result of each window, per input."""

    parameters: ClassVar[tuple[Parameter, ...]] = (SIZE, STRIDE, RATE)
    size: int
    stride: int
    rate: float

    def apply(self, name: str, samples: Samples) -> Samples:
        windower: Windower = self._kept.setdefault(name, Windower())
        windows = windower.feed(samples, self.size, self.stride, self.rate, self.report)
        return windows.replace(values=self.compute(windows.values)) if len(windows) else windows

    @abstractmethod
    def compute(self, windows: Floats) -> Floats:
        """(k, size, ...) to (k, ...)."""


class Window(_Windowed):
    """The windows themselves: (k, size, channels ...)."""

    def compute(self, windows: Floats) -> Floats:
        return windows


class RMS(_Windowed):
    """Root mean square per channel."""

    def compute(self, windows: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean(np.square(windows), axis=1)))


class MovingStatistics(_Windowed):
    """One statistic per channel: mean, deviation, minimum, maximum, median or range."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *_Windowed.parameters,
        Parameter(
            "statistic", "str", "mean", ("mean", "deviation", "minimum", "maximum", "median", "range"),
            description="what is computed of a window",
        ),
    )  # fmt: skip
    statistic: str
    _STATISTICS: Mapping[str, Callable[..., Floats]] = {
        "mean": np.mean, "deviation": np.std, "median": np.median,
        "minimum": np.min, "maximum": np.max, "range": np.ptp,
    }  # fmt: skip

    def compute(self, windows: Floats) -> Floats:
        return np.asarray(self._STATISTICS[self.statistic](windows, axis=1))


class Spectrum(_Windowed):
    """Amplitudes of the frequencies 0, rate / size, ... rate / 2 per channel: (k, size // 2 + 1, channels).

    One-sided, of a window weighted by Hann: a sine of amplitude A in the middle of a line has A there.
    """

    def compute(self, windows: Floats) -> Floats:
        weights = np.hanning(self.size + 1)[:-1]  # periodic
        shaped = windows * weights.reshape(-1, *[1] * (windows.ndim - 2))
        amplitudes = 2 * np.abs(np.fft.rfft(shaped, axis=1)) / weights.sum()
        amplitudes[:, 0] /= 2
        if self.size % 2 == 0:
            amplitudes[:, -1] /= 2
        return np.asarray(amplitudes)
