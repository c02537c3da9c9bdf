"""Engines of missions in a simulated world are killed at seeded instants, go on, and the mission ends as it should."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import fame
from fame.clock import SECOND
from fame.robot import RobotNode
from fame.robot.durable import Recorder, restored
from fame.robot.journal import Journal, StateDirectory
from fame.scenario.run import Run

ROOT = Path(__file__).parent.parent


class DurableRun(Run):
    """A run whose engines keep journals; `kill` ends one as its process would, and starts it again."""

    folder: Path

    def begin(self) -> None:
        self.keepers: dict[str, tuple[StateDirectory, Recorder]] = {}
        self.kills = 0
        for node in self.nodes:
            directory = StateDirectory(self.folder / node.name)
            recorder = Recorder(node, Journal(directory, {"robot": node.name}))
            recorder.begin()
            self.keepers[node.name] = directory, recorder
        super().begin()

    def kill(self, robot: str) -> None:
        """Kill the engine of a robot now, and start it again."""
        place, old = next((place, node) for place, node in enumerate(self.nodes) if node.name == robot)
        if not old.engine.instances:
            return
        self.kills += 1
        directory, recorder = self.keepers[robot]
        recorder._quiet = True
        recorder.journal.close()
        for task in old.runner._tasks.values():
            if task.due is not None:
                task.due.cancel()
        old.runner._tasks.clear()
        old.runner._untils.clear()
        old.host.timers.close()
        old.node.close()
        new = self._alone(robot)
        found = directory.read()
        assert found is not None
        tables = restored(new, found)
        again = Recorder(new, Journal.resume(directory, found))
        self.keepers[robot] = directory, again
        self.nodes[place] = new
        again.go_on(tables, 0.0)

    def _alone(self, robot: str) -> RobotNode:
        """A node of one robot, loaded."""
        team = self.scenario
        self.scenario = replace(team, cast={robot: team.cast[robot]})
        try:
            (node,) = self._build_nodes(strict=False)
        finally:
            self.scenario = team
        return node


def run_with_kills(example: str, folder: Path, seed: int, kills: int, until: float) -> tuple[Any, DurableRun]:
    """The result of an example whose engines are killed at random instants."""
    scenario = fame.Scenario.load(ROOT / "examples" / f"{example}.yaml")
    run = DurableRun(scenario, False, None, None)
    run.folder = folder
    dice = random.Random(seed)
    robots = sorted(scenario.cast)
    for _ in range(kills):
        kill: Callable[[], object] = partial(run.kill, dice.choice(robots))
        run.scheduler.after(round(dice.uniform(0.5, until) * SECOND), kill)
    return run.result(), run


@pytest.mark.parametrize("seed", range(3))
def test_the_ground_vehicles_hit_their_target_although_their_engines_die(seed: int, tmp_path: Path) -> None:
    result, run = run_with_kills("ground_vehicles", tmp_path, seed, kills=5, until=60)
    assert (result.status, run.kills > 0) == ("completed", True)
