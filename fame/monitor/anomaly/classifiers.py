"""Classifiers by name: those of scikit-learn, and PathDetector; those that are tried if a learning file names none."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

from fame.errors import ConfigError, UnavailableError
from fame.monitor.anomaly.chain import load_chain
from fame.monitor.anomaly.config import Entry, Learning
from fame.monitor.anomaly.paths import PathDetector

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

DEFAULTS = (
    Entry("ocsvm", "OneClassSVM", {"nu": 0.05, "gamma": 1000}, reduction=0, threshold=0.22, unique=True),
    Entry("rbfsvm", "SVC", {"gamma": 20000, "C": 1000, "tol": 0.01, "cache_size": 400}, reduction=3, threshold=0.01),
)
"""Gamma is per squared unit of columns scaled to 0 ... 1."""


def make(entry: Entry, folder: Path) -> Any:
    """The estimator of an entry. Raises ConfigError for a class that is not known, or parameters it does not take."""
    if entry.cls == "PathDetector":
        parameters = dict(entry.parameters)
        chain = parameters.pop("chain", None)
        if chain is None:
            raise ConfigError("PathDetector needs the parameter chain: the arm's kinematics", element=entry.name)
        margin = parameters.get("margin", 1.0)
        if type(margin) not in (int, float) or not 0 < margin < inf:
            raise ConfigError(f"found the margin {margin!r}; a number above 0 would be right", element=entry.name)
        chain = chain if isinstance(chain, dict) else folder / str(chain)
        return _build(PathDetector, entry, {"chain": load_chain(chain), **parameters})
    module = _HOMES.get(entry.cls.rpartition(".")[2])
    if module is None:
        known = ", ".join(sorted([*_HOMES, "PathDetector"]))
        raise ConfigError(f"found the class {entry.cls!r}; known are {known}", element=entry.name)
    try:
        cls = getattr(import_module(f"sklearn.{module}"), entry.cls.rpartition(".")[2])
    except ImportError:
        raise UnavailableError("learning needs scikit-learn: pip install 'fame-robots[ml]'") from None
    defaults: dict[str, Any] = {"novelty": True} if entry.cls.endswith("LocalOutlierFactor") else {}
    if "random_state" in inspect.signature(cls).parameters:
        defaults["random_state"] = 0  # the same data, the same model
    return _build(cls, entry, {**defaults, **entry.parameters})


def _build(cls: Any, entry: Entry, parameters: dict[str, Any]) -> Any:
    try:
        return cls(**parameters)
    except TypeError as error:
        raise ConfigError(f"{entry.cls} does not take that: {error}", element=entry.name) from None


def candidates(learning: Learning) -> Iterator[Entry]:
    """Every classifier to try, each with its parameters and reduction: the entries, multiplied by the grid."""
    for entry in learning.classifiers or _defaults(learning):
        own = dict(learning.grid.get(entry.name, {}))
        reductions = own.pop("reduction", None)
        if reductions is None:
            fixed = learning.reduction if entry.reduction is None else entry.reduction
            reductions = learning.grid.get("reduction", [fixed]) if entry.reduction is None else [fixed]
        reductions = [0] if entry.cls == "PathDetector" else reductions
        names = sorted(own)
        for reduction, *values in product(reductions, *(own[name] for name in names)):
            chosen = dict(zip(names, values, strict=True))
            label = ", ".join([f"{name} {value}" for name, value in chosen.items()])
            several = len(reductions) > 1
            name = " ".join(part for part in (entry.name, label, f"pca {reduction}" if several else "") if part)
            yield Entry(
                name, entry.cls, {**entry.parameters, **chosen}, reduction,
                entry.scaling or learning.scaling, _threshold(entry, learning), entry.unique,
            )  # fmt: skip


def _defaults(learning: Learning) -> Iterator[Entry]:
    """Those that the learning file names data for (no ``name: Null``); a reduction that it asks for holds for them."""
    named = {"ocsvm": learning.unsupervised, "rbfsvm": learning.supervised}
    asked = learning.reduction or "reduction" in learning.grid
    for entry in DEFAULTS:
        if named[entry.name] is not None:
            yield replace(entry, reduction=None) if asked else entry


def _threshold(entry: Entry, learning: Learning) -> Any:
    return learning.threshold if entry.threshold is None else entry.threshold
