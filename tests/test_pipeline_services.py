"""Pipelines in missions: services are call activities that run until their scope ends, an alarm is a signal."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bpmn_text import extensions, process

import fame
from fame.bpmn import read_text
from fame.bpmn.library import BUILT_IN
from fame.bpmn.model import Definitions
from fame.clock import SECOND, Scheduler, WallScheduler
from fame.config.loader import find_object
from fame.errors import MissingTypeError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.middleware.typesystem import STRING
from fame.monitor.calibration import Calibration, calibrate
from fame.monitor.data_files import read_runs
from fame.monitor.pipeline.blindness import Blindness
from fame.monitor.pipeline.detectors import ChannelAutoencoders
from fame.monitor.pipeline.trained_model import LEAST_MOVEMENT, TrainedModel
from fame.robot import RobotNode, make_mission
from fame.robot.options import RobotOptions

JOINT_STATE = "sensor_msgs/msg/JointState"
ROBOT = "robot"
JOINTS = [f"joint_{number}" for number in range(6)]
FILES = [BUILT_IN[1] / f"{name}.bpmn" for name in ("ProcessingUnit", "Record", "Train", "joint_monitor")]


def model(path: Path, calibration: Calibration | None = None) -> Path:
    """Autoencoders that know nothing but zero: the loss is the mean square of the effort."""
    weights = (np.zeros((6, 50, 4)), np.zeros((6, 4, 50)))
    biases = (np.zeros((6, 1, 4)), np.zeros((6, 1, 50)))
    network = ChannelAutoencoders(weights, biases, "tanh")
    columns = tuple(f"Efforts.{joint}" for joint in JOINTS)
    TrainedModel(
        columns, 50, 500.0, np.zeros(6), np.ones(6), network, (0.5,) * 6, 5.0, 20.0, calibration=calibration
    ).save(path)
    return path


def mission(content: str, signal: str = "anomaly") -> Definitions:
    """A process that calls services, and ends when the signal is caught."""
    return read_text(process(content + handler(signal), f'<signal id="S" name="{signal}"/>'))


def call(id: str, called: str, *, own: bool = True, **data: str) -> str:
    """A call activity whose input data object holds these variables."""
    held = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in data.items())
    mapped = '<camunda:in variables="all"/>' if own else ""
    return (
        f'<callActivity id="{id}" calledElement="{called}">{extensions(mapped)}'
        f'<property id="{id}_p"/><dataInputAssociation id="{id}_a"><sourceRef>{id}_d</sourceRef>'
        f"<targetRef>{id}_p</targetRef></dataInputAssociation></callActivity>"
        f'<dataObjectReference id="{id}_d" dataObjectRef="{id}_o">'
        f"{extensions(f'<camunda:properties>{held}</camunda:properties>')}</dataObjectReference>"
        f'<dataObject id="{id}_o"/>'
    )


def flow(*ids: str) -> str:
    return "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


def handler(signal: str) -> str:
    """An interrupting event sub-process that catches it."""
    typed = extensions(
        f'<camunda:properties><camunda:property name="type" value="{JOINT_STATE}"/></camunda:properties>'
    )
    return (
        f'<subProcess id="H" triggeredByEvent="true"><startEvent id="Caught">{typed}'
        f'<signalEventDefinition id="x" signalRef="S"/></startEvent><endEvent id="Stopped"/>'
        f"{flow('Caught', 'Stopped')}</subProcess>"
    )


def arm(
    sim: fame.Simulation, seconds: float, push: float = 0.0, *, sway: float = 0.0, rate: int = 500,
    names: Sequence[str] = JOINTS,
) -> None:  # fmt: skip
    """Efforts of an arm at rest, somebody pushing joint 3; joint 0 may sway."""
    node = sim.middleware.node("driver")
    publisher = node.publisher(f"/{ROBOT}/joint_states", JOINT_STATE)
    begin = sim.now
    for number in range(1, round(seconds * rate) + 1):
        sim.run(until=begin + number / rate)
        efforts = [0.1 + sway * math.sin(0.1 * number), 0.1, 0.1, 0.1 + push, 0.1, 0.1]
        content = {"header": {"stamp": sim.now}, "name": names, "effort": efforts}
        publisher.publish(messages.create(JOINT_STATE, content))
    node.close()


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_models_check_without_a_warning(file: Path) -> None:
    from fame.check import check

    assert [finding.text for finding in check(fame.read(file)) if finding.level != "note"] == []


def test_the_joint_monitor_raises_anomaly_and_the_mission_that_catches_it_ends_the_pipeline(tmp_path: Path) -> None:
    watched = call("Monitor", "joint_monitor", model=str(model(tmp_path / "m.skops")))
    sim = fame.Simulation(mission(
        f'<startEvent id="s"/>{watched}<endEvent id="e"/>{flow("s", "Monitor", "e")}'
    ))  # fmt: skip
    sim.run(until=0.1)
    topics = {info.name: info for info in sim.middleware.graph()}
    assert {name.rpartition("/")[2] for name in topics} >= {"joint_efforts_filtered", "joint_losses", "anomaly"}
    arm(sim, 0.6)
    (instance,) = sim.instances
    assert instance.status == "running"
    arm(sim, 0.6, push=3.0)
    assert instance.status == "completed"
    assert instance.visits["Stopped"] == 1
    anomaly = instance.variables["anomaly"]
    assert anomaly.name == ["joint_3"]
    assert anomaly.effort[0] > 0.5
    assert anomaly.position[0] == pytest.approx(2 * anomaly.effort[0])
    assert "joint_losses" not in {info.name.rpartition("/")[2] for info in sim.middleware.graph()}


@pytest.mark.long
def test_a_mission_that_catches_drift_is_told_before_there_is_an_alarm(tmp_path: Path) -> None:
    """The joint monitor and the drift monitor in parallel, on runs in which joint 3 moves harder and harder."""
    usual = 0.01 * np.exp(0.1 * np.random.default_rng(3).standard_normal((20, 6)))  # losses of efforts of 0.1
    file = model(tmp_path / "m.skops", calibrate(usual, 0.1))
    watched = call("Monitor", "joint_monitor", model=str(file))
    drift = call(
        "Drift", "ProcessingUnit", configuration="joint_monitor/drift.yaml", namespace="",
        parameters=f"{{model: {file}, state: {tmp_path / 'sums.json'}}}",
    )  # fmt: skip
    sim = fame.Simulation(mission(
        f'<startEvent id="s"/><parallelGateway id="g"/>{watched}{drift}<endEvent id="e"/>'
        f'{flow("s", "g", "Monitor", "e")}{flow("g", "Drift", "e")}',
        signal="drift",
    ))  # fmt: skip
    sim.run(until=0.1)
    (instance,) = sim.instances
    runs = 0
    while instance.status == "running" and runs < 20:
        arm(sim, 0.5, push=0.003 * runs)
        sim.run(until=sim.now + 3)  # the pause between two runs
        runs += 1
    assert instance.status == "completed"
    assert instance.visits["Stopped"] == 1
    assert instance.variables["drift"].name == ["joint_3"]
    assert instance.variables["drift"].position[0] > 5
    assert 5 < runs < 15
    assert (0.1 + 0.003 * runs) ** 2 < 0.5  # far below the threshold of the alarm
    assert "anomaly" not in instance.variables


def watched_arm(file: Path, blind: str, more: str = "", *, types: bool = True) -> fame.Simulation:
    """A mission that is monitored, counts what it is told of its monitor, and works for a second each."""
    monitor = call("Monitor", "joint_monitor", model=str(file), blind=blind)
    string = '<camunda:property name="type" value="std_msgs/msg/String"/>'
    typed = extensions(f"<camunda:properties>{string}</camunda:properties>") if types else ""
    told = "".join(
        f'<subProcess id="H{name}" triggeredByEvent="true"><startEvent id="{name}" isInterrupting="false">{typed}'
        f'<signalEventDefinition id="d{name}" signalRef="S{name}"/></startEvent><endEvent id="e{name}"/>'
        f"{flow(name, f'e{name}')}</subProcess>"
        for name in ("monitor_blind", "monitor_sees")
    )
    signals = "".join(f'<signal id="S{name}" name="{name}"/>' for name in ("monitor_blind", "monitor_sees"))
    sim = fame.Simulation(read_text(process(
        f'<startEvent id="s"/>{monitor}<endEvent id="e"/>{flow("s", "Monitor", "e")}{told}{more}', signals
    )))  # fmt: skip
    sim.run(until=0.1)
    return sim


def test_a_mission_that_gives_no_type_gets_a_bare_signal(tmp_path: Path) -> None:
    sim = watched_arm(model(tmp_path / "m.skops"), "continue", types=False)
    arm(sim, 1.0)
    sim.run(until=sim.now + 4)
    assert sim.instances[0].visits["monitor_blind"] == 1


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ({"silent": True}, "/robot/joint_states: no message for 2 s"),
        ({"push": math.nan}, "/robot/joint_states: no message can be used: Efforts is not finite"),
        ({"rate": 250}, "Rate: 500 is expected"),
        ({"other": True}, "/robot/joint_states: no message can be used: Efforts has the channels"),
    ],
)
def test_a_mission_is_told_that_its_monitor_is_blind_and_that_it_sees_again(
    tmp_path: Path, how: dict[str, Any], reason: str
) -> None:
    sim = watched_arm(model(tmp_path / "m.skops"), "continue")
    (instance,) = sim.instances
    arm(sim, 3.0)
    assert not instance.visits["monitor_blind"]
    if how == {"silent": True}:
        sim.run(until=sim.now + 4)
    elif how == {"other": True}:
        arm(sim, 4.0, names=[f"wheel_{number}" for number in range(6)])
    else:
        arm(sim, 4.0, **how)
    assert instance.visits["monitor_blind"] >= 1
    assert not instance.visits["monitor_sees"]
    assert instance.variables["monitor_blind"]
    assert any("the monitor is blind: " in str(each) and reason in str(each) for each in sim.reports)
    arm(sim, 5.0)
    assert instance.visits["monitor_sees"] >= 1
    assert instance.status == "running"


def test_a_joint_that_hardly_moves_makes_the_monitor_blind(tmp_path: Path) -> None:
    made = TrainedModel.load(model(tmp_path / "m.skops"))
    replace(made, conditions={LEAST_MOVEMENT: [0.1, 0, 0, 0, 0, 0]}).save(tmp_path / "m.skops")
    sim = watched_arm(tmp_path / "m.skops", "continue")
    arm(sim, 3.0, sway=0.5)
    (instance,) = sim.instances
    assert not instance.visits["monitor_blind"]
    arm(sim, 4.0)
    assert "autoencoders: Efforts.joint_0 hardly moves: not judged" in instance.variables["monitor_blind"]


def test_the_diagnostics_of_ros_say_what_keeps_a_monitor_from_judging(tmp_path: Path) -> None:
    sim = watched_arm(model(tmp_path / "m.skops"), "continue")
    told: dict[str, tuple[int, str]] = {}

    def on_diagnostics(message: Any) -> None:
        told.update({each.name: (each.level, each.message) for each in message.status})

    sim.middleware.node("person").subscription("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", on_diagnostics)
    arm(sim, 3.0)
    assert told["low_pass: monitor"] == told["threshold: monitor"] == (0, "sees")
    sim.run(until=sim.now + 4)
    assert told["low_pass: monitor"] == (1, "/robot/joint_states: no message for 2 s")
    assert told["threshold: monitor"] == (0, "sees"), "the node before it says why nothing comes"


def test_a_ros_without_diagnostics_hears_the_signals_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    node = middleware.node("low_pass")
    heard: list[str] = []
    middleware.node("mission").subscription("/monitor_blind", STRING, lambda message: heard.append(message.data))
    publisher = node.publisher

    def missing(topic: str, type: str) -> Any:
        if topic == "/diagnostics":
            raise MissingTypeError("this ROS does not have it", type=type)
        return publisher(topic, type)

    monkeypatch.setattr(node, "publisher", missing)
    blindness = Blindness(middleware, node, "low_pass")
    blindness.look({"silent": "no message"}, scheduler.now)
    scheduler.run(until=SECOND)
    assert heard == ["low_pass: no message"]
    assert [each.topic for each in middleware.warnings] == ["/diagnostics"]


def test_a_blind_monitor_is_an_error_of_its_call_if_the_mission_wants_that(tmp_path: Path) -> None:
    caught = (
        '<boundaryEvent id="Blind" attachedToRef="Monitor"><errorEventDefinition id="x"/></boundaryEvent>'
        f'<endEvent id="Stopped"/>{flow("Blind", "Stopped")}'
    )
    sim = watched_arm(model(tmp_path / "m.skops"), "error", caught)
    arm(sim, 3.0)
    (instance,) = sim.instances
    assert instance.status == "running"
    sim.run(until=sim.now + 4)
    assert (instance.status, instance.visits["Stopped"]) == ("completed", 1)


def test_a_mission_may_wait_until_its_monitor_sees(tmp_path: Path) -> None:
    sim = watched_arm(model(tmp_path / "m.skops"), "wait")
    arm(sim, 3.0)
    node = sim.node
    assert not node.holds
    sim.run(until=sim.now + 4)
    assert node.holds == {"its monitor, which is blind"}
    arm(sim, 4.0)
    assert not node.holds
    arm(sim, 1.0, push=3.0)
    assert "joint_losses" in {info.name.rpartition("/")[2] for info in sim.middleware.graph()}, "it monitors again"


def test_what_a_monitor_does_when_it_is_blind_is_one_of_three_words(tmp_path: Path) -> None:
    sim = watched_arm(model(tmp_path / "m.skops"), "ignore")
    assert "variable blind: expected one of continue, wait, error, got 'ignore'" in str(sim.instances[0].error)


def test_a_unit_with_a_wrong_configuration_is_an_error_of_the_mission(tmp_path: Path) -> None:
    for configuration, reason in (("none.yaml", "there is no configuration none.yaml in "), ("", "needs the variable")):
        sim = fame.Simulation(mission(
            f'<startEvent id="s"/>{call("U", "ProcessingUnit", configuration=configuration)}{flow("s", "U")}'
        ))  # fmt: skip
        sim.run(until=1)
        (instance,) = sim.instances
        assert instance.status == "failed"
        assert reason in str(instance.error)


SLOW = """
import threading
BEGUN, GATE, CLOSED = threading.Event(), threading.Event(), []

class Slow:
    outputs = ("value",)

    def __init__(self):
        BEGUN.set()
        if not GATE.wait(60):
            raise TimeoutError("nothing went on while this was loaded")

    def execute(self, inputs):
        return None

    def close(self):
        CLOSED.append(self)
"""
SLOWLY = """
Inputs: {In: {Topic: joint_states, Field: [effort], MessageType: sensor_msgs/msg/JointState}}
Outputs: {Out: {Topic: out, Field: data, MessageType: std_msgs/msg/Float64}}
Processor: "slow.py:Slow"
"""


@pytest.mark.parametrize("ends", [False, True])
def test_a_mission_goes_on_while_a_unit_is_loaded_also_to_its_end(tmp_path: Path, ends: bool) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "slowly.yaml").write_text(SLOWLY)
    begun, gate, closed = (find_object(f"slow.py:{name}", tmp_path) for name in ("BEGUN", "GATE", "CLOSED"))
    unit = call("U", "ProcessingUnit", configuration="slowly.yaml")
    end = '<endEvent id="e"><terminateEventDefinition id="te"/></endEvent>' if ends else '<endEvent id="e"/>'
    beat = '<scriptTask id="beat"><script>await sleep(0.01)\nsignal("beat")</script></scriptTask>'
    definitions = read_text(process(
        f'<startEvent id="s"/><parallelGateway id="g"/>{unit}{beat}{end}{flow("s", "g", "U")}{flow("g", "beat", "e")}',
        '<signal id="S" name="beat"/>',
    ))  # fmt: skip
    scheduler = WallScheduler()
    middleware = LocalMiddleware(scheduler)
    middleware.node("other").subscription("/beat", "std_msgs/msg/Empty", lambda message: gate.set())
    robot = RobotNode(
        ROBOT, make_mission(definitions, definitions.processes[0]), scheduler=scheduler, middleware=middleware,
        options=RobotOptions(files=tmp_path),
    )  # fmt: skip
    robot.load()
    robot.start()
    loaded = lambda: closed if ends else any(info.name == f"/{ROBOT}/out" for info in middleware.graph())  # noqa: E731
    for _ in range(1000):
        if not loaded():
            scheduler.run(scheduler.now + SECOND // 100)
    assert begun.is_set()
    assert loaded()
    assert (robot.instances[0].status, robot.instances[0].error) == ("completed" if ends else "running", None)
    robot.close()


def test_parameters_and_namespace_come_from_the_data_object(tmp_path: Path) -> None:
    unit = call(
        "U", "ProcessingUnit", configuration="joint_monitor/low_pass.yaml", parameters="{cutoff: 0.001}",
        namespace="elsewhere",
    )  # fmt: skip
    sim = fame.Simulation(mission(f'<startEvent id="s"/>{unit}{flow("s", "U")}'))
    sim.run(until=0.1)
    assert "/elsewhere/joint_states" in {info.name for info in sim.middleware.graph()}
    wrong = call(
        "U", "ProcessingUnit", configuration="joint_monitor/low_pass.yaml", parameters="{cutof: 1}", namespace=""
    )
    sim = fame.Simulation(mission(f'<startEvent id="s"/>{wrong}{flow("s", "U")}'))
    sim.run(until=0.1)
    assert "no processor has this parameter" in str(sim.instances[0].error)


@pytest.mark.long
def test_a_record_unit_has_everything_on_disk_when_its_scope_ends_and_train_learns_from_it(tmp_path: Path) -> None:
    port = {"Topic": "joint_states", "Field": ["effort"], "MessageType": JOINT_STATE}
    training = {"Files": ["runs.csv"], "Window": 10, "Hidden": [3], "Epochs": 2, "Model": "out/made.skops"}
    (tmp_path / "joints.yaml").write_text(yaml.safe_dump({"Inputs": {"Efforts": port}, "Training": training}))
    variables = {"configuration": str(tmp_path / "joints.yaml")}
    recorder = call("R", "Record", **variables, output=str(tmp_path / "runs.csv"))
    for number in range(3):
        sim = fame.Simulation(mission(
            f'<startEvent id="s"/>{recorder}{flow("s", "R")}', "enough"
        ))  # fmt: skip
        sim.run(until=0.1)
        arm(sim, 0.2, sway=0.05 + 0.01 * number)
        sim.signal("enough")
        sim.run(until=sim.now + 1)
        assert sim.instances[0].status == "completed"
    assert [len(run) for run in read_runs([tmp_path / "runs.csv"])] == [99, 99, 99]
    trainer = call("T", "Train", own=False, **variables)
    sim = fame.Simulation(mission(f'<startEvent id="s"/>{trainer}{flow("s", "T")}'))
    sim.run()
    (instance,) = sim.instances
    assert instance.status == "completed", instance.error
    made = TrainedModel.load(instance.variables["model"])
    assert made.columns == tuple(f"Efforts.{joint}" for joint in JOINTS)
    assert list(instance.variables["thresholds"]) == list(made.thresholds)
