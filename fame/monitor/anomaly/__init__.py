"""The anomaly detection module: learn what a repetitive task of an arm looks like, raise an alarm when a run leaves it.

::

    recording    joint states over time, cut into runs: what is learned from and scored
    files        recordings as CSV; joining them
    bags         recordings from bags
    packages     scipy, where it is used
    runs         where one run of the task ends and the next begins
    config       the learning file
    process      DataProcess: splitting columns, scaling, principal components
    persist      DataPersist, and stored models: in a format that cannot execute code
    matrix       OutputMatrix: the confusion matrix and what follows from it
    detector     AnomalyDetector: the classifiers, fitted and asked
    interface    Interface: the published script's four steps
    chain        forward kinematics of any serial arm
    paths        PathDetector: how far the tool is from the benign paths, and how late
    learn        the table of classifiers, the best of them stored
    model        a stored model: scores points, quickly
    live         scores a run while it goes on
    watch        says when a topic is silent
    collect      the node that records, `operate` the node that watches
    cli          `fame adm`

A point is one joint state. Positive means anomalous; labels are +1 benign, -1 anomalous. The anomaly score of a run is
its anomalous points divided by all its points; a run is anomalous if the score exceeds the threshold. Splits never
take a run apart. A figure that comes from the data that was learned from says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import attach

if TYPE_CHECKING:
    from fame.monitor.anomaly.chain import Chain as Chain, load_chain as load_chain
    from fame.monitor.anomaly.confusion_matrix import OutputMatrix as OutputMatrix
    from fame.monitor.anomaly.detector import AnomalyDetector as AnomalyDetector
    from fame.monitor.anomaly.files import read_csv as read_csv, write_csv as write_csv
    from fame.monitor.anomaly.interface import Interface as Interface
    from fame.monitor.anomaly.model import Model as Model
    from fame.monitor.anomaly.paths import PathDetector as PathDetector
    from fame.monitor.anomaly.process import DataProcess as DataProcess
    from fame.monitor.anomaly.recording import Recording as Recording
    from fame.monitor.anomaly.storage import DataPersist as DataPersist, load_model as load_model
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "chain": ["Chain", "load_chain"],
            "confusion_matrix": ["OutputMatrix"],
            "detector": ["AnomalyDetector"],
            "files": ["read_csv", "write_csv"],
            "interface": ["Interface"],
            "model": ["Model"],
            "paths": ["PathDetector"],
            "process": ["DataProcess"],
            "recording": ["Recording"],
            "storage": ["DataPersist", "load_model"],
        },
    )
