"""The digital twin of an arm: from places that its tool shall go to, to trajectories of its joints.

It knows the arm's kinematics and where the program says that things are; what is different in truth it does not know.
A way is a straight line with the tool's orientation kept, and least jerk from rest to rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fame.errors import MissionError
from fame.monitor.arrays import Floats
from fame.monitor.kinematics import Chain
from robots.arm.inverse import inverse

SPEED = 0.25
"""m/s of the tool, at its fastest."""
SHORTEST = 1.0
"""s of any way."""
NODE = 0.05
"""s between two points, about."""


class Way(NamedTuple):
    """Times (points,), s from its begin, and positions (points, joints), rad."""

    times: Floats
    positions: Floats


def straight(chain: Chain, posture: Floats, place: Floats) -> Way:
    """The way of the tool from a posture (joints,) to a place (3,), m. Raises MissionError if it cannot be gone."""
    begin = chain.places(posture[None])[0]
    orientation = chain.orientations(posture[None])
    length = float(np.linalg.norm(place - begin))
    duration = max(SHORTEST, 1.875 * length / SPEED)  # least jerk is 1.875 times as fast at its middle as on average
    count = int(np.ceil(duration / NODE))
    part = np.arange(1, count + 1) / count
    done = part**3 * (10 - 15 * part + 6 * part**2)
    positions, now = [], posture[None]
    for share in done:
        now = inverse(chain, (begin + share * (place - begin))[None], orientation, now)
        positions.append(now[0])
    steps = np.abs(np.diff(np.vstack([posture, positions]), axis=0)).max() * count / duration
    if steps > np.pi:
        raise MissionError(f"the way would turn a joint at {steps:.1f} rad/s; at most {np.pi:.1f} would be right")
    return Way(part * duration, np.array(positions))
