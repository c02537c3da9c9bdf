"""`fame monitor train --data`: a user's own tables, without a configuration or a robot."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fame.cli import main
from fame.config.values import ConfigValue
from fame.errors import ConfigError
from fame.monitor.data_files import Special, is_other_class, read_labelled_runs, read_runs
from fame.monitor.pipeline import train as training
from fame.monitor.pipeline.compare import suited
from fame.monitor.pipeline.join import Join
from fame.monitor.pipeline.training_checks import warnings_of
from fame.monitor.pipeline.training_settings import Training, training_of

RATE, LENGTH, CYCLES = 20.0, 120, 8
BEGIN = datetime(2026, 1, 31, 12, tzinfo=UTC)


def rows(repeat: bool = True, bad: int = -1) -> list[tuple[str, int, float, float]]:
    """Cycles of two channels; without `repeat` their phase is another each time; cycle `bad` has a shift at the end."""
    random = np.random.default_rng(5)
    found = []
    for cycle in range(CYCLES):
        angles = 2 * np.pi * np.arange(LENGTH) / LENGTH + (0.0 if repeat else random.uniform(0, 6))
        values = np.stack([np.sin(angles), np.cos(2 * angles)], axis=1) + 0.05 * random.standard_normal((LENGTH, 2))
        values[80:, 1] += 3.0 * (cycle == bad)
        for row, (left, right) in enumerate(values):
            when = BEGIN + timedelta(seconds=60 * cycle + row / RATE)
            found.append((when.strftime("%d.%m.%Y %H:%M:%S.%f"), cycle, left, right))
    return found


def german(path: Path, **options: Any) -> Path:
    """A table as a spreadsheet in German writes it."""
    cells = [
        f"{when};{cycle};{f'{left:.6f};{right:.6f}'.replace('.', ',')}" for when, cycle, left, right in rows(**options)
    ]
    path.write_text("\n".join(["Zeit;cycle;left;right", *cells]) + "\n")
    return path


def train(tmp_path: Path, file: Path, *more: str) -> int:
    return main([
        "monitor", "train", "--data", str(file), "--run-column", "cycle", "--time-column", "Zeit",
        "--false-alarms", "0.2 per run", "-o", str(tmp_path / "model.skops"), "--json", *more,
    ])  # fmt: skip


def test_cycles_of_a_table_train_and_judge_with_scores_for_each_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert train(tmp_path, german(tmp_path / "runs.csv")) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["detector"], told["columns"]) == ("any of phase, knn", ["left", "right"])
    judged = german(tmp_path / "new.csv", bad=3)
    scores = tmp_path / "scores.csv"
    command = ["monitor", "judge", str(tmp_path / "model.skops"), str(judged), "--scores", str(scores), "--json"]
    assert main(command) == 1
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["run"] for run in runs if run["verdict"] == "anomalous"] == [3]
    with scores.open() as stream:
        found = list(csv.DictReader(stream))
    assert {row["run"] for row in found} == set(map(str, range(CYCLES)))
    above = [row for row in found if float(row["right"]) > 1]
    assert {row["run"] for row in above} == {"3"}
    assert 80 / RATE < min(float(row["time"]) for row in above) < 80 / RATE + 1


def test_parquet_is_read_and_trains_as_csv_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    special = Special("Zeit", "cycle")
    expected = read_runs([german(tmp_path / "runs.csv")], (), special)
    frame = pd.DataFrame(rows(), columns=["Zeit", "cycle", "left", "right"])
    frame["Zeit"] = pd.to_datetime(frame["Zeit"], format="%d.%m.%Y %H:%M:%S.%f")
    frame.to_parquet(tmp_path / "runs.parquet")
    found = read_runs([tmp_path / "runs.parquet"], (), special)
    assert len(found) == len(expected) == CYCLES
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.values, other.values, atol=1e-6)
        np.testing.assert_allclose(one.stamps, other.stamps, atol=1e-5)
    said = []
    for file in ("runs.csv", "runs.parquet"):
        assert train(tmp_path, tmp_path / file) == 0
        said.append(json.loads(capsys.readouterr().out))
    assert said[0]["columns"] == said[1]["columns"] == ["left", "right"]
    np.testing.assert_allclose(said[0]["thresholds"], said[1]["thresholds"], rtol=1e-3)


def test_stamps_that_fall_within_a_run_are_refused_with_their_line(tmp_path: Path):
    file = tmp_path / "runs.csv"
    file.write_text("stamp,run,a\n0,0,1\n1,0,2\n0,1,3\n1,1,4\n0.5,1,5\n")
    with pytest.raises(ConfigError, match=r"runs\.csv:6: expected stamps that grow within a run, got 0\.5 after 1: "):
        read_runs([file])
    file.write_text("stamp,run,a,b\n0,0,1,2\n5,0,1,\n1,0,2,3\n")  # a row that is left out does not count
    assert read_runs([file])[0].stamps.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(("columns", "known"), [([], 50), (["a"], 100), (["b"], 50)])
def test_rows_that_training_leaves_out_are_told_but_not_those_of_other_topics(
    tmp_path: Path, columns: list[str], known: int
):
    """Half of each run has no b; a row of another topic has only c."""
    lines, random = ["stamp,run,a,b" + ",c" * bool(columns)], np.random.default_rng(6)
    for run in range(6):
        for row in range(120):
            left, right = np.array([np.sin(row / 5), np.cos(row / 8)]) + 0.05 * random.standard_normal(2)
            cells = [f"{left:.5f}", f"{right:.5f}" if row < 60 else ""]
            lines.append(",".join((f"{row / 20 + 0.001:.3f}", str(run), *cells, *[""] * bool(columns))))
            if columns:
                lines.append(f"{row / 20 + 0.01:.3f},{run},,,1")
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    found = warnings_of(training.train(Training((str(tmp_path / "runs.csv"),), columns=tuple(columns), detector="pca")))
    assert ("6 of 6 runs are not known as a whole, run 0 to 50 %" in str(found)) == (known == 50)


def counted(path: Path, factor: int, step: int = 20) -> Path:
    """Eight runs with whole numbers as stamps."""
    random = np.random.default_rng(4)
    lines = ["stamp,run,a,b"]
    for row in range(8 * 150):
        left, right = random.standard_normal(2)
        lines.append(f"{row * step * factor},{row // 150},{left:.5f},{right:.5f}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.long_but("s-*")
@pytest.mark.parametrize(("unit", "factor", "rate"), [("ms", 1, 50.0), ("us", 1000, 50.0), ("s", 1, 0.05)])
def test_whole_numbers_as_stamps_need_a_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str, factor: int, rate: float
):
    file, model = counted(tmp_path / "runs.csv", factor), tmp_path / "model.skops"
    command = ["monitor", "train", "--data", str(file), "--detector", "pca", "-o", str(model), "--keep", "--json"]
    assert main(command) == 2
    expected = f"whole numbers {20 * factor:g} apart, a rate of {0.05 / factor:.3g} Hz: say by --time-unit"
    assert expected in capsys.readouterr().out
    assert main([*command, "--time-unit", unit]) == 0
    assert json.loads(capsys.readouterr().out)["rate"] == pytest.approx(rate)
    judge = ["monitor", "judge", str(model), str(file), "--json"]
    main(judge)
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert runs[0]["seconds"] == pytest.approx(149 / rate)
    other = counted(tmp_path / "other.csv", 1, step=int(1000 / rate) if unit == "s" else 20)
    main([*judge[:3], str(other), "--json", "--time-unit", "ms"])
    assert json.loads(capsys.readouterr().out)["runs"][0]["seconds"] == pytest.approx(149 / rate)


def test_slow_stamps_are_s_where_that_is_sure(tmp_path: Path):
    """Dates, and what fame monitor record wrote."""
    for first, second in (("2026-01-31T12:00:00", "2026-01-31T12:01:00"), ("0.000000000", "60.000000000")):
        (tmp_path / "slow.csv").write_text(f"stamp,run,a\n{first},0,1\n{second},0,2\n")
        assert np.diff(read_runs([tmp_path / "slow.csv"])[0].stamps).tolist() == [60.0]
        with pytest.raises(ConfigError, match="the times are no numbers of ms: they are s, or dates"):
            read_runs([tmp_path / "slow.csv"], (), Special(unit="ms"))


def test_phases_suit_only_cycles_that_repeat(tmp_path: Path):
    special = Special("Zeit", "cycle")
    repeating, free = (
        read_runs([german(tmp_path / f"{each}.csv", repeat=each)], (), special) for each in (True, False)
    )
    named = [replace(run, elements=((0.0, "work"),)) for run in free]
    assert [any("phase" in name for name in suited(runs)) for runs in (repeating, free, named)] == [True, False, True]
    few = training.fit(repeating[:4], Training())
    assert few.detector_text == "mahalanobis (chosen, as the runs are fewer than 5)"


@pytest.mark.parametrize("key", ["hidden", "Activation", "EPOCHS"])
def test_a_key_of_autoencoders_says_which_detector_is_meant(tmp_path: Path, key: str):
    section = {key: "tanh" if key == "Activation" else 2}
    assert training_of(ConfigValue(section, "Training"), tmp_path).detector == "autoencoder"
    assert training_of(ConfigValue({**section, "Detector": "pca"}, "Training"), tmp_path).detector == "pca"
    assert training_of(ConfigValue({"Folds": 4}, "Training"), tmp_path).detector == ""


def test_a_configuration_without_detector_takes_the_one_that_finds_most_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    german(tmp_path / "runs.csv")
    section = "Files: [runs.csv], Model: m.skops, RunColumn: cycle, TimeColumn: Zeit, Window: 20"
    (tmp_path / "c.yaml").write_text(f"Training: {{{section}}}\n")
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 0
    told = re.search(
        r"m\.skops: ((.*) \(chosen, as it finds \d+ of \d+ injected faults.*\)), windows of 20", capsys.readouterr().out
    )
    assert told
    card = json.loads((tmp_path / "m.card.json").read_text())
    assert (card["Model"]["detector"], card["Settings"]["detector"]) == told.groups()
    (tmp_path / "c.yaml").write_text(f"Training: {{{section}, Detector: pca}}\n")
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 0
    assert "m.skops: pca, windows of 20 samples" in capsys.readouterr().out
    assert json.loads((tmp_path / "m.card.json").read_text())["Model"]["detector"] == "pca"


def test_what_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = german(tmp_path / "runs.csv")
    assert main(["monitor", "train", "--data", str(file), "--run-column", "cycle"]) == 2
    assert "expected a number in column 'Zeit'" in capsys.readouterr().err
    assert main(["monitor", "train", "--data", str(file), "--time-column", "Zeit", "--run-column", "part"]) == 2
    assert "has no column 'part'" in capsys.readouterr().err
    for name, columns in (("two", "stamp,a,b"), ("three", "stamp,a,b,c")):
        (tmp_path / f"{name}.csv").write_text(f"{columns}\n0,1,2,3\n".replace(",3" if name == "two" else "-", ""))
    assert main(["monitor", "train", "--data", str(tmp_path / "two.csv"), str(tmp_path / "three.csv")]) == 2
    assert "has columns that the first file lacks, c: say which to use" in capsys.readouterr().err
    assert main(["monitor", "train"]) == 2
    assert "expected a configuration with the section Training, or --data FILE" in capsys.readouterr().err
    (tmp_path / "bag").mkdir()
    for bag in (tmp_path / "bag", tmp_path / "runs.mcap"):
        assert main(["monitor", "train", "--data", str(bag)]) == 2
        assert f"fame monitor record CONFIG.yaml --bag {bag} -o runs.csv makes one" in capsys.readouterr().err
    (tmp_path / "runs.parquet").write_bytes(b"PAR0")
    assert main(["monitor", "train", "--data", str(tmp_path / "runs.parquet")]) == 2
    assert "is not a Parquet table of numbers" in capsys.readouterr().err


def with_texts(path: Path, runs: int = 6, rows: int = 80) -> Path:
    """Two channels and a column of texts."""
    random = np.random.default_rng(8)
    lines = ["stamp,run,a,step,b"]
    for run in range(runs):
        values = np.sin(np.arange(rows)[:, None] / [5, 8]) + 0.05 * random.standard_normal((rows, 2))
        lines += [f"{row / 20:.3f},{run},{a:.5f},Prep,{b:.5f}" for row, (a, b) in enumerate(values)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_text_beside_the_chosen_columns_is_none_of_our_business(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = with_texts(tmp_path / "runs.csv")
    assert read_runs([file], ("b",))[0].values.shape == (80, 1)
    words = ["monitor", "train", "--data", str(file), "--detector", "pca", "-o", str(tmp_path / "m.skops")]
    assert main(words) == 2
    assert "expected a number in column 'step', got 'Prep'" in capsys.readouterr().err
    assert main([*words, "--exclude", "step", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["columns"] == ["a", "b"]
    assert main(["monitor", "judge", str(tmp_path / "m.skops"), str(file)]) in (0, 1, 3)


def test_what_is_to_be_excluded_has_to_be_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    model = tmp_path / "m.skops"
    words = [
        "monitor",
        "train",
        "--data",
        str(with_texts(tmp_path / "runs.csv")),
        "-o",
        str(model),
        "--exclude",
        "step",
    ]
    assert main([*words, "B"]) == 2
    expected = (
        "runs.csv: Training.exclude: has no column or run 'B' (--exclude); it has stamp, run, a, step, b, and 6 runs"
    )
    assert expected in capsys.readouterr().err
    assert main([*words, "run 6"]) == 2
    assert "there is no run 6; there are 6, from run 0 on" in capsys.readouterr().err
    assert not model.exists()


def test_excluded_columns_of_parquet_are_known_also_when_they_are_texts(tmp_path: Path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    file = tmp_path / "runs.parquet"
    pd.DataFrame({"stamp": [0.0, 1.0], "a": [1.0, 2.0], "step": ["x", "y"]}).to_parquet(file)
    (run,) = read_labelled_runs([file], (), Special(exclude=("step",)), undisturbed=True)
    assert run.samples.names == ("a",)
    with pytest.raises(ConfigError, match="has no column or run 'steps'"):
        read_labelled_runs([file], (), Special(exclude=("step", "steps")), undisturbed=True)


def test_an_anomalous_run_is_refused_by_its_column_unless_it_is_excluded(tmp_path: Path):
    file = tmp_path / "runs.csv"
    file.write_text("stamp,run,a,state\n0,0,1,0\n1,0,2,0\n2,1,3,0\n3,1,4,2\n")
    special = Special(anomaly="state")
    with pytest.raises(ConfigError, match="expected undisturbed runs, column 'state' is not 0 in run 1: leave it out"):
        read_labelled_runs([file], (), special, undisturbed=True)
    for names in ("run 1", "runs.csv"):
        assert len(read_labelled_runs([file], (), special._replace(exclude=(names,)), undisturbed=True)) == 2
    file.write_text("stamp,run,a,label\n0,0,1,1\n1,0,2,-1\n")
    with pytest.raises(ConfigError, match=r"expected undisturbed runs \(label 1\), got label -1 in run 0"):
        read_labelled_runs([file], (), undisturbed=True)


def test_rows_that_are_left_out_are_counted_with_what_they_lack_and_where(tmp_path: Path):
    (tmp_path / "runs.csv").write_text("stamp,run,a,b\n0,0,1,2\n1,0,inf,3\n2,0,4,\n3,0,4,4\n4,1,1,1\n")
    bad, good = read_labelled_runs([tmp_path / "runs.csv"])
    assert bad.lacking == "2 of 4 rows have an empty cell or inf in a, b (line 3 first)"
    assert good.lacking == ""
    rows = [f"{n},0,{n},1" for n in range(20)]
    rows[4:5] = ["4,0,4,1", "4,0,4,1", "4,0,5,1"]  # the second one says nothing new, the third one something else
    (tmp_path / "runs.csv").write_text("\n".join(["stamp,run,a,b", *rows, ""]))
    (run,) = read_labelled_runs([tmp_path / "runs.csv"])
    assert run.samples.values[:, 0].tolist() == list(range(20))
    assert (run.lacking, run.seen) == ("1 of 22 rows have the stamp of the row before (line 8 first)", 20 / 21)
    (tmp_path / "runs.csv").write_text("stamp,a,b\n" + "".join(f"{n // 2},{n},1\n" for n in range(20)))
    with pytest.raises(ConfigError, match=r"many rows with the stamp of the row before, 0 first: .* \(--rate\)"):
        read_labelled_runs([tmp_path / "runs.csv"])


def test_one_recording_without_runs_is_cut_into_parts(tmp_path: Path):
    random = np.random.default_rng(3)
    rows = [f"{n / 50:.3f},{a:.5f},{b:.5f}" for n, (a, b) in enumerate(random.standard_normal((4100, 2)))]
    (tmp_path / "stream.csv").write_text("\n".join(["stamp,a,b", *rows]) + "\n")
    config = Training((str(tmp_path / "stream.csv"),), detector="pca", window=10, false_alarms="0.1 per run")
    model = training.train(config)
    assert model.conditions["runs"] == 20
    assert "one recording, cut into 20 parts of 4.08 s: a run is such a part" in warnings_of(model)
    file = tmp_path / "runs.csv"  # of a robot that rests between its runs, and is not recorded then
    values = (line.partition(",")[2] for line in rows[:1200])
    timed = [f"{n // 200 * 10 + n % 200 / 50},{row}" for n, row in enumerate(values)]
    file.write_text("\n".join(["stamp,a,b", *timed, ""]))
    model = training.train(replace(config, files=(str(file),)))
    assert "one recording, cut into 6 parts of 3.98 s: a run is such a part" in warnings_of(model)


def test_training_says_why_no_window_is_whole(tmp_path: Path):
    file = tmp_path / "two.csv"
    rows = [f"{n / 10},{n // 40},{n % 7},{'' if n % 4 else n}" for n in range(80)]
    file.write_text("\n".join(["stamp,run,a,b", *rows, ""]))
    config = Training((str(file),), detector="pca", window=10, join=Join(10, 0.15, "hold"))
    with pytest.raises(ConfigError, match=r"no run has 10 samples at 10 Hz in a row; 2 of 2 runs .* \(b\)"):
        training.train(config)


BLOCKS = "normal\n\t-1\t63\n\t0\t62\n\t0\t61\n\n\ncollision\n\t-1\t64\n\t90\t60\n\t0\t61\n"
"""As the robot failures of UCI are published."""


def test_blocks_behind_a_line_with_their_class_are_runs_and_one_class_trains(tmp_path: Path):
    (tmp_path / "lp.data").write_text(BLOCKS)
    special = Special(rate=50.0, benign="normal")
    good, bad = read_labelled_runs([tmp_path / "lp.data"], (), special)
    assert (good.samples.names, good.labels.tolist(), bad.labels.tolist()) == (
        ("channel_0", "channel_1"), [1] * 3, [-1] * 3
    )  # fmt: skip
    assert bad.samples.values.tolist() == [[-1, 64], [90, 60], [0, 61]]
    np.testing.assert_allclose(np.diff(bad.samples.stamps), 0.02)
    read = read_labelled_runs([tmp_path / "lp.data"], (), special, undisturbed=True)
    assert [is_other_class(run, special) for run in read] == [False, True]  # which keeps its number
    with pytest.raises(ConfigError, match="classes normal, collision: say by --benign which ones are undisturbed"):
        read_labelled_runs([tmp_path / "lp.data"], (), Special(rate=50.0))
    (tmp_path / "torn.data").write_text(BLOCKS + "\t1\n")
    with pytest.raises(ConfigError, match="expected 2 numbers, or the class of the next block, got '1'") as error:
        read_labelled_runs([tmp_path / "torn.data"], (), special)
    assert error.value.line == 11


def test_a_run_of_blocks_has_one_number_in_training_and_in_judging(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    random = np.random.default_rng(6)

    def block(name: str, level: float) -> str:
        rows = random.normal(level, 1, (30, 2)) + np.sin(np.arange(30) / 3)[:, None] * 5
        return "\n".join([name, *(f"\t{a:.3f}\t{b:.3f}" for a, b in rows), "", ""])

    file, model = tmp_path / "lp.data", str(tmp_path / "m.skops")
    blocks = [block("crash", 90), *(block("normal", 0) for _ in range(6)), block("crash", 90)]
    file.write_text("".join(blocks))
    words = ["--data", str(file), "--benign", "normal", "--rate", "50", "--window", "5", "--detector", "pca"]
    assert main(["monitor", "train", *words, "--exclude", "run 3", "-o", model, "--keep"]) == 0
    capsys.readouterr()
    assert main(["monitor", "judge", model, str(file), "--json"]) == 1
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["run"] for run in runs if run["learned from"]] == [1, 2, 4, 5, 6]
    assert [runs[at]["verdict"] for at in (0, 7)] == ["anomalous"] * 2
    assert main(["monitor", "train", *words, "--exclude", "run 8", "-o", model]) == 2
    assert "there is no run 8; there are 8, from run 0 on" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--output", "--onnx"])
def test_what_cannot_be_written_is_said_before_training(
    tmp_path: Path, option: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(training, "train", lambda *args, **more: pytest.fail("it trained"))
    monkeypatch.setattr("fame.imports.require", lambda *modules: None)
    (tmp_path / "file").touch()
    words = ["monitor", "train", "--data", str(tmp_path / "runs.csv"), "--output", str(tmp_path / "m.skops")]
    for path, wrong in ((tmp_path, "expected a file, got a folder"), (tmp_path / "file" / "m", "cannot be written")):
        assert main([*words, option, str(path)]) == 2
        assert f"{path}: {wrong}" in capsys.readouterr().err


def test_a_benign_class_is_one_of_a_file_of_blocks(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, model = with_texts(tmp_path / "runs.csv"), tmp_path / "m.skops"
    words = ["monitor", "train", "--data", str(file), "--exclude", "step", "--detector", "pca", "-o", str(model)]
    assert main([*words, "--benign", "normal"]) == 2
    expected = (
        "runs.csv: is no file of blocks, each behind a line with its class: none is of the class 'normal' (--benign)"
    )
    assert expected in capsys.readouterr().err
    assert not model.exists()
    assert main(words) == 0
    assert main(["monitor", "judge", str(model), str(file), "--benign", "normal"]) == 2
    assert expected in capsys.readouterr().err


def test_a_file_is_read_from_a_start_to_an_end_at_a_rate_with_the_labels_of_a_column(tmp_path: Path):
    rows = [f"2020-03-09 10:00:{2 * n:02d};{n};{float(n >= 6)};0" for n in range(10)]
    (tmp_path / "skab.csv").write_text("\n".join(["datetime;Current;anomaly;changepoint", *rows]) + "\n")
    special = Special("datetime", exclude=("changepoint",), start=4.0, end=16.0, anomaly="anomaly")
    (run,) = read_labelled_runs([tmp_path / "skab.csv"], (), special)
    assert (run.samples.names, run.samples.values[:, 0].tolist()) == (("Current",), [2, 3, 4, 5, 6, 7])
    assert run.labels.tolist() == [1, 1, 1, 1, -1, -1]
    (run,) = read_labelled_runs([tmp_path / "skab.csv"], (), special._replace(rate=1.0, end=math.inf))
    assert run.samples.stamps.tolist() == [4, 5, 6, 7, 8, 9]
    with pytest.raises(ConfigError, match=r"has no row from 100 to inf s since its first one \(--start, --end\)"):
        read_labelled_runs([tmp_path / "skab.csv"], (), special._replace(start=100.0, end=math.inf))
    with pytest.raises(ConfigError, match=r"has no column 'wrong' \(--anomaly-column\)"):
        read_labelled_runs([tmp_path / "skab.csv"], (), special._replace(anomaly="wrong"))
    with pytest.raises(ConfigError, match=r"has no column 'stamp'; .*; without times, --rate says how many rows come"):
        read_labelled_runs([tmp_path / "skab.csv"], ("Current",))


def test_a_stream_with_labels_has_rates_of_its_rows_beside_those_of_an_alarm_that_is_always_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """From files as published to a verdict: the first part trains, the rest is judged."""
    random = np.random.default_rng(2)
    values = random.standard_normal((900, 2)) + [[8.0 * (n >= 800), 0.0] for n in range(900)]
    rows = [f"{a:.4f},{b:.4f},{int(n >= 800)}" for n, (a, b) in enumerate(values)]
    (tmp_path / "stream.csv").write_text("\n".join(["a,b,anomaly", *rows]) + "\n")
    words = ["--data", str(tmp_path / "stream.csv"), "--rate", "50", "--anomaly-column", "anomaly"]
    model = str(tmp_path / "m.skops")
    more = ["--window", "5", "--stride", "1", "--end", "8", "--detector", "mahalanobis", "--false-alarms", "0.1"]
    assert main(["monitor", "train", *words, *more, "-o", model, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["columns"] == ["a", "b"]
    assert main(["monitor", "judge", model, words[1], "--start", "8", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    figures, rows = found["figures"], found["runs"][0]["rows"]
    assert sum(rows.values()) == 496  # from the first whole window on
    assert rows["missed"] / (rows["missed"] + rows["found"]) == figures["rows missed"]["rate"] < 0.05
    assert figures["rows with a false alarm"]["rate"] < 0.1
    assert figures["F1 of rows"] > 0.85 > figures["F1 if the alarm were always on"]
    assert figures["F1 if the alarm were always on"] == pytest.approx(2 * 100 / (100 + 496), rel=0.01)


def test_a_model_does_not_replace_the_runs_that_train_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "runs.csv"
    file.write_text("run,stamp,a\n" + "".join(f"{row // 60},{row / RATE},{row % 7}\n" for row in range(240)))
    before = file.read_bytes()
    words = ["monitor", "train", "--data", str(file), "--detector", "pca", "--window", "10", "-o", str(file)]
    assert main(words) == 2
    assert "expected a new file, got one that is read" in capsys.readouterr().err
    assert file.read_bytes() == before
