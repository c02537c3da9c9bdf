"""A run in many processes is recorded as one in one process is: logs, pictures and recordings are made from it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from domains import PROCESSES

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")

from fame.log import Recording

pytestmark = pytest.mark.processes
ROOT = Path(__file__).parent.parent


def test_a_run_over_dds_is_logged_drawn_and_recorded(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("run.mcap", "run.jsonl", "run.png")]
    command = [
        *(sys.executable, "-m", "fame", "run", "examples/ground_vehicles.yaml"),
        *("--middleware", "dds", "--speed", "4", "--duration", "15"),
        *("--log", files[0], "--log", files[1], "--picture", files[2]),
    ]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(PROCESSES + 1)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert all(file.stat().st_size > 1000 for file in files), done.stderr
    with Recording(files[0]) as recording:
        assert not recording.warnings
        assert recording.robots == ["DINGO", "REX"]
        assert recording.metadata["lost_batches"] == "{}"
        events = list(recording.events(robots=["REX"]))
        assert events[0].what == "start"  # from the first step on
        lines = [json.loads(line) for line in files[1].read_text().splitlines()]
        verdicts = {each["detail"]["property"]: each["detail"]["verdict"] for each in lines[len(events) :]}
        assert [line["what"] for line in lines] == [event.what for event in events] + ["verdict"] * len(verdicts)
        assert verdicts == {"found_first": "holds", "answer": "not triggered", "apart": "holds"}
        entered = Counter(event.element for event in events if event.what == "enter")
        last = recording.state(recording.end).robots["REX"]
        assert {
            id: last.marks_of(id)["enter"] for marks in last.counts.values() for id in marks if "enter" in marks[id]
        } == entered
        step = (recording.end - events[0].time) // 15
        ways = [recording.world(recording.end - number * step).get("REX") for number in range(15)]
        ways = [pose for pose in ways if pose is not None]  # of the world it may have heard the first a moment later
        assert len({(pose["x"], pose["y"]) for pose in ways}) > 3
        assert "ground_vehicles.bpmn" in recording.models
