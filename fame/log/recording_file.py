"""The file of a recording: MCAP, with the channels of docs/recording_format.md, written message by message."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from fame.fast_json import json_bytes
from fame.log.channels import CHANNELS, FORMAT
from fame.version import current as fame_version

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

    from fame.middleware.messages import Message


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


class ChannelWriter(Protocol):
    """What a `ChannelSink` writes to: `fame.log.mcap_writer.McapWriter` says what each method does."""

    def schema(self, name: str, encoding: str, data: bytes) -> int: ...
    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int: ...
    def message(self, channel: int, time: int, data: bytes) -> None: ...
    def metadata(self, name: str, data: Mapping[str, str]) -> None: ...
    def attachment(self, name: str, media_type: str, data: bytes) -> None: ...
    def flush(self) -> None: ...
    def finish(self) -> None: ...


class ChannelSink(Sink):
    """Writes the channels of a recording, message by message."""

    def __init__(self, writer: ChannelWriter) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write what the recording says of itself."""
        whole = {"format": str(FORMAT), "fame": fame_version(), "python": sys.version.split()[0], **metadata}
        self._writer.metadata("fame", whole)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the recording."""
        self._writer.attachment(name, media_type, data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        schema = self._schemas.get(type)
        if schema is None:
            from fame.middleware import codec

            text = codec.typestore(type).generate_msgdef(type, ros_version=2)[0]
            schema = self._schemas[type] = self._writer.schema(type, "ros2msg", text.encode())
        return self._writer.channel(topic, "cdr", schema, {"node": node})

    def same_channel(self, channel: Channel, schema: Schema) -> int:
        """Return the number of a channel like that of another file."""
        number = self._writer.schema(schema.name, schema.encoding, schema.data)
        return self._writer.channel(channel.topic, channel.message_encoding, number, channel.metadata)

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        """Write a message of one of `CHANNELS` at a time (ns), as JSON."""
        self._writer.message(self._channels.get(topic) or self.open(topic), time, json_bytes(data))

    def open(self, topic: str) -> int:
        """Return the number of the channel, from 1 on, that one of `CHANNELS` has from now on."""
        name, schema = CHANNELS[topic]
        schema_id = self._writer.schema(name, "jsonschema", json.dumps(schema).encode())
        self._channels[topic] = number = self._writer.channel(topic, "json", schema_id, {})
        return number

    def message(self, channel: int, time: int, message: Message) -> None:
        """Write a message of the mission."""
        from fame.middleware import codec

        self.write(channel, time, codec.serialize(message))

    def write(self, channel: int, time: int, data: bytes) -> None:
        """Write a message that is bytes already."""
        self._writer.message(channel, time, data)

    def flush(self) -> None:
        """Write what was recorded so far to the file: it can be read if this process ends now."""
        self._writer.flush()

    def finish(self) -> None:
        self._writer.finish()


class RecordingFile(ChannelSink):
    """An MCAP file with the channels of a recording, written message by message."""

    def __init__(self, stream: BinaryIO) -> None:
        from fame.log.mcap_writer import McapWriter

        super().__init__(McapWriter(stream, f"fame {fame_version()}"))
