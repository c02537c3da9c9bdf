"""The patterns of the cookbook: each is checked, drawn, run, explored and tested, and a fault in it is noticed."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from fame_test_runs import fame_test

import fame
from fame.bpmn import read
from fame.bpmn.draw.diagram import draw
from fame.cli import main, parser
from fame.scenario.explore.exploration import explore

ROOT = Path(__file__).parent.parent
COOKBOOK = ROOT / "examples" / "cookbook"
PATTERNS = sorted(path.parent.name for path in COOKBOOK.glob("*/mission.bpmn"))
FAULTS = {
    "ask_until_answered": ('"Event_2S" targetRef="Gateway_Again"', '"Event_2S" targetRef="Event_Answered"'),
    "auction": ("winner = bidder if cost &lt; lowest", "winner = bidder if cost &gt; 1"),
    "battery": ("charge &lt; 0.2", "charge &lt; 0.02"),
    "compensation": ('attachedToRef="Activity_Load"', 'attachedToRef="Activity_Transport"'),
    "degraded_team": ("helper == robot.name", "helper != robot.name"),
    "emergency_stop": ('name="resume" value="true"', 'name="resume" value="false"'),
    "exclusive_zone": ('name="instances" value="1"', 'name="instances" value="2"'),
    "follow_the_leader": ('name="queue" value="100"', 'name="queue" value="1"'),
    "handover": ('name="queue" value="1"', 'name="comment" value="1"'),
    "human_approval": ("PT1M", "PT10M"),
    "orders": ('name="correlate"', 'name="comment"'),
    "patrol": ("${msg.x}", "${msg.y}"),
    "shift_end": (">over<", ">not over<"),
    "stop_and_ask": ("force &gt; limit</", "force &lt; limit</"),
    "timeout_and_retry": ("tries &lt; 3", "tries &lt; 4"),
}
"""A fault in each: a text of its model, and what stands there instead."""
EXPLAINED = {"auction": {"dropped"}, "battery": {"error"}}
"""Kinds of findings that the page of a pattern explains."""


def mission(pattern: str) -> Path:
    """What `fame run` runs in the folder of a pattern."""
    scenario = COOKBOOK / pattern / "mission.yaml"
    return scenario if scenario.is_file() else scenario.with_suffix(".bpmn")


@pytest.mark.long_but("[!b]*")
@pytest.mark.parametrize("pattern", PATTERNS)
def test_it_has_no_problems_and_runs_as_it_is(pattern: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--no-project", "--json", str(mission(pattern))]) == 0
    assert '"warning"' not in capsys.readouterr().out
    result = fame.Scenario.load(mission(pattern)).run()
    assert result.status == "completed"


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_state_is_explored_and_its_page_explains_what_is_found(pattern: str) -> None:
    result = explore(mission(pattern))
    assert result.exhaustive
    assert not result.failed
    assert {one.kind for one in result.findings if one.kind != "unneeded"} == EXPLAINED.get(pattern, set())


@pytest.mark.parametrize("pattern", PATTERNS)
def test_its_picture_is_that_of_the_model_and_stands_on_its_page_and_in_the_list(pattern: str) -> None:
    folder = COOKBOOK / pattern
    assert (folder / "mission.svg").read_text(encoding="utf-8") == draw(read(folder / "mission.bpmn"))
    assert "](mission.svg)" in (page := (folder / "README.md").read_text(encoding="utf-8"))
    assert len(re.findall(r"\w+", page)) < 400  # two minutes
    assert f"](../examples/cookbook/{pattern}/mission.svg)" in (ROOT / "docs" / "cookbook.md").read_text(
        encoding="utf-8"
    )


def test_the_commands_on_the_pages_exist() -> None:
    pages = [ROOT / "docs" / "cookbook.md", *COOKBOOK.glob("*/README.md")]
    found = [
        one for page in pages for one in re.findall(r"^fame .*|(?<=`)fame [^`]+", page.read_text("utf-8"), re.MULTILINE)
    ]
    assert len(found) > 40
    commands = parser()
    for command in found:
        assert commands.parse_args(shlex.split(command, comments=True)[1:]).command, command


def test_their_tests_pass_and_cover_them() -> None:
    code, shown = fame_test("--no-project", "examples/cookbook", "--cov-model", "--cov-fail-under", "100", folder=ROOT)
    assert code == 0, shown


@pytest.mark.long
def test_their_tests_notice_a_fault(tmp_path: Path) -> None:
    assert [*FAULTS] == PATTERNS
    for pattern, (right, wrong) in FAULTS.items():
        folder = shutil.copytree(COOKBOOK / pattern, tmp_path / pattern, ignore=shutil.ignore_patterns("__pycache__"))
        text = (folder / "mission.bpmn").read_text(encoding="utf-8")
        assert right in text
        (folder / "mission.bpmn").write_text(text.replace(right, wrong), encoding="utf-8")
    _, shown = fame_test("--no-project", ".", "--pytest=--tb=no", folder=tmp_path)
    assert {*re.findall(r"^FAILED (\w+)/", shown, re.MULTILINE)} == {*PATTERNS}, shown


@pytest.mark.long
def test_fame_new_copies_each_as_a_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for pattern in PATTERNS:
        assert main(["new", "--no-project", "--from", pattern]) == 0
        there = {path.relative_to(COOKBOOK / pattern) for path in (COOKBOOK / pattern).rglob("*.*")}
        assert {path for path in there if "__pycache__" not in path.parts} <= {
            path.relative_to(pattern) for path in Path(pattern).rglob("*")
        }
        assert f"scenarios: [{mission(pattern).name}]" in Path(pattern, "fame.yaml").read_text(encoding="utf-8")
    monkeypatch.chdir("handover/tests")
    assert main(["check"]) == 0
    assert main(["run", "--quiet"]) == 0
