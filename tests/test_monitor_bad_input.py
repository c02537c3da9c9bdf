"""Data that say little or contradict themselves: one run, channels that stand still, very unequal runs, labels."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from monitor_runs import told, write_runs

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.pipeline.detectors import DETECTORS
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, losses
from fame.monitor.pipeline.training_checks import warnings_of

QUICK = Training(window=20, samples=800, epochs=3, hidden=(4, 2, 4), detector="pca", folds=3)


def run(seed: int, rows: int = 200, *, moved: float = 0.0) -> Samples:
    """Two channels that move and one that does not, or does so for ten samples."""
    random, index = np.random.default_rng(seed), np.arange(rows)
    values = np.stack([np.sin(index / 20), np.cos(index / 15), np.full(rows, 0.25)], axis=1)
    values[:, :2] += random.normal(0, 0.02, (rows, 2))
    values[rows // 2 : rows // 2 + 10, 2] += moved
    return Samples(values, index / 100, ("a", "b", "still"))


@pytest.mark.parametrize("detector", [*DETECTORS, "any of pca, ocsvm"])
def test_a_channel_that_never_moved_raises_an_alarm_when_it_does(detector: str):
    model = fit([run(seed) for seed in range(5)], replace(QUICK, detector=detector))
    assert "still never moved in training: any movement raises an alarm" in warnings_of(model)
    above = losses(model, run(9), 5).values > np.array(model.thresholds)
    assert not above[:, 2].any()
    above = losses(model, run(9, moved=0.001), 5).values > np.array(model.thresholds)
    assert above[:, 2].any()


def test_runs_in_which_nothing_moves_are_refused():
    still = [item.replace(np.full_like(item.values, 0.3)) for item in map(run, range(4))]
    with pytest.raises(ConfigError, match=r"Training\.files: no channel ever moves: nothing to learn"):
        fit(still, QUICK)


def test_very_unequal_runs_are_named_and_those_without_a_window_set_no_threshold():
    runs = [run(0), run(1, 1), run(2), run(3, 12), run(4, 900), run(5)]
    found = "\n".join(warnings_of(fit(runs, QUICK)))
    assert "2 of 6 runs are shorter than a window: they set no threshold" in found
    assert "runs last from 0 to 8.99 s" in found


def learning(folder: Path, folds: int = 3) -> Path:
    """A learning file for runs.csv in this folder."""
    (folder / "learning.yaml").write_text(
        "Files: {unsupervised_train: {name: runs.csv, input_col: [0, 1, 2], output_col: [3]}}\n"
        "Classifiers: [{name: one, class: OneClassSVM, parameters: {nu: 0.1, gamma: 5}, threshold: 0.5}]\n"
        f"Split: {{folds: {folds}}}\n"
    )
    return folder / "learning.yaml"


def refusal(capsys: pytest.CaptureFixture[str], *command: object) -> str:
    """What a command says that is refused: one line."""
    capsys.readouterr()
    assert main([str(part) for part in command]) == 2
    text = capsys.readouterr().err.strip().splitlines()[-1]
    assert text.startswith("fame: error: ")
    return text


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A model of each kind, learned from six runs; that of `fame adm learn` has no stamps to know a rate from."""
    folder = tmp_path_factory.mktemp("models")
    runs = [run(seed) for seed in range(6)]
    fit(runs, QUICK).save(folder / "train.skops")
    write_runs(folder / "runs.csv", runs, lambda number, row: 1)
    assert main(["monitor", "adm", "learn", str(learning(folder)), "-o", str(folder / "adm.skops"), "--jobs", "1"]) == 0
    return {"train": folder / "train.skops", "adm": folder / "adm.skops"}


@pytest.mark.parametrize("kind", ["train", "adm"])
def test_the_same_points_with_two_labels_cannot_be_judged(
    models: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
):
    data = write_runs(tmp_path / "runs.csv", [run(11), run(12), run(11)], lambda number, row: -1 if number == 2 else 1)
    assert "runs 0 and 2 are the same points, but their labels differ" in refusal(
        capsys, "monitor", "judge", models[kind], data
    )
    data = write_runs(tmp_path / "runs.csv", [run(11), run(12), run(11)], lambda number, row: 1)
    assert main(["monitor", "judge", str(models[kind]), str(data)]) == 0


@pytest.mark.parametrize("kind", ["train", "adm"])
def test_runs_without_labels_are_no_benign_ones(
    models: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
):
    capsys.readouterr()
    code, found = told(capsys, "monitor", "judge", models[kind], write_runs(tmp_path / "runs.csv", [run(11)]))
    figures = found["figures"]
    assert code == 0
    assert "alarms per hour" in figures
    assert "false alarms" not in figures


@pytest.mark.parametrize("kind", ["train", "adm"])
def test_runs_of_a_few_rows_get_a_verdict_or_are_named(
    models: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
):
    capsys.readouterr()
    data = write_runs(tmp_path / "runs.csv", [run(1), run(2, 2)])
    code, found = told(capsys, "monitor", "judge", models[kind], data)
    whole, short = found["runs"]
    assert code == 3
    assert (whole["verdict"], short["verdict"]) == ("benign", "not judged")
    assert short["share judged"] < 0.1
    notes = short["notes"]
    assert "not judged" in " ".join(notes) or "cut off" in " ".join(notes)


@pytest.mark.parametrize("kind", ["train", "adm"])
def test_an_anomalous_run_wins_over_one_that_is_not_judged(
    models: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
):
    strange = run(3)
    data = write_runs(tmp_path / "runs.csv", [run(1), run(2, 2), strange.replace(strange.values + 3.0)])
    code, found = told(capsys, "monitor", "judge", models[kind], data)
    assert (code, [each["verdict"] for each in found["runs"]]) == (1, ["benign", "not judged", "anomalous"])


def test_learning_refuses_one_run_standing_still_and_labels_that_contradict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    command = ("monitor", "adm", "learn", learning(tmp_path), "-o", tmp_path / "m.skops", "--jobs", 1)
    write_runs(tmp_path / "runs.csv", [run(0)], lambda number, row: 1)
    assert "has 1 run of one class; at least 3 are needed for Split.folds 3" in refusal(capsys, *command)
    still = [item.replace(np.full_like(item.values, 0.3)) for item in map(run, range(4))]
    write_runs(tmp_path / "runs.csv", still, lambda number, row: 1)
    assert "no joint ever moves: nothing to learn" in refusal(capsys, *command)
    write_runs(tmp_path / "runs.csv", [run(0), run(1), run(0)], lambda number, row: -1 if number == 2 else 1)
    assert "runs 0 and 2 are the same points, one labelled 1, the other -1" in refusal(capsys, *command)
    write_runs(tmp_path / "runs.csv", [run(0), run(1)], lambda number, row: -1 if row > 100 else 1)
    assert "run 0 has points of both labels" in refusal(capsys, *command)
    assert not (tmp_path / "m.skops").exists()


def test_a_model_of_one_kind_is_refused_where_the_other_is_expected(
    models: dict[str, Path], capsys: pytest.CaptureFixture[str]
):
    text = refusal(capsys, "monitor", "adm", "operate", "--model", models["train"], "--bag", "none")
    assert "is a model of another command; expected one of fame monitor adm learn" in text
    for kind, maker in (("train", "fame monitor train"), ("adm", "fame monitor adm learn")):
        assert main(["monitor", "model", "show", str(models[kind])]) == 0
        assert f"made by: {maker}" in capsys.readouterr().out


def test_the_card_of_a_model_that_was_learned_again_names_what_it_replaced(tmp_path: Path):
    write_runs(tmp_path / "runs.csv", [run(seed) for seed in range(6)], lambda number, row: 1)
    words = ["monitor", "adm", "learn", str(learning(tmp_path)), "-o", str(tmp_path / "m.skops"), "--jobs", "1"]
    for _ in range(2):
        assert main(words) == 0
    card = json.loads((tmp_path / "m.card.json").read_text())
    made = card["Model"]["made on"]
    assert card["Model"]["predecessor"].startswith(f"of {made[:11]}")
    assert card["Model"]["predecessor"].endswith(f"trained on data {card['Data']['sha256'][:12]}")
