"""``fame monitor process``, ``record``, ``train``; ``fame param``, ``topic``; over DDS between processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from domains import PROCESSES as DOMAIN

from fame.cli import main
from fame.cli.monitor import ros
from fame.cli.monitor.pipelines import _plot_training, _values_of
from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.interface import LATCHED
from fame.middleware.local import LocalMiddleware
from fame.monitor.data_files import read_runs
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.processors import make_processors
from fame.monitor.pipeline.threshold import Threshold
from fame.monitor.pipeline.topic_tools import format_message
from fame.monitor.pipeline.train import Training, fit
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.monitor.plots import plot_loss

ROOT = Path(__file__).parent.parent
MONITOR = ROOT / "models" / "monitoring" / "joint_monitor"
JOINT_STATE = "sensor_msgs/msg/JointState"
EFFORTS = {"Topic": "joint_states", "Field": ["effort"], "MessageType": JOINT_STATE}
PATIENCE = 120 * SECOND


@pytest.fixture
def low_pass(tmp_path: Path) -> Path:
    """A configuration."""
    filtered = {"Filtered": {**EFFORTS, "Topic": "filtered"}}
    stage = {"Class": "LowPass", "Parameters": {"cutoff": 20}}
    path = tmp_path / "low_pass.yaml"
    path.write_text(yaml.safe_dump({"Inputs": {"Efforts": EFFORTS}, "Outputs": filtered, "Processor": stage}))
    return path


def test_training_prints_a_table_stores_the_model_and_knows_it_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random = np.random.default_rng(0)
    rows = [
        f"{0.01 * index:.3f},{run},{np.sin(index / 9):.6f},{random.normal():.6f}"
        for run in range(3) for index in range(60)
    ]  # fmt: skip
    (tmp_path / "a.csv").write_text("\n".join(["stamp,run,Efforts.elbow,Efforts.wrist", *rows]) + "\n")
    training = {"Files": ["*.csv"], "Detector": "autoencoder", "Window": 10, "Hidden": [3], "Epochs": 2}
    training["Model"] = "out/m.skops"
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({"Training": training}))  # a CSV is enough
    command = ["monitor", "train", str(tmp_path / "c.yaml")]
    assert main([*command, "--onnx", str(tmp_path / "m.onnx")]) == 0
    out = capsys.readouterr().out
    assert "Efforts.wrist" in out
    assert "10-3-10 per channel, windows of 10 samples at 100 Hz" in out
    assert (
        TrainedModel.load(tmp_path / "m.onnx").thresholds == TrainedModel.load(tmp_path / "out" / "m.skops").thresholds
    )
    assert main([*command, "--check", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["columns"] == ["Efforts.elbow", "Efforts.wrist"]
    with (tmp_path / "a.csv").open("a") as stream:
        stream.write("9.0,2,0,0\n")
    assert main([*command, "--check"]) == 2
    assert "is stale" in capsys.readouterr().err
    loss = {"Loss": {**EFFORTS, "Topic": "loss"}}
    stage = {"Class": "Autoencoder", "Parameters": {"model": "out/m.skops"}}
    sections = {"Inputs": {"Efforts": EFFORTS}, "Outputs": loss, "Training": training, "Processor": stage}
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(sections))
    assert main(["monitor", "process", str(tmp_path / "c.yaml")]) == 2
    assert "is stale: trained on data" in capsys.readouterr().err
    for wrong, said in (
        ({"Windw": 10}, "is stale: trained on data"),  # the other settings say nothing about the data
        ({"Window": "wide"}, "is stale: trained on data"),
        ({"Files": [3]}, r"Training\.Files\[0\]: expected a text, got 3"),
    ):
        (tmp_path / "c.yaml").write_text(yaml.safe_dump({**sections, "Training": training | wrong}))
        with pytest.raises(ConfigError, match=said):
            make_processors(load(tmp_path / "c.yaml"))
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({**sections, "Training": training | {"Files": ["runs/*.csv"]}}))
    (processor,) = make_processors(load(tmp_path / "c.yaml"))  # trained elsewhere: its data are not here
    assert processor.trained.columns == ("Efforts.elbow", "Efforts.wrist")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["monitor", "process", "none.yaml"], "none.yaml: cannot be read: No such file or directory"),
        (
            ["monitor", "process", "{low_pass}", "--processor", "Lowpass"],
            "expected a processor, module:Class or file.py:Class, got 'Lowpass'; did you mean 'LowPass'?",
        ),
        (["monitor", "process", "{low_pass}", "--set", "cutoff"], "expected NAME=VALUE, as in cutoff=5, got 'cutoff'"),
        (["monitor", "process", "{low_pass}", "--frequency", "0"], "expected a number above 0, got '0'"),
        (["monitor", "record", "{low_pass}", "-o", "x.csv", "--bag", "none.bag"], "none.bag: is not a readable bag"),
        (["monitor", "process", "{low_pass}", "--set", "cut=5"], "cut: unknown parameter; known are cutoff"),
        (
            ["monitor", "record", "{low_pass}", "-o", "x.csv", "--bag", "b", "--duration", "3"],
            "--duration is for listening",
        ),
        (["monitor", "train", "{low_pass}", "--onnx-single"], "--onnx-single is about the file of --onnx"),
        (["monitor", "train", "{low_pass}"], "has no section Training"),
        (["topic", "plot", "/a", "-o", "x.png"], "expected /topic:field"),
        (["topic", "plot", "/a:b", "-o", "x.svg"], "expected a file with the ending .png, got '.svg'"),
    ],
)
def test_a_wrong_request_is_one_line_and_exit_code_2(
    low_pass: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    assert main([argument.format(low_pass=low_pass) for argument in arguments]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_a_parameter_is_set_on_every_node_that_has_it_and_refused_if_none_has(low_pass: Path) -> None:
    chains = [make_processors(load(low_pass)), [Threshold(threshold=1.0)], make_processors(load(low_pass))]
    values = [("cutoff", 5), ("threshold", 2), ("cutoff", 7)]
    cutoffs = [("cutoff", 5), ("cutoff", 7)]
    assert _values_of(chains, values) == [cutoffs, [("threshold", 2)], cutoffs]
    with pytest.raises(ConfigError, match=r"cut: unknown parameter; known are cutoff, .*threshold"):
        _values_of(chains, [("cut", 5)])


@pytest.mark.parametrize("lengths", [(60, 60, 60), (60, 5, 60)])
def test_each_plot_has_the_number_of_its_run_and_only_plots_are_counted(
    lengths: tuple[int, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fame.monitor.plots.plot_loss", lambda loss, path, **_: path.touch())
    rows = [
        f"{0.01 * index:.3f},{run},{np.sin(index / 9 + run / 9):.6f}"
        for run, long in enumerate(lengths)
        for index in range(long)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["stamp,run,elbow", *rows]) + "\n")
    training = Training(files=(str(tmp_path / "a.csv"),), window=10, detector="pca")
    model = fit(read_runs(training.files), training)
    _plot_training(tmp_path / "plots", model, training)
    long = [number for number, length in enumerate(lengths) if length == 60]
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == [f"run_{number:03d}.png" for number in long]
    assert f"{len(long)} plots in " in capsys.readouterr().err


def test_the_graph_of_a_pipeline_shows_nodes_and_topics_in_order(tmp_path: Path) -> None:
    files = [str(MONITOR / f"{name}.yaml") for name in ("low_pass", "autoencoders", "loss_low_pass", "threshold")]
    assert main(["monitor", "process", *files, "--graph", str(tmp_path / "g.svg")]) == 0
    drawn = ElementTree.parse(tmp_path / "g.svg").getroot()
    boxes = [each for each in drawn if each.tag.endswith("rect")]
    texts = [each.text for each in drawn if each.tag.endswith("text") and each.get("class") is None]
    places = {text: float(box.get("x", 0)) for text, box in zip(texts, boxes, strict=True)}
    order = ["/joint_states", "low_pass", "/joint_efforts_filtered", "autoencoders", "/joint_losses", "loss_low_pass",
             "/joint_losses_filtered", "threshold", "/anomaly"]  # fmt: skip
    assert sorted(places, key=lambda name: places[name]) == order
    assert sum(each.tag.endswith("path") for each in drawn) == 8


def test_a_processor_that_does_not_exist_is_not_drawn(
    low_pass: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    low_pass.write_text(low_pass.read_text().replace("LowPass", "LwoPass"))
    assert main(["monitor", "process", str(low_pass), "--graph", str(tmp_path / "g.svg")]) == 2
    assert "did you mean 'LowPass'?" in capsys.readouterr().err


@pytest.mark.long
def test_losses_are_drawn_with_thresholds_and_alarms(tmp_path: Path) -> None:
    loss = Samples(np.abs(np.random.default_rng(0).normal(size=(50, 2))), np.arange(50.0), ("elbow", "wrist"))
    plot_loss(loss, tmp_path / "bare.png")
    plot_loss(loss, tmp_path / "loss.png", thresholds=[1.0, 2.0], title="a run")
    bare, told = (path.read_bytes() for path in (tmp_path / "bare.png", tmp_path / "loss.png"))
    assert told.startswith(b"\x89PNG")
    assert told != bare


# ---- over DDS --------------------------------------------------------------------------------------------------------


class Arm:
    """Publishes efforts of two joints at 100 Hz while something runs."""

    def __init__(self) -> None:
        from fame.middleware.dds import DdsMiddleware, DdsScheduler

        self.scheduler = DdsScheduler()
        self.middleware = DdsMiddleware(self.scheduler, domain=DOMAIN)
        node = self.middleware.node("arm")
        self.joints = node.publisher("/joint_states", JOINT_STATE)
        self.filtered: list[Any] = []
        node.subscription("/filtered", JOINT_STATE, self.filtered.append)
        self.count = 0

    def step(self) -> None:
        self.count += 1
        header = {"stamp": {"sec": 100 + self.count // 100, "nanosec": self.count % 100 * 10_000_000}}
        content = {"header": header, "name": ["elbow", "wrist"], "effort": [1.0, 2.0]}
        self.joints.publish(messages.create(JOINT_STATE, content))
        self.scheduler.run(self.scheduler.now + SECOND // 100)

    def while_running(self, *commands: tuple[str, ...]) -> list[tuple[int, str, str]]:
        """Publish until all these commands have ended; the exit code of each, and what it printed."""
        processes = [fame(*command) for command in commands]
        end = self.scheduler.now + PATIENCE
        try:
            while any(process.poll() is None for process in processes):
                assert self.scheduler.now < end, "they did not end"
                self.step()
        finally:
            for process in processes:
                process.kill()
            said = [process.communicate() for process in processes]
        return [(process.returncode, *told) for process, told in zip(processes, said, strict=True)]


def fame(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "fame", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


@pytest.fixture
def arm() -> Iterator[Arm]:
    pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")
    made = Arm()
    yield made
    made.middleware.close()


@pytest.mark.processes
@pytest.mark.dds
def test_a_node_in_another_process_filters_and_its_parameters_change_from_a_third(arm: Arm, low_pass: Path) -> None:
    node = fame("monitor", "process", str(low_pass), "--set", "cutoff=7")
    try:
        end = arm.scheduler.now + PATIENCE
        while len(arm.filtered) < 20:
            assert arm.scheduler.now < end, "nothing came back"
            arm.step()
        assert arm.filtered[-1].name == ["elbow", "wrist"]
        (changed,) = arm.while_running(("param", "set", "/low_pass", "cutoff", "5"))
        assert changed == (0, "5\n", "")
        listed, refused = arm.while_running(
            ("param", "list", "/low_pass", "--json"), ("param", "set", "/low_pass", "cutoff", "-1")
        )
        assert (listed[0], json.loads(listed[1])["parameters"]) == (
            0,
            {"cutoff": 5.0, "rate": 0.0, "use_sim_time": False},
        )
        assert (refused[0], "expected a number of 1e-06 or more Hz, got -1.0" in refused[2]) == (2, True)
    finally:
        node.send_signal(signal.SIGINT)
        _, said = node.communicate(timeout=60)
    assert node.returncode == 0
    assert "low_pass: cutoff is 5.0 now" in said


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        (["'1e-3'", "--count", "2"], ["1e-3"] * 2),
        (["data: NO"], ["NO"]),
        ([], [""]),
        (["x", "--rate", "4", "--duration", "1"], ["x"] * 4),
    ],
)
def test_messages_are_published_once_or_at_a_rate(
    words: list[str], sent: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scheduler = Scheduler()
    middleware, heard = LocalMiddleware(scheduler), list[str]()
    monkeypatch.setattr(ros, "connected", lambda arguments: nullcontext((scheduler, middleware)))
    topic = ["topic", "pub", "x", "std_msgs/msg/String", *words]
    if "--rate" not in words:
        assert main(topic) == 1
        assert "nobody subscribes to /x with the type std_msgs/msg/String" in capsys.readouterr().err
    middleware.node("listener").subscription("/x", "std_msgs/msg/String", lambda message: heard.append(message.data))
    assert main(topic) == 0
    assert heard == sent
    assert capsys.readouterr().out.startswith(f"/x: {len(sent)} message")


def test_a_latched_message_is_shown_that_was_published_before(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    monkeypatch.setattr(ros, "connected", lambda arguments: nullcontext((scheduler, middleware)))
    publisher = middleware.node("map_server").publisher("/map_name", "std_msgs/msg/String", LATCHED)
    publisher.publish(messages.create(publisher.type, "hall"))
    assert main(["topic", "echo", "/map_name", "--duration", "2"]) == 0
    assert capsys.readouterr().out == "data: hall\n---\n"


@pytest.fixture
def speaking(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets commands find a topic ``/x`` on which these messages come, one each 0.1 s."""

    def begin(type: str, *values: object) -> None:
        scheduler = Scheduler()
        middleware = LocalMiddleware(scheduler)
        monkeypatch.setattr(ros, "connected", lambda arguments: nullcontext((scheduler, middleware)))
        publisher = middleware.node("sensor").publisher("/x", type)
        for number, value in enumerate(values):
            scheduler.after(number * SECOND // 10, partial(publisher.publish, messages.create(type, value)))

    return begin


def test_a_rate_says_how_long_a_topic_has_been_silent(
    speaking: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    speaking("std_msgs/msg/Float64", *range(20))
    assert main(["topic", "hz", "/x", "--duration", "5.5"]) == 0
    said = [line.partition("deviation 0.00")[2] for line in capsys.readouterr().out.splitlines()]
    assert said == ["", "", *(f"; silent for {seconds} s" for seconds in range(1, 5))]
    for count, code, last in ((0, 1, "/x: silent"), (1, 1, "/x: 1 message; silent for 2 s")):
        speaking("std_msgs/msg/Float64", *range(count))
        assert main(["topic", "hz", "/x", "--duration", "2"]) == code
        assert capsys.readouterr().out.splitlines()[-1] == last
    speaking("std_msgs/msg/Float64", *range(3))
    assert main(["topic", "hz", "/x", "--duration", "2", "--count", "4"]) == 1


def test_fewer_messages_than_asked_for_are_told(
    speaking: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    speaking("std_msgs/msg/Float64", *range(3))
    assert main(["topic", "echo", "/x", "--duration", "2", "--count", "4"]) == 1
    assert capsys.readouterr().err == "fame: error: /x: received 3 of 4 messages\n"


def test_a_drawing_tells_how_many_messages_it_could_not_use(
    speaking: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    short, whole = {"name": ["a"]}, {"name": ["a"], "effort": [1.0]}
    for given, code in ((short, 1), (whole, 0)):
        speaking(JOINT_STATE, short, short, given)
        assert main(["topic", "plot", "/x:effort.a", "--duration", "1", "-o", str(tmp_path / "x.png")]) == code
        assert f"/x effort.a: {3 - (given is whole)} not usable: effort has 0 values, not 1" in capsys.readouterr().err


@pytest.mark.processes
@pytest.mark.dds
def test_topics_of_another_process_are_listed_recorded_and_drawn(arm: Arm, low_pass: Path) -> None:
    csv, png = low_pass.parent / "a.csv", low_pass.parent / "a.png"
    listed, echoed, often, recorded, drawn = arm.while_running(
        ("topic", "list", "--json"),
        ("topic", "echo", "/joint_states", "--count", "2", "--field", "effort.wrist"),
        ("topic", "hz", "/joint_states", "--count", "20"),
        ("monitor", "record", str(low_pass), "-o", str(csv), "--duration", "0.5"),
        ("topic", "plot", "/joint_states:effort", "--duration", "0.5", "-o", str(png)),
    )
    topics = {each["name"]: each for each in json.loads(listed[1])["topics"]}
    assert topics["/joint_states"]["types"] == [JOINT_STATE]
    assert echoed == (0, "2.0\n2.0\n", "")
    assert (often[0], "Hz over 20 messages" in often[1]) == (0, True)
    told, *late = recorded[2].splitlines()  # on a busy machine, that messages are late, too
    assert (recorded[0], told, [one for one in late if "late: " not in one]) == (0, f"low_pass: recording to {csv}", [])
    assert csv.read_text().splitlines()[0] == "stamp,run,Efforts.elbow,Efforts.wrist"
    assert csv.read_text().splitlines()[1].endswith(",0,1,2")
    assert (drawn[0], drawn[2], png.read_bytes()[:4]) == (0, "", b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["param", "set", "/low_pass", "cutoff", "["], "is not valid YAML"),
        (["param", "set", "/low_pass", "cutoff", "!!timestamp 2026-13-45"], "month must be in 1..12"),
        (["monitor", "process", "x.yaml", "--set", "cutoff=["], "is not valid YAML"),
        (["monitor", "process", "x.yaml", "--set", "cutoff=!!timestamp 2026-13-45"], "is not valid YAML"),
        (["monitor", "process", "x.yaml", "--frequency", "1e12"], "--frequency: expected a number from"),
        (["monitor", "process", "x.yaml", "--frequency", "1e-300"], "--frequency: expected a number from"),
        (["topic", "pub", "/x", "std_msgs/msg/String", "[1"], "expected YAML as VALUES, got '[1'"),
        (["topic", "pub", "/x", "std_msgs/msg/Strin", "x"], "there is no such message type; did you mean"),
        (["topic", "pub", "/x", "geometry_msgs/msg/Twist", "{linear: {q: 1}}"], "linear.q: there is no such field"),
        (["topic", "list", "--duration", "1e300"], "--duration: expected a number above 0, got '1e300'"),
        (["monitor", "record", "x.yaml", "-o", "http://localhost:abc/robots"], "expected http://host:8086/database"),
    ],
)
def test_numbers_and_words_that_cannot_be_meant_are_a_wrong_request(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = "{Topic: x, Field: [data], MessageType: std_msgs/msg/Float64}"
    (tmp_path / "x.yaml").write_text(f"Inputs: {{X: {port}}}\nOutputs: {{Y: {port}}}\nProcessor: LowPass\n")
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("value", [0.1, 48.13715412, 1764455000.123, 1e300, 5.0, float(np.float32(0.1234567))])
def test_numbers_of_messages_and_parameters_are_shown_whole(value: float) -> None:
    """Those of a field `float32` with as many digits as it has."""
    shown = ros._shown(value)
    assert format_message({"latitude": value, "all": [value]}) == f"latitude: {shown}\nall: [{shown}]\n"
    assert value in (float(shown), float(np.float32(min(float(shown), 3e38))))
    assert len(shown) <= len(repr(value))
