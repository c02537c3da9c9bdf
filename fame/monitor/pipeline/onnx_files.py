"""Trained models as ONNX files, and ONNX files of others as estimators.

The graph takes ``windows`` (n, window, channels) in the unit of the data and gives ``loss`` (n, channels), so that any
ONNX runtime can evaluate it without FAME. Where the detector knows phases it also takes ``times`` (n,): s at the end of
each window on the axis of phases (since the start of the run), NaN where that is not known. What cuts windows and finds
runs, the low-passes and the thresholds are not in the graph; the metadata hold all values of the model, those of the
graph by name, so that FAME reads the model back. An ONNX file holds data and operators, never Python code.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats
from fame.monitor.calibration import LEAST
from fame.monitor.pipeline import detectors, phases
from fame.monitor.pipeline.detectors import (
    ChannelAutoencoders,
    Components,
    FittedDetector,
    Forest,
    Nearest,
    OneClass,
    Several,
    Whitening,
    detector_name,
)
from fame.monitor.pipeline.phases import Phases

if TYPE_CHECKING:
    from fame.monitor.pipeline.trained_model import TrainedModel

_OPSET, _IR = 18, 9
_OPERATORS = {"relu": "Relu", "tanh": "Tanh", "logistic": "Sigmoid"}
_METADATA_KEY = "fame"
_TENSOR = "tensor"
SAME = 1e-5
"""Largest difference of a loss from that of the model, in units of the threshold or of the loss, whichever is more."""


class _Graph:
    """Nodes in order, and the constants that they use."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self.nodes: list[Any] = []
        self.tensors: dict[int, tuple[str, Any]] = {}  # by the identity of the array, which the model has, too
        self._make = make

    def __call__(self, operator: str, *inputs: Any, to: str = "", **attributes: Any) -> str:
        """Add a node; its inputs are the names of others, or constants. Returns the name of its output."""
        names = [each if isinstance(each, str) else self.constant(each) for each in inputs]
        output = to or f"{operator}_{len(self.nodes)}"
        self.nodes.append(self._make(operator, names, [output], **attributes))
        return output

    def constant(self, value: Any) -> str:
        array = np.asarray(value)
        return self.tensors.setdefault(id(array), (f"constant_{len(self.tensors)}", array))[0]

    def flat(self, values: str) -> str:
        return self("Reshape", values, np.array([0, -1]))

    def mean_square(self, errors: str) -> str:
        """(n, samples, channels) to (n, channels)."""
        return self("ReduceMean", self("Mul", errors, errors), np.array([1]), keepdims=0)

    def reduced(self, windows: str, samples: int) -> str:
        """`fame.monitor.pipeline.phases.reduced`, which is linear: a product with what it makes of each sample."""
        return self("MatMul", np.ascontiguousarray(phases.reduced(np.eye(samples)[None])[0]), windows)

    def projected(self, components: Components, windows: str) -> str:
        """`Components.project` without the division by the deviations."""
        return self("Gemm", self.flat(windows), components.axes, transB=1)

    def shared(self, score: str, windows: str) -> str:
        """`fame.monitor.pipeline.other_estimators.shared`."""
        energy = self("Add", self("ReduceSum", self("Mul", windows, windows), np.array([1]), keepdims=0), 1e-12)
        share = self("Div", energy, self("ReduceMax", energy, np.array([1]), keepdims=1))
        return self("Mul", self("Unsqueeze", score, np.array([1])), share)


_Form = Callable[[_Graph, Any, str, tuple[int, int]], str]
"""Adds a detector to a graph: of scaled windows, and their samples and channels. Returns its loss."""
_TIMES = "numbered_times"


def _autoencoders(graph: _Graph, network: ChannelAutoencoders, windows: str, shape: tuple[int, int]) -> str:
    at = inputs = graph("Transpose", windows, perm=[2, 0, 1])
    for number, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        at = graph("Add", graph("MatMul", at, weight), bias)
        if number < len(network.weights) - 1 and network.activation in _OPERATORS:
            at = graph(_OPERATORS[network.activation], at)
    return graph.mean_square(graph("Transpose", graph("Sub", at, inputs), perm=[1, 2, 0]))


def _components(graph: _Graph, detector: Components, windows: str, shape: tuple[int, int]) -> str:
    told = graph("MatMul", graph.projected(detector, windows), detector.axes)
    return graph.mean_square(graph("Sub", windows, graph("Reshape", told, np.array([-1, *shape]))))


def _whitening(graph: _Graph, detector: Whitening, windows: str, shape: tuple[int, int]) -> str:
    return _whitened(graph, windows, detector.root, shape)


def _whitened(graph: _Graph, values: str, root: Floats, shape: tuple[int, int]) -> str:
    white = graph("MatMul", graph.flat(values), root)
    return graph.mean_square(graph("Reshape", white, np.array([-1, *shape])))


def _nearest(graph: _Graph, detector: Nearest, windows: str, shape: tuple[int, int]) -> str:
    values, kept = graph.reduced(windows, shape[0]), detector.place(detector.kept)
    product = graph("MatMul", graph.projected(detector.components, values), np.ascontiguousarray(-2 * kept.T))
    nearest = graph("ArgMin", graph("Add", product, (kept**2).sum(axis=1)), axis=1, keepdims=0)
    return graph.mean_square(graph("Sub", values, graph("Gather", detector.kept, nearest)))


def _one_class(graph: _Graph, detector: OneClass, windows: str, shape: tuple[int, int]) -> str:
    features = graph("Div", graph.projected(detector.components, windows), detector.components.deviations)
    own = graph("ReduceSum", graph("Mul", features, features), np.array([1]), keepdims=1)
    product = graph("MatMul", features, np.ascontiguousarray(-2 * detector.vectors.T))
    squares = graph("Add", graph("Add", product, (detector.vectors**2).sum(axis=1)), own)
    weighs = graph("Mul", graph("Max", squares, 0.0), -detector.gamma)
    exponents = graph("Add", weighs, np.log(detector.weights))
    largest = graph("ReduceMax", exponents, np.array([1]), keepdims=1)
    total = graph("ReduceSum", graph("Exp", graph("Sub", exponents, largest)), np.array([1]), keepdims=0)
    density = graph("Add", graph("Log", total), graph("Squeeze", largest, np.array([1])))
    return graph.shared(graph("Max", graph("Sub", 1.0 + np.log(detector.offset), density), 0.0), windows)


def _forest(graph: _Graph, detector: Forest, windows: str, shape: tuple[int, int]) -> str:
    """Go down all trees at once, a level for each step; nodes are numbered through all trees."""
    values = graph("Div", graph.projected(detector.components, windows), detector.components.deviations)
    trees, size = detector.features.shape
    first = np.arange(trees)[:, None] * size
    parts = (detector.features, detector.limits, detector.left + first, detector.right + first, detector.depths)
    features, limits, left, right, depths = map(np.ravel, parts)
    count = graph("Concat", graph("Shape", values, start=0, end=1), np.array([1]), axis=0)
    node = graph("Expand", np.ascontiguousarray(first.T), count)
    for _ in range(detector.steps):
        value = graph("GatherElements", values, graph("Gather", features, node), axis=1)
        is_left = graph("LessOrEqual", value, graph("Gather", limits, node))
        node = graph("Where", is_left, graph("Gather", left, node), graph("Gather", right, node))
    depth = graph("ReduceMean", graph("Gather", depths, node), np.array([1]), keepdims=0)
    return graph.shared(graph("Pow", 2.0, graph("Mul", depth, -1.0 / detector.usual)), windows)


def _phases(graph: _Graph, detector: Phases, windows: str, shape: tuple[int, int]) -> str:
    rows = detector.rows if len(detector.rows) else np.arange(len(detector.location))

    def row(found: str) -> str:
        inside = graph("And", graph("GreaterOrEqual", found, 0.0), graph("Less", found, float(len(rows))))
        place = graph("Cast", graph("Where", inside, found, 0.0), to_type="INT64")
        return graph("Where", inside, graph("Gather", rows, place), -1)

    def phase(of: Floats, place: str) -> str:
        return graph("Gather", of, graph("Max", place, 0))

    values, reduced = graph.reduced(windows, shape[0]), detector.location.shape[1:]
    place = graph("Div", graph("Sub", _TIMES, detector.begin), detector.step)
    low_place, near = graph("Floor", graph("Add", place, 1e-6)), row(graph("Round", place))
    low, high = row(low_place), row(graph("Add", low_place, 1.0))
    low, high = (graph("Where", graph("Less", each, 0), near, each) for each in (low, high))
    share = graph("Clip", graph("Sub", place, low_place), 0.0, 1.0)
    share = graph("Unsqueeze", share, np.array([1, 2]))
    before = phase(detector.location, low)
    usual = graph("Add", before, graph("Mul", share, graph("Sub", phase(detector.location, high), before)))
    deviations = _arcsinh(graph, graph("Div", graph("Sub", values, usual), phase(detector.scale, near)))
    shift = graph("ReduceMean", deviations, np.array([1]), keepdims=0)
    shape_loss = graph("Div", _whitened(graph, deviations, detector.root, reduced), detector.usual[0])
    inside = graph("Max", shape_loss, graph("Div", graph("Mul", shift, shift), detector.usual[1]))
    elsewhere = _whitened(graph, _arcsinh(graph, values), detector.elsewhere, reduced)
    known = graph("Unsqueeze", graph("GreaterOrEqual", near, 0), np.array([1]))
    return graph("Where", known, inside, graph("Div", elsewhere, detector.usual[2]))


def _arcsinh(graph: _Graph, values: str) -> str:
    """By logarithms: the operator Asinh is not for 64 bit everywhere."""
    size = graph("Abs", values)
    root = graph("Sqrt", graph("Add", graph("Mul", size, size), 1.0))
    return graph("Mul", graph("Sign", values), graph("Log", graph("Add", size, root)))


def _several(graph: _Graph, detector: Several, windows: str, shape: tuple[int, int]) -> str:
    found = [
        graph("Div", _FORMS[type(part)](graph, part, windows, shape), usual)
        for part, usual in zip(detector.parts, detector.usual, strict=True)
    ]
    return graph("Max" if detector.rule == detectors.RULES[0] else "Min", *found)


_FORMS: Mapping[type, _Form] = {
    ChannelAutoencoders: _autoencoders, Components: _components, Whitening: _whitening, Nearest: _nearest,
    OneClass: _one_class, Forest: _forest, Phases: _phases, Several: _several,
}  # fmt: skip


def _refuse(detector: FittedDetector) -> None:
    """Raise ConfigError for a detector that has no form in ONNX."""
    for part in getattr(detector, "parts", (detector,)):
        if type(part) not in _FORMS:
            text = f"{detector_name(part)} has no form in ONNX: expected one of {', '.join(detectors.DETECTORS)}"
            raise ConfigError(f"{text}, or several of these")


def takes_times(detector: FittedDetector) -> bool:
    """Return whether a detector, or one of several, knows phases."""
    return any(isinstance(part, Phases) for part in getattr(detector, "parts", (detector,)))


def onnx_bytes(model: TrainedModel, *, single: bool = False) -> bytes:
    """Return a model as the content of an ONNX file; `single`: inputs and outputs of 32 bit.

    The graph computes with 64 bit in both cases. Raises UnavailableError without the package `onnx`, ConfigError for a
    detector that has no form in ONNX.
    """
    _refuse(model.detector)
    onnx = _package("onnx")
    types, helper = onnx.TensorProto.DataType, onnx.helper

    def make(operator: str, names: list[str], outputs: list[str], to_type: str = "", **attributes: Any) -> Any:
        return helper.make_node(
            operator, names, outputs, **attributes, **({"to": types.Value(to_type)} if to_type else {})
        )

    ends = "FLOAT" if single else "DOUBLE"
    graph, shape, timed = _Graph(make), (model.window, len(model.columns)), takes_times(model.detector)
    numbers = graph("Cast", "windows", to_type="DOUBLE")
    if timed:
        graph("Cast", "times", to=_TIMES, to_type="DOUBLE")
    scaled = graph("Div", graph("Sub", numbers, model.mean), model.scale)
    graph("Cast", _FORMS[type(model.detector)](graph, model.detector, scaled, shape), to="loss", to_type=ends)
    inputs = [("windows", ["windows", *shape]), *([("times", ["windows"])] if timed else [])]
    named = [helper.make_tensor_value_info(name, types.Value(ends), sizes) for name, sizes in inputs]
    loss = helper.make_tensor_value_info("loss", types.Value(ends), ["windows", shape[1]])
    tensors = [onnx.numpy_helper.from_array(array, name) for name, array in graph.tensors.values()]
    proto = helper.make_model(
        helper.make_graph(graph.nodes, "detector", named, [loss], tensors),
        opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR,
    )  # fmt: skip

    def plain(array: Any) -> Any:
        name = graph.tensors.get(id(array), ("",))[0]
        return {_TENSOR: name} if name else array.tolist()

    helper.set_model_props(proto, {_METADATA_KEY: json.dumps(model.to_plain(), default=plain)})
    return bytes(proto.SerializeToString())


def read_onnx(path: str | Path) -> dict[str, Any]:
    """Read what `onnx_bytes` made. Raises ConfigError for any other file, UnavailableError without `onnx`."""
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
        content = json.loads(
            metadata, object_hook=lambda part: tensors[part[_TENSOR]] if [*part] == [_TENSOR] else part
        )
        return dict(content) if "detector" in content else _earlier(content, tensors)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"is damaged: {error!r}", file=str(path)) from None


def _earlier(content: Mapping[str, Any], tensors: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file of an earlier release, which has autoencoders alone."""
    layers = range(sum(name.startswith("weight_") for name in tensors))
    weights, biases = ([tensors[f"{part}_{layer}"] for layer in layers] for part in ("weight", "bias"))
    network = {"kind": ChannelAutoencoders.kind, "activation": content["activation"]}
    found = {**content, "mean": tensors["mean"], "scale": tensors["scale"], "kind": "windows"}
    return {**found, "detector": {**network, "weights": weights, "biases": biases}}


def difference(model: TrainedModel, content: bytes, windows: Floats, times: Floats) -> float:
    """Return the largest difference of the losses of an ONNX file, given its content, from those of the model (`SAME`),
    on windows (n, window, channels) that end at `times` (n,). Raises ConfigError, UnavailableError without
    `onnxruntime`."""
    session = _session(content)
    inputs = dict(zip((each.name for each in session.get_inputs()), (windows, times), strict=False))
    kind = _type(session.get_inputs()[0])
    given = {name: np.ascontiguousarray(values, dtype=kind) for name, values in inputs.items()}
    found = session.run(None, given)[0].astype(np.float64)
    expected = model.loss(given["windows"], given.get("times", times.astype(kind)).astype(np.float64))
    apart = np.abs(found - expected) / np.maximum(np.maximum(expected, model.thresholds), LEAST)
    return float(np.nan_to_num(apart, nan=np.inf).max(initial=0.0))


class OnnxEstimator:
    """Any ONNX model with one input of features (n, features), with the methods of an estimator.

    Raises ConfigError for a file that onnxruntime does not take, UnavailableError without it.
    """

    n_features_in_: int

    def __init__(self, path: str | Path) -> None:
        self._session = _session(path)
        (self._input, *others) = self._session.get_inputs()
        if others:
            raise ConfigError("expected one input of features, got several", file=str(path))
        if isinstance(self._input.shape[-1], int):
            self.n_features_in_ = self._input.shape[-1]

    def predict(self, features: Floats) -> Any:
        """Return the first output."""
        values = np.ascontiguousarray(features, dtype=_type(self._input))
        return self._session.run(None, {self._input.name: values})[0]


def _session(file: str | Path | bytes) -> Any:
    runtime = _package("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return runtime.InferenceSession(
            file if isinstance(file, bytes) else str(file), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # of onnxruntime: it has classes of its own for every reason
        reason = str(error).partition("\n")[0][:120]
        raise ConfigError(
            f"onnxruntime refuses it: {reason}", file="" if isinstance(file, bytes) else str(file)
        ) from None


def _type(end: Any) -> type[np.floating[Any]]:
    return np.float64 if end.type == "tensor(double)" else np.float32


def _package(name: str) -> Any:
    require(name)
    return import_module(name)
