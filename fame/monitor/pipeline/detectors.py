"""Detectors: how unusual a window of samples is, per channel.

A detector learns from windows of undisturbed runs, scaled to mean 0 and deviation 1 per channel, and gives each window
a loss per channel. `fit_detector` makes one by name::

    autoencoder       mean squared error of the reconstruction, by a network per channel
    pca               mean squared error of the reconstruction by principal components across all channels
    mahalanobis       squared Mahalanobis distance across all channels, by the window's samples of each channel
    knn               mean squared distance to the nearest of the windows that it keeps, across all channels
    ocsvm             one-class SVM (RBF) on principal components: -log of the decision value, 1 at the boundary
    isolation_forest  isolation forest on principal components: the anomaly score of Liu, Ting and Zhou 2008
    phase             deviation from other runs at the same time since the start (`fame.monitor.pipeline.phases`)
    any of, all of    several of these: the largest or the smallest loss, each relative to its usual one
    module.Class      an outlier detector of scikit-learn (`fame.monitor.pipeline.other_estimators`)

``ocsvm``, ``isolation_forest`` and estimators have one loss for all channels; the channel that deviates most gets it,
the others get a share of it. What FAME's own detectors evaluate while a robot works is numpy and scipy: a library's
`predict` takes many times as long for the few windows of one call. They are stored as plain arrays and texts.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats, Whole
from fame.monitor.pipeline.other_estimators import EstimatorDetector, estimator_of, shared
from fame.monitor.pipeline.phases import Phases, reduced, refuse_large

if TYPE_CHECKING:
    from fame.monitor.pipeline.training_settings import Training

ACTIVATIONS = ("relu", "tanh", "logistic", "identity")
_TINY = 1e-12
_LEAST = 1e-9
"""Smallest threshold that a score is divided by: one of 0 is exceeded by any score."""
_RIDGE = 1e-5
"""What is added to each variance before it is inverted, relative to the mean variance."""


class FittedDetector(Protocol):
    kind: ClassVar[str]

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the loss (n, channels) of scaled windows (n, window, channels) that end at `times` (s)."""


# ---- autoencoders ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ChannelAutoencoders:
    """Autoencoders of the same shape, one per channel, evaluated with one matrix product per layer.

    weights     per layer (channels, in, out)
    biases      per layer (channels, 1, out)
    activation  of the hidden layers; the last is linear
    """

    kind: ClassVar[str] = "autoencoder"
    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]
    activation: str

    @property
    def channels(self) -> int:
        return int(self.weights[0].shape[0])

    @property
    def layers(self) -> tuple[int, ...]:
        """Neurons per layer, from input to output."""
        return (int(self.weights[0].shape[1]), *(int(weight.shape[2]) for weight in self.weights))

    def __call__(self, inputs: Floats) -> Floats:
        """(channels, n, in) to (channels, n, out)."""
        last = len(self.weights) - 1
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            inputs = np.matmul(inputs, weight)
            inputs += bias
            if number < last:
                _activate(self.activation, inputs)
        return inputs

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the mean squared error over each window."""
        inputs = np.ascontiguousarray(windows.transpose(2, 0, 1))  # (channels, n, window)
        errors = self(inputs)
        errors -= inputs
        return np.asarray(np.einsum("cnw,cnw->nc", errors, errors) / windows.shape[1])

    @classmethod
    def of(cls, estimators: Sequence[Any]) -> ChannelAutoencoders:
        """That of scikit-learn's MLPRegressors, one per channel."""
        layers = range(len(estimators[0].coefs_))
        weights = tuple(np.stack([item.coefs_[layer] for item in estimators]) for layer in layers)
        biases = tuple(np.stack([item.intercepts_[layer] for item in estimators])[:, None] for layer in layers)
        return cls(weights, biases, str(estimators[0].activation))

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> ChannelAutoencoders:
        require("sklearn")
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor

        estimators = []
        for channel in range(windows.shape[2]):
            estimator = MLPRegressor(
                hidden_layer_sizes=tuple(settings.hidden),
                activation=settings.activation,
                learning_rate_init=3e-3,
                max_iter=settings.epochs,
                n_iter_no_change=settings.epochs,
                random_state=settings.seed,
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is given
                estimators.append(estimator.fit(windows[:, :, channel], windows[:, :, channel]))
        network = cls.of(estimators)
        still = np.abs(windows).max(axis=(0, 1)) < _TINY
        for part in (*network.weights, *network.biases):
            part[still] = 0.0  # such a channel gives zeros, so that its loss is 0 until it moves
        return network


def _activate(name: str, values: Floats) -> None:
    """Apply an activation in place."""
    if name == "relu":
        np.maximum(values, 0, out=values)
    elif name == "tanh":
        np.tanh(values, out=values)
    elif name == "logistic":
        np.negative(values, out=values)
        np.exp(values, out=values)
        values += 1
        np.reciprocal(values, out=values)


# ---- across channels -------------------------------------------------------------------------------------------------


def _principal(windows: Floats, detector: str) -> tuple[Floats, Floats]:
    """Return growing eigenvalues and eigenvectors of the covariance of windows. Raises ConfigError for a large one."""
    refuse_large(windows, detector)
    flat = windows.reshape(len(windows), -1)
    values, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    return values, vectors


@dataclass(frozen=True, slots=True)
class Components:
    """Principal components of windows across all channels: `axes` (components, window x channels), orthonormal;
    `deviations` (components,) of the windows that it was learned from along them."""

    kind: ClassVar[str] = "pca"
    axes: Floats
    deviations: Floats

    def project(self, windows: Floats) -> Floats:
        """Return the components (n, components), each with deviation 1 on the windows that it was learned from."""
        return np.asarray(windows.reshape(len(windows), -1) @ self.axes.T / self.deviations)

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the mean squared error of the reconstruction."""
        flat = windows.reshape(len(windows), -1)
        errors = (flat - flat @ self.axes.T @ self.axes).reshape(windows.shape)
        return np.asarray(np.einsum("nwc,nwc->nc", errors, errors) / windows.shape[1])

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None, most: int = 64) -> Components:
        values, vectors = _principal(windows, cls.kind)
        values, vectors = np.maximum(values[::-1], 0), vectors[:, ::-1]
        explained = np.cumsum(values) / max(float(values.sum()), _TINY)
        count = min(int(np.searchsorted(explained, settings.components)) + 1, most, len(windows))
        return cls(np.ascontiguousarray(vectors[:, :count].T), np.sqrt(np.maximum(values[:count], _TINY)))


@dataclass(frozen=True, slots=True)
class Whitening:
    """The symmetric square root of the inverse covariance of windows across all channels (window x channels, same).

    Whitened windows have deviation 1 in every direction, so what is small but unusual counts as much as what is large;
    the symmetric root keeps each sample and channel in its place (ZCA whitening: Kessy, Lewin and Strimmer 2018).
    """

    kind: ClassVar[str] = "mahalanobis"
    root: Floats

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the mean of the squares of the whitened window, about 1 for those that it learned from."""
        white = (windows.reshape(len(windows), -1) @ self.root).reshape(windows.shape)
        return np.asarray(np.einsum("nwc,nwc->nc", white, white) / windows.shape[1])

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> Whitening:
        values, vectors = _principal(windows, cls.kind)
        floor = _RIDGE * max(float(values.mean()), _TINY)
        return cls((vectors / np.sqrt(np.maximum(values, 0) + floor)) @ vectors.T)


@dataclass(frozen=True)
class Nearest:
    """The windows that were kept, each reduced to `POINTS` values per channel: (kept, points, channels).

    Neighbours are looked up by `components` of the reduced windows, the loss compares the reduced windows themselves.
    """

    kind: ClassVar[str] = "knn"
    kept: Floats
    components: Components

    @cached_property
    def _tree(self) -> Any:
        require("scipy")
        from scipy.spatial import cKDTree

        return cKDTree(self.place(self.kept))

    def place(self, reduced: Floats) -> Floats:
        """Return where neighbours are looked up (n, components)."""
        return self.components.project(reduced) * self.components.deviations

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        """Return the mean squared difference to the nearest kept window."""
        values = reduced(windows)
        _, nearest = self._tree.query(self.place(values))
        return np.asarray(((values - self.kept[nearest]) ** 2).mean(axis=1))

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> Nearest:
        kept = reduced(windows[draw_lot(len(windows), settings.neighbours, settings.seed)])
        return cls(kept, Components.fit(kept, settings, most=12))


def draw_lot(total: int, count: int, seed: int) -> Whole:
    """Draw `count` of `total` numbers, in order; all of them if there are no more."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(seed).choice(total, count, replace=False))


# ---- one loss for all channels ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class OneClass:
    """A one-class SVM with RBF kernel on principal components."""

    kind: ClassVar[str] = "ocsvm"
    components: Components
    vectors: Floats
    weights: Floats
    gamma: float
    offset: float

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        features = self.components.project(windows)
        squares = (self.vectors**2).sum(axis=1) + (features**2).sum(axis=1)[:, None] - 2 * features @ self.vectors.T
        exponents = np.log(self.weights) - self.gamma * np.maximum(squares, 0)
        largest = exponents.max(axis=1)  # a sum of exponentials that stays finite far away from all vectors
        density = largest + np.log(np.exp(exponents - largest[:, None]).sum(axis=1))
        return shared(np.maximum(0.0, 1.0 - (density - np.log(self.offset))), windows)

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> OneClass:
        require("sklearn")
        from sklearn.svm import OneClassSVM

        components = Components.fit(windows, settings, most=12)
        features = components.project(windows[draw_lot(len(windows), 3000, settings.seed)])
        machine = OneClassSVM(nu=0.02, gamma=0.5 / features.shape[1]).fit(features)
        weights = np.asarray(machine.dual_coef_[0], dtype=np.float64)
        return cls(components, machine.support_vectors_, weights, float(machine._gamma), float(machine.offset_[0]))


@dataclass(frozen=True, slots=True)
class Forest:
    """An isolation forest on principal components. Its trees are arrays (trees, nodes), unused nodes are leaves.

    `features` and `limits` of a node lead to its `left` or `right`; in a leaf, both are the leaf itself, and `depths`
    is the length of the path to it.
    """

    kind: ClassVar[str] = "isolation_forest"
    components: Components
    features: Whole
    limits: Floats
    left: Whole
    right: Whole
    depths: Floats
    steps: int
    usual: float

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        values = self.components.project(windows)
        trees, rows = np.arange(len(self.features)), np.arange(len(values))[:, None]
        node = np.zeros((len(values), len(trees)), dtype=np.int64)
        for _ in range(self.steps):
            left = values[rows, self.features[trees, node]] <= self.limits[trees, node]
            node = np.where(left, self.left[trees, node], self.right[trees, node])
        return shared(2.0 ** (-self.depths[trees, node].mean(axis=1) / self.usual), windows)

    @classmethod
    def fit(cls, windows: Floats, settings: Training, times: Floats | None = None) -> Forest:
        require("sklearn")
        from sklearn.ensemble import IsolationForest

        components = Components.fit(windows, settings, most=12)
        features = components.project(windows).astype(np.float32).astype(np.float64)
        made = IsolationForest(random_state=settings.seed).fit(features)
        trees = [estimator.tree_ for estimator in made.estimators_]
        size = max(tree.node_count for tree in trees)
        own = np.arange(size)
        columns: dict[str, list[Any]] = {name: [] for name in ("features", "limits", "left", "right", "depths")}
        for tree in trees:
            leaf = np.pad(tree.children_left == -1, (0, size - tree.node_count), constant_values=True)
            given = (tree.feature, tree.threshold, tree.children_left, tree.children_right)
            padded = [np.pad(part, (0, size - tree.node_count)) for part in given]
            columns["features"].append(np.where(leaf, 0, padded[0]))
            columns["limits"].append(np.where(leaf, 0.0, padded[1]))
            columns["left"].append(np.where(leaf, own, padded[2]))
            columns["right"].append(np.where(leaf, own, padded[3]))
            columns["depths"].append(_depths(tree, size))
        stacked = {name: np.array(parts) for name, parts in columns.items()}
        usual = float(_usual_depth(np.array([made.max_samples_]))[0])
        return cls(components, **stacked, steps=max(tree.max_depth for tree in trees), usual=usual)


def _depths(tree: Any, size: int) -> Floats:
    """Return the depth of each node, and in leaves with several windows what a tree of these would add."""
    depths = np.zeros(size)
    for node in range(tree.node_count):  # parents come before their children
        for child in (tree.children_left[node], tree.children_right[node]):
            if child != -1:
                depths[child] = depths[node] + 1
    leaves = np.flatnonzero(tree.children_left == -1)
    depths[leaves] += _usual_depth(tree.n_node_samples[leaves])
    return depths


def _usual_depth(count: Whole) -> Floats:
    """Return the mean depth of an unsuccessful search in a binary tree of `count` windows (Liu et al. 2008, eq. 1)."""
    many = np.maximum(count, 3)
    usual = 2 * (np.log(many - 1) + np.euler_gamma) - 2 * (many - 1) / many
    return np.asarray(np.where(count <= 1, 0.0, np.where(count == 2, 1.0, usual)))


# ---- several ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Several:
    """Several detectors: ``any of`` takes the largest loss, ``all of`` the smallest. `usual` (detectors, channels) are
    the losses that count as 1: the thresholds that each would have alone, so that one with heavy tails does not set
    those of the others; those of detectors of points are the thresholds on the score of a run."""

    kind: ClassVar[str] = "several"
    rule: str
    parts: tuple[Any, ...]
    usual: Floats
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ValueError(f"rule {self.rule!r}")

    def loss(self, windows: Floats, times: Floats | None = None) -> Floats:
        found = [part.loss(windows, times) / usual for part, usual in zip(self.parts, self.usual, strict=True)]
        return np.asarray(combined(self.rule, found))

    def score(self, scores: Sequence[float]) -> float:
        """Combine the scores of a run by each part, in units of their thresholds."""
        return float(combined(self.rule, np.asarray(scores) / np.maximum(self.usual[:, 0], _LEAST)))

    def predict(self, recording: Any) -> Any:
        """Return labels (points,): +1 benign, -1 anomalous."""
        return np.where(combined(self.rule, [part.predict(recording) == -1 for part in self.parts]), -1, 1)

    @classmethod
    def fit(cls, rule: str, names: Sequence[str], windows: Floats, settings: Training, times: Floats | None) -> Several:
        parts = tuple(_KINDS[name].fit(windows, settings, times) for name in names)
        usual = np.array(settings.usual or np.ones((len(parts), windows.shape[2])))
        return cls(rule, parts, np.maximum(usual, _TINY))


# ---- by name ---------------------------------------------------------------------------------------------------------

_KINDS: dict[str, Any] = {
    kind.kind: kind for kind in (ChannelAutoencoders, Components, Whitening, Nearest, OneClass, Forest, Phases)
}
DETECTORS = tuple(_KINDS)
STORED: Mapping[str, Any] = {**_KINDS, Several.kind: Several, EstimatorDetector.kind: EstimatorDetector}
"""Kinds of detectors of windows, as models store them."""
RULES = ("any of", "all of")


def split_rule(name: str) -> tuple[str, tuple[str, ...]]:
    """Split ``pca`` or ``any of pca, knn`` into rule (empty for a single one) and names."""
    rule = next((rule for rule in RULES if name.startswith(f"{rule} ")), "")
    return rule, tuple(part.strip() for part in name.removeprefix(rule).split(","))


def combined(rule: str, values: Any) -> Any:
    """Combine losses, scores or verdicts of several detectors, along the first axis: the largest or the smallest."""
    return np.max(values, axis=0) if rule == "any of" else np.min(values, axis=0)


def detector_names(name: str) -> tuple[str, tuple[str, ...]]:
    """Split as `split_rule`. Raises ConfigError for an unknown name; those of classes are not looked up."""
    rule, names = split_rule(name)
    if is_class(name):
        return rule, names
    wrong = [part for part in names if part not in DETECTORS]
    if wrong or (rule and len(names) < 2):
        known = ", ".join(DETECTORS)
        other = "or 'any of pca, knn', or 'all of ...', or the class of an estimator"
        raise ConfigError(f"expected one of {known}, {other}, got {name!r}")
    return rule, names


def is_class(name: str) -> bool:
    """Return whether a name is that of a class, ``sklearn.ensemble.IsolationForest``, and of no detector of FAME."""
    return "." in name and all(part.isidentifier() for part in name.split("."))


def fit_detector(name: str, windows: Floats, settings: Training, times: Floats | None = None) -> FittedDetector:
    """Learn a detector from scaled windows (n, window, channels) that end at `times` (n,), s since the start; by the
    estimator of the settings if they have one.

    Raises ConfigError for an unknown name, UnavailableError without the package that learns it.
    """
    if settings.estimator is not None or is_class(name):
        estimator = estimator_of(name, settings.parameters) if settings.estimator is None else settings.estimator
        return EstimatorDetector.fit(estimator, windows, settings)
    rule, names = detector_names(name)
    detector: FittedDetector = (
        _KINDS[names[0]].fit(windows, settings, times)
        if not rule
        else Several.fit(rule, names, windows, settings, times)
    )
    return detector


def keeps_windows(detector: FittedDetector) -> bool:
    """Return whether a detector, or one of several, keeps windows of the training, as an estimator of others may."""
    return any(isinstance(part, Nearest | EstimatorDetector) for part in getattr(detector, "parts", (detector,)))


def detector_name(detector: FittedDetector) -> str:
    """Return the name that `fit_detector` takes."""
    if isinstance(detector, Several):
        return f"{detector.rule} {', '.join(part.kind for part in detector.parts)}"
    return detector.name if isinstance(detector, EstimatorDetector) else detector.kind
