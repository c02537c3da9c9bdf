"""A team of engines, each in the namespace of its robot, and a simulated world if one is named.

ros2 launch fame team.launch.py robots:="REX:car DINGO:car" world:=examples/ground_vehicles.yaml options:=--insecure
"""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

_ARGUMENTS = {
    "robots": (None, "names, each with its type if it has one: REX:car DINGO:car"),
    "world": ("", "world file or scenario to simulate; the time of all is then that on /clock"),
    "use_sim_time": ("", "whether that is so without a world here, as with Gazebo: true"),
    "options": ("", "further options of every engine, such as --trust team.pub"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in _ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Any]:
    said = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    simulated = bool(said["world"]) or said["use_sim_time"].lower() == "true"
    world = Node(package="fame", executable="world", arguments=[said["world"]], output="screen")
    return [
        *([world] if said["world"] else []),
        *(_engine(*robot.partition(":")[::2], said["options"].split(), simulated) for robot in said["robots"].split()),
    ]


def _engine(robot: str, kind: str, options: list[str], simulated: bool) -> Node:
    return Node(
        package="fame",
        executable="engine",
        namespace=robot,
        arguments=[robot, *(["--type", kind] if kind else []), *options],
        parameters=[{"use_sim_time": simulated}],
        output="screen",
    )
