"""Explorations: shipped missions, and collaborations that grow. ``python benchmarks/explore.py [--quick]``

Each case runs in a process of its own: states, transitions, seconds (CPU), transitions per second of the search of the
team, microseconds per step of a robot and per step that an engine has taken (others are known from states that agree on
what the step reads), megabytes at most, bytes per state (where there are enough of them to tell).
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

MODELS = ROOT / "models"
SHIPPED = ("ground_vehicles", "agriculture", "agriculture_resilient", "agriculture_return", "convoy", "shuttle",
           "reassembly", "sabotage", "warehouse")  # fmt: skip


def shipped(name: str) -> Callable[[], dict[str, object]]:
    """A mission that comes with FAME, with three robots in each pool of several, delivery `run`."""

    def request() -> dict[str, object]:
        from fame.bpmn.pools import pools_of
        from fame.bpmn.reader import read

        definitions = read(MODELS / f"{name}.bpmn")
        robots = {pool.name: 3 for pool in pools_of(definitions) if pool.multi_instance}
        return {"model": definitions, "robots": robots, "delivery": "run"}

    return request


def made(
    steps: Callable[[], dict[str, object]], several: tuple[str, ...] = (), **options: object
) -> Callable[[], dict[str, object]]:
    """A collaboration made for this."""

    def request() -> dict[str, object]:
        from collaborations import team

        return {"model": team(steps(), several), **options}  # type: ignore[arg-type]

    return request


def philosophers(count: int) -> Callable[[], dict[str, object]]:
    """Dining philosophers, whose product is large and whose robots are small."""

    def robots() -> dict[str, object]:
        import collaborations

        return collaborations.philosophers(count, ordered=False)  # type: ignore[return-value]

    return made(robots, delivery="fast", limit=150_000)


CASES: dict[str, Callable[[], dict[str, object]]] = {
    **{f"{name}, 3 per pool": shipped(name) for name in SHIPPED},
    "17 parallel branches": made(lambda: {"A": [("and", *[["work"] for _ in range(17)])]}),
    "12 parallel branches, unreduced": made(
        lambda: {"A": [("and", *[["work"] for _ in range(12)])]}, reduced=False, delivery="run"
    ),
    "fleet of 20 alike": made(lambda: {"F": ["work", "work", "timer PT5S"]}, ("F",), robots={"F": 20}),
    "fleet of 20 alike that answers": made(
        lambda: {"C": ["throw go", "catch done"], "F": ["catch go", "work", "work", "throw done"]},
        ("F",),
        robots={"F": 20},
    ),
    **{f"philosophers, {count}": philosophers(count) for count in (3, 4, 5)},
}


ENOUGH = 1000
"""States from which on the memory of a process tells what one needs."""


def measure(case: str) -> dict[str, float | None]:
    """Explore one case in this process."""
    from fame.check.explore import exploration, local, product
    from fame.scenario.explore.exploration import explore

    spent = {"steps": 0.0, "count": 0, "engine": 0.0, "by engine": 0, "search": 0.0}
    searched = exploration.explore

    def timed(step: Callable[..., object], total: str, count: str) -> Callable[..., object]:
        def steps(self: local.Local, *arguments: object, **options: object) -> object:
            begun, before = time.process_time(), self.steps
            try:
                return step(self, *arguments, **options)
            finally:
                spent[total] += time.process_time() - begun
                spent[count] += self.steps - before

        return steps

    def search(team: product.Product) -> object:
        begun, within = time.process_time(), spent["steps"]
        try:
            return searched(team)
        finally:
            spent["search"] += time.process_time() - begun - (spent["steps"] - within)

    explore(MODELS / "ground_vehicles.bpmn", delivery="run")  # everything is imported then, and its types are read
    options = CASES[case]()
    for name in ("start", "_new_step", "decisions"):
        setattr(local.Local, name, timed(getattr(local.Local, name), "steps", "count"))
    local.Local._explored = timed(local.Local._explored, "engine", "by engine")  # type: ignore[method-assign, assignment]
    exploration.explore = search  # type: ignore[assignment, attr-defined]
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    result = explore(**options)  # type: ignore[arg-type]
    seconds = time.process_time() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    transitions = sum(one.transitions for one in result.searches)
    return {
        "states": result.states,
        "transitions": transitions,
        "seconds": seconds,
        "per_second": transitions / max(spent["search"], 1e-9),
        "step_us": 1e6 * spent["steps"] / max(spent["count"], 1),
        "engine_us": 1e6 * spent["engine"] / max(spent["by engine"], 1),
        "mb": peak / 1024,
        "bytes": 1024 * (peak - before) / result.states if result.states >= ENOUGH else None,
        "exhaustive": result.exhaustive,
    }


def main() -> None:
    """Measure every case, one process each, and print a table."""
    if len(sys.argv) > 2 and sys.argv[1] == "--case":
        print(json.dumps(measure(sys.argv[2])))
        return
    names = [name for name in CASES if "--quick" not in sys.argv or "philosophers" not in name]
    print(f"{'case':36}{'states':>9}{'transitions':>12}{'s':>7}{'trans/s':>10}"
          f"{'step us':>9}{'engine us':>11}{'MB':>6}{'B/state':>9}")  # fmt: skip
    for name in names:
        command = [sys.executable, __file__, "--case", name]
        found = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
        cut = "" if found["exhaustive"] else "  not exhaustive"
        size = "-" if found["bytes"] is None else f"{found['bytes']:.0f}"
        print(f"{name:36}{found['states']:9}{found['transitions']:12}{found['seconds']:7.2f}{found['per_second']:10.0f}"
              f"{found['step_us']:9.0f}{found['engine_us']:11.0f}{found['mb']:6.0f}{size:>9}{cut}",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
