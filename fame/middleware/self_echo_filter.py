"""Drops the messages that come back to the node that sent them; they are recognised by their bytes.

Needed for a middleware that does not report the sender of a message (rclpy). This module needs no ROS itself, so that
it can be tested everywhere. A subscription records the messages of publishers of its own node, and drops the next
sample with the same bytes. Echoes of one publisher arrive in order: those before a recognised one were lost, as was one
that does not arrive within a second.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterable

from fame.clock import SECOND

_TIMEOUT = SECOND
"""Time limit of an echo (ns)."""
_HEADER = 4
"""Length of the encapsulation header of CDR (bytes): its last two may come back changed."""


class EchoFilter:
    """The echoes that one subscription expects."""

    def __init__(self) -> None:
        self._sent: dict[Hashable, deque[tuple[int, bytes]]] = {}

    def expect(self, publisher: Hashable, messages: Iterable[bytes], now: int) -> None:
        """Record the messages (CDR) that a publisher has sent at `now` (ns)."""
        self._sent.setdefault(publisher, deque()).extend((now, _content(data)) for data in messages)

    def take(self, data: bytes, now: int) -> bool:
        """Return whether a received sample is an echo. Each echo is recognised once."""
        content = _content(data)
        for sent in self._sent.values():
            while sent and now - sent[0][0] > _TIMEOUT:
                sent.popleft()
            for place, (_, echo) in enumerate(sent):
                if echo == content:
                    for _ in range(place + 1):
                        sent.popleft()
                    return True
        return False


def _content(data: bytes) -> bytes:
    """The content of a sample: DDS may pad it to a multiple of four bytes, and may record that in the header."""
    return data[_HEADER:] + bytes(-len(data) % 4)
