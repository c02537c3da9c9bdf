"""Learning: fit and evaluate every classifier of a learning file, and choose the best one.

Each classifier is evaluated on three kinds of data. *train*: the data that it learned from, which is optimistic and
labelled so. *validation*: runs are divided into contiguous folds, and each fold is evaluated by a classifier that was
fitted without it, scaling and components included. *test*: the testing files, unless one contains training runs, which
makes it train.

The threshold on the score of a run is the given number. ``auto`` is the largest value below the lowest score of the
held-out anomalous runs; it must exceed the highest score of the held-out benign ones. With `FalseAlarms` it is set by
conformal calibration over the held-out benign runs (`fame.monitor.calibration`), and a given number is the least that
it can be. ``any of`` and ``all of`` combine classifiers that are in the file. The best classifier has the
highest F1 of validation runs, then of validation points, then (without anomalous runs F1 is 0) the highest accuracy;
among equals the first one.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.classifiers import (
    TEST,
    TRAIN,
    VALIDATION,
    Evaluation,
    TrainedClassifier,
    expand_candidates,
    fit,
    make,
    run_scores,
)
from fame.monitor.anomaly.learning_file import CandidateClassifier, Learning
from fame.monitor.anomaly.model import Model, PointClassifier, data_hash
from fame.monitor.anomaly.recording import BENIGN, STILL, Recording, read_csv, require_same_joints
from fame.monitor.anomaly.thresholds import set_threshold, together
from fame.monitor.calibration import Calibration
from fame.monitor.copies import RUN_HASHES, copies, run_hash
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.trained_model import LEAST_MOVEMENT
from fame.monitor.pipeline.training_checks import drifts
from fame.monitor.storage import versions

_REFERENCE_RUNS = 3


class LearningProgress(NamedTuple):
    """How far learning is: fits done and to do, and what was fitted last."""

    done: int
    total: int
    name: str


@dataclass(frozen=True, slots=True)
class LearningData:
    """The recordings that a learning file names. Scaling and components are learned from `process`."""

    process: Recording | None
    benign: Recording | None
    both: Recording | None
    testing: tuple[Recording, ...]

    @property
    def all(self) -> list[Recording]:
        """Every recording there is."""
        return [item for item in (self.process, self.benign, self.both, *self.testing) if item is not None]

    @property
    def known(self) -> set[str]:
        """The hashes of the runs that are learned from."""
        return {run_hash(run.values) for item in (self.both, self.benign) if item is not None for run in item}

    @property
    def notes(self) -> list[str]:
        """What was unusual about the files, without repetition."""
        return list(dict.fromkeys(note for item in self.all for note in item.notes))


def read_data(learning: Learning) -> LearningData:
    """Read all files. Raises ConfigError, also if they are not of the same joints, or hold too few points."""
    used = (*learning.testing, learning.fit, learning.unsupervised, learning.supervised)
    files = {file: read_csv(file.path, file.inputs, file.output) for file in dict.fromkeys(used) if file is not None}
    *testing, process, benign, both = (None if file is None else files[file] for file in used)
    data = LearningData(process, benign, both, tuple(item for item in testing if item is not None))
    require_same_joints(data.all)
    for item in (data.process, data.benign, data.both):
        if item is not None and len(item) <= len(item.joints):
            text = f"has {len(item)} points of {len(item.joints)} columns: more points than columns are needed"
            raise ConfigError(text, file=item.source)
    benign, both = (None if item is None else checked(item) for item in (data.benign, data.both))
    return replace(data, benign=benign, both=both)


def checked(recording: Recording) -> Recording:
    """Note joints that never move and runs of very different length. Raises ConfigError for labels that contradict each
    other, and if nothing moves."""
    names, runs = recording.joints, list(recording)
    still = [name for name, range in zip(names, np.ptp(recording.values, axis=0), strict=True) if not range]
    if len(still) == len(names):
        raise ConfigError("no joint ever moves: nothing to learn", file=recording.source)
    seen: dict[str, tuple[int, int]] = {}
    for number, run in enumerate(runs):
        labels = np.unique(run.labels).tolist()
        if len(labels) > 1:
            text = f"run {number} has points of both labels, 1 and -1; expected one label for a whole run"
            raise ConfigError(text, file=recording.source)
        first, label = seen.setdefault(run_hash(run.values), (number, labels[0]))
        if label != labels[0]:
            text = f"runs {first} and {number} are the same points, one labelled 1, the other -1"
            raise ConfigError(text, file=recording.source)
    notes = [f"{recording.source}: {', '.join(still)} never moved"] if still else []
    if copied := copies(run_hash(run.values) for run in runs):
        number, first = next(iter(copied.items()))
        many = f"{len(copied)} of {len(runs)} runs are copies of others (run {number} of run {first})"
        notes.append(f"{recording.source}: {many}: FalseAlarms counts each once")
    shortest, longest = min(map(len, runs)), max(map(len, runs))
    if longest > 2 * shortest:
        notes.append(f"{recording.source}: runs have from {shortest} to {longest} points: are they of the same task?")
    return replace(recording, notes=(*recording.notes, *notes))


def learn(
    learning: Learning,
    data: LearningData | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[LearningProgress], object] | None = None,
) -> list[TrainedClassifier]:
    """Fit and evaluate every classifier, `jobs` at a time. Raises ConfigError for data that cannot be learned from."""
    try:
        return _learn(learning, data or read_data(learning), jobs, progress)
    except ConfigError as error:  # of a classifier or a scaling, which know no file
        raise ConfigError(
            error.text, file=error.file or str(learning.file), line=error.line, element=error.element
        ) from None


def _learn(
    learning: Learning, data: LearningData, jobs: int, progress: Callable[[LearningProgress], object] | None
) -> list[TrainedClassifier]:
    every = list(expand_candidates(learning))
    candidates = [candidate for candidate in every if candidate.combined is None]
    for candidate in candidates:
        make(candidate, learning.file.parent)  # a wrong one is refused before the first fit
    require("sklearn")  # which brings joblib
    from joblib import Parallel, delayed

    whole = data.both or data.benign
    assert whole is not None  # checked by `load`
    folds = _folds(whole, learning.folds)
    tasks = list(product(candidates, folds))
    work = (delayed(_fit)(candidate, fold, learning, data) for candidate, fold in tasks)
    fits: list[_Fitted] = []
    for (candidate, _), fitted in zip(tasks, Parallel(n_jobs=jobs, return_as="generator")(work), strict=True):
        fits.append(fitted)
        if progress is not None:
            progress(LearningProgress(len(fits), len(tasks), candidate.name))
    for (category, text), count in Counter(warned for each in fits for warned in each.warned).items():
        warnings.warn(f"{text} ({count} of {len(fits)} fits)", category, stacklevel=2)
    parts = (fits[begin : begin + len(folds)] for begin in range(0, len(fits), len(folds)))
    single = [_learned(each, part, learning, data, whole) for each, part in zip(candidates, parts, strict=True)]
    combined = []
    for candidate in every:
        if candidate.combined:
            _, names = candidate.combined
            named = [[each for each in single if f"{each.candidate.name} ".startswith(f"{name} ")] for name in names]
            combined.append(together(candidate, [best(each) for each in named], learning, whole))
    return [*single, *combined]


def best(learned: Sequence[TrainedClassifier]) -> TrainedClassifier:
    """Choose the best classifier by the rule above; without validation by the training data."""

    def rank(item: TrainedClassifier) -> tuple[float, ...]:
        result = item.on(VALIDATION) or item.on(TRAIN)
        if result is None:
            return (0.0,)
        return result.runs.f1, result.points.f1, result.runs.accuracy, result.points.accuracy

    return max((item for item in learned if not item.note), key=rank, default=max(learned, key=rank))


# ---- one fit ---------------------------------------------------------------------------------------------------------


class _Fitted(NamedTuple):
    """Result of a fit: the classifier (kept of the fit with all data), the labels that it predicts, and the warnings of
    its package."""

    detector: Any
    predicted: Any
    warned: frozenset[tuple[type[Warning], str]]


def _fit(candidate: CandidateClassifier, fold: int, learning: Learning, data: LearningData) -> _Fitted:
    """Fit without a fold and evaluate the fold; fold -1: fit all data and evaluate them."""
    detector = make(candidate, learning.file.parent, learning.scaling)
    source = data.both if detector.supervised else data.benign or data.both
    if source is None:
        missing = "supervised_train" if detector.supervised else "unsupervised_train"
        raise ConfigError(f"the classifier {candidate.name} needs Files.{missing}", file=str(learning.file))
    target = data.both or source
    if fold >= 0:
        target = target.select(np.flatnonzero(fold_numbers(target, learning.folds) == fold).tolist())
        held = {run_hash(run.values) for run in target}  # the same runs may stand in two files
        source = source.select([number for number, run in enumerate(source) if run_hash(run.values) not in held])
    if isinstance(detector, PointClassifier):
        detector.process.fit((source if fold >= 0 or data.process is None else data.process).values)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        fit(detector, source)
        predicted = detector.predict(target)
    texts = frozenset((each.category, str(each.message)) for each in warned)
    return _Fitted(detector if fold < 0 else None, predicted, texts)


def fold_numbers(recording: Recording, folds: int) -> Any:
    """Return the fold of each run: contiguous, of each class alike."""
    labels = np.array(recording.run_labels())
    numbers = np.zeros(len(labels), dtype=np.int64)
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        numbers[members] = np.arange(len(members)) * folds // len(members)
    return numbers


def _folds(whole: Recording, folds: int) -> list[int]:
    """Return the numbers of the fits of a candidate: of each fold, then of all data. Raises ConfigError for fewer runs
    of a class."""
    labels = whole.run_labels()
    count = min(map(labels.count, set(labels)))
    if count < folds:
        many = "1 run" if count == 1 else f"{count} runs"
        text = f"has {many} of one class; at least {folds} are needed for Split.folds {folds}"
        raise ConfigError(text, file=whole.source)
    return [*range(folds), -1]


# ---- evaluation ------------------------------------------------------------------------------------------------------


def _learned(
    candidate: CandidateClassifier, fits: Sequence[_Fitted], learning: Learning, data: LearningData, whole: Recording
) -> TrainedClassifier:
    """Set the threshold of a classifier from the folds, and evaluate it on all data."""
    *folds, final = fits
    known = data.known
    predicted = [(TRAIN, whole, final.predicted)]
    scores = None
    if folds:
        held = np.zeros(len(whole), dtype=np.int64)
        order = np.argsort(fold_numbers(whole, learning.folds)[whole.runs], kind="stable")
        held[order] = np.concatenate([fold.predicted for fold in folds])
        predicted.append((VALIDATION, whole, held))
        scores = run_scores(whole, held)
    threshold, note, calibration = set_threshold(candidate, learning, whole, scores)
    for item in data.testing:
        known_run = any(run_hash(run.values) in known for run in item)
        label = f"{TRAIN if known_run else TEST}: {item.source}"
        predicted.append((label, item, final.detector.predict(item)))
    late = _late(whole, learning.folds)
    model = model_of(candidate.name, final.detector, data, threshold, calibration, late)
    evaluations = tuple(
        Evaluation(name, recording, labels, tuple(run_scores(recording, labels)), threshold)
        for name, recording, labels in predicted
    )
    return TrainedClassifier(candidate, model, evaluations, note)


def model_of(
    name: str, detector: Any, data: LearningData, threshold: float, calibration: Calibration | None, late: int = 0
) -> Model:
    """Return the model of a fitted detector, `late` as of `_late`."""
    whole = data.both or data.benign
    assert whole is not None  # checked by `load`
    benign = whole.select([index for index, label in enumerate(whole.run_labels()) if label == BENIGN])
    return Model(
        name=name,
        joints=whole.joints,
        detector=detector,
        threshold=threshold,
        nominal=int(np.median([len(run) for run in benign])),
        reference=benign.select(range(min(_REFERENCE_RUNS, benign.count))).values,
        data=data_hash(*(item for item in (data.benign, data.both) if item is not None)),
        versions=versions(),
        calibration=calibration,
        band=_band(benign),
        conditions={
            RUN_HASHES: sorted(data.known),
            LEAST_MOVEMENT: _least_movement(benign),
            "drifts": drifts(_samples(benign)),
            "late": late,
            "longest": max(map(len, benign)),
        },
    )


def _least_movement(benign: Recording) -> list[float]:
    """Return the least standard deviation of each joint over a run; 0 of one that rests in one of them."""
    least = np.min([run.values.std(axis=0) for run in benign], axis=0)
    return [float(each) if each > STILL else 0.0 for each in least]


def _late(whole: Recording, folds: int) -> int:
    """Count the benign runs of the last fold that set the threshold: what judges them has learned from all before."""
    if not folds:
        return 0
    copied, numbers = copies(run_hash(run.values) for run in whole), fold_numbers(whole, folds)
    runs = enumerate(zip(whole.run_labels(), numbers.tolist(), strict=True))
    return sum(label == BENIGN and fold == folds - 1 and number not in copied for number, (label, fold) in runs)


def _samples(benign: Recording) -> list[Samples]:
    """Return the runs over the number of the point."""
    return [Samples(run.values, np.arange(len(run), dtype=np.float64), run.joints) for run in benign]


def _band(benign: Recording) -> Band:
    runs = _samples(benign)
    return Band.of(runs, [run.stamps for run in runs])
