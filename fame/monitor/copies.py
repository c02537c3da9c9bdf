"""Copies of runs: equal values, wherever they stand. They say nothing about the next run, and count in no rate."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

RUN_HASHES = "run_hashes"
"""In the conditions of a model: the hash of each run that it learned from."""


def run_hash(values: Any) -> str:
    """Return a hash that is the same for the same values (n, channels)."""
    data = np.ascontiguousarray(values, dtype=np.float64)
    return hashlib.sha256(f"{data.shape}".encode() + data.tobytes()).hexdigest()[:16]


def copies(hashes: Iterable[str]) -> dict[int, int]:
    """Return the numbers of runs that are copies, each with that of the first of its kind."""
    seen: dict[str, int] = {}
    firsts = [(number, seen.setdefault(each, number)) for number, each in enumerate(hashes)]
    return {number: first for number, first in firsts if number != first}
