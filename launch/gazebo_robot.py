#!/usr/bin/env python3
"""A process with what a robot in Gazebo lacks (see `robots.gazebo`): ``gazebo_robot.py REX --radius 0.2``."""

import argparse
import sys

from fame.cli.network import add_network, without_ros_arguments
from fame.scenario import serve
from robots.gazebo import Supplement


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", help="its name and namespace")
    parser.add_argument("--radius", type=float, default=0.2, help="of a circle that it fits into (m); 0: it flies")
    add_network(parser)  # type: ignore[arg-type]
    said = parser.parse_args(without_ros_arguments(sys.argv[1:]))
    serve(
        said.middleware,
        said.network,
        lambda scheduler, middleware: Supplement(middleware.node("gazebo_robot", said.robot), said.radius),
    )


if __name__ == "__main__":
    main()
