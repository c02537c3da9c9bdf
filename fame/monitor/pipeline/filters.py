"""Low-pass, resample, scale: from samples to samples, all channels at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from fame.monitor.pipeline.processor import Floats, Parameter, Processor, Result, Samples, per_channel

_BLOCK = 64  # samples that are filtered at a time
_LONG = 100.0  # periods of the cutoff, after which nothing is left; sums of more would cost digits, or overflow


class LowPass(Processor):
    """One pole: y += a (x - y), a = 1 - exp(-2 pi fc / fs). It starts at the first sample.

    With `rate` 0, fs is taken from the stamps, sample by sample, which is right at any rate and across gaps.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("cutoff", "float", 10.0, (1e-6, None), "Hz", "fc, where the amplitude is down by 3 dB"),
        Parameter("rate", "float", 0.0, (0, None), "Hz", "fs; 0: from the stamps"),
    )
    cutoff: float
    rate: float

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._last: dict[str, tuple[Floats, float]] = {}

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        return {name: self._filtered(name, samples) for name, samples in inputs.items() if len(samples)}

    def _filtered(self, name: str, samples: Samples) -> Samples:
        values, stamps = np.asarray(samples.values, dtype=np.float64), samples.stamps
        y, before = self._last.get(name, (values[0], float(stamps[0])))
        if y.shape != values.shape[1:]:
            y, before = values[0], float(stamps[0])
        steps = np.full(len(stamps), 1 / self.rate) if self.rate else stamps - np.concatenate(([before], stamps[:-1]))
        steps = np.minimum(steps, _LONG / self.cutoff)
        out = np.empty_like(values)
        for first in range(0, len(stamps), _BLOCK):
            block = slice(first, first + _BLOCK)
            out[block] = _one_pole(y, values[block], -2 * np.pi * (self.cutoff * steps[block]))
            y = out[block][-1]
        self._last[name] = (y, float(stamps[-1]))
        return samples.replace(values=out)


def _one_pole(y: Floats, values: Floats, exponents: Floats) -> Floats:
    """y_k = d_k y_(k-1) + (1 - d_k) x_k with d = exp(exponents), for all k as one product of matrices."""
    total = np.cumsum(exponents)
    decays = np.tril(np.exp(np.minimum(total[:, None] - total, 0)))  # from sample j to sample k
    flat = values.reshape(len(values), -1)
    out = (decays * -np.expm1(exponents)) @ flat + np.exp(total)[:, None] * y.reshape(1, -1)
    return np.asarray(out.reshape(values.shape))


class Resample(Processor):
    """Samples at a fixed rate, on multiples of 1 / rate, by linear interpolation; nothing across a gap."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rate", "float", 50.0, (1e-6, None), "Hz", "of what comes out"),
        Parameter("gap", "float", 0.1, (0, None), "s", "between two samples, above which nothing is interpolated"),
    )
    rate: float
    gap: float

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._last: dict[str, Samples] = {}

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        results = {name: self._resampled(name, samples) for name, samples in inputs.items() if len(samples)}
        return {name: result for name, result in results.items() if len(result)}

    def _resampled(self, name: str, samples: Samples) -> Samples:
        values, stamps = np.asarray(samples.values, dtype=np.float64), samples.stamps
        begin = float(stamps[0]) - 0.5 / self.rate  # the first sample may stand on the grid itself
        if name in self._last and self._last[name].values.shape[1:] == values.shape[1:]:
            last = self._last[name]
            begin = float(last.stamps[0])
            values, stamps = np.concatenate((last.values, values)), np.concatenate((last.stamps, stamps))
        self._last[name] = Samples(values[-1:], stamps[-1:])
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
        """The multiples of 1 / rate after `begin`, among the stamps, without those deep in a gap: it may be years."""
        lows, highs = self._last_of(np.concatenate(([begin], stamps[:-1]))) + 1, self._last_of(stamps)
        wide = stamps - np.concatenate((stamps[:1], stamps[:-1])) > self.gap
        lows = np.where(wide, np.maximum(lows, highs), lows)  # the sample behind a gap may stand on the grid itself
        counts = np.maximum(highs - lows + 1, 0).astype(np.int64)
        ends = np.cumsum(counts)
        grid = (np.repeat(lows - (ends - counts), counts) + np.arange(counts.sum())) / self.rate
        return np.asarray(grid[grid >= stamps[0]])

    def _last_of(self, stamps: Floats) -> Floats:
        """The number of the last multiple of 1 / rate that is not after each stamp."""
        last = np.floor(stamps * self.rate)
        last += (last + 1) / self.rate <= stamps  # the product may have been rounded either way
        return np.asarray(last - (last / self.rate > stamps))


class Scale(Processor):
    """(x - offset) * factor, each one number for all channels or one per channel."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset", "floats", (0.0,), description="what is taken off"),
        Parameter("factor", "floats", (1.0,), description="what the rest is multiplied by"),
    )
    offset: tuple[float, ...]
    factor: tuple[float, ...]

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        return {
            name: samples.replace(
                values=(samples.values - self._fitting("offset", samples)) * self._fitting("factor", samples)
            )
            for name, samples in inputs.items()
            if len(samples)
        }

    def _fitting(self, name: str, samples: Samples) -> Floats | float:
        return per_channel(getattr(self, name), samples.values.shape, name)
