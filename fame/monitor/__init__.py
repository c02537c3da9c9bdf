"""Data-driven monitoring: pipelines of processors, recording, learned models, and anomaly detection for arms.

pipeline    processors, the nodes that run them, recording, training
anomaly     learn what a repetitive task of an arm looks like; raise an alarm when a run differs
services    the services of both, for service tasks of a mission; `loading` of what takes long
calibration thresholds that promise a rate of false alarms
judge       `fame monitor judge`, with `judge_report`; drift: slow changes over runs
comparison  two models on the same recordings; copies: runs that are copies of others
model_card  the card of a model
data_files  CSV tables and bags
storage     models on disk; `earlier_models`: those of earlier versions
estimator   `Detector`, an estimator of scikit-learn
plots       plots of losses, thresholds and alarms
kinematics  forward kinematics of serial arms
arrays      types of arrays
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.monitor.estimator import Detector as Detector
    from fame.monitor.pipeline.filters import LowPass as LowPass
    from fame.monitor.pipeline.processor import Parameter as Parameter, Samples as Samples
    from fame.monitor.pipeline.processors import run as run
    from fame.monitor.pipeline.threshold import Threshold as Threshold
    from fame.monitor.plots import plot_loss as plot_loss
else:
    __getattr__, __dir__, __all__ = attach(__name__)
