"""When garbage is collected: rarely, where much is made that is no garbage, or garbage that is found quickly."""

from __future__ import annotations

import gc
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
