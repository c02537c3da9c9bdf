"""Engines with a state directory are killed at any instant, and the mission goes on: nothing is lost or done twice."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import document
from middleware_contract import DOMAIN, needs

ROOT = Path(__file__).parent.parent
ENVIRONMENT = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN + 1), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
KILLS = int(os.environ.get("FAME_KILLS", "3"))
"""How often the engine is killed: FAME_KILLS=20 takes two minutes."""
LAST = max(60, 18 * KILLS)
PATIENCE = 120 + KILLS
"""How long a test waits before it looks at what there is (s): on a busy machine an engine takes long to start."""
TICKS = document(
    '<signal id="T" name="tick"/><collaboration id="C"><participant id="A" name="REX" processRef="p"/></collaboration>'
    '<process id="p" isExecutable="true"><startEvent id="s"/><exclusiveGateway id="m"/>'
    '<scriptTask id="a"><script>n = globals().get("n", 0) + 1\nwith open(FILE, "a") as file: file.write(f"{n}\\n")'
    "</script></scriptTask>"
    '<intermediateThrowEvent id="t"><extensionElements><camunda:properties>'
    '<camunda:property name="type" value="std_msgs/msg/Int32"/><camunda:property name="payload" value="${n}"/>'
    '</camunda:properties></extensionElements><signalEventDefinition signalRef="T"/></intermediateThrowEvent>'
    '<intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT0.05S</timeDuration></timerEventDefinition>'
    '</intermediateCatchEvent><exclusiveGateway id="x" default="xe"/><userTask id="e"/>'
    + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ["sm", "ma", "at", "tc", "cx"])
    + '<sequenceFlow id="xe" sourceRef="x" targetRef="e"/>'
    f'<sequenceFlow id="xm" sourceRef="x" targetRef="m"><conditionExpression>${{n &lt; {LAST}}}</conditionExpression>'
    "</sequenceFlow></process>"
)


def fame(*words: str) -> list[str]:
    return [sys.executable, "-m", "fame", *words]


def told(*words: str) -> str:
    done = subprocess.run(fame(*words), env=ENVIRONMENT, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done
    return done.stdout


class Engine:
    """An engine in a process of its own, started again after each kill."""

    def __init__(self, state: Path) -> None:
        self.words = fame("engine", "REX", "--state", str(state))
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(self.words, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)

    def kill(self) -> str:
        self.process.kill()
        return self.process.communicate()[1]

    def status(self) -> dict[str, object]:
        done = subprocess.run(
            fame("status", "REX", "--json"), env=ENVIRONMENT, capture_output=True, text=True, check=False
        )
        return json.loads(done.stdout).get("robots", {}).get("REX", {})


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = Engine(tmp_path / "state")
    yield made
    made.kill()


def wait_for(path: Path, number: int) -> list[int]:
    """The numbers in a file, as soon as they have come so far."""
    until = time.monotonic() + PATIENCE
    while True:
        found = [int(line) for line in path.read_text().split()] if path.exists() else []
        if (found and found[-1] >= number) or time.monotonic() > until:
            return found
        time.sleep(0.01)


@needs("cyclonedds")
@pytest.mark.dds
@pytest.mark.processes
def test_a_mission_that_is_killed_again_and_again_counts_every_number_once(engine: Engine, tmp_path: Path) -> None:
    dice, file = random.Random(1), tmp_path / "numbers"
    model = tmp_path / "ticks.bpmn"
    model.write_text(TICKS.replace("FILE", repr(str(file))))
    told("deploy", str(model), "--wait", "60")
    kills = 0
    while kills < KILLS:
        seen = wait_for(file, 5 + 14 * kills)
        time.sleep(dice.random() * 0.1)
        engine.kill()
        kills += 1
        assert len(seen) < LAST + kills
        engine.start()
    found = wait_for(file, LAST)
    # A script whose stimulus was not recorded yet has not ended: it may run again, once for each kill.
    assert sorted(set(found)) == list(range(1, LAST + 1))
    assert len(found) - LAST <= kills
    assert all(later - sooner in (0, 1) for sooner, later in pairwise(found))
    assert engine.process.poll() is None


@needs("cyclonedds")
@pytest.mark.dds
@pytest.mark.processes
def test_an_engine_that_is_interrupted_goes_on_with_the_same_command(engine: Engine, tmp_path: Path) -> None:
    file, model = tmp_path / "numbers", tmp_path / "ticks.bpmn"
    model.write_text(TICKS.replace("FILE", repr(str(file))))
    told("deploy", str(model), "--wait", "60")
    wait_for(file, 5)
    engine.process.send_signal(signal.SIGINT)
    engine.process.communicate()
    assert engine.process.returncode == 0
    engine.start()
    found = wait_for(file, LAST)
    assert found == list(range(1, LAST + 1))
    engine.kill()
    engine.words.append("--fresh")
    engine.start()
    until = time.monotonic() + PATIENCE
    while (found := engine.status().get("state")) != "waiting" and time.monotonic() < until:
        time.sleep(0.2)
    assert found == "waiting"
    assert (tmp_path / "state" / "old-1").is_dir()
