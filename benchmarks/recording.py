"""What a recording costs: time of a run, size of its file, opening and seeking, and an engine that is watched.

    python benchmarks/recording.py [--runs 3]

Times are CPU seconds of this process, the least of several runs, so that other load counts little.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from fame.clock import SECOND, Scheduler
from fame.deploy import EngineNode
from fame.log import Recording, logging_to
from fame.log.live_team import LiveTeam
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.scenario import Scenario

ROOT = Path(__file__).parent.parent
LOOP = (ROOT / "tests" / "test_live_team.py").read_text().partition('COUNTING = process("""')[2].partition('""")')[0]
STRING = "std_msgs/msg/String"


def least(runs: int, action: Callable[[], object]) -> float:
    """CPU s of the fastest of several runs."""
    times = []
    for _ in range(runs):
        begun = time.process_time()
        action()
        times.append(time.process_time() - begun)
    return min(times)


def run(name: str, path: Path | None, topics: str = "signals") -> None:
    """One run of an example, recorded if `path` is given."""
    scenario = Scenario.load(ROOT / "examples" / f"{name}.yaml")
    if path is None:
        scenario.run()
        return
    with logging_to(path, scenario.closures(), topics=topics) as log:  # type: ignore[arg-type]
        scenario.run(observer=log)


def command(*options: str) -> None:
    """`fame run` of the ground vehicles in a process of its own."""
    line = [sys.executable, "-m", "fame", "run", "examples/ground_vehicles.yaml", "--quiet", *options]
    subprocess.run(line, cwd=ROOT, check=True, stderr=subprocess.DEVNULL)


def command_time(runs: int, *options: str) -> float:
    """CPU s of the fastest of several such processes."""
    times = []
    for _ in range(runs):
        before = os.times()
        command(*options)
        after = os.times()
        times.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return min(times)


def engine(seconds: float, *, watched: bool) -> None:
    """An engine with 10 steps a second, watched or not, on a simulated clock."""
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    node = EngineNode("REX", scheduler=scheduler, middleware=middleware)
    team = LiveTeam(middleware.node("w"), middleware, scheduler, lambda *told: None) if watched else None
    namespace = "http://www.omg.org/spec/BPMN/20100524/MODEL"
    text = f'<definitions xmlns="{namespace}" targetNamespace="t"><process id="P" isExecutable="true">{LOOP}'
    publisher = middleware.node("sender").publisher("/REX/bpmn_process", STRING)
    scheduler.run(SECOND)
    publisher.publish(messages.create(STRING, f"{text}</process></definitions>"))
    scheduler.run(round(seconds * SECOND))
    if team is not None:
        team.close()
    node.close()


def main() -> None:
    """Measure, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    runs = parser.parse_args().runs
    print(f"load: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        for name in ("ground_vehicles", "agriculture"):
            plain, recorded = least(runs, lambda n=name: run(n, None)), least(runs, lambda n=name: run(n, path))
            size = path.stat().st_size / 1e6
            print(f"{name}: {plain:.2f} s CPU, recorded {recorded:.2f} s (+{recorded - plain:.2f} s), {size:.2f} MB")
            begun = time.perf_counter()
            with Recording(path) as recording:
                opened = time.perf_counter() - begun
                times = random.Random(1).sample(range(recording.start, recording.end), 50)
                begun = time.perf_counter()
                for moment in times:
                    recording.state(moment)
                sought = (time.perf_counter() - begun) / len(times)
            print(f"  opened in {opened * 1e3:.0f} ms, sought in {sought * 1e3:.1f} ms")
        run("ground_vehicles", path, "all")
        print(f"ground_vehicles with all topics: {path.stat().st_size / 1e6:.2f} MB")
        plain, recorded = command_time(runs), command_time(runs, "--log", str(path))
        print(f"command: {plain:.2f} s CPU, recorded {recorded:.2f} s: +{recorded / plain - 1:.0%}")
    alone, watched = (least(runs, lambda w=w: engine(60, watched=w)) for w in (False, True))
    print(f"engine, 60 s of 10 steps a second: {alone:.2f} s CPU, watched and followed {watched:.2f} s: "
          f"{(watched - alone) / 60:.1%} of a core more")  # fmt: skip


if __name__ == "__main__":
    main()
