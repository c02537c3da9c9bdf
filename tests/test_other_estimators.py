"""Outlier detectors of scikit-learn and PyOD as detectors of a training: promise, card and file as those of FAME."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
import yaml
from monitor_runs import told, write_runs
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.ensemble import IsolationForest

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor import Detector
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.trained_model import TrainedModel

CONFIG = Training(window=10, stride=5, samples=500, false_alarms="0.1 per run")
FOREST = "sklearn.ensemble.IsolationForest"


def run(seed: int, *, pushed: float = 0.0) -> Samples:
    """Two channels that repeat; somebody may push against one of them."""
    random, index = np.random.default_rng(seed), np.arange(200)
    values = np.stack([np.sin(index / 20), np.cos(index / 15)], axis=1) + random.normal(0, 0.05, (200, 2))
    values[100:120, 1] += pushed
    return Samples(values, index / 100, ("a", "b"))


@pytest.mark.long
def test_a_class_of_scikit_learn_trains_with_a_promise_and_a_card(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_runs(tmp_path / "runs.csv", [run(seed) for seed in range(12)])
    section = {"Files": ["runs.csv"], "Detector": FOREST, "Parameters": {"n_estimators": 20}, "Window": 10}
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({"Training": section | {"FalseAlarms": "0.1 per run"}}))
    assert main(["monitor", "train", str(tmp_path / "c.yaml")]) == 0
    said = capsys.readouterr().out
    assert f"model.skops: {FOREST}, windows of 10 samples" in said
    assert "false alarms: at most 0.077 false alarms per run on average" in said
    card = json.loads((tmp_path / "model.card.json").read_text())
    assert card["Model"]["detector"] == card["Settings"]["detector"] == FOREST
    assert card["Settings"]["parameters"] == {"n_estimators": 20}
    judged = write_runs(tmp_path / "new.csv", [run(20), run(21, pushed=3.0)])
    code, found = told(capsys, "monitor", "judge", tmp_path / "model.skops", judged)
    assert (code, [each["verdict"] for each in found["runs"]]) == (1, ["benign", "anomalous"])


@pytest.mark.long_but("*mixture*", "*Kernel*")
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        (FOREST, {"n_estimators": 5}),
        ("sklearn.svm.OneClassSVM", {"nu": 0.1}),
        ("sklearn.neighbors.LocalOutlierFactor", {"novelty": True}),
        ("sklearn.covariance.EllipticEnvelope", {}),
        ("sklearn.neighbors.KernelDensity", {}),
        ("sklearn.mixture.GaussianMixture", {"n_components": 2}),
    ],
)
def test_a_model_of_an_estimator_is_stored_and_comes_back(tmp_path: Path, name: str, parameters: dict[str, Any]):
    settings = replace(CONFIG, detector=name, parameters=parameters, window=4)
    made = fit([run(seed) for seed in range(6)], settings)
    made.save(tmp_path / "one.skops")
    again = TrainedModel.load(tmp_path / "one.skops")
    odd, usual = (run(30, pushed=pushed).values[100:120].reshape(5, 4, 2) for pushed in (5.0, 0.0))
    np.testing.assert_allclose(again.loss(odd), made.loss(odd))
    assert again.loss(odd)[:, 1].max() > 2 * again.loss(usual)[:, 1].max()
    fit([run(seed) for seed in range(6)], settings).save(tmp_path / "two.skops")
    assert (tmp_path / "one.skops").read_bytes() == (tmp_path / "two.skops").read_bytes()
    plain = made.to_plain()
    with pytest.raises(ConfigError, match=r"m\.skops: was made with scikit-learn 0\.1"):
        TrainedModel.of(plain | {"versions": {"scikit-learn": "0.1"}}, "m.skops")


@pytest.mark.parametrize(
    ("name", "parameters", "said"),
    [
        ("sklearn.ensemble.IsolationForst", {}, "sklearn.ensemble.IsolationForst is no class of an estimator"),
        ("sklearn.ensembles.IsolationForest", {}, "No module named 'sklearn.ensembles'"),
        ("os.system", {"command": "exit 1"}, "os.system is no class of scikit-learn, and models hold no others"),
        (FOREST, {"trees": 3}, f"{FOREST} does not take these Parameters: .*'trees'"),
        (FOREST, {"n_estimators": -3}, f"{FOREST} cannot learn: The 'n_estimators' parameter"),
        ("sklearn.neighbors.LocalOutlierFactor", {}, r"score_samples.*, got LocalOutlierFactor\(\)"),
        ("sklearn.linear_model.LinearRegression", {}, r"got LinearRegression\(\)"),
        ("test_other_estimators.Far", {}, "test_other_estimators.Far is no class of scikit-learn"),
        ("any of pca, sklearn.svm.OneClassSVM", {}, "expected one of autoencoder, pca"),
        ("pca", {"n_estimators": 3}, r"Training\.parameters: are those of a Detector that is a class"),
    ],
)
def test_what_cannot_be_a_detector_is_refused_in_one_line(name: str, parameters: dict[str, Any], said: str):
    with pytest.raises(ConfigError, match=said) as refused:
        fit([run(seed) for seed in range(3)], replace(CONFIG, detector=name, parameters=parameters))
    assert "\n" not in str(refused.value)


def test_what_a_configuration_names_is_not_called_before_it_is_known_to_be_an_estimator(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr("sklearn.show_versions", lambda: pytest.fail("called"))
    with pytest.raises(ConfigError, match="no class of an estimator"):
        fit([run(seed) for seed in range(3)], replace(CONFIG, detector="sklearn.show_versions"))


class Far(OutlierMixin, BaseEstimator):  # type: ignore[misc]
    """Scores as scikit-learn has them: lower far from the mean."""

    def fit(self, features: Any, y: Any = None) -> Self:
        self.mean_ = features.mean(axis=0)
        return self

    def decision_function(self, features: Any) -> Any:
        return -self.far(features)

    def far(self, features: Any) -> Any:
        return np.linalg.norm(features - self.mean_, axis=1)


class PyodFar(BaseEstimator):  # type: ignore[misc]
    """Scores as PyOD has them: higher far from the mean."""

    fit = Far.fit
    decision_function = Far.far


PyodFar.__module__ = "pyod.models.far"


class Scorer(BaseEstimator):  # type: ignore[misc]
    """Scores of which nobody knows what is unusual."""

    fit = Far.fit
    decision_function = Far.far


@pytest.mark.parametrize("estimator", [Far(), PyodFar(), IsolationForest(n_estimators=20)])
def test_an_estimator_in_memory_is_calibrated_whichever_way_its_scores_point(estimator: Any):
    rows = np.random.default_rng(0).standard_normal((400, 3))
    made = Detector(estimator, false_alarms=0.05).fit(rows[:300])
    assert (made.predict(rows[300:]) == -1).mean() < 0.15
    assert (made.predict(rows[300:] + 6.0) == -1).all()
    assert not hasattr(estimator, "n_features_in_")  # the one that was given has learned nothing


def test_scores_of_unknown_direction_are_refused():
    with pytest.raises(ConfigError, match=r"expected an estimator of scikit-learn .*, got Scorer\(\)"):
        Detector(Scorer()).fit(np.random.default_rng(0).standard_normal((50, 2)))
