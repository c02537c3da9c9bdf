"""Trained autoencoders, one per channel, with thresholds and origin: evaluated, stored and loaded.

A `Network` evaluates the perceptrons of all channels at once, with one matrix product per layer. scikit-learn evaluates
one network at a time and checks its input each time, which takes many times as long as the arithmetic for the few
windows of one call. Results agree to 1e-5.

Models are stored with skops as plain arrays and texts, so that a file cannot hold anything that runs on loading, and
does not depend on the version of scikit-learn. `TrainedModel.load` refuses a file that is not a model, is damaged, or
was trained on other columns or other data than asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.storage import read_artefact, versions, write_artefact

ACTIVATIONS = ("relu", "tanh", "logistic", "identity")


@dataclass(frozen=True, slots=True)
class Network:
    """Networks of the same shape, one per channel.

    weights     per layer (channels, in, out)
    biases      per layer (channels, 1, out)
    activation  of the hidden layers; the last is linear
    """

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

    @classmethod
    def of(cls, estimators: Sequence[Any]) -> Network:
        """That of scikit-learn's MLPRegressors, one per channel."""
        layers = range(len(estimators[0].coefs_))
        weights = tuple(np.stack([item.coefs_[layer] for item in estimators]) for layer in layers)
        biases = tuple(np.stack([item.intercepts_[layer] for item in estimators])[:, None] for layer in layers)
        return cls(weights, biases, str(estimators[0].activation))


def _activate(name: str, values: Floats) -> None:
    """In place."""
    if name == "relu":
        np.maximum(values, 0, out=values)
    elif name == "tanh":
        np.tanh(values, out=values)
    elif name == "logistic":
        np.negative(values, out=values)
        np.exp(values, out=values)
        values += 1
        np.reciprocal(values, out=values)


FORMAT = "fame-autoencoder-1"


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """One autoencoder per column.

    columns     names, in the order of the channels
    window      samples
    rate        Hz, of the samples it learned from
    mean, scale (channels,), of what it learned from; windows are shifted and divided by these
    thresholds  (channels,), on the loss after smoothing
    cutoff      Hz, of the low-pass on the loss for which the thresholds hold; 0: none
    before      Hz, of the low-pass on the data before; 0: none
    data        SHA-256 of the files
    metrics     figures of training and validation, by name, each (channels,)
    """

    columns: tuple[str, ...]
    window: int
    rate: float
    mean: Floats
    scale: Floats
    network: Network
    thresholds: tuple[float, ...]
    cutoff: float = 0.0
    before: float = 0.0
    data: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def loss(self, windows: Any) -> Floats:
        """Mean squared error over each window, in the scaled unit: (n, window, channels) to (n, channels)."""
        scaled = (np.asarray(windows, dtype=np.float64) - self.mean) / self.scale
        inputs = np.ascontiguousarray(scaled.transpose(2, 0, 1))  # (channels, n, window)
        errors = self.network(inputs)
        errors -= inputs
        return np.asarray(np.einsum("cnw,cnw->nc", errors, errors) / self.window)

    def to_plain(self) -> dict[str, Any]:
        """Give all values as plain data and arrays, as they are stored."""
        return {
            "format": FORMAT,
            "versions": dict(self.versions) or versions(),
            "columns": list(self.columns),
            "window": self.window,
            "rate": float(self.rate),
            "mean": self.mean,
            "scale": self.scale,
            "weights": list(self.network.weights),
            "biases": list(self.network.biases),
            "activation": self.network.activation,
            "thresholds": [float(value) for value in self.thresholds],
            "cutoff": float(self.cutoff),
            "before": float(self.before),
            "data": self.data,
            "metrics": {name: [float(value) for value in values] for name, values in self.metrics.items()},
        }

    def save(self, path: str | Path) -> None:
        """Store the model: with skops, or as ONNX if the name ends in ``.onnx``.

        Raises UnavailableError without the package that writes it.
        """
        if str(path).endswith(".onnx"):
            from fame.monitor.pipeline.onnx import write_onnx

            write_onnx(self.to_plain(), path)
        else:
            write_artefact(self.to_plain(), path)

    @classmethod
    def load(cls, path: str | Path, *, columns: Sequence[str] = (), data: str = "") -> TrainedModel:
        """Read a model, from skops or ONNX (``.onnx``). If given, `columns` and `data` must be those of its training.

        Raises ConfigError for each reason named above.
        """
        if str(path).endswith(".onnx"):
            from fame.monitor.pipeline.onnx import read_onnx

            content = read_onnx(path)
        else:
            content = read_artefact(Path(path), "fame train")
            found = content.get("format") if isinstance(content, dict) else None
            if found != FORMAT:
                text = f"is not a model of fame train: expected format {FORMAT!r}, got {found!r}"
                raise ConfigError(text, file=str(path))
        model = _from_plain(content, str(path))
        model.require(path, columns, data)
        return model

    def require(self, path: str | Path, columns: Sequence[str] = (), data: str = "") -> None:
        """Check columns and data, each if given. Raises ConfigError if the model was trained on others."""
        if columns and tuple(columns) != self.columns:
            text = f"has the columns {', '.join(self.columns)}; expected {', '.join(columns)}: train again"
            raise ConfigError(text, file=str(path))
        if data and data != self.data:
            text = f"is stale: trained on data {self.data[:12]}, the files hold {data[:12]} now: train again"
            raise ConfigError(text, file=str(path))


def _from_plain(content: Mapping[str, Any], file: str) -> TrainedModel:
    """Give the model that `TrainedModel.to_plain` described. Raises ConfigError if its parts do not fit."""
    try:
        arrays = {
            name: [np.asarray(part, dtype=np.float64) for part in content[name]] for name in ("weights", "biases")
        }
        network = Network(tuple(arrays["weights"]), tuple(arrays["biases"]), str(content["activation"]))
        model = TrainedModel(
            columns=tuple(map(str, content["columns"])),
            window=int(content["window"]),
            rate=float(content["rate"]),
            mean=np.asarray(content["mean"], dtype=np.float64),
            scale=np.asarray(content["scale"], dtype=np.float64),
            network=network,
            thresholds=tuple(map(float, content["thresholds"])),
            cutoff=float(content["cutoff"]),
            before=float(content["before"]),
            data=str(content["data"]),
            versions=dict(content["versions"]),
            metrics={str(name): tuple(map(float, values)) for name, values in content["metrics"].items()},
        )
        _check(model)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise ConfigError(f"is damaged: {error!r}", file=file) from None
    return model


def _check(model: TrainedModel) -> None:
    """Raises ValueError if its parts do not fit."""
    channels, network = len(model.columns), model.network
    if network.activation not in ACTIVATIONS:
        raise ValueError(f"activation {network.activation!r}")
    if network.layers[0] != model.window or network.layers[-1] != model.window:
        raise ValueError(f"layers {network.layers} for windows of {model.window}")
    shapes = [(channels, a, b) for a, b in zip(network.layers, network.layers[1:], strict=False)]
    if [weight.shape for weight in network.weights] != shapes:
        raise ValueError(f"weights of {[weight.shape for weight in network.weights]} for {channels} columns")
    if [bias.shape for bias in network.biases] != [(channels, 1, shape[2]) for shape in shapes]:
        raise ValueError(f"biases of {[bias.shape for bias in network.biases]}")
    numbers = (model.mean, model.scale, np.array(model.thresholds), *network.weights, *network.biases)
    if any(part.shape != (channels,) for part in numbers[:3]):
        raise ValueError(f"mean, scale or thresholds not of {channels} columns")
    if not all(np.isfinite(part).all() for part in numbers) or not (model.scale > 0).all():
        raise ValueError("values that are not finite")
    if not (model.rate > 0 and model.cutoff >= 0 and model.before >= 0 and np.isfinite(model.rate)):
        raise ValueError(f"rate {model.rate:g}, cutoff {model.cutoff:g}, before {model.before:g}")
