"""The 2D physics world: bodies, obstacles, targets, their map, and drawings of a run.

`sim2d.world.World` is built from a checked `sim2d.config.WorldConfig` and run by the scheduler.
`sim2d.scene` describes it in recordings, `sim2d.record` reads these, and `sim2d.animation` draws films and pictures of
them. The robots themselves are in the package `robots`.
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from sim2d.animation import animate as animate, picture as picture
    from sim2d.config import WorldConfig as WorldConfig, read_world as read_world
    from sim2d.grid import place as place
    from sim2d.record import WorldRecord as WorldRecord, WorldRecorder as WorldRecorder
    from sim2d.robot import (
        MEASUREMENT as MEASUREMENT,
        Appearance as Appearance,
        Pose as Pose,
        RobotConfig as RobotConfig,
        RobotWorld as RobotWorld,
        SimulatedRobot as SimulatedRobot,
        TopicCommand as TopicCommand,
        period as period,
    )
    from sim2d.world import World as World
else:
    __getattr__, __dir__, __all__ = attach(__name__)
