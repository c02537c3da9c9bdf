"""A second process writes the recording of a run: the same file, and whatever becomes of either process is said."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fame.errors import ConfigError
from fame.log import Recording, logging_to, recorder_process
from fame.scenario import Scenario
from tests.bpmn_text import process

EXAMPLES = Path(__file__).parent.parent / "examples"

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not recorder_process.is_useful(), reason="needs Linux and two processors"),
]


def record(path: Path, **options: Any) -> bytes:
    scenario = Scenario.load(EXAMPLES / "agriculture.yaml", duration=3)
    with logging_to(path, scenario.closures(), topics="all", **options) as log:
        scenario.run(observer=log)
    return path.read_bytes()


def test_it_writes_the_same_file(tmp_path: Path) -> None:
    (tmp_path / "b.mcap").write_bytes(b"an older and longer file" * 100_000)
    assert record(tmp_path / "a.mcap") == record(tmp_path / "b.mcap", own_process=True)


def test_details_of_events_that_are_no_plain_data_are_written_too(tmp_path: Path) -> None:
    import fame

    model = """
      <startEvent id="Start"><outgoing>f</outgoing></startEvent>
      <sequenceFlow id="f" sourceRef="Start" targetRef="Fails" />
      <scriptTask id="Fails" scriptFormat="python"><incoming>f</incoming>
        <script>raise BpmnError("low", {"charge": 0.1, "cells": {1, 2}})</script></scriptTask>"""
    path, written = tmp_path / "m.bpmn", []
    path.write_text(process(model))
    for own in (False, True):
        with logging_to(tmp_path / "run.mcap", [fame.read(path)], own_process=own) as log:
            fame.Simulation(path, observer=log).run()
        written.append((tmp_path / "run.mcap").read_bytes())
    assert written[0] == written[1]


def test_a_process_that_is_killed_ends_the_run_in_one_line(tmp_path: Path) -> None:
    log = logging_to(tmp_path / "run.mcap", [], own_process=True)
    writer = log.__enter__().begin()  # type: ignore[attr-defined]
    os.kill(writer._process.pid, signal.SIGKILL)
    with pytest.raises(ConfigError, match=r"run\.mcap: is cut short: .*signal 9"):
        log.__exit__(None, None, None)


def test_a_run_that_is_killed_leaves_a_whole_recording(tmp_path: Path) -> None:
    script = f"""
import os, signal
from fame.log import logging_to
from fame.scenario import Scenario
scenario = Scenario.load({str(EXAMPLES / "agriculture.yaml")!r}, duration=3)
with logging_to("run.mcap", scenario.closures(), own_process=True) as log:
    scenario.run(observer=log)
    log.begin()._send()
    print(log.begin()._process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert done.stdout, done.stderr
    with Recording(tmp_path / "run.mcap") as recording:  # standard output is open until the second process has ended
        assert recording.duration > 2.5
        assert not recording.warnings


def test_ctrl_c_does_not_reach_it(tmp_path: Path) -> None:
    with logging_to(tmp_path / "run.mcap", [], own_process=True) as log:
        writer = log.begin()  # type: ignore[attr-defined]
        assert os.getpgid(writer._process.pid) != os.getpgid(0)


def test_a_full_disk_ends_the_run_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    words = [sys.executable, "-m", "fame", "run", "examples/ground_vehicles.yaml", "--quiet", "--log", str(path)]
    limited = ["sh", "-c", 'ulimit -f 400; exec "$@"', "sh", *words]
    found = subprocess.run(limited, cwd=EXAMPLES.parent, stderr=subprocess.PIPE, text=True, check=False)
    assert found.returncode == 2
    assert found.stderr == f"fame: error: {path}: cannot be written: File too large\n"
    with Recording(path) as recording:
        assert recording.duration > 1
