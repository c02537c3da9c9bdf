"""Runs that are unlike the others are refused, and changes from run to run are told."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from monitor_runs import told, write_runs

from fame.cli import main
from fame.monitor.model_card import card_of
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.training_checks import drifting, memorised, outliers, unlike_durations, warnings_of

RATE, RUNS = 50.0, 12
CONFIG = Training(detector="phase", window=20, stride=5, false_alarms="0.1 per run")


def run(seed: int, gain: float = 1.0, level: float = 0.0, rows: int = 300) -> Samples:
    """Two channels with heavy-tailed noise that repeat; the first has another gain or level."""
    random = np.random.default_rng(seed)
    stamps = np.arange(rows) / RATE
    values = np.sin(stamps[:, None] * [2.0, 3.0]) * [gain, 1.0] + [level, 0.0]
    return Samples(values + 0.05 * random.standard_t(4, (rows, 2)), stamps, ("left", "right"))


def trained(folder: Path, runs: Sequence[Samples], *more: str) -> int:
    file = write_runs(folder / "runs.csv", runs)
    words = ["monitor", "train", "--data", str(file), "--false-alarms", "0.1 per run", "-o", str(folder / "m.skops")]
    return main([*words, *more])


def test_unlike_runs_are_left_out_by_the_names_that_training_gives_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    every = [write_runs(tmp_path / f"{seed}.csv", [run(seed, gain=0.0 if seed == 2 else 1.0)]) for seed in range(6)]
    words = ["monitor", "train", "--data", *map(str, every), "--detector", "pca", "-o", str(tmp_path / "m.skops")]
    assert main(words) == 2
    assert re.search(r"run 2: .*leave them out \(--exclude 'run 2'\), or train with --keep", capsys.readouterr().err)
    for name in ("run 2", "2.csv"):
        assert main([*words, "--exclude", name, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["columns"] == ["left", "right"]
    assert main([*words, "--exclude", "run 1"]) == 2
    assert "run 2: " in capsys.readouterr().err  # numbers stay those of the files
    assert main([*words, "--exclude", "run 9"]) == 2
    assert "there is no run 9; there are 6, from run 0 on" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("detector", ["phase", "mahalanobis", "pca"])
def test_a_run_in_which_a_motor_stood_still_is_refused_by_name_unless_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], detector: str
):
    runs = [run(seed, gain=0.0 if seed == 4 else 1.0) for seed in range(RUNS)]
    assert trained(tmp_path, runs, "--detector", detector) == 2
    error = capsys.readouterr().err
    assert re.search(r"run 4: .*left moves 0\.\d+ times as much as usual", error)
    assert not (tmp_path / "m.skops").exists()
    assert trained(tmp_path, runs, "--detector", detector, "--keep") == 0
    assert "warning: run 4: " in capsys.readouterr().err


def test_copies_of_runs_are_refused_and_promise_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    runs = [run(seed) for seed in range(6)]
    assert trained(tmp_path, [*runs, *runs], "--detector", "mahalanobis") == 2
    assert "run 6 has the same values as run 0, and 5 more runs are copies" in capsys.readouterr().err
    assert trained(tmp_path, [*runs, *runs], "--detector", "mahalanobis", "--keep") == 0
    said = capsys.readouterr()
    assert "6 runs promise 0.14 per run at best" in said.out
    assert "warning: 6 runs that are copies of others were left out" in said.err


@pytest.mark.long
def test_what_a_model_has_learned_from_counts_in_no_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for name, seeds in (("old", range(6)), ("new", range(6, 12))):
        (tmp_path / name).mkdir()
        assert trained(tmp_path / name, [run(seed) for seed in seeds], "--detector", "mahalanobis") == 0
    models = [tmp_path / name / "m.skops" for name in ("old", "new")]
    data = write_runs(tmp_path / "data.csv", [run(seed) for seed in (0, 7, 20)], lambda number, row: 1)
    capsys.readouterr()
    _, found = told(capsys, "monitor", "judge", models[0], data)
    assert [each["learned from"] for each in found["runs"]] == [True, False, False]
    assert (found["figures"]["learned from"], found["figures"]["benign runs"]) == (1, 2)
    _, found = told(capsys, "monitor", "model", "compare", *models, data)
    assert [found[name]["figures"]["benign runs"] for name in ("old", "new")] == [1, 1]
    write_runs(data, [run(0), run(7)], lambda number, row: 1)
    code, found = told(capsys, "monitor", "model", "compare", *models, data)
    assert (code, found["text"]) == (3, "not known: no runs but 2 that a model has learned from")


def test_the_number_of_a_refused_run_counts_runs_that_are_too_short():
    runs = [run(seed, gain=0.0 if seed == 4 else 1.0, rows=10 if seed == 1 else 300) for seed in range(RUNS)]
    assert list(outliers(fit(runs, CONFIG))) == [4]


@pytest.mark.parametrize("spread", [0.01, 0.4])
def test_undisturbed_runs_are_not_refused_however_much_the_movement_varies(spread: float):
    gains = np.exp(spread * np.random.default_rng(1).standard_normal(RUNS))
    for detector in ("phase", "mahalanobis"):
        model = fit([run(seed, gain) for seed, gain in enumerate(gains)], replace(CONFIG, detector=detector))
        assert outliers(model) == {}


def test_a_run_that_stands_still_from_the_middle_on_is_refused():
    runs = [run(seed) for seed in range(RUNS)]
    runs[7].values[150:] = runs[7].values[150]
    assert list(outliers(fit(runs, CONFIG))) == [7]


@pytest.mark.parametrize("detector", ["knn", "any of phase, knn", "sklearn.neighbors.LocalOutlierFactor"])
def test_that_stored_windows_are_like_themselves_says_nothing_of_other_runs(detector: str):
    own = {"parameters": {"novelty": True}} if "." in detector else {}
    runs = [run(seed, gain=3.0 if seed == 4 else 1.0) for seed in range(RUNS)]
    model = fit([runs[number] for number in range(RUNS) if number != 4], replace(CONFIG, detector=detector, **own))
    assert (memorised(model), outliers(model)) == ("", {})
    assert 4 in outliers(fit(runs, replace(CONFIG, detector=detector, **own)))


@pytest.mark.parametrize("detector", ["mahalanobis", "pca"])
@pytest.mark.parametrize(("size", "rows", "refused"), [(3.0, 1, []), (6.0, 1, [4]), (3.0, 25, [4])])
def test_a_lone_sample_may_be_further_out_than_a_bump(detector: str, size: float, rows: int, refused: list[int]):
    runs = [run(seed) for seed in range(RUNS)]
    runs[4].values[150 : 150 + rows, 0] += size
    assert list(outliers(fit(runs, replace(CONFIG, detector=detector)))) == refused


@pytest.mark.long_but("2.0")
@pytest.mark.parametrize("seconds", [2.0, 14.0])
def test_a_run_that_lasts_much_longer_or_shorter_is_refused_unless_the_mission_waits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: float
):
    runs = [run(seed, rows=round((seconds if seed == 4 else 6.0) * RATE)) for seed in range(RUNS)]
    assert trained(tmp_path, runs, "--detector", "mahalanobis") == 2
    assert re.search(rf"run 4: .*lasts {seconds / 6:.2g}\d* times as long as usual", capsys.readouterr().err)
    waiting = [Samples(each.values, each.stamps, each.names, ((0.0, "wait"),)) for each in runs]
    assert unlike_durations(waiting) == []


def test_stamps_that_jump_within_a_run_are_told():
    runs = [run(seed) for seed in range(RUNS)]
    assert not any("stamps jump" in text for text in warnings_of(fit(runs, CONFIG)))
    runs[7].stamps[100:] += 0.5
    told = "stamps jump in 1 of 12 runs, in run 7 by 0.52 s at 1.98 s: a clock that was set, samples that are missing"
    assert any(text.startswith(told) for text in warnings_of(fit(runs, CONFIG)))


def test_a_mission_that_failed_stands_on_the_card():
    model = fit([run(seed) for seed in range(5)], CONFIG)
    kept = replace(model, conditions={**model.conditions, "failed": {"run.mcap": ["REX"]}})
    text = "run.mcap: the mission of REX failed: such a run may not be undisturbed"
    assert text in card_of(kept)["Limits"]
    assert text not in card_of(model)["Limits"]


@pytest.mark.parametrize("order", [1, -1])
def test_a_level_that_drifts_from_run_to_run_is_told_and_stands_on_the_card(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], order: int
):
    levels = np.linspace(0.0, 0.1, RUNS)[::order]
    assert trained(tmp_path, [run(seed, level=level) for seed, level in enumerate(levels)]) == 0
    told = "levels drift from run to run: later runs may raise more alarms than promised: left (from "
    assert f"warning: {told}" in capsys.readouterr().err
    assert any(text.startswith(told) for text in json.loads((tmp_path / "m.card.json").read_text())["Limits"])
    mixed = np.random.default_rng(2).permutation(levels)
    assert trained(tmp_path, [run(seed, level=level) for seed, level in enumerate(mixed)]) == 0
    assert "drift" not in capsys.readouterr().err


def test_last_runs_that_a_model_of_those_before_does_not_know_are_told():
    """From the ninth run on another movement: the detectors of the folds know it from the other late runs."""
    runs = [run(seed) for seed in range(RUNS)]
    for late in runs[8:]:
        late.values[100:160, 1] += np.sin(np.arange(60) * 2 * np.pi / 12)
    told = drifting(fit(runs, replace(CONFIG, detector="mahalanobis")))
    assert any(text.startswith("4 of the last 4 runs exceed thresholds by the runs before") for text in told)
    assert drifting(fit([run(seed) for seed in range(RUNS)], replace(CONFIG, detector="mahalanobis"))) == []


@pytest.mark.parametrize(("margin", "why"), [(5.0, "5 times by the margin, the rest as runs differ: "), (1.0, "")])
def test_thresholds_that_a_margin_lifts_are_not_blamed_on_the_runs(margin: float, why: str):
    model = fit([run(seed) for seed in range(RUNS)], replace(CONFIG, margin=margin))
    told = [text for text in warnings_of(model) if text.startswith("thresholds lie far above")]
    assert [text.partition(", ")[2][: len(why)] for text in told] == ([why] if why else [])
