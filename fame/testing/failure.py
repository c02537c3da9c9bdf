"""The text of a failed expectation: where each token is, what it waits for and why, and the last events.

The run is saved beside it: the recording (``run.mcap``), and each diagram with the path of the run on it.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fame.bpmn.model import ElementOutcome
from fame.clock import SECOND
from fame.errors import FameError
from fame.log.reading import tally
from fame.testing.trace import TraceStep

if TYPE_CHECKING:
    from fame.testing.mission import MissionUnderTest

LAST = 12
"""How many of the last events are shown."""


class ExpectationError(AssertionError):
    """An expectation of a mission under test did not hold. The text shows the state of the mission."""


def failure(mission: MissionUnderTest, text: str) -> ExpectationError:
    """Return the error of an expectation that did not hold, with the state of the mission; saves the run."""
    saved = mission.save()
    return ExpectationError("\n".join([text, "", *state_lines(mission), *saved]))


def state_lines(mission: MissionUnderTest) -> Iterator[str]:
    """Yield the state of a mission, for people: time, tokens, last events, reports."""
    yield f"at {mission.now:g} s"
    if not mission.begun:
        yield "nothing has run yet: call advance or run_until"
        return
    yield "tokens:"
    for robot in mission.robots:
        yield from (f"  {line}" for line in _token_lines(mission, robot))
    steps = [step for step in mission.trace.steps if step.what in _SHOWN]
    yield f"last events ({min(LAST, len(steps))} of {len(steps)}):" if steps else "no event yet"
    yield from (f"  {event_line(mission, step)}" for step in steps[-LAST:])
    if mission.reports:
        yield "reports:"
        for report in mission.reports[-LAST:]:
            place = f" {mission.elements.shown(report.robot, report.element)}" if report.element else ""
            yield f"  {report.time / SECOND:9.3f} s  {report.robot}{place}: {report.detail}"


_SHOWN = {
    "start": "started",
    "enter": "entered",
    "leave": "left",
    "cancel": "cancelled",
    "fail": "failed",
    "end": "ended",
}


def _token_lines(mission: MissionUnderTest, robot: str) -> Iterator[str]:
    node = mission.node(robot)
    waits = node.waiting_tokens()
    for wait in waits:
        came = mission.trace.of(robot, frozenset([wait.element]), "enter")
        since = f" since {came[-1].time / SECOND:g} s" if came and node.engine.instances else ""
        why = wait.suspended or f"waits for {wait.text}"
        yield f"{robot}  at {mission.elements.shown(robot, wait.element)}{since}, {why}"
    failed = [instance for instance in node.instances if instance.error is not None]
    for instance in failed[-1:]:
        yield f"{robot}  failed: {instance.error}"
    if not waits and not failed:
        ended = node.instances[-1].status if node.instances else "never started"
        yield f"{robot}  no token: {ended}"


def event_line(mission: MissionUnderTest, step: TraceStep) -> str:
    """Return an event on one line."""
    detail = f" ({step.detail})" if step.what in ("fail", "end") and step.detail else ""
    shown = mission.elements.shown(step.robot, step.element)
    return f"{step.time / SECOND:9.3f} s  {step.robot}  {_SHOWN[step.what]} {shown}{detail}"


# ---- what is saved ---------------------------------------------------------------------------------------------------


def save_diagrams(mission: MissionUnderTest, folder: Path) -> Iterator[Path]:
    """Draw the diagram of each file that ran, with the path of the run on it."""
    from fame.bpmn.draw.diagram import draw

    tallies = _tallies(mission)
    for definitions in mission.files():
        if definitions.file not in tallies:
            continue
        path = folder / f"{Path(definitions.file).stem or 'model'}.svg"
        try:
            path.write_text(draw(definitions, tallies[definitions.file]), encoding="utf-8")
        except FameError:  # a diagram that cannot be drawn hides no failure
            continue
        yield path


def _tallies(mission: MissionUnderTest) -> dict[str, dict[str, Counter[ElementOutcome]]]:
    """File -> element -> number of executions with each outcome."""
    names: dict[str, str] = {}
    for file, element in mission.trace.covered:
        names.setdefault(element, file)
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for step in mission.trace.steps:
        counts[step.element][step.what] += 1
    found: dict[str, dict[str, Counter[ElementOutcome]]] = {}
    for element, file in names.items():
        found.setdefault(file, {})[element] = tally(counts[element], over=False)
    return found
