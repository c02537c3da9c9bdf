"""What interpretation costs: the same car, stopped by a Python controller and by a BPMN model (paper section 5.4).

A car drives straight at an obstacle at 0.8, 0.9 and 1.0 m/s and stops when its range falls below 0.5 m. The direct
controller imports no engine. Each way runs ten times per speed and tyre, with the same seeds; printed are the distances
left between nose and obstacle beside the paper's Fig. 15, and the CPU time of both ways. The tyres were chosen by
`--calibrate`, on the direct controller alone, to leave what the paper's compiled code left.

    python benchmarks/interpretation.py
    python benchmarks/interpretation.py --real-time --runs 2
    python benchmarks/interpretation.py --json
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
sys.path.insert(0, str(ROOT.parent))

from fame.clock import SECOND, Scheduler, WallScheduler  # noqa: E402
from fame.middleware import messages  # noqa: E402
from fame.middleware.interface import Node  # noqa: E402
from fame.middleware.local import LocalMiddleware  # noqa: E402
from sim2d.world import World  # noqa: E402

SPEEDS = (0.8, 0.9, 1.0)
NEAR = 0.5
"""The range below which the car stops, m."""
TYRES = {"simulated": 0.1273, "real": 0.5892}
"""Coefficients of friction, from `--calibrate`."""
PAPER = {"simulated": (14.67, 14.09), "real": (40.18, 39.07)}
"""Distance left, cm, mean over the speeds: compiled, FAME (paper section 5.4, Fig. 15)."""
FACE = 3.0
"""Where the obstacle's face is, m."""
LENGTH = 0.25
DURATION = 8.0
TWIST, RANGE = "geometry_msgs/msg/Twist", "sensor_msgs/msg/Range"


class Direct:
    """The controller as one would write it by hand."""

    def __init__(self, node: Node, speed: float) -> None:
        self.drive = messages.create(TWIST, {"linear": {"x": speed}})
        self.out = node.publisher("cmd_vel", TWIST)
        node.subscription("range", RANGE, self.heard)
        self.near = False

    def start(self) -> None:
        self.out.publish(self.drive)

    def heard(self, message: Any) -> None:
        if not self.near:
            self.near = message.range < NEAR
            self.out.publish(messages.create(TWIST) if self.near else self.drive)


def interpreted(scheduler: Scheduler, middleware: LocalMiddleware, speed: float) -> Callable[[], object]:
    """The same as a model, on an engine. Returns what starts it."""
    import fame
    from fame.node import RobotNode, mission

    definitions = fame.read(ROOT / "stop_before_obstacle.bpmn")
    node = RobotNode("car", mission(definitions, definitions.processes[0]), scheduler=scheduler, middleware=middleware)
    node.load()
    return partial(node.start, {"speed": speed})


def run(way: str, speed: float, friction: float, seed: int, real_time: bool = False) -> tuple[float, float]:
    """One run. Returns the distance left (cm) and the CPU time of all but the building of it (s)."""
    scheduler = WallScheduler() if real_time else Scheduler()
    middleware = LocalMiddleware(scheduler)
    world = World(
        {
            "bounds": [-1, -1, 5, 1],
            "obstacles": [{"name": "wall", "at": [FACE + 0.1, 0], "size": [0.2, 1.0]}],
            "robots": {"car": {"type": "car", "at": [0, 0], "length": LENGTH, "friction": friction, "max_speed": 1.2}},
        },
        seed=seed,
        scheduler=scheduler,
        middleware=middleware,
    )
    if way == "direct":
        start: Callable[[], object] = Direct(middleware.node("controller", "car"), speed).start
    else:
        start = interpreted(scheduler, middleware, speed)
    begun = time.process_time()
    world.start()
    start()
    scheduler.run(scheduler.now + round(DURATION * SECOND))
    spent = time.process_time() - begun
    left = FACE - (world.robots["car"].pose.x + LENGTH / 2)
    return left * 100, spent


def calibrate(target: float, runs: int) -> float:
    """The friction with which the direct controller leaves `target` cm on average."""
    low, high = 0.05, 2.0
    for _ in range(18):
        middle = (low + high) / 2
        mean = statistics.fmean(run("direct", speed, middle, seed)[0] for speed in SPEEDS for seed in range(runs))
        low, high = (middle, high) if mean < target else (low, middle)
    return round((low + high) / 2, 4)


def measure(tyre: str, runs: int, real_time: bool) -> dict[str, Any]:
    """Both ways in turn, pair by pair."""
    pairs = [
        (run("direct", speed, TYRES[tyre], seed, real_time), run("interpreted", speed, TYRES[tyre], seed, real_time))
        for speed in SPEEDS
        for seed in range(runs)
    ]
    direct, model = ([pair[side][0] for pair in pairs] for side in (0, 1))
    ratios = [pair[1][1] / pair[0][1] for pair in pairs]
    return {
        "tyre": tyre,
        "real_time": real_time,
        "runs": len(pairs),
        "direct_cm": round(statistics.fmean(direct), 3),
        "interpreted_cm": round(statistics.fmean(model), 3),
        "spread_cm": round(statistics.pstdev(direct), 3),
        "difference_cm": round(statistics.fmean(abs(a - b) for a, b in zip(direct, model, strict=True)), 4),
        "paper_cm": PAPER[tyre],
        "cpu_direct_ms": round(statistics.median(pair[0][1] for pair in pairs) * 1000, 2),
        "cpu_interpreted_ms": round(statistics.median(pair[1][1] for pair in pairs) * 1000, 2),
        "cpu_ratio": round(statistics.median(ratios), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, help="runs per speed (10)")
    parser.add_argument("--real-time", action="store_true", help="on the wall clock")
    parser.add_argument("--json", action="store_true", help="one JSON line per tyre")
    parser.add_argument("--calibrate", action="store_true", help="find the tyres, on the direct controller alone")
    options = parser.parse_args()
    if options.calibrate:
        for tyre, (target, _) in PAPER.items():
            print(tyre, calibrate(target, options.runs))
        return
    run("interpreted", 1.0, 0.5, 0)  # what is imported and compiled once is not measured
    rows = [measure(tyre, options.runs, options.real_time) for tyre in TYRES]
    if options.json:
        for row in rows:
            print(json.dumps(row))
        return
    print(f"{'tyre':10} {'direct':>8} {'FAME':>8} {'diff':>8} {'paper':>16} {'CPU direct':>11} {'CPU FAME':>9} ratio")
    for row in rows:
        paper = "{} / {} cm".format(*row["paper_cm"])
        distances = f"{row['direct_cm']:5.2f} cm {row['interpreted_cm']:5.2f} cm {row['difference_cm']:5.3f} cm"
        cpu = f"{row['cpu_direct_ms']:8.1f} ms {row['cpu_interpreted_ms']:6.1f} ms {row['cpu_ratio']:.3f}"
        print(f"{row['tyre']:10} {distances} {paper:>16} {cpu}")


if __name__ == "__main__":
    main()
