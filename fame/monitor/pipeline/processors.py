"""The processors that come with FAME, by the name that a configuration gives as `Class`."""

from __future__ import annotations

from fame.monitor.pipeline.estimators import Autoencoder, Estimator
from fame.monitor.pipeline.filters import LowPass, Resample, Scale
from fame.monitor.pipeline.polled_source import Machine
from fame.monitor.pipeline.threshold import Expression, Threshold
from fame.monitor.pipeline.windows import RMS, MovingStatistics, Spectrum, Window

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
