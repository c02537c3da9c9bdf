"""What networks and clocks do to a mission: time that jumps, signals that get lost, robots that are cut off."""

from __future__ import annotations

import signal

from attacks.field import START, WAIT, Engine, Field, held, model, process, script
from fame.middleware.interface import QoS
from fame.middleware.messages import create

CLOCK = "rosgraph_msgs/msg/Clock"
SIGNALS = 50_000
LOOP = model(
    '<signal id="S" name="beat"/>',
    '<process id="p" isExecutable="true"><startEvent id="s"><timerEventDefinition>'
    "<timeCycle>R/PT0.2S</timeCycle></timerEventDefinition></startEvent>"
    '<endEvent id="e"><signalEventDefinition signalRef="S"/></endEvent>'
    '<sequenceFlow id="f" sourceRef="s" targetRef="e"/></process>',
)
"""Says /beat every 0.2 s of its time."""
SPEAKER = model(
    '<signal id="S" name="go"/>', process("p", START, script(f"for i in range({SIGNALS}): signal('go')"), WAIT)
)
COUNTER = model(
    '<signal id="S" name="go"/>',
    process("p", '<startEvent id="s"><signalEventDefinition signalRef="S"/></startEvent>', '<endEvent id="e"/>'),
)
WAITER = model(
    '<signal id="S" name="done"/>',
    process(
        "p", START, '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>'
    ),
)
SENDER = model(
    '<signal id="S" name="done"/>',
    process(
        "p",
        START,
        WAIT,
        '<intermediateThrowEvent id="t"><signalEventDefinition signalRef="S"/></intermediateThrowEvent>',
    ),
)


def _clock(field: Field, begin: float, seconds: float) -> None:
    """Say the time from `begin` on for so many seconds, as fast as reality."""
    clock = field.publisher("/clock", CLOCK, QoS(depth=10))
    for tick in range(round(seconds * 20)):
        time = begin + tick / 20
        clock.publish(create(CLOCK, {"clock": {"sec": int(time), "nanosec": int(time % 1 * 1e9)}}))
        field.pass_time(0.05)


def _on_a_clock(field: Field) -> tuple[Engine, list[object]]:
    """An engine in simulated time that beats, and its beats."""
    engine = field.start("A", "--use-sim-time")
    beats: list[object] = []
    field.stranger.subscription("/beat", "std_msgs/msg/Empty", beats.append)
    field.say("/A/bpmn_process", LOOP)
    held(field.answer("A", "started", 20), "did not start")
    _clock(field, 0, 2)
    held(beats, "the mission does not beat")
    return engine, beats


def clock_far_ahead(field: Field) -> None:
    """One /clock of 2^31-1 s, and a timer loop of 0.2 s."""
    engine, _ = _on_a_clock(field)
    _clock(field, 2**31 - 1, 0.05)
    held(field.speaks("A"), "is silent")
    held("jumped" in engine.said, "does not tell of it")
    held(engine.ends(6), "does not end on Ctrl-C")


def clock_begins_anew(field: Field) -> None:
    """A world is started again: its clock begins at 0 in mid-mission."""
    engine, beats = _on_a_clock(field)
    _clock(field, 500, 1)
    beats.clear()
    _clock(field, 0, 3)
    held(len(beats) > 3, f"beats {len(beats)} times in 3 s")
    held("jumped" in engine.said, "does not tell of it")


def signals_at_full_rate(field: Field) -> None:
    """50,000 signals at full rate: what does not arrive is told."""
    field.run("B", COUNTER)
    field.run("A", SPEAKER)
    came = -1
    while came < field.last("B").completed if field.reports["B"] else came < 0:
        came = field.last("B").completed if field.reports["B"] else -1
        field.reports["B"].clear()
        field.until(lambda: field.reports["B"], 5)
        field.pass_time(2)
    told = [text for name in "AB" for text in field.last(name).warnings if "lost" in text]
    held(came > 0, "no signal arrived")
    held(came == SIGNALS or told, f"{came} of {SIGNALS} arrived, and nobody says a word")


def cut_off_while_it_waits(field: Field) -> None:
    """A robot waits for a signal of one that is cut off for 8 s, and comes back."""
    sender = field.run("A", SENDER)
    field.run("B", WAITER)
    hears = lambda: any(wait["topics"].get("/done") for report in field.reports["B"] for wait in report.waits)  # noqa: E731
    held(field.until(hears, 10), "never hears of the other robot")
    sender.tell(signal.SIGSTOP)
    field.pass_time(8)
    sender.tell(signal.SIGCONT)
    gap = lambda: any("was gone" in str(wait) for report in field.reports["B"] for wait in report.waits)  # noqa: E731
    held(field.until(gap, 60), "nobody says that a signal may be lost")
