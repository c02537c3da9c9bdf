"""A trained model: detector, threshold and origin; scores single points, stored and loaded.

`OperateNode` scores one point at a time, so classifiers with an RBF kernel are evaluated here directly: scaling and
components are one matrix, the kernel is one product and one exponential over the support vectors. A library's `predict`
takes several times as long for a single point. The verdicts are equal.

`DataPersist` stores processed data under the hash of the data that it was made from, and returns it for the same data
only.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.anomaly.learning_file import SCALINGS
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import ANOMALOUS, Recording, read_csv
from fame.monitor.anomaly.scoring import PointTracker, Scorer
from fame.monitor.arrays import Floats
from fame.monitor.calibration import Calibration
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.detectors import Several
from fame.monitor.pipeline.trained_model import LEAST_MOVEMENT, STILL
from fame.monitor.storage import FORMAT, StoredModel, read_artefact, versions, write_artefact


@dataclass(slots=True)
class DataProcess:
    """Preprocessing of points for a classifier: scaling, then reduction.

    reduction  how many principal components are kept; 0: all columns as they are
    scaling    ``minmax`` (each column to 0 ... 1), ``standard`` (mean 0, deviation 1) or ``none``
    """

    reduction: int = 0
    scaling: str = "minmax"
    scaler: Any = None
    pca: Any = None

    def __post_init__(self) -> None:
        if self.scaling not in SCALINGS:
            raise ConfigError(f"expected a scaling of {', '.join(SCALINGS)}, got {self.scaling!r}")

    def split(self, in_file: str | Path, x_cols: Sequence[int], y_cols: Sequence[int]) -> tuple[Floats, Any]:
        """Return input columns (points, inputs) and the label column (points,) of a CSV file; columns count from 0."""
        recording = read_csv(in_file, x_cols, y_cols[0] if y_cols else None)
        return recording.values, recording.labels

    def fit(self, values: Floats) -> DataProcess:
        """Learn scaling and components from points (points, inputs). Raises ConfigError if they are too few."""
        from sklearn.decomposition import PCA
        from sklearn.preprocessing import MinMaxScaler, StandardScaler

        points, inputs = values.shape
        if points <= inputs:
            raise ConfigError(f"has {points} points of {inputs} columns: more points than columns are needed")
        if self.reduction > inputs or self.reduction < 0:
            text = f"reduction: expected 0 (none) or 1 to {inputs} components, got {self.reduction}"
            raise ConfigError(text)
        kinds: dict[str, Any] = {"minmax": MinMaxScaler, "standard": StandardScaler}
        self.scaler = kinds[self.scaling]().fit(values) if self.scaling in kinds else None
        self.pca = PCA(self.reduction).fit(self._scaled(values)) if self.reduction else None
        return self

    def transform(self, values: Floats) -> Floats:
        """(points, inputs) as classifiers see them."""
        scaled = self._scaled(values)
        return np.asarray(self.pca.transform(scaled) if self.pca is not None else scaled)

    def affine(self, inputs: int) -> tuple[Floats, Floats]:
        """Return the transformation as matrix and offset: ``transform(x) == x @ matrix + offset``."""
        offset = self.transform(np.zeros((1, inputs)))[0]
        return self.transform(np.eye(inputs)) - offset, offset

    def _scaled(self, values: Floats) -> Floats:
        return np.asarray(self.scaler.transform(values) if self.scaler is not None else values)


@dataclass(frozen=True, slots=True)
class PointClassifier:
    """A classifier with its preprocessing. `unique` leaves repeated points out of what an unsupervised one learns."""

    kind: ClassVar[str] = "classifier"
    period: ClassVar[float] = 0.0  # it knows no time
    classifier: Any
    process: DataProcess
    unique: bool = False

    @property
    def supervised(self) -> bool:
        """Whether it learns from points of both kinds."""
        from sklearn.base import is_outlier_detector

        return not is_outlier_detector(self.classifier)

    def fit(self, data: Recording) -> PointClassifier:
        """Learn from points, scaled as `process` has learned to. Raises ConfigError for what scikit-learn refuses."""
        values = np.unique(data.values, axis=0) if self.unique and not self.supervised else data.values
        labels = (data.labels,) if self.supervised else ()
        features = self.process.transform(values)
        try:
            self.classifier.fit(features, *labels)
        except (TypeError, ValueError) as error:  # parameters are checked only now
            text = f"{type(self.classifier).__name__} cannot be trained on these data: {error}"
            raise ConfigError(text, file=data.source) from None
        return self

    def predict(self, recording: Recording) -> Any:
        """Return labels (points,): +1 benign, -1 anomalous."""
        return np.where(self.classifier.predict(self.process.transform(recording.values)) == ANOMALOUS, -1, 1)

    def decision(self, joints: int) -> Callable[[Floats], bool]:
        """Return what tells whether a point (joints,) is benign."""
        svm, process = self.classifier, self.process
        if getattr(svm, "kernel", None) != "rbf" or not hasattr(svm, "support_vectors_"):
            return lambda point: bool(svm.predict(process.transform(point[None]))[0] != ANOMALOUS)
        matrix, offset = process.affine(joints)
        vectors, gamma = np.ascontiguousarray(svm.support_vectors_.T), float(svm._gamma)
        squares, weights = (vectors**2).sum(axis=0), np.ascontiguousarray(svm.dual_coef_[0])
        intercept = float(svm.intercept_[0])

        def benign(point: Floats) -> bool:
            features = point @ matrix + offset
            distances = squares - 2 * (features @ vectors) + features @ features
            return bool(np.exp(-gamma * distances) @ weights + intercept > 0)

        return benign


@dataclass(frozen=True, slots=True)
class Model(StoredModel):
    """A detector of points with all that it needs.

    detector     a PointClassifier, PathDetector or several of them
    threshold    a run is anomalous if its score exceeds this
    nominal      points of a usual benign run
    reference    points of some benign runs (points, joints), to find the joint that is off
    data         SHA-256 of the training data
    versions     of the packages that made it
    calibration  of the threshold, if it promises a rate of false alarms
    band         of the benign training runs, over the number of the point in its run; None of an earlier version
    conditions   of the learning, as plain data: its date, what the model replaced, hashes of its runs, the least
                 standard deviation of each joint over one of them, the points of the longest one, and drift
    """

    kind: ClassVar[str] = "points"
    maker: ClassVar[str] = "fame monitor adm learn"
    estimators: ClassVar[bool] = True
    detectors: ClassVar[Mapping[str, Any]] = {each.kind: each for each in (PathDetector, PointClassifier, Several)}
    name: str
    joints: tuple[str, ...]
    detector: Any
    threshold: float
    nominal: int
    reference: Floats
    data: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    calibration: Calibration | None = None
    band: Band | None = None
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def check(self) -> None:
        """Raise ValueError or another error if its parts do not fit each other."""
        if self.reference.ndim != 2 or self.reference.shape[1] != len(self.joints):
            raise ValueError(f"reference of shape {self.reference.shape} for {len(self.joints)} joints")
        self.scorer().step(self.reference[0].tolist())
        self.alarm_text()

    def predict(self, recording: Recording) -> Any:
        """Return labels (points,): +1 benign, -1 anomalous."""
        return self.detector.predict(recording)

    def scorer(self) -> Scorer:
        """Return a scorer of single points."""
        rule, parts = "any of", (self.detector,)
        if isinstance(self.detector, Several):
            rule, parts = self.detector.rule, self.detector.parts
        trackers = [
            part.tracker() if isinstance(part, PathDetector) else PointTracker(part.decision(len(self.joints)))
            for part in parts
        ]
        return Scorer(rule, trackers, self.worst_joint)

    @property
    def parts(self) -> dict[str, Any]:
        """The detectors by name: those of several, or the only one."""
        if isinstance(self.detector, Several):
            return dict(zip(self.detector.names, self.detector.parts, strict=True))
        return {self.name: self.detector}

    def run_score(self, anomalous: Sequence[int], points: int) -> float:
        """Return the score of a run from its anomalous points (of each of several detectors) and all its points."""
        scores = [count / points for count in anomalous]
        return self.detector.score(scores) if isinstance(self.detector, Several) else scores[0]

    def alarm_text(self, threshold: float | None = None) -> str:
        """Return the threshold in points and time."""
        limit = self.threshold if threshold is None else threshold
        if not isinstance(self.detector, Several):
            return self._alarm_text(limit, self.period)
        own = zip(self.parts.items(), self.detector.usual[:, 0].tolist(), strict=True)
        texts = (f"{name}: {self._alarm_text(limit * unit, part.period)}" for (name, part), unit in own)
        return f"{self.detector.rule} {'; '.join(texts)}"

    def _alarm_text(self, limit: float, period: float) -> str:
        points = math.floor(limit * self.nominal + 1e-9) + 1
        lasts = f", {points * period:.3g} s" if period else ""  # if the detector knows the time between two
        many = "1 anomalous point" if points == 1 else f"{points} anomalous points"
        return f"alarm from {many} of a run of {self.nominal} on{lasts}"

    def still(self, values: Floats) -> tuple[str, ...]:
        """Return the joints that hardly move in a run (points, joints), as with a dead sensor, and as none did in the
        training; none of an earlier version."""
        least = np.asarray(self.conditions.get(LEAST_MOVEMENT, np.zeros(len(self.joints))))
        return tuple(self.joints[joint] for joint in np.flatnonzero(values.std(axis=0) < STILL * least))

    @property
    def period(self) -> float:
        """The usual time between two points, s; 0 if it is unknown."""
        return max(float(part.period) for part in self.parts.values())

    def worst_joint(self, values: Floats) -> tuple[str, float]:
        """Return the joint that is farthest from the nearest benign point, and how far (rad)."""
        nearest = self.reference[np.argmin(((self.reference - values) ** 2).sum(axis=1))]
        apart = np.abs(values - nearest)
        worst = int(apart.argmax())
        return self.joints[worst], float(apart[worst])


def data_hash(*recordings: Recording) -> str:
    """Return the SHA-256 of the values, labels and runs of recordings."""
    digest = hashlib.sha256()
    for recording in recordings:
        for part in (recording.values, recording.labels, recording.runs):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


class DataPersist:
    """The published role: keeps processed data and fitted processing in a folder, each under the hash of its origin."""

    folder: Path

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def save(self, name: str, content: Any, data: str) -> Path:
        """Store something made from the data of that hash."""
        path = self.folder / f"{name}.skops"
        write_artefact({"format": FORMAT, "data": data, "versions": versions(), "content": content}, path)
        return path

    def retrieve(self, name: str, data: str) -> Any:
        """Return what was stored. Raises ConfigError if it does not exist, or was made from other data."""
        path = self.folder / f"{name}.skops"
        stored = read_artefact(path, "fame monitor adm")
        if not isinstance(stored, dict) or stored.get("format") != FORMAT:
            raise ConfigError("was not stored by fame monitor adm", file=str(path))
        if stored["data"] != data:
            text = f"is stale: made from data {stored['data'][:12]}, expected {data[:12]}; learn again"
            raise ConfigError(text, file=str(path))
        return stored["content"]
