"""``fame monitor judge`` of bags: rosbag2 in both forms, by models of ``monitor train`` and ``monitor adm learn``."""

from __future__ import annotations

from collections.abc import Callable
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


@pytest.mark.long
def test_a_trained_model_judges_a_bag(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = own_data.run(5001, "stuck")
    bag = write_bag(tmp_path / "bag", own_data.NAMES, 100 + run.stamps, run.values, field="effort")
    words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
    code, found = told(capsys, *words, "-o", tmp_path / "report.html")
    assert code == 1
    (judged,) = found["runs"]
    assert judged["file"] == str(bag)
    first = judged["events"][0]
    assert next(iter(first["shares"])) == f"Efforts.{own_data.NAMES[5001 % 12 % 8]}"
    assert own_data.ONSET < first["start"] < own_data.ONSET + 1
    assert "<svg" in (tmp_path / "report.html").read_text()


@pytest.mark.long
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


def silenced(values: np.ndarray, stamps: np.ndarray) -> None:
    values[len(values) // 2 :] = np.nan


def set_back(values: np.ndarray, stamps: np.ndarray) -> None:
    stamps[len(values) // 2 :] -= 12


@pytest.mark.parametrize("lose", [silenced, set_back])
def test_a_bag_of_whose_messages_half_were_left_out_is_not_judged(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], lose: Callable[..., None]
) -> None:
    run = own_data.run(1000)
    arrivals, values = 100 + run.stamps, run.values.copy()
    stamps = arrivals.copy()
    lose(values, stamps)
    bag = write_bag(tmp_path / "bag", own_data.NAMES, stamps, values, field="effort", arrivals=arrivals)
    words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
    code, found = told(capsys, *words)
    (judged,) = found["runs"]
    assert (code, found["status"], judged["verdict"]) == (3, "partial", "not judged")
    assert judged["seconds"] == pytest.approx(run.stamps[-1], abs=0.02)
    assert judged["share judged"] == pytest.approx(0.5, abs=0.01)
    half = len(values) - len(values) // 2
    assert any(f"{half} of {len(values)} messages on /joint_states are left out" in note for note in judged["notes"])


@pytest.mark.long
def test_a_second_publisher_whose_messages_are_left_out_is_not_judged(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(1000)
    stamps = 100 + np.repeat(run.stamps, 2) - np.tile([0, 0.005], len(run))
    values = np.repeat(run.values, 2, axis=0) + 50 * np.tile([[0], [1]], (len(run), 1))
    arrivals = 100 + np.arange(len(values)) * 0.005
    bag = write_bag(tmp_path / "bag", own_data.NAMES, stamps, values, field="effort", arrivals=arrivals)
    words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
    code, found = told(capsys, *words)
    assert (code, found["runs"][0]["verdict"], found["runs"][0]["share judged"]) == (3, "not judged", 0.5)


@pytest.mark.long
def test_another_device_on_the_topic_hides_nothing_of_a_run_unless_it_takes_the_place_of_the_first(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(1000)
    hand, later = tuple(f"finger_{n}" for n in range(12)), len(run) // 2
    both = [name for _ in run.stamps for name in (own_data.NAMES, hand)]
    one = [own_data.NAMES] * later + [hand] * (len(run) - later)
    stamps = {"both": np.sort(np.concatenate([run.stamps, run.stamps + 0.001])), "one": run.stamps}
    values = {"both": np.repeat(run.values, 2, axis=0), "one": run.values}
    found = {}
    for name, names in (("both", both), ("one", one)):
        bag = write_bag(tmp_path / name, names, 100 + stamps[name], values[name], field="effort")
        words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
        found[name] = told(capsys, *words)[1]["runs"][0]
    assert [(judged["verdict"], round(judged["share judged"], 2)) for judged in found.values()] == [
        ("benign", 1.0), ("not judged", 0.5),
    ]  # fmt: skip
    assert all("Efforts has the channels finger_0, " in str(judged["notes"]) for judged in found.values())


@pytest.mark.long
def test_a_message_that_is_sent_twice_hides_nothing(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(1000)
    stamps, values = np.repeat(100 + run.stamps, 2), np.repeat(run.values, 2, axis=0)
    bag = write_bag(tmp_path / "bag", own_data.NAMES, stamps, values, field="effort")
    words = ("monitor", "judge", trained / "monitor.skops", bag, "--config", trained / "low_pass.yaml")
    assert told(capsys, *words)[0] == 0


def test_a_bag_without_a_usable_message_is_one_line(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", ["a"], 100 + np.arange(3) / 10, np.full((3, 1), np.nan), field="effort")
    words = ["monitor", "judge", str(trained / "monitor.skops"), str(bag), "--config", str(trained / "low_pass.yaml")]
    assert main(words) == 2
    assert "3 of 3 messages on /joint_states are left out, the last one since Efforts is not" in capsys.readouterr().err


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


@pytest.mark.long
def test_a_learned_model_judges_the_runs_of_a_bag(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nominal, random = cutting_run(MH5, TRIANGLE, 40.0), np.random.default_rng(8)
    runs = [nominal, alter(nominal, knots("b", 0.5)).values, nominal]
    values = np.concatenate([simulated(run, random, MH5) for run in runs])
    stamps = 100 + 0.025 * np.arange(len(values))
    bag = write_bag(tmp_path / "bag", MH5.joints, stamps, values, storage=StoragePlugin.MCAP)
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


@pytest.mark.long
def test_a_bag_of_which_a_model_of_joint_states_does_not_see_all_is_not_benign(
    learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = simulated(cutting_run(MH5, TRIANGLE, 40.0), np.random.default_rng(8), MH5)
    values[-(len(values) // 10) :] = np.nan
    bag = write_bag(tmp_path / "bag", MH5.joints, 100 + 0.025 * np.arange(len(values)), values)
    capsys.readouterr()
    code, found = told(capsys, "monitor", "judge", learned / "path.skops", bag)
    (run,) = found["runs"]
    assert (code, run["verdict"]) == (3, "not judged")
    assert run["share judged"] == pytest.approx(0.9, abs=0.01)
    assert "messages on /joint_states are left out, the last one since joint is not finite" in run["notes"][-1]


def test_a_bag_without_the_topic_is_one_line(learned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag", ["a"], np.ones(1), np.ones((1, 1)))
    capsys.readouterr()
    assert main(["monitor", "judge", str(learned / "path.skops"), str(bag), "--topic", "/Arm/joint_states"]) == 2
    assert capsys.readouterr().err.endswith("has no topic /Arm/joint_states; it has /joint_states\n")
    assert main(["monitor", "judge", str(learned / "path.skops"), str(bag)]) == 2
    assert "it has 1 joints (a), without joint_s" in capsys.readouterr().err
