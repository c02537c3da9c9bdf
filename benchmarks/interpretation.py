"""What interpretation costs: the same cars, driven by Python controllers and by BPMN models (paper section 5.4).

Fig. 15: a car drives straight at an obstacle at 0.8, 0.9 and 1.0 m/s and stops when its range falls below 0.5 m. The
direct controller imports no engine. Each way runs ten times per speed and tyre, with the same seeds; printed are the
distances left between nose and obstacle beside the paper's, and the CPU time of both ways. The tyres were chosen by
`--calibrate`, on the direct controller alone, to leave what the paper's compiled code left.

Fig. 14: ten missions of the ground vehicles each way (`ground_vehicles_direct.py`, `models/ground_vehicles.bpmn`), each
in a process of its own together with its world, which is the same for both: CPU time from its start to the end of the
mission, and memory then.

    python benchmarks/interpretation.py
    python benchmarks/interpretation.py --real-time --runs 2
    python benchmarks/interpretation.py --middleware dds --runs 2
    python benchmarks/interpretation.py --json
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
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
from fame.middleware.interface import Middleware, Node  # noqa: E402
from fame.middleware.local import LocalMiddleware  # noqa: E402
from sim2d.world import World  # noqa: E402

SPEEDS = (0.8, 0.9, 1.0)
NEAR = 0.5
"""The range below which the car stops, m."""
TYRES = {"simulated": 0.1269, "real": 0.6153}
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


def interpreted(scheduler: Scheduler, middleware: Middleware, speed: float) -> Callable[[], object]:
    """The same as a model, on an engine. Returns what starts it."""
    import fame
    from fame.robot import RobotNode, make_mission

    definitions = fame.read(ROOT / "stop_before_obstacle.bpmn")
    node = RobotNode(
        "car", make_mission(definitions, definitions.processes[0]), scheduler=scheduler, middleware=middleware
    )
    node.load()
    return partial(node.start, {"speed": speed})


def controller(way: str, scheduler: Scheduler, middleware: Middleware, speed: float) -> Callable[[], object]:
    """Either controller of the car. Returns what starts it."""
    if way == "direct":
        return Direct(middleware.node("controller", "car"), speed).start
    return interpreted(scheduler, middleware, speed)


def world(friction: float, seed: int, scheduler: Scheduler, middleware: Middleware) -> World:
    """The car on its way to a wall."""
    config = {
        "bounds": [-1, -1, 5, 1],
        "obstacles": [{"name": "wall", "at": [FACE + 0.1, 0], "size": [0.2, 1.0]}],
        "robots": {"car": {"type": "car", "at": [0, 0], "length": LENGTH, "friction": friction, "max_speed": 1.2}},
    }
    return World(config, seed=seed, scheduler=scheduler, middleware=middleware)


def distance_left(world: World) -> float:
    """From the nose to the wall, cm."""
    return (FACE - (world.robots["car"].pose.x + LENGTH / 2)) * 100


def run(way: str, speed: float, friction: float, seed: int, where: str = "simulated") -> tuple[float, float]:
    """One run. Returns the distance left (cm) and the CPU time of all but the building of it (s)."""
    if where == "dds":
        from stopping_over_dds import run as run_apart

        return run_apart(way, speed, friction, seed)
    scheduler = WallScheduler() if where == "real time" else Scheduler()
    middleware = LocalMiddleware(scheduler)
    made = world(friction, seed, scheduler, middleware)
    start = controller(way, scheduler, middleware, speed)
    begun = time.process_time()
    made.start()
    start()
    scheduler.run(scheduler.now + round(DURATION * SECOND))
    return distance_left(made), time.process_time() - begun


def calibrate(target: float, runs: int) -> float:
    """The friction with which the direct controller leaves `target` cm on average."""
    low, high = 0.05, 2.0
    for _ in range(18):
        middle = (low + high) / 2
        mean = statistics.fmean(run("direct", speed, middle, seed)[0] for speed in SPEEDS for seed in range(runs))
        low, high = (middle, high) if mean < target else (low, middle)
    return round((low + high) / 2, 4)


def measure(tyre: str, runs: int, where: str) -> dict[str, Any]:
    """Both ways in turn, pair by pair."""
    pairs = [
        (run("direct", speed, TYRES[tyre], seed, where), run("interpreted", speed, TYRES[tyre], seed, where))
        for speed in SPEEDS
        for seed in range(runs)
    ]
    direct, model = ([pair[side][0] for pair in pairs] for side in (0, 1))
    ratios = [pair[1][1] / pair[0][1] for pair in pairs]
    return {
        "tyre": tyre,
        "where": where,
        "runs": len(pairs),
        "direct_cm": round(statistics.fmean(direct), 3),
        "interpreted_cm": round(statistics.fmean(model), 3),
        "spread_direct_cm": round(statistics.pstdev(direct), 3),
        "spread_interpreted_cm": round(statistics.pstdev(model), 3),
        "difference_of_means_cm": round(abs(statistics.fmean(direct) - statistics.fmean(model)), 4),
        "difference_cm": round(statistics.fmean(abs(a - b) for a, b in zip(direct, model, strict=True)), 4),
        "paper_cm": PAPER[tyre],
        "cpu_direct_ms": round(statistics.median(pair[0][1] for pair in pairs) * 1000, 2),
        "cpu_interpreted_ms": round(statistics.median(pair[1][1] for pair in pairs) * 1000, 2),
        "cpu_ratio": round(statistics.median(ratios), 3),
    }


def direct_cars(scheduler: Scheduler, middleware: Middleware) -> tuple[Callable[[], object], Callable[[], bool]]:
    """Both cars of the mission, driven by hand. Returns what starts them, and what tells whether they are done."""
    from ground_vehicles_direct import Dingo, Rex

    cars = Rex(middleware.node("controller", "REX")), Dingo(middleware.node("controller", "DINGO"))
    return lambda: [car.start() for car in cars], lambda: all(car.over for car in cars)


def interpreted_cars(scheduler: Scheduler, middleware: Middleware) -> tuple[Callable[[], object], Callable[[], bool]]:
    """The same, driven by their models."""
    import fame
    from fame.bpmn.library import Library
    from fame.bpmn.pools import pools_of, shared_topics
    from fame.robot import RobotNode, make_mission

    definitions, library = fame.read(ROOT.parent / "models" / "ground_vehicles.bpmn"), Library()
    pools = pools_of(definitions)
    shared = shared_topics(definitions, pools, library)
    nodes = [
        RobotNode(
            pool.name,
            make_mission(definitions, pool.process, library=library, shared=shared),
            scheduler=scheduler,
            middleware=middleware,
        )
        for pool in pools
    ]
    for node in nodes:
        node.load()
    return lambda: [node.start() for node in nodes], lambda: all(node.completed for node in nodes)


def drive_mission(way: str, seed: int) -> dict[str, float]:
    """One mission of the ground vehicles in this process: CPU s, simulated s, memory in MiB."""
    import yaml

    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    ground_file = ROOT.parent / "examples" / "ground_vehicles.yaml"
    ground = World(
        yaml.safe_load(ground_file.read_text())["world"], seed=seed, scheduler=scheduler, middleware=middleware
    )
    start, over = (direct_cars if way == "direct" else interpreted_cars)(scheduler, middleware)
    ground.watchers.append(lambda _: scheduler.stop() if over() else None)
    ground.start()
    start()
    scheduler.run(600 * SECOND)
    assert over(), "the mission did not end"
    assert way != "direct" or "fame.engine" not in sys.modules, "the direct controller needs no engine"
    pages = [int(word) for word in Path("/proc/self/statm").read_text().split()[:3]]
    virtual, resident, shared = (page * resource.getpagesize() / 2**20 for page in pages)
    status = Path("/proc/self/status").read_text()  # the peak of getrusage is that of the process that started us
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    memory = {"shared": shared, "virtual": virtual, "resident": resident, "peak": peak}
    return {"cpu": time.process_time(), "simulated": scheduler.now / SECOND, **memory}


def missions(runs: int) -> list[dict[str, Any]]:
    """Fig. 14: missions in turn, each in a process of its own. Means and standard deviations, way by way."""
    rows: dict[str, list[dict[str, float]]] = {"direct": [], "interpreted": []}
    for seed in range(runs):
        for way, found in rows.items():
            command = [sys.executable, __file__, "--mission", way, str(seed)]
            found.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
    return [
        {"mission": way, "runs": runs}
        | {f"{name}_mean": round(statistics.fmean(row[name] for row in found), 3) for name in found[0]}
        | {f"{name}_spread": round(statistics.pstdev(row[name] for row in found), 3) for name in found[0]}
        for way, found in rows.items()
    ]


def show_distances(rows: list[dict[str, Any]]) -> None:
    """Fig. 15 as a table."""
    print(f"Fig. 15, {rows[0]['where']}, {rows[0]['runs']} runs each: distance left, mean and spread; the paper's; CPU")
    print("tyre             direct            FAME   means apart  by pairs paper direct/FAME  CPU direct/FAME  ratio")
    for row in rows:
        direct, model = (
            f"{row[f'{way}_cm']:6.2f} ({row[f'spread_{way}_cm']:.2f}) cm" for way in ("direct", "interpreted")
        )
        apart = f"{row['difference_of_means_cm']:9.3f} cm {row['difference_cm']:7.3f} cm"
        paper = "{} / {} cm".format(*row["paper_cm"])
        cpu = f"{row['cpu_direct_ms']:7.1f} / {row['cpu_interpreted_ms']:.1f} ms  {row['cpu_ratio']:.3f}"
        print(f"{row['tyre']:9} {direct}  {model}  {apart}  {paper:>19}  {cpu}")


def show_missions(rows: list[dict[str, Any]]) -> None:
    """Fig. 14 as a table."""
    print(f"Fig. 14, {rows[0]['runs']} missions each, mean and spread; the paper's values are only in its figure")
    print(
        "mission              CPU     simulated           shared           virtual          resident              peak"
    )
    for row in rows:
        times = (f"{row[f'{name}_mean']:6.2f} ({row[f'{name}_spread']:.2f}) s" for name in ("cpu", "simulated"))
        names = ("shared", "virtual", "resident", "peak")
        memory = (f"{row[f'{name}_mean']:7.1f} ({row[f'{name}_spread']:.1f}) MiB" for name in names)
        print(f"{row['mission']:12} {' '.join(times)} {' '.join(memory)}")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10, help="runs per speed, and missions (10)")
    parser.add_argument("--real-time", action="store_true", help="on the wall clock; Fig. 15 alone")
    parser.add_argument("--middleware", choices=("local", "dds"), default="local",
                        help="dds: on the wall clock, world and controller in processes of their own")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="one JSON line per row")
    parser.add_argument("--calibrate", action="store_true", help="find the tyres, on the direct controller alone")
    parser.add_argument("--mission", nargs=2, metavar=("WAY", "SEED"), help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    if options.mission:
        way, seed = options.mission
        print(json.dumps(drive_mission(way, int(seed))))
        return
    if options.calibrate:
        for tyre, (target, _) in PAPER.items():
            print(tyre, calibrate(target, options.runs))
        return
    where = "dds" if options.middleware == "dds" else "real time" if options.real_time else "simulated"
    run("interpreted", 1.0, 0.5, 0)  # what is imported and compiled once is not measured
    rows = [measure(tyre, options.runs, where) for tyre in TYRES]
    driven = missions(options.runs) if where == "simulated" else []
    if options.json:
        for row in [*rows, *driven]:
            print(json.dumps(row))
        return
    show_distances(rows)
    if driven:
        show_missions(driven)


if __name__ == "__main__":
    main()
