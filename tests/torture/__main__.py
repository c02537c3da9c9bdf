"""``python -m tests.torture --seeds 1:1000 --jobs 2``: run seeds, report failures and how often each fault struck."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from .invariants import judge
from .plan import Plan, draw
from .team import Team


def outcome(plan: Plan) -> tuple[list[str], Counter[str], list[str]]:
    """What does not hold in the run of a plan, what struck, and the lines of the run."""
    team = Team(plan)
    found = judge(team)
    return found, team.struck + team.fabric.struck, team.lines


def run_seed(seed: int) -> tuple[int, list[str], Counter[str]]:
    """The outcome of a seed."""
    found, struck, _ = outcome(draw(seed))
    return seed, found, struck


def reduced(plan: Plan) -> Plan:
    """The fewest steps that still fail in the same way."""
    steps, sought = list(plan.steps), outcome(plan)[0][0].split(":")[0].split(" ")[-1]
    size = max(1, len(steps) // 2)
    while size:
        at = 0
        while at < len(steps):
            fewer = [*steps[:at], *steps[at + size :]]
            if any(sought in one for one in outcome(Plan(plan.seed, tuple(fewer)))[0]):
                steps = fewer
            else:
                at += size
        size //= 2
    return Plan(plan.seed, tuple(steps))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    parser.add_argument("--seeds", default="1:200", metavar="FIRST:LAST")
    parser.add_argument("--seed", type=int, metavar="N", help="run one seed, print what happens")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--reduce", action="store_true", help="with --seed: the fewest steps that still fail")
    arguments = parser.parse_args()
    if arguments.seed is not None:
        plan = draw(arguments.seed)
        if arguments.reduce:
            plan = reduced(plan)
            print(plan.to_json())
        found, _, lines = outcome(plan)
        print(*map(str, plan.steps), "", *lines, "", *found, sep="\n")
        return bool(found)
    first, last = map(int, arguments.seeds.split(":"))
    return _run_all(range(first, last + 1), arguments.jobs)


def _run_all(seeds: range, jobs: int) -> int:
    begun, failed, struck, done = time.perf_counter(), 0, Counter[str](), 0
    with ProcessPoolExecutor(jobs) as pool:
        for seed, found, counts in pool.map(run_seed, seeds, chunksize=4):
            done += 1
            struck += counts
            if found:
                failed += 1
                print(f"seed {seed}: {'; '.join(found)}", flush=True)
    seconds = time.perf_counter() - begun
    for kind, count in sorted(struck.items()):
        print(f"{count:9d}  {kind}")
    print(f"{done} seeds, {failed} failed, {seconds:.0f} s, {done / seconds:.1f} seeds/s")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
