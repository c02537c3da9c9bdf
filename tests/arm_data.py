"""The public recordings of the arm, for tests that need them: those skip, by name, where the files are missing."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import Recording, read_csv
from robots.arm.task import MH5

FOLDER = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "mh5"
BENIGN, BOTH = FOLDER / "original_30.csv", FOLDER / "rbfsvm_train_30.csv"

needs_data = pytest.mark.skipif(not BENIGN.is_file(), reason=f"needs the public recordings of the MH5 in {FOLDER}")


@cache
def recording(path: Path) -> Recording:
    return read_csv(path)


def runs(*numbers: int) -> np.ndarray:
    """The joint positions of benign runs, one after another."""
    return recording(BENIGN).select(numbers).values


@cache
def learned() -> PathDetector:
    """A detector that knows every other benign run."""
    return PathDetector(MH5).fit(recording(BENIGN).select(range(0, 30, 2)))


@cache
def path_model() -> Model:
    """The model of this detector."""
    return Model("path", MH5.joints, learned(), 0.002, 518, runs(0, 1))
