"""Acknowledged signals between two machines whose link is down half of the time: does each arrive once, in order?

Two network namespaces with a veth pair. A counts on one, B keeps the counts on the other; the link is taken down and up
by ``ip link set``, each time for `PERIOD` s, which is longer than the lease of discovery. One JSON line per middleware.
Run as ``python -m benchmarks.roaming [SIGNALS [MIDDLEWARE ...]]`` (root; it makes the namespaces itself).
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from typing import Any

from fame.bpmn.reader import read_text
from fame.clock import SECOND, WallScheduler
from fame.deploy import Deployment, EngineNode, engines
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.scenario.process import Router, connect
from tests.networked_machines import ADDRESSES, INTERFACE, machines

PERIOD = 4.0
LONGEST = 300.0
"""s"""
_PORT = 7447
_THROW = 'type="std_msgs/msg/Int32" payload="${n}" delivery="acknowledged"'


def model(signals: int, throw: str = _THROW, rate: int = 100, kept: str = "count") -> str:
    """A throws the numbers from 1 on, so many a second; B keeps them."""
    pairs = (word.split("=", 1) for word in throw.split())
    given = "".join(f'<c:property name="{name}" value={value}/>' for name, value in pairs)
    return f"""<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"
 xmlns:c="http://camunda.org/schema/1.0/bpmn"><signal id="S" name="count"/><collaboration id="c">
 <participant id="PA" name="A" processRef="a"/><participant id="PB" name="B" processRef="b"/></collaboration>
 <process id="a" isExecutable="true"><startEvent id="s"/>
 <scriptTask id="zero"><script>n = 0</script></scriptTask>
 <scriptTask id="one"><script>n = n + 1; text = "%0100d" % n</script></scriptTask>
 <intermediateThrowEvent id="t"><extensionElements><c:properties>{given}</c:properties></extensionElements>
 <signalEventDefinition signalRef="S"/></intermediateThrowEvent><exclusiveGateway id="x" default="more"/>
 <intermediateCatchEvent id="w"><timerEventDefinition><timeDuration>PT{1 / rate:g}S</timeDuration>
 </timerEventDefinition></intermediateCatchEvent><endEvent id="e"/>
 <sequenceFlow id="f1" sourceRef="s" targetRef="zero"/>
 <sequenceFlow id="f2" sourceRef="zero" targetRef="one"/>
 <sequenceFlow id="f3" sourceRef="one" targetRef="t"/><sequenceFlow id="f4" sourceRef="t" targetRef="x"/>
 <sequenceFlow id="more" sourceRef="x" targetRef="w"/><sequenceFlow id="f5" sourceRef="w" targetRef="one"/>
 <sequenceFlow id="f6" sourceRef="x" targetRef="e"><conditionExpression>${{n &gt;= {signals}}}</conditionExpression>
 </sequenceFlow></process>
 <process id="b" isExecutable="true"><startEvent id="s2"/>
 <scriptTask id="none"><script>kept = []</script></scriptTask>
 <intermediateCatchEvent id="h"><extensionElements><c:properties><c:property name="queue" value="10000"/>
 </c:properties></extensionElements><signalEventDefinition signalRef="S"/></intermediateCatchEvent>
 <scriptTask id="k"><script>kept.append({kept})</script></scriptTask>
 <sequenceFlow id="g1" sourceRef="s2" targetRef="none"/><sequenceFlow id="g2" sourceRef="none" targetRef="h"/>
 <sequenceFlow id="g3" sourceRef="h" targetRef="k"/><sequenceFlow id="g4" sourceRef="k" targetRef="h"/>
 </process></definitions>"""


def engine(robot: str, backend: str, text: str, signals: int, silence: float = LONGEST) -> None:
    """The process of a robot. A deploys the model of a `text` to both, and says when the link may go; B prints what it
    has kept, when it has all or nothing has come for a `silence` (s)."""
    scheduler, place, kept = WallScheduler(), int(robot == "B"), list[Any]()
    network: Any = INTERFACE
    if backend == "zenoh":
        from fame.middleware.zenoh import open_router

        listen, others = f"tcp/{ADDRESSES[place]}:{_PORT}", [f"tcp/{ADDRESSES[0]}:{_PORT}"] * place
        kept.append(open_router([f"tcp/127.0.0.1:{_PORT}", listen], others, None))
        network = Router("127.0.0.1")
    middleware = connect(backend, scheduler, network)
    options = EngineOptions(on_report=lambda event: print(event.robot, event.detail, file=sys.stderr, flush=True))
    node = EngineNode(robot, scheduler=scheduler, middleware=middleware, options=options)
    if robot == "A":
        while len(engines(middleware)) < 2:
            scheduler.run(scheduler.now + SECOND // 10)
        both = read_text(text, file="counts.bpmn")
        deployment = Deployment(
            both, id="d", sequence=1, scheduler=scheduler, middleware=middleware, ended=lambda _: scheduler.stop(),
            options=DeploymentOptions(patience=60.0),  # a busy machine takes long to find all ends of a topic
        )  # fmt: skip
        deployment.begin()
        scheduler.run(scheduler.now + 60 * SECOND)
        print(json.dumps([str(progress) for progress in deployment.robots.values()]), flush=True)
        begun = scheduler.now
        while node.running is None or any(one.status == "running" for one in node.running.instances):
            scheduler.run(scheduler.now + SECOND // 10)
        print(json.dumps((scheduler.now - begun) / SECOND), flush=True)
        scheduler.run()
    until = scheduler.now + round(LONGEST * SECOND)
    counts, last = list[int](), until
    while len(counts) < signals and scheduler.now < min(until, last + round(silence * SECOND)):
        scheduler.run(scheduler.now + SECOND // 2)
        if node.running is not None and node.running.instances:
            before, counts = len(counts), list(node.running.instances[-1].variables.get("kept", []))
            last = scheduler.now if len(counts) > before else last
    scheduler.run(scheduler.now + 3 * SECOND)  # for what would come twice
    print(json.dumps(counts), flush=True)


def run(backend: str, signals: int, period: float = PERIOD) -> dict[str, Any]:
    """One run: what B has kept, and for how long it lasted (s)."""
    with machines(2) as pair:
        command = [sys.executable, "-m", "benchmarks.roaming", "engine"]
        made = [
            subprocess.Popen(
                pair.inside(place, *command, robot, backend, str(signals)),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            for place, robot in enumerate("AB")
        ]
        try:
            first, second = (process.stdout for process in made)
            assert first is not None
            assert second is not None
            begun = json.loads(first.readline())
            began, downs = time.monotonic(), 0
            state, result = "up", list[str]()
            reader = threading.Thread(target=lambda: result.append(second.readline()), daemon=True)
            reader.start()
            while reader.is_alive() and time.monotonic() - began < LONGEST:
                state = "down" if state == "up" else "up"
                downs += state == "down"
                pair.set(state)
                reader.join(period)
            pair.set("up")
            reader.join(LONGEST)
            counts = json.loads(result[0])
        finally:
            for process in made:
                process.kill()
                process.communicate()
    return {
        "middleware": backend, "signals": signals, "deployed": begun, "kept": len(counts),
        "once_and_in_order": counts == list(range(1, signals + 1)), "downs": downs, "period_s": period,
        "took_s": round(time.monotonic() - began),
    }  # fmt: skip


if __name__ == "__main__":
    if sys.argv[1:2] == ["engine"]:
        engine(sys.argv[2], sys.argv[3], model(int(sys.argv[4])), int(sys.argv[4]))
    else:
        for wanted in sys.argv[2:] or ("dds", "zenoh"):
            print(json.dumps(run(wanted, int(sys.argv[1]) if sys.argv[1:] else 10_000)), flush=True)
