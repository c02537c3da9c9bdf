"""``fame monitor adm collect`` and ``operate`` in processes of their own over DDS, with the published arguments."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from domains import PROCESSES as DOMAIN

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")

from lxml import etree

from fame.clock import SECOND
from fame.middleware import messages
from fame.middleware.dds import DdsMiddleware, DdsScheduler
from fame.monitor.anomaly.model import DataProcess, Model, PointClassifier
from fame.monitor.anomaly.nodes import TYPE
from fame.monitor.anomaly.recording import read_csv

ROOT = Path(__file__).parent.parent
NAMES = ("S", "L")
STEP = SECOND // 200
PATIENCE = 30
"""Seconds after which a process is taken to hang."""


class Arm:
    """Publishes joint states of two joints that go round a circle, twenty points a round."""

    def __init__(self) -> None:
        self.scheduler = DdsScheduler()
        self.middleware = DdsMiddleware(self.scheduler, domain=DOMAIN)
        self.node = self.middleware.node("arm")
        self.joints = self.node.publisher("/joint_states", TYPE)
        self.alarms: list[object] = []
        self.node.subscription("/anomaly", TYPE, self.alarms.append)
        self.count = 0

    def step(self) -> None:
        """One more joint state."""
        angle = 2 * np.pi * self.count / 20
        stamp = {"sec": self.count // 40, "nanosec": self.count % 40 * 25_000_000}
        position = [float(np.cos(angle)), float(np.sin(angle))]
        self.joints.publish(messages.create(TYPE, {"header": {"stamp": stamp}, "name": NAMES, "position": position}))
        self.count += 1
        self.scheduler.run(self.scheduler.now + STEP)

    def work_until_ended(self, process: subprocess.Popen[str]) -> tuple[str, str]:
        """Move until the process has ended; what it said."""
        end = self.scheduler.now + PATIENCE * SECOND
        while process.poll() is None:
            assert self.scheduler.now < end, "it did not end"
            self.step()
        return process.communicate()


@pytest.fixture
def arm() -> Iterator[Arm]:
    made = Arm()
    yield made
    made.middleware.close()


@contextmanager
def adm(*words: object) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "fame", "monitor", "adm", *map(str, words), "--json"]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.processes
@pytest.mark.dds
def test_collect_records_so_many_runs_of_a_live_arm(arm: Arm, tmp_path: Path) -> None:
    out = tmp_path / "benign.csv"
    with adm("collect", "/joint_states", out, 1, "--rule", "count", "--points", 20, "--runs", 2) as process:
        told, said = arm.work_until_ended(process)
    assert (process.returncode, json.loads(told)["runs"]) == (0, 2), said
    found = read_csv(out)
    assert found.joints == NAMES
    assert [len(run) for run in found] == [20, 20]
    assert np.allclose(np.linalg.norm(found.values, axis=1), 1)
    assert "2 of 2 runs" in said


@pytest.mark.processes
@pytest.mark.dds
def test_operate_raises_the_signal_over_the_network(arm: Arm, tmp_path: Path) -> None:
    from sklearn.svm import OneClassSVM

    elsewhere = np.random.default_rng(1).normal(3.0, 0.01, size=(40, 2))  # what it takes for benign is another place
    process_ = DataProcess(0).fit(elsewhere)
    estimator = OneClassSVM(gamma=1.0).fit(process_.transform(elsewhere))
    model = Model("svm", NAMES, PointClassifier(estimator, process_), 0.5, 20, elsewhere)
    model.save(tmp_path / "best.skops")
    with adm("operate", "/joint_states", tmp_path / "best.skops", 0.5, "--rule", "signal", "--runs", 1) as process:
        start, end = (arm.node.publisher(topic, "std_msgs/msg/Empty") for topic in ("/task_start", "/task_end"))
        while not arm.alarms and process.poll() is None and arm.count < PATIENCE * 200:
            if arm.count % 60 == 0:
                start.publish(messages.create("std_msgs/msg/Empty"))
            arm.step()
        end.publish(messages.create("std_msgs/msg/Empty"))
        told, said = arm.work_until_ended(process)
    assert process.returncode == 1, said
    assert json.loads(told)["runs"][0]["above"]
    assert arm.alarms
    assert arm.alarms[0].name[0] in NAMES  # type: ignore[attr-defined]


def test_the_launch_file_has_the_published_arguments_and_starts_what_there_is(capsys) -> None:
    from fame.cli import main

    root = etree.parse(str(ROOT / "launch" / "module.launch.xml")).getroot()
    assert {arg.get("name") for arg in root.findall("arg")} == {"mode_arg", "other_args", "pkg_name", "file_name"}
    modes = {group.get("if").split("-")[1].split("\\")[0]: group[0] for group in root.findall("group")}
    assert list(modes) == ["collect", "learn", "train", "operate"]
    for started in modes.values():  # the shell takes arguments and their quotes apart; exec: Ctrl-C reaches the command
        assert started.get("shell") == "true"
        assert started.get("cmd").startswith("exec ")
    expected = {"collect": "1 positional arguments", "learn": "gone.yaml", "operate": "1 positional arguments"}
    for mode, given in {"collect": "/joint_states", "learn": "gone.yaml", "operate": "/joint_states"}.items():
        started = modes[mode]
        words = started.get("cmd").partition(" $(var ")[0].split()
        assert words[:7] == ["exec", "python3", "-m", "fame", "monitor", "adm", mode]
        assert main([*words[4:], given]) == 2
        assert expected[mode] in capsys.readouterr().err
