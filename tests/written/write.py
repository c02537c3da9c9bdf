"""Write the files of a release, with its own Python: ``PYTHON tests/written/write.py tests/written/RELEASE``.

They are committed with the release, and never written again: ``tests/test_written_files.py`` reads those of each one.
"""

import math
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import fame
from fame.bpmn.reader import read_text
from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.deploy.requests import TaskClient, TaskRequest
from fame.middleware.local import LocalMiddleware
from fame.robot.journal import StateDirectory

MODEL = "mission.bpmn"


class Robot:
    """A robot A with a state directory, in simulated time."""

    def __init__(self, state: Path) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        options = EngineOptions(state=StateDirectory(state), hold_errors=True, wall_time=lambda: 1e9)
        self.engine = EngineNode("A", scheduler=self.scheduler, middleware=self.middleware, options=options)
        self.node = self.middleware.node("desk")
        self.requests = 0

    def run(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def deploy(self, text: str, number: int, seconds: float = 20, **more) -> None:
        options = replace(DeploymentOptions(), robots=["A"], wall_time=lambda: 1e9, **more)
        sent = Deployment(
            read_text(text, file="mission.bpmn"), id=f"d{number}", sequence=number, scheduler=self.scheduler,
            middleware=self.middleware, ended=lambda deployment: None, options=options,
        )  # fmt: skip
        sent.begin()
        self.run(seconds)

    def ask(self, act: str, element: str = "", **values) -> None:
        self.requests += 1
        request = TaskRequest(id=f"request {self.requests}", element=element, act=act, values=values)
        client = TaskClient("A", request, node=self.node, scheduler=self.scheduler, answered=lambda report: None)
        self.run(1)
        client.close()


def states(folder: Path) -> None:
    """Write a journal in each phase of a mission and of a deployment."""
    text = Path(MODEL).read_text()
    for name in ("running", "inside", "ended", "suspended", "incident", "migrated", "promised"):
        robot = Robot(folder / name)
        robot.deploy(text, 1)
        if name == "suspended":
            robot.ask("suspend")
        elif name == "incident":
            robot.ask("complete", "first", speed=0)
        elif name in ("inside", "ended"):
            robot.ask("complete", "first", speed=2)
            robot.ask("complete", "ask")
            if name == "ended":
                robot.ask("complete", "ask")
        elif name == "migrated":
            robot.ask("complete", "first", speed=2)
            robot.deploy(text.replace('name="Ask"', 'name="Ask again"'), 2, migrate=True)
        elif name == "promised":
            promise = (folder / "running" / "promise").exists
            assert not promise()
            write = robot.engine._keeper._write_promises
            kept = folder / "ready"

            def note(envelopes, write=write, kept=kept, name=name) -> None:
                write(envelopes)
                if envelopes and not kept.exists():
                    shutil.copytree(folder / name, kept)

            robot.engine._keeper._write_promises = note
            robot.deploy(text.replace('name="Ask"', 'name="Ask again"'), 2)
        robot.scheduler.run(robot.scheduler.now + SECOND)
        shutil.copytree(folder / name, folder / f"{name}.copy")  # as a crash leaves it
        robot.engine.stop()
        shutil.rmtree(folder / name)
        (folder / f"{name}.copy").rename(folder / name)
    shutil.rmtree(folder / "promised")
    for lock in folder.glob("*/lock"):  # of a process that has ended
        lock.unlink()


def runs() -> list[str]:
    """Return the names of six files of a run each, of 3 s."""
    names = [f"run_{number}.csv" for number in range(6)]
    for number, name in enumerate(names):
        samples = [(row / 20, math.sin(row / 10) + 0.01 * math.sin(row * (number + 7))) for row in range(60)]
        Path(name).write_text("t,speed\n" + "".join(f"{time:.3f},{speed:.4f}\n" for time, speed in samples))
    return names


def write() -> None:
    """Write into the working directory, with names relative to it."""
    states(Path("states"))
    fame.Simulation(MODEL).run(5).complete("first", {"speed": 2}).save("run.state")
    logs = [f"--log=run.{suffix}" for suffix in ("mcap", "jsonl", "csv", "xes")]
    assert main(["run", MODEL, "--duration", "5", "--quiet", *logs]) in (0, 1)
    assert main(["campaign", MODEL, "--runs", "3", "--duration", "5", "--jobs", "1", "-o", "campaign"]) in (0, 1)
    test = Path("test_mission.py")
    test.write_text(f'def test_first(mission):\n    mission.load({MODEL!r}).advance(1).complete("first", speed=2)\n')
    assert main(["test", str(test), "--cov-json", "coverage.json"]) == 0
    test.unlink()
    for folder in ("__pycache__", ".pytest_cache"):
        shutil.rmtree(folder, ignore_errors=True)
    names = runs()
    train = ["monitor", "train", "--data", *names, "--time-column", "t", "--detector", "phase", "--keep"]
    assert main([*train, "-o", "detector.skops"]) == 0
    for name in names[1:]:
        Path(name).unlink()


if __name__ == "__main__":
    release = Path(sys.argv[1])
    release.mkdir()
    shutil.copy(Path(__file__).with_name(MODEL), release)
    os.chdir(release)
    write()
