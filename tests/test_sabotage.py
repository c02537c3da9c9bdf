"""The sabotage example: an arm is led astray in mid-production, and its monitor stops it."""

import shutil
from pathlib import Path

import pytest

from fame.errors import ConfigError
from fame.scenario import Result, Scenario

ROOT = Path(__file__).parent.parent
FILES = ("models/sabotage.bpmn", "examples/sabotage.yaml", "examples/sabotage_learn.yaml")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A place of its own, so that what is recorded and learned stays there."""
    folder = tmp_path_factory.mktemp("sabotage")
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def result(tree: Path) -> Result:
    return Scenario.load(tree / "examples" / "sabotage.yaml").run()


@pytest.mark.long
def test_the_mission_completes_with_one_part_spoiled(result: Result) -> None:
    assert result.status == "completed"
    assert result.world is not None
    arm = result.world["robots"]["Arm"]
    assert (arm["program"], arm["spoiled"], arm["cutting"]) == ("b 0.5", 1, False)
    assert 12 < arm["parts"] < 40


@pytest.mark.long
def test_its_properties_hold(result: Result) -> None:
    assert [each.verdict for each in result.judgements] == ["holds"] * 3


@pytest.mark.long
def test_the_alarm_says_which_part_and_how_many_are_good_and_spoiled(result: Result) -> None:
    assert result.world is not None
    good = result.world["robots"]["Arm"]["parts"]
    said = [report.detail for report in result.reports if report.robot == "Arm"]
    assert len(said) == 1
    assert f"stopped while part {good + 1} was cut" in said[0]
    assert f"{good} parts are good, 1 is spoiled" in said[0]


@pytest.mark.long
def test_all_parts_before_are_judged_benign(result: Result) -> None:
    judged = [
        report.detail for report in result.reports if report.detail.startswith("run ") and "score" in report.detail
    ]
    verdicts = ["benign" in text for text in judged if "points)" in text]
    assert verdicts[-1] is False
    assert len(verdicts) >= 3
    assert all(verdicts[:-1])


@pytest.mark.long
def test_what_was_recorded_and_learned_stays(result: Result, tree: Path) -> None:
    assert {path.name for path in (tree / "out" / "sabotage").iterdir()} == {
        "good.csv", "good.skops", "good.card.md", "good.card.json",
    }  # fmt: skip


def test_a_computer_with_the_name_of_a_robot_is_refused(tree: Path) -> None:
    path = tree / "examples" / "sabotage.yaml"
    wrong = tree / "examples" / "wrong.yaml"
    wrong.write_text(path.read_text().replace("[Monitor, Attacker]", "[Monitor, Arm]"))
    with pytest.raises(ConfigError, match=r"computers\[1\].*got 'Arm', which is taken"):
        Scenario.load(wrong)
