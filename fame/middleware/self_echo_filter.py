"""Drops the messages that come back to the node that sent them; they are recognised by their bytes.

Needed where a middleware does not say who sent a message (rclpy; it needs no ROS itself, so that it is tested
everywhere). A subscription records what publishers of its own node have sent to it, and drops the next sample with the
same bytes. Echoes of one publisher come in its order, so those before a recognised one were lost; one that does not
come within a second was lost too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterable

from fame.clock import SECOND

_TIMEOUT = SECOND
"""How long an echo may take (ns)."""
_HEADER = 4
"""Length of the encapsulation header of CDR (bytes): its last two may come back changed."""


class EchoFilter:
    """The echoes that one subscription expects."""

    def __init__(self) -> None:
        self._sent: dict[Hashable, deque[tuple[int, bytes]]] = {}

    def expect(self, publisher: Hashable, messages: Iterable[bytes], now: int) -> None:
        """Record what a publisher has sent (CDR) at `now` (ns)."""
        self._sent.setdefault(publisher, deque()).extend((now, _content(data)) for data in messages)

    def take(self, data: bytes, now: int) -> bool:
        """Whether a sample that has come is an echo. An echo is recognised once."""
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
