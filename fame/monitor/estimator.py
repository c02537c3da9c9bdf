"""`Detector`: the detectors of FAME as an estimator of scikit-learn, to compare them with others."""

from __future__ import annotations

from collections import Counter
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from fame.monitor.arrays import Floats
from fame.monitor.calibration import LEAST, Calibration, calibrate_runs
from fame.monitor.copies import copies, run_hash
from fame.monitor.pipeline.other_estimators import EstimatorDetector
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, learned, left_out, losses, weighed
from fame.monitor.pipeline.trained_model import TrainedModel


class Detector(OutlierMixin, BaseEstimator):  # type: ignore[misc]
    """An outlier detector of rows (n, channels), in their order if `window` is above 1.

    detector      as in a configuration of ``fame monitor train``: ``mahalanobis``, ``phase``, ``any of pca, knn`` ...
                  or an outlier detector of scikit-learn or PyOD: ``IsolationForest()``
    window        rows per window
    false_alarms  share of runs that may raise an alarm, on average over trainings; of rows, if `fit` is not told runs
    folds         that are left out for the scores that set the threshold
    """

    detector: Any
    window: int
    false_alarms: float
    folds: int
    seed: int

    def __init__(
        self, detector: Any = "mahalanobis", window: int = 1, false_alarms: float = 0.05, folds: int = 5, seed: int = 0
    ) -> None:
        self.detector, self.window, self.false_alarms = detector, window, false_alarms
        self.folds, self.seed = folds, seed

    def fit(self, X: Any, y: Any = None, runs: Any = None) -> Self:
        """Learn from undisturbed rows; `runs` (n,) has the number of the run of each, by default `folds` equal parts.

        Raises ConfigError for an unknown detector, for an estimator of which it is not known whether unusual rows have
        low or high scores, and for too few rows or runs; ValueError for a run that is a copy of another one, and for
        one whose rows are not in a row.
        """
        X = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        name, estimator = (self.detector, None) if isinstance(self.detector, str) else ("", self.detector)
        config = Training(
            detector=name, estimator=estimator, window=self.window, stride=1, folds=self.folds, seed=self.seed
        )
        parts = _runs(X, runs if runs is not None else np.arange(len(X)) * min(self.folds, len(X)) // len(X))
        if runs is not None and (copied := copies(run_hash(part.values) for part in parts)):
            number, first = next(iter(copied.items()))
            raise ValueError(f"expected runs of their own: that of place {number} has the same rows as that of {first}")
        config = weighed(parts, config, 1.0)
        self.model_: TrainedModel = learned(parts, config, 1.0)
        found = {index: losses(model, parts[index]).values for index, model in left_out(parts, config, 1.0)}
        usual = np.maximum(np.median(np.concatenate([*found.values()]), axis=0), LEAST)
        one = isinstance(self.model_.detector, EstimatorDetector)  # score, which is that of the row
        self.usual_: Floats = np.ones_like(usual) if one else usual
        scores = [(loss / self.usual_).max(axis=1) for loss in found.values() if len(loss)]
        counted = np.concatenate(scores) if runs is None else np.array([score.max() for score in scores])
        self.calibration_: Calibration = calibrate_runs(counted, self.false_alarms)
        self.offset_: float = -self.calibration_.thresholds[0]
        return self

    def score_samples(self, X: Any, runs: Any = None) -> Floats:
        """Return a score per row (n,), the lower the more unusual; rows before a whole window have that of the first.

        Raises ValueError for a run that is shorter than a window, and for one whose rows are not in a row.
        """
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        found = []
        for part in _runs(X, np.zeros(len(X)) if runs is None else runs):
            if len(part) < self.window:
                raise ValueError(f"expected at least {self.window} rows of a run, a whole window, got {len(part)}")
            score = -(losses(self.model_, part).values / self.usual_).max(axis=1)
            found.append(np.concatenate((np.full(len(part) - len(score), score[0]), score)))
        return np.concatenate(found)

    def decision_function(self, X: Any, runs: Any = None) -> Floats:
        """Return the score above the threshold (n,): below 0 a row is anomalous."""
        return np.asarray(self.score_samples(X, runs) - self.offset_)

    def predict(self, X: Any, runs: Any = None) -> Any:
        """Return 1 for a usual row, -1 for an anomalous one (n,)."""
        return np.where(self.decision_function(X, runs) < 0, -1, 1)


def _runs(values: Floats, numbers: Any) -> list[Samples]:
    """Divide rows where the number of the run changes; a row per s. Raises ValueError for one that comes back."""
    numbers = np.asarray(numbers)
    bounds = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
    begun = numbers[np.concatenate(([0], bounds))].tolist()
    if len(set(begun)) < len(begun):
        run = next(run for run, count in Counter(begun).items() if count > 1)
        raise ValueError(f"expected the rows of each run together, got run {run!r} again after another one")
    return [Samples(part, np.arange(len(part), dtype=np.float64)) for part in np.split(values, bounds)]
