"""Thresholds with a stated rate of false alarms."""

import numpy as np
import pytest
from scipy.stats import binomtest

from fame.errors import ConfigError
from fame.intervals import interval
from fame.monitor.calibration import (
    FAR,
    Calibration,
    calibrate,
    calibrate_runs,
    false_alarm_rate,
    independent,
    left_out_thresholds,
    rank,
    runs_needed,
    runs_to_bound,
)
from fame.monitor.storage import from_plain, to_plain


def scores(seed: int, runs: int, channels: int = 12) -> np.ndarray:
    """Largest losses of runs: channels of different size, a factor per run that all share, long tails."""
    random = np.random.default_rng(seed)
    sizes = 10.0 ** random.uniform(-3, 3, channels)
    shared = np.exp(0.2 * random.standard_normal((runs, 1)))
    return np.asarray(sizes * shared * np.exp(0.3 * random.standard_normal((runs, channels))))


@pytest.mark.parametrize(("rate", "needed"), [(0.01, 99), (0.05, 19), (0.5, 1), (1 / 17, 16)])
def test_a_rate_needs_a_number_of_runs(rate: float, needed: int):
    assert runs_needed(rate) == needed
    assert rank(needed, rate) == needed
    assert rank(needed - 1, rate) is None


def test_enough_runs_promise_the_rate_and_few_say_what_they_can():
    promise = calibrate(scores(1, 99), 0.01)
    assert promise.promised == pytest.approx(0.01)
    assert promise.margin == 1.0
    none = calibrate(scores(1, 16), 0.01)
    assert (none.promised, none.margin) == (None, 1.5)
    assert none.text == (
        "no promise: 0.01 false alarms per run were asked for, 16 runs promise 0.059 per run at best, 99 are needed, "
        "230 to be 90 % sure of it"
    )
    assert calibrate(scores(1, 16), 0.06).promised == pytest.approx(1 / 17)


@pytest.mark.parametrize(("runs", "rate"), [(16, 0.06), (40, 0.05), (99, 0.01)])
def test_the_promise_is_kept_on_average_over_all_channels_together(runs: int, rate: float):
    """200 times: thresholds of some runs, 20 further runs. A rate per channel would be twelve times as high."""
    alarms = total = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        every = scores(7, runs + 20)[random.permutation(runs + 20)]
        limits = calibrate(every[:runs], rate).thresholds
        alarms += int((every[runs:] > limits).any(axis=1).sum())
        total += 20
    assert alarms / total < 1.25 * rate


def test_without_a_promise_no_score_of_the_calibration_exceeds_its_threshold():
    few = scores(3, 8)
    found = calibrate(few, 0.01)
    assert (few * found.margin <= np.array(found.thresholds) * (1 + 1e-12)).all()


def test_a_margin_holds_with_a_promise_too():
    every = scores(2, 99)
    assert calibrate(every, 0.01, 2.0).thresholds == pytest.approx(2 * np.array(calibrate(every, 0.01).thresholds))


def test_a_margin_that_lowers_the_thresholds_voids_the_promise():
    lowered = calibrate(scores(1, 99), 0.01, 0.5)
    assert lowered.promised is None
    assert lowered.text == "no promise: a margin of 0.5 lowers thresholds below those that 99 runs promise"


def test_runs_are_judged_by_the_thresholds_of_the_others():
    every = scores(4, 30)
    every[17] *= 50
    assert np.flatnonzero((every > left_out_thresholds(every, 0.05)).any(axis=1)).tolist() == [17]


def test_a_channel_that_never_moved_has_a_threshold_above_zero():
    every = scores(5, 10)
    every[:, 3] = 0.0
    assert 0 < calibrate(every).thresholds[3] < 1e-9


@pytest.mark.parametrize("runs", [2, 3, 4])
def test_very_few_runs_promise_nothing_and_have_finite_thresholds(runs: int):
    few = scores(8, runs)
    found = calibrate(few, 0.4)
    assert found.promised is None
    assert (np.array(found.thresholds) < 100 * few.max(axis=0)).all()


def test_one_run_and_impossible_rates_are_refused():
    with pytest.raises(ConfigError, match="has 1 run; at least 2 are needed"):
        calibrate(scores(1, 1))
    with pytest.raises(ConfigError, match="between 0 and 1 per run, got 0"):
        calibrate(scores(1, 5), 0.0)


@pytest.mark.parametrize(("count", "total"), [(0, 20), (1, 20), (7, 20), (20, 20)])
def test_intervals_are_those_of_the_exact_binomial_test(count: int, total: int):
    exact = binomtest(count, total).proportion_ci(method="exact")
    assert interval(count, total) == pytest.approx((exact.low, exact.high))


def test_a_calibration_comes_back_from_plain_data():
    found = calibrate(scores(6, 20), 0.1)
    again = from_plain(Calibration, to_plain(found))
    assert (again.thresholds, again.promised, again.text) == (found.thresholds, found.promised, found.text)


@pytest.mark.long_but("[2-5]-*")
@pytest.mark.parametrize("margin", [None, 0.5, 3.0])
@pytest.mark.parametrize("runs", [2, 3, 4, 5, 6, 9, 16, 19, 20, 60])
def test_a_lower_rate_never_gives_a_lower_threshold(runs: int, margin: float | None):
    """Of all functions that set thresholds: for channels, whole runs, and the left-out runs of a comparison."""
    rates = (0.9, 0.5, 0.3, 0.2, 0.1, 0.06, 0.05, 0.02, 0.01, 1e-6)
    for seed in range(6):
        every = scores(seed, runs, channels=6)
        if seed % 2:
            every[0] *= 30.0  # an outlier
        if seed % 3 == 0:
            every[1] = every[0]  # equal runs
        limits = np.array([calibrate(every, rate, margin).thresholds for rate in rates])
        assert (np.diff(limits, axis=0) >= 0).all(), seed
        for column in (every[:, 0], -every[:, 0], np.zeros(runs)):
            for least in (-np.inf, 0.0, 1.0):
                found = [calibrate_runs(column, rate, margin or 1.5, least=least).thresholds[0] for rate in rates]
                assert (np.diff(found) >= 0).all(), seed
        if runs > 2 and seed in ((3,) if runs == 60 else range(4)):  # each run of 60 is left out: slow
            left_out = np.array([left_out_thresholds(every, rate, margin) for rate in rates])
            assert (np.diff(left_out, axis=0) >= 0).all(), seed


@pytest.mark.parametrize("seconds", [0.5, 20.0, 3000.0])
def test_a_lower_rate_per_hour_is_a_lower_rate_per_run(seconds: float):
    rates = [false_alarm_rate(f"{rate} per hour", seconds) for rate in (1.0, 0.5, 0.1, 0.001)]
    assert rates == sorted(rates, reverse=True)


def test_a_promise_is_told_as_an_average_and_with_confidence():
    found = calibrate(scores(1, 16), 0.06)
    assert found.text == (
        "at most 0.059 false alarms per run on average over trainings, with 90 % confidence at most 0.13, by 16 runs "
        "(asked for: 0.06; 0.06 takes 38 to be 90 % sure of it)"
    )
    drawn = np.random.default_rng(0).beta(1, 16, 4000)  # the rate of a model whose threshold is the largest of 16
    assert (drawn > found.bound).mean() == pytest.approx(0.1, abs=0.02)
    assert calibrate(scores(1, 16), 0.01).bound == 1.0


@pytest.mark.parametrize("rate", [0.3, 0.05, 0.01])
def test_so_many_runs_bound_a_rate_with_confidence(rate: float):
    runs = runs_to_bound(rate)
    assert (1 - rate) ** runs <= 0.1 < (1 - rate) ** (runs - 1)
    assert calibrate(scores(1, runs), 1 / (runs + 1)).bound <= rate


def test_a_run_that_is_unlike_the_others_in_one_channel_hardly_raises_the_thresholds_of_the_others():
    every = scores(2, 20, channels=4)
    before = np.array(calibrate(every, 0.05).thresholds)
    every[3, 0] *= 1000.0
    after = calibrate(every, 0.05)
    assert (np.array(after.thresholds)[1:] < 1.7 * before[1:]).all()
    assert (after.stretch < FAR).all()


@pytest.mark.parametrize("runs", [6, 9])
def test_thresholds_of_few_runs_stay_near_to_what_was_seen(runs: int):
    for seed in range(20):
        assert (calibrate(scores(seed, runs), 0.01).stretch < 3 * FAR).all(), seed


def test_detectors_of_which_any_raises_the_alarm_keep_the_promise_together():
    """Three detectors that see other things: the rate is divided among them."""
    alarms = 0
    for seed in range(100):
        parts = [scores(1000 * part + seed, 19 + 40, channels=6) for part in range(3)]
        among = independent(np.hstack([part[:19] for part in parts]))
        above = [part[19:] > calibrate(part[:19], 0.05, among=among).thresholds for part in parts]
        alarms += int(np.any(above, axis=(0, 2)).sum())
    assert alarms / 4000 < 1.25 * 0.05


def test_scores_that_rise_together_count_as_one():
    every = scores(3, 200, channels=6)
    assert independent(np.repeat(every[:, :1], 6, axis=1)) == pytest.approx(1)
    assert 4 < independent(np.random.default_rng(0).random((200, 6))) <= 6


def test_of_200_machines_few_exceed_the_conditional_bound():
    """Each with thresholds of its own at 0.05, by 19 runs; its rate is that of 2000 further runs."""
    rates, bound = [], calibrate(scores(0, 19), 0.05).bound
    for seed in range(200):
        every = scores(seed, 2019, channels=6)
        rates.append((every[19:] > calibrate(every[:19], 0.05).thresholds).any(axis=1).mean())
    assert np.mean(rates) < 0.05
    exceeding = sum(rate > bound for rate in rates)
    assert binomtest(exceeding, 200, 0.1, alternative="greater").pvalue > 0.05
