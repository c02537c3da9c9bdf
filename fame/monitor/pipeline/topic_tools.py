"""Inspection of topics: their messages, rates, and numbers on them over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.dataclasses import dataclass, field
from fame.errors import MessageError
from fame.middleware.interface import SENSOR_DATA, Middleware, Node
from fame.monitor.pipeline.fields import FieldPath, UnusableMessage, has_stamp, reader, stamp_of
from fame.text import printable


def type_of_topic(middleware: Middleware, topic: str) -> str:
    """Return the type of a topic by the graph. Raises MessageError for an unknown topic, or one of several types."""
    there = {info.name: info for info in middleware.graph()}
    info = there.get(topic)
    if info is None or not info.types:
        have = ", ".join(sorted(there)) or "none"
        raise MessageError(f"unknown topic {topic}; known are {have}")
    if len(info.types) > 1:
        raise MessageError(f"topic {topic} has several types: {', '.join(info.types)}; it should have one")
    return info.types[0]


@dataclass(slots=True)
class MessageTimes:
    """When messages came: how often, and how regularly."""

    times: list[float] = field(default_factory=list)

    def text(self, now: float, last: float = 10.0) -> str:
        """Describe rate (Hz) and periods (ms) of the `last` seconds of messages in one line, and how long (s) none has
        come `now`."""
        if not self.times:
            return "silent"
        times = np.array([time for time in self.times if time >= self.times[-1] - last])
        silent = f"; silent for {now - times[-1]:.0f} s" if now - times[-1] >= 1 else ""
        if len(times) < 2:
            return f"1 message{silent}"
        periods = 1000 * np.diff(times)
        rate = 1000 / periods.mean() if periods.mean() > 0 else float("inf")
        return (
            f"{rate:.2f} Hz over {len(times)} messages; period {periods.mean():.2f} ms, "
            f"from {periods.min():.2f} to {periods.max():.2f}, deviation {periods.std():.2f}{silent}"
        )


class Series:
    """One or more numbers over time, at a path in the messages of a topic. `unusable`: why some messages were not."""

    label: str

    def __init__(self, node: Node, scheduler: Scheduler, topic: str, type: str, path: FieldPath) -> None:
        """Subscribe. Raises MessageError if the type has no such path."""
        self._scheduler, self._read, self._stamped = scheduler, reader(type, path), has_stamp(type)
        self.label = f"{topic} {'.'.join(map(str, path))}"
        self.stamps: list[float] = []
        self.values: list[Any] = []
        self.names: tuple[str, ...] = ()
        self.unusable: list[str] = []
        node.subscription(topic, type, self._on_message, SENSOR_DATA)

    def _on_message(self, message: Any) -> None:
        try:
            value, self.names = self._read(message)
        except UnusableMessage as reason:
            self.unusable.append(str(reason))
            return
        stamp = (stamp_of(message) if self._stamped else 0.0) or self._scheduler.now / SECOND
        self.stamps.append(stamp)
        self.values.append(value)


def parse_path(text: str) -> FieldPath:
    """Read a path: ``effort.3``, ``effort.elbow_joint``, ``pose.position.x``."""
    return tuple(int(step) if step.isdecimal() else step for step in text.replace("/", ".").split("."))


def format_message(value: Any, limit: int = 8, indent: str = "") -> str:
    """Return a message as text like YAML, long lists cut."""
    if isinstance(value, dict):
        return "".join(_entry(name, item, limit, indent) for name, item in value.items())
    return printable(str(value))


def _entry(name: str, item: Any, limit: int, indent: str) -> str:
    if isinstance(item, dict):
        return f"{indent}{name}:\n{format_message(item, limit, indent + '  ')}" if item else f"{indent}{name}: {{}}\n"
    if isinstance(item, list) and item and isinstance(item[0], dict):
        parts = "".join(f"{indent}-\n{format_message(each, limit, indent + '  ')}" for each in item[:limit])
        return f"{indent}{name}:\n{parts}" + (f"{indent}... {len(item)} in all\n" if len(item) > limit else "")
    if isinstance(item, list):
        more = f", ... {len(item)} in all" if len(item) > limit else ""
        return f"{indent}{name}: [{', '.join(map(_number, item[:limit]))}{more}]\n"
    return f"{indent}{name}: {_number(item)}\n"


def _number(value: Any) -> str:
    return float_text(value) if isinstance(value, float) else repr(value) if value == "" else printable(str(value))


def float_text(value: float) -> str:
    """Return a number as the shortest text from which it can be read again, also one of a field `float32`."""
    texts = (f"{value:.{digits}g}" for digits in (6, 7, 8, 9))
    with np.errstate(over="ignore"):
        return next((text for text in texts if value in (float(text), float(np.float32(text)))), repr(value))


def wait_for_types(
    middleware: Middleware, scheduler: Scheduler, topics: Sequence[str], patience: float = 3.0
) -> dict[str, str]:
    """Return the type of each topic, as soon as all are there. Raises MessageError after `patience` s."""
    end = scheduler.now + round(patience * SECOND)
    while True:
        try:
            return {topic: type_of_topic(middleware, topic) for topic in topics}
        except MessageError:
            if scheduler.now >= end:
                raise
            scheduler.run(scheduler.now + SECOND // 10)
