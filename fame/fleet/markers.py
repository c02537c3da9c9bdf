"""What a mission means, for RViz: visualization_msgs/msg/MarkerArray on ``/mission_markers``.

Once a second each robot publishes its state at its own frame, the goals of the actions in progress (each
geometry_msgs/PoseStamped in them) as arrows, and its zones: the outlines of variables that are a
geometry_msgs/PolygonStamped. Namespaces are ``REX/state``, ``REX/goals``, ``REX/zones``; what is not published again
vanishes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from fame.deploy.envelope import Report
from fame.errors import MessageError
from fame.fleet.diagnostics import ERROR, OK, diagnostic_status
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.scripting.requests import Act

if TYPE_CHECKING:
    from fame.robot import RobotNode

TYPE, MARKER = "visualization_msgs/msg/MarkerArray", "visualization_msgs/msg/Marker"
ARROW, LINE_STRIP, TEXT = 0, 4, 9
_MOST = 100
"""Goals and zones of a robot that are shown."""
_DEPTH = 4
"""Levels of a goal in which poses are looked for."""
_LIFETIME = {"sec": 3, "nanosec": 0}
_GREEN, _ORANGE, _RED, _BLUE = ((0.3, 0.8, 0.3), (0.95, 0.6, 0.1), (0.9, 0.2, 0.2), (0.3, 0.5, 0.9))


class MarkerPublisher:
    """Publishes what a report says and what runs means; `frame` is that of the robot."""

    def __init__(self, node: Node, frame: str, running: Callable[[], RobotNode | None]) -> None:
        self._out, self._frame, self._running = node.publisher("/mission_markers", TYPE), frame, running

    def __call__(self, report: Report) -> None:
        found = [_state(report, self._frame)]
        if (node := self._running()) is not None:
            found += [*_goals(node, _places(report)), *_zones(node)][:_MOST]
        made = []
        for number, (kind, frame, fields) in enumerate(found):
            header = {"frame_id": frame or "map"}  # without a stamp: where the frame is by its newest transform
            whole = {"header": header, "ns": f"{report.robot}/{kind}", "id": number, "lifetime": _LIFETIME, **fields}
            with suppress(MessageError):  # a variable that only looks like one
                made.append(messages.create(MARKER, whole))
        self._out.publish(messages.create(TYPE, {"markers": made}))


_Found = tuple[str, str, dict[str, Any]]
"""Kind, frame and fields of a marker."""


def _state(report: Report, frame: str) -> _Found:
    """The state of a robot's mission, and where it waits, above it."""
    status = diagnostic_status(report)
    text = "\n".join([f"{report.robot}: {status['message']}", *_places(report).values()])
    colour = _GREEN if status["level"] == OK else _RED if status["level"] == ERROR else _ORANGE
    return "state", frame, {**_text(text, colour), "pose": {"position": {"z": 1.0}}, "frame_locked": True}


def _places(report: Report) -> dict[str, str]:
    """The elements where a robot waits, as people see them, by id."""
    return {str(wait["element"]): str(wait.get("place") or wait["element"]) for wait in report.waits}


def _goals(node: RobotNode, places: Mapping[str, str]) -> Iterator[_Found]:
    """The poses of the goals that are in progress, with the names of their elements."""
    for wait in node.engine.waits.values():
        request = node.runner.request(wait.key)
        if isinstance(request, Act) and not wait.paused:
            for frame, pose in _stamped(request.fields, "pose"):
                shape = {"type": ARROW, "pose": pose, "scale": {"x": 0.6, "y": 0.1, "z": 0.1}, "color": _colour(_BLUE)}
                yield "goals", frame, shape
                text = f"{node.name}: {places.get(wait.node.id, wait.node.id)}"
                yield "goals", frame, {**_text(text, _BLUE), "pose": pose}


def _zones(node: RobotNode) -> Iterator[_Found]:
    """The outlines of areas in variables, with their names."""
    for instance in node.engine.instances.values():
        for name, value in instance.variables.items():
            for frame, polygon in _stamped(value, "polygon", depth=1):
                points = polygon.get("points") if isinstance(polygon, Mapping) else None
                if isinstance(points, list) and points:
                    line = {"type": LINE_STRIP, "points": [*points, points[0]], "scale": {"x": 0.05}}
                    yield "zones", frame, {**line, "color": _colour(_ORANGE)}
                    place = {"position": points[0]}
                    yield "zones", frame, {**_text(name, _ORANGE), "pose": place}


def _stamped(value: Any, key: str, depth: int = _DEPTH) -> Iterator[tuple[str, Any]]:
    """The frame and content of each stamped value inside a value: mappings and messages with `header` and `key`."""
    value = messages.to_mapping(value) if isinstance(value, messages.Message) else value
    if isinstance(value, Mapping) and {"header", key} <= value.keys():
        header = value["header"]
        yield str(header.get("frame_id", "") if isinstance(header, Mapping) else ""), value[key]
    elif depth and isinstance(value, Mapping | list):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _stamped(inner, key, depth - 1)


def _text(text: str, colour: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": TEXT, "text": text, "scale": {"z": 0.25}, "color": _colour(colour)}


def _colour(rgb: tuple[float, float, float]) -> dict[str, float]:
    return {**dict(zip("rgb", rgb, strict=True)), "a": 1.0}
