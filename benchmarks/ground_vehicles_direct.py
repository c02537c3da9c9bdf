"""The ground-vehicle mission as one would write it by hand: coroutines on topics, and no engine.

The same behaviours with the same numbers as `models/ground_vehicles.bpmn` and the models that it calls, step by step,
so that `interpretation.py` compares two ways to run one mission and not two missions.
"""

from __future__ import annotations

import math
from collections.abc import Coroutine, Generator
from contextlib import suppress
from functools import partial
from types import coroutine
from typing import Any

import numpy

from fame.middleware import messages
from fame.middleware.interface import LATCHED, Node

AREA = 0.0, 6.0, 0.0, 4.0
"""x_min, x_max, y_min, y_max, m."""
SENSOR = 0.125
"""How far the range sensor is in front of the middle of the car, m."""
RADIUS = 0.08
"""Of the target, m."""
Point = tuple[float, float]
Wanted = tuple[str, ...]
Heard = tuple[str, Any]


class Unreachable(Exception):
    """There is no way."""


@coroutine
def hear(*topics: str) -> Generator[Wanted, Heard, Heard]:
    """The topic and the message that comes next on one of these topics."""
    return (yield topics)


@coroutine
def race(*others: Coroutine[Wanted, Heard, Any]) -> Generator[Wanted, Heard, None]:
    """All of them at once, until one is over; the others are then closed."""
    try:
        wanted = [other.send(None) for other in others]  # type: ignore[arg-type]
        while True:
            heard = yield sum(wanted, ())
            for number, other in enumerate(others):
                if heard[0] in wanted[number]:
                    wanted[number] = other.send(heard)
    except StopIteration:
        pass
    finally:
        for other in others:
            other.close()


class Car:
    """What both cars can do. `over` tells whether the mission of this one is."""

    def __init__(self, node: Node) -> None:
        self.node, self.over, self.map = node, False, messages.create("nav_msgs/msg/OccupancyGrid")
        self.twist = node.publisher("cmd_vel", "geometry_msgs/msg/Twist")
        self.goal = node.publisher("goal_pose", "geometry_msgs/msg/PoseStamped")
        for topic, type in (("odom", "nav_msgs/msg/Odometry"), ("range", "sensor_msgs/msg/Range"),
                            ("plan", "nav_msgs/msg/Path")):  # fmt: skip
            node.subscription(topic, type, partial(self.heard, topic))
        self.mission: Coroutine[Wanted, Heard, None] = self.work()
        self.wanted: Wanted = ()

    async def work(self) -> None:
        """The mission."""

    def start(self) -> None:
        self.wanted = self.mission.send(None)  # type: ignore[arg-type]

    def heard(self, topic: str, message: Any) -> None:
        """A message: whoever waits for it goes on."""
        if topic in self.wanted:
            try:
                self.wanted = self.mission.send((topic, message))
            except StopIteration:
                self.wanted, self.over = (), True

    def drive(self, speed: float = 0.0, turn: float = 0.0) -> None:
        self.twist.publish(messages.create("geometry_msgs/msg/Twist", {"linear": {"x": speed}, "angular": {"z": turn}}))

    async def plan(self, x: float, y: float) -> list[Point]:
        """Return the path; empty if the goal cannot be reached."""
        pose = {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}
        goal = {"header": {"frame_id": "map"}, "pose": pose}
        self.goal.publish(messages.create("geometry_msgs/msg/PoseStamped", goal))
        _, path = await hear("plan")
        return [(stamped.pose.position.x, stamped.pose.position.y) for stamped in path.poses[1:]]

    async def go_to(self, goal: Point) -> None:
        """Drive there, around what is on the map, and aside from what is not. Raises Unreachable."""
        evasions, via = 0, goal
        while True:
            waypoints = await self.plan(*via)
            if not waypoints and via == goal:
                raise Unreachable
            aside = await self.follow(waypoints, evasions) if waypoints else None
            if waypoints and aside is None:
                if via == goal:
                    break
                via = goal
                continue
            evasions += 1
            if evasions > 8:
                raise RuntimeError("blocked")
            via = aside or via
        self.drive()

    async def follow(self, waypoints: list[Point], evasions: int) -> Point | None:
        """Drive along. Gives the place to step aside to if something is in the way, None at the end."""
        stalled = 0
        while True:
            _, odom = await hear("odom")
            in_front = await self.in_front()
            x, y, course = place(odom)
            x_next, y_next = waypoints[0]
            to_end, to_waypoint = math.dist((x, y), waypoints[-1]), math.dist((x, y), (x_next, y_next))
            error = math.remainder(math.atan2(y_next - y, x_next - x) - course, math.tau)
            clear = max(0.05 * (to_end < 0.6), in_front - 0.2)
            speed = min(0.6, 2 * to_end, clear) * max(0, math.cos(error)) ** 4
            moving = abs(odom.twist.twist.linear.x) + abs(odom.twist.twist.angular.z)
            stalled = (stalled + 1) * (moving < 0.03)
            self.drive(speed, max(-1.5, min(1.5, 3 * error)))
            if to_end < 0.05 or (to_end < 0.5 and in_front < 0.05):
                return None
            if to_waypoint < 0.15 and len(waypoints) > 1:
                waypoints = waypoints[1:]
            elif stalled > 40 or (in_front < min(0.6, to_waypoint - 0.5) and abs(error) < 0.1):
                aside = course - 0.7 - 0.5 * (evasions + 1)
                return x + math.cos(aside), y + math.sin(aside)

    async def in_front(self) -> float:
        """The next range; RuntimeError after 2 s of silence, 40 times odometry."""
        for _ in range(40):
            topic, message = await hear("range", "odom")
            if topic == "range":
                distance: float = message.range
                return distance
        raise RuntimeError("sensor lost")

    async def turn(self, angle: float) -> None:
        """Turn on the spot (rad)."""
        _, odom = await hear("odom")
        bearing, turned = place(odom)[2], 0.0
        while True:
            self.drive(turn=math.copysign(1.2, angle))
            _, odom = await hear("odom")
            before, bearing = bearing, place(odom)[2]
            turned += math.remainder(bearing - before, math.tau)
            if abs(turned) >= abs(angle):
                self.drive()
                return


class Rex(Car):
    """Finds the target and tells where it is."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self.maps = node.publisher("map", "nav_msgs/msg/OccupancyGrid", LATCHED)
        self.found = node.publisher("/target_found", "geometry_msgs/msg/Vector3")
        node.subscription("map", "nav_msgs/msg/OccupancyGrid", self.take_map, LATCHED)
        node.subscription("/done", "std_msgs/msg/Bool", partial(self.heard, "/done"))
        self.target: Point = (0.0, 0.0)
        self.sightings: list[Point] = []

    def take_map(self, message: Any) -> None:
        self.map = message
        self.heard("map", message)

    async def work(self) -> None:
        await hear("map")
        cells = self.cells()
        self.obstacles = cells[numpy.reshape(self.map.data, cells.shape) > 50]
        _, odom = await hear("odom")
        home, views = place(odom)[:2], viewpoints()
        while not await self.locate_after(views):
            pass
        self.mark()
        await self.go_to(home)
        x, y = self.target
        self.found.publish(messages.create("geometry_msgs/msg/Vector3", {"x": x, "y": y}))
        await hear("/done")

    async def locate_after(self, views: list[Point]) -> bool:
        """Search until something is there, and come closer until it is clear where. False if it is nothing."""
        await race(self.look_around(views), self.detect())
        while True:
            near = await self.locate()
            if near is None:
                return False
            distance, place_near = near
            if distance <= 1.0:
                return inside(self.target)
            await self.go_to(place_near)

    async def look_around(self, views: list[Point]) -> None:
        while views:
            with suppress(Unreachable):
                await self.go_to(views.pop(0))
                await self.turn(6.3)
        raise RuntimeError("target not found")

    async def detect(self) -> None:
        """Until something unknown is in the area, seen three times in a row."""
        echoes = 0
        while echoes < 3:
            unexplained, distance, heading, here = await self.look()
            echo = here[0] + distance * math.cos(heading), here[1] + distance * math.sin(heading)
            if unexplained and inside(echo):
                echoes, self.target = echoes + 1, echo
            else:
                echoes = 0

    async def look(self) -> tuple[bool, float, float, Point]:
        """Whether the map does not explain the range; distance (m) and heading (rad) of the echo; from where."""
        _, odom = await hear("odom")
        _, measured = await hear("range")
        x, y, heading = place(odom)
        ahead = (self.obstacles - complex(x, y)) * numpy.exp(-1j * heading) - SENSOR
        beam = abs(ahead.imag) < 0.1 + math.tan(measured.field_of_view / 2) * ahead.real
        expected = abs(ahead[beam]).min(initial=measured.max_range)
        unexplained = bool(measured.min_range < measured.range < expected - 0.15)
        return unexplained, SENSOR + measured.range, heading, (x, y)

    async def locate(self) -> tuple[float, Point] | None:
        """Turn back and forth, and take the middle of what is seen: how far it is (m), and a place near it."""
        _, odom = await hear("odom")
        here = place(odom)[:2]
        expected = math.dist(here, self.target)
        for angle in (1.6, -6.3):
            self.sightings = []
            await race(self.turn(angle), self.watch(expected))
        if not self.sightings:
            return None
        nearest = min(distance for distance, _ in self.sightings)
        same = [(distance, bearing) for distance, bearing in self.sightings if distance < nearest + 0.1]
        sines, cosines = (sum(part(bearing) for _, bearing in same) for part in (math.sin, math.cos))
        bearing = math.atan2(sines, cosines)
        distance = sum(distance for distance, _ in same) / len(same) + RADIUS
        self.target = x, y = here[0] + distance * math.cos(bearing), here[1] + distance * math.sin(bearing)
        return distance, (x - 0.7 * math.cos(bearing), y - 0.7 * math.sin(bearing))

    async def watch(self, expected: float) -> None:
        """Note what is seen at about this distance, until it was passed."""
        while True:
            unexplained, distance, heading, _ = await self.look()
            if unexplained and abs(distance - expected) < 0.3:
                self.sightings.append((distance, heading))
            elif len(self.sightings) >= 3:
                return

    def cells(self) -> Any:
        """The middles of the cells of the map, as complex numbers, row by row."""
        info = self.map.info
        rows, columns = numpy.indices((info.height, info.width))
        corner = complex(info.origin.position.x, info.origin.position.y)
        return corner + info.resolution * (columns + 0.5 + 1j * (rows + 0.5))

    def mark(self) -> None:
        """Put the target on the map."""
        near = abs(self.cells() - complex(*self.target)).ravel() < 0.12
        data = numpy.where(near, 100, self.map.data).astype(numpy.int8)
        fields = {"header": {"frame_id": "map"}, "info": self.map.info, "data": data}
        self.maps.publish(messages.create("nav_msgs/msg/OccupancyGrid", fields))


class Dingo(Car):
    """Goes to the target and fires."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self.led = node.publisher("led", "std_msgs/msg/ColorRGBA")
        self.done = node.publisher("/done", "std_msgs/msg/Bool")
        node.subscription("/target_found", "geometry_msgs/msg/Vector3", partial(self.heard, "/target_found"))

    async def work(self) -> None:
        _, target = await hear("/target_found")
        await self.go_to((target.x, target.y))
        self.led.publish(messages.create("std_msgs/msg/ColorRGBA", {"r": 1.0}))
        self.done.publish(messages.create("std_msgs/msg/Bool", True))


def place(odom: Any) -> tuple[float, float, float]:
    """x, y (m), heading (rad)."""
    pose = odom.pose.pose
    return pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w)


def viewpoints() -> list[Point]:
    """Places 1.5 m apart at most, column by column, back and forth."""
    x_min, x_max, y_min, y_max = AREA
    columns = numpy.linspace(x_min, x_max, 2 * math.ceil((x_max - x_min) / 1.5) + 1)[1::2]
    rows = numpy.linspace(y_min, y_max, 2 * math.ceil((y_max - y_min) / 1.5) + 1)[1::2]
    return [(float(x), float(y)) for n, x in enumerate(columns) for y in rows[:: 1 - n % 2 * 2]]


def inside(point: Point) -> bool:
    x_min, x_max, y_min, y_max = AREA
    return x_min < point[0] < x_max and y_min < point[1] < y_max
