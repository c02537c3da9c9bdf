"""Joint states from a bag (rosbag2 in either storage, or rosbag1)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fame.anomaly.joints import TYPE
from fame.errors import ConfigError


def read_bag(path: str | Path, topic: str) -> Iterator[tuple[float, Any]]:
    """Every message of a topic and the time (s) at which it was recorded. Raises ConfigError."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            connections = [item for item in reader.connections if item.topic == topic]
            if not connections:
                has = ", ".join(sorted({item.topic for item in reader.connections})) or "none"
                raise ConfigError(f"has no topic {topic}; it has {has}", file=str(path))
            if connections[0].msgtype != TYPE:
                raise ConfigError(f"{topic} carries {connections[0].msgtype}; {TYPE} would be right", file=str(path))
            for connection, time, data in reader.messages(connections=connections):
                yield time * 1e-9, reader.deserialize(data, connection.msgtype)
    except AnyReaderError as error:
        raise ConfigError(f"is no bag that can be read: {error}", file=str(path)) from None
