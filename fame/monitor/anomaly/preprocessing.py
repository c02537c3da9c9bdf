"""DataProcess: splitting columns, scaling, principal components."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fame.errors import ConfigError
from fame.monitor.anomaly.learning_file import SCALINGS
from fame.monitor.anomaly.recording import read_csv
from fame.monitor.arrays import Floats


class DataProcess:
    """Preprocessing of points for a classifier: scaling, then reduction.

    reduction  how many principal components are kept; 0: all columns as they are
    scaling    ``minmax`` (each column to 0 ... 1), ``standard`` (mean 0, deviation 1) or ``none``
    """

    reduction: int
    scaling: str
    scaler: Any
    pca: Any

    def __init__(self, reduction: int = 0, scaling: str = "minmax", scaler: Any = None, pca: Any = None) -> None:
        if scaling not in SCALINGS:
            raise ConfigError(f"expected a scaling of {', '.join(SCALINGS)}, got {scaling!r}")
        self.reduction, self.scaling = reduction, scaling
        self.scaler, self.pca = scaler, pca

    def split(self, in_file: str | Path, x_cols: Sequence[int], y_cols: Sequence[int]) -> tuple[Floats, Any]:
        """The input columns (points, inputs) and the label column (points,) of a CSV file; columns count from 0."""
        recording = read_csv(in_file, x_cols, y_cols[0] if y_cols else None)
        return recording.values, recording.labels

    def fit(self, values: Floats) -> DataProcess:
        """Learn scaling and components from points (points, inputs). Raises ConfigError if they are too few."""
        from sklearn.decomposition import PCA
        from sklearn.preprocessing import MinMaxScaler, StandardScaler

        points, inputs = values.shape
        if points <= inputs:
            raise ConfigError(f"has {points} points of {inputs} columns: more points than columns are needed")
        if self.reduction > inputs or self.reduction < 0:
            text = f"reduction: expected 0 (none) or 1 to {inputs} components, got {self.reduction}"
            raise ConfigError(text)
        kinds: dict[str, Any] = {"minmax": MinMaxScaler, "standard": StandardScaler}
        self.scaler = kinds[self.scaling]().fit(values) if self.scaling in kinds else None
        self.pca = PCA(self.reduction).fit(self._scaled(values)) if self.reduction else None
        return self

    def transform(self, values: Floats) -> Floats:
        """(points, inputs) as classifiers see them."""
        scaled = self._scaled(values)
        return np.asarray(self.pca.transform(scaled) if self.pca is not None else scaled)

    def affine(self, inputs: int) -> tuple[Floats, Floats]:
        """The same as one matrix and offset: ``transform(x) == x @ matrix + offset``."""
        offset = self.transform(np.zeros((1, inputs)))[0]
        return self.transform(np.eye(inputs)) - offset, offset

    def _scaled(self, values: Floats) -> Floats:
        return np.asarray(self.scaler.transform(values) if self.scaler is not None else values)
