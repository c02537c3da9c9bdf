"""Detectors: trained from runs, calibrated by runs that were left out, stored, refused when foreign or stale."""

import json
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from monitor_runs import write_runs

from fame.config.values import ConfigValue
from fame.errors import ConfigError
from fame.monitor.calibration import MARGIN
from fame.monitor.data_files import hash_files, read_runs
from fame.monitor.pipeline.detectors import ChannelAutoencoders
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.filters import LowPass
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.processors import run
from fame.monitor.pipeline.threshold import Threshold
from fame.monitor.pipeline.train import Training, fit, train
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.pipeline.training_settings import training_of
from fame.version import current as fame_version

JOINTS = ("shoulder", "elbow", "wrist")
QUICK = Training(
    detector="autoencoder", window=20, hidden=(8, 3, 8), stride=3, before=30.0, cutoff=10.0, epochs=15, samples=1500
)


def motion(seed: int, *, push: float = 0.0, n: int = 800, rate: float = 200.0) -> Samples:
    """The efforts of a repetitive task; somebody may push against the wrist in the middle of it."""
    random = np.random.default_rng(seed)
    stamps = np.arange(n) / rate
    phase = 2 * np.pi * stamps[:, None] * [0.5, 1.0, 1.5] + random.normal(0, 0.05, 3)
    values = np.sin(phase) * [3.0, 2.0, 1.0] + random.normal(0, 0.05, (n, 3))
    values[n // 2 : n // 2 + 60, 2] += push
    return Samples(values, stamps, JOINTS)


@pytest.fixture(scope="module")
def model() -> TrainedModel:
    return fit([motion(seed) for seed in range(6)], QUICK, data="cafe" * 16)


def monitor(model: TrainedModel, run_: Samples) -> dict[str, Samples]:
    chain = [LowPass(cutoff=model.before), Autoencoder(model, stride=3), LowPass(cutoff=model.cutoff)]
    return run([*chain, Threshold(threshold=list(model.thresholds))], {"efforts": run_})


def test_an_undisturbed_run_raises_no_alarm_and_a_disturbed_one_names_the_joint(model: TrainedModel) -> None:
    assert "alarm" not in monitor(model, motion(50))
    found = monitor(model, motion(51, push=1.5))
    assert found["name"].values[0].tolist() == ["wrist"]
    assert 2.0 < found["alarm"].stamps[0] < 2.4


def test_without_a_promise_thresholds_are_at_least_the_largest_loss_of_left_out_runs_times_the_margin(
    model: TrainedModel,
) -> None:
    assert model.calibration is not None
    assert (model.calibration.promised, model.calibration.margin) == (None, MARGIN)
    factors = np.array(model.thresholds) / np.array(model.metrics["validation_max"])
    assert factors.min() == pytest.approx(MARGIN)  # of the channel with the most unusual loss
    assert set(model.metrics) == {"training_max", "training_mean", "validation_max", "validation_mean"}
    assert model.rate == pytest.approx(200.0)
    assert model.network.layers == (20, 8, 3, 8, 20)


@pytest.mark.long
def test_training_twice_gives_the_same_model(model: TrainedModel) -> None:
    again = fit([motion(seed) for seed in range(6)], QUICK)
    assert again.thresholds == model.thresholds


@pytest.mark.parametrize("activation", ["relu", "tanh", "logistic", "identity"])
def test_inference_is_that_of_scikit_learn(activation: str) -> None:
    from sklearn.neural_network import MLPRegressor

    random = np.random.default_rng(1)
    estimators = []
    for seed in range(3):
        data = random.normal(size=(60, 20))
        estimator = MLPRegressor(
            hidden_layer_sizes=(8, 3, 8), activation=activation, solver="lbfgs", max_iter=5, random_state=seed
        )
        with pytest.warns(UserWarning, match="max_iter|converge|ITERATIONS"):
            estimators.append(estimator.fit(data, data))
    inputs = random.normal(size=(3, 40, 20))
    expected = np.stack([item.predict(part) for item, part in zip(estimators, inputs, strict=True)])
    np.testing.assert_allclose(ChannelAutoencoders.of(estimators)(inputs), expected, rtol=1e-5, atol=1e-8)


def test_the_loss_is_the_mean_squared_error_over_the_window(model: TrainedModel) -> None:
    windows = np.random.default_rng(2).normal(size=(7, 20, 3))
    scaled = (windows - model.mean) / model.scale
    told = np.stack([model.network(scaled[None, number].transpose(2, 0, 1)) for number in range(7)])[:, :, 0]
    expected = ((told - scaled.transpose(0, 2, 1)) ** 2).mean(axis=2)
    np.testing.assert_allclose(model.loss(windows), expected)


# ---- stored ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".skops", ".onnx"])
def test_a_model_comes_back_as_it_was(model: TrainedModel, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"model{ending}"
    model.save(path)
    again = TrainedModel.load(path)
    windows = np.random.default_rng(2).normal(size=(7, 20, 3))
    np.testing.assert_array_equal(again.loss(windows), model.loss(windows))
    for name in ("columns", "window", "rate", "thresholds", "cutoff", "before", "data", "versions", "metrics"):
        assert getattr(again, name) == getattr(model, name), name
    assert again.versions.keys() >= {"scikit-learn", "numpy", "skops"}


def refusal(path: Path, **asked: object) -> str:
    with pytest.raises(ConfigError) as caught:
        TrainedModel.load(path, **asked)
    return str(caught.value)


def test_a_model_of_other_columns_or_older_data_is_refused_with_the_reason(model: TrainedModel, tmp_path: Path) -> None:
    model.save(tmp_path / "m.skops")
    assert "expected a, b: train again" in refusal(tmp_path / "m.skops", columns=("a", "b"))
    assert "is stale: trained on data cafecafecafe" in refusal(tmp_path / "m.skops", data="beef" * 16)
    assert TrainedModel.load(tmp_path / "m.skops", columns=JOINTS, data="cafe" * 16).columns == JOINTS


def test_foreign_and_damaged_files_are_refused_with_the_reason(model: TrainedModel, tmp_path: Path) -> None:
    import pickle

    import skops.io
    from sklearn.decomposition import PCA

    (tmp_path / "pickle.skops").write_bytes(pickle.dumps({"format": "fame-autoencoder-1"}))
    assert "is corrupt, or no model of fame monitor train" in refusal(tmp_path / "pickle.skops")
    with ZipFile(tmp_path / "half.skops", "w") as archive:
        archive.writestr("schema.json", "{")
    assert "is corrupt" in refusal(tmp_path / "half.skops")
    skops.io.dump(PCA(), tmp_path / "pca.skops")
    assert "is not a model of fame monitor train: expected format" in refusal(tmp_path / "pca.skops")
    skops.io.dump({"format": "fame-autoencoder-1", "run": print}, tmp_path / "code.skops")
    assert "contains code or unknown classes" in refusal(tmp_path / "code.skops")
    assert "there is no such file" in refusal(tmp_path / "none.skops")
    assert "expected a file of" in refusal(tmp_path)
    replace(model, thresholds=(1.0,)).save(tmp_path / "torn.skops")
    assert "is damaged" in refusal(tmp_path / "torn.skops")
    (tmp_path / "text.onnx").write_text("hello")
    assert "is not a valid ONNX file" in refusal(tmp_path / "text.onnx")


# ---- data that do not fit --------------------------------------------------------------------------------------------


def test_channels_are_matched_by_name_and_others_refused(model: TrainedModel) -> None:
    given = motion(3)
    straight = run([Autoencoder(model)], {"efforts": given})["loss"]
    turned = Samples(given.values[:, ::-1], given.stamps, JOINTS[::-1])
    np.testing.assert_allclose(run([Autoencoder(model)], {"efforts": turned})["loss"].values, straight.values)
    apart = {name: Samples(given.values[:, k], given.stamps) for k, name in enumerate(JOINTS)}
    np.testing.assert_allclose(run([Autoencoder(model)], apart)["loss"].values, straight.values)
    foreign = Samples(given.values, given.stamps, ("a", "b", "c"))
    with pytest.raises(ValueError, match="trained on shoulder, elbow, wrist; the data are a, b, c"):
        run([Autoencoder(model)], {"efforts": foreign})
    with pytest.raises(ValueError, match="trained on shoulder, elbow, wrist; the data are 2 channels"):
        run([Autoencoder(model)], {"efforts": Samples(given.values[:, :2], given.stamps)})


def test_a_rate_twice_that_of_the_training_gives_no_loss_and_says_so(model: TrainedModel) -> None:
    said: list[str] = []
    autoencoder = Autoencoder(model)
    autoencoder.report = said.append
    assert run([autoencoder], {"efforts": motion(3, rate=400.0)}) == {}
    assert said == ["windows left out: expected samples at 200 Hz without a gap, got 400 Hz"]


# ---- files -----------------------------------------------------------------------------------------------------------


def test_training_from_files_hashes_them_and_takes_runs_as_they_are(tmp_path: Path) -> None:
    write_runs(tmp_path / "a.csv", [motion(0), motion(1)])
    write_runs(tmp_path / "b.csv", [motion(2)])
    config = replace(QUICK, files=(str(tmp_path / "a.csv"), str(tmp_path / "b.csv")), columns=("elbow",), epochs=2)
    assert [len(item) for item in read_runs(config.files)] == [800, 800, 800]
    made = train(config)
    assert (made.columns, made.data) == (("elbow",), hash_files(config.files))


def test_rows_without_a_value_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("stamp,x,y\n0.1,1,\n0.2,,2\n0.3,3,4\n")
    assert [len(item) for item in read_runs([tmp_path / "a.csv"])] == [1]
    assert read_runs([tmp_path / "a.csv"], ["x"])[0].values.tolist() == [[1.0], [3.0]]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("stamp,x\n0.1,1\n0.2,two\n", "a.csv:3: expected a number in column 'x', got 'two'"),
        ("stamp,x\n0.1,1\n0.2\n", "a.csv:3: expected 2 cells, got 1"),
        ("0.1,1\n", "a.csv:1: has no header"),
        ("stamp,x\n", "a.csv: has no rows"),
        ("stamp,run,x", "a.csv: has no rows"),
        ("time,x\n1,2\n", "a.csv:1: has no column 'stamp'; it has time, x"),
        ("", "a.csv: is empty"),
    ],
)
def test_a_file_that_is_no_table_is_refused_with_its_line(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_runs([tmp_path / "a.csv"])
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("section", "reason"),
    [
        ({"Files": ["no*.csv"]}, "no file matches"),
        ({"Files": [], "Windw": 3}, "Training.Windw: unknown key; did you mean 'window'?"),
        ({"Window": "fifty"}, "Training.Window: expected a whole number of at least 2, got 'fifty'"),
        ({"Hidden": [16, "4"]}, "Training.Hidden[1]: expected a whole number of at least 1, got '4'"),
        ("runs.csv", "Training: expected a mapping"),
    ],
)
def test_a_wrong_training_section_is_refused(tmp_path: Path, section: object, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        training_of(ConfigValue(section, "Training"), tmp_path)
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("factor", "text"), [(1e-200, "no channel ever moves"), (1e120, r"got the value .*e\+120: at most 1e\+100")]
)
def test_values_whose_squares_are_no_numbers_do_not_train(factor: float, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        fit([run.replace(run.values * factor) for run in map(motion, range(3))], QUICK)


def test_one_run_is_not_enough_to_train_and_validate() -> None:
    with pytest.raises(ConfigError, match="at least 2 are needed"):
        fit([motion(0)], QUICK)


@pytest.mark.parametrize(
    "wrong", [{"seed": -1}, {"seed": 2**32}, {"before": np.inf}, {"cutoff": np.nan}, {"margin": np.inf}]
)
def test_settings_out_of_range_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"Training.{next(iter(wrong))}: expected"):
        fit([motion(0), motion(1)], replace(QUICK, **wrong))


def test_of_two_runs_one_trains_however_much_is_held_back() -> None:
    assert fit([motion(0), motion(1)], replace(QUICK, held_back=0.9, epochs=1)).metrics["training_max"]


def files(pattern: str) -> ConfigValue:
    return ConfigValue({"Files": [pattern]}, "Training")


def test_the_files_of_a_training_may_be_a_pattern_anywhere(tmp_path: Path) -> None:
    (tmp_path / "[1]").mkdir()
    file = write_runs(tmp_path / "[1]" / "runs.csv", [motion(0)])
    assert training_of(files(str(tmp_path / "[[]1]" / "*.csv")), Path("elsewhere")).files == (str(file),)
    assert training_of(files("*.csv"), tmp_path / "[1]").files == (str(file),)
    with pytest.raises(ConfigError, match="no file matches"):
        training_of(files("a**b"), tmp_path)


@pytest.mark.parametrize("change", [{"window": float("inf")}, {"rate": float("nan")}, {"rate": 0.0}, {"cutoff": -1.0}])
def test_a_stored_model_whose_figures_cannot_be_is_damaged(
    model: TrainedModel, change: dict[str, float], tmp_path: Path
) -> None:
    from fame.monitor.storage import read_artefact, write_artefact

    model.save(tmp_path / "model.skops")
    content = read_artefact(tmp_path / "model.skops", "fame monitor train")
    write_artefact(content | change, tmp_path / "model.skops")
    with pytest.raises(ConfigError, match="is damaged"):
        TrainedModel.load(tmp_path / "model.skops")


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("\ufeffstamp,run,a\r\n0,0,1\r\n1,0,2\r\n", [[1], [2]]),
        ('"stamp","run","a"\n0,0,"1"\n1,0,2\n\n\n', [[1], [2]]),
        ("stamp,run,a\n,0,1\n1,0,2\ninf,0,3\n2,0,4\n", [[2], [4]]),
        ("stamp,run,a\n0,,1\n1,,2\n", [[1], [2]]),
    ],
)
def test_tables_of_other_programs_are_read_as_they_are_meant(
    text: str, values: list[list[int]], tmp_path: Path
) -> None:
    (tmp_path / "runs.csv").write_bytes(text.encode())
    (found,) = read_runs([tmp_path / "runs.csv"])
    assert (found.values.tolist(), found.names) == (values, ("a",))


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("stamp;a;b\n0,0;1,5;2\n0,5;;2,1\n1,0;1,6;2,1\n", 0),
        ("stamp\ta\tb\n0.0\t1.5\t2\n1.0\t1.6\t2.1\n", 0),
        ("stamp;a;b\n31.01.2026 12:00:00,0;1,5;2\n31.01.2026 12:00:01,0;1,6;2,1\n", 1769860800),
        ("stamp,a,b\n2026-01-31T12:00:00Z,1.5,2\n2026-01-31 12:00:01.0,1.6,2.1\n", 1769860800),
        ('"stamp";"a";"b"\n"0";"1,5";"2"\n"1";"1,6";"2,1"\n', 0),
        ("stamp,a,b\n0,1.5,2\n0.5,NaN,2\n1,1.6,2.1\n", 0),
        ("stamp;a;b;\n0;1.5;2;\n1;1.6;2.1;\n", 0),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_separators_decimal_commas_dates_and_encodings_are_found(
    text: str, start: float, encoding: str, tmp_path: Path
) -> None:
    (tmp_path / "runs.csv").write_bytes(text.encode(encoding))
    (found,) = read_runs([tmp_path / "runs.csv"])
    assert (found.values.tolist(), found.names) == ([[1.5, 2.0], [1.6, 2.1]], ("a", "b"))
    assert found.stamps.tolist() == [start, start + 1]


def test_a_table_in_another_encoding_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_bytes("stamp,a\n0,1°\n".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"runs\.csv:2: is not UTF-8 text"):
        read_runs([tmp_path / "runs.csv"])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("stamp,a,a\n0,1,2\n", "several columns 'a'"),
        ("stamp,a\n0,1#2\n", ":2: expected a number in column 'a', got '1#2'"),
        ("stamp\n0\n", "no columns but stamp"),
        ("stamp,a\n\n\n", "no rows"),
        ("stamp," + "a" * 200_000 + "\n0,1\n", ":1: is not a row of a table"),
        ("stamp,a\n01/31/2026 12:00:00,1\n", ":2: expected a number .s. or a date such as .* in column 'stamp'"),
        ("stamp,a\n46053.5,1\n46053.50001157,2\n", ":2: expected s in column 'stamp', got 46053.5.* spreadsheet"),
        ("stamp,a\n1760000000000000000,1\n", ":2: expected s in column 'stamp', got 1.76e.18, as ms, us or ns"),
        ("Time [s],a [Nm]\n0,1\n", ":1: has no column 'stamp'; it has Time .s., a .Nm."),
        ("stamp,a\ns,Nm\n0,1\n", ":2: expected a number .* in column 'stamp', got 's'"),
        ("\nstamp,a\n0,1\n", ":1: is a blank line"),
        ("stamp,a\n0,1\n\n1,2\n", ":3: expected 2 cells, got a blank line$"),
        ('stamp,a\n0,"1,500.5"\n', ":2: expected a number in column 'a', got '1,500.5'"),
        ("stamp;a\n0,0;1.500\n", ":2: expected a number in column 'a' without a point, .* got '1.500'"),
        ("stamp;a\n0,0;1 500,5\n", ":2: expected a number in column 'a', got '1 500,5'"),
        ("stamp,a\n0,N/A\n", ":2: expected a number in column 'a', got 'N/A'"),
        ("Zeit;a\n26.11.2026 11:00:00;1,5\n", r"a date only in .* \(--time-column 'Zeit'\), got '26"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused_with_its_line(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(ConfigError, match=why):
        read_runs([tmp_path / "runs.csv"])


@pytest.mark.long
def test_a_run_that_is_unlike_the_others_is_refused_unless_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that stood still in one of the runs."""
    import yaml

    from fame.cli import main

    random = np.random.default_rng(3)
    lines = ["stamp,run,a,b"]
    for number in range(4):
        for n in range(400):
            wave = 0.0 if number == 2 else np.sin(n / 7)
            a, b = np.array([5 * wave, 2 * wave]) + random.normal(0, 1e-3, 2)
            lines.append(f"{n / 100 + number * 10},{number},{a},{b + (100 if number == 2 else 0)}")
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    section = {"Files": ["runs.csv"], "Detector": "pca", "Window": 20}
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({"Training": section}))
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 2
    error = capsys.readouterr().err
    assert "run 2: its left-out loss of" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "model.skops").exists()
    assert "their median" in (tmp_path / "model.refused.html").read_text()
    for _ in range(2):
        assert main(["monitor", "train", str(tmp_path / "c.yaml"), "--keep"]) == 0
    assert "warning: run 2: its left-out loss" in capsys.readouterr().err
    card = json.loads((tmp_path / "model.card.json").read_text())
    made, data = card["Model"]["made on"], card["Data"]["sha256"]
    assert card["Model"]["predecessor"].startswith(f"of {made[:11]}")
    assert card["Model"]["predecessor"].endswith(f"trained on data {data[:12]}")
    assert card["Versions"]["FAME"] == fame_version()


def test_a_detector_that_knows_its_own_runs_only_is_refused_unless_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Noise, of which there is less than the detector has numbers to fit: no run is unlike the others."""
    from fame.cli import main

    random = np.random.default_rng(5)
    lines = ["stamp,run,a,b,c"]
    lines += [
        ",".join(map(repr, [n / 100 + number * 10, number, *random.normal(0, 1, 3).tolist()]))
        for number in range(6)
        for n in range(60)
    ]
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    words = ["monitor", "train", "--data", str(tmp_path / "runs.csv"), "-o", str(tmp_path / "model.skops")]
    words += ["--detector", "mahalanobis"]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "of 6 runs the left-out loss is" in error
    assert "the detector has learned its own runs by heart: record more or longer runs" in error
    assert "leave them out" not in error
    assert main([*words, "--keep"]) == 0
    assert "the detector has learned its own runs by heart" in capsys.readouterr().err


def trained(tmp_path: Path, runs: list[tuple[float, float]]) -> str:
    """What ``fame monitor train`` says of runs, each of a noise and a length (s)."""
    import contextlib
    import io

    import yaml

    from fame.cli import main

    random = np.random.default_rng(5)
    lines = ["stamp,run,a,b"]
    for number, (noise, seconds) in enumerate(runs):
        for n in range(round(100 * seconds)):
            a, b = np.array([5, 2]) * np.sin(n / 7) + random.normal(0, noise, 2)
            lines.append(f"{n / 100 + number * 100},{number},{a},{b}")
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    section = {"Files": ["runs.csv"], "Detector": "pca", "Window": 20}
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({"Training": section}))
    with contextlib.redirect_stderr(io.StringIO()) as said:
        assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 0
    return said.getvalue()


@pytest.mark.parametrize("order", [1, -1])
def test_losses_that_grow_or_fall_from_run_to_run_are_told(tmp_path: Path, order: int) -> None:
    growing = [(0.05 * 1.2**n, 4.0) for n in range(8)][::order]
    assert "warning: losses grow or fall from run to run" in trained(tmp_path, growing)
    mixed = [growing[n] for n in (3, 6, 0, 5, 2, 7, 1, 4)]
    assert "losses grow or fall" not in trained(tmp_path, mixed)


def test_runs_of_unlike_lengths_are_told(tmp_path: Path) -> None:
    assert "warning: runs last from 3.99 to 5.99 s" in trained(tmp_path, [(0.05, 4.0), (0.05, 6.0), (0.05, 4.0)])
    assert "runs last" not in trained(tmp_path, [(0.05, 4.0), (0.05, 4.4), (0.05, 4.0)])
