"""One robot's engine node: the world of an engine, made of a middleware node, a scheduler and scripts.

robot_node  the node: host of one engine
mission     what it is to do
addressed   messages for one robot
ends        its ends of topics: of events, and of what scripts name
scripts     the runner of its scripts, and what they have around them
asking      service tasks that ask ROS services and actions
timers      timers of ISO 8601 on the scheduler
waits       what its tokens wait for
gaps        publishers that left and came back meanwhile
"""

from __future__ import annotations

from fame.clock import EPOCH
from fame.robot.events import Event
from fame.robot.mission import Mission, Service, mission
from fame.robot.node import Ahead, RobotNode
from fame.robot.waiting_tokens import Wait
from fame.scripting import Log, error_text

__all__ = ["EPOCH", "Ahead", "Event", "Log", "Mission", "RobotNode", "Service", "Wait", "error_text", "mission"]
