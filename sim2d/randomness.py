"""Random numbers: one generator per sensor, so that adding a robot does not change others; noise drawn in blocks."""

from __future__ import annotations

import hashlib

import numpy as np


def generator(seed: int, *owner: str) -> np.random.Generator:
    """Return the generator of one owner, such as ``generator(7, "REX", "range")``, the same on every run and machine.

    Generators of different owners are independent: the key is a cryptographic hash of seed and names (Python's own hash
    differs from run to run).
    """
    key = "\0".join([str(seed), *owner]).encode()
    return np.random.Generator(np.random.PCG64(int.from_bytes(hashlib.sha256(key).digest()[:16], "big")))


_BLOCK = 8


class Noise:
    """Rows of `columns` standard normal numbers."""

    def __init__(self, random: np.random.Generator, columns: int) -> None:
        self._random, self._columns = random, columns
        self._rows: list[list[float]] = []

    def row(self) -> list[float]:
        """Return the next row."""
        if not self._rows:
            self._rows = self._random.standard_normal((_BLOCK, self._columns)).tolist()
            self._rows.reverse()
        return self._rows.pop()
