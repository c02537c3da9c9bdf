"""Nav2 for simulated ground robots: the action servers of Nav2 on a node that uses only topics.

`navigate_to_pose`, `navigate_through_poses`, `follow_waypoints`, `dock_robot`, `undock_robot`, `spin`, `backup` and
`wait` have the interfaces of ROS 2 Jazzy, and the error codes of Nav2's planner, controller, behavior and docking
servers. The node subscribes to `map`, `odom`, `range` and `battery_state`, and publishes `cmd_vel`. One goal runs at a
time, as a maneuver of `robots.navigation`: a new goal replaces the current one, which is aborted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.actions import ActionServer, ServerGoal
from fame.middleware.interface import LATCHED, AnyMessage, Node
from robots import navigation as nav
from robots.navigation import STILL, Dock, Limits, Maneuver, Navigator, Velocity, goal_pose
from robots.planner import PlannerParameters
from sim2d.grid import from_message
from sim2d.robot import MEASUREMENT, Pose

_FEEDBACK = 0.5
"""s between two feedback messages."""


class Nav2:
    """Nav2 of one robot. `docks` is its dock database; with a battery, docking waits until that is charged."""

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        parameters: PlannerParameters,
        limits: Limits,
        docks: Mapping[str, Dock],
        *,
        battery: bool = False,
    ) -> None:
        self._scheduler = scheduler
        self._robot = Navigator(scheduler, parameters, limits, docks)
        self._robot.charging = not battery
        self._goal: ServerGoal | None = None
        self._maneuver: Maneuver | None = None
        self._begun = self._reported = 0
        self._result: Callable[[bool], Mapping[str, Any]] = lambda done: {}
        self._feedback: Callable[[], Mapping[str, Any]] = lambda: {}
        self._publisher = node.publisher("cmd_vel", "geometry_msgs/msg/Twist")
        node.subscription("map", "nav_msgs/msg/OccupancyGrid", self._on_map, LATCHED)
        node.subscription("odom", "nav_msgs/msg/Odometry", self._on_odometry, MEASUREMENT)
        node.subscription("range", "sensor_msgs/msg/Range", self._on_range, MEASUREMENT)
        if battery:
            node.subscription("battery_state", "sensor_msgs/msg/BatteryState", self._on_battery, MEASUREMENT)
        self._servers = [
            ActionServer(node, name, f"nav2_msgs/action/{type}", begin, self._cancel, accept)
            for name, type, begin, accept in (
                ("navigate_to_pose", "NavigateToPose", self._to_pose, lambda goal: _in_map([goal.pose])),
                ("navigate_through_poses", "NavigateThroughPoses", self._through, lambda goal: _in_map(goal.poses)),
                ("follow_waypoints", "FollowWaypoints", self._waypoints, lambda goal: _in_map(goal.poses)),
                ("dock_robot", "DockRobot", self._dock, lambda goal: goal.use_dock_id or _in_map([goal.dock_pose])),
                ("undock_robot", "UndockRobot", self._undock, lambda goal: True),
                ("spin", "Spin", self._spin_goal, lambda goal: math.isfinite(goal.target_yaw)),
                ("backup", "BackUp", self._back_up_goal, lambda goal: math.isfinite(goal.target.x + goal.speed)),
                ("wait", "Wait", self._wait_goal, lambda goal: True),
            )
        ]

    def _on_map(self, message: AnyMessage) -> None:
        self._robot.ground = from_message(message)

    def _on_range(self, message: AnyMessage) -> None:
        self._robot.on_range(message.range)

    def _on_battery(self, message: AnyMessage) -> None:
        self._robot.charging = message.power_supply_status in (1, 4)  # charging, full

    def _on_odometry(self, message: AnyMessage) -> None:
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        self._robot.pose = Pose(position.x, position.y, 2 * math.atan2(orientation.z, orientation.w))
        if self._maneuver is None or self._goal is None:
            return
        try:
            velocity = next(self._maneuver)
        except StopIteration as end:
            self._end("aborted" if end.value else "succeeded", end.value)
            return
        self._drive(velocity)
        if self._scheduler.now - self._reported >= _FEEDBACK * SECOND:
            self._reported = self._scheduler.now
            self._goal.feedback(self._feedback())

    def _drive(self, velocity: Velocity) -> None:
        fields = {"linear": {"x": velocity.ahead}, "angular": {"z": velocity.turn_rate}}
        self._publisher.publish(messages.create("geometry_msgs/msg/Twist", fields))

    def _begin(
        self,
        goal: ServerGoal,
        maneuver: Maneuver,
        feedback: Callable[[], Mapping[str, Any]],
        result: Callable[[bool], Mapping[str, Any]] | None = None,
    ) -> None:
        """Run a maneuver for a goal; a goal that runs already is aborted. `result` takes whether it has succeeded."""
        self._end("aborted", 0, "replaced by a new goal")
        self._goal, self._maneuver, self._feedback = goal, maneuver, feedback
        self._result = result or (lambda done: {})
        self._begun = self._reported = self._scheduler.now
        self._robot.recoveries, self._robot.unreached = 0, None

    def _end(self, outcome: Any, code: int, text: str = "") -> None:
        goal, self._goal, self._maneuver, self._robot.path = self._goal, None, None, ()
        if goal is not None:
            self._drive(STILL)
            goal.end(
                outcome,
                {**self._result(outcome == "succeeded"), "error_code": code, "error_msg": text or self._text(code)},
            )

    def _text(self, code: int) -> str:
        """What a person reads of an error code: where navigation failed, with the goal."""
        text, goal = _TEXTS.get(code, ""), self._robot.unreached
        if code == nav.GOAL_OUTSIDE and self._robot.ground is not None:
            text += f" ({self._robot.ground.extent})"
        return f"{text}: x={goal[0]:g} y={goal[1]:g}" if goal is not None and code in _NAVIGATION else text

    def _cancel(self, goal: ServerGoal) -> None:
        if goal is self._goal:
            self._end("canceled", 0)

    def _elapsed(self) -> dict[str, int]:
        return _duration(self._scheduler.now - self._begun)

    def _to_pose(self, goal: ServerGoal) -> None:
        self._begin(goal, self._robot.go_through([goal_pose(goal.message.pose)]), self._progress)

    def _through(self, goal: ServerGoal) -> None:
        remaining = list(map(goal_pose, goal.message.poses))
        feedback = lambda: {**self._progress(), "number_of_poses_remaining": len(remaining)}  # noqa: E731
        self._begin(goal, self._robot.go_through(remaining), feedback)

    def _waypoints(self, goal: ServerGoal) -> None:
        missed: list[dict[str, Any]] = []
        at = [0]
        maneuver = self._robot.follow(goal.message, missed, at)
        self._begin(goal, maneuver, lambda: {"current_waypoint": at[0]}, lambda done: {"missed_waypoints": missed})

    def _dock(self, goal: ServerGoal) -> None:
        message = goal.message
        dock = self._robot.docks.get(message.dock_id) if message.use_dock_id else Dock(*goal_pose(message.dock_pose))
        state = [1]
        feedback = lambda: {"state": state[0], "docking_time": self._elapsed()}  # noqa: E731
        maneuver = self._robot.go_to_dock(dock, message, state)
        self._begin(goal, maneuver, feedback, lambda done: {"success": done, "num_retries": 0})

    def _undock(self, goal: ServerGoal) -> None:
        self._begin(goal, self._robot.leave_dock(), dict, lambda done: {"success": done})

    def _spin_goal(self, goal: ServerGoal) -> None:
        turned = [0.0]
        maneuver = self._robot.spin(goal.message.target_yaw, _seconds(goal.message.time_allowance), turned)
        elapsed = lambda done: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        self._begin(goal, maneuver, lambda: {"angular_distance_traveled": turned[0]}, elapsed)

    def _back_up_goal(self, goal: ServerGoal) -> None:
        gone, message = [0.0], goal.message
        speed = 0.0 if message.target.y or message.target.z else abs(message.speed)  # it moves in x only
        maneuver = self._robot.back_up(abs(message.target.x), speed, _seconds(message.time_allowance), gone)
        elapsed = lambda done: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        self._begin(goal, maneuver, lambda: {"distance_traveled": gone[0]}, elapsed)

    def _wait_goal(self, goal: ServerGoal) -> None:
        until = self._scheduler.now + round(_seconds(goal.message.time) * SECOND)
        elapsed = lambda done: {"total_elapsed_time": self._elapsed()}  # noqa: E731
        left = lambda: {"time_left": _duration(max(0, until - self._scheduler.now))}  # noqa: E731
        self._begin(goal, self._robot.wait(_seconds(goal.message.time)), left, elapsed)

    def _progress(self) -> dict[str, Any]:
        """Feedback of navigation."""
        assert self._robot.pose is not None
        x, y, heading = self._robot.pose
        places = [(x, y), *self._robot.path]
        distance = sum(math.dist(a, b) for a, b in pairwise(places))
        turn = {"z": math.sin(heading / 2), "w": math.cos(heading / 2)}
        return {
            "current_pose": {
                "header": {"frame_id": "map"},
                "pose": {"position": {"x": x, "y": y}, "orientation": turn},
            },
            "navigation_time": self._elapsed(),
            "estimated_time_remaining": _duration(round(distance / self._robot.limits.speed * SECOND)),
            "number_of_recoveries": self._robot.recoveries,
            "distance_remaining": distance,
        }


def _in_map(poses: Sequence[AnyMessage]) -> bool:
    """Whether poses are finite and in the frame `map`, the only one known here."""
    return all(
        pose.header.frame_id.lstrip("/") == "map" and all(map(math.isfinite, (*goal_pose(pose),))) for pose in poses
    )


def _seconds(duration: AnyMessage) -> float:
    return float(duration.sec + duration.nanosec / SECOND)


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // SECOND, "nanosec": nanoseconds % SECOND}


_NAVIGATION = (nav.NO_PATH, nav.GOAL_OCCUPIED, nav.GOAL_OUTSIDE, nav.NO_PROGRESS)
_TEXTS = {
    nav.NO_PATH: "no valid path",
    nav.GOAL_OCCUPIED: "the goal is occupied",
    nav.GOAL_OUTSIDE: "the goal is outside of the map",
    nav.NO_PROGRESS: "failed to make progress",
    nav.NO_POSES: "no poses given",
    nav.SPIN_TIMEOUT: "the time allowance is over",
    nav.BACKUP_TIMEOUT: "the time allowance is over",
    nav.COLLISION: "collision ahead",
    nav.INVALID_INPUT: "expected a speed other than 0, and a target in x alone",
    nav.UNKNOWN_DOCK: "the dock is not in the database",
    nav.NO_STAGING: "failed to reach the staging pose",
    nav.NO_CONTROL: "failed to drive into or out of the dock",
    nav.NO_CHARGE: "the battery is not charging",
    nav.NOT_DOCKED: "the robot is not docked",
    nav.WAYPOINT_FAILED: "no waypoint was reached",
    nav.NO_WAYPOINTS: "no waypoints given",
}
