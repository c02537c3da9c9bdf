"""Trained models as ONNX files: written for others, read back, and evaluated by onnxruntime.

The graph takes ``windows`` (n, window, channels) in the unit of the data and gives ``loss`` (n, channels), so that
whoever runs it needs nothing of FAME. What else a model knows stands in the metadata. An ONNX file holds data and
operators, never code of Python.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fame.errors import ConfigError
from fame.extras import require
from fame.monitor.pipeline.processor import Floats

if TYPE_CHECKING:
    from fame.monitor.pipeline.model import TrainedModel

_OPSET, _IR = 18, 9
_OPERATORS = {"relu": "Relu", "tanh": "Tanh", "logistic": "Sigmoid"}
_KEY = "fame"
_PLAIN = ("columns", "window", "rate", "thresholds", "cutoff", "before", "data", "versions", "metrics")


def save_onnx(model: TrainedModel, path: str | Path) -> None:
    """Write it. Raises UnavailableError without the package `onnx`."""
    onnx = _package("onnx")
    constants = {"mean": model.mean, "scale": model.scale}
    for layer, (weight, bias) in enumerate(zip(model.network.weights, model.network.biases, strict=True)):
        constants |= {f"weight_{layer}": weight, f"bias_{layer}": bias}
    shapes = (("windows", ["n", model.window, len(model.columns)]), ("loss", ["n", len(model.columns)]))
    given, told = (onnx.helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, shape) for name, shape in shapes)
    held = [onnx.numpy_helper.from_array(np.ascontiguousarray(value), name) for name, value in constants.items()]
    held.append(onnx.numpy_helper.from_array(np.array([2], dtype=np.int64), "samples"))
    graph = onnx.helper.make_graph(_nodes(model, onnx.helper.make_node), "autoencoders", [given], [told], held)
    made = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", _OPSET)], ir_version=_IR)
    plain = {name: getattr(model, name) for name in _PLAIN} | {"activation": model.network.activation}
    onnx.helper.set_model_props(made, {_KEY: json.dumps(plain, default=dict)})
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    onnx.save(made, str(path))


def load_onnx(path: str | Path) -> TrainedModel:
    """Read a model that `save_onnx` wrote. Raises ConfigError for another, UnavailableError without `onnx`."""
    from fame.monitor.pipeline.model import from_plain

    onnx = _package("onnx")
    try:
        read = onnx.load(str(path))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except Exception as error:  # of the parser: the package does not say which
        raise ConfigError(f"is no ONNX file ({type(error).__name__})", file=str(path)) from None
    noted = {entry.key: entry.value for entry in read.metadata_props}.get(_KEY)
    if noted is None:
        text = "is no model of fame train; an Estimator can run other ONNX files"
        raise ConfigError(text, file=str(path))
    try:
        content = json.loads(noted)
        held = {entry.name: onnx.numpy_helper.to_array(entry) for entry in read.graph.initializer}
        layers = sum(name.startswith("weight_") for name in held)
        content |= {"mean": held["mean"], "scale": held["scale"]}
        content |= {"weights": [held[f"weight_{layer}"] for layer in range(layers)]}
        content |= {"biases": [held[f"bias_{layer}"] for layer in range(layers)]}
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"is damaged: {error!r}", file=str(path)) from None
    return from_plain(content, str(path))


class OnnxEstimator:
    """Any ONNX model with one input of features (n, features), with the methods of an estimator.

    Raises ConfigError for a file that onnxruntime does not take, UnavailableError without it.
    """

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
            raise ConfigError("has several inputs; one of features would be right", file=str(path))
        self._type = np.float64 if self._input.type == "tensor(double)" else np.float32
        if isinstance(self._input.shape[-1], int):
            self.n_features_in_ = self._input.shape[-1]

    def predict(self, features: Floats) -> Any:
        """The first output."""
        return self._session.run(None, {self._input.name: np.ascontiguousarray(features, dtype=self._type)})[0]


def _nodes(model: TrainedModel, make: Any) -> list[Any]:
    """The graph: scale, channels first, the layers, mean squared error, channels last."""
    nodes = [
        make("Sub", ["windows", "mean"], ["shifted"]),
        make("Div", ["shifted", "scale"], ["scaled"]),
        make("Transpose", ["scaled"], ["inputs"], perm=[2, 0, 1]),
    ]
    at, last = "inputs", len(model.network.weights) - 1
    for layer in range(last + 1):
        nodes.append(make("MatMul", [at, f"weight_{layer}"], [f"product_{layer}"]))
        nodes.append(make("Add", [f"product_{layer}", f"bias_{layer}"], [f"sum_{layer}"]))
        at = f"sum_{layer}"
        if layer < last and model.network.activation in _OPERATORS:
            nodes.append(make(_OPERATORS[model.network.activation], [at], [f"layer_{layer}"]))
            at = f"layer_{layer}"
    return [
        *nodes,
        make("Sub", [at, "inputs"], ["errors"]),
        make("Mul", ["errors", "errors"], ["squares"]),
        make("ReduceMean", ["squares", "samples"], ["means"], keepdims=0),
        make("Transpose", ["means"], ["loss"], perm=[1, 0]),
    ]


def _package(name: str) -> Any:
    from importlib import import_module

    require(name)
    return import_module(name)
