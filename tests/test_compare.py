"""Detectors compared on a user's own runs, and the best one chosen by the stated rule."""

import json
from pathlib import Path

import own_data
import pytest

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.pipeline.compare import FAULTS, Compared, compare
from fame.monitor.pipeline.train import Training

RUNS = [own_data.run(seed) for seed in range(8)]
QUICK = Training(window=20, samples=2000, epochs=2, hidden=(4, 2, 4), folds=2)


@pytest.mark.long
def test_every_detector_has_its_figures_and_the_best_comes_first():
    found = compare(RUNS, QUICK, ("pca", "mahalanobis", "ocsvm"))
    assert {item.detector for item in found} == {"pca", "mahalanobis", "ocsvm"}
    assert found == sorted(found, key=lambda item: item.order)
    best = next(item for item in found if item.detector == "mahalanobis")
    assert (best.runs, best.faults, set(best.found)) == (8, 8 * len(FAULTS), set(FAULTS))
    assert sum(best.found.values()) > 20
    assert best.latency is not None
    assert 0 <= best.latency < 10
    assert best.cost > 0


def test_false_alarms_come_before_faults_and_these_before_cost():
    figures = [(1, 9, 1.0), (0, 5, 3.0), (0, 5, 2.0), (0, 7, 9.0)]
    items = [
        Compared(str(n), 10, alarms, {"spike": found}, 0.1, cost) for n, (alarms, found, cost) in enumerate(figures)
    ]
    assert [item.detector for item in sorted(items, key=lambda item: item.order)] == ["3", "2", "1", "0"]


def test_too_few_runs_and_runs_that_stand_still_are_refused():
    with pytest.raises(ConfigError, match="has 3 runs; at least 4 are needed"):
        compare(RUNS[:3], QUICK)
    still = [run.replace(run.values * 0) for run in RUNS[:4]]
    with pytest.raises(ConfigError, match="no channel that moves"):
        compare(still, QUICK)


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
