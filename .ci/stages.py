#!/usr/bin/env python3
"""The stages that a change passes: each is timed, and the last lines are a table of all.

    stages.py landing      what .ci/run calls: within 25 minutes on two cores
    stages.py nightly      what .ci/nightly calls: all of it; a release requires it
    stages.py NAME...      these stages

A landing has what fails cheaply and often first, then a tenth of what is too long for each (`ROTATING`, chosen by the
day of the commit), and what the paths ask for that changed since BASE (a revision; without it, in the day before
HEAD). What cannot be run here, or is left to the night, is printed as NOT RUN with the reason.

PYTHON names the interpreter of the environment, ROS_SETUP the folder that can set up a ROS 2 (`setup`, `env.sh`).
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
ROS = Path(os.environ.get("ROS_SETUP") or ROOT.parent / "shared" / "ros2")
LONGEST = 45 * 60
"""After how long a stage is ended (s)."""
MOST_CHANGED = 1
"""How many stages a landing has for what changed: more are left to the night."""

BARE = [sys.executable, ".ci/stage.py", "--bare"]
LOOPBACK = ["unshare", "-n", "bash", "-c", 'ip link set lo up && exec "$@"', "_"]
ATTACKS = 4
"""Into how many parts the attacks are split."""


class Stage(NamedTuple):
    """The command of a stage, and what says why it cannot be run here."""

    command: Callable[[], Sequence[str]]
    missing: Callable[[], str] = str


class Outcome(NamedTuple):
    """How a stage ended: passed, FAILED or NOT RUN, in how many seconds, and why."""

    name: str
    outcome: str
    seconds: float = 0.0
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.name:<18}{self.outcome:<9}{self.seconds:6.0f} s  {self.reason}".rstrip()


def main(names: list[str]) -> int:
    """Run stages; the exit code."""
    os.chdir(ROOT)
    if names not in (["landing"], ["nightly"]) and (not names or not STAGES.keys() >= {*names}):
        unknown = ", ".join(name for name in names if name not in STAGES) or "nothing"
        print(f"expected landing, nightly or stages ({', '.join(STAGES)}), got {unknown}", file=sys.stderr)
        return 2
    if os.environ.get("VERSIONS") != "newest":
        os.environ.setdefault("PIP_CONSTRAINT", str(ROOT / ".ci" / "constraints.txt"))
    os.environ.setdefault("PYTHON", system_python())
    left: list[Outcome] = []
    groups: Iterable[Sequence[str]] = [[name] for name in names]
    if names == ["landing"]:
        chosen, left = rotating(commit_day(), changed_paths())
        groups = [*LANDING, *([name] for name in chosen)]
    elif names == ["nightly"]:
        groups = [*LANDING, *([name] for name in NIGHTLY)]
    groups = [*groups]
    with tempfile.NamedTemporaryFile() as closing:
        os.environ["STAGES"] = closing.name
        outcomes: list[Outcome] = []
        for number, group in enumerate(groups, 1):
            outcomes += together(group)
            if failed := [outcome.name for outcome in outcomes if outcome.outcome == "FAILED"]:
                after = [name for group in groups[number:] for name in group]
                left += [Outcome(name, "NOT RUN", 0.0, f"{failed[0]} has failed") for name in after]
                break
        print("\n" + Path(closing.name).read_text("utf-8"))
    print(*outcomes, *left, sep="\n")
    print(f"{'all':<18}{'':<9}{sum(outcome.seconds for outcome in outcomes):6.0f} s", flush=True)
    return int(any(outcome.outcome == "FAILED" for outcome in outcomes))


# ---- one stage, or several at the same time --------------------------------------------------------------------------


def together(names: Sequence[str]) -> list[Outcome]:
    """Run stages at the same time; the output of all but the first is printed when all have ended."""
    if len(names) == 1:
        return [run(names[0])]
    with ThreadPoolExecutor() as pool, tempfile.TemporaryDirectory() as folder:
        others = [(Path(folder, name), pool.submit(run, name, Path(folder, name))) for name in names[1:]]
        outcomes = [run(names[0]), *(future.result() for _, future in others)]
        for path, _ in others:
            print(path.read_text("utf-8", errors="replace") if path.exists() else "", flush=True)
    return outcomes


def run(name: str, output: Path | None = None) -> Outcome:
    """Run a stage; its output goes into a file, if one is named."""
    stage = STAGES[name]
    if reason := stage.missing():
        return Outcome(name, "NOT RUN", 0.0, reason)
    print(f"== {name}", flush=True)
    began = time.monotonic()
    with (output or Path(os.devnull)).open("wb") as stream:
        to = stream if output else None
        try:
            started = subprocess.Popen(stage.command(), stdin=subprocess.DEVNULL, stdout=to, stderr=to, process_group=0)
        except OSError as error:
            return Outcome(name, "FAILED", 0.0, str(error))
        try:
            code, reason = started.wait(LONGEST), ""
        except BaseException as error:
            os.killpg(started.pid, signal.SIGKILL)
            started.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            code, reason = 1, f"not ended after {LONGEST} s"
    seconds = time.monotonic() - began
    print(f"== {name}: {seconds:.0f} s", flush=True)
    return Outcome(name, "FAILED" if code else "passed", seconds, reason or (f"exit code {code}" if code else ""))


# ---- stages ----------------------------------------------------------------------------------------------------------


def make(*words: str) -> list[str]:
    return ["make", *words]


def on_loopback(command: Sequence[str]) -> list[str]:
    """Give the command on loopback alone, if the system allows it."""
    known = shutil.which(LOOPBACK[0]) is not None
    allowed = known and subprocess.run([*LOOPBACK, "true"], capture_output=True, check=False).returncode == 0
    return [*LOOPBACK, *command] if allowed else list(command)


def system_python() -> str:
    """Name the system's Python if it will do: those that version managers build are slower by half, often."""
    fits = "import ensurepip, sys; sys.exit(sys.version_info < (3, 11))"
    for program in ("/usr/bin/python3", "python3"):
        with_it = shutil.which(program)
        if with_it and subprocess.run([with_it, "-c", fits], capture_output=True, check=False).returncode == 0:
            return program
    return "python3"


def no_python(version: str) -> str:
    there = subprocess.run([".ci/python", version], check=False).returncode == 0
    return "" if there else f"there is no Python {version}"


def other_python(version: str) -> Stage:
    """The fast tests on another Python."""
    return Stage(lambda: make("test-python", f"VERSION={version}"), lambda: no_python(version))


def no_browser() -> str:
    there = subprocess.run([".ci/browser"], check=False).returncode == 0
    return "" if there else "there is no chromium"


def no_npm() -> str:
    return "" if shutil.which("npm") else "there is no npm"


def no_node() -> str:
    return no_browser() or no_npm()


def no_ros() -> str:
    return (
        "" if (ROS / "setup").exists() and os.getuid() == 0 else f"there is no ROS 2 in {ROS} (ROS_SETUP), or no root"
    )


def torture() -> list[str]:
    """Run seeds that are known to hold: about one new seed in a hundred shows an open fault (`new_torture`)."""
    return make("torture", "TORTURE=--seconds 60 --seeds 4941585:4941984")


def new_torture() -> list[str]:
    """Run 400 new seeds, which the hash of HEAD decides."""
    first = int(git("rev-parse", "HEAD")[:7], 16)
    return make("torture", f"TORTURE=--seconds 60 --seeds {first}:{first + 399}")


def no_release() -> str:
    tagged = subprocess.run(["git", "describe", "--tags", "--match", "v*", "HEAD^"], capture_output=True, check=False)
    return "there is no tagged release" if tagged.returncode else ""


def with_ros() -> list[str]:
    prepare = f'"{ROS}/setup" && set +u && . "{ROS}/env.sh" && env -u PIP_CONSTRAINT make .venv-ros/bin/python'
    return ["bash", "-c", f"{prepare} && exec {' '.join(map(quoted, on_loopback(make('test-ros'))))}"]


def fastdds() -> list[str]:
    tests = " ".join(map(quoted, on_loopback(make("test-fastdds"))))
    return ["bash", "-c", f"make .venv-jazzy/installed .venv-kilted/installed && exec {tests}"]


def pages() -> list[str]:
    return ["bash", "-c", f".ci/pages --environments && exec {' '.join(map(quoted, on_loopback(['.ci/pages'])))}"]


def quoted(word: str) -> str:
    return "'" + word.replace("'", "'\\''") + "'"


def attack(part: int) -> Stage:
    return Stage(lambda: on_loopback(make("attack", f"ATTACK=--again --part {part}/{ATTACKS}")))


STAGES: dict[str, Stage] = {
    "lint": Stage(lambda: make("lint")),
    "lint-page": Stage(lambda: make("lint-page"), no_npm),
    "test": Stage(lambda: [*BARE, "make", "test"]),
    "test-long": Stage(lambda: make("test-long")),
    "torture": Stage(torture),
    "new-torture": Stage(new_torture),
    "test-processes": Stage(lambda: on_loopback(make("test-processes"))),
    "test-browser": Stage(lambda: make("test-browser"), no_browser),
    "test-node": Stage(lambda: make("test-node"), no_node),
    "versions": Stage(lambda: [".venv/bin/python", ".ci/versions.py"]),
    "wheel": Stage(lambda: [".ci/wheel"]),
    "pages": Stage(pages),
    "kept": Stage(lambda: [".venv/bin/python", "benchmarks/kept.py"], no_release),
    "long-view": Stage(lambda: [".venv/bin/python", "benchmarks/view.py", "--events", "100000"], no_browser),
    "python-3.12": other_python("3.12"),
    "python-3.13": other_python("3.13"),
    "python-3.14": other_python("3.14"),
    "fastdds": Stage(fastdds, lambda: no_python("3.12")),  # for which PyPI has it
    "ros": Stage(with_ros, no_ros),
    **{f"attack-{part}": attack(part) for part in range(1, ATTACKS + 1)},
}
LANDING = [
    ["lint"],
    ["lint-page"],
    ["test"],
    ["test-long"],
    ["versions"],
    ["torture"],
    ["test-processes"],
    ["test-browser"],
    ["test-node"],
]
ROTATING = (
    "attack-1",
    "attack-2",
    "attack-3",
    "attack-4",
    "wheel",
    "pages",
    "python-3.12",
    "python-3.13",
    "python-3.14",
    "fastdds",
    "ros",
)
NIGHTLY = (*ROTATING, "new-torture", "kept", "long-view")
CHANGED = (
    ("ros", ("fame/middleware/ros/*", "launch/*", "package.xml", "CMakeLists.txt")),
    ("fastdds", ("fame/middleware/dds/*",)),
    ("wheel", ("pyproject.toml", ".ci/wheel", "fame/cli/new*", "fame/project*")),
    ("pages", ("README.md", "docs/tutorial*.md", "docs/cookbook.md", "examples/*", "fame/imports.py", ".ci/pages")),
    ("python-3.14", ("fame/scripting/*",)),
    ("attack-1", ("fame/deploy/*", "fame/middleware/*")),
    ("kept", tuple(f"fame/{room}/*" for room in ("engine", "robot", "scripting", "log", "scenario"))),
)
"""Which stage a landing has for changed paths, the most particular first."""


# ---- what a landing has besides --------------------------------------------------------------------------------------


def rotating(day: int, paths: Sequence[str]) -> tuple[list[str], list[Outcome]]:
    """Choose the stages for a day (counted from anywhere) and changed paths, and say which are left to the night."""
    chosen = [ROTATING[day % len(ROTATING)]]
    touched = [name for name, patterns in CHANGED if any(fnmatch(path, of) for path in paths for of in patterns)]
    chosen += [name for name in touched if name not in chosen][:MOST_CHANGED]
    left = [name for name in NIGHTLY if name not in chosen]
    return chosen, [Outcome(name, "NOT RUN", 0.0, "left to .ci/nightly") for name in left]


def git(*words: str) -> str:
    return subprocess.run(["git", *words], capture_output=True, text=True, check=True).stdout.strip()


def commit_day() -> int:
    """The day of HEAD's commit, as an ordinal number."""
    return datetime.fromtimestamp(int(git("log", "-1", "--format=%ct")), UTC).toordinal()


def changed_paths() -> list[str]:
    """The paths that changed since BASE, or in the day before HEAD."""
    base = os.environ.get("BASE")
    if base and subprocess.run(["git", "rev-parse", "-q", "--verify", f"{base}^{{commit}}"], check=False).returncode:
        sys.exit(f"BASE: expected a revision that is here, got {base!r}")
    base = base or git("rev-list", "-1", f"--before={int(git('log', '-1', '--format=%ct')) - 86400}", "HEAD")
    return git("diff", "--name-only", base, "HEAD").splitlines() if base else []


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # and its stage ends, too
    sys.exit(main(sys.argv[1:]))
