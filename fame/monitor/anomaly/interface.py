"""The published roles of a learning script: `Interface` trains the classifiers of the script and stores each.

::

    interface = Interface("learning.yaml")
    interface.genmodel_train([("ocsvm", OneClassSVM(nu=0.5, gamma=1000))], [("rbfsvm", SVC(gamma=5, C=10))])
    unsupervised, supervised = interface.get_testing_predictions()

The threshold of a stored classifier is set as by ``fame monitor adm learn``, but from the runs of the testing files
instead of those that are held out.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import HEADS, AnomalyDetector, ConfusionMatrix, Named, by_point, run_scores
from fame.monitor.anomaly.learn import LearningData, model_of, read_data
from fame.monitor.anomaly.learning_file import CandidateClassifier, Learning, load
from fame.monitor.anomaly.model import DataPersist, DataProcess, data_hash
from fame.monitor.anomaly.recording import BENIGN, Recording, join
from fame.monitor.anomaly.thresholds import set_threshold
from fame.monitor.calibration import Calibration
from fame.monitor.copies import run_hash
from fame.monitor.model_card import origin_of, write_card
from fame.text import table

_FILE_NAME = re.compile(r"\w[\w .,=+-]*")


class Interface:
    """Reads the learning file, and fits scaling and components to `fit_file`.

    With a `folder`, these are kept there, and taken again if they were made from the same data. Classifiers are stored
    there, or in the working directory. Raises ConfigError.
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
        self._folder = Path(folder or "")
        self._predicted: list[tuple[dict[str, Any], dict[str, Any]]] | None = None
        for note in self.data.notes:
            print(note, file=self._out)

    def genmodel_train(self, unsupervised_models: Sequence[Named], supervised_models: Sequence[Named]) -> None:
        """Train classifiers, each (name, estimator), and store each as NAME.skops for ``fame monitor adm operate``.

        A kind without a file is not trained, and this is printed. Raises ConfigError if no kind can be, and for names
        that are not unique or not those of files.
        """
        names = [name for name, _ in (*unsupervised_models, *supervised_models)]
        wrong = [name for name in names if names.count(name) > 1 or not _FILE_NAME.fullmatch(name)]
        if wrong:
            raise ConfigError(f"expected unique names that a file can have, got {wrong[0]!r}", element="genmodel_train")
        data = self.data
        unsupervised = self._trainable("unsupervised_train", unsupervised_models, data.benign or data.both)
        supervised = self._trainable("supervised_train", supervised_models, data.both)
        if names and not unsupervised and not supervised:
            raise ConfigError("names no file to train these classifiers from", file=str(self.learning.file))
        self.detector = AnomalyDetector(unsupervised, supervised, self.process)
        if unsupervised and (benign := data.benign or data.both) is not None:
            self.detector.train_unsupervised(benign)
        if supervised and data.both is not None:
            self.detector.train_supervised(data.both)
        for source in (data.benign, data.both):
            if source is not None:
                self._show(source.source, self.detector.evaluate(source), "train (learned from)")
        self._predicted = None
        for name in self.detector.parts:
            self._store(name)

    def get_testing_predictions(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Return, for unsupervised and supervised classifiers, the labels (points,) by name for each testing file."""
        predictions = self._predictions()
        for data, (unsupervised, supervised) in zip(self.data.testing, predictions, strict=True):
            found = {**unsupervised, **supervised}
            self._show(data.source, {name: by_point(data, labels) for name, labels in found.items()}, "testing")
        return [each for each, _ in predictions], [each for _, each in predictions]

    def _trainable(self, kind: str, models: Sequence[Named], source: Recording | None) -> Sequence[Named]:
        if source is not None or not models:
            return models
        names = ", ".join(name for name, _ in models)
        print(f"{self.learning.file}: Files.{kind} names no file: not trained: {names}", file=self._out)
        return []

    def _predictions(self) -> list[tuple[dict[str, Any], dict[str, Any]]]:
        """Judge the testing files, once for the thresholds and for the script."""
        if self._predicted is None:
            unsupervised, supervised = self.detector.classify_unsupervised, self.detector.classify_supervised
            self._predicted = [(unsupervised(each), supervised(each)) for each in self.data.testing]
        return self._predicted

    def _store(self, name: str) -> None:
        threshold, note, calibration = self._threshold(name)
        path = self._folder / f"{name}.skops"
        try:
            model = model_of(name, self.detector.parts[name], self.data, threshold, calibration)
            model = replace(model, conditions={**model.conditions, **origin_of(path)})
            model.save(path)
            write_card(model, path)
            text = f"{path}: {model.alarm_text()}"
        except ConfigError as error:  # of an estimator that could not be read back
            text = str(error)
        print(f"{text}; {note}" if note else text, file=self._out)

    def _threshold(self, name: str) -> tuple[float, str, Calibration | None]:
        """Return the threshold on the score of a run, what is doubtful about it, and its calibration."""
        candidate = CandidateClassifier(name, "", threshold=self.learning.threshold)
        judged = [
            (data, {**unsupervised, **supervised}[name])
            for data, (unsupervised, supervised) in zip(self.data.testing, self._predictions(), strict=True)
            if not any(run_hash(run.values) in self.data.known for run in data)
        ]
        scores = [score for data, labels in judged for score in run_scores(data, labels)]
        whole = join([data for data, _ in judged]) if judged else self.data.both or self.data.benign
        assert whole is not None  # checked by `load`
        try:
            return set_threshold(candidate, self.learning, whole, scores if judged else None)
        except ConfigError as error:
            if not judged:
                scores = run_scores(whole, self.detector.parts[name].predict(whole))
            benign = [score for score, label in zip(scores, whole.run_labels(), strict=True) if label == BENIGN]
            runs = "testing" if judged else "training"
            note = (
                f"threshold of the benign {runs} runs: there are no anomalous testing runs that were not learned from"
            )
            return max(benign, default=0.0), note if self.learning.threshold == "auto" else error.text, None

    def _process(self) -> DataProcess:
        source = self.data.process or self.data.benign or self.data.both
        assert source is not None  # checked by `load`
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
        lines = [(name, kind, source, *matrix.cells) for name, matrix in found.items()]
        if lines:
            print(table(("classifier", "data", "file", *HEADS[4:12]), lines), file=self._out)
