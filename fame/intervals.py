"""Intervals of a probability that was estimated from a count of runs, and percentiles of what runs gave."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Literal

from fame.imports import require


def interval(
    count: int, total: int, confidence: float = 0.95, method: Literal["exact", "wilson"] = "exact"
) -> tuple[float, float]:
    """Return the interval of a probability from `count` of `total`: Clopper-Pearson's (exact) or Wilson's, by scipy.

    It is (0, 1) if `total` is 0. Raises UnavailableError without scipy.
    """
    if not total:
        return 0.0, 1.0
    require("scipy")
    from scipy.stats import binomtest

    found = binomtest(count, total).proportion_ci(confidence, method)
    return float(found.low), float(found.high)


def wilson(count: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's interval (Wilson 1927), as `interval`."""
    return interval(count, total, confidence, "wilson")


def nearest_rank(values: Sequence[float], fraction: float) -> float:
    """Return the percentile by nearest rank: the least value that at least this fraction of the values, of which there
    is one at least, do not exceed."""
    return sorted(values)[max(0, ceil(fraction * len(values)) - 1)]
