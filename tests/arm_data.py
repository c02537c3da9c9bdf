"""The public recordings of the arm, for tests that need them: those skip, by name, where the files are missing."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from fame.monitor.anomaly.recording import Recording, read_csv

FOLDER = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "mh5"
BENIGN, BOTH = FOLDER / "original_30.csv", FOLDER / "rbfsvm_train_30.csv"

needs_data = pytest.mark.skipif(not BENIGN.is_file(), reason=f"needs the public recordings of the MH5 in {FOLDER}")


@cache
def recording(path: Path) -> Recording:
    return read_csv(path)
