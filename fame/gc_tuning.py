"""When no garbage is collected: while an engine starts, or loads a model beside a running mission.

What is loaded stays, so that looking through it finds nothing, and stops all threads meanwhile. It is a function of
CPython's documented `gc` (verified with 3.11). Another collector ignores `freeze`: everything works, only slower.
`benchmarks/garbage.py` measures what it saves.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uncollected(*, stays: bool = False) -> Iterator[None]:
    """Collect no garbage in the block, which allocates much that lives on. `stays`: freeze what exists at its end."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if stays:
            gc.freeze()
        if collects:
            gc.enable()
