"""The UR5e-like arm: where its parameters are from stands in `ur5e.yaml`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fame.monitor.arrays import Floats
from robots.arm.dynamics import load_arm

UR5E = load_arm(Path(__file__).with_name("ur5e.yaml"))
HOME: Floats = np.array([np.pi, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, np.pi / 2])
"""Upper arm upright, forearm level, tool down, the bracket to the side."""
