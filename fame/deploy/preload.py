"""While an engine waits for its first process it loads what any process needs: that one starts as fast as all others.

Not before it has said that it is there, and step by step: a process that comes meanwhile waits for one step at most,
and loads the rest itself. The more engines there are, the slower: when many start at once on one machine, finding each
other comes first.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator

from fame.clock import SECOND, Kind, Scheduler

TURN = 0.15
"""Between two steps, for each engine that there is (s): it may be on this machine, and have work of its own to do."""


def warm(scheduler: Scheduler, waits: Callable[[], bool], engines: Callable[[], int]) -> None:
    """Enter the steps in the scheduler; there are no more as soon as the engine no longer `waits`.

    `engines` tells how many there are.
    """
    steps = _steps()

    def rest() -> None:
        scheduler.after(round(TURN * SECOND) * engines(), go_on, Kind.TIMER)

    def go_on() -> None:
        if waits() and _load(steps):
            rest()

    rest()


def _load(steps: Iterator[str]) -> bool:
    """Do the next step; whether there was one. What it loads stays, so nobody need look for garbage in it."""
    gc.disable()
    try:
        return next(steps, None) is not None
    finally:
        gc.freeze()
        gc.enable()


def _steps() -> Iterator[str]:
    """Each tells what is there now."""
    import fame.bpmn.reader

    yield "reader"
    import fame.check.gate

    yield "check"
    import fame.monitor.services
    import fame.robot.node
    import fame.simulation  # noqa: F401

    yield "interpreter"
    from fame.middleware import codec, typesystem

    typesystem.names()
    yield "types"
    codec.typestore("std_msgs/msg/Bool")
    yield "codec"
    if "fame.middleware.dds" in sys.modules:
        from fame.middleware.dds import wire

        wire.declared("std_msgs/msg/Bool", False).__idl__.fill_type_data()  # what all descriptions are made with
    yield "descriptions"
