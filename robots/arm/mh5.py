"""The MH5 as a robot of the world: it cuts a part on command and publishes its joint states all the time.

In its namespace it subscribes to `cut` (cut one part, from home and back), `hold` (stop) and `program`: ``nominal``, or
a modification of `robots.arm.sabotage` and its size in mm, as in ``b 0.5``, for all parts from then on; other text is
ignored. It publishes `joint_states` at its rate, and `part_cut`, the number of the part, when a part is done. Every run
is different: another phase of sampling, some samples late, jitter of the encoders (`robots.arm.task`). An arm that was
held moves home first when it has to cut again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fame.config.values import parameter
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.imports import require
from fame.text import as_number
from robots.arm.sabotage import KINDS, alter, knots
from robots.arm.task import DEPTH, MH5, RETURN, TRIANGLE, cutting_run, movement, simulated
from robots.sensors import header_maker, message_class
from robots.vehicles import check_fault
from sim2d.robot import MEASUREMENT, Appearance, Pose, TopicCommand, Workpiece, body_of, period, rectangle

if TYPE_CHECKING:
    from fame.middleware.interface import AnyMessage
    from fame.monitor.arrays import Floats
    from sim2d.robot import RobotConfig, RobotWorld

JOINT_STATE, NUMBER, EMPTY, TEXT = (
    "sensor_msgs/msg/JointState", "std_msgs/msg/UInt32", "std_msgs/msg/Empty", "std_msgs/msg/String",
)  # fmt: skip
_NONE = np.zeros(0)
"""Velocities and efforts, which it does not measure."""
MODIFICATIONS = (*KINDS, "rotated")
SHEET = ((0.38, -0.1), (0.6, -0.1), (0.6, 0.1), (0.38, 0.1))
"""The sheet that parts are cut from, in the arm's frame, m."""


@dataclass(frozen=True, slots=True)
class CutterParameters:
    """The parameters of an MH5 in a world file."""

    rate: float = parameter(40.0, "Hz", above=0)
    base: float = parameter(0.3, "m, side of the base", above=0)
    mass: float = parameter(58.0, "kg", above=0)


class Cutter:
    """A robot of type ``mh5`` (`sim2d.robot.SimulatedRobot`)."""

    Parameters: ClassVar[type[Any]] = CutterParameters
    SAFE_STATE: ClassVar[tuple[TopicCommand, ...]] = (TopicCommand("hold", EMPTY, {}),)
    SAFE_SUSPENDED: ClassVar[tuple[TopicCommand, ...]] = SAFE_STATE
    FAULTS: ClassVar[tuple[str, ...]] = ("encoders",)

    def __init__(self, config: RobotConfig, world: RobotWorld) -> None:
        p: CutterParameters = config.parameters
        require("scipy")  # needed by its runs: fail before anything moves
        self.name, self.type = config.name, config.type
        self.outline = rectangle(p.base, p.base)
        self.body, _ = body_of(world.space, Pose(*config.at, config.heading), self.outline, p.mass)
        self.body.body_type = type(self.body).STATIC  # it is bolted to the floor
        self._pose = Pose(*config.at, config.heading)
        self._random = world.random(config.name, "encoders")
        self._every = period(p.rate, world.step)
        self._rate = 1 / (self._every * world.step)
        self._program = "nominal"
        self._angles: Floats = np.zeros(len(MH5.joints))
        self._ahead: deque[Floats] = deque()
        self._postures: list[Floats] = []
        self._cutting = self._silent = self._held = self._cut_off = False
        self.parts = self.spoiled = 0
        self._node = node = world.middleware.node("robot", config.name)
        self._joints = node.publisher("joint_states", JOINT_STATE, MEASUREMENT)
        self._cut = node.publisher("part_cut", NUMBER)
        self._state, self._number = message_class(JOINT_STATE), message_class(NUMBER)
        self._header, self._names = header_maker(config.name), list(MH5.joints)
        node.subscription("cut", EMPTY, lambda _: self._begin())
        node.subscription("hold", EMPTY, lambda _: self._hold())
        node.subscription("program", TEXT, self._change)

    @property
    def pose(self) -> Pose:
        return self._pose

    @property
    def appearance(self) -> Appearance:
        limb = [(x, y) for x, y, _ in MH5.skeleton(self._angles.tolist())]
        led = "red" if self._held else "off"
        return Appearance(self._pose, led=led, limb=limb, workpieces=self._workpieces(), note=self._note())

    def _workpieces(self) -> list[Workpiece]:
        """The sheet, and the cut so far or the finished part."""
        pieces = [Workpiece("fixture", SHEET)]
        if self._cut_off:
            return [*pieces, Workpiece("part", TRIANGLE.corners.tolist())]
        places = MH5.places(np.array(self._postures)) if self._postures else np.zeros((0, 3))
        cut = places[np.abs(places[:, 2] - TRIANGLE.height) < DEPTH, :2].tolist()
        return [*pieces, Workpiece("cut", cut, closed=False)] if len(cut) > 1 else pieces

    def _note(self) -> str:
        changed = "" if self._program == "nominal" else f", program {self._program}"
        if self._held:
            return f"held in part {self.parts + 1}"
        return f"cuts part {self.parts + 1}{changed}" if self._cutting else "stands"

    @property
    def tool(self) -> tuple[float, float]:
        """The true position of the tool in the world (m)."""
        x, y, _ = MH5.place(self._angles.tolist())
        cos, sin = math.cos(self._pose.heading), math.sin(self._pose.heading)
        return self._pose.x + cos * x - sin * y, self._pose.y + sin * x + cos * y

    @property
    def status(self) -> Mapping[str, Any]:
        """Parts begun with a modified program count as spoiled, finished or not."""
        return {"parts": self.parts, "spoiled": self.spoiled, "cutting": self._cutting, "program": self._program}

    def start(self) -> None:
        """Do nothing: an arm has no latched topics."""

    def move(self, now: int, duration: float) -> None:
        """Do nothing: the joints move in `sense`, sample by sample."""

    def sense(self, now: int, count: int) -> None:
        if count % self._every:
            return
        if self._ahead:
            self._angles = self._ahead.popleft()
            self._postures.append(self._angles)
        if not self._silent:
            self._joints.publish(self._state(self._header(now), self._names, self._angles, _NONE, _NONE))
        if self._cutting and not self._ahead:
            self._cutting, self._cut_off = False, True
            self.parts += 1
            self._cut.publish(self._number(self.parts))

    def fault(self, kind: str) -> None:
        """`encoders`: no more joint states."""
        check_fault(self.name, self.type, kind, self.FAULTS)
        self._silent = True

    def close(self) -> None:
        self._node.close()

    def _begin(self) -> None:
        if self._cutting:
            return
        if np.abs(self._angles).max() > 1e-3:  # rad: it was held on its way
            self._ahead.extend(movement(self._angles, np.zeros_like(self._angles), RETURN, self._rate))
        run = simulated(programmed(self._program, self._rate), self._random, MH5)
        self._ahead.extend(run)
        self._postures.clear()
        self._cutting, self._held, self._cut_off = True, False, False
        self.spoiled += self._program != "nominal"

    def _hold(self) -> None:
        self._ahead.clear()
        self._held |= self._cutting
        self._cutting = False

    def _change(self, message: AnyMessage) -> None:
        text = " ".join(message.data.split())
        try:
            programmed(text, self._rate)
        except ConfigError:  # an unknown program: the controller keeps the one that it has
            return
        self._program = text


@cache
def programmed(program: str, rate: float) -> Floats:
    """Return the run of a program (points, joints), rad. Raises ConfigError for an unknown program."""
    run = cutting_run(MH5, TRIANGLE, rate)
    if program == "nominal":
        return run
    kind, _, millimetres = program.partition(" ")
    amount = as_number(millimetres)
    if kind not in MODIFICATIONS or not 0 < amount < 20:
        raise ConfigError(f"expected nominal, or a kind of modification and mm, got {program!r}")
    return alter(run, knots(kind, amount)).values
