"""Nothing that tests start outlives them, whatever fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

_MARK = f"FAME_TESTS={os.getpid()}"


def mark() -> None:
    """Mark what this process starts, and what that starts, by its environment. What a block holds that fails is killed:
    to wait for it, as Python does, can take for ever."""
    os.environ.update([_MARK.split("=")])
    leave = subprocess.Popen.__exit__

    def leave_at_once(process: subprocess.Popen[Any], kind: object, *error: Any) -> None:
        if kind is not None:
            process.kill()
        leave(process, kind, *error)  # type: ignore[arg-type]

    subprocess.Popen.__exit__ = leave_at_once  # type: ignore[method-assign, assignment]


def end_processes() -> None:
    """End all that is marked and still runs.

    Workers of joblib are told to end. A resource tracker ends with the process that it belongs to.
    """
    if (executors := sys.modules.get("joblib.externals.loky.reusable_executor")) is not None:
        executors.get_reusable_executor(reuse=True).shutdown()
    while sum(map(_end, Path("/proc").glob("[0-9]*"))):  # until no other one has come meanwhile
        time.sleep(0.01)


def _end(folder: Path) -> bool:
    """Kill a process, if it is marked. Returns whether it is."""
    with suppress(OSError):  # it is over, or of another user
        marked = _MARK.encode() in (folder / "environ").read_bytes().split(b"\0")
        if marked and b"resource_tracker" not in (folder / "cmdline").read_bytes():
            os.kill(int(folder.name), signal.SIGKILL)
            return True
    return False
