"""The `fame` command, also as ``python -m fame``. A Ctrl-C is reported in one line, also during imports."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress

_PATIENCE = 0.5
"""Maximum time for a thread that a script has started to end (s)."""


def main() -> int:
    """Run the command line and return the exit code. See `fame.cli`."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started us: fame check >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - until the process ends
    # Threads of OpenBLAS, which numpy starts, would keep a processor busy for a tenth of a second before they sleep:
    # the processor on which the recording is written, or that of other engines.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    try:
        from fame import cli
    except KeyboardInterrupt:
        print("fame: interrupted", file=sys.stderr)
        return 130
    return _without_waiting(cli.main())


def _without_waiting(code: int) -> int:
    """Return the exit code, or exit at once if threads of scripts, which are not daemons, are still running."""
    others = [
        thread for thread in threading.enumerate() if thread is not threading.current_thread() and _is_plain(thread)
    ]
    for thread in others:
        if not thread.daemon:
            thread.join(_PATIENCE)
    if left := [thread.name for thread in others if not thread.daemon and thread.is_alive()]:
        with suppress(OSError):
            print(f"fame: ended while threads were running: {', '.join(left)}", file=sys.stderr, flush=True)
            sys.stdout.flush()
        os._exit(code)
    return code


def _is_plain(thread: threading.Thread) -> bool:
    """Whether no library's own kind of thread: those (of joblib, for one) are ended by their library at exit.

    The JavaScript engine starts a plain one when it is imported, which does nothing and ends at exit, too.
    """
    plain = type(thread) is threading.Thread or type(thread).__module__ not in sys.modules
    return plain and not thread.name.startswith("quickjs-worker")


if __name__ == "__main__":
    sys.exit(main())
