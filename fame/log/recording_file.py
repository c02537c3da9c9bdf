"""The file of a recording: MCAP, with the channels of docs/recording_format.md, written message by message."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, BinaryIO

from fame.fast_json import json_bytes
from fame.log.channels import CHANNELS, FORMAT
from fame.version import current as fame_version

if TYPE_CHECKING:
    from mcap.writer import Writer

    from fame.middleware.messages import Message

CHUNK = 1 << 18
"""Bytes of a chunk before it is compressed: what a crash may lose, and what a seek has to read."""


class Sink:
    """Takes what a recording has, in the order of time. This one drops it."""

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Take what the recording says of itself."""

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Take a file that belongs to it."""

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Take a message of one of `CHANNELS` at a time (ns). Nobody changes the data any more."""

    def message_channel(self, topic: str, type: str, node: str) -> int:
        """Return the number of a new channel for messages of a ROS 2 type that `node` (full name) publishes."""
        return 0

    def message(self, channel: int, time: int, message: Message) -> None:
        """Take a message of the mission at a time (ns). Nobody changes it any more."""

    def flush(self) -> None:
        """Make what was taken safe, should this process end now."""

    def finish(self) -> None:
        """Take the end."""


class RecordingFile(Sink):
    """An MCAP file with the channels of a recording, written message by message."""

    def __init__(self, stream: BinaryIO) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer: Writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"fame {fame_version()}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[int, int] = {}

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write what the recording says of itself."""
        whole = {"format": str(FORMAT), "fame": fame_version(), "python": sys.version.split()[0], **metadata}
        self._writer.add_metadata("fame", whole)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the recording."""
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        schema = self._schemas.get(type)
        if schema is None:
            from fame.middleware import codec

            text = codec.typestore(type).generate_msgdef(type, ros_version=2)[0]
            schema = self._schemas[type] = self._writer.register_schema(type, "ros2msg", text.encode())
        return self._writer.register_channel(topic, "cdr", schema, {"node": node})

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Write a message of one of `CHANNELS` at a time (ns), as JSON."""
        channel = self._channels.get(topic)
        if channel is None:
            name, schema = CHANNELS[topic]
            schema_id = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self.write(channel, time, json_bytes(data))

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
        self._writer.finish()  # type: ignore[no-untyped-call]
