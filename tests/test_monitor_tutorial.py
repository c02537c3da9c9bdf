"""docs/tutorial_monitor.md: deploy and record again and again, train, monitor; in simulated time."""

import shutil
from pathlib import Path

import pytest
import yaml

from fame.bpmn.reader import read
from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.middleware.local import LocalMiddleware
from fame.monitor.data_files import read_runs
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.recording import RecordingNode, RecordingOptions
from fame.scenario.plan import read_scenario_world
from sim2d.robot import robot_class
from sim2d.world import World

ROOT = Path(__file__).parent.parent
PIPELINE = ("low_pass", "autoencoders", "loss_low_pass", "threshold")
RUNS, LENGTH = 10, 27.0
"""How many runs train, and how long each recording is, s."""
SEEDS = (12, 13, 14)
"""Of the runs that are judged."""

pytestmark = pytest.mark.processes  # for their time: one to two minutes


class Cell:
    """The arm of the tutorial with its engine: both stay, and get one deployment after another."""

    def __init__(self, seed: int = 1) -> None:
        config, _ = read_scenario_world(ROOT / "examples" / "reassembly.yaml")
        assert config is not None
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.world = World(config, seed=seed, scheduler=self.scheduler, middleware=self.middleware)
        safe = robot_class("ur5e").SAFE_STATE  # as --type ur5e: a deployment stops the arm first
        self.engine = EngineNode(
            "Arm", scheduler=self.scheduler, middleware=self.middleware, options=EngineOptions(safe_state=safe)
        )
        self.sent = 0
        self.world.start()

    def deploy(self) -> None:
        """``fame deploy models/reassembly.bpmn --to Arm``."""
        self.sent += 1
        sent = Deployment(
            read(ROOT / "models" / "reassembly.bpmn"), id=f"d{self.sent}", sequence=self.sent, scheduler=self.scheduler,
            middleware=self.middleware, ended=lambda deployment: deployment.close(),
            options=DeploymentOptions(only=["Arm"]),
        )  # fmt: skip
        sent.begin()

    def record(self, folder: Path) -> RecordingNode:
        """``fame record`` of one run, begun before it; the node is closed."""
        ended: list[bool] = []
        node = RecordingNode(
            self.middleware, self.scheduler, load(folder / "low_pass.yaml"), [folder / "runs.csv"],
            RecordingOptions(namespace="/Arm", append=self.sent > 0),
        )  # fmt: skip
        node.end_after(LENGTH, lambda: ended.append(True))
        self.pass_time(1.0)
        self.deploy()
        while not ended:
            self.pass_time(0.02)
        node.close()
        return node

    def alarms(self, folder: Path, fault: str = "", at: float = 0.0) -> list[tuple[str, float]]:
        """``fame process`` from 1 s before a run: joint and time (s) of the first alarms; a fault comes at `at` s."""
        found: list[tuple[str, float]] = []
        nodes = [
            ProcessingNode(self.middleware, self.scheduler, load(folder / f"{name}.yaml"), namespace="/Arm")
            for name in PIPELINE
        ]
        begun = self.scheduler.now
        self.middleware.node("person").subscription(
            "/anomaly",
            "sensor_msgs/msg/JointState",
            lambda message: found.append((message.name[0], (self.scheduler.now - begun) / SECOND)),
        )
        self.pass_time(1.0)
        self.deploy()
        if fault:
            self.pass_time(at)
            self.world.fault("Arm", fault)
        while not found and self.scheduler.now < begun + LENGTH * SECOND:
            self.pass_time(0.5)
        for node in nodes:
            node.close()
        return found

    def pass_time(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    @property
    def status(self) -> str:
        """Of the last mission."""
        assert self.engine.running is not None
        return self.engine.running.instances[-1].status


@pytest.fixture(scope="module")
def monitor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the recordings of some deployments, and the model trained on them."""
    folder = tmp_path_factory.mktemp("walk") / "monitor"
    shutil.copytree(ROOT / "models" / "monitoring" / "joint_monitor", folder)
    cell = Cell()
    for _ in range(RUNS):
        cell.record(folder)
        assert cell.status == "completed"
    file = folder / "autoencoders.yaml"
    section = yaml.safe_load(file.read_text())
    section["Training"] |= {"Samples": 1500, "Folds": 3}  # a quick training: docs take two minutes
    file.write_text(yaml.safe_dump(section, sort_keys=False))
    assert main(["monitor", "train", str(file)]) == 0
    return folder


def test_every_deployment_is_recorded_as_a_whole_run(monitor: Path) -> None:
    runs = read_runs([monitor / "runs.csv"])
    assert len(runs) == RUNS
    for run in runs:
        assert run.stamps[-1] - run.stamps[0] == pytest.approx(LENGTH, abs=0.03)
        moving = run.values[:, 0].std()
        assert moving == pytest.approx(runs[0].values[:, 0].std(), rel=0.1)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("fault", "at"), [("blocked_shoulder", 6.5), ("blocked_lid", 1.0)])
def test_the_monitor_of_the_walk_finds_what_obstructs_the_arm(monitor: Path, fault: str, at: float, seed: int) -> None:
    found = Cell(seed).alarms(monitor, fault, at)
    assert found
    assert found[0][1] > at + 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_the_monitor_of_the_walk_raises_no_alarm_in_an_undisturbed_run(monitor: Path, seed: int) -> None:
    cell = Cell(seed)
    assert cell.alarms(monitor) == []
    assert cell.status == "completed"
