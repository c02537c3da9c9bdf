"""Shares for tables, with 95 % intervals that take runs of one machine, file or arm for what they are: alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fame.intervals import interval


def share(counts: Any) -> float:
    """Give the share of (count, total)."""
    return float(counts[0] / counts[1])


def over_clusters(counts: Any, figure: Callable[[Any], float] = share) -> tuple[float, float]:
    """Give the 95 % interval of a figure of summed counts (clusters, k): 500 resamplings of clusters."""
    random = np.random.default_rng(0)
    draws = (random.integers(0, len(counts), len(counts)) for _ in range(500))
    low, high = np.quantile([figure(counts[draw].sum(axis=0)) for draw in draws], [0.025, 0.975])
    return float(low), float(high)


def told(counts: Any) -> str:
    """Give a share with its interval: of (count, total) the exact one; of (clusters, 2) the one over clusters, but no
    narrower than the exact one. Where clusters have none, or all, of it, resampling says nothing, and the exact one has
    each cluster as one trial."""
    counts = np.asarray(counts)
    count, total = map(int, counts.reshape(-1, 2).sum(axis=0))
    if counts.ndim == 2 and count in (0, total):
        ends = interval(len(counts) if count else 0, len(counts))
    elif counts.ndim == 2:
        both = over_clusters(counts), interval(count, total)
        ends = min(low for low, _ in both), max(high for _, high in both)
    else:
        ends = interval(count, total)
    return f"{count} of {total} ({100 * ends[0]:.0f} to {100 * ends[1]:.0f} %)"
