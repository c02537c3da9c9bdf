"""Windows of samples, and what is computed of each: itself, RMS, moving statistics, spectrum.

A window is `size` consecutive samples; the next begins `stride` samples later. A result carries the stamp of
the last sample of its window. A window that spans a gap, or samples of another rate than given, is left out and
reported.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from fame.monitor.arrays import Whole
from fame.monitor.pipeline.processor import Floats, Parameter, Processor, Result, Samples

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
        """The windows that these samples complete: values (k, size, ...), stamps of their last samples (k,)."""
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
    """Those windows that are as long as they should be."""
    if not rate or not len(ends):
        return ends
    length = (size - 1) / rate
    lasted = stamps[ends] - stamps[ends - (size - 1)]
    fits = np.abs(lasted - length) <= TOLERANCE * length
    if not fits.all():
        found = (size - 1) / float(lasted[~fits][-1])
        report(f"windows left out: expected samples at {rate:g} Hz without a gap, got {found:.3g} Hz")
    return ends[fits]


class _Windowed(Processor):
    """Computes a result of each window, per input."""

    parameters: ClassVar[tuple[Parameter, ...]] = (SIZE, STRIDE, RATE)
    size: int
    stride: int
    rate: float

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._windowers: dict[str, Windower] = {}

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        results = {name: self._apply(name, samples) for name, samples in inputs.items() if len(samples)}
        return {name: result for name, result in results.items() if len(result)}

    def _apply(self, name: str, samples: Samples) -> Samples:
        windower = self._windowers.setdefault(name, Windower())
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
