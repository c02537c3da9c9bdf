"""Processors: what each computes, and that it does not depend on how samples are cut into calls."""

from typing import Any

import numpy as np
import pytest

from fame.errors import ConfigError
from fame.monitor.pipeline.estimators import Estimator
from fame.monitor.pipeline.filters import RMS, LowPass, MovingStatistics, Resample, Scale, Spectrum, Window
from fame.monitor.pipeline.formula import Expression
from fame.monitor.pipeline.processor import Parameter, Samples, set_value
from fame.monitor.pipeline.processors import run
from fame.monitor.pipeline.threshold import Threshold


def wave(n: int = 400, rate: float = 500.0, channels: int = 3, seed: int = 0) -> Samples:
    """Noisy sines, one per channel."""
    stamps = np.arange(n) / rate
    phases = np.arange(1, channels + 1)
    noise = 0.1 * np.random.default_rng(seed).standard_normal((n, channels))
    return Samples(np.sin(2 * np.pi * stamps[:, None] * phases) + noise, stamps, tuple(f"j{k}" for k in phases))


CHAINS = {
    "low-pass": lambda: [LowPass(cutoff=20.0)],
    "low-pass of a known rate": lambda: [LowPass(cutoff=20.0, rate=500.0)],
    "resample": lambda: [Resample(rate=130.0)],
    "scale": lambda: [Scale(offset=[1.0, 2.0, 3.0], factor=2)],
    "window": lambda: [Window(size=20, stride=7)],
    "rms": lambda: [RMS(size=20, stride=3, rate=500.0)],
    "median": lambda: [MovingStatistics(size=15, statistic="median")],
    "spectrum": lambda: [Spectrum(size=64, stride=16)],
    "expression": lambda: [Expression(formula="abs(efforts[:, 0] - efforts[:, 1]) > 0.5")],
    "threshold": lambda: [Threshold(threshold=[0.9, 0.95, 1.0], hysteresis=0.5)],
    "three in a row": lambda: [LowPass(cutoff=20.0), RMS(size=10, stride=5), Threshold(threshold=0.6)],
}


@pytest.mark.parametrize("frequency", [1000.0, 130.0, 9.0])
@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_calls_at_any_frequency_give_what_one_call_gives(chain, frequency: float) -> None:
    whole, parts = run(chain(), {"efforts": wave()}), run(chain(), {"efforts": wave()}, frequency)
    assert whole.keys() == parts.keys() != set()
    for name, samples in whole.items():
        np.testing.assert_allclose(parts[name].stamps, samples.stamps)
        if samples.values.dtype == object:
            assert (parts[name].values == samples.values).all()
        else:
            np.testing.assert_allclose(parts[name].values, samples.values, atol=1e-12)


def test_the_low_pass_is_the_one_pole_filter_of_its_formula() -> None:
    x = wave(50).values
    a = 1 - np.exp(-2 * np.pi * 20.0 / 500.0)
    y = [x[0]]
    for value in x[1:]:
        y.append(y[-1] + a * (value - y[-1]))
    out = run([LowPass(cutoff=20.0)], {"x": wave(50)})["x"]
    np.testing.assert_allclose(out.values, y, atol=1e-9)
    assert out.names == ("j1", "j2", "j3")


def test_the_low_pass_halves_the_power_at_its_cutoff() -> None:
    stamps = np.arange(20_000) / 5000.0
    sine = Samples(np.sin(2 * np.pi * 10 * stamps), stamps)
    out = run([LowPass(cutoff=10.0)], {"x": sine})["x"].values[10_000:]
    assert np.sqrt(2 * np.mean(out**2)) == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_without_a_rate_the_low_pass_is_right_for_samples_that_come_twice_as_often() -> None:
    slow, fast = wave(250, 500.0), wave(500, 1000.0)
    ramp = [Samples(item.stamps * 3.0, item.stamps) for item in (slow, fast)]
    one, two = (run([LowPass(cutoff=5.0)], {"x": item})["x"] for item in ramp)
    assert one.values[-1] == pytest.approx(two.values[-2], abs=0.005)


def test_resampling_interpolates_on_multiples_of_the_period_and_not_across_a_gap() -> None:
    stamps = np.array([0.0, 0.033, 0.066, 0.5, 0.533])
    out = run([Resample(rate=100.0, gap=0.1)], {"x": Samples(2 * stamps, stamps)})["x"]
    np.testing.assert_allclose(out.stamps, [0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.5, 0.51, 0.52, 0.53])
    np.testing.assert_allclose(out.values, 2 * out.stamps)


def test_a_sine_has_its_amplitude_at_its_frequency() -> None:
    stamps = np.arange(200) / 200.0
    out = run([Spectrum(size=100, stride=100)], {"x": Samples(3 * np.sin(2 * np.pi * 20 * stamps), stamps)})["x"]
    assert out.values.shape == (2, 51)
    assert out.values[1, 10] == pytest.approx(3.0)
    assert out.values[1, 15:].max() < 1e-9


@pytest.mark.parametrize(
    ("statistic", "expected"),
    [("mean", 2.0), ("deviation", 1.0), ("minimum", 1.0), ("maximum", 3.0), ("median", 2.0), ("range", 2.0)],
)
def test_moving_statistics(statistic: str, expected: float) -> None:
    values = np.array([1.0, 3.0] * 5)
    out = run([MovingStatistics(size=4, stride=2, statistic=statistic)], {"x": Samples(values, np.arange(10.0))})["x"]
    np.testing.assert_allclose(out.values, expected)


def test_windows_across_a_gap_and_of_another_rate_are_left_out_and_reported() -> None:
    said: list[str] = []
    rms = RMS(size=10, stride=1, rate=100.0)
    rms.report = said.append
    stamps = np.concatenate((np.arange(30) / 100, 5 + np.arange(30) / 100, 9 + np.arange(30) / 200))
    out = run([rms], {"x": Samples(np.ones(90), stamps)})["x"]
    assert len(out) == 2 * 21
    assert said == ["windows left out: expected samples at 100 Hz without a gap, got 200 Hz"]


def losses(*rows: list[float]) -> Samples:
    return Samples(np.array(rows), np.arange(float(len(rows))), ("shoulder", "wrist"))


def test_an_alarm_comes_once_and_again_only_after_all_channels_have_come_well_below() -> None:
    seen = losses([0.1, 0.1], [0.1, 2.1], [0.1, 3.0], [0.1, 1.9], [0.1, 2.2], [0.1, 1.0], [0.95, 0.1], [1.2, 2.2])
    out = run([Threshold(threshold=[1.0, 2.0], hysteresis=0.1)], {"loss": seen})
    assert out["alarm"].stamps.tolist() == [1.0, 7.0]
    assert out["name"].values.tolist() == [["wrist"], ["shoulder"]]
    assert out["loss"].values.tolist() == [2.1, 1.2]
    assert out["active"].values.tolist() == [False, True, True, True, True, False, False, True]


def test_one_threshold_holds_for_all_channels() -> None:
    assert run([Threshold(threshold=3)], {"loss": losses([2.9, 0], [3.1, 0])})["alarm"].stamps.tolist() == [1.0]


def test_thresholds_of_another_number_of_channels_are_refused() -> None:
    with pytest.raises(ValueError, match="threshold has 3 numbers, the data 2 channels"):
        run([Threshold(threshold=[1, 2, 3])], {"loss": losses([0, 0])})


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("left - right * 2", [-1.0, -3.0]),
        ("0 < left < 2 and not right > 1", [True, False]),
        ("clip(left + right, 0, 2.5)", [2.0, 2.5]),
        ("max(efforts) - norm(efforts)", [4 - 5, 8 - 10]),
        ("efforts[:, 1] % 3", [1.0, 2.0]),
        ("pi", [np.pi, np.pi]),
        ("holes > 0", [np.nan, True]),
        ("holes != 2 and left > 0", [np.nan, False]),
        ("not holes < 1", [np.nan, True]),
        ("where(holes > 0, left, 5)", [np.nan, 1.0]),
        ("(left > 0) + (right > 1)", [1.0, 2.0]),
        ("(left > 0) - (right > 1)", [1.0, 0.0]),
        ("-(left > 0)", [-1.0, -1.0]),
        ("sqrt(left > 0) / 3", [1 / 3, 1 / 3]),
        ("e + pi", [7.0 + np.pi, 8.0 + np.pi]),
        ("efforts - mean(efforts)", [[-0.5, 0.5], [-1.0, 1.0]]),
        ("efforts > right * 3.5", [[False, True], [False, True]]),
        ("right < efforts < right * 3.5", [[True, False], [True, False]]),
        ("bytes - right * 2 - bytes", [-2.0, -4.0]),
        ("bytes // (right - 1)", [np.inf, 200.0]),
        ("bytes - 201 + bytes * bytes", [39999.0, 39999.0]),
    ],
)
def test_expressions(formula: str, expected: list[float]) -> None:
    stamps = np.array([0.0, 1.0])
    given = {
        "left": Samples(np.array([1.0, 1.0]), stamps),
        "right": Samples(np.array([1.0, 2.0]), stamps),
        "holes": Samples(np.array([np.nan, 2.0]), stamps),
        "efforts": Samples(np.array([[3.0, 4.0], [6.0, 8.0]]), stamps),
        "e": Samples(np.array([7.0, 8.0]), stamps),
        "bytes": Samples(np.array([200, 200], dtype=np.uint8), stamps),
    }
    np.testing.assert_allclose(run([Expression(formula=formula)], given)["value"].values, expected)


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        ("__import__('os')", "unknown function __import__"),
        ("left.values", "is not allowed"),
        ("(lambda: 1)()", "is not allowed"),
        ("left[open]", "expected a formula"),
        ("efforts[1]", r"index of channels, as in \[:, 3\], got \[1\]: the first is the sample"),
        ("efforts - efforts[:1]", "the first is the sample"),
        ("efforts[()]", "the first is the sample"),
        ("left +", "expected a formula"),
        ("", "needs a formula"),
    ],
)
def test_an_expression_computes_and_does_nothing_else(formula: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        Expression(formula=formula)


def test_a_formula_cannot_compute_for_ever() -> None:
    with pytest.raises(OverflowError):
        run([Expression(formula="x + 9 ** 9 ** 9 ** 9")], {"x": Samples(np.ones(1), np.zeros(1))})


def test_inputs_of_other_stamps_are_not_put_side_by_side() -> None:
    given = {"a": Samples(np.ones(2), np.array([0.0, 1.0])), "b": Samples(np.ones(2), np.array([0.0, 1.1]))}
    with pytest.raises(ValueError, match="b has not the stamps of a"):
        run([Expression(formula="a + b")], given)


def test_an_estimator_of_scikit_learn_judges_samples_and_windows(tmp_path) -> None:
    import skops.io
    from sklearn.decomposition import PCA
    from sklearn.linear_model import LinearRegression

    data = wave(100)
    slope = LinearRegression().fit(data.values, data.values @ [1.0, 2.0, 3.0])
    skops.io.dump(slope, tmp_path / "slope.skops")
    out = run([Estimator(model=str(tmp_path / "slope.skops"))], {"x": data})["value"]
    np.testing.assert_allclose(out.values, data.values @ [1.0, 2.0, 3.0])
    skops.io.dump(PCA(2).fit(np.random.default_rng(0).random((50, 30))), tmp_path / "pca.skops")
    windows = Estimator(model=str(tmp_path / "pca.skops"), method="transform", window=10, stride=10)
    assert run([windows], {"x": data})["value"].values.shape == (10, 2)
    with pytest.raises(ValueError, match="trained on 30 features; the data are 6"):
        run([Estimator(model=str(tmp_path / "pca.skops"), method="transform", window=2)], {"x": data})
    with pytest.raises(ConfigError, match="expected a method of LinearRegression \\(predict\\)"):
        Estimator(model=str(tmp_path / "slope.skops"), method="transform")


@pytest.mark.parametrize(
    ("parameter", "value", "kept"),
    [
        (Parameter("x", "float", 0.0), 3, 3.0),
        (Parameter("x", "floats", ()), 3, (3.0,)),
        (Parameter("x", "floats", ()), [1, 2.5], (1.0, 2.5)),
        (Parameter("x", "strs", ()), ["a"], ("a",)),
        (Parameter("x", "bool", False), True, True),
        (Parameter("x", "int", 1, (1, None)), 7, 7),
    ],
)
def test_a_parameter_takes_what_says_the_same(parameter: Parameter, value: object, kept: object) -> None:
    assert parameter.convert(value) == kept


@pytest.mark.parametrize(
    ("parameter", "value", "right"),
    [
        (Parameter("cutoff", "float", 1.0, (0, 5), "Hz"), 6, "a number from 0 to 5 Hz"),
        (Parameter("cutoff", "float", 1.0, (0, None), "Hz"), float("nan"), "a number of 0 or more Hz"),
        (Parameter("size", "int", 1), True, "a whole number"),
        (Parameter("size", "int", 1), 2.5, "a whole number"),
        (Parameter("on", "bool", False), 1, "true or false"),
        (Parameter("which", "str", "a", ("a", "b")), "c", "a text: a, b"),
        (Parameter("all", "floats", ()), [1.0, "2"], "a number"),
    ],
)
def test_a_parameter_refuses_what_does_not_fit(parameter: Parameter, value: object, right: str) -> None:
    with pytest.raises(ConfigError, match=right):
        parameter.convert(value)


def test_parameters_change_while_it_runs() -> None:
    low_pass = LowPass(cutoff=1.0)
    data = wave(100)
    before = low_pass.execute({"x": data})["x"].values[-1]
    assert set_value(low_pass, "cutoff", 249) == 249.0
    later = Samples(data.values, data.stamps + 0.2)
    assert not np.allclose(low_pass.execute({"x": later})["x"].values[-1], before, atol=0.1)
    with pytest.raises(ConfigError, match="LowPass has no such parameter; it has cutoff, rate"):
        set_value(low_pass, "cutof", 1.0)


def test_numbers_beyond_every_float_are_refused_as_any_other_that_does_not_fit() -> None:
    for make in (lambda: LowPass(cutoff=10**400), lambda: Window(stride=10**30), lambda: Scale(factor=[])):
        with pytest.raises(ConfigError, match="expected"):
            make()


@pytest.mark.parametrize(
    "formula", ["x + " + "9" * 400, "-" * 20_000 + "1", "abs()", "abs(x, x)", "max(x, 1)", "where(x)"]
)
def test_what_is_no_formula_is_refused_before_anything_runs(formula: str) -> None:
    with pytest.raises(ConfigError, match="expected a formula"):
        Expression(formula=formula)


def test_the_channels_of_an_estimator_are_matched_by_name_and_its_result_has_a_value_for_each_sample() -> None:
    import pandas
    from sklearn.linear_model import LinearRegression
    from sklearn.multioutput import MultiOutputClassifier
    from sklearn.preprocessing import OneHotEncoder
    from sklearn.tree import DecisionTreeClassifier

    table = pandas.DataFrame({"a": [0.0, 1.0, 0.0], "b": [0.0, 0.0, 1.0]})
    line = Estimator(LinearRegression().fit(table, [0.0, 10.0, 1.0]))
    said: list[str] = []
    line.report = said.append

    def value(estimator: Estimator, *names: str) -> Any:
        return run([estimator], {"x": Samples(np.array([[1.0, 0.0]]), np.zeros(1), names)})["value"].values

    assert value(line, "a", "b") == pytest.approx(10)
    assert value(line, "b", "a") == pytest.approx(1)
    assert not said
    assert value(line, "c", "d") == pytest.approx(10)
    assert said == ["the features are a, b, the channels have other names: taken in order"]
    sparse = Estimator(OneHotEncoder().fit(table.values), method="transform")
    assert value(sparse).tolist() == [[0, 1, 1, 0]]
    two = MultiOutputClassifier(DecisionTreeClassifier()).fit(table.values, [[0, 1], [1, 0], [1, 1]])
    with pytest.raises(ValueError, match=r"expected a value for each of 1 samples, got an array of shape \(2, 1, 2\)"):
        value(Estimator(two, method="predict_proba"))


def test_what_an_estimator_or_a_formula_cannot_do_is_refused_while_they_run_and_nothing_changes() -> None:
    from sklearn.linear_model import LinearRegression

    x = {"x": Samples(np.arange(3.0), np.arange(3.0))}
    line = Estimator(LinearRegression().fit([[0.0], [1.0]], [0.0, 2.0]))
    twice = Expression(formula="x * 2")
    for processor, name, value in (
        (line, "method", "predict_proba"),
        (twice, "formula", "abs("),
        (twice, "formula", ""),
    ):
        with pytest.raises(ConfigError):
            set_value(processor, name, value)
        np.testing.assert_allclose(processor.execute(x)["value"].values, [0, 2, 4], atol=1e-9)


def test_and_or_and_chains_of_comparisons_take_numbers_beside_arrays() -> None:
    x = {"x": Samples(np.array([[1.0, 2.0], [3.0, 4.0]]), np.arange(2.0)), "y": Samples(np.ones(2), np.arange(2.0))}
    for formula, right in (
        ("x[:, 0] > 1 and True", [False, True]),
        ("False or x[:, 1] > 3", [False, True]),
        ("0 < 1 < x[:, 0]", [False, True]),
    ):
        np.testing.assert_array_equal(Expression(formula=formula).execute(x)["value"].values, right)


def test_a_threshold_of_zero_or_less_of_which_no_part_is_below_is_refused() -> None:
    for wrong in ([0.0], [-5.0], [1.0, 0.0]):
        with pytest.raises(ConfigError, match="or more, got"):
            Threshold(threshold=wrong)
    alarms = Threshold(threshold=[1.0])
    with pytest.raises(ConfigError, match="empty"):
        set_value(alarms, "threshold", [])
    assert alarms.threshold == (1.0,)


def test_a_loss_that_is_no_number_is_not_judged_and_hides_no_other_channel() -> None:
    alarms, reports = Threshold(threshold=[1.0, 1.0], names=["elbow", "wrist"]), list[str]()
    alarms.report = reports.append
    nan = np.nan
    loss = np.array([[0.5, 0.5], [nan, 0.5], [0.5, 0.5], [nan, 3.0], [nan, 0.5], [nan, nan], [0.5, 0.5], [nan, 0.5]])
    found = alarms.execute({"Loss": Samples(loss, np.arange(8.0))})
    assert dict(zip(found["active"].stamps, found["active"].values, strict=True)) == {
        0: False,
        2: False,
        3: True,
        6: False,
    }
    assert found["name"].values.tolist() == [["wrist"]]
    assert set(reports) == {"elbow is no number: not judged", "wrist is no number: not judged"}
    assert len(alarms.execute({"Loss": Samples(loss[1:2], np.array([9.0]))})["active"]) == 0


def test_thresholds_go_with_the_names_of_channels_in_whichever_order_these_come() -> None:
    alarms = Threshold(threshold=[1.0, 10.0], names=["elbow", "wrist"])
    loss = Samples(np.array([[5.0, 0.5], [5.0, 2.0]]), np.arange(2.0), ("Loss.wrist", "Loss.elbow"))
    found = alarms.execute({"Loss": loss})
    np.testing.assert_array_equal(found["active"].values, [False, True])
    assert (found["name"].values.tolist(), found["excess"].values.tolist()) == ([["elbow"]], [2.0])
    with pytest.raises(ValueError, match="3 texts, the data 2 channels"):
        Threshold(threshold=[1.0], names=["a", "b", "c"]).execute({"Loss": loss})


def test_channels_that_only_the_beginnings_of_their_names_tell_apart_keep_these() -> None:
    loss = Samples(np.array([[0.5, 2.0]]), np.zeros(1), ("right.elbow", "left.elbow"))
    found = Threshold(threshold=[1.0, 10.0], names=["left.elbow", "right.elbow"]).execute({"Loss": loss})
    assert (found["name"].values.tolist(), found["excess"].values.tolist()) == ([["left.elbow"]], [2.0])
    arms = {arm: Samples(np.array([[0.0, loss]]), np.zeros(1)) for arm, loss in (("left", 0.0), ("right", 3.0))}
    assert Threshold(threshold=[1.0]).execute(arms)["name"].values.tolist() == [["right.1"]]


def test_an_input_that_has_not_spoken_yet_does_not_keep_scale_from_the_others() -> None:
    silent = Samples(np.zeros(0), np.zeros(0))
    found = Scale(offset=[1.0, 2.0]).execute({"a": Samples(np.ones((1, 2)), np.zeros(1)), "b": silent})
    assert list(found) == ["a"]


def test_stamps_that_jump_by_decades_cost_no_memory_and_no_digits() -> None:
    stamps = np.array([0.0, 0.05, 1.76e9, 1.76e9 + 0.05, 1.76e9 + 0.1])
    found = run([Resample(rate=20.0)], {"x": Samples(np.arange(5.0), stamps)})["x"]
    np.testing.assert_allclose(found.stamps, stamps)
    low_pass = run([LowPass(cutoff=1.0)], {"x": Samples(np.arange(5.0), stamps)})["x"].values
    a = 1 - np.exp(-2 * np.pi * 0.05)
    np.testing.assert_allclose(low_pass[2:4], [2.0, 2 + a * 1], rtol=1e-6)
    assert np.isfinite(run([LowPass(cutoff=1e308)], {"x": Samples(np.arange(5.0), stamps)})["x"].values).all()


def test_resampling_loses_no_sample_of_the_grid_between_two_calls() -> None:
    for rate in (3.0, 7.0, 10.0, 130.0, 1000 / 3):
        grid = np.arange(200) / rate
        stamps = np.unique(np.concatenate((grid, np.nextafter(grid[1:], 0), np.nextafter(grid, 1e9))))
        whole = run([Resample(rate=rate)], {"x": Samples(stamps, stamps)})["x"]
        np.testing.assert_array_equal(whole.stamps, grid)
        processor = Resample(rate=rate)
        parts = [processor.execute({"x": Samples(stamps[k : k + 1], stamps[k : k + 1])}) for k in range(len(stamps))]
        np.testing.assert_array_equal(np.concatenate([part["x"].stamps for part in parts if part]), grid)


def test_a_stride_that_is_made_small_counts_from_the_last_window_on() -> None:
    windows = Window(size=2, stride=1_000_000)
    samples = Samples(np.arange(10.0), np.arange(10.0))
    assert len(windows.execute({"x": samples})["x"]) == 1
    set_value(windows, "stride", 2)
    later = windows.execute({"x": Samples(np.arange(10.0, 14), np.arange(10.0, 14))})["x"]
    assert later.stamps[0] <= 11
    assert np.diff(later.stamps).tolist() == [2.0] * (len(later) - 1)
