"""Processors that were learned: any estimator or transformer of scikit-learn, and autoencoders."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.cycles import phases_of
from fame.monitor.pipeline.elements import active, foreign, phase_times
from fame.monitor.pipeline.filters import Windower
from fame.monitor.pipeline.processor import ActiveElements, Parameter, Processor, Result, Samples, stacked
from fame.monitor.pipeline.run_finder import RunFinder, Spans, inside
from fame.monitor.pipeline.trained_model import TrainedModel

OUTSIDE = "outside of every run, or longer than any run of the training: not judged"
GAP = 2.0
_METHODS = ("predict", "transform", "decision_function", "score_samples", "predict_proba")


class Autoencoder(Processor):
    """The loss of each window and channel by a trained model (`TrainedModel.loss`), of any detector.

    A run begins with the first sample, and with the first after a `gap`; phases count from there.

    `elements` tells which elements of the mission were active when. Windows in one that no training run had are left
    out, and those without an alarm in which a channel hardly moves, as it never did in training.

    All inputs together are the channels. Data that name their channels are matched to the model's columns by name;
    others are taken in order. `model` may be a TrainedModel in memory.
    """

    trained: TrainedModel

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("model", "file", "", description="file of the trained model", fixed=True),
        Parameter("stride", "int", 5, (1, None), "samples", "from one window to the next"),
        Parameter("gap", "float", GAP, (0, None), "s", "between two samples, after which a run begins"),
    )
    outputs: tuple[str, ...] = ("loss",)
    model: str
    stride: int
    gap: float

    elements: ActiveElements = ()
    cycles: bool = True
    """Whether runs are looked for in the data; otherwise all samples up to a gap are one run."""
    runs: Spans | None = None
    """From when to when (s) runs last, if a trigger tells; windows outside of them are left out."""
    blind: str = ""
    """Why the last windows were not judged."""

    def __init__(self, model: str | Path | TrainedModel = "", **values: Any) -> None:
        super().__init__(**values)
        if not model:
            raise ConfigError("needs the file of a trained model", element="model")
        self.trained = model if isinstance(model, TrainedModel) else TrainedModel.load(model)
        self.model = "" if isinstance(model, TrainedModel) else str(model)
        self._windower = Windower()
        self._begun = self._last = np.inf
        detector = phases_of(self.trained.detector)
        self._finder = RunFinder(detector, self.trained, self.stride / self.trained.rate) if detector else None

    @property
    def latest(self) -> float:
        """How late (s) a run may begin without a fault."""
        return self._finder.latest if self._finder is not None and not self.trained.elements else 0.0

    @property
    def longest(self) -> float:
        """How long (s) a run may last; inf where a detector does not know the time since its begin."""
        return self._finder.longest if self._finder is not None and not self.trained.elements else np.inf

    @property
    def needs_elements(self) -> bool:
        """Whether the model knows phases by the elements of a mission."""
        return bool(self.trained.elements)

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples, trained = stacked(inputs), self.trained
        if not len(samples):
            return None
        samples = _in_order(samples, trained.columns)
        begins = self._begins(samples.stamps)
        windows = self._windower.feed(samples, trained.window, self.stride, trained.rate, self._not_judged)
        if not len(windows):
            return None
        if trained.elements:
            return self._judge_elements(windows)
        if self._finder is None:
            return self._judge_inside(windows)
        self._finder.searched, self._finder.spans = self.cycles, self.runs
        kept, outside = self._finder.feed(
            windows.values, windows.stamps, begins[np.searchsorted(samples.stamps, windows.stamps)]
        )
        if outside:
            self.report(OUTSIDE)
        if not kept:
            return None
        values, stamps, times = (np.array(each) for each in zip(*kept, strict=True))
        return self._moving(windows.replace(values, stamps), trained.loss(values, times))

    def _judge_inside(self, windows: Samples) -> Result:
        """Judge windows by a detector that does not know the time since a run began."""
        kept = inside(windows.stamps, self.trained.window / self.trained.rate, self.runs)
        if not kept.all():
            self.report(OUTSIDE)
        if not kept.any():
            return None
        windows = windows.replace(windows.values[kept], windows.stamps[kept])
        return self._moving(windows, self.trained.loss(windows.values))

    def _moving(self, windows: Samples, loss: Floats) -> Result:
        """Return the loss of the windows but those that it says nothing about: a dead sensor fits every detector."""
        still = self.trained.still(windows.values)
        out = still.any(axis=1) & (loss <= self.trained.thresholds).all(axis=1)
        for channel in np.flatnonzero(still[out].any(axis=0)):
            self._not_judged(f"{self.trained.columns[channel]} hardly moves: not judged")
        if out.all():
            return None
        self.blind = ""
        return {"loss": windows.replace(loss[~out], windows.stamps[~out])}

    def _not_judged(self, text: str) -> None:
        self.blind = text
        self.report(text)

    def _judge_elements(self, windows: Samples) -> Result:
        axis = self.trained.elements
        strange = foreign(windows.stamps, self.elements, axis)
        for name in np.unique(active(windows.stamps[strange], self.elements)[0]):
            self._not_judged(f"no training run had the element {name}: not judged")
        known = windows.replace(windows.values[~strange], windows.stamps[~strange])
        if not len(known):
            return None
        times = phase_times(known.stamps, self.elements, axis)
        return self._moving(known, self.trained.loss(known.values, times))

    def _begins(self, stamps: Floats) -> Floats:
        """Return the stamp of the first sample of the run of each sample."""
        before = np.concatenate(([self._last], stamps[:-1]))
        first = ~(stamps - before <= self.gap) | ~np.isfinite(before)
        places = np.maximum.accumulate(np.where(first, np.arange(len(stamps)), -1))
        begins = np.where(places < 0, self._begun, stamps[places])
        self._begun, self._last = float(begins[-1]), float(stamps[-1])
        return begins


def _in_order(samples: Samples, columns: tuple[str, ...]) -> Samples:
    """Return the channels in the order of the columns, by name if they have any. Raises ValueError for others."""
    values, names = samples.channels(), samples.names
    if names != columns and _named(names):
        if not set(columns) <= set(names) or len(set(names)) < len(names):
            raise ValueError(f"the model was trained on {', '.join(columns)}; the data are {', '.join(names)}")
        values = values[:, [names.index(column) for column in columns]]
    elif values.shape[1] != len(columns):
        raise ValueError(f"the model was trained on {', '.join(columns)}; the data are {values.shape[1]} channels")
    return samples.replace(values=values, names=columns)


def _named(names: tuple[str, ...]) -> bool:
    """Return whether channels have names, not numbers alone."""
    return bool(names) and not all(name.rpartition(".")[2].isdecimal() for name in names)


class Estimator(Processor):
    """Applies an estimator or transformer of scikit-learn to each sample, or to each window of samples.

    The file is one that skops stored. With a window, its samples and channels are the features, sample by sample.
    Without one, channels are matched by name to the features of an estimator that knows all of their names.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("model", "file", "", description="file of the estimator, stored by skops", fixed=True),
        Parameter("method", "str", "predict", _METHODS, description="method of the estimator"),
        Parameter("window", "int", 1, (1, None), "samples", "whose values are the features"),
        Parameter("stride", "int", 1, (1, None), "samples", "from one window to the next"),
    )
    outputs: tuple[str, ...] = ("value",)
    model: str
    window: int
    stride: int
    estimator: Any = None

    def __init__(self, model: Any = "", **values: Any) -> None:
        super().__init__(**values)
        if isinstance(model, (str, Path)):
            if not str(model):
                raise ConfigError("needs the file of an estimator", element="model")
            self.model, model = str(model), load_estimator(model)
        self.estimator = model
        self.method = self._method
        self._windower = Windower()

    @property
    def method(self) -> str:
        """The method that is called. Setting one that the estimator lacks raises ConfigError."""
        return self._method

    @method.setter
    def method(self, name: str) -> None:
        if self.estimator is not None and not hasattr(self.estimator, name):
            able = ", ".join(each for each in _METHODS if hasattr(self.estimator, each))
            raise ConfigError(
                f"expected a method of {type(self.estimator).__name__} ({able}), got {name!r}", element="method"
            )
        self._method = name

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        if not len(samples):
            return None
        names = tuple(getattr(self.estimator, "feature_names_in_", ())) if self.window == 1 else ()
        if names and set(names) <= set(samples.names):
            samples = _in_order(samples, names)
        elif names:
            self.report(f"the features are {', '.join(names)}, the channels have other names: taken in order")
        samples = samples.replace(values=samples.channels())
        windows = self._windower.feed(samples, self.window, self.stride, 0.0, self.report)
        if not len(windows):
            return None
        features = windows.values.reshape(len(windows), -1)
        expected = getattr(self.estimator, "n_features_in_", features.shape[1])
        if features.shape[1] != expected:
            raise ValueError(f"the estimator was trained on {expected} features; the data are {features.shape[1]}")
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "X does not have valid feature names")  # an array has none
            result = getattr(self.estimator, self.method)(features)
        values = np.asarray(result.toarray() if hasattr(result, "toarray") else result)  # of a sparse matrix
        if len(values) != len(windows):
            raise ValueError(
                f"expected a value for each of {len(windows)} samples, got an array of shape {values.shape}"
            )
        return {"value": Samples(values, windows.stamps)}


def load_estimator(path: str | Path) -> Any:
    """Load an estimator that skops stored, or an ONNX model.

    Raises ConfigError for anything else, and for what could run code.
    """
    from fame.monitor.pipeline.onnx_files import OnnxEstimator
    from fame.monitor.storage import read_artefact

    if str(path).endswith(".onnx"):
        return OnnxEstimator(path)

    content = read_artefact(Path(path), "scikit-learn")
    if not hasattr(content, "get_params"):
        raise ConfigError(f"expected an estimator of scikit-learn, got {type(content).__name__}", file=str(path))
    return content
