"""Engines of simulated missions are killed right after seeded records of their journals, and go on.

A case is one record of one robot. Several cases share a run, so that hundreds of them take minutes. What is compared:
what has completed before and after each kill, and at the end the outcome and how often each activity has completed.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from durable_runs import DurableRun

import fame

ROOT = Path(__file__).resolve().parent.parent
TOGETHER = 10
"""Cases of one run."""


@dataclass(frozen=True)
class Mission:
    """An example, and the elements whose number of completions must be that of the uninterrupted run.

    The others depend on when a robot answers: a tractor that is busy does not.
    """

    example: str
    elements: tuple[str, ...]


MISSIONS = (
    Mission("ground_vehicles", ("Activity_Explore", "Activity_GoTo", "Activity_Fire")),
    Mission(
        "agriculture",
        ("Activity_TakeOff", "Activity_Explore", "Activity_ReturnToBase", "Activity_Land", "Activity_CutGrass",
         "Activity_StopBlade"),
    ),
)  # fmt: skip


class KilledRun(DurableRun):
    """A run in which each robot's engine is killed after some of its records."""

    wanted: Mapping[str, Sequence[int]]

    def begin(self) -> None:
        self.appended: Counter[str] = Counter()
        self.differences: list[str] = []
        super().begin()
        for robot in self.keepers:
            self._watch(robot)

    def _watch(self, robot: str) -> None:
        """Count the records of a robot, and kill its engine when one is written that is wanted."""
        journal = self.keepers[robot][1].journal
        append = journal.append
        journal.sync = lambda then: then()  # type: ignore[method-assign]  # no disk: thousands of records

        def counted(record: Mapping[str, Any]) -> None:
            append(record)
            self.appended[robot] += 1
            if self.appended[robot] in self.wanted.get(robot, ()):
                self.scheduler.soon(partial(self._kill, robot))

        journal.append = counted  # type: ignore[method-assign]

    def _kill(self, robot: str) -> None:
        before = self._completed(robot)
        self.kill(robot)
        self._watch(robot)
        if before != (now := self._completed(robot)):
            self.differences.append(
                f"{robot} at record {self.appended[robot]}: {before - now} lost, {now - before} more"
            )

    def _completed(self, robot: str) -> Counter[str]:
        node = next(node for node in self.nodes if node.name == robot)
        return sum((instance.visits for instance in node.instances), Counter[str]())

    def totals(self, mission: Mission) -> dict[str, int]:
        """How often the elements that count have completed in the whole team."""
        found = sum((self._completed(node.name) for node in self.nodes), Counter[str]())
        return {element: found[element] for element in mission.elements}


def run(mission: Mission, wanted: Mapping[str, Sequence[int]]) -> tuple[str, KilledRun]:
    """The status of a run in which engines are killed at some records."""
    with tempfile.TemporaryDirectory() as folder:
        made = KilledRun(fame.Scenario.load(ROOT / "examples" / f"{mission.example}.yaml"), False, None, None)
        made.folder, made.wanted = Path(folder), wanted
        return made.result().status, made


def rows(cases: int, seed: int) -> Iterator[dict[str, Any]]:
    """A row for each mission: cases, kills, and what was different."""
    for number, mission in enumerate(MISSIONS):
        dice, begun = random.Random(seed), time.perf_counter()
        status, plain = run(mission, {})
        totals, records = plain.totals(mission), sorted(plain.appended.elements())
        count = cases // len(MISSIONS) + (number < cases % len(MISSIONS))
        different, kills, left = list[str](), 0, count
        while left > 0:
            chosen = Counter(dice.choices(records, k=min(TOGETHER, left)))
            left -= chosen.total()
            wanted = {
                robot: dice.sample(range(1, plain.appended[robot] + 1), min(n, plain.appended[robot]))
                for robot, n in chosen.items()
            }
            ended, made = run(mission, wanted)
            kills += made.kills
            different += made.differences
            if (ended, made.totals(mission)) != (status, totals):
                different.append(f"{wanted}: {ended}, {made.totals(mission)} instead of {status}, {totals}")
        yield {"row": f"{mission.example}, killed at seeded records", "cases": count, "kills": kills,
               "records": dict(plain.appended), "different": different,
               "seconds": round(time.perf_counter() - begun, 1)}  # fmt: skip
