"""``fame monitor train`` on bags, by the Inputs of a configuration: the same as on a CSV file that is made of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("skops")

from monitor_runs import told, write_bag
from rosbags.rosbag2 import StoragePlugin

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.processors import make_processors

NAMES, RUNS, ROWS = ("left", "right"), 6, 120
INPUTS = "Inputs:\n  Joints: {Topic: /joint_states, Field: [position], MessageType: sensor_msgs/msg/JointState}\n"


def bag_of(path: Path, seed: int, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    random, stamps = np.random.default_rng(seed), 1000 * (seed + 1) + np.arange(ROWS) / 20
    values = np.sin(np.arange(ROWS)[:, None] / [5.0, 8.0]) + 0.05 * random.standard_normal((ROWS, 2))
    return write_bag(path, NAMES, stamps, values, storage=storage)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "joints.yaml").write_text(INPUTS)
    return tmp_path / "joints.yaml"


def words(tmp_path: Path, *data: Path, model: str = "bags.skops") -> list[object]:
    return ["monitor", "train", "--data", *data, "-o", tmp_path / model, "--false-alarms", "0.2 per run"]


@pytest.mark.long
@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("form", ["folders", "files"])
def test_bags_train_as_the_table_that_is_recorded_from_them_each_a_run(
    tmp_path: Path, config: Path, storage: StoragePlugin, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [bag_of(tmp_path / f"day_{seed}" / "bag", seed, storage) for seed in range(RUNS)]
    if form == "files":
        bags = [next(path for path in bag.iterdir() if path.suffix in (".db3", ".mcap")) for bag in bags]
    for bag in bags:
        record = ("monitor", "record", config, "--bag", bag, "-o", tmp_path / "runs.csv", "--append")
        assert told(capsys, *record)[1]["rows"] == ROWS
    expected = told(capsys, *words(tmp_path, tmp_path / "runs.csv", model="table.skops"))[1]
    code, found = told(capsys, *words(tmp_path, *bags), "--config", config)
    assert code == 0
    assert found["columns"] == ["Joints.left", "Joints.right"]
    for key in ("columns", "detector", "thresholds", "metrics", "false_alarms", "rate"):
        assert found[key] == expected[key]
    assert found["training"]["files"] == list(map(str, bags))
    card = json.loads((tmp_path / "bags.card.json").read_text())
    assert (card["Data"]["runs"], card["Data"]["files"]) == (RUNS, [bag.name for bag in bags])


@pytest.mark.long
def test_a_changed_bag_is_not_the_data_of_the_model(
    tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [bag_of(tmp_path / str(seed), seed) for seed in range(RUNS)]
    assert told(capsys, *words(tmp_path, *bags), "--config", config)[0] == 0
    assert told(capsys, *words(tmp_path, *bags), "--config", config, "--check")[0] == 0
    changed = [*bags[:-1], bag_of(tmp_path / "other", 9)]
    assert main([*map(str, words(tmp_path, *changed)), "--config", str(config), "--check"]) == 2
    assert "data" in capsys.readouterr().err


@pytest.mark.long
def test_the_files_of_a_configuration_are_read_by_its_own_inputs(
    tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [bag_of(tmp_path / f"run_{seed}", seed) for seed in range(RUNS)]
    expected = told(capsys, *words(tmp_path, *bags), "--config", config, "--detector", "pca")[1]
    training = "Training: {Files: ['run_*'], Model: own.skops, Detector: pca, FalseAlarms: 0.2 per run}\n"
    config.write_text(INPUTS + training)
    code, found = told(capsys, "monitor", "train", config)
    assert (code, found["thresholds"]) == (0, expected["thresholds"])
    stage = "Processor: {Class: Autoencoder, Parameters: {model: own.skops}}\n"
    config.write_text(INPUTS + training + stage)
    make_processors(load(config))
    bag_of(tmp_path / "run_9", 9)
    with pytest.raises(ConfigError, match="is stale: trained on data"):
        make_processors(load(config))


@pytest.mark.long
def test_the_card_says_what_of_the_bags_was_left_out(
    tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [bag_of(tmp_path / str(seed), seed) for seed in range(RUNS - 1)]
    values = np.sin(np.arange(ROWS)[:, None] / [5.0, 8.0])
    values[ROWS // 2 :] = np.nan
    bags.append(write_bag(tmp_path / "half", NAMES, 9000 + np.arange(ROWS) / 20, values))
    code, found = told(capsys, *words(tmp_path, *bags), "--config", config, "--detector", "pca", "--keep")
    assert code == 0
    expected = (
        f"1 of {RUNS} runs is not known as a whole, run {RUNS - 1} to 50 %: {ROWS // 2} of {ROWS} messages on "
        "/joint_states are left out, the last one since Joints is not finite"
    )
    assert expected in found["warnings"]
    assert expected in json.loads((tmp_path / "bags.card.json").read_text())["Limits"]


@pytest.mark.long
def test_a_recording_of_a_mission_that_failed_is_refused_unless_kept(
    tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [bag_of(tmp_path / str(seed), seed) for seed in range(RUNS)]
    failed = Path(__file__).with_name("recordings") / "failed.mcap"
    command = [*map(str, words(tmp_path, *bags, failed)), "--config", str(config)]
    assert main(command) == 2
    assert f"{failed}: the mission of REX failed in this recording: leave it out" in capsys.readouterr().err
    assert main([*command, "--keep"]) == 2
    assert f"{failed}: has no topic /joint_states" in capsys.readouterr().err


def test_an_error_names_the_bag(tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = [bag_of(tmp_path / str(seed), seed) for seed in range(2)]
    command = [*map(str, words(tmp_path, *bags)), "--config", str(config)]
    assert main([*command, "--time-column", "Zeit"]) == 2
    assert f"{bags[0]}: has no column 'Zeit'" in capsys.readouterr().err
    assert main([*command, "--namespace", "Arm", "--elements"]) == 2
    assert f"{bags[0]}: has no topic /Arm/bpmn_events; it has /joint_states" in capsys.readouterr().err
    config.write_text("Training: {Files: []}\n")
    assert main(command) == 2
    assert "joints.yaml: Inputs: has no Inputs to record" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--config", "joints.yaml"], ["--elements"], ["--namespace", "/Arm"]])
def test_what_is_about_bags_is_refused_without_one(
    tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "runs.csv"
    table.write_text("stamp,a\n0,1\n1,2\n")
    assert main([*map(str, words(tmp_path, table)), *option]) == 2
    assert f"{option[0]} is about bags, and {table} has none" in capsys.readouterr().err
