"""The node of one robot: its engine, connected to middleware, scheduler and scripts.

node            the interface for others, from loading a process to its end
options         what it runs its process with
host            the host of the engine: messages, timers, scripts, events
mission         the process that a robot runs, with everything that it refers to
endpoints       publishers and subscriptions of its events and scripts; messages to one robot
acknowledged    signals that are sent until each receiver has acknowledged them; delivery_protocol: its decisions
scripts         the runner of its scripts, and the interface that they find
suspension      a person's suspension of the mission, and who steers the robot meanwhile
service_tasks   service tasks that call ROS services and actions
services        services that a task runs for as long as its scope lasts
timers          ISO 8601 timers on the scheduler
waiting_tokens  what its tokens wait for
events          events of a run, and observers of them
changes         what changes from instant to instant: events, variables, waiting tokens
robot_state     the state that these changes lead to
live            publishes these changes for views and recorders
clock_server    tells others the engine's time
plain_values    variables as plain data, for these changes

durable         durable execution: records, effects, resumption
restoring       gives a node the state of a journal or file, and lets it go on
journal         the file of these records; disk: the operations that it needs
state_tables    the state of an engine as data; stored_values: values of its variables
state_transfer  transfer the state of an old process to a new one
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.robot.events import Event as Event
    from fame.robot.mission import Mission as Mission, ServiceFunction as ServiceFunction, make_mission as make_mission
    from fame.robot.node import PendingStarts as PendingStarts, RobotNode as RobotNode
    from fame.robot.waiting_tokens import WaitingToken as WaitingToken
else:
    __getattr__, __dir__, __all__ = attach(__name__)
