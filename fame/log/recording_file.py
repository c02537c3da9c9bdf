"""The file of a recording: MCAP, with the channels of docs/recordings.md, written message by message."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from fame.log.channels import CHANNELS, FORMAT, KEY
from fame.robot.change_text import Changes, ChangeText, name_text

if TYPE_CHECKING:
    from mcap.writer import Writer

    from fame.middleware.messages import Message

CHUNK = 1 << 18
"""Bytes of a chunk before it is compressed: what a crash may lose, and what a seek has to read."""


class RecordingFile:
    """An MCAP file with the channels of a recording, written message by message."""

    def __init__(self, stream: BinaryIO, chunk: int = 0) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer: Writer = Writer(stream, chunk_size=chunk or CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"fame {_version()}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write what the recording says of itself."""
        whole = {"format": str(FORMAT), "fame": _version(), "python": sys.version.split()[0], **metadata}
        self._writer.add_metadata("fame", whole)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the recording."""
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def message_channel(self, topic: str, type: str, node: str, definition: str = "") -> int:
        """The number of a new channel for messages of a ROS 2 type that `node` (full name) publishes, as CDR.

        `definition` of the type is needed where this process does not know it.
        """
        schema = self._schemas.get(type)
        if schema is None:
            text = definition or definition_of(type)
            schema = self._schemas[type] = self._writer.register_schema(type, "ros2msg", text.encode())
        return self._writer.register_channel(topic, "cdr", schema, {"node": node})

    def put(self, topic: str, time: int, text: str) -> None:
        """Write a message of one of `CHANNELS`: JSON, at a time (ns)."""
        channel = self._channels.get(topic)
        if channel is None:
            name, schema = CHANNELS[topic]
            schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self.write(channel, time, text.encode("utf-8", "backslashreplace"))

    def message(self, channel: int, time: int, message: Message) -> None:
        """Write a message of the mission."""
        from fame.middleware import codec

        self.write(channel, time, codec.serialize(message))

    def write(self, channel: int, time: int, data: bytes) -> None:
        """Write a message that is bytes already."""
        sequence = self._sequences[channel] = self._sequences.get(channel, 0) + 1
        self._writer.add_message(channel, time, data, time, sequence)

    def flush(self) -> None:
        """Write what was recorded so far to the file: it can be read if this process ends now."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]


@cache
def _version() -> str:
    """The version of FAME; empty where it is not installed."""
    try:
        return version("fame-robots")
    except PackageNotFoundError:
        return ""


def definition_of(type: str) -> str:
    """The definition of a type of messages, with those that it contains, as ROS 2 writes it."""
    from fame.middleware import codec

    text: str = codec.typestore(type).generate_msgdef(type, ros_version=2)[0]
    return text


class RunWriter(Protocol):
    """Takes what a run gives, in the order of time: here, or in another process."""

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write the metadata of the recording."""

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """A file that belongs to it."""

    def robot(self, name: str, process: str) -> None:
        """A robot of the run, and the process (id) that it runs."""

    def changes(self, robot: str, time: int, changes: Changes) -> None:
        """Record the changes of a robot up to a time (ns)."""

    def key(self, time: int) -> None:
        """Everything as it is before the changes of this time (ns) is wanted."""

    def scene(self, topic: str, time: int, make: Callable[..., str], *data: Any) -> None:
        """A message of the simulated world at a time (ns): what `make`, which can be pickled, makes of plain data."""

    def message_channel(self, topic: str, type: str, node: str) -> int:
        """The number of a new channel for messages of a ROS 2 type that `node` (full name) publishes."""

    def message(self, channel: int, time: int, message: Message) -> None:
        """A message at a time (ns)."""

    def finish(self) -> None:
        """There is nothing more."""


class FileWriter:
    """Makes the messages of a recording of what a run gives, and puts them into a file."""

    def __init__(self, file: RecordingFile) -> None:
        self.describe: Callable[[Mapping[str, str]], None] = file.describe
        self.attach: Callable[[str, str, bytes], None] = file.attach
        self.finish: Callable[[], None] = file.finish
        self._file = file
        self._robots: dict[str, ChangeText] = {}
        self._channels: list[int] = []

    def robot(self, name: str, process: str) -> None:
        """A robot of the run, and the process (id) that it runs."""
        self._robots[name] = ChangeText(name, process)

    def changes(self, robot: str, time: int, changes: Changes) -> None:
        """Write what changed in a robot."""
        self._robots[robot].write(time, changes, self._put)

    def _put(self, channel: str, time: int, text: str) -> None:
        self._file.put(f"/fame/{channel}", time, text)

    def key(self, time: int) -> None:
        """Write everything as it is."""
        robots = ",".join(f"{name_text(name)}:{text.key()}" for name, text in self._robots.items())
        self._file.put(KEY, time, f'{{"robots":{{{robots}}}}}')

    def scene(self, topic: str, time: int, make: Callable[..., str], *data: Any) -> None:
        """Write a message of the simulated world."""
        self._file.put(topic, time, make(*data))

    def message_channel(self, topic: str, type: str, node: str, definition: str = "") -> int:
        """The number of a new channel."""
        self._channels.append(self._file.message_channel(topic, type, node, definition))
        return len(self._channels) - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        """Write a message."""
        self._file.message(self._channels[channel], time, message)

    def write(self, channel: int, time: int, data: bytes) -> None:
        """Write a message that is CDR already."""
        self._file.write(self._channels[channel], time, data)
