"""Bags: messages read from rosbag2 in either storage, a single MCAP file or rosbag1, and written as rosbag2 or MCAP."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.middleware import codec
from fame.monitor.pipeline.configuration import Port


def read_bag(path: str | Path, topics: Mapping[str, str]) -> Iterator[tuple[float, str, Any]]:
    """Give every message of some topics (full name -> type), in the order of recording: time (s), topic, message.

    Raises ConfigError for a file that is not a bag, lacks a topic, or has it with another type.
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
                    raise ConfigError(f"expected {type} on {topic}, got {found[0]}", file=file)
            for connection, time, data in reader.messages(connections=connections):
                yield time * 1e-9, connection.topic, reader.deserialize(data, connection.msgtype)
    except (AnyReaderError, OSError) as error:
        raise ConfigError(f"is not a readable bag: {error}", file=file) from None


class BagWriter:
    """Writes messages to a folder as `ros2 bag` does, or to a file if its name ends in ``.mcap``.

    Raises ConfigError if it exists already.
    """

    path: Path
    count: int

    def __init__(self, path: Path, ports: Sequence[Port], topics: Sequence[str]) -> None:
        """`topics` are the full names, one per port."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        if path.exists():
            raise ConfigError("exists already", file=str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.count = path, 0
        self._folder = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.")) if path.suffix else None
        target = self._folder / "bag" if self._folder is not None else path
        self._writer = Writer(target, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        types = dict(zip(topics, (port.type for port in ports), strict=True))
        self._connections = {
            topic: self._writer.add_connection(topic, type, typestore=codec.typestore(type))
            for topic, type in types.items()
        }

    def put(self, topic: str, stamp: float, message: Any) -> None:
        """Write a message at its time (s)."""
        self._writer.write(self._connections[topic], round(stamp * SECOND), codec.serialize(message))
        self.count += 1

    def close(self) -> None:
        """Finish the bag."""
        self._writer.close()
        if self._folder is not None:
            (made,) = (self._folder / "bag").glob("*.mcap")
            made.replace(self.path)
            shutil.rmtree(self._folder)
