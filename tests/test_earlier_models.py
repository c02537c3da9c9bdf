"""Models and learning files of earlier versions: they load, or are refused with the command that makes them anew."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_data import BENIGN, needs_data, recording

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.anomaly.learning_file import load
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import of_runs
from fame.monitor.drift import Drift
from fame.monitor.model_card import card_of, load_any, to_markdown
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.storage import to_plain, versions, write_artefact
from robots.arm.task import MH5, simulated_runs


def first_autoencoders() -> dict[str, Any]:
    """What the first version of `fame monitor train` stored: autoencoders only, no rate of false alarms."""
    random = np.random.default_rng(3)
    layers = (8, 3, 8)
    shapes = list(pairwise(layers))
    figures = {name: [0.1, 0.2] for name in ("training_max", "training_mean", "validation_max", "validation_mean")}
    return {
        "format": "fame-autoencoder-1", "versions": versions(), "columns": ["a", "b"], "window": 8, "rate": 100.0,
        "mean": np.zeros(2), "scale": np.ones(2), "activation": "tanh",
        "weights": [random.standard_normal((2, *shape)) for shape in shapes],
        "biases": [np.zeros((2, 1, shape[1])) for shape in shapes],
        "thresholds": [0.3, 0.4], "cutoff": 5.0, "before": 20.0, "data": "", "metrics": figures,
    }  # fmt: skip


def benign_runs(count: int, seed: int) -> list[np.ndarray]:
    """Runs (points, joints) of the MH5 along a recorded one."""
    return simulated_runs(recording(BENIGN).select([0]), count, seed, MH5)


def first_paths() -> dict[str, Any]:
    """What the first version of `adm learn` stored of a path detector: no orientations, parameters or noise."""
    runs = of_runs(benign_runs(4, seed=7), 1, MH5.joints)
    plain = to_plain(PathDetector(MH5).fit(runs))
    own = {name: plain[name] for name in ("kind", "margin", "period", "limits")}
    plain = {**plain["chain"], **plain["paths"], **own}
    del plain["turns"]
    return {
        "format": "fame-adm-1", "versions": versions(), "name": "path", "joints": list(MH5.joints),
        "estimator": {**plain, "limits": plain["limits"][:, :3]}, "process": None, "threshold": 0.002, "nominal": 517,
        "reference": runs.select([0]).values, "data": "",
    }  # fmt: skip


@pytest.fixture
def old(tmp_path: Path) -> Path:
    write_artefact(first_autoencoders(), tmp_path / "old.skops")
    return tmp_path / "old.skops"


def test_the_first_autoencoders_compute_their_losses_and_their_card_promises_nothing(old: Path):
    model = TrainedModel.load(old)
    assert np.isfinite(model.loss(np.ones((2, 8, 2)))).all()
    assert model.thresholds == (0.3, 0.4)
    text = to_markdown(card_of(load_any(old)))
    assert "promise: none: trained by an earlier version" in text
    assert "its rate of false alarms is unknown; fame monitor train makes it anew" in text
    assert "The promise holds" not in text
    assert "## Data\n\n##" not in text


def test_the_drift_of_the_first_autoencoders_is_refused_with_the_command(old: Path):
    with pytest.raises(ConfigError, match=r"was trained by an earlier version, .*: fame monitor train makes it anew"):
        Drift(model=str(old))


def classifier(name: str, threshold: float, seed: int) -> dict[str, Any]:
    """What `adm learn` stored of a classifier, alone or in an ensemble, before both kinds of models had one format."""
    from sklearn.preprocessing import MinMaxScaler
    from sklearn.svm import OneClassSVM

    points = np.random.default_rng(seed).normal(size=(50, 2))
    scaler = MinMaxScaler().fit(points)
    return {
        "name": name, "joints": ["a", "b"], "estimator": OneClassSVM(nu=0.1).fit(scaler.transform(points)),
        "process": [0, "minmax", scaler, None], "threshold": threshold, "nominal": 50, "reference": points, "data": "",
    }  # fmt: skip


def test_the_first_classifiers_and_ensembles_score_as_they_did(tmp_path: Path):
    one, two = classifier("one", 0.5, 1), classifier("two", 0.2, 2)
    either = {**one, "name": "either", "threshold": 1.0, "estimator": {"rule": "any of", "members": [one, two]}}
    points = np.random.default_rng(3).normal(size=(50, 2))
    found = {}
    for content in (one, two, either):
        path = tmp_path / f"{content['name']}.skops"
        write_artefact({"format": "fame-adm-1", "versions": versions(), **content, "calibration": None}, path)
        found[content["name"]] = Model.load(path)
    expected = [each["estimator"].predict(each["process"][2].transform(points)) == -1 for each in (one, two)]
    for name, votes in zip(found, [*expected, expected[0] | expected[1]], strict=True):
        assert (found[name].predict(of_runs([points], 1, ("a", "b"))) == -1).tolist() == votes.tolist()
    assert found["either"].run_score([5, 5], 50) == 0.1 / 0.2
    begin = "any of one: alarm from 26 anomalous points of a run of 50 on; two: alarm from 11 "
    assert found["either"].alarm_text().startswith(begin)
    plain = found["either"].to_plain()
    for wrong in ({"rule": "some of"}, {"names": ["one"]}, {"usual": [0.5, 0.2]}):
        write_artefact(plain | {"detector": plain["detector"] | wrong}, tmp_path / "damaged.skops")
        with pytest.raises(ConfigError, match="is damaged"):
            load_any(tmp_path / "damaged.skops")


@pytest.mark.long
@needs_data
def test_the_first_path_detector_scores_as_it_did_and_says_what_it_does_not_see(tmp_path: Path):
    write_artefact(first_paths(), tmp_path / "path.skops")
    detector = Model.load(tmp_path / "path.skops").detector
    benign = of_runs(benign_runs(1, seed=8), 1, MH5.joints)
    assert sum(reading.anomalous for reading in detector.follow(benign)) == 0
    moved = of_runs([benign_runs(1, seed=8)[0] + [0, 0.02, 0, 0, 0, 0]], -1, MH5.joints)
    assert sum(reading.anomalous for reading in detector.follow(moved)) > 100
    text = to_markdown(card_of(load_any(tmp_path / "path.skops")))
    assert "does not see the orientation of the tool: fame monitor adm learn makes it anew" in text


@pytest.mark.parametrize("format", ["fame-adm-0", "fame-monitor-99", None, ["fame-adm-1"]])
def test_a_model_of_another_version_is_refused_with_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], format: Any
):
    write_artefact({"format": format}, tmp_path / "m.skops")
    assert main(["monitor", "model", "show", str(tmp_path / "m.skops")]) == 2
    assert "fame monitor train or adm learn makes it anew" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"'fame-monitor-3', got .*; fame monitor train makes it anew"):
        TrainedModel.load(tmp_path / "m.skops")
    with pytest.raises(ConfigError, match=r"'fame-monitor-3', got .*; fame monitor adm learn makes it anew"):
        Model.load(tmp_path / "m.skops")


@needs_data
def test_a_model_of_another_scikit_learn_is_refused_with_the_command(tmp_path: Path):
    write_artefact({**first_paths(), "versions": {"scikit-learn": "0.99.1"}}, tmp_path / "m.skops")
    with pytest.raises(ConfigError, match=r"scikit-learn 0\.99\.1, .*: fame monitor adm learn makes it anew"):
        Model.load(tmp_path / "m.skops")


def test_a_learning_file_of_the_first_version_is_read(tmp_path: Path):
    (tmp_path / "learning.yaml").write_text(
        "Files:\n"
        "  fit_file: {name: a.csv, input_col: [0, 1], output_col: [2]}\n"
        "  unsupervised_train: {name: a.csv, input_col: [0, 1], output_col: [2]}\n"
        "  supervised_train: {name: Null}\n"
        "  testing: []\n"
        "Operations: {reduction: 0, scaling: minmax}\n"
        "Classifiers:\n"
        "  - {name: path, class: PathDetector, parameters: {chain: arm.yaml, margin: 1.5}, threshold: 0.002}\n"
        "Split: {by: run, folds: 5}\n"
        "Threshold: auto\n"
    )
    learning = load(tmp_path / "learning.yaml")
    assert (learning.false_alarms, learning.folds, learning.supervised) == ("", 5, None)
