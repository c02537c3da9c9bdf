"""What Python lacks and CPython has in its C interface: verified with CPython 3.11.

Another interpreter has no ``ctypes.pythonapi``: there nothing of this is done. A thread of a library then needs a new
thread state for each callback (16 to 75 us of processor time), and a thread's loop that never ends keeps its thread.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from typing import Any

_API: Any = ctypes.pythonapi if sys.implementation.name == "cpython" else None
_state = threading.local()
"""Of each thread; not by its number, which a thread gets again when another has ended."""


def keep_thread_state() -> None:
    """Let Python keep its state of this thread, which a library in C started, from one callback to the next.

    It is safe: the thread holds Python's lock here and gives it back when the callback returns, since that is up to the
    outermost call of PyGILState_Ensure, not to this one. One state for each such thread stays until the process ends:
    call this in threads of a pool alone. `benchmarks/zenoh_trips.py` measures what it saves.
    """
    if _API is not None and not hasattr(_state, "kept"):
        _state.kept = True
        _API.PyGILState_Ensure()


def raise_in(thread: threading.Thread, error: type[BaseException]) -> None:
    """Raise an error in another thread at its next step of Python: nothing else ends a loop there."""
    if _API is not None:
        _API.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(error))
