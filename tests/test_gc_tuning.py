"""What changes the collector of garbage does so for its block only."""

import gc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bpmn_text import process
from recorded_runs import record

import fame
from fame.deploy import loading
from fame.gc_tuning import uncollected


@pytest.fixture(autouse=True)
def _frozen_again() -> Iterator[None]:
    frozen = gc.get_freeze_count()
    gc.unfreeze()
    yield
    if frozen:
        gc.freeze()


def test_a_block_is_not_collected_and_what_stays_is_exempt() -> None:
    with uncollected(stays=True):
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0


MISSION = process('<startEvent id="s"/><endEvent id="e"/><sequenceFlow id="f" sourceRef="s" targetRef="e"/>')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model and a recording."""
    made = tmp_path_factory.mktemp("gc")
    (made / "a.bpmn").write_text(MISSION)
    record(fame.Scenario.load("examples/delivery.yaml"), made / "run.mcap")
    return made


def forked_processes(folder: Path) -> None:
    from fame.scenario.forking import fork_each

    fork_each([])


def an_engine_that_starts(folder: Path) -> None:
    loading._preload(iter(["a part"]))


def a_page_of_a_recording(folder: Path) -> None:
    from fame.view.replay import Replay

    with Replay(folder / "run.mcap") as page:
        page.wait()


@pytest.mark.long_but("an_*")
@pytest.mark.parametrize(
    ("what", "change"),
    [
        (forked_processes, "freeze"),
        (an_engine_that_starts, "disable"),
        (a_page_of_a_recording, "freeze"),
    ],
)
def test_what_makes_much_that_lives_on_changes_the_collector(
    folder: Path, monkeypatch: pytest.MonkeyPatch, what: Callable[[Path], object], change: str
) -> None:
    """What each saves: `benchmarks/garbage.py`."""
    changes = list[object]()
    monkeypatch.setattr(gc, change, lambda *values: changes.append(values))
    what(folder)
    assert changes
