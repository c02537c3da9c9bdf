"""The anomaly detection module: learn what a repetitive task of an arm looks like, raise an alarm when a run leaves it.

::

    recording      joint states over time, cut into runs; CSV files of them
    segmentation   where one run of the task ends and the next begins
    learning_file  the learning file
    preprocessing  DataProcess: scaling, principal components
    paths          PathDetector: deviation of the tool from the benign paths, and its lateness
    classifiers    classifiers by name, fitted and asked; AnomalyDetector
    evaluation     OutputMatrix: the confusion matrix; tables of results
    model          a stored model: scores points, quickly; DataPersist
    learn          fit and judge every classifier, choose the best
    interface      Interface: the four steps of the published script
    live           score or record a run while it goes on
    nodes          the node that records and the node that watches

A point is one joint state. Positive means anomalous; labels are +1 benign, -1 anomalous. The anomaly score of a run is
its anomalous points divided by all its points; a run is anomalous if the score exceeds the threshold. Splits never
take a run apart. Figures from the data that was learned from are marked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import attach

if TYPE_CHECKING:
    from fame.monitor.anomaly.classifiers import AnomalyDetector as AnomalyDetector
    from fame.monitor.anomaly.evaluation import OutputMatrix as OutputMatrix
    from fame.monitor.anomaly.interface import Interface as Interface
    from fame.monitor.anomaly.model import DataPersist as DataPersist, Model as Model, load_model as load_model
    from fame.monitor.anomaly.paths import PathDetector as PathDetector
    from fame.monitor.anomaly.preprocessing import DataProcess as DataProcess
    from fame.monitor.anomaly.recording import Recording as Recording, read_csv as read_csv, write_csv as write_csv
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "classifiers": ["AnomalyDetector"],
            "evaluation": ["OutputMatrix"],
            "interface": ["Interface"],
            "model": ["DataPersist", "Model", "load_model"],
            "paths": ["PathDetector"],
            "preprocessing": ["DataProcess"],
            "recording": ["Recording", "read_csv", "write_csv"],
        },
    )
