"""Interface: what a learning script talks to, in the published four steps.

::

    interface = Interface("learning.yaml")
    interface.genmodel_train([("ocsvm", OneClassSVM(nu=0.5, gamma=1000))], [("rbfsvm", SVC(gamma=5, C=10))])
    unsupervised, supervised = interface.get_testing_predictions()
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import AnomalyDetector, Named
from fame.monitor.anomaly.evaluation import HEADS, ConfusionMatrix, by_point, render
from fame.monitor.anomaly.learn import LearningData, read_data
from fame.monitor.anomaly.learning_file import Learning, load
from fame.monitor.anomaly.model import DataPersist, data_hash
from fame.monitor.anomaly.preprocessing import DataProcess


class Interface:
    """Reads the learning file, fits scaling and components to `fit_file`, and keeps them in `folder` if it is given.

    What the folder holds from earlier is taken if it was made from the same data, and made anew if not.
    Raises ConfigError.
    """

    learning: Learning
    data: LearningData
    persist: DataPersist | None
    process: DataProcess
    detector: AnomalyDetector

    def __init__(self, file: str | Path, folder: str | Path | None = None, out: TextIO | None = None) -> None:
        self.learning = load(file)
        self.data = read_data(self.learning)
        self.persist = DataPersist(folder) if folder is not None else None
        self.process = self._process()
        self.detector = AnomalyDetector([], [], self.process)
        self._out = out or sys.stdout
        for note in self.data.notes:
            print(note, file=self._out)

    def genmodel_train(self, unsupervised_models: Sequence[Named], supervised_models: Sequence[Named]) -> None:
        """Train classifiers, each (name, estimator). Raises ConfigError if data for a kind is missing."""
        data = self.data
        self.detector = AnomalyDetector(unsupervised_models, supervised_models, self.process)
        for kind, models, source in (
            ("unsupervised_train", unsupervised_models, data.benign),
            ("supervised_train", supervised_models, data.both),
        ):
            if models and source is None:
                raise ConfigError("needs a file for these classifiers", file=str(self.learning.file), element=kind)
        if data.benign is not None:
            self.detector.train_unsupervised(data.benign)
        if data.both is not None:
            self.detector.train_supervised(data.both)
        for source in (data.benign, data.both):
            if source is not None:
                self._show(source.source, self.detector.evaluate(source), "train (learned from)")

    def get_testing_predictions(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """For unsupervised and supervised classifiers: per testing file, the labels (points,) by name."""
        unsupervised, supervised = [], []
        for data in self.data.testing:
            unsupervised.append(self.detector.classify_unsupervised(data))
            supervised.append(self.detector.classify_supervised(data))
            found = {**unsupervised[-1], **supervised[-1]}
            self._show(data.source, {name: by_point(data, labels) for name, labels in found.items()}, "testing")
        return unsupervised, supervised

    def _process(self) -> DataProcess:
        source = self.data.process or self.data.benign or self.data.both
        assert source is not None  # `load` asked for one
        learning = self.learning
        if self.persist is None:
            return DataProcess(learning.reduction, learning.scaling).fit(source.values)
        origin = f"{data_hash(source)}-{learning.reduction}-{learning.scaling}"
        try:
            scaler, pca = self.persist.retrieve("process", origin)
            return DataProcess(learning.reduction, learning.scaling, scaler, pca)
        except ConfigError:  # not there yet, or made from other data
            process = DataProcess(learning.reduction, learning.scaling).fit(source.values)
            self.persist.save("process", [process.scaler, process.pca], origin)
            return process

    def _show(self, source: str, found: dict[str, ConfusionMatrix], kind: str) -> None:
        lines = [
            (name, kind, source, *map(str, matrix), *(f"{part:.4f}" for part in _ratios(matrix)))
            for name, matrix in found.items()
        ]
        if lines:
            print(render(lines, ("classifier", "data", "file", *HEADS[4:12])), file=self._out)


def _ratios(matrix: ConfusionMatrix) -> tuple[float, float, float, float]:
    return matrix.accuracy, matrix.recall, matrix.precision, matrix.f1
