"""Types of arrays, and which channels move."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Whole: TypeAlias = NDArray[np.int64]
"""Whole numbers: labels, runs, indices."""


def moves(deviation: Floats, mean: Floats) -> Any:
    """Return which channels move by more than rounding errors, by their standard deviation (channels,)."""
    return deviation > 1e-13 + 1e-9 * np.abs(mean)
