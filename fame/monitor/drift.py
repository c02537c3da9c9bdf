"""Drift: slow changes over many runs, told apart from anomalies of one run.

Each run gives a score per channel. Against the runs of the calibration, z = (log score - mean) / deviation. A
cumulative sum per channel (one-sided CUSUM: Page 1954) grows by z - `SLACK` and never falls below 0; above `LIMIT` the
channel is drifting, and the model should be learned again before false alarms begin. With z of undisturbed runs
normal, SLACK 0.5 and LIMIT 5 give a false verdict in about 930 runs per channel, and find a shift of one deviation
after about 10 runs (Montgomery, Introduction to Statistical Quality Control, table 9.4). A single anomalous run counts
as z = `MOST`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.calibration import LEAST, Calibration

SLACK, LIMIT, MOST = 0.5, 5.0, 2.5


@dataclass(slots=True)
class DriftMonitor:
    """CUSUM per channel over runs. `levels` and `deviations` are those of the log scores of the calibration."""

    names: tuple[str, ...]
    levels: Floats
    deviations: Floats
    sums: Floats = field(default_factory=lambda: np.zeros(0))
    runs: int = 0

    @classmethod
    def of(cls, names: Sequence[str], calibration: Calibration) -> DriftMonitor:
        """A new monitor for the runs after a calibration."""
        levels, deviations = np.array(calibration.levels), np.array(calibration.deviations)
        return cls(tuple(names), levels, deviations, np.zeros(len(names)))

    def add(self, scores: Sequence[float] | Floats) -> tuple[str, ...]:
        """Take the scores of one more run (channels,); return the channels that are drifting."""
        z = (np.log(np.maximum(np.asarray(scores, dtype=np.float64), LEAST)) - self.levels) / self.deviations
        self.sums = np.maximum(0.0, self.sums + np.minimum(z, MOST) - SLACK)
        self.runs += 1
        return self.drifting

    @property
    def drifting(self) -> tuple[str, ...]:
        """The channels whose sum is above the limit."""
        return tuple(name for name, total in zip(self.names, self.sums, strict=True) if total > LIMIT)

    def save(self, path: Path) -> None:
        """Store the sums, to go on in another process."""
        path.parent.mkdir(parents=True, exist_ok=True)
        whole = path.with_name(f".{path.name}.part")
        whole.write_text(json.dumps({"names": self.names, "sums": self.sums.tolist(), "runs": self.runs}) + "\n")
        whole.replace(path)

    def restore(self, path: Path) -> None:
        """Go on from what `save` stored, if the file exists. Raises ConfigError if it is of other channels."""
        if not path.exists():
            return
        try:
            stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            names, sums, runs = tuple(stored["names"]), np.array(stored["sums"], dtype=np.float64), int(stored["runs"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"is not the state of a drift monitor ({type(error).__name__})", file=str(path)) from None
        if names != self.names or sums.shape != (len(names),):
            text = f"is of the channels {', '.join(map(str, names))}; expected {', '.join(self.names)}: remove it"
            raise ConfigError(text, file=str(path))
        self.sums, self.runs = sums, runs
