"""DDS domains of these tests alone: other runs may be on the machine, and other workers of pytest-xdist are."""

from __future__ import annotations

import socket
from contextlib import suppress

_kept: list[socket.socket] = []
"""Says to others on this machine that the domains are taken, until this process ends, however it does."""


def _free() -> int:
    """The first of four domains that nobody has. Those above 101 use ports that other programs may be given."""
    for first in range(1, 100, 4):
        taken = socket.socket()
        with suppress(OSError):
            taken.bind(("127.0.0.1", 7400 + 250 * first + 249))  # a port of TCP, which DDS has no use for
            _kept.append(taken)
            return first
        taken.close()
    raise RuntimeError("no DDS domain from 1 to 100 is free: too many runs of the tests at once")


DOMAIN = _free()
"""The next domain belongs to this worker, too."""
PROCESSES = DOMAIN + 2
"""For engines in processes of their own; the next domain belongs to this worker, too."""
