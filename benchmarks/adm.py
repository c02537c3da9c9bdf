"""Time to score one sample, and to learn: python benchmarks/adm.py [--data DIR] [--learn].

One JSON line per classifier: microseconds per sample, median and 99th percentile over some runs, on one core; with
--learn the seconds that learning with the default configuration takes on two, and its seconds of processor time. The
data are those of the MH5.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from joblib.externals.loky import get_reusable_executor

from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import DEFAULTS, fit, make
from fame.monitor.anomaly.learn import best, learn
from fame.monitor.anomaly.learning_file import CandidateClassifier, DataFile, Learning
from fame.monitor.anomaly.model import Model, PointClassifier
from fame.monitor.anomaly.recording import Recording, read_csv

ROOT = Path(__file__).resolve().parent.parent
PATH = CandidateClassifier(
    "path", "PathDetector", {"chain": str(ROOT / "robots" / "arm" / "mh5.yaml")}, reduction=0, threshold=0.002
)
COLUMNS = (0, 1, 2, 3, 4, 5)


def model(candidate: CandidateClassifier, benign: Recording, both: Recording) -> Model:
    """A classifier fitted to all data: only its speed is of interest."""
    detector = make(candidate, ROOT)
    if isinstance(detector, PointClassifier):
        detector.process.fit(benign.values)
    fit(detector, both if detector.supervised else benign)
    return Model(candidate.name, benign.joints, detector, 0.0, 518, benign.select([0]).values)


def microseconds(scorer: Any, runs: Recording) -> np.ndarray:
    """Per sample."""
    taken = []
    for run in runs:
        scorer.reset()
        for row in run.values.tolist():
            began = time.perf_counter()
            scorer.step(row)
            taken.append(time.perf_counter() - began)
    return 1e6 * np.array(taken)


def cpu_seconds() -> float:
    """Processor time of this process and of those it started."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(item.ru_utime + item.ru_stime for item in used)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "mh5")
    parser.add_argument("--learn", action="store_true", help="time learning too")
    arguments = parser.parse_args()
    files = [arguments.data / name for name in ("original_30.csv", "rbfsvm_train_30.csv")]
    try:
        benign, both = (read_csv(path) for path in files)
    except ConfigError as error:
        sys.exit(f"{error}; the recordings are those of mh5_anomaly_detector: --data DIR")
    for candidate in (*DEFAULTS, PATH):
        scorer = model(candidate, benign, both).scorer()
        taken = microseconds(scorer, benign.select(range(10)))
        line = {"case": f"score, {candidate.name}", "us_median": np.median(taken), "us_99": np.quantile(taken, 0.99)}
        print(
            json.dumps(
                {key: value if isinstance(value, str) else round(float(value), 1) for key, value in line.items()}
            )
        )
    if arguments.learn:
        first, second = (DataFile(path, COLUMNS, 6) for path in files)
        learning = Learning(ROOT / "learning.yaml", first, first, second, ())
        began = time.perf_counter()
        before = cpu_seconds()
        chosen = best(learn(learning, jobs=2))
        taken = time.perf_counter() - began
        get_reusable_executor().shutdown(wait=True)  # processor time of a process counts once it has ended
        line = {"case": "learn", "s": round(taken, 1), "cpu_s": round(cpu_seconds() - before, 1)}
        print(json.dumps({**line, "best": chosen.candidate.name}))


if __name__ == "__main__":
    main()
