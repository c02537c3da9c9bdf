"""Whether FAME is as fast as its last release was: both by turns, in processes of their own, by processor time.

    python benchmarks/kept.py                        # the last tagged release
    python benchmarks/kept.py --against 1509237 --only signal --rounds 9

On both sides models and examples are those of the release, which HEAD reads too, and benchmarks those of HEAD. A line
per case: milliseconds of each (the best of all turns, since noise only slows) and their ratio; below `LEAST` it is
measured again with as many turns, and fails if it stays there. Exit code 1 if a case fails, 3 if one is not known: the
release cannot run it, or there is no release.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LEAST = 0.95
NOT_KNOWN = 3
ENGINE = "models and signals"
TASK = "benchmarks/out/task.bpmn"
LOG = "benchmarks/out/run.mcap"
RUN = ("-m", "fame", "run", "examples/convoy.yaml", "--quiet")
COMMANDS = {
    "start: --help": ("-m", "fame", "--help"),
    "start: check": ("-m", "fame", "check", TASK),
    "start: run": ("-m", "fame", "run", TASK, "--quiet"),
    "start: Python": ("-c", f"import fame; fame.Simulation(fame.read({TASK!r})).run()"),
    "world: run": RUN,
    "world: recorded": (*RUN, "--log", LOG),
    "view: read": (
        "-c",
        f"from fame.view.replay import Replay\nfrom pathlib import Path\nReplay(Path({LOG!r})).wait()",
    ),
    "explore": ("-m", "fame", "check", "--explore", "models/shuttle.bpmn"),
}
"""Commands whose processes are measured whole, in this order: the recording is that of the run before.

Of the models, the shuttle is explored: its number of states has not changed since 1509237. Others have more, since an
uncaught error ends one instance only."""
OF_ENGINE = """
import sys, json, time
sys.path[:0] = ["benchmarks"]
from engine import RUNS, read
from models import CASES
found = {}
for case in (case for case in CASES if not case.name.startswith("long")):
    model, many = read(case.make(case.size)), (case.size * case.signals, case.size * case.instances)
    for face in ("engine", "simulation"):
        end, times = time.process_time() + 0.15, []
        while len(times) < 3 or time.process_time() < end:
            times.append(RUNS[face](model, *many)[0])
        found[f"{case.name}: {face}"] = 1e3 * min(times)
print(json.dumps(found))
"""
Times = dict[str, float]


def last_release() -> str:
    """The tag of the last release before HEAD, or an empty text."""
    command = ["git", "describe", "--tags", "--abbrev=0", "--match", "v*", "HEAD^"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


def check_out(revision: str, release: str, folder: Path) -> None:
    """Write the code of a revision, what it runs, and the benchmarks. Raises CalledProcessError."""
    code, runs = ("fame", "robots", "sim2d"), ("models", "examples")
    for source, names in ((revision, code), (release, runs), ("HEAD", ("benchmarks",))):
        packed = subprocess.run(["git", "archive", source, *names], cwd=ROOT, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(folder)], input=packed, check=True)
    (folder / TASK).parent.mkdir()
    sys.path.insert(0, str(folder / "benchmarks"))
    from models import gateways

    (folder / TASK).write_text(gateways(1))


def turn(folder: Path, only: str) -> Times:
    """Processor time of each case (ms), without those that fail."""
    found = Times()
    if only in ENGINE:
        done, _ = measured(folder, ("-c", OF_ENGINE))
        found.update(json.loads(done or "{}"))
    needed = {name for name in COMMANDS if only in name} | ({"world: recorded"} if only in "view: read" else set())
    for name, command in COMMANDS.items():
        if name in needed:
            done, seconds = measured(folder, command)
            found.update({name: 1e3 * seconds} if done is not None else {})
    return found


def measured(folder: Path, command: tuple[str, ...]) -> tuple[str | None, float]:
    """What a process printed, None if it failed, and its processor time (s)."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": ""}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return None if done.returncode else done.stdout, seconds


def compare(folders: tuple[Path, Path], only: str, rounds: int) -> tuple[Times, Times]:
    """The best time of each case in both folders, by turns."""
    best = (Times(), Times())
    for _ in range(rounds):
        for folder, known in zip(folders, best, strict=True):
            for name, milliseconds in turn(folder, only).items():
                known[name] = min(milliseconds, known.get(name, milliseconds))
    return best


def verdicts(then: Times, now: Times, only: str) -> Iterator[tuple[str, float | None]]:
    """Each case with how many times faster it is now; None if that is not known."""
    for name in dict.fromkeys((*then, *now, *(name for name in COMMANDS if only in name))):
        yield name, then[name] / now[name] if name in then and name in now else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--against", default=last_release(), metavar="REVISION", help="by default the last release")
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="cases with this in their name (or in: models and signals)"
    )
    parser.add_argument("--rounds", type=int, default=4, help="turns of each (4)")
    arguments = parser.parse_args()
    if not arguments.against:
        print("not known: no release is tagged; --against names a revision")
        return NOT_KNOWN
    with tempfile.TemporaryDirectory() as former, tempfile.TemporaryDirectory() as present:
        folders = Path(former), Path(present)
        for revision, folder in zip((arguments.against, "HEAD"), folders, strict=True):
            check_out(revision, arguments.against, folder)
        turn(folders[0], "start"), turn(folders[1], "start")  # byte code is written
        then, now = compare(folders, arguments.only, arguments.rounds)
        if any(ratio is not None and ratio < LEAST for _, ratio in verdicts(then, now, arguments.only)):
            for known, again in zip((then, now), compare(folders, arguments.only, arguments.rounds), strict=True):
                known.update({name: min(known.get(name, time), time) for name, time in again.items()})
    code = 0
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; against {arguments.against}, ms")
    for name, ratio in verdicts(then, now, arguments.only):
        if ratio is None:
            code = code or NOT_KNOWN
            print(f"{name:42} not known: it fails {'there' if name in now else 'now'}")
            continue
        slower = ratio < LEAST
        code = 1 if slower else code
        print(f"{name:42} {then[name]:9.2f} {now[name]:9.2f}  {ratio:5.2f}{'  SLOWER' if slower else ''}")
    return code


if __name__ == "__main__":
    sys.exit(main())
