"""Models as ONNX files: the same losses without FAME, checked when they are written; what has no form is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from monitor_runs import told, write_runs

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.pipeline.detectors import DETECTORS, fit_detector
from fame.monitor.pipeline.onnx_files import SAME, difference, onnx_bytes
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.train import Training
from fame.monitor.pipeline.trained_model import TrainedModel

NAMES = ("turn", "press", "heat")
QUICK = Training(hidden=(6, 2, 6), epochs=3, neighbours=300, window=20, stride=5)
EVERY = (*DETECTORS, "any of phase, knn", "all of pca, isolation_forest")


@cache
def windows() -> tuple[np.ndarray, np.ndarray]:
    """Windows of thirty runs of three channels, in their own units, and the times of their ends."""
    random = np.random.default_rng(3)
    times = np.tile(np.arange(20) * 0.5, 30)
    phase = times[:, None] + np.linspace(0, 3, 20)
    values = np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)], axis=2)
    return (values + 0.05 * random.standard_normal(values.shape)) * [2.0, 30.0, 0.1] + 5.0, times


@cache
def trained(name: str) -> TrainedModel:
    values, times = windows()
    mean, scale = values.mean(axis=(0, 1)), values.std(axis=(0, 1))
    detector = fit_detector(name, (values - mean) / scale, QUICK, times)
    return TrainedModel(NAMES, 20, 40.0, mean, scale, detector, (1.0, 1.0, 1.0))


@pytest.mark.parametrize("single", [False, True], ids=["64 bit", "32 bit"])
@pytest.mark.parametrize("name", EVERY)
def test_a_detector_gives_the_same_losses_as_onnx_and_comes_back_as_it_was(name: str, single: bool, tmp_path: Path):
    model, (values, times) = trained(name), windows()
    odd = values + np.random.default_rng(4).normal(size=values.shape) * model.scale
    unknown = np.where(np.arange(len(times)) % 7 == 0, np.nan, times + 0.2)  # between two phases
    unknown[::11] += 1000.0  # behind the last one
    content = onnx_bytes(model, single=single)
    for each, at in ((values, times), (odd, unknown)):
        assert difference(model, content, each, at) < (1e-6 if single else 1e-12)
    (tmp_path / "m.onnx").write_bytes(content)
    again = TrainedModel.load(tmp_path / "m.onnx")
    np.testing.assert_array_equal(again.loss(odd, unknown), model.loss(odd, unknown))
    assert (again.columns, again.thresholds, again.window) == (NAMES, model.thresholds, 20)


def test_another_model_than_the_file_is_noticed():
    model, (values, times) = trained("knn"), windows()
    moved = replace(model, mean=model.mean + np.array([0.2, 0.0, 0.0]))
    assert difference(moved, onnx_bytes(model), values, times) > 100 * SAME


# ---- the command -----------------------------------------------------------------------------------------------------


def runs() -> list[Samples]:
    random, at = np.random.default_rng(5), np.arange(60) / 20
    return [Samples(np.sin(at[:, None] + [0, 1, 2]) + 0.05 * random.normal(size=(60, 3)), at, NAMES) for _ in range(6)]


def train(folder: Path, *more: str, detector: str = "phase") -> Path:
    model, file = folder / "m.skops", write_runs(folder / "runs.csv", runs())
    options = ["--window", "10", "--detector", detector, "--keep", *more]
    assert main(["monitor", "train", "--data", str(file), "-o", str(model), *options]) == 0
    return model


def test_a_model_is_exported_once_it_gives_its_losses_on_the_runs_of_its_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    import onnxruntime

    model, output = train(tmp_path), tmp_path / "m.onnx"
    capsys.readouterr()
    before = model.read_bytes(), (tmp_path / "runs.csv").read_bytes()
    for read in (model, tmp_path / "runs.csv"):
        assert main(["monitor", "export", str(model), "-o", str(read)]) == 2
        assert f"{read}: expected a new file, got one that is read" in capsys.readouterr().err
    assert before == (model.read_bytes(), (tmp_path / "runs.csv").read_bytes())
    code, found = told(capsys, "monitor", "export", model, "-o", output)
    assert (code, found["detector"], found["windows"]) == (0, "phase", 66)
    assert found["difference"] < 1e-12
    session = onnxruntime.InferenceSession(str(output), providers=["CPUExecutionProvider"])
    assert [each.name for each in session.get_inputs()] == ["windows", "times"]
    assert main(["monitor", "export", str(model), "-o", str(output)]) == 0
    assert "phase; gives the losses of" in capsys.readouterr().out
    output.unlink()
    monkeypatch.setattr("fame.monitor.pipeline.onnx_files.difference", lambda *given: 0.5)
    assert main(["monitor", "export", str(model), "-o", str(output)]) == 2
    assert "gives other losses as ONNX: a difference of 0.5 of a threshold" in capsys.readouterr().err
    (tmp_path / "runs.csv").unlink()
    assert main(["monitor", "export", str(model), "-o", str(output)]) == 2
    assert "only if it gives the same losses on runs: expected --data FILE" in capsys.readouterr().err
    assert not output.exists()


def test_what_has_no_form_in_onnx_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    model = train(tmp_path, detector="sklearn.neighbors.KernelDensity")
    words = ["monitor", "export", str(model), "-o", str(tmp_path / "m.onnx")]
    capsys.readouterr()
    assert main(words) == 2
    text = "sklearn.neighbors.KernelDensity has no form in ONNX: expected one of autoencoder, pca, "
    assert text in capsys.readouterr().err
    with pytest.raises(ConfigError, match="KernelDensity has no form"):
        TrainedModel.load(model).save(tmp_path / "other.onnx")
    monkeypatch.setattr("fame.monitor.model_card.load_any", lambda path: object())  # a detector of paths
    assert main(words) == 2
    assert (
        "m.skops: is a model of fame monitor adm learn, whose detectors have no form in ONNX" in capsys.readouterr().err
    )
    assert not (tmp_path / "m.onnx").exists()


def test_the_old_option_says_what_replaces_it_and_still_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    output = tmp_path / "m.onnx"
    model = train(tmp_path, "--onnx", str(output), detector="pca")
    assert "--onnx is now fame monitor export MODEL.skops -o MODEL.onnx" in capsys.readouterr().err
    assert TrainedModel.load(output).thresholds == TrainedModel.load(model).thresholds


def test_a_file_of_an_earlier_release_is_read(tmp_path: Path):
    import onnx

    model = trained("autoencoder")
    plain: dict[str, Any] = model.to_plain()
    network = plain.pop("detector")
    tensors = {"mean": plain.pop("mean"), "scale": plain.pop("scale")}
    for part, arrays in (("weight", network["weights"]), ("bias", network["biases"])):
        tensors |= {f"{part}_{layer}": array for layer, array in enumerate(arrays)}
    del plain["kind"]
    constants = [onnx.numpy_helper.from_array(array, name) for name, array in tensors.items()]
    graph = onnx.helper.make_graph([], "autoencoders", [], [], constants)
    proto = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=9)
    metadata = json.dumps({**plain, "activation": network["activation"]}, default=np.ndarray.tolist)
    onnx.helper.set_model_props(proto, {"fame": metadata})
    (tmp_path / "m.onnx").write_bytes(proto.SerializeToString())
    values, _ = windows()
    np.testing.assert_array_equal(TrainedModel.load(tmp_path / "m.onnx").loss(values), model.loss(values))
