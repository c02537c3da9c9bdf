"""Robots in processes of their own, over DDS on loopback: deployed, redeployed, killed."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")
pytestmark = pytest.mark.processes

ROOT = Path(__file__).parent.parent
LIMIT = 40
"""Seconds after which a process is taken to hang."""

HEAD = '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">'
THROW = '<intermediateThrowEvent id="{0}"><signalEventDefinition signalRef="{1}"/></intermediateThrowEvent>'
CATCH = '<intermediateCatchEvent id="{0}"><signalEventDefinition signalRef="{1}"/></intermediateCatchEvent>'


def flows(prefix: str, *ids: str) -> str:
    return "".join(
        f'<sequenceFlow id="{prefix}{n}" sourceRef="{a}" targetRef="{b}"/>' for n, (a, b) in enumerate(pairwise(ids))
    )


PING_PONG = (
    f'{HEAD}<signal id="Ping" name="ping"/><signal id="Pong" name="pong"/><collaboration id="c">'
    '<participant id="A" name="A" processRef="pa"/><participant id="B" name="B" processRef="pb"/></collaboration>'
    '<process id="pa"><startEvent id="sa"/>'
    f'{THROW.format("ping", "Ping")}{CATCH.format("pong", "Pong")}<endEvent id="ea"/>'
    f"{flows('a', 'sa', 'ping', 'pong', 'ea')}</process>"
    '<process id="pb"><startEvent id="sb"><signalEventDefinition signalRef="Ping"/></startEvent>'
    f'{THROW.format("answer", "Pong")}<endEvent id="eb"/>{flows("b", "sb", "answer", "eb")}</process></definitions>'
)


def waiting(name: str) -> str:
    """A pool that waits at an event `name` for ever."""
    return (
        f'{HEAD}<signal id="S" name="never"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
        f'</collaboration><process id="pa"><startEvent id="s"/>{CATCH.format(name, "S")}{flows("f", "s", name)}'
        "</process></definitions>"
    )


@pytest.fixture
def environment() -> dict[str, str]:
    """A DDS domain of our own, so that nothing else is heard."""
    return {**os.environ, "ROS_DOMAIN_ID": str(100 + os.getpid() % 100), "PYTHONPATH": str(ROOT)}


@pytest.fixture
def start(environment) -> Iterator:
    started: list[subprocess.Popen] = []

    def begin(*words: str) -> subprocess.Popen:
        process = subprocess.Popen([sys.executable, "-m", "fame", *words], env=environment, stderr=subprocess.PIPE)
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    for process in started:
        try:
            process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


@pytest.fixture
def fame(environment):
    def run(*words: str) -> tuple[int, dict]:
        done = subprocess.run(
            [sys.executable, "-m", "fame", *words, "--json"],
            env=environment, capture_output=True, text=True, timeout=LIMIT, check=False,
        )  # fmt: skip
        return done.returncode, json.loads(done.stdout)

    return run


def until(ask, holds, what: str) -> dict:
    """Ask again and again until it holds."""
    deadline = time.monotonic() + LIMIT
    while time.monotonic() < deadline:
        code, said = ask()
        if code == 0 and holds(said):
            return said
    raise AssertionError(f"{what}: {said}")


def test_a_mission_in_many_processes_completes(tmp_path, fame):
    path = tmp_path / "ping.bpmn"
    path.write_text(PING_PONG)
    code, said = fame("run", str(path), "--middleware", "dds", "--duration", "20")
    assert (code, said["status"]) == (0, "completed"), said
    assert {name: robot["completed"] for name, robot in said["robots"].items()} == {"A": 1, "B": 1}


def test_an_engine_is_deployed_to_redeployed_killed_and_comes_back(tmp_path, start, fame):
    for name in ("first", "second"):
        (tmp_path / f"{name}.bpmn").write_text(waiting(name))
    engine = start("engine", "A")

    def deploy(name: str) -> tuple[int, dict]:
        return fame("deploy", str(tmp_path / f"{name}.bpmn"))

    code, said = deploy("first")
    assert (code, said["robots"]["A"]["state"]) == (0, "started"), said
    code, said = deploy("second")
    assert code == 0, said

    def at(element: str):
        return lambda said: [wait["element"] for wait in said["robots"]["A"]["waits"]] == [element]

    until(lambda: fame("status"), at("second"), "the second process did not run")
    (tmp_path / "wrong.bpmn").write_text(waiting("x").replace("</process>", "<dance/></process>"))
    code, said = deploy("wrong")
    assert code == 2, said

    twin = start("engine", "A")
    _, complaint = twin.communicate(timeout=LIMIT)
    assert (twin.returncode, "there is an engine 'A' already" in complaint.decode()) == (2, True)

    os.kill(engine.pid, signal.SIGKILL)
    engine.wait()
    code, said = deploy("first")
    assert code == 1, said
    start("engine", "A")
    until(lambda: deploy("first"), lambda said: said["robots"]["A"]["state"] == "started", "it did not come back")
