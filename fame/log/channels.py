"""The channels of a recording: their topics, and the schemas of their JSON (docs/recording_format.md).

Foxglove and Lichtblick read a channel only if each object of its schema has `properties`, each array `items`, and each
value one type: members that may be null are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.robot.robot_state import EVENTS as EVENTS, VARIABLES as VARIABLES, WAITING as WAITING

FORMAT = 2
"""The version of the format: a reader reads this one and older ones."""

KEY, WORLD, GROUND = "/fame/key", "/fame/world", "/fame/ground"
PROPERTIES, CLOCKS = "/fame/properties", "/fame/clocks"

_ROBOT = {"type": "string", "description": "name of the robot"}
_OBJECTS = {"type": "array", "items": {"type": "object", "properties": {}}}
_TEXTS = {"type": "array", "items": {"type": "string"}}


def _schema(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


_TIME = _schema(sec={"type": "integer"}, nsec={"type": "integer"})
_VECTOR = _schema(x={"type": "number"}, y={"type": "number"}, z={"type": "number"})
_COLOR = _schema(r={"type": "number"}, g={"type": "number"}, b={"type": "number"}, a={"type": "number"})
_POSE = _schema(
    position=_VECTOR,
    orientation=_schema(x={"type": "number"}, y={"type": "number"}, z={"type": "number"}, w={"type": "number"}),
)
_POINTS = {"type": "array", "items": _VECTOR}


def _listed(**properties: Any) -> dict[str, Any]:
    return {"type": "array", "items": _schema(**properties)}


_ENTITY = _schema(
    timestamp=_TIME,
    frame_id={"type": "string"},
    id={"type": "string"},
    lifetime=_TIME,
    frame_locked={"type": "boolean"},
    metadata=_listed(key={"type": "string"}, value={"type": "string"}),
    arrows=_OBJECTS,
    cubes=_OBJECTS,
    spheres=_OBJECTS,
    cylinders=_listed(
        pose=_POSE, size=_VECTOR, bottom_scale={"type": "number"}, top_scale={"type": "number"}, color=_COLOR
    ),
    lines=_listed(
        type={"type": "integer"},
        pose=_POSE,
        thickness={"type": "number"},
        scale_invariant={"type": "boolean"},
        points=_POINTS,
        color=_COLOR,
        colors={"type": "array", "items": _COLOR},
        indices={"type": "array", "items": {"type": "integer"}},
    ),
    triangles=_listed(
        pose=_POSE,
        points=_POINTS,
        color=_COLOR,
        colors={"type": "array", "items": _COLOR},
        indices={"type": "array", "items": {"type": "integer"}},
    ),
    texts=_listed(
        pose=_POSE,
        billboard={"type": "boolean"},
        font_size={"type": "number"},
        scale_invariant={"type": "boolean"},
        color=_COLOR,
        text={"type": "string"},
    ),
    models=_OBJECTS,
)
_SCENE = _schema(
    deletions=_listed(timestamp=_TIME, type={"type": "integer"}, id={"type": "string"}),
    entities={"type": "array", "items": _ENTITY},
)

CHANNELS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    EVENTS: ("fame.Events", _schema(robot=_ROBOT, events=_OBJECTS)),
    VARIABLES: ("fame.Variables", _schema(robot=_ROBOT, changes=_OBJECTS)),
    WAITING: (
        "fame.Waiting",
        _schema(robot=_ROBOT, tokens=_OBJECTS, gone=_TEXTS),
    ),
    KEY: ("fame.Key", _schema(robots={"type": "object", "properties": {}})),
    WORLD: ("foxglove.SceneUpdate", _SCENE),
    GROUND: ("foxglove.SceneUpdate", _SCENE),
    PROPERTIES: (
        "fame.Judgement",
        _schema(property={"type": "string"}, verdict={"type": "string"}, robots=_TEXTS),
    ),
    CLOCKS: ("fame.Clock", _schema(robot=_ROBOT)),
}
"""Topic -> name and content of its schema."""
