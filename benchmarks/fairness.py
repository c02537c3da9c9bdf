"""How long an engine that is busy with a greedy model leaves its sender without an answer, over DDS.

    python benchmarks/fairness.py [MODEL ...]

For each model an engine is started, the model deployed, and for a while an envelope sent every 50 ms whose answer is
a report. Prints a JSON line with the longest and the median time to the answer (s), the longest time between two
reports (s, of which one a second is due anyway), the size of the largest report, and what the engine said.
Use a network namespace of your own on a shared machine.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from itertools import pairwise
from statistics import median
from typing import Any

from fame.clock import SECOND
from fame.deploy import STATUS_QOS, STRING, Report
from fame.deploy.envelope import PROCESS_QOS, Envelope
from fame.middleware.dds import DdsMiddleware, DdsScheduler
from fame.middleware.messages import create

DURATION, PERIOD, PATIENCE = 12, 0.05, 60
BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
_TIMER = "<timerEventDefinition><{0}>{1}</{0}></timerEventDefinition>"


def _model(content: str, *flows: str) -> str:
    arrows = "".join(
        f'<sequenceFlow id="f{n}" sourceRef="{flow.split()[0]}" targetRef="{flow.split()[1]}"/>'
        for n, flow in enumerate(flows)
    )
    process = f'<process id="Greedy" isExecutable="true">{content}{arrows}</process>'
    return f'<definitions xmlns="{BPMN}" targetNamespace="t">{process}</definitions>'


MODELS = {
    "cycle of 1 ns": _model(
        f'<startEvent id="s">{_TIMER.format("timeCycle", "R/PT0.000000001S")}</startEvent><endEvent id="e"/>', "s e"
    ),
    "fork loop of 1 ms": _model(
        '<startEvent id="s"/><exclusiveGateway id="m"/><parallelGateway id="p"/><intermediateCatchEvent id="t">'
        f"{_TIMER.format('timeDuration', 'PT0.001S')}</intermediateCatchEvent>",
        "s m",
        "m t",
        "t p",
        "p m",
        "p m",
    ),
    "90,000 parallel tasks": _model(
        '<startEvent id="s"/><userTask id="u"><multiInstanceLoopCharacteristics><loopCardinality>90000'
        "</loopCardinality></multiInstanceLoopCharacteristics></userTask>",
        "s u",
    ),
    "string of 10^9": _model(
        '<startEvent id="s"/><scriptTask id="x"><script>text = "x" * 10**9</script></scriptTask><userTask id="u"/>',
        "s x",
        "x u",
    ),
}


def measure(name: str) -> dict[str, Any]:
    """Run one model."""
    scheduler = DdsScheduler()
    middleware = DdsMiddleware(scheduler)
    node = middleware.node("sender")
    reports: list[tuple[float, Report, int]] = []
    sent: dict[str, float] = {}
    taken: dict[str, float] = {}

    def hear(message: Any) -> None:
        report = Report.from_json(message.data)
        if report is None:
            return
        reports.append((time.monotonic(), report, len(message.data)))
        if report.deployment in sent:
            taken.setdefault(report.deployment, time.monotonic() - sent[report.deployment])

    def ask() -> None:
        id = f"ask{len(sent)}"
        envelope = Envelope(deployment=id, sequence=1, robot="A", phase="start", born=reports[-1][1].born)
        sent[id] = time.monotonic()
        out.publish(create(STRING, envelope.to_json()))

    def until(true: Any) -> None:
        end = time.monotonic() + PATIENCE
        while not true() and time.monotonic() < end:
            scheduler.run(scheduler.now + SECOND // 100)

    out = node.publisher("/A/bpmn_process", STRING, PROCESS_QOS)
    node.subscription("/A/bpmn_status", STRING, hear, STATUS_QOS)
    command = [sys.executable, "-m", "fame", "engine", "A", "--middleware", "dds"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as engine:
        try:
            until(lambda: reports)
            out.publish(create(STRING, MODELS[name]))
            until(lambda: any(report.hash for _, report, _ in reports))
            began = time.monotonic()
            while time.monotonic() < began + DURATION:
                ask()
                scheduler.run(scheduler.now + round(PERIOD * SECOND))
            until(lambda: len(taken) == len(sent))
        finally:
            engine.terminate()
            said = engine.communicate(timeout=PATIENCE)[1].splitlines()
    middleware.close()
    times = [moment for moment, _, _ in reports]
    last = reports[-1][1]
    return {
        "model": name,
        "longest": round(max(taken.values(), default=PATIENCE), 3),
        "median": round(median(taken.values()), 3) if taken else None,
        "unanswered": len(sent) - len(taken),
        "silence": round(max((b - a for a, b in pairwise(times)), default=0.0), 3),
        "report": max(size for _, _, size in reports),
        "state": last.state,
        "started": last.started,
        "elements": last.elements,
        "lines": len(said),
        "said": [line[:200] for line in said[:4]],
    }


if __name__ == "__main__":
    for model in sys.argv[1:] or MODELS:
        print(json.dumps(measure(model)), flush=True)
