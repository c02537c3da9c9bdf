"""Bodies of robots: how they are put into the space of the world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fame.config.values import Point
from robots.robot import ROBOT, Pose

if TYPE_CHECKING:
    import pymunk


def rectangle(length: float, width: float) -> tuple[Point, ...]:
    """The corners of a body, m: x ahead, y to the left."""
    x, y = length / 2, width / 2
    return (x, y), (-x, y), (-x, -y), (x, -y)


def body_of(space: pymunk.Space, start: Pose, outline: Sequence[Point], mass: float) -> tuple[pymunk.Body, pymunk.Poly]:
    """A body of `mass` kg in the space, and its shape. The filter of the shape leaves out the body itself."""
    import pymunk

    body = pymunk.Body(mass, pymunk.moment_for_poly(mass, outline))
    body.position = start.x, start.y
    body.angle = start.heading
    shape = pymunk.Poly(body, outline)
    shape.friction = 0.5
    shape.collision_type = ROBOT
    shape.filter = pymunk.ShapeFilter(group=len(space.bodies) + 1)
    space.add(body, shape)
    return body, shape
