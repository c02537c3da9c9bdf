"""The run of a scenario beside an exploration that a limit has ended.

No search knows how long a behaviour takes: the world decides that. So the engines run the scenario once, with its seed.
What goes wrong in it is a finding of kind ``run``. A run in which all goes well proves nothing: it is but a sample.
"""

from __future__ import annotations

import time
from dataclasses import replace

from fame.bpmn.pools import pools_of
from fame.check.explore import Exploration, Finding
from fame.check.explore.findings import acceptance
from fame.check.explore.places import accepted
from fame.errors import FameError
from fame.scenario.result import Result
from fame.scenario.run import Run
from fame.scenario.scenario import Scenario

_ACCEPTED = ("run", "deadlock", "lost", "never")
"""Kinds of findings of which each is accepted where a robot waits at the end."""


def with_run(explored: Exploration, scenario: Scenario, seconds: float | None) -> Exploration:
    """Return an exploration with a run of its scenario, cut after `seconds` of the wall clock, None for no bound."""
    name = f"a run of the scenario (seed {scenario.seed})"
    try:
        result = scenario.run(pace=None if seconds is None else _Patience(seconds))
    except FameError as error:
        return replace(explored, sampled=(*explored.sampled, f"no run of the scenario: {error}"))
    sample = name + (", not to its end" if result.status == "interrupted" else "")
    explored = replace(explored, sampled=(*explored.sampled, sample))
    failure = _failure(name, scenario, result)
    if failure is None:
        return explored
    findings = sorted((*explored.findings, failure), key=lambda finding: finding.level != "error")
    return replace(explored, findings=tuple(findings))


def _failure(name: str, scenario: Scenario, result: Result) -> Finding | None:
    """What goes wrong in a run: a robot fails, a property is violated, or it is not over when its time is."""
    violated = [str(judged) for judged in result.judgements if judged.verdict == "violated"]
    over = result.status in ("completed", "interrupted")
    if over and not violated and not any(robot.failed for robot in result.robots):
        return None
    text = f"{name} goes wrong: {'; '.join([*violated, *result.messages])}"
    return Finding("run", text, accepted="" if violated else _acceptance(scenario, result), certain=True)


def _acceptance(scenario: Scenario, result: Result) -> str:
    """Why the model accepts each wait at the end; empty if it does not, or if more is wrong than that robots wait."""
    if result.never_started or result.problems or any(robot.errors for robot in result.robots):
        return ""
    reasons = accepted(scenario.definitions, pools_of(scenario.definitions), scenario.library)
    waiting = [
        ([wait.element for wait in robot.waits], scenario.cast[robot.name].process.id)
        for robot in result.robots
        if robot.waits
    ]
    return acceptance(reasons, waiting, _ACCEPTED)


class _Patience:
    """A pace that lets a run go on for some seconds of the wall clock."""

    attended = False

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    def advance(self, run: Run, until: int) -> None:
        """Run until `until` (ns), or end the run if the time is over: a run that has reached its end is not cut."""
        if time.monotonic() > self._end:
            run.interrupted = True
        else:
            run.scheduler.run(until)
