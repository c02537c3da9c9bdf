"""Detectors compared on a user's own runs, and the best one chosen by the stated rule."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import own_data
import pytest

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.calibration import calibrate
from fame.monitor.model_card import card_of
from fame.monitor.pipeline.compare import REPEATED, Compared, best, compare
from fame.monitor.pipeline.faults import CASES, FAULTS, Tried, faulty
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.training_checks import memorised

RUNS = [own_data.run(seed) for seed in range(8)]
QUICK = Training(window=20, samples=2000, epochs=2, hidden=(4, 2, 4), folds=2)


@pytest.mark.long
def test_every_detector_has_its_figures_and_the_best_comes_first():
    found = compare(RUNS, QUICK, ("pca", "mahalanobis", "ocsvm"))
    items = [item for item, _ in found]
    assert {item.detector for item in items} == {"pca", "mahalanobis", "ocsvm"}
    assert items == sorted(items, key=lambda item: item.order)
    best = next(item for item in items if item.detector == "mahalanobis")
    assert (best.runs, best.faults, set(best.kinds)) == (8, 8 * len(CASES), set(FAULTS))
    assert sum(best.kinds.values()) > 40
    assert best.latency is not None
    assert 0 <= best.latency < 10
    assert best.cost > 0


def test_a_detector_that_learned_its_runs_by_heart_is_none_of_the_best():
    """Training would refuse the model: windows of 30 samples of four channels, and not many more windows."""
    rng = np.random.default_rng(3)
    runs = [Samples(rng.standard_normal((300, 4)).cumsum(0), np.arange(300) / 10) for _ in range(6)]
    config = Training(window=30, stride=30, folds=3)
    ranked = compare(runs, config, ("mahalanobis", "knn"))
    assert [(item.detector, item.by_heart) for item, _ in ranked] == [("knn", False), ("mahalanobis", True)]
    assert not memorised(best(runs, config, ("mahalanobis", "knn")))


def test_false_alarms_beyond_chance_come_before_faults_and_these_before_the_order_of_names():
    """Not before the cost, which is measured: the same runs give the same detector on any machine."""
    figures = [(9, 9, 1.0), (1, 5, 3.0), (0, 5, 2.0), (0, 7, 9.0)]
    items = [
        Compared(str(n), 20, alarms, 0.05, (("spike", "", found, 9),), 0.1, cost)
        for n, (alarms, found, cost) in enumerate(figures)
    ]
    assert [item.detector for item in sorted(items, key=lambda item: item.order)] == ["3", "1", "2", "0"]


@pytest.mark.long
def test_too_few_runs_are_refused_and_a_detector_that_refuses_the_runs_is_left_out():
    with pytest.raises(ConfigError, match="has 3 runs; at least 4 are needed"):
        compare(RUNS[:3], QUICK)
    many = Training(window=30, folds=2)
    wide = [run.replace(np.tile(run.values, 40), names=()) for run in map(_repeating, range(4))]
    ((only, _),) = compare(wide, many, ("mahalanobis", "knn"))
    assert only.detector == "knn"
    with pytest.raises(ConfigError, match="at most 3000 values"):
        compare(wide, many, ("mahalanobis",))


def _repeating(seed: int) -> Samples:
    random, stamps = np.random.default_rng(seed), np.arange(120) / 20
    values = np.sin(stamps[:, None] * [1.0, 2.0, 3.0]) + 0.1 * random.standard_normal((120, 3))
    return Samples(values, stamps, ("a", "b", "c"))


def test_without_a_word_the_detector_that_finds_the_most_is_taken_and_the_card_says_what_it_finds():
    model = fit([_repeating(seed) for seed in range(8)], Training(window=10, folds=2, false_alarms="0.2 per run"))
    rows = model.conditions["compared"]
    assert {row["detector"] for row in rows} == set(REPEATED)
    assert sum(rows[0]["found"].values()) == max(sum(row["found"].values()) for row in rows)
    assert model.detector_text == f"{rows[0]['detector']} (chosen, as {model.conditions['chosen']})"
    assert set(card_of(model)["Would be found"]) == set(FAULTS)
    assert "% of 8 (0.25 deviations); " in card_of(model)["Would be found"]["offset"]


def test_several_detectors_count_by_the_thresholds_that_each_has_at_its_part_of_the_rate():
    runs = [_repeating(seed) for seed in range(8)]
    config = Training(window=10, folds=2, false_alarms="0.2 per run", detector="any of phase, knn")
    both = fit(runs, config)
    single = [fit(runs, replace(config, detector=name)).calibration for name in ("phase", "knn")]
    among = both.calibration.among
    assert among > max(each.among for each in single)  # either may raise the alarm
    parts = both.calibration.parts
    assert np.allclose(both.detector.usual, [calibrate(each, 0.2, 1.0, among).thresholds for each in parts])
    assert np.array_equal(parts[0], single[0].scores)
    assert not np.allclose(parts[1], single[1].scores)  # it keeps the windows of phase, which lie closer


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_changes_a_run_from_its_middle_on(kind: str):
    run = _repeating(0)
    for size in FAULTS[kind].sizes:
        changed = faulty(run, 1, (kind, size), np.arange(3), run.values.mean(axis=0), run.values.std(axis=0))
        assert changed is not None
        count = len(changed)
        assert np.allclose(changed.values[:60], run.values[:60])
        assert not np.allclose(changed.values[60:], run.values[60:count])
        assert np.isfinite(changed.values).all()


@pytest.mark.parametrize("length", [1, 2, 60])
def test_a_fault_that_changes_nothing_is_not_among_those_that_were_tried(length: int):
    """One channel has no other one to be swapped with."""
    run = Samples(np.random.default_rng(0).normal(size=(length, 1)), np.arange(length) / 10)
    other = Samples(run.values + 5, run.stamps)
    tried = Tried([run, other])
    for number in (0, 1):
        tried.put(number, lambda changed: Samples(np.full((len(changed), 1), 9.0), changed.stamps))
    told = {(kind, size): (count, of) for kind, size, count, of in tried.found([1.0])["found"]}
    assert told["swapped", FAULTS["swapped"].text(0.5)] == (0, 0)
    assert told["offset", FAULTS["offset"].text(0.5)] == (2, 2)
    assert told["stuck", FAULTS["stuck"].text(0.5)] == ((2, 2) if length == 60 else (0, 0))


@pytest.mark.long
def test_fame_train_prints_the_table_and_stores_the_best(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    rows = [
        ",".join(map(str, (stamp, number, *row)))
        for number, run in enumerate(RUNS[:4])
        for stamp, row in zip(run.stamps, run.values[:, :3], strict=True)
    ]
    (tmp_path / "runs.csv").write_text("\n".join(["stamp,run,a,b,c", *rows]) + "\n")
    (tmp_path / "m.yaml").write_text(
        "Inputs: {A: {Topic: joints, Field: [effort], MessageType: sensor_msgs/msg/JointState}}\n"
        "Training: {Files: [runs.csv], Model: m.skops, Window: 20, Samples: 500, Hidden: [4, 2], Epochs: 2, Folds: 2}\n"
    )
    assert main(["monitor", "train", str(tmp_path / "m.yaml"), "--compare"]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in ("detector", "false alarms", "isolation_forest", "mahalanobis"))
    assert main(["monitor", "train", str(tmp_path / "m.yaml"), "--compare", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["detector"] == found["compared"][0]["detector"]
    assert (tmp_path / "m.card.md").is_file()
