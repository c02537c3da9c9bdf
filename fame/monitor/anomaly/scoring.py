"""Scoring of single points by a model, one after the other, as a running node does."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from fame.monitor.anomaly.benign_changes import Change
from fame.monitor.anomaly.recording import ANOMALOUS
from fame.monitor.arrays import Floats

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model


class Verdict(NamedTuple):
    """The verdict on a point. `magnitude` is in `unit` (``mm`` across the path, ``deg`` turned, ``samples`` late,
    ``rad``); `joint` is the one that is farthest from where it should be; `kind` is ``path``, ``orientation``,
    ``speed`` or empty. They are set for anomalous points only. `votes` are those of the members of an ensemble."""

    anomalous: bool
    magnitude: float = 0.0
    unit: str = ""
    joint: str = ""
    kind: str = ""
    votes: tuple[bool, ...] = ()


BENIGN_POINT = Verdict(False)


class Scorer(Protocol):
    """Scores points one by one."""

    def reset(self) -> None:
        """The next run begins."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        """One point: values of the joints in the model's order, and its time (s) if known."""

    def changes(self) -> Sequence[Change]:
        """Give the benign changes of the run so far."""


class PointScorer:
    """Scores each point on its own, by a classifier."""

    model: Model

    def __init__(self, model: Model) -> None:
        self.model = model
        self._benign = _decision(model)

    def reset(self) -> None:
        """Nothing is kept from point to point."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        point = np.asarray(values, dtype=np.float64)
        if self._benign(point):
            return BENIGN_POINT
        joint, apart = self.model.worst_joint(point)
        return Verdict(True, apart, "rad", joint)

    def changes(self) -> Sequence[Change]:
        return ()


class PathScorer:
    """For the detector in task space."""

    model: Model

    def __init__(self, model: Model) -> None:
        self.model = model
        self._tracker = model.estimator.tracker()

    def reset(self) -> None:
        self._tracker.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        reading = self._tracker.step(values, stamp)
        if not reading.anomalous:
            return BENIGN_POINT
        joint, _ = self.model.worst_joint(np.asarray(values))
        if reading.off_path:
            return Verdict(True, 1000 * reading.deviation, "mm", joint, reading.kind)
        if reading.kind == "orientation":
            return Verdict(True, math.degrees(reading.tilt), "deg", joint, reading.kind)
        return Verdict(True, reading.lateness, "samples", joint, reading.kind)

    def changes(self) -> Sequence[Change]:
        return list(self._tracker.changes())


def _decision(model: Model) -> Callable[[Floats], bool]:
    """Whether a point is benign."""
    estimator, process = model.estimator, model.process
    assert process is not None
    if getattr(estimator, "kernel", None) != "rbf" or not hasattr(estimator, "support_vectors_"):
        return lambda point: bool(estimator.predict(process.transform(point[None]))[0] != ANOMALOUS)
    matrix, offset = process.affine(len(model.joints))
    vectors, gamma = np.ascontiguousarray(estimator.support_vectors_.T), float(estimator._gamma)
    squares, weights = (vectors**2).sum(axis=0), np.ascontiguousarray(estimator.dual_coef_[0])
    intercept = float(estimator.intercept_[0])

    def benign(point: Floats) -> bool:
        features = point @ matrix + offset
        distances = squares - 2 * (features @ vectors) + features @ features
        return bool(np.exp(-gamma * distances) @ weights + intercept > 0)

    return benign
