"""The pytest plugin: the fixture ``mission``, and the state of missions in the report of a failed test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from fame.testing.mission import MissionLoader

_LOADER = pytest.StashKey["MissionLoader"]()


@pytest.fixture
def mission(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MissionLoader]:
    """Load missions and drive them in simulated time: ``m = mission.load("patrol.yaml")``."""
    from fame.testing.mission import MissionLoader

    search = (request.path.parent, request.config.rootpath)
    loader = MissionLoader(_folder(tmp_path_factory, request.node.name), search)
    request.node.stash[_LOADER] = loader
    yield loader
    loader.close()


def _folder(factory: pytest.TempPathFactory, name: str) -> Callable[[], Path]:
    """A function that makes the folder of a test, once."""
    made: list[Path] = []

    def folder() -> Path:
        if not made:
            plain = "".join(sign if sign.isalnum() else "_" for sign in name)[:60]
            made.append(factory.mktemp(plain, numbered=True))
        return made[0]

    return folder


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Any:
    """Add the state of the missions to the report of a test that failed for another reason than an expectation."""
    report = yield
    loader = item.stash.get(_LOADER, None)
    if loader is not None and report.when == "call" and report.failed:
        from fame.testing.failure import ExpectationError, state_lines

        if call.excinfo is not None and not call.excinfo.errisinstance(ExpectationError):
            for loaded in loader.loaded:
                lines = [*state_lines(loaded), *loaded.save()]
                report.sections.append((f"mission {Path(loaded.scenario.file).name}", "\n".join(lines)))
    return report
