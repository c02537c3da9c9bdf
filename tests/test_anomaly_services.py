"""The modes of the anomaly detection module as call activities of a mission."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_data import BENIGN, needs_data, path_model, recording, runs
from bpmn_text import process

import fame
from fame.clock import SECOND, Scheduler, WallScheduler
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.nodes import TYPE
from fame.monitor.anomaly.recording import read_csv, write_csv
from fame.monitor.services import adm_operate
from fame.robot.services import CommandService, ServiceContext
from robots.arm.sabotage import alter, knots
from robots.arm.task import FILE, MH5

PERIOD = SECOND // 40


def calling(service: str, more: str = "") -> str:
    """A process that calls a service, and what is beside it."""
    return process(
        f"""<startEvent id="s"/><callActivity id="c" calledElement="{service}"/><endEvent id="e"/>
        <sequenceFlow id="f" sourceRef="s" targetRef="c"/><sequenceFlow id="g" sourceRef="c" targetRef="e"/>{more}"""
    )


STOPPED_BY_THE_ALARM = """<subProcess id="h" triggeredByEvent="true"><startEvent id="hs"><signalEventDefinition
signalRef="A"/><extensionElements><camunda:properties><camunda:property name="type" value="sensor_msgs/msg/JointState"/>
</camunda:properties></extensionElements></startEvent><endEvent id="he"/>
<sequenceFlow id="hf" sourceRef="hs" targetRef="he"/></subProcess>"""


class Watch:
    """A mission, and an arm that publishes joint states, one every 25 ms."""

    def __init__(self, folder: Path, text: str, **variables: Any) -> None:
        path = folder / "mission.bpmn"
        path.write_text(text.replace("<process", '<signal id="A" name="anomaly"/><process', 1))
        self.sim = fame.Simulation(fame.read(path), variables=variables)
        self.sim.run(0)
        self.joints = self.sim.middleware.node("arm").publisher("/joint_states", TYPE)

    def play(self, values: np.ndarray) -> None:
        for number, row in enumerate(values.tolist()):
            stamp = {"sec": number // 40, "nanosec": number % 40 * PERIOD}
            fields = {"header": {"stamp": stamp}, "name": list(MH5.joints), "position": row}
            self.joints.publish(messages.create(TYPE, fields))
            self.sim.run(self.sim.now + 0.025)

    @property
    def status(self) -> str:
        return self.sim.instances[0].status


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("model") / "best.skops"
    path_model().save(path)
    return str(path)


@pytest.mark.long
@needs_data
def test_collect_writes_so_many_runs_and_goes_on(tmp_path: Path) -> None:
    watch = Watch(tmp_path, calling("adm_collect"), output="benign.csv", label=1, runs=2)
    watch.play(runs(20, 21, 22))
    assert watch.status == "completed"
    assert watch.sim.instances[0].variables["runs_collected"] == 2
    assert len(list(read_csv(tmp_path / "benign.csv"))) == 2


@pytest.mark.parametrize(("points", "whole"), [((10, 3, 10), 2), ((0, 10, 10, 3), 2)])
def test_runs_that_are_cut_off_count_as_little_as_they_are_written(
    tmp_path: Path, points: tuple[int, ...], whole: int
) -> None:
    watch = Watch(tmp_path, calling("adm_collect"), output="benign.csv", label=1, runs=3, rule="signal")
    node, empty = watch.sim.middleware.node("task"), "std_msgs/msg/Empty"
    bounds = [node.publisher(topic, empty) for topic in ("/task_start", "/task_end")]
    for number in points:
        for bound in bounds:
            bound.publish(messages.create(empty))
            watch.sim.run(watch.sim.now)
            if bound is bounds[0]:
                watch.play(np.linspace(0.1, 0.2, number)[:, None] * np.ones(6))
    assert watch.status == "completed"
    assert watch.sim.instances[0].variables["runs_collected"] == whole
    assert read_csv(tmp_path / "benign.csv").count == whole


@pytest.mark.long
@needs_data
def test_operate_raises_the_signal_that_the_mission_catches(tmp_path: Path, model: str) -> None:
    watch = Watch(tmp_path, calling("adm_operate", STOPPED_BY_THE_ALARM), model=model)
    watch.play(runs(21))
    assert watch.status == "running"
    watch.play(alter(runs(23), knots("b", 0.5)).values)
    assert watch.status == "completed"
    instance = watch.sim.instances[0]
    assert instance.variables["anomaly"].name[0] in MH5.joints
    assert (instance.visits["he"], instance.visits["e"]) == (1, 0)
    assert any("alarm at point" in report.detail for report in watch.sim.reports)


@pytest.mark.long
@needs_data
def test_learn_stores_the_best_classifier(tmp_path: Path) -> None:
    write_csv(tmp_path / "benign.csv", recording(BENIGN).select(range(6)))
    (tmp_path / "learn.yaml").write_text(
        "Files:\n  unsupervised_train: {name: benign.csv, input_col: [0, 1, 2, 3, 4, 5], output_col: [6]}\n"
        f"Classifiers:\n  - {{name: path, class: PathDetector, parameters: {{chain: {FILE}}}, threshold: 0.002}}\n"
        "Split: {folds: 0}\n"
    )
    watch = Watch(tmp_path, calling("adm_learn"), config="learn.yaml", model="stored.skops")
    assert watch.status == "completed"
    assert watch.sim.instances[0].variables["classifier"] == "path"
    assert Model.load(tmp_path / "stored.skops").name == "path"


BAD = {
    "no model": ("adm_operate", {}, "needs the variable model"),
    "a model that is not there": ("adm_operate", {"model": "gone.skops"}, "gone.skops"),
    "another label": (
        "adm_collect",
        {"output": "x.csv", "label": 7},
        "expected 1 (benign) or -1 (anomalous), got 7",
    ),
    "another rule": ("adm_collect", {"output": "x.csv", "label": 1, "rule": "often"}, "'often'"),
    "a learning file that is not there": ("adm_learn", {"config": "gone.yaml"}, "gone.yaml"),
}


@pytest.mark.parametrize(("service", "variables", "said"), BAD.values(), ids=BAD)
def test_what_is_wrong_fails_the_mission_by_name(
    service: str, variables: dict[str, Any], said: str, tmp_path: Path
) -> None:
    watch = Watch(tmp_path, calling(service), **variables)
    assert watch.status == "failed"
    assert said in str(watch.sim.instances[0].error)


def test_a_command_that_is_killed_fails_with_what_became_of_it(tmp_path: Path) -> None:
    scheduler, changed = WallScheduler(), list[int]()
    middleware, done = LocalMiddleware(scheduler), lambda: changed.append(1)
    context = ServiceContext("ARM", "ARM", middleware, scheduler, tmp_path, print, done, lambda topic, type: print)
    service = CommandService(context, ["adm", "learn", "gone.yaml"], dict)
    service._process.kill()
    while not changed:
        scheduler.run(scheduler.now + SECOND // 100)
    with pytest.raises(ConfigError, match="fame adm learn ended without a result, with exit code -9"):
        service.results()
    service.close()


@pytest.mark.parametrize("threshold", [float("nan"), -1, 1.0, 5])
def test_a_threshold_that_no_score_could_meet_is_refused_before_anything_is_watched(
    threshold: float, tmp_path: Path
) -> None:
    scheduler = Scheduler()
    context = ServiceContext("ARM", "ARM", LocalMiddleware(scheduler), scheduler, tmp_path, print, print, print)
    with pytest.raises(ConfigError, match="expected a number from 0 to 1"):
        adm_operate(context, {"model": "best.skops", "threshold": threshold})
