"""The UR5e as a robot of the world: it handles the lid of a motor and follows trajectories.

In its namespace it subscribes to `joint_trajectory` (trajectory_msgs/msg/JointTrajectory: positions of all joints at
increasing times from now; without points it stops) and offers the service `gripper` (std_srvs/srv/SetBool: shut or
open; `success` says whether the lid is held then). It publishes `joint_states` with efforts, and on
`trajectory_refused` (std_msgs/msg/String) why it does not follow a trajectory.

Its digital twin, a node of its own, answers each `goal_pose` (geometry_msgs/msg/PoseStamped: position of the fingertips
in the frame of the arm's base; the orientation is kept) with the `joint_trajectory` of a straight line, or an empty one
if the position is out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fame.clock import SECOND, Entry, Scheduler
from fame.config.values import Point, parameter
from fame.dataclasses import dataclass
from fame.errors import MissionError
from fame.imports import require
from fame.middleware import messages
from robots.arm.bench import MOTOR, TABLE, Bench
from robots.arm.dynamics import HOME, UR5E
from robots.arm.kinematics import straight
from robots.arm.machine import TYPICAL, ControlledArm, Generators, PlanningTime, RunVariation
from robots.sensors import header_maker, message_class
from robots.vehicles import check_fault
from sim2d.ground import disc
from sim2d.robot import MEASUREMENT, Appearance, Pose, TopicCommand, Workpiece, body_of, period, rectangle

if TYPE_CHECKING:
    from fame.middleware.interface import AnyMessage, Node
    from fame.monitor.arrays import Floats
    from sim2d.robot import RobotConfig, RobotWorld

JOINT_STATE, TRAJECTORY = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"
FASTEST = math.pi
"""Maximum speed of any joint, rad/s (data sheet)."""
JAWS = {"open": 0.09, "holding": 0.04, "slipping": 0.02, "shut": 0.0}
"""Opening of the gripper, m."""


@dataclass(frozen=True, slots=True)
class HandlerParameters:
    """The parameters of a UR5e in a world file."""

    rate: float = parameter(500.0, "Hz", above=0)
    base: float = parameter(0.15, "m, side of the base", above=0)
    mass: float = parameter(20.6, "kg", above=0)
    bench: bool = parameter(True, "(the arm stands at a motor with a lid, beside a table)")
    variation: RunVariation = TYPICAL


class UR5e:
    """A robot of type ``ur5e`` (`sim2d.robot.SimulatedRobot`)."""

    Parameters: ClassVar[type[Any]] = HandlerParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (TopicCommand("joint_trajectory", TRAJECTORY, {}),)
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE
    FAULTS: ClassVar[tuple[str, ...]] = ("blocked_shoulder", "blocked_lid", "encoders")

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        p: HandlerParameters = config.parameters
        require("scipy")  # needed by its motions: fail before anything moves
        self.name, self.type = config.name, config.type
        self.outline = rectangle(p.base, p.base)
        self._pose = Pose(*config.at, config.heading)
        self.body, _ = body_of(world.space, self._pose, self.outline, p.mass)
        self.body.body_type = type(self.body).STATIC  # it is bolted to the table
        self._every = period(p.rate, world.step)
        generators = Generators(*(world.random(config.name, name) for name in Generators._fields))
        self.machine = ControlledArm(UR5E, HOME, self._every * world.step, generators, p.variation)
        if not p.bench:
            self._bench.lid = "none"
        self._silent = self._stopped = False
        self._dropped: Point = (0.0, 0.0)
        self._node = node = world.middleware.node("robot", config.name)
        self._joints = node.publisher("joint_states", JOINT_STATE, MEASUREMENT)
        self._refused = node.publisher("trajectory_refused", "std_msgs/msg/String")
        self._state, self._header = message_class(JOINT_STATE), header_maker(config.name)
        self._names = list(UR5E.chain.joints)
        node.subscription("joint_trajectory", TRAJECTORY, self._follow)
        node.service("gripper", "std_srvs/srv/SetBool", self._grip)
        self._twin_node = world.middleware.node("twin", config.name)
        self._twin = Twin(self._twin_node, world.scheduler, PlanningTime(p.variation, generators.planning))

    @property
    def pose(self) -> Pose:
        return self._pose

    @property
    def appearance(self) -> Appearance:
        places = UR5E.chain.skeleton(self.machine.state.positions)
        limb = [(x, y) for x, y, _ in places]
        return Appearance(
            self._pose,
            led="red" if self._stopped else "off",
            limb=limb,
            jaws=JAWS[self._bench.jaws],
            workpieces=self._workpieces(limb[-1]),
            note=self._note(places[-1][2]),
        )

    def _workpieces(self, tool: Point) -> list[Workpiece]:
        """The motor, the place on the table, and the lid on either, between the jaws, or where it fell."""
        if self._bench.lid == "none":
            return []
        motor, table = ((float(place[0]), float(place[1])) for place in (MOTOR, TABLE))
        lid = {"motor": motor, "table": table, "jaws": tool}.get(self._bench.lid, self._dropped)
        fixtures = [Workpiece("fixture", disc(place, 0.085)) for place in (motor, table)]
        return [*fixtures, Workpiece("part", disc(lid, 0.065))]

    def _note(self, height: float) -> str:
        """What the arm does, and the height (m) of its fingertips, which a view from above does not show."""
        doing = "stopped on its way" if self._stopped else "moves" if self.machine.moving else "stands"
        held = ", holds the lid" if self._bench.load else ""
        return f"{'is pushed' if self.machine.push is not None else doing}{held}, {height:.2f} m up"

    @property
    def status(self) -> Mapping[str, Any]:
        return {"lid": self._bench.lid, "gripper": self._bench.jaws, "moving": self.machine.moving}

    @property
    def _bench(self) -> Bench:
        assert self.machine.bench is not None
        return self.machine.bench

    def start(self) -> None:
        """Do nothing: an arm has no latched topics."""

    def move(self, now: int, duration: float) -> None:
        """Do nothing: the joints move in `sense`, cycle by cycle."""

    def sense(self, now: int, count: int) -> None:
        if count == 0 or count % self._every:
            return
        state = self.machine.step()
        if not self._silent:
            self._joints.publish(self._state(self._header(now), self._names, *map(np.array, state)))

    def fault(self, kind: str) -> None:
        """`blocked_shoulder`: a person pushes joint 0, then blocks it, for some seconds; `blocked_lid`: a person holds
        the lid on the motor until the gripper slips off; `encoders`: no more joint states."""
        known = tuple(one for one in self.FAULTS if one != "blocked_lid" or self._bench.lid != "none")
        check_fault(self.name, self.type, kind, known)
        if kind == "blocked_shoulder":
            self.machine.obstruct_shoulder()
        elif kind == "blocked_lid":
            self.machine.hold_lid()
        else:
            self._silent = True

    def close(self) -> None:
        self._twin.close()
        self._node.close()

    def _grip(self, request: AnyMessage) -> Mapping[str, Any]:
        held = self.machine.grip(request.data)
        self._dropped = UR5E.chain.place(self.machine.state.positions)[:2]
        return {"success": held or not request.data, "message": "holds the lid" if held else "empty"}

    def _follow(self, message: AnyMessage) -> None:
        if not message.points:
            self._stopped |= self.machine.moving
            self.machine.hold()
            return
        try:
            times, positions = points(message, self._names)
            check_speed(times, positions, self.machine.reference[0])
        except MissionError as error:
            self._refused.publish(messages.create("std_msgs/msg/String", {"data": error.text}))
            return
        self._stopped = False
        self.machine.follow(times, positions)


class Twin:
    """The node of the digital twin.

    It plans from its own posture, the end of its last trajectory, because forces on the arm deflect the measured one;
    from the measured one if they are more than `APART` from each other, as after a stop. A trajectory of another node
    ends the planning of its own.
    """

    APART = 0.05
    """rad"""

    def __init__(self, node: Node, scheduler: Scheduler, planning: PlanningTime) -> None:
        self._node, self._scheduler, self._planning = node, scheduler, planning
        self._posture = self._measured = HOME
        self._pending: Entry | None = None
        self._trajectory = node.publisher("joint_trajectory", TRAJECTORY)
        node.subscription("joint_states", JOINT_STATE, self._on_state, MEASUREMENT)
        node.subscription("goal_pose", "geometry_msgs/msg/PoseStamped", self._on_goal)
        node.subscription("joint_trajectory", TRAJECTORY, lambda message: self._cancel())

    def close(self) -> None:
        self._cancel()
        self._node.close()

    def _cancel(self) -> None:
        if self._pending is not None:
            self._pending.cancel()

    def _on_state(self, message: AnyMessage) -> None:
        self._measured = np.array(message.position)

    def _on_goal(self, message: AnyMessage) -> None:
        at = message.pose.position
        place = np.array([at.x, at.y, at.z])
        try:
            if not np.isfinite(place).all():
                raise MissionError("expected a finite position")
            apart = np.abs(self._posture - self._measured).max() > self.APART
            way = straight(UR5E.chain, self._measured if apart else self._posture, place)
        except MissionError:
            answer = messages.create(TRAJECTORY, {})
        else:
            self._posture = way.positions[-1]
            answer = trajectory(way.times, way.positions)
        self._cancel()
        self._pending = self._scheduler.after(self._planning.draw(), partial(self._trajectory.publish, answer))


def trajectory(times: Floats, positions: Floats) -> AnyMessage:
    """Make a trajectory_msgs/msg/JointTrajectory of the UR5e."""
    points = [
        {"positions": row, "time_from_start": {"sec": time // SECOND, "nanosec": time % SECOND}}
        for row, time in zip(positions.tolist(), np.rint(times * SECOND).astype(int).tolist(), strict=True)
    ]
    return messages.create(TRAJECTORY, {"joint_names": UR5E.chain.joints, "points": points})


def points(message: AnyMessage, joints: list[str]) -> tuple[Floats, Floats]:
    """Read times (points,), s, and positions (points, joints), rad, in the arm's order. Raises MissionError."""
    names = list(message.joint_names)
    if sorted(names) != sorted(joints):
        raise MissionError(f"expected the joints {', '.join(joints)}, got {', '.join(names) or 'none'}")
    order = [names.index(joint) for joint in joints]
    for number, point in enumerate(message.points):
        if len(point.positions) != len(joints):
            raise MissionError(f"expected {len(joints)} positions in point {number}, got {len(point.positions)}")
    times = np.array([p.time_from_start.sec + p.time_from_start.nanosec / SECOND for p in message.points])
    positions = np.array([list(point.positions) for point in message.points])[:, order]
    if not np.isfinite(positions).all():
        raise MissionError("expected finite positions")
    if times[0] <= 0 or (np.diff(times) <= 0).any():
        raise MissionError(f"expected positive, increasing times of the points, got {times.tolist()}")
    return times, positions


def check_speed(times: Floats, positions: Floats, here: Floats) -> None:
    """Raise MissionError if a joint's mean speed between two points is too high."""
    steps = np.abs(np.diff(np.vstack([here, positions]), axis=0)) / np.diff(times, prepend=0.0)[:, None]
    if steps.max() > FASTEST:
        joint = UR5E.chain.joints[int(steps.max(axis=0).argmax())]
        raise MissionError(f"expected at most {FASTEST:.1f} rad/s, got {steps.max():.1f} rad/s for {joint}")
