"""What leaves: publishers made from a configuration, and messages put together from what was computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fame.errors import FameError
from fame.middleware.interface import Node, Publisher
from fame.pipeline.configuration import Port
from fame.pipeline.intake import Reporter
from fame.pipeline.processor import Samples
from fame.pipeline.writing import Writer, writer


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
        whole = [_finite(item.values) for item in there]
        rows = [np.ascontiguousarray(item.values) for item in there]  # as a middleware writes them
        plain, first = outlet.writer.is_plain(rows), None
        for index, stamp in enumerate(there[0].stamps.tolist()):
            if not all(finite is None or finite[index] for finite in whole):
                self._say(f"finite {outlet.publisher.topic}", f"{outlet.publisher.topic}: not sent: it is not finite")
                continue
            values = [item[index] for item in rows]
            if first is None or not plain:
                first = message = outlet.writer.message(values, stamp, told)
            else:
                message = outlet.writer.like(first, values, stamp)
            outlet.publisher.publish(message)
            self.count += 1


def _finite(values: Any) -> Any:
    """Which rows are finite; None if all of them are."""
    if values.dtype.kind != "f":
        return None
    finite = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    return None if finite.all() else finite
