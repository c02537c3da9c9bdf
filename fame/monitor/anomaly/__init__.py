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

from fame.lazy import from_homes

_HOMES = {
    "AnomalyDetector": "detector",
    "Chain": "chain",
    "DataPersist": "storage",
    "DataProcess": "process",
    "Interface": "interface",
    "Model": "model",
    "OutputMatrix": "confusion_matrix",
    "PathDetector": "paths",
    "Recording": "recording",
    "load_chain": "chain",
    "load_model": "storage",
    "read_csv": "files",
    "write_csv": "files",
}
__all__ = [
    "AnomalyDetector",
    "Chain",
    "DataPersist",
    "DataProcess",
    "Interface",
    "Model",
    "OutputMatrix",
    "PathDetector",
    "Recording",
    "load_chain",
    "load_model",
    "read_csv",
    "write_csv",
]

__getattr__ = from_homes(__name__, _HOMES)
"""What is asked for, imported now: importing `fame.monitor.anomaly` itself costs nothing."""
