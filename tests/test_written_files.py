"""What each release wrote is read for ever: states in each phase, recordings, campaigns, coverage, detectors."""

import importlib.util
import json
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import fame
from fame.cli import main

WRITTEN = Path(__file__).parent / "written"
RELEASES = sorted(folder.name for folder in WRITTEN.iterdir() if (folder / "mission.bpmn").exists())
PHASES = {
    "running": ("running", {"day", "first"}),
    "inside": ("running", {"day", "ask"}),
    "ended": ("idle", set()),
    "suspended": ("suspended", {"day", "first"}),
    "incident": ("incident", {"day", "divide"}),
    "migrated": ("running", {"day", "ask"}),
    "ready": ("ready", {"day", "first"}),
}
"""By phase in which the engine of the release ended: what its successor reports, and the elements of its tokens."""
ACTS = {
    "running": [("complete", "first", {"speed": 2})],
    "suspended": [("continue", "", {}), ("complete", "first", {"speed": 2})],
    "incident": [("set", "divide", {"speed": 2}), ("retry", "divide", {})],
    "ready": [("complete", "first", {"speed": 2})],
    "migrated": [("complete", "ask", {})],
}


@pytest.fixture(scope="module")
def writer() -> ModuleType:
    """The module that writes them, which has a robot in simulated time."""
    spec = importlib.util.spec_from_file_location("write", WRITTEN / "write.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(params=RELEASES)
def written(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of what a release wrote, as the working directory."""
    folder: Path = shutil.copytree(WRITTEN / request.param, tmp_path / "written")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("phase", PHASES)
def test_an_engine_goes_on_from_the_state_of_each_phase(writer: ModuleType, written: Path, phase: str) -> None:
    robot = writer.Robot(written / "states" / phase)
    robot.run(3)
    told: dict[str, Any] = robot.engine._progress()
    assert (told["state"], {wait["element"] for wait in told["waits"]}) == PHASES[phase]
    robot.run(20)  # a sender that is gone for ever is given up
    for act, element, values in ACTS.get(phase, []):
        robot.ask(act, element, **values)
    while told["waits"] and robot.requests < 10:
        robot.ask("complete", "ask")
        told = robot.engine._progress()
    assert (told["state"], told["waits"]) == ("idle", [])
    assert told["deployed"] == ("d2" if phase == "migrated" else "d1")
    robot.engine.stop()


def test_a_saved_simulation_goes_on(written: Path) -> None:
    saved = fame.Simulation.load("run.state")
    (instance,) = saved.instances
    assert (instance.status, saved.now) == ("running", 5)
    saved.complete("ask").complete("ask")
    assert (instance.status, instance.variables["slowness"]) == ("completed", 0.5)


@pytest.mark.parametrize("suffix", ["jsonl", "csv"])
def test_a_recording_has_the_events_that_the_release_converted(written: Path, suffix: str) -> None:
    assert main(["log", "convert", "run.mcap", "-o", f"again.{suffix}"]) == 0
    again, lines = (Path(name).read_text().splitlines() for name in (f"again.{suffix}", f"run.{suffix}"))
    assert [line for line in again if line in lines] == lines


def test_a_recording_is_shown(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "run.mcap", "-o", "run.html"]) == 0
    assert Path("run.html").stat().st_size > 100_000


def test_a_campaign_is_continued(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = Path("campaign/runs.jsonl").read_text().splitlines()
    assert main(["campaign", "--resume", "campaign"]) in (0, 1)
    assert Path("campaign/runs.jsonl").read_text().splitlines() == rows
    assert json.loads(Path("campaign/summary.json").read_text())["runs"] == 3


def test_coverage_is_in_a_safety_report(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path("coverage.json")
    file.write_text(file.read_text().replace('"/mission/', f'"{written}/'))  # it has absolute paths
    command = ["check", "mission.bpmn", "--explore", "--coverage", "coverage.json", "--report", "report.html"]
    assert main(command) in (0, 1, 3)
    report = Path("report.html").read_text()
    assert "9 of 12" in report
    assert "does not have this file" not in report


def test_a_detector_judges(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("skops")
    assert main(["monitor", "judge", "detector.skops", "run_0.csv", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["runs"][0]["verdict"] == "benign", told
