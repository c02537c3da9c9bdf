"""Learning: every classifier of a learning file fitted and judged; the best of them as a model to store.

Each is judged three ways. *train*: on the very data that it learned from, which flatters, and says so. *validation*:
runs are put into contiguous folds, and each fold is judged by a classifier that never saw it; scaling and components
are learned anew without it too. *test*: the testing files, unless one holds training runs, which makes it train.

The threshold on the score of a run is the given number. ``auto`` is the lowest score over the held-out anomalous runs
(the largest value just below it), and must exceed the highest score of held-out benign ones.
The best is the one with the highest F1 of validation runs, then of validation points, then (without anomalous runs F1
is 0) with the highest accuracy; the first among equals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import candidates, fit, is_supervised, make, predict
from fame.monitor.anomaly.evaluation import TEST, TRAIN, VALIDATION, Judged, Learned, by_point, by_run, run_scores
from fame.monitor.anomaly.learning_file import Entry, Learning, Source
from fame.monitor.anomaly.model import Model, data_hash
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.preprocessing import DataProcess
from fame.monitor.anomaly.recording import BENIGN, Recording, read_csv, require_same_joints
from fame.monitor.storage import versions

_REFERENCE_RUNS = 3


class Progress(NamedTuple):
    """How far learning is: fits done and to do, what was fitted last, and the time left (s; None if unknown)."""

    done: int
    total: int
    name: str
    left: float | None


@dataclass(frozen=True, slots=True)
class Data:
    """What a learning file names. `process` is what scaling and components are learned from."""

    process: Recording | None
    benign: Recording | None
    both: Recording | None
    testing: tuple[Recording, ...]

    @property
    def all(self) -> list[Recording]:
        """Every recording there is."""
        return [item for item in (self.process, self.benign, self.both, *self.testing) if item is not None]

    @property
    def notes(self) -> list[str]:
        """What was odd about the files, each said once."""
        return list(dict.fromkeys(note for item in self.all for note in item.notes))


class _Task(NamedTuple):
    """One fit: of a candidate, without one fold (or with all, fold -1)."""

    entry: int
    fold: int


def read_data(learning: Learning) -> Data:
    """Read all files. Raises ConfigError, also if they are not of the same joints, or hold too few points."""
    cache: dict[Source, Recording] = {}

    def read(source: Source | None) -> Recording | None:
        if source is not None and source not in cache:
            cache[source] = read_csv(source.path, source.inputs, source.output)
        return None if source is None else cache[source]

    testing = [read(source) for source in learning.testing]
    data = Data(
        read(learning.fit), read(learning.unsupervised), read(learning.supervised),
        tuple(item for item in testing if item is not None),
    )  # fmt: skip
    require_same_joints(data.all)
    for item in (data.process, data.benign, data.both):
        if item is not None and len(item) <= len(item.joints):
            text = f"has {len(item)} points of {len(item.joints)} columns: more points than columns are needed"
            raise ConfigError(text, file=item.source)
    return data


def learn(
    learning: Learning,
    data: Data | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[Progress], object] | None = None,
) -> list[Learned]:
    """Fit and judge every classifier, `jobs` at a time. Raises ConfigError for data that cannot be learned from."""
    try:
        return _learn(learning, data or read_data(learning), jobs, progress)
    except ConfigError as error:  # of a classifier or a scaling, which know no file
        raise ConfigError(
            error.text, file=error.file or str(learning.file), line=error.line, element=error.element
        ) from None


def _learn(learning: Learning, data: Data, jobs: int, progress: Callable[[Progress], object] | None) -> list[Learned]:
    entries = list(candidates(learning))
    tasks = [_Task(number, fold) for number in range(len(entries)) for fold in _folds(entries[number], learning, data)]
    began, results = time.monotonic(), {}
    for done, (task, result) in enumerate(_run(tasks, entries, learning, data, jobs), start=1):
        results[task] = result
        if progress is not None:
            left = (time.monotonic() - began) / done * (len(tasks) - done)
            progress(Progress(done, len(tasks), entries[task.entry].name, left))
    return [_learned(number, entries[number], results, learning, data) for number in range(len(entries))]


def best(learned: Sequence[Learned]) -> Learned:
    """By the rule above; without validation by the training data, which the caller has to say."""

    def rank(item: Learned) -> tuple[float, ...]:
        judged = item.on(VALIDATION) or item.on(TRAIN)
        if judged is None:
            return (0.0,)
        return judged.runs.f1, judged.points.f1, judged.runs.accuracy, judged.points.accuracy

    return max((item for item in learned if not item.note), key=rank, default=max(learned, key=rank))


# ---- one fit ---------------------------------------------------------------------------------------------------------


class _Fitted(NamedTuple):
    """What a fit gives: the classifier (of the one with all data), and labels found in what was to be judged."""

    estimator: Any
    process: DataProcess | None
    predicted: Any


def _run(
    tasks: Sequence[_Task], entries: Sequence[Entry], learning: Learning, data: Data, jobs: int
) -> Iterator[tuple[_Task, _Fitted]]:
    """All fits, in order, `jobs` at a time in processes of their own."""
    if jobs == 1:
        yield from ((task, _fit(entries[task.entry], task.fold, learning, data)) for task in tasks)
        return
    from joblib import Parallel, delayed

    work = (delayed(_fit)(entries[task.entry], task.fold, learning, data) for task in tasks)
    yield from zip(tasks, Parallel(n_jobs=jobs, return_as="generator")(work), strict=True)


def _fit(entry: Entry, fold: int, learning: Learning, data: Data) -> _Fitted:
    """Fit without a fold and judge it; with all (fold -1) judge what was learned from."""
    estimator = make(entry, learning.file.parent)
    supervised = is_supervised(estimator)
    source = data.both if supervised else data.benign or data.both
    if source is None:
        missing = "supervised_train" if supervised else "unsupervised_train"
        raise ConfigError(f"the classifier {entry.name} needs Files.{missing}", file=str(learning.file))
    judged = data.both or source
    if fold >= 0:
        held = fold_numbers(judged, learning.folds) == fold
        source = _without(source, judged.select(np.flatnonzero(held).tolist()))
        judged = judged.select(np.flatnonzero(held).tolist())
    process = DataProcess(entry.reduction or 0, entry.scaling or learning.scaling)
    basis = source if fold >= 0 or data.process is None else data.process
    if not isinstance(estimator, PathDetector):
        process.fit(basis.values)
    fit(estimator, process, source, supervised=supervised, unique=entry.unique)
    kept = None if isinstance(estimator, PathDetector) else process
    return _Fitted(estimator if fold < 0 else None, kept, predict(estimator, kept, judged))


def fold_numbers(recording: Recording, folds: int) -> Any:
    """The fold of each run: contiguous, of each class alike."""
    labels = np.array(recording.run_labels())
    numbers = np.zeros(len(labels), dtype=np.int64)
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        numbers[members] = np.arange(len(members)) * folds // len(members)
    return numbers


def _without(source: Recording, held: Recording) -> Recording:
    """The runs that are not among the held-out ones (the same runs may stand in two files)."""
    out = {data_hash_of_run(run) for run in held}
    return source.select([number for number, run in enumerate(source) if data_hash_of_run(run) not in out])


def data_hash_of_run(run: Recording) -> str:
    """The same for the same points, wherever they stand."""
    return data_hash(replace(run, runs=run.runs[:0], labels=run.labels[:0]))


def _folds(entry: Entry, learning: Learning, data: Data) -> list[int]:
    judged = data.both or data.benign
    count = 0 if judged is None else min(judged.run_labels().count(label) for label in set(judged.run_labels()))
    if 0 < count < learning.folds:
        text = f"has {count} runs of one class; at least {learning.folds} are needed for Split.folds {learning.folds}"
        raise ConfigError(text, file=judged.source if judged is not None else "")
    return [*range(learning.folds), -1]


# ---- judging ---------------------------------------------------------------------------------------------------------


def _learned(number: int, entry: Entry, results: dict[_Task, _Fitted], learning: Learning, data: Data) -> Learned:
    final = results[_Task(number, -1)]
    whole = data.both or data.benign
    assert whole is not None
    held = _held_out([results[_Task(number, fold)].predicted for fold in range(learning.folds)], whole, learning.folds)
    threshold, note = _threshold(entry, whole, held)
    estimator, process = final.estimator, final.process
    judged = [_judge(TRAIN, whole, final.predicted, threshold)]
    if held is not None:
        judged.append(_judge(VALIDATION, whole, held, threshold))
    known = {data_hash_of_run(run) for source in (data.both, data.benign) if source is not None for run in source}
    for item in data.testing:
        seen = any(data_hash_of_run(run) in known for run in item)
        label = f"{TRAIN if seen else TEST}: {item.source}"
        judged.append(_judge(label, item, predict(estimator, process, item), threshold))
    benign = whole.select([index for index, label in enumerate(whole.run_labels()) if label == BENIGN])
    model = Model(
        name=entry.name,
        joints=whole.joints,
        estimator=estimator,
        process=process,
        threshold=threshold,
        nominal=int(np.median([len(run) for run in benign])),
        reference=benign.select(range(min(_REFERENCE_RUNS, benign.count))).values,
        data=data_hash(*(item for item in (data.benign, data.both) if item is not None)),
        versions=versions(),
    )
    return Learned(entry, model, tuple(judged), note)


def _held_out(parts: Sequence[Any], whole: Recording, folds: int) -> Any:
    """What was found in the folds, put back in the order of the recording; None without folds."""
    if not parts:
        return None
    point_folds = fold_numbers(whole, folds)[whole.runs]
    found = np.zeros(len(whole), dtype=np.int64)
    for fold, part in enumerate(parts):
        found[point_folds == fold] = part
    return found


def _judge(name: str, recording: Recording, predicted: Any, threshold: float) -> Judged:
    scores, labels = run_scores(recording, predicted), recording.run_labels()
    return Judged(name, by_point(recording, predicted), by_run(labels, scores, threshold), tuple(scores), tuple(labels))


def _threshold(entry: Entry, whole: Recording, held: Any) -> tuple[float, str]:
    """The threshold, and what is wrong with it."""
    if entry.threshold != "auto":
        return float(entry.threshold or 0.0), ""
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
