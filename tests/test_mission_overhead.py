"""Tests of missions do once, or not at all, what would make each of them slow: imports, recordings, collections."""

import os
from pathlib import Path

import pytest

from fame.bpmn.library import Library
from fame.bpmn.reader import read
from fame.middleware import messages
from fame.testing import MissionLoader, late_recording

pytest_plugins = ["pytester"]
VEHICLES = Path(__file__).parent.parent / "models" / "ground_vehicles.bpmn"


def played(mission: MissionLoader) -> bytes:
    """The recording of two cars without a world."""
    m = mission.load(VEHICLES)
    m.stub("Explore", after=2, signals={"target_found": {"x": 1.0, "y": 2.0}})
    m.stub("GoTo", after=3)
    m.advance(10)
    return m.recorded()


def test_a_recording_is_written_only_if_it_is_wanted(mission: MissionLoader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(late_recording, "RecordingFile")
    m = mission.load(VEHICLES)
    m.stub("Explore", after=2, signals={"target_found": {"x": 1.0, "y": 2.0}})
    m.advance(3)
    m.expect("REX").waits_at("done")
    with pytest.raises(NameError, match="RecordingFile"):
        m.recorded()


def test_a_recording_is_the_same_in_one_piece_and_in_many(
    mission: MissionLoader, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = played(mission)
    monkeypatch.setattr(late_recording, "MOST", 3)
    assert played(mission) == whole
    assert len(whole) > 1000


@pytest.mark.long
@pytest.mark.parametrize(("fixture", "loaded"), [("mission", True), ("tmp_path", False)])
def test_what_missions_need_is_imported_before_the_first_of_them(
    pytester: pytest.Pytester, fixture: str, loaded: bool
) -> None:
    pytester.makepyfile(f"""
        import sys

        def test_imports({fixture}):
            assert ("fame.testing.mission" in sys.modules) is {loaded}
            assert ("numpy" in sys.modules) is {loaded}
    """)
    pytester.runpytest_subprocess("-p", "no:hypothesispytest").assert_outcomes(passed=1)


def test_a_called_process_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[object] = []
    list_folder = os.listdir
    monkeypatch.setattr(os, "listdir", lambda path: searched.append(path) or list_folder(path))
    library, definitions = Library(), read(VEHICLES)
    found = [library.closure(definitions, process) for process in definitions.processes]
    first = len(searched)
    assert found == [library.closure(definitions, process) for process in definitions.processes]
    assert len(searched) == first > 0


def test_a_value_that_is_repeated_is_one_message(mission: MissionLoader, monkeypatch: pytest.MonkeyPatch) -> None:
    place, other, made = {"x": 1.0}, {"x": 2.0}, list[object]()
    m = mission.load(VEHICLES)
    create = messages.create
    monkeypatch.setattr(messages, "create", lambda type, value=None: made.append(value) or create(type, value))
    m.fake_topic("/target_found", values=[*[place] * 50, other, place])
    m.advance(0)
    assert [one for one in made if one in (place, other)] == [place, other, place]
