"""How far one process reaches: the agriculture mission with 1, 10, 100 and 1000 tractors, each with an own engine.

The tractors stand in rows beside the field, and every one that is idle answers every weed. Each size runs in a process
of its own, as often as `--runs` says; the quickest counts. Times are CPU times of the one thread there is, so that it
does not matter what else the machine does. `cost` is that per robot and simulated second, the drone among the robots,
without building the scenario and ending it; memory per robot is the growth of the largest resident set from the
smallest size on.

    python benchmarks/scale.py
    python benchmarks/scale.py --sizes 1 10 100 --seconds 120 --json
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from fame.middleware.local import LocalSubscription  # noqa: E402
from fame.scenario import Scenario  # noqa: E402
from fame.scenario.run import Run  # noqa: E402 - building it and running it are measured apart

SIZES = (1, 10, 100, 1000)
ROW = 15
"""Tractors side by side, a metre apart."""
APART = 4.0
"""m from row to row: more than a range sensor sees, so that no tractor has more to measure than another."""


def scenario(size: int, seconds: float) -> Scenario:
    """The example with so many tractors, in rows to the west of the field."""
    loaded = Scenario.load(ROOT / "examples" / "agriculture.yaml", duration=seconds)
    assert loaded.world is not None
    drone, tractor = loaded.world.robots[:2]
    places = [(-1.0 - APART * (number // ROW), 0.5 + number % ROW) for number in range(size)]
    tractors = [replace(tractor, name=f"Tractor_{number}", at=at) for number, at in enumerate(places, 1)]
    _, low, right, high = loaded.world.bounds
    world = replace(loaded.world, robots=(replace(drone, at=(1.0, -0.5)), *tractors))
    world = replace(world, bounds=(min(x for x, _ in places) - 1, low, right, high))
    pool = loaded.cast["Tractor_1"]
    cast = {"Drone": loaded.cast["Drone"]} | {robot.name: pool for robot in tractors}
    return replace(loaded, world=world, cast=cast)


def measure(size: int, seconds: float) -> dict[str, Any]:
    """One run, in this process."""
    delivered: dict[str, int] = {}
    enqueue = LocalSubscription.enqueue

    def count(self: LocalSubscription, message: Any) -> None:
        name = self.topic.rpartition("/")[2]
        delivered[name] = delivered.get(name, 0) + 1
        enqueue(self, message)

    LocalSubscription.enqueue = count  # type: ignore[method-assign]
    begun = time.process_time()
    run = Run(scenario(size, seconds), False, None, None, False, False)
    built = time.process_time()
    work, times = run._work, []

    def timed(begun: float) -> Any:
        started = time.process_time()
        try:
            return work(begun)
        finally:
            times.append(time.process_time() - started)

    run._work = timed  # type: ignore[method-assign]
    result = run.result()
    (spent,) = times
    whole = time.process_time() - built
    messages = sum(delivered.values())
    return {
        "tractors": size,
        "simulated_s": round(result.simulated, 3),
        "wall_s": round(result.wall, 3),
        "cpu_s": round(spent, 3),
        "building_s": round(built - begun, 3),
        "ending_s": round(whole - spent, 3),
        "times_real_time": round(result.simulated / spent, 2),
        "messages": messages,
        "messages_per_s": round(messages / spent),
        "requests": delivered.get("weed_position", 0) // size,
        "answers": delivered.get("tractor_position", 0),
        "cost_us": round(spent * 1e6 / (size + 1) / result.simulated),
        "resident_kb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def fresh(size: int, seconds: float) -> dict[str, Any]:
    """One run, in a process of its own."""
    command = [sys.executable, __file__, "--one", str(size), "--seconds", str(seconds)]
    row: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="how many tractors")
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated seconds (60)")
    parser.add_argument("--runs", type=int, default=1, help="runs of each size (1)")
    parser.add_argument("--json", action="store_true", help="one JSON line per size")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one, options.seconds)))
        return
    if not options.json:
        print("tractors  x real time  messages/s  requests  answers  building   ending  cost/robot/s  memory/robot")
    first: dict[str, Any] = {}
    for size in options.sizes:
        rows = [fresh(size, options.seconds) for _ in range(options.runs)]
        row = min(rows, key=lambda one: float(one["cpu_s"]))
        first = first or row
        more = size - first["tractors"]
        row["robot_kb"] = round((row["resident_kb"] - first["resident_kb"]) / more) if more else None
        if options.json:
            print(json.dumps(row), flush=True)
            continue
        memory = f"{row['robot_kb']:9} KiB" if more else ""
        speed = f"{size:8}  {row['times_real_time']:11.2f}  {row['messages_per_s']:10}  {row['requests']:8}"
        times = f"{row['building_s']:6.2f} s {row['ending_s']:6.2f} s  {row['cost_us']:9} us"
        print(f"{speed}  {row['answers']:7}  {times}  {memory}".rstrip(), flush=True)


if __name__ == "__main__":
    main()
