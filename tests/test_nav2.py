"""Nav2 in the simulated world: the action servers of a robot with `navigation: nav2`."""

import math
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from grounds import ground

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.middleware.actions import ActionClient
from robots.navigation import Limits, Navigator
from robots.planner import PlannerParameters
from sim2d.grid import Grid
from sim2d.robot import Pose

WALL = {"name": "wall", "at": [3, 1.2], "size": [0.2, 2.4]}


def pose(x: float, y: float, yaw: float = 0.0, frame: str = "map") -> dict[str, Any]:
    turn = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}, "orientation": turn}}


class Robot:
    """REX with Nav2. `act` sends a goal and runs until its end, or until the simulated `limit` (s)."""

    def __init__(self, **changes: Any) -> None:
        rex = {"navigation": "nav2", "planner": {"tolerance": 0.1}, **changes.pop("rex", {})}
        self.ground = ground(rex=rex, resolution=0.1, **changes)
        self.node = self.ground.middleware.node("test", "REX")
        self.feedback: list[Any] = []
        self.ended: list[tuple[str, Any]] = []
        self.run(0.2)

    def run(self, seconds: float) -> None:
        self.ground.run(self.ground.scheduler.now / SECOND + seconds)

    def begin(self, name: str, type: str, **goal: Any) -> Any:
        client = ActionClient(self.node, name, f"nav2_msgs/action/{type}")
        self.ended = ended = []
        return client.send(goal, lambda outcome, result: ended.append((outcome, result)), self.feedback.append)

    def act(self, name: str, type: str, *, limit: float = 120, **goal: Any) -> tuple[str, Any]:
        self.begin(name, type, **goal)
        for _ in range(round(limit * 10)):
            self.run(0.1)
            if self.ended:
                break
        (end,) = self.ended
        return end

    @property
    def place(self) -> tuple[float, float]:
        return self.ground.world.robots["REX"].pose[:2]


def test_it_drives_around_an_obstacle_to_a_pose_and_reports_its_progress() -> None:
    robot = Robot(obstacles=[WALL])
    outcome, result = robot.act("navigate_to_pose", "NavigateToPose", pose=pose(5, 1, 1.57))
    assert (outcome, result.error_code) == ("succeeded", 0)
    assert math.dist(robot.place, (5, 1)) < 0.15
    assert abs(robot.ground.world.robots["REX"].pose.heading - 1.57) < 0.15
    distances = [feedback.distance_remaining for feedback in robot.feedback]
    assert distances[0] > math.dist((1, 2), (5, 1))  # around the wall
    assert distances[-1] < 0.5
    assert robot.ground.world.collisions == []


def test_it_passes_poses_in_order() -> None:
    robot = Robot()
    robot.begin("navigate_through_poses", "NavigateThroughPoses", poses=[pose(3, 3.3), pose(5, 2)])
    highest = 0.0
    while not robot.ended:
        robot.run(0.1)
        highest = max(highest, robot.place[1])
    assert robot.ended[0][0] == "succeeded"
    assert highest > 3
    assert {feedback.number_of_poses_remaining for feedback in robot.feedback} == {1, 2}


def test_it_follows_waypoints_and_names_the_missed_ones() -> None:
    robot = Robot(obstacles=[WALL])
    outcome, result = robot.act("follow_waypoints", "FollowWaypoints", poses=[pose(3, 1), pose(2, 3)])
    assert outcome == "succeeded"
    assert [(missed.index, missed.error_code) for missed in result.missed_waypoints] == [(0, 206)]
    assert math.dist(robot.place, (2, 3)) < 0.15


@pytest.mark.parametrize(
    ("goal", "end"),
    [(pose(3, 1), ("aborted", 206)), (pose(40, 1), ("aborted", 204)), (pose(5, 1, frame="odom"), ("rejected", None))],
    ids=["occupied", "outside of the map", "in an unknown frame"],
)
def test_goals_that_cannot_be_reached_end_with_nav2_s_codes(goal: Any, end: tuple[str, int | None]) -> None:
    outcome, result = Robot(obstacles=[WALL]).act("navigate_to_pose", "NavigateToPose", pose=goal)
    assert (outcome, result and result.error_code) == end


def test_of_several_loops_only_the_first_begins_with_a_later_waypoint() -> None:
    poses = [pose(1, 1), pose(50, 1)]
    outcome, result = Robot().act("follow_waypoints", "FollowWaypoints", poses=poses, number_of_loops=1)
    assert (outcome, result.error_code, [one.index for one in result.missed_waypoints]) == ("succeeded", 0, [1, 1])
    robot = Robot()
    outcome, result = robot.act("follow_waypoints", "FollowWaypoints", poses=poses, goal_index=1)
    assert (outcome, result.error_code, result.error_msg) == ("aborted", 600, "no waypoint was reached")
    poses[1] = pose(1.5, 1)
    assert robot.act("follow_waypoints", "FollowWaypoints", poses=poses, goal_index=1, number_of_loops=1)[1] is not None
    assert [index for index, _ in groupby(robot.feedback, lambda said: said.current_waypoint)][-3:] == [1, 0, 1]


@pytest.mark.parametrize("goal", [{"poses": []}, {"poses": [pose(1, 1)], "goal_index": 1}])
def test_no_waypoint_is_no_success(goal: dict[str, Any]) -> None:
    outcome, result = Robot().act("follow_waypoints", "FollowWaypoints", **goal)
    assert (outcome, result.error_code, result.error_msg) == ("aborted", 602, "no waypoints given")


def test_it_backs_up_only_as_far_as_it_is_told_and_knows_the_ground() -> None:
    robot = Robot()
    for goal in ({"target": {"x": math.nan}, "speed": 0.1}, {"target": {"x": 1.0}, "speed": math.inf}):
        assert robot.act("backup", "BackUp", **goal)[0] == "rejected"
    outcome, result = robot.act("backup", "BackUp", target={"y": 1.0}, speed=0.1)
    assert (outcome, result.error_code) == ("aborted", 713)
    navigator = Navigator(robot.ground.scheduler, PlannerParameters(), Limits(0.5, 1.0, 1.0, 0.3, 0.2), {})
    navigator.ground = Grid(np.zeros((10, 10), dtype=np.bool_), 0.1, (0.0, 0.0))
    for navigator.pose in (Pose(0.2, 0.5, 0.0), Pose(0.8, 0.5, math.pi)):
        assert list(navigator.back_up(1.0, 0.1, 0.0, [0.0])) == []  # at once: what is behind it is not on the map


def test_a_goal_outside_the_map_is_told_with_the_map() -> None:
    _, result = Robot().act("navigate_to_pose", "NavigateToPose", pose=pose(40, 1))
    assert result.error_msg == "the goal is outside of the map (x -0.1 to 6.1 m, y -0.1 to 4.1 m): x=40 y=1"


def test_it_recovers_and_aborts_where_something_unknown_stands_on_the_goal() -> None:
    robot = Robot(targets=[{"name": "crate", "at": [4.5, 2], "size": [0.8, 0.8]}])
    outcome, result = robot.act("navigate_to_pose", "NavigateToPose", limit=300, pose=pose(4.5, 2))
    assert (outcome, result.error_msg) == ("aborted", "no valid path: x=4.5 y=2")
    assert robot.feedback[-1].number_of_recoveries == 6


def test_it_drives_around_something_that_is_not_on_the_map() -> None:
    robot = Robot(targets=[{"name": "crate", "at": [3, 2], "radius": 0.2}])
    outcome, _ = robot.act("navigate_to_pose", "NavigateToPose", pose=pose(5, 2))
    assert outcome == "succeeded"
    assert robot.ground.world.collisions == []


def test_a_cancelled_goal_stops_the_robot() -> None:
    robot = Robot()
    goal = robot.begin("navigate_to_pose", "NavigateToPose", pose=pose(5, 2))
    robot.run(2)
    goal.cancel()
    robot.run(1)
    place = robot.place
    robot.run(1)
    assert place[0] < 4
    assert math.dist(robot.place, place) < 0.01


def test_a_new_goal_replaces_the_current_one() -> None:
    robot = Robot()
    robot.begin("navigate_to_pose", "NavigateToPose", pose=pose(5, 2))
    first = robot.ended
    robot.run(1)
    assert robot.act("navigate_to_pose", "NavigateToPose", pose=pose(2, 3))[0] == "succeeded"
    assert [outcome for outcome, _ in first] == ["aborted"]
    assert math.dist(robot.place, (2, 3)) < 0.15


def test_a_dock_that_is_not_reached_is_no_success() -> None:
    robot = Robot()
    for name, type, goal in (
        ("dock_robot", "DockRobot", {"use_dock_id": False, "dock_pose": pose(5, 3)}),
        ("undock_robot", "UndockRobot", {}),
    ):
        robot.begin(name, type, **goal)
        first = robot.ended
        robot.begin("wait", "Wait", time={"sec": 1})
        robot.run(0.5)
        ((outcome, result),) = first
        assert (outcome, result.success, result.error_msg) == ("aborted", False, "replaced by a new goal")


def test_it_spins_backs_up_and_waits() -> None:
    robot = Robot()
    begun = robot.ground.scheduler.now
    assert robot.act("spin", "Spin", target_yaw=1.57, time_allowance={"sec": 9})[0] == "succeeded"
    assert abs(robot.ground.world.robots["REX"].pose.heading - 1.57) < 0.2
    assert robot.act("backup", "BackUp", target={"x": 0.4}, speed=0.2, time_allowance={"sec": 9})[0] == "succeeded"
    assert abs(robot.place[1] - 1.6) < 0.1
    _, result = robot.act("wait", "Wait", time={"sec": 2})
    assert result.total_elapsed_time.sec == 2
    assert robot.ground.scheduler.now - begun > 4 * SECOND
    outcome, result = robot.act("spin", "Spin", target_yaw=3.0, time_allowance={"nanosec": 100_000_000})
    assert (outcome, result.error_code) == ("aborted", 701)


def test_it_docks_at_a_charger_until_its_battery_charges_and_undocks() -> None:
    charger = {"name": "dock_1", "at": [0.7, 3.2], "heading": 90}
    robot = Robot(chargers=[charger], rex={"type": "tractor", "battery": {"charge": 0.5}})
    assert robot.act("undock_robot", "UndockRobot")[1].error_code == 902
    assert robot.act("dock_robot", "DockRobot", dock_id="dock_9")[1].error_code == 901
    outcome, result = robot.act("dock_robot", "DockRobot", dock_id="dock_1")
    assert (outcome, result.success) == ("succeeded", True)
    assert math.dist(robot.place, (0.7, 3.2)) < 0.15
    assert robot.act("undock_robot", "UndockRobot")[1].success
    assert math.dist(robot.place, (0.7, 3.2)) > 0.5


def test_navigation_is_the_planner_or_nav2() -> None:
    with pytest.raises(ConfigError, match=r"robots\.REX\.navigation: expected one of planner, nav2, got 'nav3'"):
        ground(rex={"navigation": "nav3"})
