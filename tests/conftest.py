"""What holds for all tests."""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import sys
from collections.abc import Generator, Iterator
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from domains import DOMAIN
from started import end_processes, mark

from fame.gc_tuning import uncollected

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
LEARNS = re.compile(rb"fame\.monitor|skops|sklearn|monitor_runs|own_data|fuzz")
"""What is named in files of tests that load scikit-learn."""


class MemoryGrowth:
    """Collects all garbage if the memory of this process has grown by a quarter since it last did."""

    above = 0.0

    def collect(self) -> None:
        if sys.getallocatedblocks() > self.above:
            gc.collect()
            self.above = 1.25 * sys.getallocatedblocks()


MEMORY = MemoryGrowth()


if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):  # hundreds of processes would compile FAME, each for itself
    sys.dont_write_bytecode = False
for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # each worker has a core: threads would wait for each other
    os.environ.setdefault(threads, "1")
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)  # of this worker alone: a test that names no domain meets no other test
mark()
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever starts the tests may have it ignored: nohup, a shell
with suppress(ImportError):  # the tests on ROS have no hypothesis
    from hypothesis import HealthCheck, settings

    settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("unhurried")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage while ten thousand tests are made, which stay."""
    with uncollected(stays=True):
        return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Collect what the test before left; the rest is looked through, which takes a second, when there is much more."""
    gc.collect(1)
    gc.unfreeze()
    MEMORY.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Let the last collection of pytest find whatever was never closed."""
    gc.unfreeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Function]) -> None:
    """Mark what needs a browser or packages of npm (`make test-browser`, `make test-node`), or is long.

    What learns comes first, so that of two workers one alone loads scikit-learn: that takes seconds, and much memory.
    """
    learns = {path: LEARNS.search(path.read_bytes()) is not None for path in {item.path for item in items}}
    items.sort(key=lambda item: not learns[item.path])
    for item in items:
        for fixture, marker in (("chromium", "browser"), ("node_modules", "node")):
            if fixture in getattr(item, "fixturenames", ()):
                item.add_marker(marker)
        short = item.get_closest_marker("long_but")
        if short and not any(fnmatchcase(item.callspec.id, pattern) for pattern in short.args):
            item.add_marker("long")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A browser. Skips where there is none: before a test, which then has nothing open."""
    api = pytest.importorskip("playwright.sync_api", reason="needs the package playwright: make test-browser")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("needs the program chromium (apt-get install chromium): make test-browser")
    with api.sync_playwright() as play, play.chromium.launch(executable_path=program, args=["--no-sandbox"]) as found:
        yield found


@pytest.fixture(scope="session")
def node_modules() -> Path:
    """The packages of npm that tests use. Skips where they are not."""
    if shutil.which("node") is None or not (ROOT / "out" / "node" / "installed").exists():
        pytest.skip("needs the program node, and packages of npm: make test-node")
    return ROOT / "out" / "node" / "node_modules"


@pytest.fixture(autouse=True, scope="module")
def _ended_processes() -> Iterator[None]:
    """End what the tests of a module have started, and not ended."""
    yield
    end_processes()


@pytest.fixture(autouse=True, scope="module")
def _closed_worlds() -> Iterator[None]:
    """Close the worlds of a module, so that none is left to the garbage collector (see `World._clear`)."""
    yield
    grounds = sys.modules.get("grounds") or sys.modules.get("tests.grounds")
    while grounds is not None and grounds.OPEN:
        grounds.OPEN.pop().close()
