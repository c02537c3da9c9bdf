"""An alarm on the processor time of one thread, as POSIX has it (``timer_create``) and Python has not."""

from __future__ import annotations

import ctypes
import signal
import time
from collections.abc import Callable
from functools import partial


class _Event(ctypes.Structure):
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


def processor_alarm() -> Callable[[float], object]:
    """What sets the alarm: SIGVTALRM comes after so many seconds that this thread computes; 0 takes it back.

    Where a thread has no such clock the time of all threads counts.
    """
    try:
        libc, timer = ctypes.CDLL(None), ctypes.c_void_p()
        event = _Event(signal=signal.SIGVTALRM)
        if libc.timer_create(time.CLOCK_THREAD_CPUTIME_ID, ctypes.byref(event), ctypes.byref(timer)) == 0:
            return partial(_set, libc, timer)
    except (AttributeError, OSError, TypeError):
        pass
    return partial(signal.setitimer, signal.ITIMER_VIRTUAL)


def _set(libc: ctypes.CDLL, timer: ctypes.c_void_p, seconds: float) -> None:
    times = _Times(seconds=int(seconds), ns=int(seconds % 1 * 1e9))
    libc.timer_settime(timer, 0, ctypes.byref(times), None)
