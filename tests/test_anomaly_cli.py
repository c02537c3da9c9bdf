"""`fame monitor adm` on bags and files, through the handlers of the command line."""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_data import needs_data, path_model, runs
from monitor_runs import told, write_bag

from fame.cli import main, parser
from fame.errors import ConfigError, MissionError
from fame.monitor.anomaly.recording import of_runs, read_csv, write_csv
from robots.arm.sabotage import alter, knots
from robots.arm.task import FILE, MH5

LEARNING = """
Files:
  unsupervised_train: {{name: benign.csv, input_col: [0, 1, 2, 3, 4, 5], output_col: [6]}}
Classifiers:
  - {{name: path, class: PathDetector, parameters: {{chain: {chain}}}, threshold: 0.002}}
Split: {{folds: 0}}
"""


def adm(*words: object) -> int:
    arguments = parser().parse_args(["monitor", "adm", *map(str, words)])
    code: int = arguments.command(arguments)
    return code


def bag_of(path: Path, values: np.ndarray, signals: Sequence[int] = ()) -> Path:
    """Joint states of the MH5 every 25 ms."""
    return write_bag(path, MH5.joints, 1 + 0.025 * np.arange(len(values)), values, signals=signals)


@pytest.mark.long
@needs_data
def test_from_bag_to_alarm(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    bag = bag_of(tmp_path / "benign", runs(*range(20, 27)))
    assert adm("collect", "--bag", bag, "--label", 1, "--runs", 6, "-o", tmp_path / "benign.csv") == 0
    collected = read_csv(tmp_path / "benign.csv")
    assert (collected.joints, collected.run_labels()) == (MH5.joints, [1] * 6)
    assert "6 of 6 runs" in capsys.readouterr().err
    (tmp_path / "learning.yaml").write_text(LEARNING.format(chain=FILE))
    pytest.importorskip("skops")
    assert adm("learn", tmp_path / "learning.yaml", "-o", tmp_path / "m.skops", "--jobs", 1) == 0
    assert "chosen by the data that it learned from" in capsys.readouterr().out
    bag = bag_of(tmp_path / "wrong", np.vstack([runs(26), alter(runs(27), knots("g", 1.0)).values]))
    assert adm("operate", "--bag", bag, "--model", tmp_path / "m.skops", "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert [item["above"] for item in found["runs"]] == [False, True]


def test_merging_tells_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for name, label in (("a.csv", 1), ("b.csv", -1)):
        write_csv(tmp_path / name, of_runs([np.ones((3, 2))], label, ("s", "l")))
    assert adm("merge", tmp_path / "a.csv", tmp_path / "b.csv", "-o", tmp_path / "c.csv") == 0
    assert "6 points, 1 benign and 1 anomalous runs" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="expected a new file, got one that is read"):
        adm("merge", tmp_path / "a.csv", tmp_path / "b.csv", "-o", tmp_path / "a.csv")


@needs_data
def test_signals_of_a_bag_delimit_its_runs(tmp_path: Path):
    bag = bag_of(tmp_path / "bag", runs(20), signals=(10, 400))
    assert adm("collect", "--bag", bag, "--rule", "signal", "--label", 1, "-o", tmp_path / "x.csv") == 0
    assert len(read_csv(tmp_path / "x.csv")) == 390


@needs_data
def test_fewer_runs_than_asked_for_are_written_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    bag = bag_of(tmp_path / "bag", runs(20, 21))
    assert adm("collect", "--bag", bag, "--label", 1, "--runs", 5, "-o", tmp_path / "x.csv") == 1
    assert read_csv(tmp_path / "x.csv").count == 2
    assert "3 of the 5 runs are missing" in capsys.readouterr().err


@pytest.mark.long
@needs_data
def test_a_model_that_could_judge_nothing_is_no_success(tmp_path: Path):
    other = tuple(f"other_{name}" for name in MH5.joints)
    replace(path_model(), joints=other).save(tmp_path / "m.skops")
    bag = bag_of(tmp_path / "bag", runs(20)[:30])
    with pytest.raises(MissionError, match="no run was evaluated"):
        adm("operate", "--bag", bag, "--model", tmp_path / "m.skops")


def move_model(path: Path, threshold: float = 0.5) -> Path:
    """A model that knows one straight move of two joints, of 40 points."""
    from sklearn.svm import OneClassSVM

    from fame.monitor.anomaly.model import DataProcess, Model, PointClassifier

    values = np.linspace((0.0, 0.0), (1.0, 0.5), 40)
    detector = PointClassifier(OneClassSVM(nu=0.1), DataProcess().fit(values)).fit(of_runs([values], 1, JOINTS))
    Model("svm", JOINTS, detector, threshold, 40, values).save(path)
    return path


JOINTS = ("lift", "turn")


@pytest.mark.parametrize(("points", "code", "status"), [(40, 0, "completed"), (20, 3, "partial")])
def test_a_run_that_was_cut_off_is_not_known_to_be_benign(
    points: int, code: int, status: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = move_model(tmp_path / "m.skops")
    values = np.linspace((0.0, 0.0), (1.0, 0.5), 40)[:points]
    bag = write_bag(tmp_path / "bag", JOINTS, 1 + 0.025 * np.arange(points), values)
    words = ("operate", "--bag", bag, "--model", model, "--rule", "count", "--points", 40, "--json")
    assert adm(*words) == code
    found = json.loads(capsys.readouterr().out)
    assert (found["status"], [run["above"] for run in found["runs"]]) == (status, [False])


def test_a_model_judges_columns_by_name_and_refuses_those_of_another_arm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, values = move_model(tmp_path / "m.skops"), np.linspace((0.0, 0.0), (1.0, 0.5), 40)
    write_csv(tmp_path / "same.csv", of_runs([values], 1, JOINTS))
    write_csv(tmp_path / "turned.csv", of_runs([values[:, ::-1]], 1, JOINTS[::-1]))
    write_csv(tmp_path / "other.csv", of_runs([values], 1, ("wheel", "gripper")))
    same, turned = ([run["verdict"] for run in judgement(model, tmp_path / name, capsys)["runs"]]
                    for name in ("same.csv", "turned.csv"))  # fmt: skip
    assert same == turned == ["benign"]
    assert main(["monitor", "judge", str(model), str(tmp_path / "other.csv")]) == 2
    assert "has 2 joints (wheel, gripper); the model has 2: lift, turn" in capsys.readouterr().err


def judgement(model: Path, data: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    return told(capsys, "monitor", "judge", model, data)[1]


@pytest.mark.parametrize("threshold", ["-1", "7", "nan"])
def test_a_threshold_that_is_no_score_is_refused(tmp_path: Path, threshold: str):
    with pytest.raises(ConfigError, match=r"expected a threshold from 0 to 1, got"):
        adm("operate", "--model", tmp_path / "m.skops", "--threshold", threshold)


def test_a_result_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path):
    (tmp_path / "file").write_text("")
    for out, said in ((tmp_path / "file" / "x.csv", "cannot be written"), (tmp_path, "got a folder")):
        with pytest.raises(ConfigError, match=said):
            adm("collect", "--bag", tmp_path / "gone", "--label", 1, "-o", out)


@needs_data
def test_a_topic_that_the_bag_does_not_hold_is_named_with_those_it_holds(tmp_path: Path):
    bag = bag_of(tmp_path / "bag", runs(20)[:3])
    with pytest.raises(ConfigError, match=r"has no topic /other; it has /joint_states"):
        adm("collect", "--bag", bag, "--topic", "/other", "--label", 1, "-o", tmp_path / "x.csv")


def test_without_the_extra_a_model_is_not_called_corrupt(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    for name in ("skops", "skops.io"):
        monkeypatch.setitem(sys.modules, name, None)
    model = Path(__file__).parent.parent / "models" / "reassembly.skops"
    assert main(["monitor", "judge", str(model), "runs.csv"]) == 2
    assert "pip install 'fame-robots[ml]'" in capsys.readouterr().err


def test_without_the_extra_learning_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    (tmp_path / "benign.csv").write_text("".join(f"{row % 7},{row % 5},{row % 3},0,0,0,1\n" for row in range(100)))
    (tmp_path / "learning.yaml").write_text(LEARNING.format(chain="'robots.arm:mh5.yaml'"))
    monkeypatch.setattr("fame.imports.find_spec", lambda name: None)
    assert main(["monitor", "adm", "learn", str(tmp_path / "learning.yaml")]) == 2
    assert "learning needs scikit-learn: pip install 'fame-robots[ml]'" in capsys.readouterr().err
