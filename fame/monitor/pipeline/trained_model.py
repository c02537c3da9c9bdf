"""Trained models: a detector with thresholds and origin, stored and loaded; autoencoders also as ONNX files.

Models are stored as `fame.monitor.storage` says; all detectors are plain arrays and texts, which do not depend on the
version of scikit-learn.

The graph of an ONNX file takes ``windows`` (n, window, channels) in the unit of the data and gives ``loss``
(n, channels), so that any ONNX runtime can evaluate it without FAME. The metadata hold the remaining values of the
model. An ONNX file holds data and operators, never Python code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats
from fame.monitor.calibration import Calibration
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.detectors import ACTIVATIONS, STORED, ChannelAutoencoders, FittedDetector, detector_name
from fame.monitor.storage import StoredModel, read_model
from fame.text import write_file

LEAST_MOVEMENT = "least_movement"
"""In the conditions of a model."""
STILL = 0.1
"""A channel that moves less than this part of its least movement in training hardly moves."""


@dataclass(frozen=True, slots=True)
class TrainedModel(StoredModel):
    """A detector of windows with all that it needs.

    columns      names, in the order of the channels
    window       samples
    rate         Hz, of the samples it learned from
    mean, scale  (channels,), of what it learned from; windows are shifted and divided by these
    thresholds   (channels,), on the loss after smoothing
    cutoff       Hz, of the low-pass on the loss for which the thresholds hold; 0: none
    before       Hz, of the low-pass on the data before; 0: none
    data         SHA-256 of the files
    metrics      figures of training and validation, by name, each (channels,)
    calibration  what the thresholds promise; None for a model of an earlier version
    conditions   of the training, as plain data: files, runs, settings
    elements     of the mission, on the axis of phases (`fame.monitor.pipeline.elements`); none: time since the start
    band         of the training runs, in the unit of the data; None of an earlier version
    """

    kind: ClassVar[str] = "windows"
    maker: ClassVar[str] = "fame monitor train"
    detectors: ClassVar[Mapping[str, Any]] = STORED
    columns: tuple[str, ...]
    window: int
    rate: float
    mean: Floats
    scale: Floats
    detector: FittedDetector
    thresholds: tuple[float, ...]
    cutoff: float = 0.0
    before: float = 0.0
    data: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    metrics: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    calibration: Calibration | None = None
    conditions: Mapping[str, Any] = field(default_factory=dict)
    band: Band | None = None
    elements: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def least_movement(self) -> Floats:
        """The least standard deviation of a channel over a window of the training (channels,), in the unit of the data;
        0 where it stood still, and of an earlier version."""
        return np.asarray(self.conditions.get(LEAST_MOVEMENT, np.zeros(len(self.columns))), dtype=np.float64)

    def still(self, windows: Floats) -> NDArray[np.bool_]:
        """Return whether a channel hardly moves in a window, as a sensor that is dead, stuck or in another unit, and as
        none did in training: (n, window, channels) to (n, channels)."""
        least = self.least_movement
        return windows.std(axis=1) < STILL * least if least.any() else np.zeros((len(windows), len(least)), dtype=bool)

    @property
    def detector_text(self) -> str:
        """The name of the detector; if it was chosen by the runs, also why."""
        chosen = self.conditions.get("chosen")
        return detector_name(self.detector) + (f" (chosen, as {chosen})" if chosen else "")

    @property
    def network(self) -> ChannelAutoencoders:
        """The autoencoders. Raises ConfigError for another detector."""
        if not isinstance(self.detector, ChannelAutoencoders):
            raise ConfigError(f"has no autoencoders, its detector is {detector_name(self.detector)}")
        return self.detector

    def loss(self, windows: Any, times: Floats | None = None) -> Floats:
        """Return the loss of each window by the detector, in the scaled unit: (n, window, channels) to (n, channels).

        `times` (n,) are those of their ends, s since the start of the run, for a detector that knows phases.
        """
        return self.detector.loss((np.asarray(windows, dtype=np.float64) - self.mean) / self.scale, times)

    def save(self, path: str | Path, *, single: bool = False) -> None:
        """Store the model: with skops, or autoencoders as ONNX if the name ends in ``.onnx``; `single`: with inputs and
        outputs of 32 bit.

        Raises UnavailableError without the package that writes it, ConfigError for another detector as ONNX.
        """
        if str(path).endswith(".onnx"):
            _ = self.network  # ONNX files hold autoencoders
            write_onnx(self.to_plain(), path, single=single)
        else:
            StoredModel.save(self, path)

    @classmethod
    def load(cls, path: str | Path, *, columns: Sequence[str] = (), data: str = "") -> TrainedModel:
        """Read a model, from skops or ONNX (``.onnx``). If given, `columns` and `data` must be those of its training.

        Raises ConfigError for any other file.
        """
        content = read_onnx(path) if str(path).endswith(".onnx") else read_model(Path(path), cls.maker)
        model = cls.of(content, str(path))
        model.require(path, columns, data)
        return model

    def check(self) -> None:
        """Raise ValueError or another error if its parts do not fit each other."""
        channels = len(self.columns)
        numbers = (self.mean, self.scale, np.array(self.thresholds))
        if any(part.shape != (channels,) for part in numbers):
            raise ValueError(f"mean, scale or thresholds not of {channels} columns")
        if self.least_movement.shape != (channels,):
            raise ValueError(f"least movements of {len(self.least_movement)} columns")
        if not all(np.isfinite(part).all() for part in numbers) or not (self.scale > 0).all():
            raise ValueError("values that are not finite")
        if not (self.rate > 0 and self.cutoff >= 0 and self.before >= 0 and np.isfinite(self.rate)):
            raise ValueError(f"rate {self.rate:g}, cutoff {self.cutoff:g}, before {self.before:g}")
        if isinstance(self.detector, ChannelAutoencoders):
            _check_network(self.detector, self.window, channels)
        loss = self.loss(np.zeros((1, self.window, channels)))  # its parts fit each other
        if loss.shape != (1, channels) or not np.isfinite(loss).all():
            raise ValueError(f"a loss of shape {loss.shape} for {channels} columns")

    def require(self, path: str | Path, columns: Sequence[str] = (), data: str = "") -> None:
        """Check columns and data, each if given. Raises ConfigError if the model was trained on others."""
        if columns and tuple(columns) != self.columns:
            text = f"has the columns {', '.join(self.columns)}; expected {', '.join(columns)}: train again"
            raise ConfigError(text, file=str(path))
        if data and data != self.data:
            text = f"is stale: trained on data {self.data[:12]}, the files hold {data[:12]} now: train again"
            raise ConfigError(text, file=str(path))


def _check_network(network: ChannelAutoencoders, window: int, channels: int) -> None:
    if network.activation not in ACTIVATIONS:
        raise ValueError(f"activation {network.activation!r}")
    if network.layers[0] != window or network.layers[-1] != window:
        raise ValueError(f"layers {network.layers} for windows of {window}")
    shapes = [(channels, a, b) for a, b in zip(network.layers, network.layers[1:], strict=False)]
    if [weight.shape for weight in network.weights] != shapes:
        raise ValueError(f"weights of {[weight.shape for weight in network.weights]} for {channels} columns")
    if [bias.shape for bias in network.biases] != [(channels, 1, shape[2]) for shape in shapes]:
        raise ValueError(f"biases of {[bias.shape for bias in network.biases]}")


_OPSET, _IR = 18, 9
_OPERATORS = {"relu": "Relu", "tanh": "Tanh", "logistic": "Sigmoid"}
_METADATA_KEY = "fame"
_NOT_METADATA = ("format", "mean", "scale", "detector")


def write_onnx(model: Mapping[str, Any], path: str | Path, *, single: bool = False) -> None:
    """Write a model of autoencoders, given as `TrainedModel.to_plain` gives it; `single`: inputs and outputs of 32 bit.

    The graph computes with 64 bit in both cases. Raises UnavailableError without the package `onnx`.
    """
    onnx = _package("onnx")
    network = model["detector"]
    constants = {"mean": model["mean"], "scale": model["scale"]}
    for layer, (weight, bias) in enumerate(zip(network["weights"], network["biases"], strict=True)):
        constants |= {f"weight_{layer}": weight, f"bias_{layer}": bias}
    channels = len(model["columns"])
    shapes = (("windows", ["n", model["window"], channels]), ("loss", ["n", channels]))
    kind = onnx.TensorProto.FLOAT if single else onnx.TensorProto.DOUBLE
    inputs, outputs = (onnx.helper.make_tensor_value_info(name, kind, shape) for name, shape in shapes)
    tensors = [onnx.numpy_helper.from_array(np.ascontiguousarray(value), name) for name, value in constants.items()]
    tensors.append(onnx.numpy_helper.from_array(np.array([2], dtype=np.int64), "samples"))
    nodes = _nodes(len(network["weights"]), network["activation"], onnx.helper.make_node, kind, onnx.TensorProto.DOUBLE)
    graph = onnx.helper.make_graph(nodes, "autoencoders", [inputs], [outputs], tensors)
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", _OPSET)], ir_version=_IR)
    metadata = {name: value for name, value in model.items() if name not in _NOT_METADATA}
    metadata["activation"] = network["activation"]
    onnx.helper.set_model_props(proto, {_METADATA_KEY: json.dumps(metadata, default=np.ndarray.tolist)})
    write_file(path, proto.SerializeToString())


def read_onnx(path: str | Path) -> dict[str, Any]:
    """Read what `write_onnx` wrote. Raises ConfigError for any other file, UnavailableError without `onnx`."""
    onnx = _package("onnx")
    try:
        proto = onnx.load(str(path))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except Exception as error:  # of the parser: the package does not document which
        raise ConfigError(f"is not a valid ONNX file ({type(error).__name__})", file=str(path)) from None
    metadata = {entry.key: entry.value for entry in proto.metadata_props}.get(_METADATA_KEY)
    if metadata is None:
        text = "is not a model of fame monitor train; an Estimator can run other ONNX files"
        raise ConfigError(text, file=str(path))
    try:
        tensors = {entry.name: onnx.numpy_helper.to_array(entry) for entry in proto.graph.initializer}
        layers = range(sum(name.startswith("weight_") for name in tensors))
        weights, biases = ([tensors[f"{part}_{layer}"] for layer in layers] for part in ("weight", "bias"))
        content = {**json.loads(metadata), "mean": tensors["mean"], "scale": tensors["scale"]}
        network = {"kind": ChannelAutoencoders.kind, "activation": content["activation"]}
        return {**content, "kind": TrainedModel.kind, "detector": {**network, "weights": weights, "biases": biases}}
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"is damaged: {error!r}", file=str(path)) from None


class OnnxEstimator:
    """Any ONNX model with one input of features (n, features), with the methods of an estimator.

    Raises ConfigError for a file that onnxruntime does not take, UnavailableError without it.
    """

    n_features_in_: int

    def __init__(self, path: str | Path) -> None:
        runtime = _package("onnxruntime")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # of onnxruntime: it has classes of its own for every reason
            reason = str(error).partition("\n")[0][:120]
            raise ConfigError(f"onnxruntime refuses it: {reason}", file=str(path)) from None
        (self._input, *others) = self._session.get_inputs()
        if others:
            raise ConfigError("expected one input of features, got several", file=str(path))
        self._type = np.float64 if self._input.type == "tensor(double)" else np.float32
        if isinstance(self._input.shape[-1], int):
            self.n_features_in_ = self._input.shape[-1]

    def predict(self, features: Floats) -> Any:
        """Return the first output."""
        return self._session.run(None, {self._input.name: np.ascontiguousarray(features, dtype=self._type)})[0]


def _nodes(layers: int, activation: str, make: Any, outside: int, inside: int) -> list[Any]:
    """Build the graph: scale, channels first, the layers, mean squared error, channels last; `outside` and `inside` are
    the types of its ends and of its numbers."""
    nodes = [
        make("Cast", ["windows"], ["numbers"], to=inside),
        make("Sub", ["numbers", "mean"], ["shifted"]),
        make("Div", ["shifted", "scale"], ["scaled"]),
        make("Transpose", ["scaled"], ["inputs"], perm=[2, 0, 1]),
    ]
    at = "inputs"
    for layer in range(layers):
        nodes.append(make("MatMul", [at, f"weight_{layer}"], [f"product_{layer}"]))
        nodes.append(make("Add", [f"product_{layer}", f"bias_{layer}"], [f"sum_{layer}"]))
        at = f"sum_{layer}"
        if layer < layers - 1 and activation in _OPERATORS:
            nodes.append(make(_OPERATORS[activation], [at], [f"layer_{layer}"]))
            at = f"layer_{layer}"
    return [
        *nodes,
        make("Sub", [at, "inputs"], ["errors"]),
        make("Mul", ["errors", "errors"], ["squares"]),
        make("ReduceMean", ["squares", "samples"], ["means"], keepdims=0),
        make("Transpose", ["means"], ["losses"], perm=[1, 0]),
        make("Cast", ["losses"], ["loss"], to=outside),
    ]


def _package(name: str) -> Any:
    require(name)
    return import_module(name)
