"""A trained model as it is stored and used: processing, classifier, threshold, and where it came from.

Scoring one point at a time is what Operate does, so classifiers with an RBF kernel are evaluated here directly: scaling
and components are one matrix, the kernel one product and one exponential over the support vectors. A library's
`predict` takes several times as long for a single point. The verdicts are the same; a test says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.process import DataProcess
from fame.monitor.anomaly.recording import ANOMALOUS, Floats, Recording


class Verdict(NamedTuple):
    """What a point is found to be. `magnitude` is in `unit` (``mm`` across the path, ``samples`` late, ``rad``);
    `joint` is the one that is farthest from where it should be. Both only tell of anomalous points."""

    anomalous: bool
    magnitude: float = 0.0
    unit: str = ""
    joint: str = ""


BENIGN_POINT = Verdict(False)


@dataclass(frozen=True, slots=True)
class Model:
    """A classifier with all that it needs.

    process    None for a PathDetector, which takes joint angles as they are
    threshold  a run is anomalous if its score exceeds this
    nominal    points of a usual benign run
    reference  points of some benign runs (points, joints): tells which joint is off
    data       SHA-256 of the training data
    versions   of the packages that made it
    """

    name: str
    joints: tuple[str, ...]
    estimator: Any
    process: DataProcess | None
    threshold: float
    nominal: int
    reference: Floats
    data: str = ""
    versions: dict[str, str] = field(default_factory=dict)

    def predict(self, recording: Recording) -> Any:
        """Labels (points,): +1 benign, -1 anomalous."""
        if self.process is None:
            return self.estimator.predict(recording)
        return np.where(self.estimator.predict(self.process.transform(recording.values)) == ANOMALOUS, -1, 1)

    def scorer(self) -> Scorer:
        """What judges points one by one."""
        if isinstance(self.estimator, PathDetector):
            return PathScorer(self)
        return PointScorer(self)

    def blame(self, values: Floats) -> tuple[str, float]:
        """The joint that is farthest from the nearest benign point, and how far (rad)."""
        nearest = self.reference[np.argmin(((self.reference - values) ** 2).sum(axis=1))]
        apart = np.abs(values - nearest)
        worst = int(apart.argmax())
        return self.joints[worst], float(apart[worst])


class Scorer(Protocol):
    """Judges points one by one."""

    def reset(self) -> None:
        """The next run begins."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        """One point: values of the joints in the model's order, and its time (s) if known."""


class PointScorer:
    """For classifiers to which every point stands for itself."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._benign = _decision(model)

    def reset(self) -> None:
        """Nothing is kept from point to point."""

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        point = np.asarray(values, dtype=np.float64)
        if self._benign(point):
            return BENIGN_POINT
        joint, apart = self.model.blame(point)
        return Verdict(True, apart, "rad", joint)


class PathScorer:
    """For the detector in task space."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._tracker = model.estimator.tracker()

    def reset(self) -> None:
        self._tracker.reset()

    def step(self, values: Sequence[float], stamp: float | None = None) -> Verdict:
        reading = self._tracker.step(values, stamp)
        if not reading.anomalous:
            return BENIGN_POINT
        joint, _ = self.model.blame(np.asarray(values))
        if reading.off_path:
            return Verdict(True, 1000 * reading.deviation, "mm", joint)
        return Verdict(True, reading.lateness, "samples", joint)


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
