"""Stimuli: what may happen to a robot, and how its engine takes it."""

from __future__ import annotations

from typing import Any

from fame.check.explore.abstraction import Step
from fame.check.explore.host import ExplorationHost, Running
from fame.check.explore.timers import Timer
from fame.engine import Engine
from fame.engine.host import BpmnError
from fame.engine.state import Wait

Stimulus = tuple[str, Any, Any]
"""What happens to a robot: (kind, key or element or topic, code or message number).

``end`` and ``block`` of a step by key, ``timer`` by key, ``person`` and ``offer`` by element, ``hear`` and ``outside``
by topic.
"""


def apply(engine: Engine, stimulus: Stimulus, host: ExplorationHost) -> None:
    """Give an engine a stimulus; `host` is its host."""
    kind, what, detail = stimulus
    if kind == "hear" or kind == "outside":
        if kind == "hear":
            received = what in engine.listeners or what in engine.program.starts
            host.outcome.flags.append(("received" if received else "lost" if engine.instances else "unneeded", what))
        engine.deliver(what, host.values.value(detail))
    elif kind == "end":
        _end(engine, what, detail, host)
    elif kind == "timer":
        timer = host.timers.pop(what)
        host.fired = timer
        if timer.period is not None:
            host.timers[what] = Timer(timer.group, timer.offset + timer.period, timer.period)
        engine.timer_fired(what, last=timer.period is None)
    elif kind == "person":
        host.forget(host.remembered)  # a person may set any variable
        engine.complete_task(what)
    elif kind == "offer":
        engine.activate(what)
    elif kind == "block":
        engine.waits.pop(what).started = False


def _end(engine: Engine, key: int, code: str | None, host: ExplorationHost) -> None:
    wait = engine.waits[key]
    step = step_under_way(wait)
    host.place = wait.node.id
    if code is None:
        host.end_step(step, wait.scope.variables)
    variable = getattr(wait.node.spec, "variable", "")
    host.forget(host.readers.get(variable, ()))
    if host.kept(variable):
        wait.scope.variables[variable] = host.values.unknown
    engine.script_ended(key, None if code is None else BpmnError(code))


def step_under_way(wait: Wait) -> Step:
    """What takes time where a token waits."""
    made = wait.node.spec.run(wait.scope.variables)
    assert isinstance(made, Running)
    return made.step
