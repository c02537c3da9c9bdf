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

The package exports what a robot type of one's own is derived from or built of, `parameter` for its keys in a world
file, and `message_class` for what it publishes.
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.config.values import parameter as parameter
    from robots.drone import (
        Drone as Drone,
        DroneParameters as DroneParameters,
        Flight as Flight,
        FlightParameters as FlightParameters,
    )
    from robots.equipment import (
        Battery as Battery,
        BatteryParameters as BatteryParameters,
        Blade as Blade,
        BladeParameters as BladeParameters,
        Led as Led,
        Tray as Tray,
        TrayParameters as TrayParameters,
    )
    from robots.planner import (
        DirectPlanner as DirectPlanner,
        Planner as Planner,
        PlannerParameters as PlannerParameters,
    )
    from robots.sensors import (
        Camera as Camera,
        CameraParameters as CameraParameters,
        Odometer as Odometer,
        OdometerParameters as OdometerParameters,
        Ultrasonic as Ultrasonic,
        UltrasonicParameters as UltrasonicParameters,
        message_class as message_class,
    )
    from robots.vehicles import (
        BatteryVehicle as BatteryVehicle,
        Car as Car,
        Carrier as Carrier,
        CarrierParameters as CarrierParameters,
        Drive as Drive,
        DriveParameters as DriveParameters,
        Tractor as Tractor,
        TractorParameters as TractorParameters,
        Vehicle as Vehicle,
        VehicleParameters as VehicleParameters,
    )
else:
    __getattr__, __dir__, __all__ = attach(__name__)
