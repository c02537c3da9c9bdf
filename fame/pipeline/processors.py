"""The processors that come with FAME, by the name that a configuration gives as `Class`."""

from __future__ import annotations

from fame.pipeline.decisions import Expression, Threshold
from fame.pipeline.filters import LowPass, Resample, Scale
from fame.pipeline.learned import Autoencoder, Estimator
from fame.pipeline.machine import Machine
from fame.pipeline.windows import RMS, MovingStatistics, Spectrum, Window

PROCESSORS: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        LowPass, Resample, Scale, Window, RMS, MovingStatistics, Spectrum,
        Estimator, Autoencoder, Threshold, Expression, Machine,
    )
}  # fmt: skip

__all__ = [
    "PROCESSORS",
    "RMS",
    "Autoencoder",
    "Estimator",
    "Expression",
    "LowPass",
    "Machine",
    "MovingStatistics",
    "Resample",
    "Scale",
    "Spectrum",
    "Threshold",
    "Window",
]
