"""Models that earlier versions stored, as they would be stored now."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

_NO_LIMIT = 1e9
"""Of the tilt, in models that do not see it."""


def _first_windows(content: Mapping[str, Any]) -> dict[str, Any]:
    """``fame-autoencoder-1``: autoencoders only, and no calibration."""
    return _windows({**content, "detector": {**content, "kind": "autoencoder"}})


def _windows(content: Mapping[str, Any]) -> dict[str, Any]:
    """``fame-monitor-2``: a kind of its own."""
    return {**content, "kind": "windows"}


def _points(content: Mapping[str, Any]) -> dict[str, Any]:
    """``fame-adm-1``: a kind of its own; an ensemble of whole models."""
    return {**content, "kind": "points", "detector": _detector(content)}


def _detector(content: Mapping[str, Any]) -> dict[str, Any]:
    plain = content["estimator"]
    if isinstance(plain, dict) and "members" in plain:
        members = plain["members"]
        return {
            "kind": "several", "rule": plain["rule"], "parts": list(map(_detector, members)),
            "names": [each["name"] for each in members], "usual": [[each["threshold"]] for each in members],
        }  # fmt: skip
    if isinstance(plain, dict):
        limits = np.asarray(plain["limits"], dtype=np.float64)
        missing = ((0, 0), (0, 4 - limits.shape[1]))  # the first version had no tilt
        limits = np.pad(limits, missing, constant_values=_NO_LIMIT)
        paths = {"turns": np.zeros((0, 4)), **plain, "kind": None}
        return {**plain, "chain": paths, "paths": paths, "limits": limits}
    reduction, scaling, scaler, pca = content["process"]
    process = {"reduction": reduction, "scaling": scaling, "scaler": scaler, "pca": pca}
    return {"kind": "classifier", "classifier": plain, "process": process}


EARLIER: Mapping[Any, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "fame-autoencoder-1": _first_windows, "fame-monitor-2": _windows, "fame-adm-1": _points,
}  # fmt: skip
"""What makes the content of today of one in a format."""
