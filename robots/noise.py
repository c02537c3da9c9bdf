"""Gaussian noise for sensors, drawn in blocks: one by one the draws would cost more than the measurement.

The blocks are small: what a thousand robots have drawn in advance has to stay in the processor's cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

_BLOCK = 8


class Noise:
    """Rows of `columns` standard normal numbers."""

    def __init__(self, random: np.random.Generator, columns: int) -> None:
        self._random, self._columns = random, columns
        self._rows: list[list[float]] = []

    def row(self) -> list[float]:
        """The next row."""
        if not self._rows:
            self._rows = self._random.standard_normal((_BLOCK, self._columns)).tolist()
            self._rows.reverse()
        return self._rows.pop()
