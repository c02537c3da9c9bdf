"""What people say of runs: it stands beside the model, and its next training uses it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from monitor_runs import told, write_runs

from fame.cli import main
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.trained_model import TrainedModel


def run(seed: int, shift: float = 0.0) -> Samples:
    """Two channels; the second has a shift in the middle."""
    random, stamps = np.random.default_rng(seed), np.arange(60) / 20
    values = np.sin(stamps[:, None] * [3.0, 5.0]) + 0.1 * random.standard_normal((60, 2))
    values[20:40, 1] += shift
    return Samples(values, stamps, ("left", "right"))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A model of eight runs."""
    file = write_runs(tmp_path / "runs.csv", [run(seed) for seed in range(8)])
    words = ["--detector", "pca", "--window", "10", "--false-alarms", "0.2", "-o", str(tmp_path / "m.skops")]
    assert main(["monitor", "train", "--data", str(file), *words]) == 0
    return tmp_path / "m.skops"


def test_an_alarm_that_was_false_raises_the_thresholds_of_the_next_training(
    model: Path, capsys: pytest.CaptureFixture[str]
):
    later = write_runs(model.with_name("later.csv"), [run(20), run(21, 0.8)])
    judged = told(capsys, "monitor", "judge", model, later)[1]["runs"]
    assert [each["verdict"] for each in judged] == ["benign", "anomalous"]
    before = TrainedModel.load(model).thresholds
    assert main(["monitor", "label", f"{later}:1", "--benign", "--model", str(model), "--by", "Ada"]) == 0
    (said,) = json.loads(model.with_name("m.labels.json").read_text()).values()
    assert (said["label"], said["who"], said["run"], said["file"]) == ("benign", "Ada", "1", str(later))
    capsys.readouterr()
    assert main(["monitor", "retrain", str(model)]) == 0  # though this run is unlike the others
    text = capsys.readouterr().out
    assert "threshold of" in text
    assert "later.csv:1" in text
    assert "Ada" in text
    assert text.rstrip().endswith("anomalous  benign")
    again = TrainedModel.load(model)
    assert again.conditions["runs"] == 9
    assert again.thresholds[1] > before[1]


def test_a_run_that_is_anomalous_trains_no_longer(model: Path, capsys: pytest.CaptureFixture[str]):
    runs = model.with_name("runs.csv")
    assert main(["monitor", "label", f"{runs}:3", "--anomalous", "--model", str(model)]) == 0
    capsys.readouterr()
    assert main(["monitor", "retrain", str(model)]) == 0
    warning = capsys.readouterr().err
    assert "warning: run 3 is left out: labelled anomalous" in warning
    assert "not known as a whole" not in warning
    assert TrainedModel.load(model).conditions["runs"] == 7
    assert main(["monitor", "label", f"{runs}:3", "--benign", "--model", str(model)]) == 0  # the last word counts
    assert main(["monitor", "retrain", str(model)]) == 0
    assert TrainedModel.load(model).conditions["runs"] == 8
    for number, count in (("", "0 runs beside 8"), (":3", "1 run beside 7")):  # of which no parts are made
        assert main(["monitor", "label", str(runs), "--anomalous", "--model", str(model)]) == 0
        assert not number or main(["monitor", "label", f"{runs}:3", "--benign", "--model", str(model)]) == 0
        capsys.readouterr()
        assert main(["monitor", "retrain", str(model)]) == 2
        assert f"has {count} that are labelled anomalous (fame monitor label); at least" in capsys.readouterr().err


def test_what_cannot_be_labelled_or_trained_again_is_said(model: Path, capsys: pytest.CaptureFixture[str]):
    runs = model.with_name("runs.csv")
    assert main(["monitor", "label", f"{runs}:8", "--benign", "--model", str(model)]) == 2
    assert "has no run 8; it has 8, from 0 on" in capsys.readouterr().err
    for text in ("[1]", '{"ab12": 1}', '{"ab12": {"file": "runs.csv", "run": 1, "label": "benign"}}'):
        model.with_name("m.labels.json").write_text(text)
        assert main(["monitor", "retrain", str(model)]) == 2
        said = capsys.readouterr().err
        assert (
            "m.labels.json: is not what fame monitor label writes: expected the hash of each run with texts as" in said
        )
        assert "object" not in said
    runs.unlink()
    assert main(["monitor", "retrain", str(model)]) == 2
    assert "runs.csv: cannot be read" in capsys.readouterr().err


def test_a_label_can_be_taken_back_also_of_a_file_that_is_gone(model: Path, capsys: pytest.CaptureFixture[str]):
    later = write_runs(model.with_name("later.csv"), [run(20), run(21)])
    words = ["--model", str(model)]
    assert main(["monitor", "label", str(later), f"{model.with_name('runs.csv')}:2", "--benign", *words]) == 0
    later.unlink()
    assert main(["monitor", "retrain", str(model)]) == 2
    said = capsys.readouterr().err
    assert "m.labels.json: has a label of run 1 of a file that cannot be used" in said
    assert f"fame monitor label {later} --remove --model {model}" in said
    assert main(["monitor", "label", f"{later}:1", f"{later}:2", "--remove", *words]) == 2
    assert f"m.labels.json: has no label of {later}:2; it has {later}:0, {later}:1, " in capsys.readouterr().err
    assert main(["monitor", "label", f"{later}:1", "--remove", *words]) == 0  # the failure before removed nothing
    assert main(["monitor", "label", str(later), "--remove", *words]) == 0
    assert "1 label removed" in capsys.readouterr().out
    (left,) = json.loads(model.with_name("m.labels.json").read_text()).values()
    assert left["run"] == "2"
    assert main(["monitor", "retrain", str(model)]) == 0


def test_a_label_holds_for_a_run_of_which_only_a_part_trains(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    files = [str(write_runs(tmp_path / f"{seed}.csv", [run(seed)])) for seed in range(8)]
    model = str(tmp_path / "m.skops")
    words = ["--detector", "pca", "--window", "10", "--false-alarms", "0.2", "--start", "0.5", "-o", model]
    assert main(["monitor", "train", "--data", *files, *words]) == 0
    assert main(["monitor", "label", files[3], "--anomalous", "--model", model]) == 0
    assert main(["monitor", "label", files[5], "--benign", "--model", model]) == 0
    assert main(["monitor", "retrain", model]) == 0
    assert "run 3 is left out: labelled anomalous" in capsys.readouterr().err
    conditions = TrainedModel.load(model).conditions
    assert (conditions["runs"], conditions["benign"]) == (7, [5])  # it does not train once more, as a whole


def test_a_label_of_values_that_are_no_longer_there_is_said_not_to_count(
    model: Path, capsys: pytest.CaptureFixture[str]
):
    later, label = model.with_name("later.csv"), ["monitor", "label", "--benign", "--model", str(model)]
    write_runs(later, [run(20)])
    assert main([*label, str(later)]) == 0
    write_runs(later, [run(21)])
    assert main(["monitor", "retrain", str(model)]) == 0
    assert f"warning: the label of {later}:0 does not count" in capsys.readouterr().err
    assert main([*label, str(later)]) == 0  # it stands in place of the one before
    assert main(["monitor", "retrain", str(model)]) == 0
    assert "does not count" not in capsys.readouterr().err
