"""The robots that come with FAME: their topics, and how they move.

Each type is a class with the members of `sim2d.robot.SimulatedRobot`; a world file names it by `type:`.

    vehicles   car, tractor and carrier
    drone      a quadrotor
    arm        two arms, the MH5 and the UR5e
    planner    path planners of vehicles and drone
    navigation maneuvers of vehicles: follow a path, recover, dock
    nav2       the action servers of Nav2, for vehicles
    twist_mux  the mission's commands, or those of a person who steers
    sensors    range sensor, camera, odometry
    equipment  battery, blade, tray, LED
    gazebo     topics that robots in Gazebo lack
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from robots.drone import Drone as Drone
    from robots.vehicles import (
        Car as Car,
        Tractor as Tractor,
        Vehicle as Vehicle,
        VehicleParameters as VehicleParameters,
    )

__getattr__, __dir__, __all__ = attach(__name__)
