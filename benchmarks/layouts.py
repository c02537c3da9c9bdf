"""The agriculture mission on grounds that chance laid out: does it always complete, and what is touched.

Each layout has one to five obstacles, five weeds and one to three tractors (or `--tractors`), all by its seed, which is
that of all noise too. Prints a line per layout, then how many completed with every weed cut. Exit code 1 if one did
not, or if a tractor touched an obstacle.

    python benchmarks/layouts.py
    python benchmarks/layouts.py --first 100 --layouts 12 --tractors 12 --json
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from fame.bpmn.pools import assign_pools, pools_of  # noqa: E402
from fame.scenario import Scenario  # noqa: E402
from sim2d.config import world_config  # noqa: E402

PASSAGE, ROOM = 1.2, 0.6
"""m between solid things at least, so that a tractor passes; and around a weed, so that it can be reached."""


class Places:
    """Free places on the field, m."""

    def __init__(self, random: random.Random) -> None:
        self._random, self._taken = random, list[tuple[float, float, float]]()

    def take(self, radius: float, apart: float) -> list[float]:
        """The middle of a disc that is so far from all others."""
        while True:
            x, y = round(self._random.uniform(0.5, 19.5), 2), round(self._random.uniform(0.5, 14.5), 2)
            if all(math.dist((x, y), (a, b)) > radius + other + apart for a, b, other in self._taken):
                self._taken.append((x, y, radius))
                return [x, y]


def layout(seed: int, tractors: int | None) -> dict[str, Any]:
    """A world by chance."""
    chance = random.Random(seed)
    count = tractors or chance.randint(1, 3)
    places, radii = Places(chance), [round(chance.uniform(0.4, 1.3), 2) for _ in range(chance.randint(1, 5))]
    return {
        "bounds": [-2, -1, 21, 16],
        "obstacles": [
            {"name": f"obstacle {number}", "at": places.take(radius, PASSAGE), "radius": radius}
            for number, radius in enumerate(radii)
        ],
        "weeds": [{"name": f"weed {number}", "at": places.take(0.0, ROOM)} for number in range(5)],
        "robots": {"Drone": {"type": "drone", "at": [-1, 0]}}
        | {f"Tractor_{number}": {"type": "tractor", "at": places.take(0.4, PASSAGE)} for number in range(1, count + 1)},
    }


def run(base: Scenario, seed: int, tractors: int | None) -> dict[str, Any]:
    """The mission on one layout."""
    world = world_config(layout(seed, tractors))
    cast = assign_pools(pools_of(base.definitions), [robot.name for robot in world.robots])
    result = replace(base, world=world, cast=cast, seed=seed, duration=1800.0).run()
    assert result.world is not None
    touched = [(one["a"], one["b"]) for one in result.world["collisions"]]
    return {
        "seed": seed,
        "tractors": len(cast) - 1,
        "status": result.status,
        "simulated_s": round(result.simulated, 1),
        "uncut": [name for name, weed in result.world["weeds"].items() if weed["by"] is None],
        "obstacles_touched": [pair for pair in touched if not set(pair) <= set(cast)],
        "robots_touched": [pair for pair in touched if set(pair) <= set(cast)],
        "messages": result.messages,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--layouts", type=int, default=20, help="how many (20)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first (0)")
    parser.add_argument("--tractors", type=int, help="in each; otherwise one to three by chance")
    parser.add_argument("--json", action="store_true", help="one JSON line per layout")
    options = parser.parse_args()
    base, rows = Scenario.load(ROOT / "examples" / "agriculture.yaml"), []
    for seed in range(options.first, options.first + options.layouts):
        row = run(base, seed, options.tractors)
        rows.append(row)
        print(
            json.dumps(row) if options.json else "  ".join(f"{key} {value}" for key, value in row.items()), flush=True
        )
    good = [row for row in rows if row["status"] == "completed" and not row["uncut"] and not row["obstacles_touched"]]
    if not options.json:
        met = sum(bool(row["robots_touched"]) for row in rows)
        print(f"{len(good)} of {len(rows)} completed, every weed cut, no obstacle touched; in {met} two robots touched")
    return int(len(good) < len(rows))


if __name__ == "__main__":
    sys.exit(main())
