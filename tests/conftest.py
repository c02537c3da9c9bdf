"""What holds for all tests."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator

import pytest

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever starts the tests may have it ignored: nohup, a shell


@pytest.fixture(autouse=True, scope="module")
def _closed_worlds() -> Iterator[None]:
    """Close the worlds of a module, so that none is left to the garbage collector (see `World._clear`)."""
    yield
    grounds = sys.modules.get("grounds") or sys.modules.get("tests.grounds")
    while grounds is not None and grounds.OPEN:
        grounds.OPEN.pop().close()
