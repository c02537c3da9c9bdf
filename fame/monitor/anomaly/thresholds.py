"""Thresholds of classifiers: as given, between the classes, or calibrated to a rate of false alarms; combinations.

Only scores of held-out runs set a threshold (`fame.monitor.anomaly.learn` holds out folds of runs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import VALIDATION, Evaluation, TrainedClassifier
from fame.monitor.anomaly.learning_file import CandidateClassifier, Learning
from fame.monitor.anomaly.recording import ANOMALOUS, BENIGN, Recording
from fame.monitor.calibration import Calibration, calibrate_runs, false_alarm_rate
from fame.monitor.copies import copies, run_hash
from fame.monitor.pipeline.detectors import Several, combined


def set_threshold(
    candidate: CandidateClassifier, learning: Learning, whole: Recording, held: Sequence[float] | None
) -> tuple[float, str, Calibration | None]:
    """Return the threshold, what is wrong with it, and its calibration if a rate of false alarms is asked for; `held`
    are the scores of the runs, each by a classifier that was fitted without it."""
    given = 0.0 if candidate.threshold in ("auto", None) else float(candidate.threshold or 0.0)
    if learning.false_alarms:
        return _calibrated(learning, whole, held, given)
    return (given, "", None) if candidate.threshold != "auto" else (*_between(whole, held), None)


def _calibrated(
    learning: Learning, whole: Recording, held: Sequence[float] | None, least: float
) -> tuple[float, str, Calibration | None]:
    """Set a threshold from the scores of held-out benign runs, each once. Raises ConfigError without such runs."""
    if held is None or BENIGN not in whole.run_labels():
        raise ConfigError("FalseAlarms needs held-out benign runs: give Split.folds of 2 or more", file=whole.source)
    if whole.stamps is None and "hour" in learning.false_alarms:
        raise ConfigError("has no stamps: give FalseAlarms per run, not per hour", file=whole.source)
    lasted = [float(run.stamps[-1] - run.stamps[0]) for run in whole if run.stamps is not None]
    rate = false_alarm_rate(learning.false_alarms, float(np.mean(lasted)) if lasted else 1.0)
    copied = copies(run_hash(run.values) for run in whole)
    rows = enumerate(zip(held, whole.run_labels(), strict=True))
    scores = [score for number, (score, label) in rows if label == BENIGN and number not in copied]
    calibration = calibrate_runs(np.array(scores), rate, least=least)
    return calibration.thresholds[0], "" if calibration.promised else calibration.text, calibration


def _between(whole: Recording, held: Sequence[float] | None) -> tuple[float, str]:
    """Return the largest threshold that parts the runs, and what is wrong with it."""
    labels = whole.run_labels()
    if held is None or len(set(labels)) < 2:
        text = "Threshold: auto needs anomalous runs and Split.folds: give a number, or runs with label -1"
        raise ConfigError(text, file=whole.source)
    lowest = min(score for score, label in zip(held, labels, strict=True) if label != BENIGN)
    highest = max(score for score, label in zip(held, labels, strict=True) if label == BENIGN)
    if lowest <= highest:
        return highest, f"no threshold parts the runs: anomalous from {lowest:.4f}, benign up to {highest:.4f}"
    return float(np.nextafter(lowest, -np.inf)), ""


def together(
    candidate: CandidateClassifier, chosen: Sequence[TrainedClassifier], learning: Learning, whole: Recording
) -> TrainedClassifier:
    """Combine classifiers that have been learned, by ``any of`` or ``all of``. Raises ConfigError."""
    rule, _ = candidate.combined or ("any of", ())
    models = [item.model for item in chosen]
    detector = Several(
        rule, tuple(each.detector for each in models), np.array([[each.threshold] for each in models]),
        tuple(each.name for each in models),
    )  # fmt: skip
    threshold, note, calibration = float(candidate.threshold or 1.0), "", None
    evaluations = [_together(detector, items) for items in zip(*(item.evaluations for item in chosen), strict=True)]
    if learning.false_alarms:
        held = next((each.scores for each in evaluations if each.data == VALIDATION), None)
        threshold, note, calibration = _calibrated(learning, whole, held, threshold)
    model = replace(
        chosen[0].model, name=candidate.name, detector=detector, threshold=threshold, calibration=calibration
    )
    return TrainedClassifier(candidate, model, tuple(replace(each, threshold=threshold) for each in evaluations), note)


def _together(detector: Several, items: Sequence[Evaluation]) -> Evaluation:
    """Combine evaluations of several detectors on the same data."""
    scores = tuple(detector.score(each) for each in zip(*(item.scores for item in items), strict=True))
    votes = np.array([np.asarray(item.predicted) == ANOMALOUS for item in items])
    return replace(items[0], scores=scores, predicted=np.where(combined(detector.rule, votes), ANOMALOUS, BENIGN))
