"""Drift: slow changes over many runs, as distinct from anomalies of one run.

Each run gives a score per channel. Against the runs of the calibration, z = (log score - mean) / deviation. A
cumulative sum per channel (one-sided CUSUM: Page 1954) grows by z - `SLACK` and never falls below 0; above `LIMIT` the
channel is drifting, and the model should be learned again before false alarms begin. With z of undisturbed runs
normal, SLACK 0.5 and LIMIT 5 give a false verdict in about 930 runs per channel, and find a shift of one deviation
after about 10 runs (Montgomery, Introduction to Statistical Quality Control, table 9.4). A single anomalous run counts
as z = `MOST`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.calibration import LEAST, Calibration
from fame.monitor.pipeline.processor import Parameter, Processor, Result, Samples, stacked
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.text import write_file

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
        """Return a new monitor for the runs after a calibration."""
        levels, deviations = np.array(calibration.levels), np.array(calibration.deviations)
        return cls(tuple(names), levels, deviations, np.zeros(len(names)))

    def add(self, scores: Sequence[float] | Floats) -> tuple[str, ...]:
        """Take the scores of one more run (channels,); return the channels that are drifting.

        A score that is no number says nothing: the sum of its channel stays.
        """
        z = (np.log(np.maximum(np.asarray(scores, dtype=np.float64), LEAST)) - self.levels) / self.deviations
        self.sums = np.where(np.isnan(z), self.sums, np.maximum(0.0, self.sums + np.minimum(z, MOST) - SLACK))
        self.runs += 1
        return self.drifting

    @property
    def drifting(self) -> tuple[str, ...]:
        """The channels whose sum is above the limit."""
        return tuple(name for name, total in zip(self.names, self.sums, strict=True) if total > LIMIT)

    def save(self, path: Path) -> None:
        """Store the sums, to continue in another process."""
        write_file(path, json.dumps({"names": self.names, "sums": self.sums.tolist(), "runs": self.runs}) + "\n")

    def restore(self, path: Path) -> None:
        """Continue from what `save` stored, if the file exists. Raises ConfigError if it is of other channels."""
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
        if not np.isfinite(sums).all():
            raise ConfigError("is not the state of a drift monitor: a sum is not finite", file=str(path))
        self.sums, self.runs = sums, runs


class Drift(Processor):
    """Reports each drifting channel once: takes the smoothed losses of a model, as `Threshold` does.

    A run ends when no sample has come for `gap`, and with the node. The sums go on from run to run, and with a `state`
    file from one start of the node to the next. `name` and `sum` have one value per drifting channel.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("model", "file", "", description="trained model whose calibration is used", fixed=True),
        Parameter("state", "file", "", description="file that keeps the sums between starts; empty: none", fixed=True),
        Parameter("gap", "float", 2.0, (0, None), "s", "between two samples, which ends a run"),
    )
    outputs: tuple[str, ...] = ("drift", "name", "sum")
    model: str
    state: str
    gap: float

    def __init__(self, model: str | Path | TrainedModel = "", **values: Any) -> None:
        super().__init__(**values)
        if not model:
            raise ConfigError("needs the file of a trained model", element="model")
        trained = model if isinstance(model, TrainedModel) else TrainedModel.load(model)
        if trained.calibration is None:
            text = "was trained by an earlier version, which stored no calibration: fame monitor train makes it anew"
            raise ConfigError(text, file=str(model), element="model")
        self.model = "" if isinstance(model, TrainedModel) else str(model)
        self.monitor: DriftMonitor = DriftMonitor.of(trained.columns, trained.calibration)
        if self.state:
            self.monitor.restore(Path(self.state))
        self._largest: Floats | None = None
        self._last: float | None = None
        self._reported: tuple[str, ...] = ()

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        if not len(samples):
            return None
        values = samples.channels()
        if values.shape[1] != len(self.monitor.names):
            raise ValueError(f"the model has {len(self.monitor.names)} channels; the data are {values.shape[1]}")
        before = samples.stamps[0] if self._last is None else self._last
        bounds = np.flatnonzero(np.diff(samples.stamps, prepend=before) > self.gap)
        for number, rows in enumerate(np.split(np.arange(len(samples)), bounds)):
            if number:
                self._end_run()
            if len(rows):
                largest = values[rows].max(axis=0)
                for channel in np.flatnonzero(np.isnan(largest)):
                    self.report(f"{self.monitor.names[channel]} is no number: its run is not judged")
                self._largest = largest if self._largest is None else np.maximum(self._largest, largest)
        self._last = float(samples.stamps[-1])
        drifting = self.monitor.drifting
        if not drifting or drifting == self._reported:
            return None
        self._reported = drifting
        sums = [self.monitor.sums[self.monitor.names.index(name)] for name in drifting]
        stamps = samples.stamps[-1:]
        names = tuple(name.rpartition(".")[2] for name in drifting)
        return {
            "drift": Samples(np.ones(1, dtype=bool), stamps),
            "name": Samples(np.array([names], dtype=object), stamps),
            "sum": Samples(np.array([sums]), stamps),
        }

    def close(self) -> None:
        """End the run, and store the sums."""
        self._end_run()
        if self.state:
            self.monitor.save(Path(self.state))

    def _end_run(self) -> None:
        if self._largest is not None:
            self.monitor.add(self._largest)
            self._largest = None
