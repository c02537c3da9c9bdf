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
