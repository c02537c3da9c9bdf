"""Engines of missions in a simulated world are killed at seeded instants, go on, and the mission ends as it should."""

import random
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from durable_runs import DurableRun

import fame
from fame.clock import SECOND

EXAMPLE = Path(__file__).parent.parent / "examples" / "ground_vehicles.yaml"


@pytest.mark.parametrize(
    ("seconds", "status"), [(5, "timeout"), pytest.param(300, "completed", marks=pytest.mark.long)], ids=str
)
def test_the_ground_vehicles_hit_their_target_although_their_engines_die(
    tmp_path: Path, seconds: float, status: str
) -> None:
    run = DurableRun(fame.Scenario.load(EXAMPLE, duration=seconds), False, None, None)
    run.folder = tmp_path
    dice = random.Random(0)
    for _ in range(15):
        kill: Callable[[], object] = partial(run.kill, dice.choice(sorted(run.scenario.cast)))
        run.scheduler.after(round(dice.uniform(0.5, min(seconds, 60)) * SECOND), kill)
    assert (run.result().status, run.kills > 5) == (status, True)


class KilledAsking(DurableRun):
    """REX is killed when it has asked its planner for the first time, before the answer."""

    def begin(self) -> None:
        super().begin()
        journal = self.keepers["REX"][1].journal
        append = journal.append
        journal.sync = lambda then: then()  # type: ignore[method-assign]
        asked = set[str]()

        def appended(record: Mapping[str, Any]) -> None:
            append(record)
            effects = record.get("set", {}).get("effects", {})
            asked.update(batch for batch, sent in effects.items() if sent[0][1] == "/REX/goal_pose")
            if asked.intersection(record.get("gone", {}).get("effects", ())) and not self.kills:
                self.scheduler.soon(partial(self.kill, "REX"))

        journal.append = appended  # type: ignore[method-assign]


@pytest.mark.long
def test_a_vehicle_that_dies_before_its_planner_answers_asks_again(tmp_path: Path) -> None:
    run = KilledAsking(fame.Scenario.load(EXAMPLE), False, None, None)
    run.folder = tmp_path
    assert (run.result().status, run.kills) == ("completed", 1)
