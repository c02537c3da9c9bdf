"""Interrupts scripts by the clock, where `fame.scripting.budget` cannot count.

A script's frame is recognised by the budget in its builtins. `heartbeat` interrupts the main thread periodically, and
raises `BudgetExceeded` in a script that is still in the same step. Python handles signals between two bytecode
instructions, and in long calls that check for them (powers of large integers, regular expressions, `time.sleep`). A
call that never checks (``sum(itertools.count())``) ends with its process only, by the `last_resort`.
"""

from __future__ import annotations

import ctypes
import faulthandler
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType

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
    """Interrupt a step of a script that is running at three beats in a row, which are `seconds` / 2 apart.

    Works in the main thread only, elsewhere it does nothing. Raises BudgetExceeded inside the script, never in the
    engine. With `last_resort` (s of processor time, so that a stopped process lives on) a process whose main thread
    handles no beat while it computes that long is killed by SIGVTALRM, with a traceback on stderr.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen: tuple[FrameType, int] | None = None
    times = 0
    arm = _processor_alarm() if last_resort else lambda seconds: None

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


class _SignalEvent(ctypes.Structure):
    """``struct sigevent``: send a signal, which is 0 in `notify`."""

    _fields_ = [
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("_", ctypes.c_char * 48),
    ]


class _Times(ctypes.Structure):
    """``struct itimerspec``."""

    _fields_ = [(name, ctypes.c_long) for name in ("interval", "interval_ns", "seconds", "ns")]


def _processor_alarm() -> Callable[[float], object]:
    """A function that sets an alarm: SIGVTALRM comes after so many seconds of processor time of this thread; 0 cancels.

    POSIX has it (``timer_create``) and Python does not. Where a thread has no clock the time of all threads counts.
    """
    try:
        libc, timer = ctypes.CDLL(None), ctypes.c_void_p()
        event = _SignalEvent(signal=signal.SIGVTALRM)
        if libc.timer_create(time.CLOCK_THREAD_CPUTIME_ID, ctypes.byref(event), ctypes.byref(timer)) == 0:
            return partial(_set, libc, timer)
    except (AttributeError, OSError, TypeError):
        pass
    return partial(signal.setitimer, signal.ITIMER_VIRTUAL)


def _set(libc: ctypes.CDLL, timer: ctypes.c_void_p, seconds: float) -> None:
    times = _Times(seconds=int(seconds), ns=int(seconds % 1 * 1e9))
    libc.timer_settime(timer, 0, ctypes.byref(times), None)
