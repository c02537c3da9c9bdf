"""The end of steps by the clock: what `fame.scripting.budget` cannot count, a heartbeat of the process sees.

A script's frame is known by the budget in its builtins. `heartbeat` interrupts the main thread now and then, and raises
`BudgetExceeded` in a script that is still at work in the same step. Python hears of an interruption between two steps
of its own and in those long calls that ask for it (powers of large integers, regular expressions, `time.sleep`). A call
that never asks (``sum(itertools.count())``) ends with its process only, if there is a `last_resort`.
"""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from fame.processor_time import processor_alarm

BUDGET = "__budget__"
"""The name of the budget in a script's builtins."""


class BudgetExceeded(BaseException):
    """A step did not end. Not an Exception: `except Exception` must not swallow it."""


def script_frame(frame: FrameType | None, budget: object = None) -> FrameType | None:
    """The outermost frame of a script (of the interface with that budget) that called `frame`, or None."""
    found = None
    while frame is not None:
        owner = frame.f_builtins.get(BUDGET)
        if owner is not None and (budget is None or owner is budget):
            found = frame
        frame = frame.f_back
    return found


@contextmanager
def heartbeat(seconds: float = 5.0, *, last_resort: float = 0.0) -> Iterator[None]:
    """End by the wall clock what the budget does not see: a step at work at three beats in a row, half of that apart.

    Acts in the main thread only, elsewhere it does nothing. Raises BudgetExceeded inside the script, never in the
    engine. With `last_resort` a process whose main thread hears no beat while it computes so long (s of its processor
    time, so that one which was stopped lives on) is killed by SIGVTALRM; where it was stands on stderr.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen: tuple[FrameType, int] | None = None
    times = 0
    arm = processor_alarm() if last_resort else lambda seconds: None

    def beat(_number: int, frame: FrameType | None) -> None:
        nonlocal seen, times
        arm(last_resort)
        script = script_frame(frame)
        now = (script, script.f_builtins[BUDGET].steps) if script is not None else None
        same = now is not None and seen is not None and now[0] is seen[0] and now[1] == seen[1]
        seen, times = now, times + 1 if same else 1
        if times >= 3:
            raise BudgetExceeded(f"one step of the script took more than {seconds:g} s")

    former = signal.signal(signal.SIGALRM, beat)
    if last_resort and sys.__stderr__ is not None:
        faulthandler.register(signal.SIGVTALRM, file=sys.__stderr__, chain=True)
    arm(last_resort)
    signal.setitimer(signal.ITIMER_REAL, seconds / 2, seconds / 2)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        arm(0)
        faulthandler.unregister(signal.SIGVTALRM)
        signal.signal(signal.SIGALRM, former)
