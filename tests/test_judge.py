"""Recorded runs judged by a model: verdicts, events, figures, the report, and the card of the model."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import own_data
import pytest
from monitor_runs import told, write_runs

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor import judge_report
from fame.monitor.data_files import LabelledRun, read_labelled_runs
from fame.monitor.drift import Drift, DriftMonitor
from fame.monitor.judge import JudgedRun, _share, areas, judge_trained
from fame.monitor.model_card import card_of, to_markdown
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.trained_model import TrainedModel


@pytest.fixture(scope="module")
def model() -> TrainedModel:
    runs = [own_data.run(seed) for seed in range(16)]
    return fit(runs, Training(window=40, detector="mahalanobis", samples=4000), data="cafe" * 16)


@pytest.fixture(scope="module")
def folder(model: TrainedModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("judge")
    model.save(folder / "monitor.skops")
    runs = [own_data.run(1000), own_data.run(5001, "stuck"), own_data.run(1001), own_data.run(5002, "vibration")]
    write(folder / "runs.csv", runs, anomalous=(1, 3))
    return folder


def write(path: Path, runs: list[Samples], anomalous: tuple[int, ...] | None) -> None:
    if anomalous is None:
        write_runs(path, runs)
    else:
        onset = own_data.ONSET
        write_runs(path, runs, lambda run, row: -1 if run in anomalous and runs[run].stamps[row] >= onset else 1)


def test_runs_have_verdicts_events_with_channels_and_latency(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", folder / "runs.csv")
    assert code == 1
    assert [run["verdict"] for run in found["runs"]] == ["benign", "anomalous", "benign", "anomalous"]
    assert [run["label"] for run in found["runs"]] == [1, -1, 1, -1]
    stuck = found["runs"][1]
    first = stuck["events"][0]
    assert next(iter(first["shares"])) == own_data.NAMES[5001 % 12 % 8]
    assert own_data.ONSET < first["start"] < own_data.ONSET + 1
    text, *_ = first["explanations"]
    assert text.startswith(next(iter(first["shares"])))
    assert "in training" in text
    assert stuck["latency"] == pytest.approx(first["start"] - own_data.ONSET, abs=0.02)
    figures = found["figures"]
    assert (figures["false alarms"], figures["found"]) == (0, 2)
    assert figures["area under ROC"]["value"] == 1.0
    assert figures["false alarms per run"]["interval"][1] == pytest.approx(1 - 0.025**0.5)


@pytest.mark.long
def test_the_report_is_one_static_page_with_plots_of_the_runs(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "out" / "report.html"
    assert main(["monitor", "judge", str(folder / "monitor.skops"), str(folder / "runs.csv"), "-o", str(page)]) == 1
    text = page.read_text()
    assert text.count("<svg") == 4 + 4  # scores, drift, two curves, four runs
    assert "<script" not in text
    assert "http" not in text.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    ).replace("https://matplotlib.org", "")
    assert "no promise" in text
    for head in ("Figures", "Runs", "Events", "Losses over time", "Model card"):
        assert f"<h2>{head}</h2>" in text


@pytest.mark.parametrize(
    ("label", "wrong", "kind"),
    [(None, (), "good"), (None, ("x",), "bad"), (1, ("x",), "bad"), (-1, ("x",), "good"), (-1, (), "bad")],
)
def test_a_report_has_an_alarm_in_red_unless_it_is_labelled_so(
    label: int | None, wrong: tuple[str, ...], kind: str
) -> None:
    run = JudgedRun(0, "run.csv", 1.0, (), np.ones(1), np.ones((1, 1)), ("a",), label=label, order=wrong)
    assert f'<td class="{kind}">{run.verdict}</td>' in judge_report._runs([run])


def test_an_alarm_is_explained_by_what_the_training_runs_did_at_that_time() -> None:
    stamps = np.arange(60) / 10
    runs = [Samples(np.column_stack([np.sin(stamps), stamps + n]), stamps, ("a", "b")) for n in range(3)]
    band = Band.of(runs, [stamps] * 3)
    other = Samples(np.column_stack([np.sin(stamps), stamps + 1]), stamps, ("a", "b"))
    other.values[30:, 1] = 9.0
    texts = [each.text for each in band.explain(other, stamps, (1, 0), (0.9, 0.1))]
    assert texts == ["b: 9 at 3 s; in training 3 to 5", "a: unusual course within the values of the training (0 to 0)"]
    assert np.isnan(band.at(np.array([5.9, 6.3]))[0]).any(axis=1).tolist() == [False, True]
    (whole,) = Band.of(runs, None).explain(other, stamps, (1,), (1.0,))
    assert whole.text == "b: 9 at 3 s; in training 0 to 7.9"


def test_without_labels_alarms_are_counted_per_hour(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "stream.csv", [own_data.run(1003)], None)
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "stream.csv")
    assert code == 0
    assert found["figures"]["alarms per hour"] == 0.0
    assert found["runs"][0]["label"] is None


def test_a_run_without_a_whole_window_is_told(model: TrainedModel) -> None:
    short = own_data.run(1)
    run = LabelledRun(Samples(short.values[:10], short.stamps[:10], short.names), np.ones(10, dtype=np.int64), "a.csv")
    (judged,) = judge_trained(model, [run], "m").runs
    assert judged.notes == ("no whole window of 40 samples at 100 Hz: not judged",)
    assert (judged.verdict, judged.share) == ("not judged", 0.0)


def effort(seed: int) -> Samples:
    """Two channels of filtered noise around 0, which do not repeat."""
    noise = np.random.default_rng(seed).standard_normal((519, 2))
    values = np.stack([np.convolve(each, np.ones(20) / 20, "valid") for each in noise.T], axis=1)
    return Samples(values, np.arange(500) / 50, ("a", "b"))


def dead(values: np.ndarray) -> None:
    values[:, 0] = 0


def frozen(values: np.ndarray) -> None:
    values[100:, 0] = values[100, 0]


def scaled(values: np.ndarray) -> None:
    values *= 0.001


@pytest.mark.long
@pytest.mark.parametrize("detector", ["mahalanobis", "pca", "knn", "phase"])
def test_a_run_with_a_sensor_that_failed_is_not_judged(detector: str) -> None:
    model = fit([effort(seed) for seed in range(12)], Training(window=50, detector=detector))
    earlier = replace(model, conditions={})
    for fail in (dead, frozen, scaled):
        run = effort(100)
        fail(run.values)
        given = LabelledRun(run, np.ones(500, dtype=np.int64), "a.csv")
        (judged,) = judge_trained(model, [given], "m").runs
        assert (judged.verdict, judged.share < 0.4) == ("not judged", True)
        assert judged.notes[0] == "a hardly moves: not judged"
        assert not any("no whole window" in text for text in judged.notes)
        assert judge_trained(earlier, [given], "m").runs[0].share == 1
    for seed in range(100, 105):
        (judged,) = judge_trained(model, [LabelledRun(effort(seed), np.ones(500, dtype=np.int64), "a.csv")], "m").runs
        assert (judged.share, judged.notes) == (1, ())


def test_a_node_reports_a_dead_sensor_and_gives_no_loss_but_alarms_where_it_is_far_off() -> None:
    model = fit([effort(seed) for seed in range(12)], Training(window=50, detector="mahalanobis"))
    texts: list[str] = []
    scorer = Autoencoder(model)
    scorer.report = texts.append
    run = effort(100)
    dead(run.values)
    assert scorer.execute({"x": run}) is None
    assert texts == ["a hardly moves: not judged"]
    run.values[:, 0] = 100.0
    (judged,) = judge_trained(model, [LabelledRun(run, np.ones(500, dtype=np.int64), "a.csv")], "m").runs
    assert judged.verdict == "anomalous"


def slower(run: Samples) -> Samples:
    """The same at half the rate."""
    return run.replace(run.values, stamps=2 * run.stamps)


@pytest.mark.long
def test_runs_that_were_not_judged_are_never_benign(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = own_data.run(1003), own_data.run(5001, "stuck")
    write(tmp_path / "mixed.csv", [good, slower(good)], None)
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "mixed.csv")
    assert (code, found["status"]) == (3, "partial")
    assert [(run["verdict"], run["share judged"]) for run in found["runs"]] == [("benign", 1.0), ("not judged", 0.0)]
    assert (found["figures"]["not judged"], found["figures"]["share judged"]) == (1, pytest.approx(1 / 3, abs=0.01))
    assert main(["monitor", "judge", str(folder / "monitor.skops"), str(tmp_path / "mixed.csv")]) == 3
    assert "not judged: 1" in capsys.readouterr().out
    write(tmp_path / "worse.csv", [slower(good), bad], None)
    assert told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "worse.csv")[0] == 1


def test_empty_cells_are_told_and_what_they_leave_out_is_not_benign(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "gaps.csv", [own_data.run(1003), own_data.run(1004)], None)
    head, *lines = (tmp_path / "gaps.csv").read_text().splitlines()
    lines[500:900] = [line.rpartition(",")[0] + "," for line in lines[500:900]]
    lines[2000:] = [line.rpartition(",")[0] + "," for line in lines[2000:]]
    (tmp_path / "gaps.csv").write_text("\n".join([head, *lines]) + "\n")
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "gaps.csv")
    assert code == 3
    assert [run["verdict"] for run in found["runs"]] == ["not judged", "not judged"]
    assert 0.7 < found["runs"][0]["share judged"] < 0.85
    assert any("rows have an empty cell in " in note for note in found["runs"][0]["notes"])


def test_what_no_window_between_others_has_seen_is_not_judged() -> None:
    ends = np.arange(20, 151, 5) / 50  # of windows of 20 samples at 50 Hz, in a run of 3 s
    assert [_share(ends[:-2], 0.4, 3.0, 0.1), _share(ends, 0.4, 3.09, 0.1)] == [pytest.approx(1 - 0.2 / 3), 1.0]
    without = ends[(ends < 1.45) | (ends > 1.85)]  # those with a value that no detector could take
    assert _share(without, 0.4, 3.0, 0.1) == pytest.approx(1 - 0.1 / 3)


def test_a_run_that_ends_early_is_not_judged_if_runs_have_a_length_of_their_own(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = own_data.run(1003)
    early = run.replace(run.values[:400], stamps=run.stamps[:400])
    write(tmp_path / "early.csv", [run, early], None)
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "early.csv")
    assert (code, [each["verdict"] for each in found["runs"]]) == (3, ["benign", "not judged"])
    assert found["runs"][1]["share judged"] == pytest.approx(0.2, abs=0.01)
    assert found["runs"][1]["notes"][-1].startswith("cut off before its end: 3.99 s, training runs last at least 19")


def test_a_part_of_what_does_not_repeat_is_judged(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    streams = [random.standard_normal((600, 2)) for _ in range(9)]
    runs = [Samples(values, np.arange(600) / 50, ("a", "b")) for values in streams]
    model = fit(runs[:8], Training(window=20, detector="mahalanobis", margin=3.0))
    part = Samples(streams[8][:100], np.arange(100) / 50, ("a", "b"))
    (judged,) = judge_trained(model, [LabelledRun(part, np.ones(100, dtype=np.int64), "a")], "m").runs
    assert (judged.verdict, judged.share) == ("benign", 1.0)


def test_rows_with_an_empty_cell_here_and_there_are_not_benign(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "torn.csv", [own_data.run(1003)], None)
    head, *lines = (tmp_path / "torn.csv").read_text().splitlines()
    lines[5::10] = [line.rpartition(",")[0] + "," for line in lines[5::10]]
    (tmp_path / "torn.csv").write_text("\n".join([head, *lines]) + "\n")
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / "torn.csv")
    assert (code, found["runs"][0]["verdict"]) == (3, "not judged")
    assert found["runs"][0]["share judged"] == pytest.approx(0.9, abs=0.01)


@pytest.mark.long
@pytest.mark.parametrize("separator", [";", "\t", "|"])
def test_decimal_commas_separators_and_dates_are_understood(
    separator: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "plain.csv", [own_data.run(1003)], None)
    head, *lines = (tmp_path / "plain.csv").read_text().splitlines()
    rows = [head.split(",")]
    for line in lines:
        stamp, *rest = line.split(",")
        seconds = float(stamp)
        rows.append([f"2026-01-31T12:00:{seconds:09.6f}", *(cell.replace(".", ",") for cell in rest)])
    (tmp_path / "local.csv").write_text("\n".join(separator.join(row) for row in rows) + "\n")
    plain, local = (
        told(capsys, "monitor", "judge", folder / "monitor.skops", tmp_path / f"{name}.csv")
        for name in ("plain", "local")
    )
    assert plain[0] == local[0] == 0
    assert local[1]["runs"][0]["score"] == pytest.approx(plain[1]["runs"][0]["score"], rel=1e-3)


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ("31.1.2026 12:00:33,1", "runs.csv:2: expected a number (s) or a date such as 2026-01-31T12:00:00.5 in column "
         "'stamp', got '31.1.2026 12:00:33'"),
        ("0.1,high", "runs.csv:2: expected a number in column 'a', got 'high'"),
        ("0.1,1_0", "runs.csv:2: expected a number in column 'a', got '1_0'"),
        ("0.1,True\n0.2,0.5", "runs.csv:2: expected a number in column 'a', got 'True'"),
        ("0,1,2,5", "runs.csv:2: expected 2 cells, got 4; a decimal comma needs another separator, such as ;"),
    ],
)  # fmt: skip
def test_cells_that_are_no_numbers_are_named_with_their_column(row: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(f"stamp,a\n{row}\n")
    with pytest.raises(ConfigError) as found:
        read_labelled_runs([tmp_path / "runs.csv"])
    assert str(found.value).endswith(text)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("nowhere.skops", "runs.csv"), "nowhere.skops: there is no such file"),
        (("monitor.skops", "nowhere.csv"), "nowhere.csv: cannot be read: No such file"),
        (("monitor.skops", "bag.mcap"), "a bag needs --config CONFIG.yaml"),
        (("runs.csv", "runs.csv"), "is corrupt, or no model of fame monitor train or adm learn"),
    ],
)
def test_what_cannot_be_judged_is_one_line(
    folder: Path, words: tuple[str, str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitor", "judge", *(str(folder / word) for word in words)]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def test_intervals_of_areas_hold_the_value() -> None:
    random = np.random.default_rng(1)
    positive = np.repeat([False, True], 40)
    found = areas(random.normal(positive, 1.0), positive)
    for part in found.values():
        assert part["interval"][0] < part["value"] < part["interval"][1]


@pytest.mark.parametrize("levels", [3, 1000], ids=["many equal scores", "few"])
def test_areas_are_those_of_scikit_learn(levels: int) -> None:
    from sklearn.metrics import average_precision_score, roc_auc_score

    random = np.random.default_rng(2)
    positive = random.random(50) < 0.3
    scores = random.integers(0, levels, 50) + 1.0 * positive
    found = areas(scores, positive)
    assert found["area under ROC"]["value"] == pytest.approx(roc_auc_score(positive, scores))
    assert found["average precision"]["value"] == pytest.approx(average_precision_score(positive, scores))


# ---- the card --------------------------------------------------------------------------------------------------------


def test_a_card_says_what_was_learned_promised_and_measured(model: TrainedModel) -> None:
    card = card_of(model)
    assert card["Data"]["sha256"] == "cafe" * 16
    assert card["Data"]["runs"] == 16
    assert card["False alarms"]["promised per run"] is None
    assert "16 runs promise 0.059 per run at best, 99 are needed" in card["False alarms"]["promise"]
    low, high = card["False alarms"]["95 % interval"]
    assert low <= card["False alarms"]["measured per run"] <= high
    assert set(card["Thresholds"]) == set(own_data.NAMES)
    text = to_markdown(card)
    assert all(f"## {name}" in text for name in card)


def test_the_card_is_printed_from_the_model_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "model", "show", str(folder / "monitor.skops")]) == 0
    assert "no promise" in capsys.readouterr().out
    code, found = told(capsys, "monitor", "model", "show", folder / "monitor.skops")
    assert (code, found["Model"]["detector"]) == (0, "mahalanobis")


# ---- two models ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_two_models_judge_the_same_runs_and_the_labels_say_which_is_better(
    folder: Path, model: TrainedModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deaf = replace(model, thresholds=tuple(1e6 * each for each in model.thresholds), conditions={})
    deaf.save(tmp_path / "deaf.skops")
    names, data = (folder / "monitor.skops", tmp_path / "deaf.skops"), folder / "runs.csv"
    code, found = told(capsys, "monitor", "model", "compare", *names, data)
    assert (code, found["better"], found["worse"]) == (1, 0, 2)
    assert [(run["run"], run["label"], run["old"], run["new"]) for run in found["differing"]] == [
        (1, -1, "anomalous", "benign"),
        (3, -1, "anomalous", "benign"),
    ]
    assert (found["old"]["figures"]["found"], found["new"]["figures"]["found"]) == (2, 0)
    write(tmp_path / "one.csv", [own_data.run(5001, "stuck")], anomalous=(0,))
    assert told(capsys, "monitor", "model", "compare", *reversed(names), tmp_path / "one.csv")[0] == 0
    assert main(["monitor", "model", "compare", *map(str, (names[0], names[0], tmp_path / "one.csv"))]) == 0
    assert "same verdicts on every run" in capsys.readouterr().out


@pytest.mark.long
def test_without_labels_or_verdicts_which_model_is_better_is_not_known(
    folder: Path, model: TrainedModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(model, thresholds=tuple(1e6 * each for each in model.thresholds)).save(tmp_path / "deaf.skops")
    names = (folder / "monitor.skops", tmp_path / "deaf.skops")
    write(tmp_path / "runs.csv", [own_data.run(1000), own_data.run(5001, "stuck")], anomalous=None)
    code, found = told(capsys, "monitor", "model", "compare", *names, tmp_path / "runs.csv")
    assert (code, found["status"]) == (3, "partial")
    assert found["text"] == "other verdicts on 1 of 2 runs: without labels, which model is right is not known"
    short = own_data.run(1000)
    write(tmp_path / "short.csv", [replace(short, values=short.values[:20], stamps=short.stamps[:20])], anomalous=())
    code, found = told(capsys, "monitor", "model", "compare", names[0], names[0], tmp_path / "short.csv")
    assert (code, found["text"]) == (3, "same verdicts on every run")


@pytest.mark.long
def test_a_run_without_labels_is_not_benign_beside_a_file_that_has_them(
    folder: Path, model: TrainedModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "labelled.csv", [own_data.run(1000)], anomalous=())
    write(tmp_path / "plain.csv", [own_data.run(5001, "stuck"), own_data.run(1001)], anomalous=None)
    data = tmp_path / "labelled.csv", tmp_path / "plain.csv"
    code, found = told(capsys, "monitor", "judge", folder / "monitor.skops", *data)
    figures = found["figures"]
    assert (code, [run["label"] for run in found["runs"]]) == (1, [1, None, None])
    assert (figures["benign runs"], figures["false alarms"], figures["without label"]) == (1, 0, 2)
    replace(model, thresholds=tuple(1e6 * each for each in model.thresholds)).save(tmp_path / "deaf.skops")
    names = folder / "monitor.skops", tmp_path / "deaf.skops"
    code, found = told(capsys, "monitor", "model", "compare", *names, *data)
    assert (code, found["better"], found["worse"]) == (3, 0, 0)


def test_a_run_whose_label_cells_are_empty_has_no_label(tmp_path: Path) -> None:
    rows = ["0,0,1.0,1", "1,0,2.0,1", "0,1,3.0,", "1,1,4.0,", "0,2,5.0,", "1,2,6.0,-1"]
    (tmp_path / "runs.csv").write_text("stamp,run,a,label\n" + "\n".join(rows) + "\n")
    runs = read_labelled_runs([tmp_path / "runs.csv"])
    assert [(run.labelled, run.labels.tolist()) for run in runs] == [(True, [1, 1]), (False, [1, 1]), (True, [1, -1])]


def test_where_a_loss_is_no_number_a_run_is_not_judged(model: TrainedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    execute, run = Autoencoder.execute, own_data.run(1000)
    third = run.stamps[len(run) // 3]

    def forget(scorer: Autoencoder, inputs: Mapping[str, Samples]) -> Any:
        if (found := execute(scorer, inputs)) is not None:
            found["loss"].values[found["loss"].stamps > third, 2] = np.nan
        return found

    monkeypatch.setattr(Autoencoder, "execute", forget)
    given = LabelledRun(run, np.ones(len(run), dtype=np.int64), "a.csv")
    (judged,) = judge_trained(model, [given], "m").runs
    assert (judged.verdict, judged.events, f"{model.columns[2]} is no number: not judged" in judged.notes) == (
        "not judged",
        (),
        True,
    )
    assert 0.2 < judged.share < 0.5


# ---- drift -----------------------------------------------------------------------------------------------------------


def test_a_slow_change_is_drift_before_it_is_an_alarm(model: TrainedModel, tmp_path: Path) -> None:
    assert model.calibration is not None
    dead = DriftMonitor.of(model.columns, model.calibration)
    for _ in range(5):
        dead.add(np.full(len(model.columns), np.nan))
    assert (dead.drifting, dead.sums.any()) == ((), False)  # what is no number is neither as before nor drifting
    monitor = DriftMonitor.of(model.columns, model.calibration)
    levels, deviations = np.array(model.calibration.levels), np.array(model.calibration.deviations)
    for run in range(60):
        drifted = np.where(np.arange(12) == 4, 0.15 * run, 0.0)
        scores = np.exp(levels + drifted * deviations)
        if monitor.add(scores):
            break
        monitor.save(tmp_path / "drift.json")
        monitor = DriftMonitor.of(model.columns, model.calibration)  # another process goes on
        monitor.restore(tmp_path / "drift.json")
    assert monitor.drifting == ("current_0",)
    assert (scores < np.array(model.thresholds)).all()
    assert 5 < monitor.runs < 30
    (tmp_path / "drift.json").write_text((tmp_path / "drift.json").read_text().replace("0.0", "NaN", 1))
    with pytest.raises(ConfigError, match="a sum is not finite"):  # it would never drift again
        monitor.restore(tmp_path / "drift.json")


def test_a_node_signals_drift_once_and_goes_on_after_a_restart(model: TrainedModel, tmp_path: Path) -> None:
    assert model.calibration is not None
    levels, deviations = np.array(model.calibration.levels), np.array(model.calibration.deviations)
    told = []
    for mission in range(12):
        drift = Drift(model, state=str(tmp_path / "drift.json"), gap=2.0)
        for cycle in range(2):  # two runs of each mission, 10 s apart
            loss = np.exp(levels + np.where(np.arange(12) == 6, 0.2 * (2 * mission + cycle), 0.0) * deviations)
            stamps = 100.0 * mission + 10.0 * cycle + np.arange(5) * 0.1 + 1
            found = drift.execute({"loss": Samples(np.tile(loss, (5, 1)), stamps, model.columns)})
            if found:
                told.append((mission, found["name"].values.tolist(), found["sum"].values[0, 0] > 5))
        drift.close()
        assert drift.monitor.runs == 2 * (mission + 1)
    assert told[0][1:] == ([["current_2"]], True)
    assert [mission for mission, *_ in told] == sorted({mission for mission, *_ in told})  # once in each mission


def test_one_anomalous_run_is_no_drift(model: TrainedModel) -> None:
    assert model.calibration is not None
    monitor = DriftMonitor.of(model.columns, model.calibration)
    usual = np.exp(np.array(model.calibration.levels))
    for run in range(30):
        assert monitor.add(usual * (1000 if run == 10 else 1)) == ()


def test_a_report_does_not_replace_the_runs_nor_the_model(folder: Path, capsys: pytest.CaptureFixture[str]):
    files = [folder / "monitor.skops", folder / "runs.csv"]
    before = [each.read_bytes() for each in files]
    for option in ("-o", "--scores"):
        for each in files:
            assert main(["monitor", "judge", *map(str, files), option, str(each)]) == 2
            assert "expected a new file, got one that is read" in capsys.readouterr().err
    assert [each.read_bytes() for each in files] == before
