"""Detectors by one interface, on data as a user's own robot gives them."""

import warnings
from functools import cache

import numpy as np
import own_data
import pytest
from scipy.stats import binomtest

from fame.dataclasses import replace
from fame.errors import ConfigError
from fame.monitor.calibration import independent
from fame.monitor.pipeline.compare import compare
from fame.monitor.pipeline.detectors import (
    DETECTORS,
    STORED,
    Several,
    detector_name,
    detector_names,
    fit_detector,
)
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit, learned, losses
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.storage import detector_of, to_plain

QUICK = Training(hidden=(6, 2, 6), epochs=3, neighbours=300)
EVERY = (*DETECTORS, "any of pca, knn", "all of pca, mahalanobis")


@cache
def windows() -> np.ndarray:
    """Scaled windows of three channels that belong together."""
    random = np.random.default_rng(1)
    phase = random.uniform(0, 2 * np.pi, (600, 1)) + np.linspace(0, 3, 20)
    values = np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)], axis=2)
    values = values + 0.05 * random.standard_normal(values.shape)
    return np.asarray((values - values.mean(axis=(0, 1))) / values.std(axis=(0, 1)))


@pytest.mark.parametrize("name", EVERY)
def test_a_detector_names_the_channel_that_deviates_and_comes_back_as_it_was(name: str):
    detector = fit_detector(name, windows(), QUICK)
    assert detector_name(detector) == name
    usual = detector.loss(windows())
    assert usual.shape == (600, 3)
    odd = windows()[:50].copy()
    odd[:, :, 1] += 6.0
    found = detector.loss(odd)
    assert np.median(found.max(axis=1)) > np.quantile(usual.max(axis=1), 0.95)
    assert (found.argmax(axis=1) == 1).mean() > 0.9
    again = detector_of(to_plain(detector), STORED)
    np.testing.assert_array_equal(again.loss(odd), found)
    np.testing.assert_allclose(detector.loss(odd[:1]), found[:1], rtol=1e-9)  # one by one as all at once


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(("size", "unit"), [(1e300, 1.0), (-1.7e308, 1.0), (8.0, 1e-12)])
def test_a_value_of_any_size_has_the_largest_loss_in_any_unit(name: str, size: float, unit: float):
    channels = ("a", "b", "c")
    runs = [Samples(values * unit, np.arange(20) / 10, channels) for values in windows()[:12]]
    made = learned(runs, replace(QUICK, detector=name, window=10), 10.0)
    odd = np.stack([run.values[:10] for run in runs])
    usual = made.loss(odd)
    odd[3, 5:, 1] = size * unit
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = made.loss(odd)
    assert np.isfinite(found).all()
    assert found[3].max() > usual.max()


@pytest.mark.parametrize(("rule", "score"), [("any of", 1.5), ("all of", 0.5)])
def test_the_score_of_a_run_by_several_is_in_units_of_their_thresholds(rule: str, score: float):
    assert Several(rule, (), np.array([[2.0], [4.0]])).score([1.0, 6.0]) == score


@pytest.mark.parametrize("name", ["any of phase, knn", "any of phase, knn, mahalanobis"])
def test_thresholds_of_several_are_of_what_each_learned_with_the_others(name: str):
    random, at = np.random.default_rng(1), np.arange(150)[:, None] / 50  # windows of training lie closer for `phase`
    runs = [Samples(np.sin(at * [2.0, 5.0]) + 0.03 * random.standard_normal((150, 2)), at[:, 0]) for _ in range(12)]
    made = fit(runs, Training(detector=name, window=20, stride=5, false_alarms="0.1 per run"))
    assert made.calibration is not None
    assert (made.calibration.scores <= made.thresholds).all()  # the lowest promise of 12 runs that keeps 0.1


def test_the_forest_scores_as_scikit_learn_does():
    from sklearn.ensemble import IsolationForest

    forest = fit_detector("isolation_forest", windows(), QUICK)
    features = forest.components.project(windows()).astype(np.float32).astype(np.float64)  # type: ignore[attr-defined]
    expected = -IsolationForest(random_state=0).fit(features).score_samples(features)
    np.testing.assert_allclose(forest.loss(windows()).max(axis=1), expected, rtol=1e-6)


def test_unknown_detectors_are_refused_with_those_there_are():
    for name in ("pcb", "any of pca", "any of pca, pcb", "any of"):
        with pytest.raises(ConfigError, match="expected one of autoencoder, pca"):
            detector_names(name)


# ---- a user's own data -----------------------------------------------------------------------------------------------

TRAINING = Training(window=40, detector="mahalanobis", samples=8000)
TRAIN, TEST, FAULTY = range(16), range(1000, 1020), range(5000, 5012)
FURTHER = range(20_000, 20_200)
"""The seeds. Detector and window were chosen on runs of the first three; those of `FURTHER` were not looked at."""


@cache
def model(false_alarms: str) -> TrainedModel:
    config = Training(**{**vars(TRAINING), "false_alarms": false_alarms})
    return fit([own_data.run(seed) for seed in TRAIN], config)


def alarm(model: TrainedModel, seed: int, fault: own_data.Fault = "none") -> bool:
    found = losses(model, own_data.run(seed, fault), TRAINING.stride).values
    return bool((found > np.array(model.thresholds)).any())


@pytest.mark.long
def test_by_default_no_false_alarm_and_no_promise_with_sixteen_runs():
    made = model("0.01 per run")
    assert made.calibration is not None
    assert made.calibration.promised is None
    assert [seed for seed in TEST if alarm(made, seed)] == []


@pytest.mark.long_but("spike")
@pytest.mark.parametrize("fault", own_data.FAULTS)
def test_every_rare_fault_is_found(fault: own_data.Fault):
    assert [seed for seed in FAULTY if not alarm(model("0.01 per run"), seed, fault)] == []


@pytest.mark.long
def test_a_promise_is_kept_on_200_further_runs():
    made = model("0.06 per run")
    assert made.calibration is not None
    assert made.calibration.promised == pytest.approx(1 / 17)
    alarms = sum(alarm(made, seed) for seed in FURTHER)
    assert binomtest(alarms, len(FURTHER), 1 / 17, alternative="greater").pvalue > 0.05


@pytest.mark.parametrize("name", ["mahalanobis", "pca", "ocsvm", "isolation_forest"])
def test_a_matrix_that_would_be_too_large_is_refused_with_its_size(name: str):
    with pytest.raises(ConfigError, match=r"matrix of 3050 x 3050 \(74 MB\).*Window 49 or less"):
        fit_detector(name, np.zeros((2, 50, 61)), Training())


def test_phases_of_more_than_300_channels_are_refused_with_the_size():
    with pytest.raises(ConfigError, match=r"phase needs a matrix of 3010 x 3010 \(72 MB\) .* 301 channels"):
        fit_detector("phase", np.zeros((2, 50, 301)), Training())


def test_the_rate_is_divided_among_detectors_that_a_comparison_could_choose():
    """Each alone has then no lower threshold than in all of them together."""
    random = np.random.default_rng(4)
    runs = [Samples(random.standard_normal((30, 2)), np.arange(30) / 10, ("a", "b")) for _ in range(5)]
    config = Training(window=5, stride=5, folds=2, false_alarms="0.2 per run")
    pairs = compare(runs, config, ("pca", "mahalanobis", "any of pca, mahalanobis"))
    found = {item.detector: model for item, model in pairs}
    both = found["any of pca, mahalanobis"]
    assert both.calibration is not None
    assert both.calibration.parts.shape == (2, 5, 2)
    assert both.thresholds == (1.0,) * 2
    assert 1 <= both.calibration.among <= 4
    alone = found["pca"].calibration
    assert alone is not None
    assert alone.among == 2 * independent(alone.scores)
