"""What would be a recording, given to a page at once: without a file, and without the bytes of one."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from fame.log.recording_file import RecordingFile
from fame.middleware import codec, messages
from fame.middleware.messages import Message


class PageSink(RecordingFile):
    """Takes the messages of a recording; the file is the page.

    `put` gets those of its channels: topic, time (ns) and data. `message` gets those of the mission: time (ns), topic,
    the full name of the publisher, and the fields.
    """

    def __init__(
        self,
        put: Callable[[str, int, Any], object],
        message: Callable[[int, str, str, Any], object],
    ) -> None:
        self._put, self._message = put, message
        self._topics: list[tuple[str, str, str]] = []

    def describe(self, metadata: Mapping[str, str]) -> None:
        pass

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        pass

    def put(self, topic: str, time: int, text: str) -> None:
        self._put(topic, time, json.loads(text))

    def message_channel(self, topic: str, type: str, node: str, definition: str = "") -> int:
        self._topics.append((topic, type, node))
        return len(self._topics) - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        topic, _, publisher = self._topics[channel]
        self._message(time, topic, publisher, messages.to_mapping(message))

    def write(self, channel: int, time: int, data: bytes) -> None:
        self.message(channel, time, codec.deserialize(data, self._topics[channel][1]))

    def flush(self) -> None:
        pass

    def finish(self) -> None:
        pass
