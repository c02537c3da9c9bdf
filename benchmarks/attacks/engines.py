"""Attacks that would hang an engine, or end it (what it reads, what its scripts do, where its log goes)."""

from __future__ import annotations

import itertools
import json
import os
import signal
import time

from attacks.field import START, WAIT, Field, held, model, process, script, scripted
from fame.middleware.interface import QoS
from fame.middleware.messages import create

TICK = model(
    '<signal id="S" name="beat"/>',
    '<process id="p" isExecutable="true"><startEvent id="s"><timerEventDefinition>'
    "<timeCycle>R/PT0.1S</timeCycle></timerEventDefinition></startEvent>"
    '<endEvent id="e"><signalEventDefinition signalRef="S"/></endEvent>'
    '<sequenceFlow id="f" sourceRef="s" targetRef="e"/></process>',
)
"""Says /beat ten times a second."""


def blanks(field: Field) -> None:
    """A declaration of 300,000 blanks."""
    engine = field.start("A")
    field.say("/A/bpmn_process", "<?xml" + " " * 300_000 + ">")
    held(field.answer("A", "refused", 5), "not refused within 5 s")
    held(engine.ends(5), "does not end on Ctrl-C")


def large_model(field: Field) -> None:
    """A model of 100,000 tasks, sent to a robot on a mission."""
    field.run("A", TICK)
    beats: list[float] = []
    field.stranger.subscription("/beat", "std_msgs/msg/Empty", lambda message: beats.append(time.monotonic()))
    held(field.until(lambda: len(beats) > 5, 10), "the mission does not beat")
    tasks = [f'<task id="t{number}"/>' for number in range(100_000)]
    field.say("/A/bpmn_process", model(process("q", START, *tasks, WAIT)))
    held(field.answer("A", "started", 60), "not started within 60 s")
    longest = max(after - before for before, after in itertools.pairwise(beats))
    held(longest < 2, f"the mission stood still for {longest:.1f} s")


def computes_in_c(field: Field) -> None:
    """Scripts that compute in C, or sleep."""
    texts = {
        "A": "9**9**9",
        "B": "import re\nre.match('(a|aa)+$', 'a' * 60 + 'b')",
        "C": "import time\ntime.sleep(60)",
    }
    for name, text in texts.items():
        field.start(name)
        field.say(f"/{name}/bpmn_process", scripted(text))
    for name, text in texts.items():
        fails = lambda name=name: any(report.failed for report in field.reports[name])  # noqa: E731
        held(field.until(fails, 60), f"{text!r} was not ended within 60 s")
        held(field.speaks(name, 20), f"{name} is silent after {text!r}")


def uninterruptible(field: Field) -> None:
    """A call that nothing can interrupt: the engine ends, and says where."""
    engine = field.start("A")
    field.say("/A/bpmn_process", scripted("import itertools\nsum(itertools.count())"))
    held(field.until(lambda: not engine.alive, 70), "hangs forever")
    held(engine.process.returncode == -signal.SIGVTALRM, f"ended with {engine.process.returncode}")
    held("A.bpmn" in engine.said, "does not say where")


def endless_feel(field: Field) -> None:
    """FEEL and EL without end."""
    conditions = {
        "A": "=count(for i in 1..1000000000 return i) > 0",
        "B": "=some i in 1..100000000000 satisfies i &lt; 0",
        "C": "=floor(1.5, 999999999) > 0",
    }
    for name, text in conditions.items():
        field.start(name)
        branch = (
            '<startEvent id="s"/><exclusiveGateway id="g" default="f2"/><userTask id="u"/>'
            '<sequenceFlow id="f0" sourceRef="s" targetRef="g"/><sequenceFlow id="f2" sourceRef="g" targetRef="u"/>'
            f'<sequenceFlow id="f1" sourceRef="g" targetRef="u"><conditionExpression>{text}</conditionExpression>'
            "</sequenceFlow>"
        )
        field.say(f"/{name}/bpmn_process", model(f'<process id="p" isExecutable="true">{branch}</process>'))
    for name, text in conditions.items():
        decided = lambda name=name: any(  # noqa: E731
            report.failed or report.waits or report.answer == "refused" for report in field.reports[name]
        )
        held(field.until(decided, 60), f"{text!r} was not ended within 60 s")
        held(field.speaks(name, 20), f"{name} is silent after {text!r}")


def thread(field: Field) -> None:
    """A script's thread that is no daemon, as the engine is to end."""
    engine = field.run("A", scripted("import threading\nthreading.Thread(target=threading.Event().wait).start()"))
    held(engine.ends(6), "does not end on Ctrl-C")


LOGS = model(process("p", START, *(script(f"for i in range(100): log('line {n}')", f"t{n}") for n in range(3)), WAIT))


def _goes_on(field: Field, name: str) -> None:
    """Scripts that log came to their end, and garbage ends nothing."""
    held(field.until(lambda: any(report.waits for report in field.reports[name]), 5), "a script that logs failed")
    for number in range(300):
        field.say(f"/{name}/bpmn_process", f"garbage {number}")
    held(field.speaks(name), "is silent after a burst of garbage")
    held(not field.last(name).failed, "the mission failed")


def full_disk(field: Field) -> None:
    """The disk of the log is full."""
    with open("/dev/full", "w") as full:
        engine = field.run("A", LOGS, stderr=full)
    _goes_on(field, "A")
    held(engine.ends(5), "does not end on Ctrl-C")
    held(engine.process.returncode == 0, f"ended with {engine.process.returncode}")


def closed_pipe(field: Field) -> None:
    """The pipe of the log is closed."""
    reading, writing = os.pipe()
    engine = field.start("A", stderr=writing)
    os.close(writing)
    os.close(reading)
    field.say("/A/bpmn_process", LOGS)
    held(field.answer("A", "started", 10), "did not start")
    held(field.speaks("A"), "is silent")
    _goes_on(field, "A")
    held(engine.ends(5), "does not end on Ctrl-C")
    held(engine.process.returncode == 0, f"ended with {engine.process.returncode}")


def garbage(field: Field) -> None:
    """1,500 messages of garbage a second, for 4 s."""
    engine = field.start("A")
    for topic in ("/A/bpmn_process", "/A/bpmn_task"):
        field.publisher(topic)
    for number in range(200):
        for topic in ("/A/bpmn_process", "/A/bpmn_task"):
            for more in range(15):
                field.say(topic, f"garbage {number} {more} " + "x" * 100)
        field.pass_time(0.02)
    held(field.speaks("A"), "is silent")
    held(len(engine.said) < 20_000, f"wrote {len(engine.said)} bytes of log")
    held("like this within a second" in engine.said, "does not count")


def large_tasks(field: Field) -> None:
    """25 tasks with ids of 15 MB."""
    engine = field.start("A")
    publisher = field.publisher("/A/bpmn_task", qos=QoS(depth=5))
    for number in range(25):
        publisher.publish(
            create("std_msgs/msg/String", json.dumps({"id": f"{number}{'y' * 15_000_000}", "element": "e"}))
        )
        field.pass_time(0.05)
    held(field.speaks("A"), "is silent")
    field.pass_time(1)
    held(engine.megabytes < 250, f"keeps {engine.megabytes} MB")


def large_samples(field: Field) -> None:
    """Three samples of 90 MB, just what the middleware takes."""
    engine = field.start("A")
    publisher = field.publisher("/A/bpmn_process", qos=QoS(depth=1))
    for _ in range(3):
        publisher.publish(create("std_msgs/msg/String", "x" * 90_000_000))
        field.pass_time(1)
    held(field.speaks("A", 10), "is silent")
    field.pass_time(1)
    held(engine.megabytes < 350, f"keeps {engine.megabytes} MB")
