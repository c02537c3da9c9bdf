"""One input for one reader: what it did, if that is more than reading it or refusing it in one line."""

from __future__ import annotations

import gc
import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from fame.errors import FameError

from .targets import Target

SECONDS, BYTES = 5.0, 2**30
"""What no input may cost: processor time (s) and memory."""


class TooSlow(BaseException):
    """An input took more processor time than any may."""


@contextmanager
def _deadline() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlow(f"more than {SECONDS:g} s of processor time")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS, 1.0)  # again, should somebody catch it
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


def failure(target: Target, data: bytes, *, timed: bool = False) -> str:
    """Why an input is a failure of a reader: the last lines of its traceback; empty if it is none.

    Only if `timed` the time counts.
    """
    try:
        if timed:
            with _deadline():
                target.read(data)
        else:
            target.read(data)
    except FameError as error:
        text = str(error)
        return f"a message of several lines: {text!r}" if "\n" in text else ""
    except target.accepted:
        return ""
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = next((frame for frame in reversed(frames) if "/fame/" in frame.filename), frames[-1])
        name = own.filename.rpartition("/fame/")[2]
        return f"{type(error).__name__}: {str(error)[:200]!r} at fame/{name}:{own.lineno} {own.name}"
    return ""


def kind(text: str) -> str:
    """What failures of one cause have in common: error and place."""
    return text.split(":", 1)[0] + text.rpartition(" at ")[2]


def reduced(target: Target, data: bytes, why: str, seconds: float = 60.0) -> bytes:
    """A shorter input that fails in the same way: pieces are left out as long as it does."""
    until, timed = time.monotonic() + seconds, why.startswith("TooSlow")
    size = max(1, len(data) // 2)
    while size and time.monotonic() < until:
        begin = 0
        while begin < len(data) and time.monotonic() < until:
            shorter = data[:begin] + data[begin + size :]
            if kind(failure(target, shorter, timed=timed)) == kind(why):
                data = shorter
            else:
                begin += size
        size //= 2
    gc.collect()
    return data
