"""The run of a scenario beside an exploration that a limit has ended.

How long a behaviour takes is decided by the world, which no search knows: what a plain run shows is found by running.
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

_KINDS = ("run", "deadlock", "lost", "never")
"""Kinds of findings by which a model accepts that a robot waits at the end."""


def with_run(found: Exploration, scenario: Scenario, seconds: float | None) -> Exploration:
    """With a run of the scenario, as a finding if it fails or is not over at its end; `seconds` of the wall clock."""
    name = f"a run of the scenario (seed {scenario.seed})"
    try:
        result = scenario.run(pace=None if seconds is None else _Patience(seconds))
    except FameError as error:
        return replace(found, sampled=(*found.sampled, f"no run of the scenario: {error}"))
    ended = ", not to its end" if result.status == "interrupted" else ""
    found = replace(found, sampled=(*found.sampled, name + ended))
    violated = [str(one) for one in result.judgements if one.verdict == "violated"]
    failed = violated or any(robot.failed for robot in result.robots)
    if result.status in ("completed", "interrupted") and not failed:
        return found
    text = f"{name} goes wrong: {'; '.join([*violated, *result.messages])}"
    finding = Finding("run", text, accepted=_acceptance(scenario, result), certain=True)
    return replace(found, findings=tuple(sorted((*found.findings, finding), key=lambda one: one.level != "error")))


def _acceptance(scenario: Scenario, result: Result) -> str:
    """Why the model accepts what waits at the end; empty if not all of it is, or something else is wrong."""
    violated = any(one.verdict == "violated" for one in result.judgements)
    if violated or result.never_started or result.problems or any(robot.errors for robot in result.robots):
        return ""
    reasons = accepted(scenario.definitions, pools_of(scenario.definitions), scenario.library)
    waiting = (([wait.element for wait in robot.waits], robot.name) for robot in result.robots if robot.waits)
    robots = [(elements, scenario.cast[name].process.id) for elements, name in waiting]
    return acceptance(reasons, robots, _KINDS)


class _Patience:
    """Lets a run go on for some seconds of the wall clock."""

    attended = False

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds

    def advance(self, run: Run, until: int) -> None:
        """Run until `until` (ns), or end the run if the time is over: a run that has reached its end is not cut."""
        if time.monotonic() > self._end:
            run.interrupted = True
        else:
            run.scheduler.run(until)
