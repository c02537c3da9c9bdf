"""The bench of the reassembly: a motor with a lid on it, a place on the table, and the forces on the fingertips.

Places are in the frame of the arm's base (m); the height of a lid is that of the fingertips that first gripped it.
The program comes from a digital twin with two errors, which alone cause the contact force when the lid is put back:

- the table is `gap` lower than in the twin. The lid falls by it when it is released there, is gripped that much higher
  at its knob, and is finally pressed onto the motor by the same distance;
- the motor's axis is displaced, roughly along the arm's reach. The jaws centre the lid as soon as it is free, so it
  touches the bevel of the rim when it is put back: the force is tilted by `BEVEL`.

Every contact is a spring with a damper along one normal, up to a force at which something yields. A person who holds
the lid down is a spring too, which the jaws follow until they slip off the knob. From then on they are shut and empty,
and the fingers, which reach `DEPTH` below the top of the knob, hit its bevelled top when the lid should be put back.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.dynamics import GRAVITY

MOTOR, TABLE = np.array([0.5, 0.0, 0.18]), np.array([0.32, -0.38, 0.05])
"""Where the lid is gripped, according to the twin."""
NEAR = 0.05
LID = 0.5
"""kg"""
STIFFNESS, DAMPING = 4e4, 300.0
"""Contact of printed parts: N/m, N s/m."""
BEVEL = math.radians(30)
DEPTH = 0.015
HAND = 5e3
"""Stiffness of a person's arm that holds the lid down, N/m."""
SLIDING = 0.6
"""Friction of slipping jaws relative to static friction."""


class Bench:
    """The state of the bench. `random` draws what varies from run to run. `held_down`: a person holds the lid down.

    With the `lid` "none" there are neither a lid nor a motor.
    """

    def __init__(self, random: np.random.Generator, payload: float = 0.0) -> None:
        """`payload` is the relative deviation of the lid's mass."""
        self.gap = random.normal(1.2e-3, 0.1e-3)
        bearing = math.atan2(MOTOR[1], MOTOR[0]) + random.normal(0.0, math.radians(3))
        self.grip_force, self.yields = random.normal(35.0, 3.0), random.normal(100.0, 5.0)
        self._mass = LID * random.normal(1.0, payload)
        self._bevel = -math.sin(BEVEL) * np.array([math.cos(bearing), math.sin(bearing), 0.0])
        self._bevel[2] = math.cos(BEVEL)
        self.lid: Literal["motor", "table", "jaws", "floor", "none"] = "motor"
        self.jaws: Literal["open", "holding", "slipping", "shut"] = "open"
        self.held_down = False
        self._hang = 0.0
        self._freed = False

    @property
    def load(self) -> float:
        """The mass that the arm carries, kg."""
        return self._mass if self.jaws == "holding" else 0.0

    def grip(self, shut: bool, place: Floats) -> bool:
        """Shut or open the jaws at a place; return whether they hold the lid then."""
        if shut and self.jaws == "open":
            height = {"motor": MOTOR[2], "table": TABLE[2] - self.gap}.get(self.lid)
            there = MOTOR if self.lid == "motor" else TABLE
            self.jaws = "shut"
            if height is not None and _near(place, there) and abs(place[2] - height) < DEPTH:
                self.jaws, self.lid, self._hang = "holding", "jaws", float(place[2] - height)
        elif not shut:
            if self.jaws == "holding":
                self.lid = "motor" if _near(place, MOTOR) else "table" if _near(place, TABLE) else "floor"
            self.jaws = "open"
        return self.jaws == "holding"

    def touches(self, x: float, y: float, z: float) -> bool:
        """Return whether there may be a force at a place: a cheap, conservative test."""
        if self.jaws == "open" or (self.jaws == "shut" and self.lid != "motor"):
            return False
        return z < max(MOTOR[2], TABLE[2]) + DEPTH + 0.01 or self.held_down

    def force(self, place: Floats, velocity: Floats) -> Floats:
        """Return the force on the fingertips (3,), N. The jaws may slip."""
        if self.jaws == "slipping" and place[2] - MOTOR[2] > DEPTH:
            self.jaws = "shut"  # off the knob
        if self.jaws == "slipping":
            return np.array([0.0, 0.0, -SLIDING * self.grip_force])
        if self.jaws == "shut" and self.lid == "motor" and _near(place, MOTOR):
            return self._pressed(np.add(MOTOR, (0.0, 0.0, DEPTH)), place, velocity, self._bevel)
        if self.jaws == "holding":
            return self._resting(place, velocity)
        return np.zeros(3)

    def _resting(self, place: Floats, velocity: Floats) -> Floats:
        """The force of the lid's support, or of the person who holds it."""
        on_motor = _near(place, MOTOR)
        low = place - [0.0, 0.0, self._hang]
        if self.held_down and on_motor and not self._freed:
            pull = HAND * (low[2] - MOTOR[2])
            if pull > self.grip_force:
                self.jaws, self.lid, self.held_down = "slipping", "motor", False
            return np.array([0.0, 0.0, -pull])
        support = MOTOR if on_motor else TABLE - [0.0, 0.0, self.gap]
        normal = self._bevel if on_motor and self._freed else np.array([0.0, 0.0, 1.0])
        rest = self._mass * GRAVITY / STIFFNESS * normal if not self._freed else 0.0
        self._freed |= bool(low[2] > support[2] + 0.002)
        return self._pressed(support + rest, low, velocity, normal)

    def _pressed(self, surface: Floats, place: Floats, velocity: Floats, normal: Floats) -> Floats:
        depth = float(normal @ (surface - place))
        if depth <= 0:
            return np.zeros(3)
        push = STIFFNESS * depth - DAMPING * float(normal @ velocity)
        return np.asarray(min(max(push, 0.0), self.yields) * normal)


def _near(place: Floats, other: Floats) -> bool:
    return math.hypot(place[0] - other[0], place[1] - other[1]) < NEAR


class Push:
    """A person who leans against joint 0 and then blocks it: a spring about its position, with limited strength.

    `random` draws the strength, Nm: about 100 N at 0.25 m from the axis. A hand that is pushed back slides.
    """

    LASTS = 3.5
    """Duration of the push, s."""

    def __init__(self, random: np.random.Generator) -> None:
        self.strength = random.normal(25.0, 2.5)
        self._anchor, self._time = math.nan, 0.0

    def torque(self, angle: float, period: float) -> float | None:
        """Return the torque on the joint at an angle (rad), `period` s after the last call; None when it is over."""
        self._time += period
        if self._time >= self.LASTS:
            return None
        if math.isnan(self._anchor):
            self._anchor = angle
        most = self.strength * min(1.0, self._time / 0.4, (self.LASTS - self._time) / 0.4)
        lean = -0.4 * self.strength
        wanted = lean + self.STIFFNESS * (self._anchor - angle)
        if abs(wanted) > self.strength:
            self._anchor = angle + (math.copysign(self.strength, wanted) - lean) / self.STIFFNESS
        return min(max(wanted, -most), most)

    STIFFNESS = 190.0
    """Nm/rad: 3000 N/m at 0.25 m."""
