"""A robot watches a property of its team: when another one breaks it, its event sub-process reacts."""

import signal
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest
from bpmn_text import document, properties
from middleware_contract import DOMAIN, needs
from test_engine_processes import ENVIRONMENT, fame, told
from test_resumption import Durable

from fame.clock import SECOND
from fame.log import Recording
from fame.log.judge import judge_log
from fame.middleware import messages
from fame.middleware.simulated_time import CLOCK, CLOCK_TYPE
from fame.properties import parse
from fame.robot import Event
from fame.scenario import Scenario
from fame.scenario.process import connect, scheduler_for

EMPTY, STRING = "std_msgs/msg/Empty", "std_msgs/msg/String"
SENTENCE = "after A throws /go, A throws /done within 2 s"
LONGER = SENTENCE.replace("2 s", "8 s")
"""For a busy machine."""


def team(pause: str, before: str = "PT3S", ends: str = "true") -> str:
    """A throws /go, and after a pause /done; B watches that, and throws /safe when it takes too long (and `ends`)."""
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

    first = f"""<process id="P_A" isExecutable="true"><startEvent id="A0"/>{timer("A1", before)}{throw("A2", "go")}
      {timer("A3", pause)}{throw("A4", "done")}{timer("A5", "PT30S")}{drawn(flows)}</process>"""
    second = f"""<process id="P_B" isExecutable="true"><startEvent id="B0"/>
      <callActivity id="B1" name="Watch" calledElement="watch_property"><property id="p" name="in"/>
        <dataInputAssociation id="d"><sourceRef>R</sourceRef><targetRef>p</targetRef></dataInputAssociation>
      </callActivity><dataObjectReference id="R" dataObjectRef="D">
        {properties(property="alive", sentence=SENTENCE)}</dataObjectReference>
      <dataObject id="D"/>{drawn([("B0", "B1")])}
      <subProcess id="Handler" triggeredByEvent="true"><startEvent id="H0" isInterrupting="{ends}">
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


class Watching(Durable):
    """A throws; B has a state directory and watches. `heard` are the signals: name, and seconds since /go."""

    robot = "B"

    def __init__(self, folder: Path, pause: str) -> None:
        super().__init__(folder)
        self.heard: list[tuple[str, float]] = []
        self.listen("A", "B")
        self.add("A")
        self.clock = self.person.publisher(CLOCK, CLOCK_TYPE)
        self.tick()
        for name, type in {"go": EMPTY, "done": EMPTY, "safe": EMPTY, "violated/alive": STRING}.items():
            self.person.subscription(f"/{name}", type, partial(self.hear, name))
        self.deploy(team(pause, before="PT20S", ends="false"))
        while not self.heard:
            self.pass_time(0.01)

    def tick(self) -> None:
        now = self.scheduler.now
        self.clock.publish(messages.create(CLOCK_TYPE, {"clock": {"sec": now // SECOND, "nanosec": now % SECOND}}))
        self.scheduler.after(SECOND // 100, self.tick)

    def hear(self, name: str, message: object) -> None:
        self.began = self.began if self.heard else self.scheduler.now
        self.heard.append((name, (self.scheduler.now - self.began) / SECOND))

    def crash(self) -> None:
        recorder, running = self.engine._keeper.recorder, self.engine.running
        assert recorder is not None
        assert running is not None
        recorder._quiet = True
        for task in running.runner._tasks.values():
            task.script.close()
        super().crash()

    def is_away(self, start: float, end: float) -> None:
        """B is killed and started again, so many seconds after /go."""
        self.pass_time(start)
        self.crash()
        self.pass_time(end - start)
        self.start()
        self.pass_time(15 - end)


@pytest.mark.long_but("*away0-*")
@pytest.mark.parametrize(
    ("pause", "away", "reacts"),
    [
        ("PT2.5S", (0.5, 1), True),  # what was pending is not forgotten
        ("PT10S", (0.5, 3), True),  # nor when its time is over meanwhile, and A has done nothing
        ("PT1.9S", (0.2, 0.8), False),  # A answers
        ("PT1S", (0.5, 1.5), False),  # A answers meanwhile: not known
        ("PT5S", (2.5, 3), True),  # it has reacted, and does so once
        *(("PT5S", (2 + hundredth / 100, 3), True) for hundredth in range(1, 15, 2)),
    ],
)
def test_a_watch_that_is_killed_forgets_nothing_and_reports_once(
    tmp_path: Path, pause: str, away: tuple[float, float], reacts: bool
) -> None:
    watching = Watching(tmp_path / "state", pause)
    watching.is_away(*away)
    names = [name for name, _ in watching.heard]
    assert [names.count(name) for name in ("violated/alive", "safe")] == [reacts, reacts], watching.heard
    assert watching.engine.state == "running"
    for engine in watching.engines.values():
        engine.close()


@pytest.mark.parametrize("pause", ["PT2.1S", "PT10S"])
def test_a_robot_on_the_network_reacts_within_half_a_second_of_the_bound(tmp_path: Path, pause: str) -> None:
    watching = Watching(tmp_path / "state", pause)
    watching.pass_time(5)
    seconds = dict(watching.heard)  # simulated s since /go, which is 2 s before the bound
    assert 2 < seconds["violated/alive"] <= seconds["safe"] < 2.5
    for engine in watching.engines.values():
        engine.close()


def reaction(middleware: str, folder: Path, *, killed: bool = False) -> tuple[list[str], float]:
    """What two engines throw of which A is stopped, and how long after the bound B reacts (recorded s)."""
    (folder / "team.bpmn").write_text(team("PT7S").replace(SENTENCE, LONGER))
    scheduler, seen = scheduler_for(middleware), list[str]()
    words = {robot: fame("engine", robot, "--insecure", "--middleware", middleware) for robot in "AB"}
    words["B"] += ["--state", str(folder / "state")] * killed
    engines = {robot: Popen(each, env=ENVIRONMENT) for robot, each in words.items()}
    try:
        with closing(connect(middleware, scheduler)) as network:
            node = network.node("test")

            def start_again() -> None:
                engines["B"].kill()
                engines["B"].wait()
                engines["B"] = Popen(words["B"], env=ENVIRONMENT)

            def hear(message: Any) -> None:
                if '"A3"' in message.data and "stop" not in seen:  # who records hears of it before A is stopped
                    seen.append("stop")
                    scheduler.after(SECOND // 2, lambda: engines["A"].send_signal(signal.SIGSTOP))
                    scheduler.after(SECOND * 3 // 2, start_again if killed else lambda: None)

            node.subscription("/A/bpmn_events", STRING, hear)
            node.subscription("/done", EMPTY, lambda _: seen.append("done"))
            node.subscription("/safe", EMPTY, lambda _: seen.append("safe"))
            words["recorder"] = fame("log", "record", "-o", str(folder / "run.mcap"), "--middleware", middleware)
            recorder = engines["recorder"] = Popen(words["recorder"], env=ENVIRONMENT, stderr=PIPE)
            assert recorder.stderr is not None
            recorder.stderr.readline()  # it is there
            told("deploy", str(folder / "team.bpmn"), "--wait", "60", "--middleware", middleware)
            end = time.monotonic() + 60
            while "safe" not in seen and time.monotonic() < end:
                scheduler.run(scheduler.now + SECOND // 20)
            scheduler.run(scheduler.now + SECOND)
            recorder.send_signal(signal.SIGINT)
            recorder.communicate(timeout=60)
    finally:
        for process in engines.values():
            process.kill()
            process.wait()
    (again,) = judge_log(folder / "run.mcap", [parse(LONGER, name="alive")])
    assert again.verdict == "violated", again.text
    assert again.time is not None
    with Recording(folder / "run.mcap") as recording:
        times = {event.element: event.time for event in recording.events() if event.what == "leave"}
    return seen, times["H1"] / SECOND - again.time


@pytest.mark.processes
@pytest.mark.parametrize("killed", [False, True])  # the watching robot
@pytest.mark.parametrize(
    "middleware",
    [
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
    ],
)
def test_a_robot_that_is_stopped_breaks_its_deadline(
    middleware: str, killed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    seen, late = reaction(middleware, tmp_path, killed=killed)
    assert seen == ["stop", "safe"]
    assert late > 0  # how long it takes on a machine: benchmarks/properties.py --reaction
