"""Dining philosophers who talk by signals: FAME with and without reduction, beside SPIN.

    python benchmarks/philosophers.py [--most N] [--seconds S]

For each number of philosophers, `ordered` (the last one takes the other fork first, so that none can starve) and
`cyclic` (they can deadlock): states, seconds (CPU) and whether a deadlock was found. FAME explores all states with
delivery `run`; with `--first`, of the cyclic ones, it ends at the first error, which runs show before any state is
explored. SPIN verifies a model in Promela in which forks and philosophers send each other the same messages, which wait
in channels; it stops at the first deadlock. A tool that does not end within S seconds (default 60) and 1 GB is not
asked for more philosophers. Without `spin` and `gcc` its rows are left out, which is said.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
Row = tuple[int, float, bool]
"""States, seconds, whether a deadlock was found."""
MEMORY = 1 << 30
"""Bytes that a tool may use."""

PROMELA = """
chan ask[{n}] = [2] of {{ byte }};
chan given[{n}] = [1] of {{ bit }};
chan back[{n}] = [1] of {{ bit }};
proctype Phil(byte me; byte first; byte second) {{
  ask[first]!me; given[me]?1; ask[second]!me; given[me]?1; back[first]!1; back[second]!1
}}
proctype Fork(byte fork) {{
  byte user;
end: do :: ask[fork]?user -> given[user]!1; back[fork]?1 od
}}
init {{ atomic {{ {run} }} }}
"""


def promela(count: int, *, ordered: bool) -> str:
    """The philosophers in the language of SPIN."""
    runs = [f"run Fork({fork})" for fork in range(count)]
    for me in range(count):
        forks = (me, (me + 1) % count)
        first, second = forks[::-1] if ordered and me == count - 1 else forks
        runs.append(f"run Phil({me}, {first}, {second})")
    return PROMELA.format(n=count, run="; ".join(runs))


def fame(count: int, *, ordered: bool, reduced: bool, seconds: float, first: bool = False) -> Row | None:
    """Explore them in a process of its own; None if it does not end."""
    command = [sys.executable, __file__, "--case", json.dumps([count, ordered, reduced, first])]
    try:
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=10 * seconds,
                              preexec_fn=_bounded(seconds))  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
    return tuple(json.loads(done.stdout)) if done.returncode == 0 else None


def explored(count: int, ordered: bool, reduced: bool, first: bool) -> Row:
    """Explore them in this process."""
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    from collaborations import philosophers, team

    from fame.scenario.explore.exploration import explore

    model = team(philosophers(count, ordered=ordered))
    begun = time.process_time()
    result = explore(model, delivery="run", reduced=reduced, samples=False, first=first, limit=100_000_000)
    return result.states, time.process_time() - begun, result.failed


def spin(count: int, *, ordered: bool, reduced: bool, seconds: float) -> Row | None:
    """Verify them by SPIN, without the time of its compiler; None if it does not end."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.pml").write_text(promela(count, ordered=ordered))
        subprocess.run(["spin", "-a", "model.pml"], cwd=folder, check=True, capture_output=True)
        options = ["-O2", "-w", "-DSAFETY", "-DMEMLIM=1024", *([] if reduced else ["-DNOREDUCE"])]
        subprocess.run(["gcc", *options, "-o", "pan", "pan.c"], cwd=folder, check=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(["./pan", "-m1000000"], check=False, cwd=folder, capture_output=True, text=True,
                              preexec_fn=_bounded(seconds))  # fmt: skip
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    states = re.search(r"([\d.e+]+) states, stored", done.stdout)
    if done.returncode or states is None or "reached -DMEMLIM" in done.stdout:
        return None
    return int(float(states[1])), spent, "errors: 0" not in done.stdout


def _bounded(seconds: float) -> Callable[[], None]:
    """What bounds the time (CPU) and memory of a process."""

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 1))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY + (1 << 29), MEMORY + (1 << 29)))  # numpy reserves addresses

    return bound


def rows(most: int, seconds: float) -> Iterator[str]:
    """The table, a row at a time."""
    tools: dict[str, Callable[..., Row | None]] = {"FAME": fame, "--first": partial(fame, first=True)}
    if shutil.which("spin") and shutil.which("gcc"):
        tools["SPIN"] = spin
    else:
        yield "spin, gcc: not found, so SPIN is left out (apt-get install spin gcc)"
    yield f"{'philosophers':16}{'tool':9}{'reduced':9}{'states':>12}{'s':>9}  deadlock"
    for ordered in (True, False):
        for name, tool in tools.items():
            for reduced in (True, False) if name != "--first" else () if ordered else (True,):
                for count in range(3, most + 1):
                    row = tool(count, ordered=ordered, reduced=reduced, seconds=seconds)
                    title = f"{count} {'ordered' if ordered else 'cyclic':12}".ljust(16)
                    title += f"{name:9}{'yes' if reduced else 'no':9}"
                    if row is None:
                        yield f"{title}{'not ended':>12}"
                        break
                    yield f"{title}{row[0]:12,}{row[1]:9.2f}  {'found' if row[2] else 'none'}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=10, metavar="N", help="philosophers at most (default: 10)")
    parser.add_argument("--seconds", type=float, default=60, metavar="S", help="CPU time of each case (default: 60)")
    parser.add_argument("--case", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.case:
        print(json.dumps(explored(*arguments.case)))
        return
    for row in rows(arguments.most, arguments.seconds):
        print(row, flush=True)


if __name__ == "__main__":
    main()
