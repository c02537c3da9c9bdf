"""Trained autoencoders as ONNX files, and ONNX models as estimators.

The graph takes ``windows`` (n, window, channels) in the unit of the data and gives ``loss`` (n, channels), so that
any ONNX runtime can evaluate it without FAME. The metadata hold the remaining values of the model. An ONNX file holds
data and operators, never Python code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.extras import require
from fame.monitor.arrays import Floats

_OPSET, _IR = 18, 9
_OPERATORS = {"relu": "Relu", "tanh": "Tanh", "logistic": "Sigmoid"}
_METADATA_KEY = "fame"
_NOT_METADATA = ("format", "mean", "scale", "weights", "biases")


def write_onnx(model: Mapping[str, Any], path: str | Path) -> None:
    """Write a model, given as `TrainedModel.to_plain` gives it. Raises UnavailableError without the package `onnx`."""
    onnx = _package("onnx")
    constants = {"mean": model["mean"], "scale": model["scale"]}
    for layer, (weight, bias) in enumerate(zip(model["weights"], model["biases"], strict=True)):
        constants |= {f"weight_{layer}": weight, f"bias_{layer}": bias}
    channels = len(model["columns"])
    shapes = (("windows", ["n", model["window"], channels]), ("loss", ["n", channels]))
    inputs, outputs = (
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, shape) for name, shape in shapes
    )
    tensors = [onnx.numpy_helper.from_array(np.ascontiguousarray(value), name) for name, value in constants.items()]
    tensors.append(onnx.numpy_helper.from_array(np.array([2], dtype=np.int64), "samples"))
    nodes = _nodes(len(model["weights"]), model["activation"], onnx.helper.make_node)
    graph = onnx.helper.make_graph(nodes, "autoencoders", [inputs], [outputs], tensors)
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", _OPSET)], ir_version=_IR)
    metadata = {name: value for name, value in model.items() if name not in _NOT_METADATA}
    onnx.helper.set_model_props(proto, {_METADATA_KEY: json.dumps(metadata)})
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    onnx.save(proto, str(path))


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
        text = "is not a model of fame train; an Estimator can run other ONNX files"
        raise ConfigError(text, file=str(path))
    try:
        tensors = {entry.name: onnx.numpy_helper.to_array(entry) for entry in proto.graph.initializer}
        layers = range(sum(name.startswith("weight_") for name in tensors))
        return {
            **json.loads(metadata),
            "mean": tensors["mean"],
            "scale": tensors["scale"],
            "weights": [tensors[f"weight_{layer}"] for layer in layers],
            "biases": [tensors[f"bias_{layer}"] for layer in layers],
        }
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
        """The first output."""
        return self._session.run(None, {self._input.name: np.ascontiguousarray(features, dtype=self._type)})[0]


def _nodes(layers: int, activation: str, make: Any) -> list[Any]:
    """Build the graph: scale, channels first, the layers, mean squared error, channels last."""
    nodes = [
        make("Sub", ["windows", "mean"], ["shifted"]),
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
        make("Transpose", ["means"], ["loss"], perm=[1, 0]),
    ]


def _package(name: str) -> Any:
    require(name)
    return import_module(name)
