"""The path planner of a ground robot: a node of its own that knows only topics, like Nav2's planner server.

Takes `map` (nav_msgs/msg/OccupancyGrid, latched) and `odom`; answers each `goal_pose` (geometry_msgs/msg/PoseStamped)
with a `plan` (nav_msgs/msg/Path) from the latest odometry to the goal. An empty path says that there is no way. A
goal that comes before map and odometry is answered when they are there; of several the latest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from fame.config.parameters import parameter
from fame.config.values import Point
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Message, Node
from robots.route import route
from sim2d.grid import Grid, from_message, inflate
from sim2d.robot import MEASUREMENT


@dataclass(frozen=True, slots=True)
class PlannerParameters:
    """`margin` is kept from obstacles; a goal may be missed by `tolerance` if it is too close to one. Both in m."""

    margin: float = parameter(0.08, "m", minimum=0)
    tolerance: float = parameter(0.5, "m", minimum=0)


class Planner:
    """Plans for a robot that fits into a circle of `radius` m."""

    def __init__(self, node: Node, parameters: PlannerParameters, radius: float) -> None:
        self._radius, self._margin, self._tolerance = radius, parameters.margin, parameters.tolerance
        self._map: Message | None = None
        self._ground: Grid | None = None
        self._grid: Grid | None = None  # inflated; made for the first goal: most of a thousand robots never get one
        self._odometry: Message | None = None
        self._goal: Message | None = None
        self._plan = node.publisher("plan", "nav_msgs/msg/Path")
        node.subscription("map", "nav_msgs/msg/OccupancyGrid", self._on_map, LATCHED)
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("goal_pose", "geometry_msgs/msg/PoseStamped", self._on_goal)

    def _on_map(self, message: Message) -> None:
        self._map, self._grid = message, None
        self._answer()

    def _on_odometry(self, message: Message) -> None:
        self._odometry = message
        if self._goal is not None:
            self._answer()

    def _on_goal(self, message: Message) -> None:
        self._goal = message
        self._answer()

    def _answer(self) -> None:
        if self._map is None or self._odometry is None or self._goal is None:
            return
        if self._grid is None:
            self._ground = from_message(self._map)
            margin = max(self._margin, self._ground.resolution)  # cells are told from each other by their centres
            self._grid = inflate(self._ground, self._radius + margin)
        goal, self._goal = self._goal, None
        position, target = self._odometry.pose.pose.position, goal.pose.position
        places = None
        if math.isfinite(target.x) and math.isfinite(target.y):
            here, there = (position.x, position.y), (target.x, target.y)
            places = route(self._grid, here, there, self._tolerance, self._ground)
        self._plan.publish(messages.create("nav_msgs/msg/Path", _path(places or [], self._odometry, goal)))


class DirectPlanner:
    """The same for a robot that flies: its way is always the straight line, without a map."""

    def __init__(self, node: Node) -> None:
        self._odometry: Message | None = None
        self._goal: Message | None = None
        self._plan = node.publisher("plan", "nav_msgs/msg/Path")
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("goal_pose", "geometry_msgs/msg/PoseStamped", self._on_goal)

    def _on_odometry(self, message: Message) -> None:
        self._odometry = message
        if self._goal is not None:
            self._on_goal(self._goal)

    def _on_goal(self, message: Message) -> None:
        if self._odometry is None:
            self._goal = message
            return
        self._goal = None
        here, there = self._odometry.pose.pose.position, message.pose.position
        finite = math.isfinite(there.x) and math.isfinite(there.y)
        places = [(here.x, here.y), (there.x, there.y)] if finite else []
        self._plan.publish(messages.create("nav_msgs/msg/Path", _path(places, self._odometry, message)))


def _path(places: list[Point], odometry: Message, goal: Message) -> dict[str, Any]:
    """The fields of a path: each pose looks to the next, the last as the goal does."""
    stamp, last = odometry.header.stamp, goal.pose.orientation
    header = {"frame_id": "map", "stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}}
    headings = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(places)]
    turns = [{"z": math.sin(heading / 2), "w": math.cos(heading / 2)} for heading in headings]
    turns.append({"x": last.x, "y": last.y, "z": last.z, "w": last.w})
    poses = [
        {"header": header, "pose": {"position": {"x": x, "y": y}, "orientation": turn}}
        for (x, y), turn in zip(places, turns, strict=False)
    ]
    return {"header": header, "poses": poses}
