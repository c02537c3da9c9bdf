"""The link between the process that has the participant and one that it has forked: a pair of Unix sockets.

Messages have a kind and a number. Both processes are of one program and nobody else has the pair, so that what is not
bytes already is pickled.
"""

from __future__ import annotations

import pickle
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

DATA, ASK, REPLY, EVENT = range(4)
"""A message from or to an endpoint (its number); a question (0: no answer is expected) and its answer; an event."""
_HEAD = struct.Struct("<QBQ")
_BUFFER = 2**20


class RelayLink:
    """One end. Any thread may send."""

    def __init__(self, end: socket.socket) -> None:
        self._lock, self._closed, self._end = threading.Condition(), False, end
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)

    def connect(self, end: socket.socket) -> None:
        """Go on over another pair of sockets: what could not be sent goes there."""
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        with self._lock:
            self._end.close()
            self._end = end
            self._lock.notify_all()

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield kind, number and data of each message, until the other end is closed."""
        with suppress(OSError), self._end.makefile("rb", _BUFFER) as file:
            while len(head := file.read(_HEAD.size)) == _HEAD.size:
                size, kind, number = _HEAD.unpack(head)
                if len(data := file.read(size)) == size:
                    yield kind, number, data

    def send(self, kind: int, number: int, data: bytes) -> None:
        """Send, and wait until the other process takes it; if that has ended, until this is connected or closed."""
        message = _HEAD.pack(len(data), kind, number) + data
        with self._lock:
            while not self._closed:
                try:
                    return self._end.sendall(message)
                except OSError:
                    self._lock.wait()

    def send_object(self, kind: int, number: int, value: Any) -> None:
        self.send(kind, number, pickle.dumps(value, pickle.HIGHEST_PROTOCOL))

    def close(self) -> None:
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._closed = True
            self._lock.notify_all()
            self._end.close()


class PatientLink(RelayLink):
    """An end that never waits: what does not go into the socket is kept, and `later` is called to `flush` it then."""

    def __init__(self, end: socket.socket, later: Callable[[], object]) -> None:
        super().__init__(end)
        self._later, self._unsent = later, bytearray()

    @property
    def congested(self) -> bool:
        """Whether the other process does not take what is sent."""
        return bool(self._unsent)

    def send(self, kind: int, number: int, data: bytes) -> None:
        with self._lock:
            waiting = self.congested
            self._unsent += _HEAD.pack(len(data), kind, number) + data
            if waiting or self._flush():
                return
        self._later()

    def flush(self) -> bool:
        """Send what is kept. Returns whether all is sent."""
        with self._lock:
            return self._flush()

    def _flush(self) -> bool:
        try:
            while self._unsent:
                del self._unsent[: self._end.send(self._unsent, socket.MSG_DONTWAIT)]
        except BlockingIOError:
            return False
        except OSError:  # the other process has ended
            self._unsent.clear()
        return True
