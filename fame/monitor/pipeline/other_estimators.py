"""Outlier detectors of scikit-learn and PyOD as detectors of windows: `EstimatorDetector`.

The features of a window are its scaled values, sample by sample. Which scores are unusual is never guessed: those of
scikit-learn are lower for unusual features (`score_samples`, and `decision_function` of an OutlierMixin), those of PyOD
are higher (`decision_function`). Others are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats

if TYPE_CHECKING:
    from fame.monitor.pipeline.training_settings import Training

_TINY = 1e-12
_MOST = 1e9
"""Loss of a score that is not finite."""
_USUAL = 0.99
"""Quantile of the scores of the training windows that has the loss 1."""


def shared(score: Floats, windows: Floats) -> Floats:
    """Return the share of each channel in a score (n,): all of it for the channel with the largest deviation."""
    energy = np.einsum("nwc,nwc->nc", windows, windows) + _TINY
    return np.asarray(score[:, None] * energy / energy.max(axis=1, keepdims=True))


@dataclass(frozen=True, slots=True)
class EstimatorDetector:
    """An estimator that was fitted, and the name of its class.

    The loss is its score, from 0 at `least`, the least of the training windows, in units of `unit`.
    """

    kind: ClassVar[str] = "estimator"
    name: str
    estimator: Any
    least: float
    unit: float

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        score = unusualness(self.estimator)(windows.reshape(len(windows), -1))
        loss = np.nan_to_num((score - self.least) / self.unit, nan=_MOST, posinf=_MOST)
        return shared(np.clip(loss, 0.0, _MOST), windows)

    @classmethod
    def fit(cls, estimator: Any, windows: Floats, settings: Training) -> EstimatorDetector:
        """Fit a copy of an estimator, with the seed of the settings if it has none. Raises ConfigError if it cannot."""
        from sklearn.base import clone

        features, name = windows.reshape(len(windows), -1), settings.detector or type(estimator).__name__
        unusualness(estimator)
        copy = clone(estimator)
        seeds = {key: settings.seed for key, value in copy.get_params().items() if _is_unset_seed(key, value)}
        try:
            fitted = copy.set_params(**seeds).fit(features)
            scores = unusualness(fitted)(features)
        except Exception as error:  # of other packages: any
            raise _refused(f"{name} cannot learn: {error}") from None
        scores = scores[np.isfinite(scores)]
        if not len(scores):
            raise _refused(f"{name} gives no window of the training a finite score")
        least = float(scores.min())
        return cls(name, fitted, least, max(float(np.quantile(scores, _USUAL)) - least, _TINY))


def _is_unset_seed(name: str, value: Any) -> bool:
    return name.rpartition("__")[2] == "random_state" and value is None


def unusualness(estimator: Any) -> Callable[[Floats], Floats]:
    """Return the function that scores features (n, features), higher for more unusual ones (n,).

    Raises ConfigError for an estimator whose scores are not known to be lower, or higher, for unusual features.
    """
    from sklearn.base import BaseEstimator, OutlierMixin

    if any(base.__module__.partition(".")[0] == "pyod" for base in type(estimator).__mro__):
        return lambda features: np.asarray(estimator.decision_function(features), dtype=np.float64)
    scikit_learn = isinstance(estimator, BaseEstimator) and hasattr(estimator, "fit")
    if scikit_learn and hasattr(estimator, "score_samples"):
        return lambda features: -np.asarray(estimator.score_samples(features), dtype=np.float64)
    if scikit_learn and isinstance(estimator, OutlierMixin) and hasattr(estimator, "decision_function"):
        return lambda features: -np.asarray(estimator.decision_function(features), dtype=np.float64)
    text = "expected an estimator of scikit-learn that has fit and score_samples, or is an OutlierMixin with "
    raise _refused(f"{text}decision_function, or a detector of PyOD, got {estimator!r}")


def estimator_of(name: str, parameters: Mapping[str, Any]) -> Any:
    """Make an estimator of scikit-learn by the dotted name of its class: a model holds no other one, and no other
    package is imported. Raises ConfigError for an unknown one, and for parameters that it does not take."""
    require("sklearn")
    from sklearn.base import BaseEstimator

    module, _, cls = name.rpartition(".")
    if module.partition(".")[0] != "sklearn":
        raise _refused(
            f"{name} is no class of scikit-learn, and models hold no others; fame.monitor.Detector compares them"
        )
    try:
        kind = getattr(import_module(module), cls, None)
    except ImportError as error:
        raise _refused(f"{name}: {error}") from None
    if not (isinstance(kind, type) and issubclass(kind, BaseEstimator)):
        raise _refused(f"{name} is no class of an estimator")
    try:
        estimator = kind(**parameters)
    except Exception as error:  # of another package: any
        raise _refused(f"{name} does not take these Parameters: {error}") from None
    unusualness(estimator)
    return estimator


def _refused(text: str) -> ConfigError:
    """Return an error of one line about the detector of a training."""
    return ConfigError(" ".join(text.split()), element="Training.detector")
