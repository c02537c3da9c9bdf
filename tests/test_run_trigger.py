"""A trigger, such as a digital input, says when a run begins and ends: live, in bags and in tables alike."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor.data_files import Special, read_labelled_runs
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.join import Join
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.recording import RecordingNode
from fame.monitor.pipeline.run_trigger import RunTracker, RunTrigger, begins_within, spans_of
from fame.monitor.pipeline.train import Training, train
from fame.monitor.pipeline.trained_model import TrainedModel
from tests.monitor_runs import told

RATE, RUN = 25.0, 4.0
STATE, BOOL = "sensor_msgs/msg/JointState", "std_msgs/msg/Bool"
INPUTS = """\
Inputs:
  Efforts: {Topic: joint_states, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Outputs:
  Loss: {Topic: loss, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Run: {Topic: cell/busy, Ends: 0}
"""
TRAINING = """\
Training:
  {Files: [day.csv], Model: model.skops, Detector: phase, Window: 10, FalseAlarms: 0.1 per run, Margin: 2}
"""
SPAN = RunTrigger(starts="== 1", ends="== 0")


def day(count: int, seed: int, missing: int = -1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, values and the trigger of so many runs with rests of many lengths, in which the arm moves as well."""
    random, values, busy = np.random.default_rng(seed), [], []
    for number in range(count):
        rest = round(random.uniform(1.0, 3.0) * RATE)
        at = np.arange(round(RUN * RATE))[:, None] / RATE
        pulses = np.exp(-(((at - [1.0, 2.5]) / 0.25) ** 2)) * [1.0, number != missing]
        values += [np.cumsum(0.2 * random.standard_normal((rest, 2)), axis=0), pulses]
        busy += [np.zeros(rest), np.ones(len(at))]
    every = np.concatenate(values)
    every += 0.02 * random.standard_normal(every.shape)
    return np.arange(len(every)) / RATE + 100.0, every, np.concatenate(busy)


def write(path: Path, stamps: np.ndarray, values: np.ndarray, busy: np.ndarray) -> Path:
    rows = np.column_stack((stamps, values, busy))
    np.savetxt(path, rows, "%.6g", ",", header="stamp,Efforts.a,Efforts.b,trigger", comments="")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration with a trigger, and a model that was trained by it on one recording of 24 runs."""
    folder = tmp_path_factory.mktemp("trigger")
    (folder / "unit.yaml").write_text(INPUTS + TRAINING)
    write(folder / "day.csv", *day(25, 1))
    assert main(["monitor", "train", str(folder / "unit.yaml"), "--keep"]) == 0
    return folder


def play(
    folder: Path, stamps: np.ndarray, values: np.ndarray, busy: np.ndarray, make: Any, *, call: bool = False
) -> list[Any]:
    """Publish a recording to a node, the trigger only when it changes; with `call` by calls of a service.

    Return the losses that come."""
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    arm, heard = middleware.node("arm"), list[Any]()
    states, trigger = arm.publisher("joint_states", STATE), arm.publisher("cell/busy", BOOL)
    arm.subscription("loss", STATE, heard.append)
    node, before = make(middleware, scheduler), None
    client, answers = arm.client("cell/run", "std_srvs/srv/SetBool"), list[Any]()
    for stamp, row, now in zip(stamps.tolist(), values, busy.tolist(), strict=True):
        scheduler.run(round(stamp * SECOND))
        if now != before and now >= 0:
            if not call:
                trigger.publish(messages.create(BOOL, {"data": bool(now)}))
            else:
                client.call({"data": bool(now)}, answers.append)
            before = now
        states.publish(messages.create(STATE, {"header": {"stamp": stamp}, "name": ("a", "b"), "effort": row}))
    scheduler.run(scheduler.now + SECOND)
    node.close()
    assert all(each.success for each in answers)
    return heard


def verdicts(capsys: pytest.CaptureFixture[str], *command: str) -> list[str]:
    capsys.readouterr()
    main(["monitor", "judge", *command, "--json"])
    return [run["verdict"] for run in json.loads(capsys.readouterr().out)["runs"]]


def test_a_table_is_cut_into_runs_by_its_column(folder: Path, capsys: pytest.CaptureFixture[str]):
    made = TrainedModel.load(folder / "model.skops")
    assert made.columns == ("Efforts.a", "Efforts.b")  # the trigger is no channel
    assert made.conditions["runs"] == 24  # the file ends before the last one does
    assert made.conditions["seconds"] == pytest.approx([RUN - 1 / RATE] * 2)
    found = verdicts(capsys, str(folder / "model.skops"), str(write(folder / "new.csv", *day(5, 2, missing=2))))
    assert found == ["benign", "benign", "anomalous", "benign", "benign"]


@pytest.mark.parametrize(("first", "said"), [(0, False), (20, True)])
def test_a_run_that_is_under_way_when_a_file_begins_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str], first: int, said: bool
):
    stamps, values, busy = day(3, 2)
    begin = int(np.flatnonzero(busy)[0]) + first if first else 0
    file = write(folder / "cut.csv", stamps[begin:], values[begin:], busy[begin:])
    main(["monitor", "judge", str(folder / "model.skops"), str(file)])
    assert ("a run was under way when the file began" in capsys.readouterr().out) == said


def test_the_card_says_that_a_trigger_begins_a_run(folder: Path, capsys: pytest.CaptureFixture[str]):
    main(["monitor", "model", "show", str(folder / "model.skops")])
    assert "a trigger: a run begins when trigger becomes == 1, and ends when it becomes == 0" in capsys.readouterr().out


def test_live_the_topic_begins_and_ends_runs(folder: Path):
    made = TrainedModel.load(folder / "model.skops")
    stamps, values, busy = day(5, 3, missing=3)
    losses = play(
        folder, stamps, values, busy,
        lambda middleware, scheduler: ProcessingNode(
            middleware, scheduler, load(folder / "unit.yaml"), processors=[Autoencoder(made)]
        ),
    )  # fmt: skip
    begins = stamps[np.flatnonzero(np.diff(busy) > 0) + 1]
    ends = np.array([each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in losses])
    since = ends - begins[np.searchsorted(begins, ends + 1e-6) - 1]
    assert ((since >= 9 / RATE - 0.02) & (since <= RUN)).all()  # windows that are wholly in a run
    above = np.array([(np.array(each.effort) > made.thresholds).any() for each in losses])
    assert set(np.searchsorted(begins, ends[above] + 1e-6).tolist()) == {4}


def test_live_what_lasts_longer_than_any_run_is_not_judged(folder: Path):
    stamps, values, busy = day(1, 3)
    rest = np.random.default_rng(0).standard_normal((200, 2))
    values, busy = np.concatenate((values, rest)), np.concatenate((busy, np.ones(200)))
    stamps = stamps[0] + np.arange(len(values)) / RATE
    losses = play(
        folder, stamps, values, busy,
        lambda *parts: ProcessingNode(
            *parts, load(folder / "unit.yaml"), processors=[Autoencoder(TrainedModel.load(folder / "model.skops"))]
        ),
    )  # fmt: skip
    last = losses[-1].header.stamp
    begin = stamps[busy.argmax()]
    assert RUN - 0.3 < last.sec + 1e-9 * last.nanosec - begin < RUN + 0.3


def test_a_bag_is_judged_as_the_table_that_was_recorded_with_it(folder: Path, capsys: pytest.CaptureFixture[str]):
    outputs = [folder / "both.csv", folder / "both"]
    configuration = load(folder / "unit.yaml")
    play(folder, *day(5, 4, missing=1), lambda *parts: RecordingNode(*parts, configuration, outputs))
    model = str(folder / "model.skops")
    table = verdicts(capsys, model, str(outputs[0]))
    assert table == ["benign", "anomalous", "benign", "benign", "benign"]
    assert verdicts(capsys, model, str(outputs[1]), "--config", str(folder / "unit.yaml")) == table


def test_a_service_begins_and_ends_runs_in_files_and_live(folder: Path, capsys: pytest.CaptureFixture[str]):
    unit, outputs, model = folder / "service.yaml", [folder / "calls.csv", folder / "calls"], folder / "model.skops"
    unit.write_text(INPUTS.replace("Topic: cell/busy", "Service: cell/run"))
    configuration, run = load(unit), day(5, 4, missing=1)
    play(folder, *run, lambda *parts: RecordingNode(*parts, configuration, outputs), call=True)
    table = verdicts(capsys, str(model), str(outputs[0]))
    assert table == ["benign", "anomalous", "benign", "benign", "benign"]
    assert verdicts(capsys, str(model), str(outputs[1]), "--config", str(unit)) == table
    made = TrainedModel.load(model)
    losses, asked = (
        play(folder, *run, partial(ProcessingNode, configuration=load(each), processors=[Autoencoder(made)]), call=call)
        for each, call in ((unit, True), (folder / "unit.yaml", False))
    )
    assert [(each.header.stamp, list(each.effort)) for each in losses] == [
        (each.header.stamp, list(each.effort)) for each in asked
    ]


def test_a_recording_has_a_column_of_the_trigger_before_its_first_value(folder: Path):
    busy = np.repeat([-1, 1, 0], [12 * round(RATE), 25, 25])  # silent for longer than other topics may be
    values, stamps = np.zeros((len(busy), 2)), 100 + np.arange(len(busy)) / RATE
    unit, file = load(folder / "unit.yaml"), folder / "late.csv"
    play(folder, stamps, values, busy, lambda *parts: RecordingNode(*parts, unit, [file]))
    (run,) = read_labelled_runs([file], special=Special(trigger=SPAN._replace(calls=True)))
    assert len(run.samples) == 25


def test_each_call_of_a_service_begins_a_run():
    calls = RunTrigger(calls=True)
    assert spans_of(calls, np.arange(4.0), np.array([1, 1, np.nan, 1])) == [(0, 1), (1, 3), (3, np.inf)]
    assert not begins_within(calls, np.ones(2))


def test_what_the_value_was_before_the_first_one_is_not_known():
    stamps = np.arange(8.0)
    assert spans_of(SPAN, stamps, np.array([1, 1, 0, 1, 1, 0, 0, 1])) == [(3.0, 5.0), (7.0, np.inf)]
    above = RunTrigger(starts="> 0.5")
    assert spans_of(above, stamps, np.array([0, 0.6, np.nan, 0.9, 0.2, 0.1, 0.7, 0])) == [(1.0, 6.0), (6.0, np.inf)]
    tracker = RunTracker(above)
    for stamp in range(300):
        tracker.feed(stamp, stamp % 2)
    assert len(tracker.spans) < 110


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("{Topic: busy, Starts: often}", "Run.Starts: expected a number, true, false, or a comparison such as"),
        ("{Topic: busy, Starts: 1, Ends: true}", "Run.Ends: is the condition of Starts, too (== 1): expected another"),
        ("{Starts: 1}", "Run: expected the key Topic: a digital input, such as {Topic: input_3, Starts: 1}"),
        ("{Topic: busy, Field: level}", "Run.Field: std_msgs/msg/Bool: there is no field level"),
        ("{Topic: joint_states, Field: effort}", "Run.Field: expected one number or boolean of sensor_msgs/msg/Joint"),
        (
            "{Topic: busy, Column: efforts}",
            "Run.Column: the value of the trigger is called efforts, and so is",
        ),
        ("{Topic: busy, Begin: 1}", "Run.Begin"),
        ("{Service: busy, Topic: busy}", "Run: got the keys Service and Topic: expected a topic or a service"),
    ],
)
def test_a_wrong_trigger_is_said_with_its_place(tmp_path: Path, line: str, text: str):
    unit = tmp_path / "unit.yaml"
    unit.write_text(INPUTS.replace("{Topic: cell/busy, Ends: 0}", line))
    with pytest.raises(ConfigError) as error:
        load(unit)
    assert str(error.value).startswith(f"{unit}:5: ")
    assert text in str(error.value)


def test_a_file_without_the_column_or_without_a_run_to_train_is_refused(tmp_path: Path):
    stamps, values, busy = day(3, 1)
    quiet = write(tmp_path / "quiet.csv", stamps, values, 0 * busy)
    with pytest.raises(ConfigError, match=r"quiet.csv.*: no run begins: column 'trigger' never becomes == 1 .* 0 to 0"):
        read_labelled_runs([quiet], special=Special(trigger=SPAN), undisturbed=True)
    with pytest.raises(ConfigError, match=r"quiet.csv:1: has no column 'start'"):
        read_labelled_runs([quiet], special=Special(trigger=RunTrigger("start")))


@pytest.mark.parametrize("join", [None, Join(RATE, 0.03, "hold")])
def test_a_file_without_a_run_is_not_judged_and_the_others_are(
    folder: Path, capsys: pytest.CaptureFixture[str], join: Join | None
):
    stamps, values, busy = day(3, 2)
    files = [write(folder / f"{n}.csv", stamps, values, busy * n) for n in (0, 1)]
    model = str(folder / "model.skops")
    code, found = told(capsys, "monitor", "judge", model, *files)
    assert code == 3
    assert [run["verdict"] for run in found["runs"]] == ["not judged", *["benign"] * 3]
    runs = read_labelled_runs(files, special=Special(trigger=SPAN, join=join))
    assert [len(run.samples) > 0 for run in runs] == [False, True, True, True]
    assert runs[0].notes[0].startswith("no run begins: column 'trigger' never becomes == 1 (Run: Starts)")
    assert runs[1].notes[0].endswith("rows lie outside of every run: not judged")


def test_true_and_false_are_values_of_a_trigger(tmp_path: Path):
    file = write(tmp_path / "day.csv", *day(3, 1))
    numbers, lines = (read_labelled_runs([file], special=Special(trigger=SPAN)), file.read_text().splitlines())
    words = [f"{line[:-1]}{('False', 'true')[int(line[-1])]}" for line in lines[1:]]
    file.write_text("\n".join([lines[0], *words]))
    read = read_labelled_runs([file], special=Special(trigger=SPAN))
    assert [run.samples.values.tolist() for run in read] == [run.samples.values.tolist() for run in numbers]
    file.write_text("stamp,a,label\n1,2,true\n")  # may as well mean that it is anomalous
    with pytest.raises(ConfigError, match="expected a number in column 'label', got 'true'"):
        read_labelled_runs([file])


@pytest.mark.parametrize(("trigger", "why"), [(SPAN, "does"), (RunTrigger(), r"does, since .* says .* \(Run: Ends\)")])
def test_training_says_that_the_last_run_of_a_file_is_left_out(folder: Path, trigger: RunTrigger, why: str):
    settings = Training((str(folder / "day.csv"),), str(folder / "none"), window=10, detector="pca", run=trigger)
    (text,) = train(settings, keep=True).conditions["missing"]
    found = r"1 of 25 runs is not known as a whole, run 24 to 0 %: the last run of day.csv is left out"
    assert re.fullmatch(rf"{found}: the file ends before it {why}", text)
