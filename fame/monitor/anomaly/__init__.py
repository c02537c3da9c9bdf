"""The anomaly detection module: learn what a repetitive task of an arm looks like, raise an alarm when a run differs.

::

    recording      joint states over time, cut into runs; CSV files of them
    learning_file  the learning file
    paths          PathDetector: deviation and tilt of the tool against the benign paths, and its lateness
    benign_changes speed, pauses, lost samples, start pose, sag and noise of a run as a whole
    model          a stored model; PointClassifier, DataProcess, DataPersist
    scoring        scores points one by one, by one detector or several
    classifiers    classifiers by name, fitted and evaluated; AnomalyDetector, OutputMatrix
    thresholds     of classifiers: given, between the classes, or promising a rate of false alarms
    learn          fit and evaluate every classifier, choose the best
    interface      Interface, for learning scripts
    live           ArmRuns: the joint states of an arm cut into runs, scored or collected while they come
    nodes          recording nodes that give joint states to these

A point is one joint state. Positive means anomalous; labels are +1 benign, -1 anomalous. The anomaly score of a run is
its anomalous points divided by all its points; a run is anomalous if the score exceeds the threshold. A split into
training and test data never divides a run. Results on training data are marked as such.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.monitor.anomaly.classifiers import AnomalyDetector as AnomalyDetector, OutputMatrix as OutputMatrix
    from fame.monitor.anomaly.interface import Interface as Interface
    from fame.monitor.anomaly.model import (
        DataPersist as DataPersist,
        DataProcess as DataProcess,
        Model as Model,
    )
    from fame.monitor.anomaly.paths import PathDetector as PathDetector
    from fame.monitor.anomaly.recording import Recording as Recording, read_csv as read_csv, write_csv as write_csv
else:
    __getattr__, __dir__, __all__ = attach(__name__)
