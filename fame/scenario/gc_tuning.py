"""How Python looks for cyclic garbage during a run: seldom, and only among what is new.

Robots stay for the whole run, and messages hold no cycles. Looking through a thousand robots again and again took half
of the time of a run.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_THRESHOLDS = 100_000, 20, 100
"""A young generation that is larger than all the messages under way at an instant."""


@contextmanager
def seldom_collected() -> Iterator[None]:
    """What there is now is not looked at, what is made meanwhile seldom; afterwards all is as before."""
    former = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(*_THRESHOLDS)
    try:
        yield
    finally:
        gc.set_threshold(*former)
        gc.unfreeze()
