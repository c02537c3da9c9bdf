"""A port of this machine that nobody listens at, for a program that cannot choose one and say which."""

from __future__ import annotations

import random
import socket
from contextlib import suppress


def free_port() -> int:
    """A free port of 127.0.0.1, which no other test is given until this process ends.

    Nor does the system give it to a program that asks for any port: Linux has 32768 to 60999 for those.
    """
    for port in random.SystemRandom().sample(range(61000, 65400), 1000):
        with suppress(OSError), socket.socket(type=socket.SOCK_DGRAM) as claim, socket.socket() as end:
            claim.bind(("127.0.0.1", port))  # of UDP, which nobody has a use for: it says to others that it is taken
            end.bind(("127.0.0.1", port))
            claim.detach()  # open until the process ends, however it does
            return port
    raise RuntimeError("no port from 61000 to 65399 is free")
