"""The price of an acknowledged signal: processor time from throw to catch, with the property and without it.

Two robots in one process on simulated time: A throws numbers, B keeps them. Each case is timed five times, in turn; the
least counts. One JSON line per case. The plain case needs nothing of the property: run it on an earlier version, too.
Run as ``python -m benchmarks.acknowledged``.
"""

from __future__ import annotations

import json
import time

from benchmarks.roaming import model
from fame.bpmn.reader import read_text
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode
from fame.deploy.options import DeploymentOptions
from fame.middleware.local import LocalMiddleware

SIGNALS, ROUNDS = 5000, 5
_TYPED = 'type="std_msgs/msg/Int32" payload="${n}"'
CASES = {
    "plain": _TYPED,
    "acknowledged, ttl 1 s": f'{_TYPED} delivery="acknowledged" ttl="1"',
    "acknowledged, ttl 60 s": f'{_TYPED} delivery="acknowledged"',
}


def microseconds(throw: str) -> float:
    """Processor time per signal of one run."""
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    nodes = [EngineNode(robot, scheduler=scheduler, middleware=middleware) for robot in "AB"]
    deployment = Deployment(
        read_text(model(SIGNALS, throw), file="counts.bpmn"), id="d", sequence=1, scheduler=scheduler,
        middleware=middleware, ended=lambda _: None, options=DeploymentOptions(robots=["A", "B"]),
    )  # fmt: skip
    deployment.begin()
    scheduler.run(SECOND)
    begun = time.process_time()
    scheduler.run(scheduler.now + SIGNALS * SECOND // 100 + 5 * SECOND)
    took = time.process_time() - begun
    assert nodes[1].running is not None
    assert nodes[1].running.instances[-1].variables["kept"] == list(range(1, SIGNALS + 1))
    for node in nodes:
        node.close()
    return took / SIGNALS * 1e6


def main() -> None:
    """Print the least time of each case."""
    taken: dict[str, list[float]] = {name: [] for name in CASES}
    for _ in range(ROUNDS):
        for name, throw in CASES.items():
            taken[name].append(microseconds(throw))
    for name, times in taken.items():
        print(json.dumps({"case": name, "us_per_signal": round(min(times), 1)}), flush=True)


if __name__ == "__main__":
    main()
