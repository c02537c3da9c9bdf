"""What holds for all tests."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator

import pytest
from domains import DOMAIN

if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):  # hundreds of processes would compile FAME, each for itself
    sys.dont_write_bytecode = False
for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # each worker has a core: threads would wait for each other
    os.environ.setdefault(threads, "1")
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)  # of this worker alone: a test that names no domain meets no other test
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever starts the tests may have it ignored: nohup, a shell


@pytest.fixture(autouse=True, scope="module")
def _closed_worlds() -> Iterator[None]:
    """Close the worlds of a module, so that none is left to the garbage collector (see `World._clear`)."""
    yield
    grounds = sys.modules.get("grounds") or sys.modules.get("tests.grounds")
    while grounds is not None and grounds.OPEN:
        grounds.OPEN.pop().close()
