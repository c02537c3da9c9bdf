"""`fame train`: autoencoders from recorded runs, one per channel, with thresholds from runs that were held back.

Runs are never taken apart: some train, the others validate. Each channel is shifted and scaled by what the training
runs hold. Of more windows than `samples` a random choice is used. A channel's threshold is the largest loss of the
held-back runs, smoothed as the pipeline smooths it, times a margin.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np

from fame.config.values import ConfigValue
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats
from fame.monitor.data_files import hash_files, rate_of, read_runs
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.filters import LowPass, Windower
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.trained_model import ACTIVATIONS, Network, TrainedModel
from fame.text import suggestion


@dataclass(frozen=True)
class Training:
    """Settings of a training: the keys of the section `Training` of a configuration.

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
    """Learn from runs in memory, each with values (n, channels). `data` names their origin."""
    _check(config, runs)
    rate = rate_of(runs)
    if config.before:
        runs = [processors.run([LowPass(cutoff=config.before)], {"x": run})["x"] for run in runs]
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
    return _evaluated(model, training, held_back, config, data)


def losses(model: TrainedModel, run: Samples, stride: int = 1) -> Samples:
    """The smoothed loss of a run whose data have gone through the low-pass before: values (k, channels)."""
    chain: list[Any] = [Autoencoder(model, stride=stride)]
    if model.cutoff:
        chain.append(LowPass(cutoff=model.cutoff))
    given = {"x": run.replace(run.channels(), names=model.columns)}
    return processors.run(chain, given).get("loss", Samples(np.zeros((0, len(model.columns))), np.zeros(0)))


def training_of(section: ConfigValue, folder: Path) -> Training:
    """Read the section `Training`: keys in any case, file names and patterns relative to `folder`.

    Raises ConfigError.
    """
    given: dict[str, Any] = {}
    for key, value in section.mapping().items():
        name = key.lower().replace(" ", "_")
        if name not in _READERS:
            raise value.error(f"unknown key; {suggestion(name, _READERS)}")
        given[name] = _READERS[name](value)
        if name == "files":
            given[name] = tuple(str(path) for item in _items(value) for path in _matching(folder, item))
    return Training(**{**given, "model": str(folder / given.get("model", Training.model))})


def _items(value: ConfigValue) -> list[ConfigValue]:
    """Give the values of a list; a single value is taken as a list of one."""
    return value.items() if isinstance(value.data, list | tuple) else [value]


def _texts(value: ConfigValue) -> tuple[str, ...]:
    return tuple(item.text() for item in _items(value))


_READERS: Mapping[str, Callable[[ConfigValue], Any]] = {
    "files": _texts,
    "model": ConfigValue.text,
    "columns": _texts,
    "window": partial(ConfigValue.integer, minimum=2),
    "hidden": lambda value: tuple(item.integer(minimum=1) for item in _items(value)),
    "activation": partial(ConfigValue.choice, known=ACTIVATIONS, what="an activation"),
    "stride": partial(ConfigValue.integer, minimum=1),
    "before": partial(ConfigValue.number, minimum=0),
    "cutoff": partial(ConfigValue.number, minimum=0),
    "held_back": partial(ConfigValue.number, above=0, maximum=math.nextafter(1, 0)),
    "samples": partial(ConfigValue.integer, minimum=10),
    "epochs": partial(ConfigValue.integer, minimum=1),
    "margin": partial(ConfigValue.number, above=0),
    "seed": partial(ConfigValue.integer, minimum=0, maximum=2**32 - 1),
}


def _matching(folder: Path, value: ConfigValue) -> list[Path]:
    pattern = value.text()
    if not any(sign in pattern for sign in "*?["):
        return [folder / pattern]
    found = sorted(folder / path for path in glob(pattern, root_dir=folder, recursive=True))
    if not found:
        raise value.error(f"no file matches {pattern!r} in {folder}")
    return found


def _check(config: Training, runs: Sequence[Samples]) -> None:
    for name, read in _READERS.items():
        read(ConfigValue(getattr(config, name), f"Training.{name}"))
    if not config.hidden:
        raise ConfigError("expected at least one layer, got none", element="Training.hidden")
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
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is given
        return estimator.fit(windows, windows)


def _evaluated(
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
