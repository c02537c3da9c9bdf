"""``fame monitor judge`` of bags: rosbag2 in both forms, by models of ``monitor train`` and ``monitor adm learn``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import own_data
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("skops")

from monitor_runs import told, write_bag
from rosbags.rosbag2 import StoragePlugin

from fame.cli import main
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from robots.arm.sabotage import alter, knots
from robots.arm.task import FILE, MH5, TRIANGLE, cutting_run, simulated

STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
CONFIG = """
Inputs:
  Efforts: {Topic: /joint_states, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Outputs:
  Unused: {Topic: unused, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Processor: {Class: LowPass}
"""


# ---- a model of fame monitor train -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    names = tuple(f"Efforts.{name}" for name in own_data.NAMES)
    runs = [own_data.run(seed) for seed in range(12)]
    settings = Training(window=40, detector="mahalanobis", samples=2000)
    fit([Samples(run.values, run.stamps, names) for run in runs], settings).save(folder / "monitor.skops")
    (folder / "low_pass.yaml").write_text(CONFIG)
    return folder


@pytest.mark.parametrize("storage", STORAGES)
def test_a_trained_model_judges_a_bag(
    trained: Path, tmp_path: Path, storage: StoragePlugin, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(5001, "stuck")
    bag = write_bag(tmp_path / "bag", own_data.NAMES, 100 + run.stamps, run.values, field="effort", storage=storage)
    words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
    code, found = told(capsys, *words, "-o", tmp_path / "report.html")
    assert code == 1
    (judged,) = found["runs"]
    assert judged["file"] == str(bag)
    first = judged["events"][0]
    assert next(iter(first["shares"])) == f"Efforts.{own_data.NAMES[5001 % 12 % 8]}"
    assert own_data.ONSET < first["start"] < own_data.ONSET + 1
    assert "<svg" in (tmp_path / "report.html").read_text()


def test_a_single_mcap_file_is_judged_as_its_folder(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(1000)
    options = {"field": "effort", "storage": StoragePlugin.MCAP}
    folder = write_bag(tmp_path / "bag", own_data.NAMES, 100 + run.stamps, run.values, **options)
    (file,) = folder.glob("*.mcap")
    words = ("--config", trained / "low_pass.yaml")
    found = [told(capsys, "monitor", "judge", trained / "monitor.skops", data, *words) for data in (folder, file)]
    assert [code for code, _ in found] == [0, 0]
    assert found[0][1]["runs"][0]["score"] == found[1][1]["runs"][0]["score"]


# ---- a model of fame monitor adm learn -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A path detector of simulated cuts."""
    folder = tmp_path_factory.mktemp("learned")
    nominal, random = cutting_run(MH5, TRIANGLE, 40.0), np.random.default_rng(7)
    lines = [",".join(("run", *MH5.joints, "label"))]
    for number in range(4):
        lines += [",".join(map(repr, (number, *row, 1))) for row in simulated(nominal, random, MH5).tolist()]
    (folder / "good.csv").write_text("\n".join(lines) + "\n")
    (folder / "learn.yaml").write_text(
        "Files:\n  unsupervised_train: {name: good.csv, input_col: [0, 1, 2, 3, 4, 5], output_col: [6]}\n"
        f"Classifiers:\n  - {{name: path, class: PathDetector, parameters: {{chain: {FILE}}}, threshold: 0.003}}\n"
        "Split: {folds: 0}\n"
    )
    assert (
        main(["monitor", "adm", "learn", str(folder / "learn.yaml"), "-o", str(folder / "path.skops"), "--jobs", "1"])
        == 0
    )
    return folder


@pytest.mark.parametrize("storage", STORAGES)
def test_a_learned_model_judges_the_runs_of_a_bag(
    learned: Path, tmp_path: Path, storage: StoragePlugin, capsys: pytest.CaptureFixture[str]
) -> None:
    nominal, random = cutting_run(MH5, TRIANGLE, 40.0), np.random.default_rng(8)
    runs = [nominal, alter(nominal, knots("b", 0.5)).values, nominal]
    values = np.concatenate([simulated(run, random, MH5) for run in runs])
    bag = write_bag(tmp_path / "bag", MH5.joints, 100 + 0.025 * np.arange(len(values)), values, storage=storage)
    capsys.readouterr()
    code, found = told(capsys, "monitor", "judge", learned / "path.skops", bag, "-o", tmp_path / "report.html")
    assert code == 1
    assert [run["verdict"] for run in found["runs"]] == ["benign", "anomalous", "benign"]
    event = found["runs"][1]["events"][0]
    assert event["kind"] == "path"
    (first, *_) = event["explanations"]
    assert first.partition(":")[0] in event["shares"]
    assert "in training" in first
    assert found["runs"][0]["label"] is None
    assert "alarms per hour" in found["figures"]
    page = (tmp_path / "report.html").read_text()
    assert "in the band of the training runs" in page
    assert page.count("their median") == 5  # a joint of each run, three of the anomalous one


def test_a_bag_without_the_topic_is_one_line(learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag", ["a"], np.ones(1), np.ones((1, 1)))
    capsys.readouterr()
    assert main(["monitor", "judge", str(learned / "path.skops"), str(bag), "--topic", "/Arm/joint_states"]) == 2
    assert capsys.readouterr().err.endswith("has no topic /Arm/joint_states; it has /joint_states\n")
    assert main(["monitor", "judge", str(learned / "path.skops"), str(bag)]) == 2
    assert "it has 1 joints (a), without joint_s" in capsys.readouterr().err
