"""What leaves: publishers made from a configuration, and messages put together from what was computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fame.errors import FameError
from fame.middleware.interface import Node, Publisher
from fame.monitor.pipeline.configuration import Port
from fame.monitor.pipeline.processor import Floats, Samples
from fame.monitor.pipeline.subscriptions import Reporter
from fame.monitor.pipeline.writing import Writer, writer

_LATEST = 2.0**31
"""Seconds of builtin_interfaces/msg/Time end here."""


@dataclass(frozen=True, slots=True)
class _Outlet:
    """One topic."""

    ports: tuple[Port, ...]
    publisher: Publisher
    writer: Writer


class Outlets:
    """The publishers. `publish` sends what was computed, a message per sample and topic."""

    def __init__(self, node: Node, ports: Sequence[Port], say: Reporter) -> None:
        self._say, self.count = say, 0
        self._outlets = []
        for topic in dict.fromkeys(port.topic for port in ports):
            of_it = tuple(port for port in ports if port.topic == topic)
            publisher = node.publisher(topic, of_it[0].type, of_it[0].qos)
            self._outlets.append(_Outlet(of_it, publisher, writer(of_it[0].type, [port.path for port in of_it])))

    def publish(self, computed: Mapping[str, Samples]) -> None:
        """Send, by name of the output. What does not fit, or is not finite, is reported and not sent."""
        for outlet in self._outlets:
            there = [computed[port.name] for port in outlet.ports if port.name in computed]
            if not there:
                continue
            lengths = {len(samples) for samples in there}
            if len(there) < len(outlet.ports) or len(lengths) > 1:
                text = f"{outlet.publisher.topic}: its outputs were not computed together; nothing is sent"
                self._say(f"together {outlet.publisher.topic}", text)
                continue
            try:
                self._send(outlet, there)
            except FameError as error:
                self._say(f"unfit {outlet.publisher.topic}", f"{outlet.publisher.topic}: not sent: {error}")

    def _send(self, outlet: _Outlet, there: Sequence[Samples]) -> None:
        names = next((item.names for item in there if item.names), ())
        told = tuple(name.rpartition(".")[2] for name in names)
        finite = _finite([item.values for item in there], there[0].stamps)
        if not finite.all():
            self._say(f"finite {outlet.publisher.topic}", f"{outlet.publisher.topic}: not sent: it is not finite")
        rows = [np.ascontiguousarray(item.values[finite]) for item in there]  # as a middleware writes them
        stamps = there[0].stamps[finite].tolist()
        plain = bool(stamps) and outlet.writer.is_plain(rows)
        for index, stamp in enumerate(stamps[:1] if plain else stamps):
            first = outlet.writer.message([item[index] for item in rows], stamp, told)
            outlet.publisher.publish(first)
        for message in outlet.writer.alike(first, [item[1:] for item in rows], stamps[1:]) if plain else ():
            outlet.publisher.publish(message)
        self.count += len(stamps)


def _finite(arrays: Sequence[Any], stamps: Floats) -> Any:
    """Which rows are finite in all of them, at a time that a message can tell."""
    finite = np.isfinite(stamps) & (np.abs(stamps) < _LATEST)
    for values in arrays:
        if values.dtype.kind == "f":
            finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return finite
