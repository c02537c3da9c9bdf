"""A run that lasts goes over to a changed model: all its robots or none, as ``fame deploy --migrate`` does it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

from fame.clock import SECOND
from fame.deploy.loading import LEAVING
from fame.deploy.migration import Foreseen, foresee, migrate_robot
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.robot import RobotNode
    from fame.scenario.plan import Plan
    from fame.scenario.run import Run

_MIGRATION = "migration"
"""Why a mission is suspended: for `RobotNode.hold`."""
_POLL = SECOND // 50
_FREE = ("file", "definitions", "library", "variables", "types", "properties", "duration")
"""What of a plan may differ: the cast only in its pools."""


def migrate_run(run: Run, plan: Plan, switched: Callable[[], object] = lambda: None) -> Mapping[str, Foreseen]:
    """Let the robots of a run go on in the model of another plan, between two steps of the scheduler.

    `switched` is called when they have the new model, before a token moves in it. Returns what becomes of each robot;
    if a token of one is `blocked`, none has changed. Raises ConfigError for a plan that differs in more than its model,
    and ModelError and MessageError for one that cannot be run: the run goes on as it was.
    """
    _refuse_others(run.scenario, plan)
    made = {node.name: node for node in run.nodes_of(plan)}
    old = {node.name: node for node in run.nodes if node.name not in run.dead}
    taken = False
    try:
        found = _foreseen(made, old)
        if not any(one.blocked for one in found.values()):
            _hold(run, old.values())
            found = _foreseen(made, old)  # time may have passed, in which tokens have moved
        if not any(one.blocked for one in found.values()):
            go_on = _take_over(run, plan, made, old)
            taken = True
            switched()
            for act in go_on:
                act()
    finally:
        for node in made.values() if not taken else ():
            node.close()
        for node in old.values() if not taken else ():
            node.release(_MIGRATION)
    return found


def _refuse_others(old: Plan, new: Plan) -> None:
    differs = [one.name for one in fields(old) if one.name not in (*_FREE, "cast")]
    differs = [name for name in differs if getattr(old, name) != getattr(new, name)]
    if old.cast.keys() != new.cast.keys():
        differs.append("robots")
    if differs:
        raise ConfigError(f"only the model of a run can change, not its {', '.join(differs)}", file=new.file)


def _foreseen(made: Mapping[str, RobotNode], old: Mapping[str, RobotNode]) -> Mapping[str, Foreseen]:
    return {name: foresee(made[name], node, {}, node.mission.hash()) for name, node in old.items()}


def _hold(run: Run, nodes: Collection[RobotNode]) -> None:
    """Hold the missions, and wait until their scripts have left: robots are safe meanwhile, if time passes."""
    for node in nodes:
        node.hold(_MIGRATION, safe=False)
    until = run.scheduler.now + LEAVING
    run.scheduler.run(run.scheduler.now)
    for node in nodes if any(node.leaving for node in nodes) else ():
        node.host.make_safe("suspended")
    while any(node.leaving for node in nodes) and run.scheduler.now < until:
        run.scheduler.run(run.scheduler.now + _POLL)


def _take_over(
    run: Run, plan: Plan, made: dict[str, RobotNode], old: Mapping[str, RobotNode]
) -> list[Callable[[], object]]:
    """Put the new nodes in the place of the old ones. Returns what lets each go on.

    Raises MissionError; then nothing has changed.
    """
    go_on = [migrate_robot(made[name], node, {}, "migrated to the changed model")[0] for name, node in old.items()]
    for name in made.keys() - old.keys():  # its engine is dead
        made.pop(name).close()
    for name, node in old.items():
        new = made[name]
        new.runner.cancelled.take_up(node.runner.cancelled.table(), new.runner.inbox.action)
        node.close()
        new.engine.parameters.update(plan.variables.get(name, {}))
        new.host.observer = run.observer
        new.attach(new.engine)  # observers watch it from here
    run.scenario, run.nodes = plan, [made.get(node.name, node) for node in run.nodes]
    return go_on
