"""Topics with rates of their own become rows with the same stamps; what has no partner in time is counted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from monitor_runs import told

from fame.cli import main
from fame.monitor.data_files import Special, read_labelled_runs
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.join import Join, Joiner, values_at
from fame.monitor.pipeline.processor import Samples

SLOW, FAST = 20.0, 50.0


@pytest.mark.parametrize(
    ("fill", "expected"),
    [("hold", [0.0, 0.0, 1.0, np.nan]), ("linear", [0.0, 0.6, np.nan, np.nan]), ("none", [0.0, 1.0, 1.0, np.nan])],
)
def test_a_value_is_held_or_lies_between_or_is_the_nearest_but_never_far_away(fill: str, expected: list[float]):
    found = values_at(
        np.array([0.0, 0.06, 0.15, 0.5]), np.array([0.0, 0.1]), np.array([[0.0], [1.0]]), Join(20.0, 0.07, fill)
    )
    np.testing.assert_allclose(found[:, 0], expected)


def two_topics(path: Path, runs: int, stops: float = np.inf) -> Path:
    """Rows of two topics, as `fame monitor record` writes them; the second one stops."""
    random, lines = np.random.default_rng(runs), ["stamp,run,Effort.a,Force.z"]
    for run in range(runs):
        rows = [(n / FAST, f"{np.sin(n / FAST * 2) + 0.05 * random.standard_normal():.4f},") for n in range(150)]
        rows += [
            (n / SLOW + 0.003, f",{np.cos(n / SLOW * 3) + 0.05 * random.standard_normal():.4f}")
            for n in range(60)
            if n / SLOW < stops
        ]
        lines += [f"{stamp:.9f},{run},{cells}" for stamp, cells in sorted(rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


CONFIG = """Training: {Files: [runs.csv], Model: m.skops, Detector: mahalanobis, Window: 10, FalseAlarms: 0.2 per run}
"""


def test_two_topics_train_and_judge_and_a_sensor_that_stops_is_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    two_topics(tmp_path / "runs.csv", 8)
    (tmp_path / "c.yaml").write_text(CONFIG)
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 2
    assert "topics with rates of their own need Join: {Rate, Tolerance, Fill}" in capsys.readouterr().err
    (tmp_path / "c.yaml").write_text("Join: {Rate: 50, Tolerance: 0.06}\n" + CONFIG)
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 0
    capsys.readouterr()
    code, found = told(capsys, "monitor", "judge", tmp_path / "m.skops", two_topics(tmp_path / "new.csv", 1, stops=1.0))
    (run,) = found["runs"]
    assert (code, run["verdict"]) == (3, "not judged")
    assert run["share judged"] < 0.5
    assert any("rows have no partner in time (Force.z)" in text for text in run["notes"])


def test_rows_without_a_partner_are_counted(tmp_path: Path):
    file = two_topics(tmp_path / "runs.csv", 1, stops=1.0)
    (run,) = read_labelled_runs([file], (), Special(join=Join(50.0, 0.06)))
    assert np.allclose(np.diff(run.samples.stamps), 1 / 50)
    assert run.gaps + len(run.samples) == 149 + 1
    assert run.samples.stamps[-1] == 1.0
    assert run.known < 0.5


def samples(stamps: Any, value: float = 1.0) -> Samples:
    return Samples(np.full((len(stamps), 1), value), np.asarray(stamps, dtype=np.float64), ("a",))


def test_live_a_row_waits_for_both_inputs_and_has_the_stamps_and_values_of_the_file():
    said: list[str] = []
    joiner = Joiner(Join(10.0, 0.15), lambda key, text: said.append(text))
    given = []
    for step in range(20):
        fast = samples([step / 10, step / 10 + 0.05], step)
        slow = samples([step / 10 + 0.02] if step < 10 else [], -step)
        given.append(joiner.feed({"fast": fast, "slow": slow}))
    for name in ("fast", "slow"):
        stamps = np.concatenate([each[name].stamps for each in given])
        np.testing.assert_allclose(stamps, np.arange(1, 11) / 10)
    slow = np.concatenate([each["slow"].values[:, 0] for each in given])
    np.testing.assert_allclose(slow, -np.arange(10.0))
    assert joiner.missing == 9
    assert any("no partner in time (slow): not judged" in text for text in said)


def test_the_keys_are_read_with_their_defaults(tmp_path: Path):
    (tmp_path / "c.yaml").write_text("Join: {Rate: 50}\n" + CONFIG)
    assert load(tmp_path / "c.yaml").join == Join(50.0, 0.03, "hold")
    assert json.dumps(load(tmp_path / "c.yaml").join) == '[50.0, 0.03, "hold"]'
