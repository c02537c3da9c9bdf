"""Read the messages of a fake topic from files: tables, ROS bags, and recordings of FAME."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fame.clock import SECOND
from fame.errors import ConfigError


def read_series(path: Path) -> list[tuple[float, Any]]:
    """Return the rows of a CSV file: time (column ``stamp``, s) and fields by path. Raises
    ConfigError with file and line."""
    if not path.is_file():
        raise ConfigError("no such file", file=str(path))
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if "stamp" not in (reader.fieldnames or ()):
            has = ", ".join(reader.fieldnames or ()) or "none"
            raise ConfigError(f"expected a column stamp (s), got the columns {has}", file=str(path), line=1)
        series = []
        for row in reader:
            line = reader.line_num
            try:
                time = float(row.pop("stamp") or "")
            except ValueError as error:
                raise ConfigError(f"stamp: {error}", file=str(path), line=line) from None
            series.append((time, _nested({name: text for name, text in row.items() if name and text})))
    return series


def _nested(fields: Mapping[str, str]) -> dict[str, Any]:
    """``{"pose.x": "1"}`` as ``{"pose": {"x": "1"}}``."""
    found: dict[str, Any] = {}
    for name, text in fields.items():
        *path, last = name.split(".")
        inner = found
        for part in path:
            inner = inner.setdefault(part, {})
        inner[last] = text
    return found


def read_recorded(path: Path, topic: str, type: str) -> list[tuple[float, Any]]:
    """Return the messages of a topic with their times (s).

    Those of a bag of ROS count from the first message of the topic, those of a recording of FAME from the start of its
    run. Raises ConfigError for a file that is neither, lacks the topic, or has it with another type.
    """
    if path.is_file() and path.suffix == ".mcap" and not _is_of_ros(path):
        return _from_recording(path, topic, type)
    from fame.middleware import messages
    from fame.monitor.data_files import read_bag

    found = [(time, messages.to_mapping(message)) for time, _, message in read_bag(path, {topic: type})]
    return [(round(time - found[0][0], 9), message) for time, message in found]


def _is_of_ros(path: Path) -> bool:
    """Whether an MCAP file was written by ROS 2."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as file:
        try:
            return make_reader(file).get_header().profile == "ros2"
        except McapError as error:
            raise ConfigError(f"is not a readable bag: {error}", file=str(path)) from None


def _from_recording(path: Path, topic: str, type: str) -> list[tuple[float, Any]]:
    from fame.log import Recording

    with Recording(path) as recording:
        if topic not in recording.topics:
            has = ", ".join(name for name in recording.topics if not name.startswith("/fame/")) or "none"
            raise ConfigError(f"has no topic {topic}; it has {has}", file=str(path))
        if (recorded := recording.topics[topic].type) != type:
            raise ConfigError(f"expected {type} on {topic}, got {recorded}", file=str(path))
        return [
            ((message.time - recording.start) / SECOND, recording.decode(message))
            for message in recording.messages({topic})
        ]
