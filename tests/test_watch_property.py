"""A robot watches a property of its team: when another one breaks it, its event sub-process reacts."""

from __future__ import annotations

import signal
import time
from contextlib import closing
from pathlib import Path
from subprocess import Popen

import pytest
from bpmn_text import document, properties
from middleware_contract import DOMAIN, needs
from test_engine_processes import ENVIRONMENT, fame, told

from fame.clock import SECOND
from fame.log import Recording
from fame.log.judge import judge_log
from fame.properties import parse
from fame.robot import Event
from fame.scenario import Scenario
from fame.scenario.process import connect, scheduler_for

EMPTY = "std_msgs/msg/Empty"
SENTENCE = "after A throws /go, A throws /done within 2 s"


def team(pause: str) -> str:
    """A throws /go, and after a pause /done; B watches that, and throws /safe when it takes too long."""
    signals = "".join(f'<signal id="S_{name}" name="{name}"/>' for name in ("go", "done", "safe"))
    flows = [("A0", "A1"), ("A1", "A2"), ("A2", "A3"), ("A3", "A4"), ("A4", "A5")]

    def drawn(pairs: list[tuple[str, str]]) -> str:
        return "".join(f'<sequenceFlow id="F_{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairs)

    def timer(id: str, text: str) -> str:
        inner = f"<timerEventDefinition id='t_{id}'><timeDuration>{text}</timeDuration></timerEventDefinition>"
        return f'<intermediateCatchEvent id="{id}">{inner}</intermediateCatchEvent>'

    def throw(id: str, name: str) -> str:
        inner = f'<signalEventDefinition id="s_{id}" signalRef="S_{name}"/>'
        return f'<intermediateThrowEvent id="{id}">{inner}</intermediateThrowEvent>'

    first = f"""<process id="P_A" isExecutable="true"><startEvent id="A0"/>{timer("A1", "PT3S")}{throw("A2", "go")}
      {timer("A3", pause)}{throw("A4", "done")}{timer("A5", "PT30S")}{drawn(flows)}</process>"""
    second = f"""<process id="P_B" isExecutable="true"><startEvent id="B0"/>
      <callActivity id="B1" name="Watch" calledElement="watch_property"><property id="p" name="in"/>
        <dataInputAssociation id="d"><sourceRef>R</sourceRef><targetRef>p</targetRef></dataInputAssociation>
      </callActivity><dataObjectReference id="R" dataObjectRef="D">
        {properties(property="alive", sentence=SENTENCE)}</dataObjectReference>
      <dataObject id="D"/>{drawn([("B0", "B1")])}
      <subProcess id="Handler" triggeredByEvent="true"><startEvent id="H0" isInterrupting="true">
        {properties(type="std_msgs/msg/String")}<signalEventDefinition id="v" signalRef="S_v"/></startEvent>
        {throw("H1", "safe")}{drawn([("H0", "H1")])}</subProcess></process>"""
    pools = "".join(f'<participant id="Pool_{one}" name="{one}" processRef="P_{one}"/>' for one in "AB")
    violated = '<signal id="S_v" name="violated/alive"/>'
    return document(f'{signals}{violated}<collaboration id="T">{pools}</collaboration>{first}{second}')


@pytest.mark.parametrize(("pause", "ends"), [("PT1S", False), ("PT2S", False), ("PT2.5S", True)])
def test_a_robot_of_a_run_reacts_to_a_violation(tmp_path: Path, pause: str, ends: bool) -> None:
    (tmp_path / "team.bpmn").write_text(team(pause))
    events: list[Event] = []
    Scenario.load(tmp_path / "team.bpmn", duration=6).run(observer=events.append)
    reacted = [event.time / SECOND for event in events if (event.element, event.what) == ("H1", "leave")]
    assert bool(reacted) == ends
    assert all(5 < second < 5.2 for second in reacted)  # /go at 3 s, and 2 s


@pytest.mark.processes
@pytest.mark.parametrize(
    "middleware",
    [
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
    ],
)
def test_a_robot_that_is_stopped_breaks_its_deadline(
    middleware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    (tmp_path / "team.bpmn").write_text(team("PT1.7S"))
    scheduler, seen = scheduler_for(middleware), list[str]()
    engines = {
        robot: Popen(fame("engine", robot, "--insecure", "--middleware", middleware), env=ENVIRONMENT) for robot in "AB"
    }
    try:
        with closing(connect(middleware, scheduler)) as network:
            node = network.node("test")

            def go(_: object) -> None:
                seen.append("go")  # its events are on their way 50 ms later
                scheduler.after(SECOND * 3 // 10, lambda: engines["A"].send_signal(signal.SIGSTOP))

            node.subscription("/go", EMPTY, go)
            node.subscription("/done", EMPTY, lambda _: seen.append("done"))
            node.subscription("/safe", EMPTY, lambda _: seen.append("safe"))
            recorder = Popen(
                fame("log", "record", "-o", str(tmp_path / "run.mcap"), "--middleware", middleware), env=ENVIRONMENT
            )
            engines["recorder"] = recorder
            told("deploy", str(tmp_path / "team.bpmn"), "--wait", "60", "--middleware", middleware)
            end = time.monotonic() + 60
            while "safe" not in seen and time.monotonic() < end:
                scheduler.run(scheduler.now + SECOND // 20)
            scheduler.run(scheduler.now + SECOND)
            recorder.send_signal(signal.SIGINT)
            recorder.wait(30)
    finally:
        for process in engines.values():
            process.kill()
            process.wait()
    assert seen == ["go", "safe"]
    (again,) = judge_log(tmp_path / "run.mcap", [parse(SENTENCE, name="alive")])
    assert again.verdict == "violated"
    with Recording(tmp_path / "run.mcap") as recording:
        times = {event.element: event.time for event in recording.events() if event.what == "leave"}
    late = times["H1"] / SECOND - again.time  # type: ignore[operator]
    print(f"{middleware}: reacted {late:.3f} s after the bound")
    assert late > 0
