"""`fame train`: autoencoders from recorded runs, one per channel, with thresholds from runs that were held back.

Runs are never taken apart: some train, the others validate. Each channel is shifted and scaled by what the training
runs hold. Windows beyond `samples` are left out by lot. A channel's threshold is the largest loss of the held-back
runs, smoothed as the pipeline smooths it, times a margin.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.extras import require
from fame.monitor.pipeline import offline
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.filters import LowPass
from fame.monitor.pipeline.processor import Floats, Samples
from fame.monitor.pipeline.trained_model import ACTIVATIONS, Network, TrainedModel
from fame.monitor.pipeline.windows import Windower
from fame.monitor.tables import hash_files, rate_of, read_runs


@dataclass(frozen=True, slots=True)
class Training:
    """What is to be learned from what: the section `Training` of a configuration, whose keys are these.

    files       CSV files of undisturbed runs
    model       where the model is stored
    columns     of the files; default all but stamp, run and label
    window      samples per window: inputs and outputs of a network
    hidden      neurons of the layers between
    activation  of these: relu, tanh, logistic, identity
    stride      samples from one window to the next, of those that train and of those that validate
    before      Hz, low-pass on the data; 0: none
    cutoff      Hz, low-pass on the loss; 0: none
    held_back   part of the runs that validates (at least one; at least one trains)
    samples     windows that train, at most
    epochs      passes over these, at most
    margin      factor on the largest loss of the held-back runs
    """

    files: tuple[str, ...] = ()
    model: str = "model.skops"
    columns: tuple[str, ...] = ()
    window: int = 50
    hidden: tuple[int, ...] = (16, 4, 16)
    activation: str = "tanh"
    stride: int = 5
    before: float = 0.0
    cutoff: float = 0.0
    held_back: float = 0.25
    samples: int = 20_000
    epochs: int = 60
    margin: float = 1.2
    seed: int = 0


def train(config: Training) -> TrainedModel:
    """Learn from the files. The model is not stored. Raises ConfigError, UnavailableError."""
    runs = read_runs(config.files, config.columns)
    return fit(runs, config, data=hash_files(config.files))


def fit(runs: Sequence[Samples], config: Training, data: str = "") -> TrainedModel:
    """Learn from runs that are at hand: each with values (n, channels). `data` names where they came from."""
    _check(config, runs)
    rate = rate_of(runs)
    if config.before:
        runs = [offline.run([LowPass(cutoff=config.before)], {"x": run})["x"] for run in runs]
    held = min(max(1, round(config.held_back * len(runs))), len(runs) - 1)
    chosen = np.random.default_rng(config.seed).permutation(len(runs))
    training, held_back = [runs[index] for index in chosen[held:]], [runs[index] for index in chosen[:held]]
    every = np.concatenate([run.channels() for run in training])
    mean, scale = every.mean(axis=0), every.std(axis=0)
    scale = np.where(scale > 1e-9 * (1 + np.abs(mean)), scale, 1.0)  # a channel that never moves
    windows = (_windows(training, config, rate) - mean) / scale
    network = Network.of([_fitted(windows[:, :, channel], config) for channel in range(windows.shape[2])])
    columns = runs[0].names or tuple(str(index) for index in range(windows.shape[2]))
    nothing = tuple(0.0 for _ in columns)
    model = TrainedModel(columns, config.window, rate, mean, scale, network, nothing, config.cutoff, config.before)
    return _judged(model, training, held_back, config, data)


def losses(model: TrainedModel, run: Samples, stride: int = 1) -> Samples:
    """The smoothed loss of a run whose data have gone through the low-pass before: values (k, channels)."""
    chain: list[Any] = [Autoencoder(model, stride=stride)]
    if model.cutoff:
        chain.append(LowPass(cutoff=model.cutoff))
    given = {"x": run.replace(run.channels(), names=model.columns)}
    return offline.run(chain, given).get("loss", Samples(np.zeros((0, len(model.columns))), np.zeros(0)))


def training_of(section: Mapping[str, Any], folder: Path) -> Training:
    """The section `Training`. Keys in any case, names of files relative to `folder`, patterns allowed.

    Raises ConfigError.
    """
    if not isinstance(section, Mapping):
        raise ConfigError(f"found {section!r}; a mapping with Files would be right", element="Training")
    spelled = {str(key).lower().replace(" ", "_"): value for key, value in section.items()}
    known = {name: Training.__dataclass_fields__[name].default for name in Training.__slots__}
    given: dict[str, Any] = {}
    for name, value in spelled.items():
        if name not in known:
            raise ConfigError(f"found the key {name!r}; known are {', '.join(known)}", element="Training")
        given[name] = _value(name, value, known[name])
    patterns = given.get("files", ())
    files = [str(path) for pattern in patterns for path in _matching(folder, pattern)]
    given["files"] = tuple(files)
    given["model"] = str(folder / given.get("model", Training().model))
    return Training(**given)


_KINDS: dict[type, str] = {int: "whole number", float: "number", str: "text"}


def _value(name: str, value: Any, default: Any) -> Any:
    """A value of the type of its default."""
    element = f"Training.{name}"
    if isinstance(default, tuple):
        items = value if isinstance(value, list) else [value]
        kind: type = int if name == "hidden" else str
        if not all(type(item) is kind for item in items):
            raise ConfigError(f"found {value!r}; a list of {_KINDS[kind]}s would be right", element=element)
        return tuple(items)
    kind = type(default)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ConfigError(f"found {value!r}; a {_KINDS[kind]} would be right", element=element)
    return value


def _matching(folder: Path, pattern: str) -> list[Path]:
    if not any(sign in pattern for sign in "*?["):
        return [folder / pattern]
    found = sorted(folder / path for path in glob(pattern, root_dir=folder, recursive=True))
    if not found:
        raise ConfigError(f"no file matches {pattern!r} in {folder}", element="Training.files")
    return found


def _check(config: Training, runs: Sequence[Samples]) -> None:
    right = {
        "window": config.window >= 2,
        "hidden": bool(config.hidden) and min(config.hidden) >= 1,
        "activation": config.activation in ACTIVATIONS,
        "stride": config.stride >= 1,
        "held_back": 0 < config.held_back < 1,
        "samples": config.samples >= 10,
        "epochs": config.epochs >= 1,
        "margin": 0 < config.margin < np.inf,
        "before": 0 <= config.before < np.inf,
        "cutoff": 0 <= config.cutoff < np.inf,
        "seed": 0 <= config.seed < 2**32,
    }
    for name, fits in right.items():
        if not fits:
            raise ConfigError(f"found {getattr(config, name)!r}, which is out of range", element=f"Training.{name}")
    if len(runs) < 2:
        raise ConfigError(f"has {len(runs)} run; at least 2 are needed: one trains, one validates", element="Training")


def _windows(runs: Sequence[Samples], config: Training, rate: float) -> Floats:
    """Windows that train: (n, window, channels)."""
    parts = [Windower().feed(run.replace(run.channels()), config.window, config.stride, rate).values for run in runs]
    parts = [part for part in parts if len(part)]
    if not parts:
        raise ConfigError(f"no run has {config.window} samples at {rate:.3g} Hz in a row", element="Training.window")
    total = sum(map(len, parts))
    if total <= config.samples:
        return np.concatenate(parts)
    lot = np.sort(np.random.default_rng(config.seed).choice(total, config.samples, replace=False))
    return np.concatenate(parts)[lot]


def _fitted(windows: Floats, config: Training) -> Any:
    """One channel's network."""
    require("sklearn")
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    estimator = MLPRegressor(
        hidden_layer_sizes=config.hidden,
        activation=config.activation,
        learning_rate_init=3e-3,
        max_iter=config.epochs,
        n_iter_no_change=config.epochs,
        random_state=config.seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # as many epochs as were asked for
        return estimator.fit(windows, windows)


def _judged(
    model: TrainedModel, training: Sequence[Samples], held_back: Sequence[Samples], config: Training, data: str
) -> TrainedModel:
    """The model with thresholds and metrics."""
    from dataclasses import replace

    from fame.monitor.storage import versions

    figures: dict[str, tuple[float, ...]] = {}
    for name, runs in (("training", training), ("validation", held_back)):
        found = [losses(model, run, config.stride).values for run in runs]
        found = [part for part in found if len(part)]
        if not found:
            raise ConfigError(f"no run for {name} has a whole window", element="Training.held_back")
        every = np.concatenate(found)
        figures[f"{name}_max"] = tuple(every.max(axis=0).tolist())
        figures[f"{name}_mean"] = tuple(every.mean(axis=0).tolist())
    thresholds = tuple(config.margin * value for value in figures["validation_max"])
    return replace(model, thresholds=thresholds, metrics=figures, data=data, versions=versions())
