"""Thresholds of classifiers: as given, between the classes, or calibrated to a rate of false alarms; combinations.

Only scores of held-out runs set a threshold (`fame.monitor.anomaly.learn` holds out folds of runs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import (
    VALIDATION,
    Evaluation,
    OutputMatrix,
    TrainedClassifier,
    by_run,
    run_scores,
)
from fame.monitor.anomaly.learning_file import Candidate, Learning
from fame.monitor.anomaly.recording import ANOMALOUS, BENIGN, Recording
from fame.monitor.anomaly.scoring import Ensemble
from fame.monitor.calibration import Calibration, calibrate_runs, false_alarm_rate
from fame.monitor.pipeline.detectors import combined


def set_threshold(
    candidate: Candidate, learning: Learning, whole: Recording, held: Any
) -> tuple[float, str, Calibration | None]:
    """The threshold, what is wrong with it, and its calibration if a rate of false alarms is asked for."""
    if not learning.false_alarms:
        return *_threshold(candidate, whole, held), None
    least = 0.0 if candidate.threshold in ("auto", None) else float(candidate.threshold or 0.0)
    benign = () if held is None else _of_benign(whole.run_labels(), run_scores(whole, held))
    calibration = _calibration(learning, whole, benign, least)
    return calibration.thresholds[0], "" if calibration.promised else calibration.text, calibration


def _of_benign(labels: Sequence[int], scores: Sequence[float]) -> tuple[float, ...]:
    return tuple(score for score, label in zip(scores, labels, strict=True) if label == BENIGN)


def _calibration(learning: Learning, whole: Recording, benign: Sequence[float], least: float) -> Calibration:
    """Set a threshold from the scores of held-out benign runs. Raises ConfigError without such runs."""
    if not benign:
        raise ConfigError("FalseAlarms needs held-out benign runs: give Split.folds of 2 or more", file=whole.source)
    if whole.stamps is None and "hour" in learning.false_alarms:
        raise ConfigError("has no stamps: give FalseAlarms per run, not per hour", file=whole.source)
    lasted = [float(run.stamps[-1] - run.stamps[0]) for run in whole if run.stamps is not None]
    rate = false_alarm_rate(learning.false_alarms, float(np.mean(lasted)) if lasted else 1.0)
    return calibrate_runs(np.array(benign), rate, least=least)


def _threshold(candidate: Candidate, whole: Recording, held: Any) -> tuple[float, str]:
    """The threshold, and what is wrong with it."""
    if candidate.threshold != "auto":
        return float(candidate.threshold or 0.0), ""
    labels = whole.run_labels()
    if held is None or len(set(labels)) < 2:
        text = "Threshold: auto needs anomalous runs and Split.folds: give a number, or runs with label -1"
        raise ConfigError(text, file=whole.source)
    scores = run_scores(whole, held)
    lowest = min(score for score, label in zip(scores, labels, strict=True) if label != BENIGN)
    highest = max(score for score, label in zip(scores, labels, strict=True) if label == BENIGN)
    if lowest <= highest:
        return highest, f"no threshold parts the runs: anomalous from {lowest:.4f}, benign up to {highest:.4f}"
    return float(np.nextafter(lowest, 0)), ""


def together(
    candidate: Candidate, chosen: Sequence[TrainedClassifier], learning: Learning, whole: Recording
) -> TrainedClassifier:
    """Combine classifiers that have been learned, by ``any of`` or ``all of``. Raises ConfigError."""
    rule, _ = candidate.combined or ("any of", ())
    ensemble = Ensemble(rule, tuple(item.model for item in chosen))
    threshold, note = float(candidate.threshold or 1.0), ""
    scores = [_scores_together(ensemble, items) for items in zip(*(item.evaluations for item in chosen), strict=True)]
    calibration = None
    validation = next((each for each in scores if each.data == VALIDATION), None)
    if learning.false_alarms:
        benign = () if validation is None else _of_benign(validation.labels, validation.scores)
        calibration = _calibration(learning, whole, benign, threshold)
        threshold, note = calibration.thresholds[0], "" if calibration.promised else calibration.text
    evaluations = [replace(each, runs=by_run(list(each.labels), list(each.scores), threshold)) for each in scores]
    model = replace(
        chosen[0].model, name=candidate.name, estimator=ensemble, threshold=threshold,
        calibration=calibration,
    )  # fmt: skip
    return TrainedClassifier(candidate, model, tuple(evaluations), note)


def _scores_together(ensemble: Ensemble, items: Sequence[Evaluation]) -> Evaluation:
    """Combine evaluations of members on the same data; `runs` are not evaluated yet."""
    first = items[0]
    scores = tuple(ensemble.score(each) for each in zip(*(item.scores for item in items), strict=True))
    votes = np.array([np.asarray(item.predicted) == ANOMALOUS for item in items])
    predicted = np.where(combined(ensemble.rule, votes), ANOMALOUS, BENIGN)
    points = OutputMatrix().output_matrix(first.truth, predicted)
    return replace(first, points=points, scores=scores, predicted=predicted)
