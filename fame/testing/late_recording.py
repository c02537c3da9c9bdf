"""The recording of a mission under test, which is written only if somebody wants it: when an expectation fails.

To write a recording costs more than to run a short mission: JSON, CDR, compression, the definitions of types. What a
run gives a `RunWriter` does not change later, so it can be kept and written at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

from fame.log.recording_file import FileWriter, RecordingFile
from fame.robot.change_text import Changes

if TYPE_CHECKING:
    from fame.middleware.messages import Message

MOST = 20_000
"""Calls that are kept; those of a longer mission are written, compressed."""


class LateWriter:
    """A `RunWriter` that keeps what it is given. `content` writes it."""

    def __init__(self) -> None:
        self._calls: list[tuple[str, tuple[Any, ...]]] = []
        self._buffer = _Buffer()
        self._writer: FileWriter | None = None
        self._channels = 0

    def content(self) -> bytes:
        """What was recorded (MCAP); complete after `finish`."""
        self._write()
        return self._buffer.getvalue()

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Take the metadata of the recording."""
        self._keep("describe", metadata)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Take a file that belongs to it."""
        self._keep("attach", name, media_type, data)

    def robot(self, name: str, process: str) -> None:
        """Take a robot of the run, and the process (id) that it runs."""
        self._keep("robot", name, process)

    def changes(self, robot: str, time: int, changes: Changes) -> None:
        """Take what changed in a robot until a time (ns)."""
        self._keep("changes", robot, time, changes)

    def key(self, time: int) -> None:
        """Take the wish for everything as it is before the changes of this time (ns)."""
        self._keep("key", time)

    def scene(self, topic: str, time: int, make: Callable[..., str], *data: Any) -> None:
        """Take a message of the simulated world at a time (ns): what `make` makes of plain data."""
        self._keep("scene", topic, time, make, *data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        """The number of a new channel for messages of a ROS 2 type that `node` (full name) publishes."""
        self._keep("message_channel", topic, type, node)
        self._channels += 1
        return self._channels - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        """Take a message at a time (ns); a message is not changed once it was published."""
        self._keep("message", channel, time, message)

    def finish(self) -> None:
        """Take the end."""
        self._keep("finish")

    def _keep(self, name: str, *arguments: Any) -> None:
        self._calls.append((name, arguments))
        if len(self._calls) >= MOST:
            self._write()

    def _write(self) -> None:
        """Write what was kept."""
        calls, self._calls = self._calls, []
        if self._writer is None and calls:
            self._writer = FileWriter(RecordingFile(self._buffer))
        for name, arguments in calls:
            getattr(self._writer, name)(*arguments)


class _Buffer(BytesIO):
    """A buffer that keeps what was written when it is closed."""

    def close(self) -> None:
        """Keep the content."""
