"""Stimuli: what may happen to a robot, and how its engine takes it."""

from __future__ import annotations

from typing import Any

from fame.check.explore.host import ExplorationHost
from fame.check.explore.remembering import owner_of
from fame.check.explore.timers import Timer
from fame.engine import Engine

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
        host.finish(engine.waits[what], detail)
    elif kind == "timer":
        timer = host.timers.pop(what)
        host.fired = timer
        if timer.period is not None:
            host.timers[what] = Timer(timer.group, timer.offset + timer.period, timer.period)
        engine.timer_fired(what, last=timer.period is None)
    elif kind == "person":
        _person(engine, what, host)
    elif kind == "offer":
        engine.activate(what)
    elif kind == "block":
        engine.waits.pop(what).started = False


def _person(engine: Engine, element: str, host: ExplorationHost) -> None:
    """A person completes a task: what it asks for is unknown, and any variable that is visible may have changed."""
    waits = [wait for one in engine.instances.values() for wait in one.waits() if wait.node.id == element]
    for wait in waits:
        for name in host.memory.readers:
            host.memory.set(name, owner_of(wait.scope.variables, name))
    engine.complete_task(element, host.answers(element, waits[0].scope.variables))
