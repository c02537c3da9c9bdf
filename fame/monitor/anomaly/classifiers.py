"""Classifiers by name, those of scikit-learn and PathDetector: made from a learning file, fitted, evaluated.

`AnomalyDetector` and `OutputMatrix` are published roles. Labels are +1 benign, -1 anomalous; positive means anomalous.
A run is anomalous if its anomaly score, its anomalous points divided by all its points, exceeds the threshold.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from math import inf
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.anomaly.benign_changes import PathParameters
from fame.monitor.anomaly.learning_file import DEFAULTS as DEFAULTS, CandidateClassifier, Learning
from fame.monitor.anomaly.model import DataProcess, Model, PointClassifier
from fame.monitor.anomaly.paths import MARGIN, PathDetector
from fame.monitor.anomaly.recording import ANOMALOUS, BENIGN, Recording
from fame.monitor.kinematics import load_chain

_MODULES = {
    "svm": ("SVC", "NuSVC", "LinearSVC", "OneClassSVM"),
    "ensemble": ("IsolationForest", "RandomForestClassifier", "HistGradientBoostingClassifier"),
    "neighbors": ("KNeighborsClassifier", "LocalOutlierFactor"),
    "covariance": ("EllipticEnvelope",),
    "linear_model": ("LogisticRegression", "SGDClassifier", "SGDOneClassSVM"),
    "neural_network": ("MLPClassifier",),
    "tree": ("DecisionTreeClassifier",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def _chain_file(named: str, folder: Path) -> Path:
    """The file of an arm's kinematics: beside the configuration, or data of a package (``robots.arm:mh5.yaml``)."""
    package, colon, file = named.partition(":")
    top, *parts = package.split(".")
    spec = find_spec(top) if colon and top.isidentifier() else None  # which imports nothing
    if spec is not None and spec.submodule_search_locations:
        return Path(spec.submodule_search_locations[0], *parts, file)
    return folder / named


def make(candidate: CandidateClassifier, folder: Path, scaling: str = "minmax") -> PathDetector | PointClassifier:
    """Make the detector of a candidate, with a `scaling` if it has none. Raises ConfigError for a wrong one."""
    if candidate.cls == "PathDetector":
        parameters = dict(candidate.parameters)
        chain = parameters.pop("chain", None)
        if chain is None:
            raise candidate.error("parameters", "expected the key chain: the arm's kinematics, for PathDetector")
        margin = parameters.pop("margin", MARGIN)
        if type(margin) not in (int, float) or not 0 < margin < inf:
            raise candidate.error("parameters.margin", f"expected a number above 0, got {margin!r}")
        if not isinstance(chain, dict):
            named, chain = str(chain), _chain_file(str(chain), folder)
            if not isfile(chain):
                text = f"expected a file, or package:file as in robots.arm:mh5.yaml, got {named!r}"
                raise candidate.error("parameters.chain", text)
        return PathDetector(load_chain(chain), margin, _build(PathParameters, candidate, parameters))
    module = _HOMES.get(candidate.cls.rpartition(".")[2])
    if module is None:
        known = ", ".join(sorted([*_HOMES, "PathDetector"]))
        raise candidate.error("class", f"expected one of {known}, got {candidate.cls!r}")
    require("sklearn")
    cls = getattr(import_module(f"sklearn.{module}"), candidate.cls.rpartition(".")[2])
    defaults: dict[str, Any] = {"novelty": True} if candidate.cls.endswith("LocalOutlierFactor") else {}
    if "random_state" in inspect.signature(cls).parameters:
        defaults["random_state"] = 0  # the same data, the same model
    process = DataProcess(candidate.reduction or 0, candidate.scaling or scaling)
    return PointClassifier(
        _build(cls, candidate, {**defaults, **candidate.parameters}), process, unique=candidate.unique
    )


def _build(cls: Any, candidate: CandidateClassifier, parameters: dict[str, Any]) -> Any:
    try:
        return cls(**parameters)
    except TypeError as error:
        raise candidate.error("parameters", f"expected the parameters of {candidate.cls}: {error}") from None


def expand_candidates(learning: Learning) -> Iterator[CandidateClassifier]:
    """Yield every classifier to try, with its parameters and reduction: the candidates, multiplied by the grid."""
    for candidate in learning.classifiers or _defaults(learning):
        own = dict(learning.grid.get(candidate.name, {}))
        reductions = own.pop("reduction", None)
        if reductions is None:
            fixed = learning.reduction if candidate.reduction is None else candidate.reduction
            reductions = learning.grid.get("reduction", [fixed]) if candidate.reduction is None else [fixed]
        reductions = [0] if candidate.cls == "PathDetector" or candidate.combined else reductions
        names = sorted(own)
        for reduction, *values in product(reductions, *(own[name] for name in names)):
            chosen = dict(zip(names, values, strict=True))
            label = ", ".join([f"{name} {value}" for name, value in chosen.items()])
            several = len(reductions) > 1
            name = " ".join(part for part in (candidate.name, label, f"pca {reduction}" if several else "") if part)
            yield replace(
                candidate, name=name, parameters={**candidate.parameters, **chosen}, reduction=reduction,
                scaling=candidate.scaling or learning.scaling, threshold=_threshold(candidate, learning),
            )  # fmt: skip


def _defaults(learning: Learning) -> Iterator[CandidateClassifier]:
    """Yield those that the learning file names data for (no ``name: Null``), with its reduction if it has one."""
    named = {"ocsvm": learning.unsupervised, "rbfsvm": learning.supervised}
    reduced = learning.reduction or "reduction" in learning.grid
    for candidate in DEFAULTS:
        if named[candidate.name] is not None:
            yield replace(candidate, reduction=None) if reduced else candidate


def _threshold(candidate: CandidateClassifier, learning: Learning) -> Any:
    if candidate.combined and candidate.threshold in (None, "auto"):
        return 1.0  # in units of the thresholds of its members
    return learning.threshold if candidate.threshold is None else candidate.threshold


Named: TypeAlias = tuple[str, Any]
"""A classifier: its name, and an estimator of scikit-learn."""


class AnomalyDetector:
    """The published role. Unsupervised classifiers learn from benign points, supervised ones from both kinds."""

    def __init__(self, unsupervised: Sequence[Named], supervised: Sequence[Named], process: DataProcess) -> None:
        self._unsupervised, self._supervised = (
            {name: PointClassifier(classifier, process) for name, classifier in models}
            for models in (unsupervised, supervised)
        )

    @property
    def parts(self) -> dict[str, PointClassifier]:
        """All classifiers by name."""
        return {**self._unsupervised, **self._supervised}

    def train_unsupervised(self, data: Recording) -> None:
        """Fit each to the benign points. Raises ConfigError without benign points."""
        for detector in self._unsupervised.values():
            fit(detector, data)

    def train_supervised(self, data: Recording) -> None:
        """Fit each to points of both kinds. Raises ConfigError if there is only one."""
        for detector in self._supervised.values():
            fit(detector, data)

    def classify_unsupervised(self, data: Recording) -> dict[str, Any]:
        return {name: detector.predict(data) for name, detector in self._unsupervised.items()}

    def classify_supervised(self, data: Recording) -> dict[str, Any]:
        return {name: detector.predict(data) for name, detector in self._supervised.items()}

    def evaluate(self, data: Recording) -> dict[str, ConfusionMatrix]:
        """Return the confusion matrix of points of each classifier, by name."""
        found = {**self.classify_unsupervised(data), **self.classify_supervised(data)}
        return {name: by_point(data, predicted) for name, predicted in found.items()}


def fit(detector: PathDetector | PointClassifier, data: Recording) -> None:
    """Fit a supervised detector to all points, another to the benign ones. Raises ConfigError for data that lack one of
    them, and for what the detector refuses."""
    present = set(data.labels.tolist())
    if detector.supervised and present != {BENIGN, ANOMALOUS}:
        kind = "benign" if BENIGN in present else "anomalous"
        text = f"has {kind} points only (label {min(present)}); a supervised classifier needs both"
        raise ConfigError(text, file=data.source)
    if not detector.supervised:
        data = data.select([number for number, label in enumerate(data.run_labels()) if label == BENIGN])
    if not len(data):
        raise ConfigError("has no benign points (label 1) to learn from", file=data.source)
    detector.fit(data)


class ConfusionMatrix(NamedTuple):
    """Counts of points or runs."""

    tp: int
    fp: int
    tn: int
    fn: int

    @property
    def accuracy(self) -> float:
        return _ratio(self.tp + self.tn, sum(self))

    @property
    def recall(self) -> float:
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def precision(self) -> float:
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def f1(self) -> float:
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn)

    @property
    def ratios(self) -> dict[str, float]:
        """Accuracy, recall, precision and F1, by name."""
        return {name: getattr(self, name) for name in ("accuracy", "recall", "precision", "f1")}

    @property
    def cells(self) -> tuple[str, ...]:
        """Counts and ratios, under those of `HEADS`."""
        return (*map(str, self), *(f"{ratio:.4f}" for ratio in self.ratios.values()))


class OutputMatrix:
    """The published role."""

    def output_matrix(self, true_y: Any, pred_y: Any) -> ConfusionMatrix:
        """Return the matrix of true and predicted labels (+1 benign, -1 anomalous), of points or of runs."""
        true, found = (np.asarray(labels).ravel() == ANOMALOUS for labels in (true_y, pred_y))
        counts = ((true & found), (~true & found), (~true & ~found), (true & ~found))
        return ConfusionMatrix(*(int(part.sum()) for part in counts))


def run_scores(recording: Recording, predicted: Any) -> list[float]:
    """Return the anomaly score of each run: its anomalous points divided by all its points."""
    return [float(np.mean(predicted[rows] == ANOMALOUS)) for rows in recording.slices()]


def by_point(recording: Recording, predicted: Any) -> ConfusionMatrix:
    return OutputMatrix().output_matrix(recording.labels, predicted)


def by_run(labels: Sequence[int], scores: Sequence[float], threshold: float) -> ConfusionMatrix:
    """Return the confusion matrix of runs, which are anomalous if their score exceeds the threshold."""
    return OutputMatrix().output_matrix(labels, [-1 if score > threshold else 1 for score in scores])


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


TRAIN, VALIDATION, TEST = "train", "validation", "test"


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Results of a classifier on some data: the labels (points,) that it gave them, and the score of each run."""

    data: str
    recording: Recording = field(repr=False, compare=False)
    predicted: Any = field(repr=False, compare=False)
    scores: tuple[float, ...]
    threshold: float

    @property
    def labels(self) -> list[int]:
        """The true label of each run."""
        return self.recording.run_labels()

    @property
    def points(self) -> ConfusionMatrix:
        return by_point(self.recording, self.predicted)

    @property
    def runs(self) -> ConfusionMatrix:
        return by_run(self.labels, self.scores, self.threshold)


@dataclass(frozen=True, slots=True)
class TrainedClassifier:
    """A classifier with its model and its evaluations. `note` names what is doubtful about it."""

    candidate: CandidateClassifier
    model: Model
    evaluations: tuple[Evaluation, ...]
    note: str = ""

    def on(self, data: str) -> Evaluation | None:
        return next((item for item in self.evaluations if item.data == data), None)


HEADS = ("", "classifier", "data", "of", "TP", "FP", "TN", "FN", "accuracy", "recall", "precision", "F1", "threshold")
LEARNED_FROM = "train (learned from)"


def rows(learned: Sequence[TrainedClassifier], chosen: TrainedClassifier | None = None) -> list[tuple[str, ...]]:
    """Return the cells of the table, under `HEADS`. Data that was learned from is marked."""
    return [
        (
            "*" if item is chosen else "",
            item.candidate.name,
            data_name(evaluation),
            kind,
            *matrix.cells,
            f"{item.model.threshold:.4g}",
        )
        for item in learned
        for evaluation in item.evaluations
        for kind, matrix in (("points", evaluation.points), ("runs", evaluation.runs))
    ]


def plain(learned: Sequence[TrainedClassifier], chosen: TrainedClassifier) -> list[dict[str, Any]]:
    """Return the results of `rows` as plain data for JSON."""
    return [
        {
            "name": item.candidate.name,
            "class": item.candidate.cls,
            "parameters": dict(item.candidate.parameters),
            "reduction": item.candidate.reduction,
            "threshold": item.model.threshold,
            "best": item is chosen,
            "note": item.note,
            "results": [
                {"data": data_name(each), "points": _plain(each.points), "runs": _plain(each.runs)}
                for each in item.evaluations
            ],
        }
        for item in learned
    ]


def data_name(evaluation: Evaluation) -> str:
    return evaluation.data.replace(TRAIN, LEARNED_FROM, 1) if evaluation.data.startswith(TRAIN) else evaluation.data


def _plain(matrix: ConfusionMatrix) -> dict[str, float]:
    return {**matrix._asdict(), **matrix.ratios}
