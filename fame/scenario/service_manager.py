"""Tell the service manager, systemd, how this process is: ready, alive, stopping (sd_notify(3)).

Nothing is told to nobody: without NOTIFY_SOCKET in the environment, none of this has an effect.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress

from fame.clock import SECOND, WallScheduler


class Notifier:
    """What systemd is told of a process whose work is done by a scheduler.

    Signs of life come from the scheduler: a process that is stuck in a call gives none, and is started again. They
    come twice in each WATCHDOG_USEC, unless WATCHDOG_PID is another process (sd_watchdog_enabled(3)).
    """

    def __init__(self, scheduler: WallScheduler) -> None:
        self._scheduler, self._address = scheduler, os.environ.get("NOTIFY_SOCKET", "")
        limit = os.environ.get("WATCHDOG_USEC", "")
        ours = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period: int = int(limit) * (SECOND // 1_000_000) // 2 if limit.isdecimal() and ours else 0

    def ready(self) -> None:
        """Say that the process does its work now, and from now on that it is alive."""
        self._tell("READY=1")
        if self._address and self._period:
            self._alive()

    def stopping(self) -> None:
        """Say that the process is about to end."""
        self._tell("STOPPING=1")

    def _alive(self) -> None:
        self._tell("WATCHDOG=1")
        self._scheduler.after(self._period, self._alive)

    def _tell(self, text: str) -> None:
        """Send a datagram; a service manager that is away is no reason to end."""
        if self._address:
            abstract = self._address.startswith("@")
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.sendto(text.encode(), f"\0{self._address[1:]}" if abstract else self._address)
