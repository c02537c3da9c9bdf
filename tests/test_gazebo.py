"""What a robot in Gazebo lacks is made from what it has."""

import math
import runpy
from pathlib import Path

import pytest
from middleware_contract import needs

from fame.clock import Scheduler
from fame.middleware import messages
from fame.middleware.interface import LATCHED, SENSOR_DATA
from fame.middleware.local import LocalMiddleware
from robots.gazebo import RANGE, SCAN, Supplement

ROOT = Path(__file__).parent.parent


@pytest.fixture
def made():
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    return scheduler, middleware.node("gazebo", "REX"), middleware


def test_the_nearest_point_of_a_scan_is_the_range(made):
    scheduler, gazebo, middleware = made
    Supplement(middleware.node("supplement", "REX"), 0.2)
    heard = []
    gazebo.subscription("range", RANGE, heard.append)
    scan = gazebo.publisher("scan", SCAN, SENSOR_DATA)
    limits = {"range_min": 0.1, "range_max": 4.0, "angle_min": -0.2, "angle_max": 0.2}
    for ranges in ([3.0, 1.5, 0.01, math.inf], [math.inf, math.nan], [], [2.0, -math.inf]):
        scan.publish(messages.create(SCAN, limits | {"ranges": ranges}))
    scheduler.run()
    assert [said.range for said in heard] == [1.5, math.inf, math.inf, -math.inf]
    assert (heard[0].field_of_view, heard[0].max_range) == (pytest.approx(0.4), 4.0)


@pytest.mark.parametrize("radius", [0.2, 0.0])
def test_the_planner_answers_a_goal(made, radius):
    scheduler, gazebo, middleware = made
    Supplement(middleware.node("supplement", "REX"), radius)
    plans = []
    gazebo.subscription("plan", "nav_msgs/msg/Path", plans.append)
    info = {"resolution": 0.1, "width": 50, "height": 50}
    empty = messages.create("nav_msgs/msg/OccupancyGrid", {"info": info, "data": [0] * 2500})
    gazebo.publisher("map", "nav_msgs/msg/OccupancyGrid", LATCHED).publish(empty)
    at = {"pose": {"pose": {"position": {"x": 1.0, "y": 1.0}}}}
    gazebo.publisher("odom", "nav_msgs/msg/Odometry").publish(messages.create("nav_msgs/msg/Odometry", at))
    scheduler.run()
    goal = messages.create("geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 4.0, "y": 3.0}}})
    gazebo.publisher("goal_pose", "geometry_msgs/msg/PoseStamped").publish(goal)
    scheduler.run()
    end = plans[-1].poses[-1].pose.position
    assert math.dist((end.x, end.y), (4.0, 3.0)) < 0.2


@needs("launch_ros")
@pytest.mark.ros
def test_the_launch_file_bridges_each_robot():
    from launch import LaunchContext

    made = runpy.run_path(str(ROOT / "launch" / "gazebo.launch.py"))
    context = LaunchContext()
    context.launch_configurations.update({"robots": "REX:car Drone:drone", "options": "", "radius": "0.2"})
    made["generate_launch_description"]()
    assert len(made["_nodes"](context)) == 6
