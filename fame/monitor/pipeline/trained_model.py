"""Trained models: a detector with thresholds and origin, stored and loaded, also as ONNX files (`onnx_files`).

Models are stored as `fame.monitor.storage` says; all detectors are plain arrays and texts, which do not depend on the
version of scikit-learn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.calibration import Calibration
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.detectors import ACTIVATIONS, STORED, ChannelAutoencoders, FittedDetector, detector_name
from fame.monitor.pipeline.onnx_files import onnx_bytes, read_onnx
from fame.monitor.storage import StoredModel, read_model
from fame.text import write_file

LEAST_MOVEMENT = "least_movement"
"""In the conditions of a model."""
FARTHEST = 1e60
"""Deviation, in the scaled unit, from which on values count as the same: its square is still finite."""
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
        with np.errstate(over="ignore"):
            scaled = (np.asarray(windows, dtype=np.float64) - self.mean) / self.scale
        return self.detector.loss(np.clip(scaled, -FARTHEST, FARTHEST), times)

    def save(self, path: str | Path, *, single: bool = False) -> None:
        """Store the model: with skops, or as ONNX if the name ends in ``.onnx``; `single`: with inputs and outputs of
        32 bit.

        Raises UnavailableError without the package that writes it, ConfigError for a detector without a form in ONNX.
        """
        if str(path).endswith(".onnx"):
            write_file(path, onnx_bytes(self, single=single))
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
