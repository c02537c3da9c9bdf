"""When garbage is collected: all calls of `gc` that change it, and what each of them saves.

They are functions of CPython's documented `gc` (verified with 3.11). Another collector ignores thresholds and `freeze`:
everything works, only slower. `benchmarks/garbage.py` measures what they save.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def rarely_collected(young: int) -> Iterator[None]:
    """Look for garbage after this many new objects; restore the former settings at the end of the block.

    Old objects are hardly ever looked through again: that takes the longer the more there are.
    """
    former = gc.get_threshold()
    gc.set_threshold(young, 20, 100)
    try:
        yield
    finally:
        gc.set_threshold(*former)


@contextmanager
def uncollected(*, stays: bool = False) -> Iterator[None]:
    """Collect no garbage in the block, which allocates much that lives on. `stays`: freeze what exists at its end.

    That makes the start of an engine a tenth shorter.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if stays:
            exempt()
        if collects:
            gc.enable()


@contextmanager
def former_exempt() -> Iterator[None]:
    """Look for no garbage in what is there before the block, until its end."""
    exempt()
    try:
        yield
    finally:
        readmit()


class MemoryGrowth:
    """Collects all garbage if the memory of this process has grown by a quarter since it last did."""

    def __init__(self) -> None:
        self._above = 0.0

    def collect(self) -> None:
        if sys.getallocatedblocks() > self._above:
            gc.collect()
            self._above = 1.25 * sys.getallocatedblocks()


def exempt() -> None:
    """Never look for garbage in what is there now: it stays. Memory that forked processes share stays shared."""
    gc.freeze()


def readmit() -> None:
    """Look for garbage in everything again."""
    gc.unfreeze()
