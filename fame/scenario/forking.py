"""Several robots' processes started by one: it imports what they need once, and becomes them by `os.fork`.

A hundred Python processes that each import the same modules need more processor time for that than for all else, and
each has a copy of them in memory. Nothing may have been started before `fork_each`: no thread, no middleware.
"""

from __future__ import annotations

import gc
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from fame.scenario.process import forked, orphaned, signals_call

_LOOK = 0.2
"""How often the parent looks who has ended (s)."""


def fork_each(names: Sequence[str]) -> tuple[str, dict[int, str], list[socket.socket]]:
    """Make a process for each name. Return its name in each of them, and in this one "" and the name by process id;
    and the ends of sockets that connect each process with this one: of each its own, in this one all."""
    gc.freeze()  # a collection would write to what is there, and memory that processes share would be copied
    sys.stdout.flush()
    sys.stderr.flush()
    parent, children, ends = os.getpid(), dict[int, str](), list[socket.socket]()
    for name in names:
        here, there = socket.socketpair()
        process = os.fork()
        if not process:
            forked(parent)
            for end in (*ends, here):  # else they stay open when that process has ended
                end.close()
            return name, {}, [there]
        there.close()
        children[process] = name
        ends.append(here)
    return "", children, ends


def wait_for(
    children: Mapping[int, str],
    rest: Callable[[float], object] = time.sleep,
    on_stopped: Callable[[str, bool], object] = lambda name, stopped: None,
) -> dict[str, int]:
    """Wait until all children have ended, and return the exit code of each; one that a signal ended has a negative one.

    Meanwhile, `rest` is called with a time in s, and `on_stopped` for one that is stopped (True) or goes on. Signals
    that ask to end go to all of them. They end, too, when the FAME process that started this one has ended.
    """
    left, codes = dict(children), dict[str, int]()

    def tell(number: int, *_: object) -> None:
        for process in tuple(left):
            with suppress(ProcessLookupError):
                os.kill(process, number)

    with signals_call(tell):
        while left:
            process, status = os.waitpid(-1, os.WNOHANG | os.WUNTRACED | os.WCONTINUED)
            if process in left and (os.WIFSTOPPED(status) or os.WIFCONTINUED(status)):
                on_stopped(left[process], os.WIFSTOPPED(status))
            elif process in left:
                codes[left.pop(process)] = os.waitstatus_to_exitcode(status)
            elif not process:
                if orphaned():
                    tell(signal.SIGTERM)
                rest(_LOOK)
    return codes
