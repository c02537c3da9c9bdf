#!/usr/bin/env python3
"""Run the nodes that a robot in Gazebo lacks (see `robots.gazebo`): ``gazebo_robot.py REX --radius 0.2``."""

import argparse
import sys

from fame.cli.network import add_network
from fame.scenario import serve
from robots.gazebo import Supplement


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", help="name and namespace of the robot")
    parser.add_argument(
        "--radius", type=float, default=0.2, help="radius of a circle around the robot (m); 0 for a flying robot"
    )
    add_network(parser)  # type: ignore[arg-type]
    words = [*sys.argv[1:], "--ros-args"]  # which launch files append, with what follows
    arguments = parser.parse_args(words[: words.index("--ros-args")])
    serve(
        arguments.middleware,
        arguments.network,
        lambda scheduler, middleware: Supplement(middleware.node("gazebo_robot", arguments.robot), arguments.radius),
    )


if __name__ == "__main__":
    main()
