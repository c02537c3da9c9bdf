"""Report what keeps a monitoring node from judging, by signals and on ``/diagnostics``.

The signal ``monitor_blind`` (std_msgs/msg/String: node and reasons) is thrown when the reasons change,
``monitor_sees`` when the last one is gone. Topics that another monitoring node publishes are not watched here: that
node reports why one falls silent. A model that catches a signal without giving its type gets std_msgs/msg/Empty.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fame.clock import SECOND
from fame.errors import MissingTypeError
from fame.middleware import messages
from fame.middleware.interface import EndpointWarning, Middleware, Node, Publisher
from fame.middleware.typesystem import STRING

BLIND, SEES = "/monitor_blind", "/monitor_sees"
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_EMPTY = "std_msgs/msg/Empty"
_OK, _WARN = 0, 1


class Blindness:
    """Tells what keeps a node from judging. `on_change` gets the reasons in one text, empty if it sees."""

    def __init__(
        self, middleware: Middleware, node: Node, name: str, on_change: Callable[[str], object] = lambda text: None
    ) -> None:
        self._name, self._on_change = name, on_change
        bare = {info.name for info in middleware.graph() if [*info.types] == [_EMPTY]}
        self._signals = {topic: node.publisher(topic, _EMPTY if topic in bare else STRING) for topic in (BLIND, SEES)}
        self._diagnostics: Publisher | None = None
        try:
            self._diagnostics = node.publisher("/diagnostics", _DIAGNOSTICS)
        except MissingTypeError as error:  # a ROS without diagnostic_msgs: signals are heard by missions all the same
            text = f"{name} says by signals only whether it is blind: {error}"
            middleware.warn(EndpointWarning("/diagnostics", text, "backend"))
        self._known: set[str] = set()

    def look(self, reasons: Mapping[str, str], now: int) -> None:
        """Take the reasons of a time (ns), by the kind of each. To be called once a second."""
        text = "; ".join(reasons.values())
        if self._diagnostics:
            status: dict[str, Any] = {"level": _WARN if text else _OK, "name": f"{self._name}: monitor"}
            status |= {"message": text or "sees", "hardware_id": self._name}
            header = {"stamp": {"sec": now // SECOND, "nanosec": now % SECOND}}
            self._diagnostics.publish(messages.create(_DIAGNOSTICS, {"header": header, "status": [status]}))
        if reasons.keys() == self._known:
            return
        self._known = set(reasons)
        topic, told = (BLIND, f"{self._name}: {text}") if text else (SEES, self._name)
        publisher = self._signals[topic]
        publisher.publish(messages.create(publisher.type, told if publisher.type == STRING else None))
        self._on_change(text)


def told_by_others(middleware: Middleware, own: str, topic: str) -> bool:
    """Return whether another node that tells its reasons publishes a topic. `own` is the node that asks."""
    there = {info.name: set(info.publishers) for info in middleware.graph() if info.name in (topic, BLIND)}
    return bool(there.get(topic, set()) & (there.get(BLIND, set()) - {own}))
