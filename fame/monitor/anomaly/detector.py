"""AnomalyDetector: the classifiers, fitted each with its kind of data, and asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.confusion_matrix import Matrix, by_point
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.process import DataProcess
from fame.monitor.anomaly.recording import ANOMALOUS, BENIGN, Recording

Named: TypeAlias = tuple[str, Any]
"""A classifier: its name, and an estimator of scikit-learn or a PathDetector."""


class AnomalyDetector:
    """The published role. Unsupervised classifiers learn from benign points, supervised ones from both kinds."""

    def __init__(self, unsupervised: Sequence[Named], supervised: Sequence[Named], process: DataProcess) -> None:
        self.unsupervised, self.supervised, self.process = list(unsupervised), list(supervised), process

    def train_unsupervised(self, data: Recording) -> None:
        """Fit each to the benign points. Raises ConfigError if there are none."""
        for _, estimator in self.unsupervised:
            fit(estimator, self.process, data, supervised=False)

    def train_supervised(self, data: Recording) -> None:
        """Fit each to points of both kinds. Raises ConfigError if there is only one."""
        for _, estimator in self.supervised:
            fit(estimator, self.process, data, supervised=True)

    def classify_unsupervised(self, data: Recording) -> dict[str, Any]:
        """Labels (points,) by each."""
        return {name: predict(estimator, self.process, data) for name, estimator in self.unsupervised}

    def classify_supervised(self, data: Recording) -> dict[str, Any]:
        """Labels (points,) by each."""
        return {name: predict(estimator, self.process, data) for name, estimator in self.supervised}

    def evaluate(self, data: Recording) -> dict[str, Matrix]:
        """The confusion matrix of points of each."""
        found = {**self.classify_unsupervised(data), **self.classify_supervised(data)}
        return {name: by_point(data, predicted) for name, predicted in found.items()}


def fit(estimator: Any, process: DataProcess, data: Recording, *, supervised: bool, unique: bool = False) -> None:
    """Fit one classifier. `unique` leaves out repeated points. Raises ConfigError for data of one class
    only, and for what scikit-learn refuses."""
    present = set(data.labels.tolist())
    if supervised and present != {BENIGN, ANOMALOUS}:
        kind = "benign" if BENIGN in present else "anomalous"
        text = f"has {kind} points only (label {min(present)}); a supervised classifier needs both"
        raise ConfigError(text, file=data.source)
    benign = data if supervised else data.select([n for n, label in enumerate(data.run_labels()) if label == BENIGN])
    if not len(benign):
        raise ConfigError("has no benign points (label 1) to learn from", file=data.source)
    if isinstance(estimator, PathDetector):
        told, there = len(estimator.chain.joints), len(benign.joints)
        if told != there:
            raise ConfigError(f"has {there} joints; the chain of the PathDetector has {told}", file=data.source)
        estimator.fit(benign)
        return
    values = np.unique(benign.values, axis=0) if unique and not supervised else benign.values
    features = process.transform(values)
    try:
        estimator.fit(features, benign.labels) if supervised else estimator.fit(features)
    except (TypeError, ValueError) as error:  # parameters are checked only now
        raise ConfigError(f"{type(estimator).__name__} does not learn from that: {error}", file=data.source) from None


def predict(estimator: Any, process: DataProcess | None, data: Recording) -> Any:
    """Labels (points,) by one classifier: +1 benign, -1 anomalous."""
    if isinstance(estimator, PathDetector):
        return estimator.predict(data)
    assert process is not None
    return np.where(estimator.predict(process.transform(data.values)) == ANOMALOUS, -1, 1)


def is_supervised(estimator: Any) -> bool:
    """Whether a classifier needs labels."""
    if isinstance(estimator, PathDetector):
        return False
    from sklearn.base import is_outlier_detector

    return not is_outlier_detector(estimator)
