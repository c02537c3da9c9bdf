"""The recording of a mission under test, which is written only if somebody wants it: when an expectation fails.

To write a recording costs more than to run a short mission: JSON, CDR, compression, the definitions of types. What a
`Sink` is given does not change later, so it can be kept and written at the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

from fame.log.recording_file import RecordingFile, Sink

if TYPE_CHECKING:
    from fame.middleware.messages import Message

MOST = 20_000
"""Calls that are kept; those of a longer mission are written, compressed."""


class LateFile(Sink):
    """A sink that keeps what it is given. `content` writes it."""

    def __init__(self) -> None:
        self._calls: list[tuple[str, tuple[Any, ...]]] = []
        self._buffer = _Buffer()
        self._file: RecordingFile | None = None
        self._channels = 0
        self._written: list[int] = []  # number of each channel in the file

    def content(self) -> bytes:
        """Return what was recorded (MCAP); complete after `finish`."""
        self._write()
        return self._buffer.getvalue()

    def describe(self, metadata: Mapping[str, str]) -> None:
        self._keep("describe", metadata)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        self._keep("attach", name, media_type, data)

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        self._keep("put", topic, time, data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        self._keep("message_channel", topic, type, node)
        self._channels += 1
        return self._channels - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        self._keep("message", channel, time, message)

    def finish(self) -> None:
        self._keep("finish")

    def _keep(self, name: str, *arguments: Any) -> None:
        self._calls.append((name, arguments))
        if len(self._calls) >= MOST:
            self._write()

    def _write(self) -> None:
        """Write what was kept."""
        calls, self._calls = self._calls, []
        if self._file is None and calls:
            self._file = RecordingFile(self._buffer)
        for name, arguments in calls:
            if name == "message":
                arguments = (self._written[arguments[0]], *arguments[1:])
            made = getattr(self._file, name)(*arguments)
            if name == "message_channel":
                self._written.append(made)


class _Buffer(BytesIO):
    """A buffer that keeps what was written when it is closed."""

    def close(self) -> None:
        """Keep the content."""
