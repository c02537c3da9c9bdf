"""Messages from a bag: rosbag2 in either storage, a single MCAP file, or rosbag1."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fame.errors import ConfigError


def read_bag(path: str | Path, topics: Mapping[str, str]) -> Iterator[tuple[float, str, Any]]:
    """Every message of some topics (full name -> type), in the order of recording: its time (s), topic, message.

    Raises ConfigError for what is no bag, lacks a topic, or has it with another type.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    file = str(path)
    try:
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            connections = [item for item in reader.connections if item.topic in topics]
            for topic, type in topics.items():
                found = [item.msgtype for item in connections if item.topic == topic]
                if not found:
                    has = ", ".join(sorted({item.topic for item in reader.connections})) or "none"
                    raise ConfigError(f"has no topic {topic}; it has {has}", file=file)
                if found[0] != type:
                    raise ConfigError(f"{topic} carries {found[0]}; {type} would be right", file=file)
            for connection, time, data in reader.messages(connections=connections):
                yield time * 1e-9, connection.topic, reader.deserialize(data, connection.msgtype)
    except (AnyReaderError, OSError) as error:
        raise ConfigError(f"is no bag that can be read: {error}", file=file) from None
