"""The Yaskawa Motoman MH5: six joints S, L, U, R, B, T; the tool is the flange."""

from __future__ import annotations

from pathlib import Path

from fame.monitor.kinematics import load_chain

FILE = Path(__file__).with_name("mh5.yaml")
MH5 = load_chain(FILE)
