"""Start one engine per robot, each in the namespace of its robot, and optionally a simulated world.

ros2 launch fame team.launch.py robots:="REX:car DINGO:car" world:=examples/ground_vehicles.yaml options:=--insecure
"""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

_ARGUMENTS = {
    "robots": (None, "robot names, optionally with types: REX:car DINGO:car"),
    "world": ("", "world file or scenario to simulate; all engines then use the time from /clock"),
    "use_sim_time": ("", "true: use the time from /clock without `world`, as with Gazebo"),
    "options": ("", "options for every engine, such as --trust team.pub"),
}


def generate_launch_description() -> LaunchDescription:
    """Return the description for `ros2 launch`."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in _ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Any]:
    arguments = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    simulated = bool(arguments["world"]) or arguments["use_sim_time"].lower() == "true"
    world = Node(package="fame", executable="world", arguments=[arguments["world"]], output="screen")
    return [
        *([world] if arguments["world"] else []),
        *(
            _engine(*robot.partition(":")[::2], arguments["options"].split(), simulated)
            for robot in arguments["robots"].split()
        ),
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
