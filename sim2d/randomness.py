"""A random generator for each sensor, so that adding a robot changes no other."""

from __future__ import annotations

import hashlib

import numpy as np


def generator(seed: int, *owner: str) -> np.random.Generator:
    """The generator of one owner, such as ``generator(7, "REX", "range")``: the same on every run and machine.

    Independent of all others: its key is a cryptographic hash of seed and names (Python's own hash differs from run
    to run).
    """
    key = "\0".join([str(seed), *owner]).encode()
    return np.random.Generator(np.random.PCG64(int.from_bytes(hashlib.sha256(key).digest()[:16], "big")))
