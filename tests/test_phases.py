"""The detector that knows the phase of a run: the same values at another time are an anomaly."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from monitor_runs import STATE, told

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.middleware.typesystem import STRING
from fame.monitor.data_files import LabelledRun, read_labelled_runs
from fame.monitor.judge import judge_trained
from fame.monitor.model_card import card_of
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.elements import ElementFollower, active
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.phases import Phases
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.recording import RecordingNode, RecordingOptions
from fame.monitor.pipeline.train import Training, fit, losses
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.tables import read_parquet
from fame.robot.robot_state import RobotState

RATE, RUNS = 50.0, 12
CONFIG = Training(detector="phase", window=20, stride=5, false_alarms="0.1 per run")


def run(seed: int, seconds: float = 6.0, begin: float = 0.0) -> Samples:
    """Two channels with heavy-tailed noise; the first has a pulse at 2 s, the second the same one at 4 s."""
    random = np.random.default_rng(seed)
    stamps = np.arange(round(seconds * RATE)) / RATE
    values = np.exp(-(((stamps[:, None] - [2.0, 4.0]) / 0.3) ** 2)) + 0.02 * random.standard_t(3, (len(stamps), 2))
    return Samples(values, stamps + begin, ("left", "right"))


@cache
def model() -> TrainedModel:
    return fit([run(seed) for seed in range(RUNS)], CONFIG)


def ratios(given: Samples) -> np.ndarray:
    return np.asarray(losses(model(), given, CONFIG.stride).values / np.array(model().thresholds))


def test_undisturbed_runs_are_below_the_thresholds():
    assert sum((ratios(run(seed)) > 1).any() for seed in range(100, 120)) <= 4


def test_a_pulse_at_the_wrong_time_is_found_in_its_channel():
    late = run(7)
    late.values[:, 0] = np.roll(late.values[:, 0], round(0.4 * RATE))
    found = ratios(late)
    assert found.max() > 1
    assert found.max(axis=0).argmax() == 0


def test_behind_the_known_phases_a_window_is_judged_by_all_windows():
    detector = model().detector
    assert isinstance(detector, Phases)
    longer = ratios(run(8, seconds=8.0))
    assert np.isfinite(longer).all()
    assert (longer[-10:] < 3).all()  # at rest, which the training knows
    windows = np.stack([run(8).values[n : n + 20] for n in (90, 200)])
    scaled = (windows - model().mean) / model().scale
    unknown = detector.loss(scaled, np.array([np.nan, 1e9]))
    np.testing.assert_allclose(unknown, detector.loss(scaled))  # without times no phase is known
    assert detector.loss(scaled, np.array([0.5, 0.5])).max() > unknown.max()  # a pulse, where none should be


def test_a_run_begins_again_after_a_gap_and_in_however_many_calls():
    both = run(30), run(31, begin=20.0)
    whole = Samples(*(np.concatenate([getattr(each, name) for each in both]) for name in ("values", "stamps")),
                    ("left", "right"))  # fmt: skip
    for frequency in (0.0, 7.0, 50.0):
        found = processors.run([Autoencoder(model(), stride=5)], {"x": whole}, frequency)["loss"]
        second = losses(model(), both[1], 5)
        np.testing.assert_allclose(found.values[found.stamps > 20.5], second.values[second.stamps > 20.5], atol=0.5)
        assert (found.values < 3 * np.array(model().thresholds)).all()


@pytest.mark.parametrize("name", ["any of phase, mahalanobis", "all of phase, pca"])
def test_phases_combine_with_other_detectors(name: str):
    made = fit([run(seed) for seed in range(RUNS)], Training(**{**vars(CONFIG), "detector": name}))
    late = run(7)
    late.values[:, 0] = np.roll(late.values[:, 0], round(0.4 * RATE))
    found = losses(made, late, CONFIG.stride).values / np.array(made.thresholds)
    assert (found.max() > 1) == name.startswith("any")


def mission(seed: int, wait: float, *elements: str) -> Samples:
    """Two elements, `wait` and `work`; the first lasts `wait` s, the second has a pulse 1 s after its begin."""
    random = np.random.default_rng(seed)
    stamps = np.arange(round((wait + 3.0) * RATE)) / RATE
    values = np.exp(-(((stamps[:, None] - wait - 1.0) / 0.3) ** 2)) + 0.02 * random.standard_t(3, (len(stamps), 2))
    wait_name, work_name = elements or ("wait", "work")
    return Samples(values, stamps, ("left", "right"), ((0.0, wait_name), (wait, work_name)))


@cache
def mission_model() -> TrainedModel:
    waits = np.random.default_rng(1).uniform(2.0, 5.0, RUNS)
    return fit([mission(seed, wait) for seed, wait in enumerate(waits)], CONFIG)


def test_the_active_element_tells_the_phase_of_runs_that_wait_for_different_times():
    made, threshold = mission_model(), np.array(mission_model().thresholds)
    assert list(made.elements) == ["wait", "work"]
    usual = [losses(made, mission(50 + n, wait), 5).values.max() for n, wait in enumerate((2.5, 3.5, 4.5))]
    assert (np.array(usual) < threshold.max()).sum() >= 2
    flat = mission(60, 3.0)
    flat.values[flat.stamps > 3.5] *= 0.0
    assert (losses(made, flat, 5).values > threshold).any()  # no pulse, where one belongs


def test_filtered_runs_keep_their_elements():
    made = fit([mission(seed, 2.0 + 0.3 * seed) for seed in range(RUNS)], replace(CONFIG, before=10.0))
    assert list(made.elements) == ["wait", "work"]


def test_without_elements_windows_are_judged_by_all_and_values_in_an_element_of_no_training_run_are_not_judged():
    made, known = mission_model(), mission(70, 3.0)
    bare = losses(made, Samples(known.values, known.stamps, known.names), 5)
    assert len(bare) == len(losses(made, known, 5))
    (judged,) = judge_trained(made, [labelled(mission(70, 3.0, "wait", "sort"))], "m").runs
    assert judged.share == pytest.approx(0.5, abs=0.02)
    order = ("work was left out", "sort is new: no training run had it")
    assert judged.notes == ("no training run had the element sort: not judged", *order)
    assert judged.verdict == "anomalous"  # for the order alone


def labelled(run: Samples) -> LabelledRun:
    return LabelledRun(run, np.ones(len(run), dtype=np.int64), "a.csv")


@pytest.mark.long
def test_elements_come_from_a_column_of_texts(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    lines = ["stamp,run,left,task,right"]
    for number in range(RUNS):
        run = mission(number, 2.0 + 0.2 * number)
        names, _ = active(run.stamps, run.elements)
        rows = zip(run.stamps, run.values, names, strict=True)
        lines += [f"{stamp},{number},{left},{name},{right}" for stamp, (left, right), name in rows]
    (tmp_path / "runs.csv").write_text("\n".join(lines) + "\n")
    words = ("--data", tmp_path / "runs.csv", "--element-column", "task", "-o", tmp_path / "m.skops")
    code, found = told(capsys, "monitor", "train", *words, "--detector", "phase")
    assert (code, found["detector"]) == (0, "phase")
    assert list(TrainedModel.load(tmp_path / "m.skops").elements) == ["wait", "work"]
    lines[-40:] = [line.replace(line.split(",")[2], "1.5") for line in lines[-40:]]
    (tmp_path / "new.csv").write_text(
        "\n".join([lines[0], *(line for line in lines if line.split(",")[1] == "11")]) + "\n"
    )
    page = tmp_path / "report.html"
    code, found = told(capsys, "monitor", "judge", tmp_path / "m.skops", tmp_path / "new.csv", "-o", page)
    assert code == 1
    assert found["runs"][0]["events"][-1]["explanations"][0].startswith("left in work: 1.5 at ")
    assert re.search(r"left \d+ % in work: 1\.5 at ", page.read_text())
    assert "training runs</text>" in page.read_text()  # the band, in the legend


EFFORTS = """Inputs:
  Efforts: {Topic: joint_states, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Outputs:
  Loss: {Topic: loss, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Processor: {Class: Autoencoder}
"""


class Arm:
    """A robot on simulated time that publishes a run, and batches of what its mission waits for."""

    def __init__(self, folder: Path) -> None:
        (folder / "unit.yaml").write_text(EFFORTS)
        self.configuration = load(folder / "unit.yaml")
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        node = self.middleware.node("engine", "arm")
        self.states, self.events = node.publisher("joint_states", STATE), node.publisher("bpmn_events", STRING)
        self.losses: list[Any] = []
        node.subscription("loss", STATE, self.losses.append)

    def tell(self, batch: int, time: float, element: str, gone: str = "") -> None:
        opens = [{"scope": batch, "instance": 1, "inside": [element]}]
        opening = ["events", round(time * SECOND), {"opens": opens, "events": []}]
        token = {"key": element, "scope": batch, "element": "inner"}
        waiting = ["waiting", round(time * SECOND), {"tokens": [token], "gone": [gone]}]
        begins = {"begins": "Process"} if batch == 1 else {}
        told = {
            "batch": batch,
            "epoch": "1970-01-01T00:00:00Z",
            "time": round(time * SECOND),
            "changes": [opening, waiting],
        }
        self.events.publish(messages.create(STRING, {"data": json.dumps(told | begins)}))

    def play(self, run: Samples) -> None:
        changes = list(enumerate(run.elements, start=1))
        for stamp, effort in zip(run.stamps + 0.02, run.values, strict=True):
            self.scheduler.run(round(stamp * SECOND))
            if changes and changes[0][1][0] <= stamp:
                number, (begin, name) = changes.pop(0)
                self.tell(number, begin, name, run.elements[number - 2][1] if number > 1 else "")
            header = {"stamp": float(stamp)}
            self.states.publish(messages.create(STATE, {"header": header, "name": run.names, "effort": effort}))
        self.scheduler.run(self.scheduler.now + SECOND)


def test_a_node_takes_the_active_element_from_the_events_of_the_robot(tmp_path: Path):
    arm, run = Arm(tmp_path), mission(70, 3.0, "wait", "sort")
    made = replace(mission_model(), columns=("Efforts.left", "Efforts.right"))
    said: list[str] = []
    node = ProcessingNode(
        arm.middleware, arm.scheduler, arm.configuration, processors=[Autoencoder(made)], namespace="arm",
        report=said.append,
    )  # fmt: skip
    arm.play(run)
    node.close()
    assert arm.losses[-1].header.stamp.sec in (2, 3)  # not judged behind the begin of an element that is not known
    assert any("no training run had the element sort: not judged" in text for text in said)


def test_a_recorder_writes_the_active_element_and_a_lost_batch_makes_it_unknown(tmp_path: Path):
    arm = Arm(tmp_path)
    node = RecordingNode(
        arm.middleware, arm.scheduler, arm.configuration, [tmp_path / "runs.csv"],
        RecordingOptions(namespace="arm", elements=True),
    )  # fmt: skip
    arm.play(mission(70, 3.0))
    arm.tell(9, 7.0, "other")
    arm.scheduler.run(8 * SECOND)
    state = {"header": {"stamp": 8.0}, "name": ("left", "right"), "effort": (0.0, 0.0)}
    arm.states.publish(messages.create(STATE, state))
    arm.scheduler.run(9 * SECOND)
    node.close()
    (run,) = read_labelled_runs([tmp_path / "runs.csv"])
    assert [(round(stamp, 1), name) for stamp, name in run.samples.elements] == [
        (0.0, "wait"), (3.0, "work"), (8.0, ""),
    ]  # fmt: skip


def test_after_a_broken_batch_the_element_is_unknown():
    follower, begin = ElementFollower(), {"epoch": "1970-01-01T00:00:00Z"}
    key = RobotState("p").to_key()
    for batch in ({"batch": 1, "time": 0, "key": key, "changes": []}, {"batch": 2, "time": 1, "changes": [["enter"]]}):
        follower.on_message(messages.create(STRING, json.dumps(begin | batch)))
    assert follower._state is None


def test_a_missing_element_in_parquet_is_not_known(tmp_path: Path):
    frame = pytest.importorskip("pandas").DataFrame({"stamp": [0.0, 1.0], "v": [1.0, 2.0], "element": ["work", None]})
    frame.to_parquet(tmp_path / "run.parquet")
    assert read_parquet(tmp_path / "run.parquet", element="element").elements == ("work", "")


def lively(seed: int, late: float = 0.0, of: Sequence[int] = (0, 1)) -> Samples:
    """A run that moves from its begin on; what channels `of` it do is `late` (s)."""
    random = np.random.default_rng(seed)
    stamps = np.arange(round(6.0 * RATE)) / RATE
    at = stamps[:, None] - late * np.isin([0, 1], of)
    wave = np.where(at > 0, np.sin(2 * np.pi * np.maximum(at, 0) / np.array([3.0, 2.0])), 0.0)
    pulses = np.exp(-(((at - [2.0, 4.0]) / 0.3) ** 2))
    return Samples(
        wave * np.exp(-at.clip(0)) + pulses + 0.02 * random.standard_t(3, at.shape), stamps, ("left", "right")
    )


@cache
def lively_model() -> TrainedModel:
    return fit([lively(seed) for seed in range(RUNS)], replace(CONFIG, margin=1.5))


def lively_stream(count: int, missing: int = 0, pause: float = 0.5) -> Samples:
    """Cycles of `lively`, in one of which, counted from 1, the second channel's pulse at 4 s is missing."""
    parts = []
    for number in range(1, count + 1):
        cycle = lively(400 + number)
        if number == missing:
            cycle.values[:, 1] -= np.exp(-(((cycle.stamps - 4.0) / 0.3) ** 2))
        rest = 0.02 * np.random.default_rng(number).standard_t(3, (round(pause * RATE), 2))
        parts.append(np.concatenate([cycle.values, rest]))
    values = np.concatenate(parts)
    return Samples(values, np.arange(len(values)) / RATE, ("left", "right"))


@pytest.mark.parametrize("missing", [1, 4, 20])
def test_a_missing_step_is_found_in_every_cycle_of_a_machine_that_never_stops(missing: int):
    length = 6.5
    (judged,) = judge_trained(lively_model(), [labelled(lively_stream(20, missing))], "m").runs
    assert [int(event.start // length) + 1 for event in judged.events] == [missing]
    assert judged.events[0].start % length == pytest.approx(4.0, abs=0.8)


def test_live_a_cycle_is_found_in_however_many_calls():
    given = lively_stream(4, 3)
    for frequency in (0.0, 7.0, 50.0):
        found = processors.run([Autoencoder(lively_model(), stride=5)], {"x": given}, frequency)["loss"]
        above = found.stamps[(found.values > lively_model().thresholds).any(axis=1)]
        assert {int(stamp // 6.5) for stamp in above} == {2}
        assert (np.diff(found.stamps) > 0).all()


def test_what_lies_outside_of_every_run_is_not_judged():
    given = lively_stream(2, pause=6.0)
    (judged,) = judge_trained(lively_model(), [labelled(given)], "m").runs
    assert (judged.events, judged.verdict) == ((), "not judged")
    assert judged.share == pytest.approx(0.5, abs=0.05)
    assert "outside of every run, or longer than any run of the training: not judged" in judged.notes


@pytest.mark.parametrize("late", [-0.2, -0.1, 0.05, 0.1, 0.13, 0.2])
def test_a_whole_run_may_be_late(late: float):
    assert (losses(lively_model(), lively(300, late), 5).values / lively_model().thresholds).max() < 1
    strict = fit([lively(seed) for seed in range(RUNS)], replace(CONFIG, start_within=0.0, margin=1.5))
    assert (losses(strict, lively(300, late), 5).values / strict.thresholds).max() > 1


def test_one_channel_that_is_late_against_the_others_is_a_fault():
    late = losses(lively_model(), lively(301, 0.2, of=(1,)), 5).values / lively_model().thresholds
    assert late.max() > 1


def test_a_step_that_is_late_against_the_run_is_a_fault():
    given = lively(302)
    given.values[150:] = lively(302, 0.2).values[150:]  # since 3 s
    late = losses(lively_model(), given, 5)
    above = late.stamps[(late.values > lively_model().thresholds).any(axis=1)]
    assert 3.0 < above[0] < 4.8


def test_a_run_that_is_late_is_judged_whole():
    (judged,) = judge_trained(lively_model(), [labelled(lively(303, 0.2))], "m").runs
    assert (judged.verdict, judged.share) == ("benign", 1.0)


def test_the_card_says_how_the_begin_of_a_run_is_found():
    (text,) = card_of(lively_model())["Begin of a run"]
    assert re.fullmatch(
        r"a run begins where the data are like the first [\d.]+ s .*: up to [\d.]+; all else .* more", text
    )
    turning = []
    for seed in range(RUNS):
        stamps, noise = run(seed).stamps, np.random.default_rng(seed).standard_normal((len(run(seed)), 2))
        turning.append(Samples(np.sin(np.pi * stamps)[:, None] + 0.1 * noise, stamps, ("left", "right")))
    (text,) = card_of(fit(turning, CONFIG))["Begin of a run"]
    assert text == "a run cannot be told by its begin: other parts of the training runs are like it"
