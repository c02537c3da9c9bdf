"""``python -m tests.torture --seeds 1:1000 --jobs 2``: run seeds, report failures and how often each fault struck."""

from __future__ import annotations

import argparse
import gc
import re
import sys
import time
from argparse import ArgumentTypeError
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from fame.gc_tuning import uncollected
from fame.log.merging import merge
from fame.log.writing import RECORDING

from .invariants import judge
from .plan import KINDS, PHASES, Plan, draw
from .planted import BUGS, seeds_until_found
from .team import Team

_TELL = 4.0
"""How often progress is printed (s)."""


def outcome(plan: Plan, log: Path | None = None) -> tuple[list[str], Counter[str], list[str]]:
    """What does not hold in the run of a plan, what struck, and the lines of the run. `log`: a folder to record it."""
    team = Team(plan, log=log)
    found = judge(team)
    team.close()
    compared = Counter({"restarts compared": sum(robot.witness.compared for robot in team.robots.values())})
    return found, team.struck + team.fabric.struck + compared, team.lines


def run_seed(seed: int, *, fixed: bool = False) -> tuple[int, list[str], Counter[str]]:
    """The outcome of a seed. Its garbage is collected once, which looks at nothing that was there before."""
    with uncollected(stays=True):
        found, struck, _ = outcome(draw(seed, fixed=fixed))
        gc.collect()
    return seed, found, struck


def reduced(plan: Plan) -> Plan:
    """The fewest steps that still fail in the same way; the plan itself if it does not fail."""
    found = outcome(plan)[0]
    if not found:
        return plan
    steps, sought = list(plan.steps), _kind(found[0])
    size = max(1, len(steps) // 2)
    while size:
        at = 0
        while at < len(steps):
            fewer = [*steps[:at], *steps[at + size :]]
            if any(sought == _kind(one) for one in outcome(plan.with_steps(fewer))[0]):
                steps = fewer
            else:
                at += size
        size //= 2
    return plan.with_steps(steps)


def _kind(sentence: str) -> str:
    """What does not hold, without names of robots and numbers."""
    return re.sub(r"\b[A-C]\b|[\d.#]+", "_", sentence.partition(":")[0])


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    parser.add_argument("--seeds", type=_range, default="1:200", metavar="FIRST:LAST", help="the seeds to run (1:200)")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after this time")
    parser.add_argument("--jobs", type=_positive, default=1, metavar="N", help="number of processes (1)")
    parser.add_argument("--seed", type=int, metavar="N", help="run one seed, print what happens")
    parser.add_argument("--fixed", action="store_true", help="only the three missions that are not drawn")
    parser.add_argument("--table", action="store_true", help="at the end: how often there was each element, fault, act")
    parser.add_argument("--reduce", action="store_true", help="with --seed: the fewest steps that still fail")
    parser.add_argument(
        "--log", type=_recording, metavar="FILE", help="with --seed or --plan: record what the robots do, for fame view"
    )
    parser.add_argument("--plan", type=_plan, metavar="FILE", help="run a plan that was kept")
    parser.add_argument(
        "--planted", type=_positive, metavar="LIMIT", help="after how many seeds is each planted bug found"
    )
    arguments = parser.parse_args()
    if arguments.planted:
        return _find_planted(arguments.planted, arguments.jobs)
    if arguments.seed is not None or arguments.plan:
        plan = arguments.plan or draw(arguments.seed, fixed=arguments.fixed)
        return _show(reduced(plan) if arguments.reduce else plan, arguments.log)
    return _run_all(arguments.seeds, arguments.jobs, arguments.seconds, fixed=arguments.fixed, table=arguments.table)


def _range(text: str) -> range:
    first, colon, last = text.partition(":")
    if not (colon and first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise ArgumentTypeError(f"expected FIRST:LAST, got {text!r}")
    return range(int(first), int(last) + 1)


def _positive(text: str) -> int:
    if not (text.isdecimal() and int(text)):
        raise ArgumentTypeError(f"expected a number from 1 on, got {text!r}")
    return int(text)


def _plan(file: str) -> Plan:
    try:
        return Plan.from_json(Path(file).read_text())
    except OSError as error:
        raise ArgumentTypeError(f"{file}: {error.strerror}") from None
    except (ValueError, TypeError, KeyError):
        raise ArgumentTypeError(f"{file}: expected a plan, the first line that --seed prints") from None


def _recording(file: str) -> str:
    if not file.endswith(RECORDING):
        raise ArgumentTypeError(f"expected a file name that ends in {RECORDING}, got {file!r}")
    return file


def _show(plan: Plan, log: str | None) -> int:
    with TemporaryDirectory() as folder:
        found, _, lines = outcome(plan, Path(folder) if log else None)
        if log:
            merge(sorted(Path(folder).glob("*.mcap")), log)
    print(plan.to_json(), *map(str, plan.steps), "", *lines, "", *found, sep="\n")
    return bool(found)


def _find_planted(limit: int, jobs: int) -> int:
    with ProcessPoolExecutor(jobs) as pool:
        results = pool.map(partial(seeds_until_found, starts=range(1, 50_001, 10_000), limit=limit), BUGS)
        missed = 0
        for name, number in zip(BUGS, results, strict=True):
            missed += number >= limit
            print(f"{name:40} {'not found' if number >= limit else number}", flush=True)
    return bool(missed)


def _print_table(struck: Counter[str]) -> None:
    """How often each kind of element was entered, and each fault and act struck, in drawn missions and others."""
    counts = Counter[str]()
    for kind, count in struck.items():
        if not kind.endswith(" / absent"):
            counts[kind.partition(" / ")[0]] += count
    for group, kinds in KINDS.items():
        print(f"| {group} |", ", ".join(f"{kind} {counts[prefix + kind]}" for prefix, kind in kinds), "|")
    rare = [kind for kinds in KINDS.values() for prefix, kind in kinds if counts[prefix + kind] < 100]
    print(f"less than 100 times: {', '.join(rare) or 'none'}")
    for what in ("missions compared with a reference", "missions compared as a whole",
                 "robots compared with a reference", "robots compared after a restart"):  # fmt: skip
        drawn = counts[f"{what.split()[0]} drawn"]
        print(f"{what}: {counts[what]} of {drawn} drawn ({100 * counts[what] / max(1, drawn):.0f} %)")


def _run_all(seeds: range, jobs: int, seconds: float | None, *, fixed: bool, table: bool) -> int:
    begun, failed, struck, done = time.perf_counter(), 0, Counter[str](), 0
    told, run = begun, partial(run_seed, fixed=fixed)
    with ProcessPoolExecutor(jobs) as pool:
        for start in range(seeds.start, seeds.stop, 100):
            if seconds is not None and time.perf_counter() - begun > seconds:
                break
            for seed, found, counts in pool.map(run, range(start, min(start + 100, seeds.stop)), chunksize=4):
                done += 1
                struck += counts
                if found:
                    failed += 1
                    print(f"seed {seed}: {'; '.join(found)}", flush=True)
                if time.perf_counter() - told > _TELL:
                    told = time.perf_counter()
                    left = (len(seeds) - done) * (told - begun) / done
                    print(f"{done} of {len(seeds)} seeds, {failed} failed, {left / 60:.0f} min left", file=sys.stderr)
    took = time.perf_counter() - begun
    for kind, count in sorted(struck.items()):
        print(f"{count:9d}  {kind}")
    print(f"{done} seeds from {seeds.start}, {failed} failed, {took:.0f} s, {done / took:.1f} seeds/s")
    if table:
        _print_table(struck)
    never = sorted(PHASES - set(struck))
    if done >= 10_000 and never:
        print(f"never struck: {', '.join(never)}")
    return bool(failed or (done >= 10_000 and never))


if __name__ == "__main__":
    sys.exit(main())
