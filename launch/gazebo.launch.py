"""Start a team of robots in Gazebo: the bridges, the nodes that Gazebo lacks, and the engines.

ros2 launch fame gazebo.launch.py robots:="REX:car DINGO:car" options:=--insecure
ros2 launch fame gazebo.launch.py robots:="Drone:drone Tractor_1:tractor Tractor_2:tractor" options:=--insecure

Start Gazebo first, with one model per robot that has the robot's name: DiffDrive (or MulticopterVelocityControl),
OdometryPublisher, and a lidar on the topic /model/NAME/scan.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

_ARGUMENTS = {
    "robots": (None, "robot names with their types: REX:car DINGO:car"),
    "options": ("", "options for every engine, such as --trust team.pub"),
    "radius": ("0.2", "radius of a circle around a ground robot (m)"),
}
_BRIDGED = {
    "cmd_vel": ("cmd_vel", "geometry_msgs/msg/Twist]gz.msgs.Twist"),
    "odometry": ("odom", "nav_msgs/msg/Odometry[gz.msgs.Odometry"),
    "scan": ("scan", "sensor_msgs/msg/LaserScan[gz.msgs.LaserScan"),
}
"""Topic of the Gazebo model -> topic of the robot, types and direction."""


def generate_launch_description() -> LaunchDescription:
    """Return the description for `ros2 launch`."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in _ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Any]:
    arguments = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    clock = ["/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock"]
    team = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(Path(__file__).with_name("team.launch.py"))),
        launch_arguments={
            "robots": arguments["robots"],
            "options": arguments["options"],
            "use_sim_time": "true",
        }.items(),
    )
    nodes: list[Any] = [Node(package="ros_gz_bridge", executable="parameter_bridge", name="clock", arguments=clock)]
    for robot in arguments["robots"].split():
        name, _, kind = robot.partition(":")
        nodes += [_bridge(name), _supplement(name, "0" if kind == "drone" else arguments["radius"])]
    return [*nodes, team]


def _bridge(robot: str) -> Node:
    return Node(
        package="ros_gz_bridge",
        executable="parameter_bridge",
        name="bridge",
        namespace=robot,
        arguments=[f"/model/{robot}/{topic}@{types}" for topic, (_, types) in _BRIDGED.items()],
        remappings=[(f"/model/{robot}/{topic}", f"/{robot}/{ours}") for topic, (ours, _) in _BRIDGED.items()],
    )


def _supplement(robot: str, radius: str) -> Node:
    return Node(
        package="fame",
        executable="gazebo_robot",
        arguments=[robot, "--radius", radius, "--middleware", "ros"],
        parameters=[{"use_sim_time": True}],
    )
