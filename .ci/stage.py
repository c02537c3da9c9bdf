#!/usr/bin/env python3
"""A stage of the tests, of which nothing is hidden.

    stage.py NAME [--no-skips] [OPTION...] -- ARGUMENT...   pytest, as `python -m pytest OPTION... ARGUMENT...`
    stage.py --bare COMMAND...                              a command where there is no browser, node, cmake and ROS

Skips are counted with their reasons; --no-skips makes any skip an error. A failed test of those marked `processes`,
`browser` or `ros` is run once more, alone, with the OPTIONs: on a shared machine processes meet deadlines late. If it
passes then, it is printed as FLAKY. More than two of these are an error. So is a process that outlives the tests that
started it; it is ended.

STAGES names a file to which the closing lines are added; what is flaky counts in all stages that use the same file.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.etree import ElementTree

HIDDEN = ("chrom*", "google-chrome*", "node", "nodejs", "npm", "npx", "cmake", "ros2", "colcon")
MOST_FLAKY = 2
REPEATED = ("processes", "browser", "ros")
MOST_REPEATED = 10  # where more has failed, it is not the machine
PYTEST = [sys.executable, "-m", "pytest"]
MARK = "FAME_STAGE"
"""A variable of the environment by which the processes of a stage are known, in whatever session they are."""
LEAVING = 5.0
"""How long a process may take to end after the tests (s)."""


class Case(NamedTuple):
    """What pytest says of a test (node id): passed, failed, skipped or xfailed; why, of one that is skipped."""

    test: str
    outcome: str
    reason: str = ""


def main(words: list[str]) -> int:
    if words[:1] == ["--bare"]:
        return run_bare(words[1:])
    split = words.index("--")
    name, *options = words[:split]
    no_skips = options[:1] == ["--no-skips"]
    return run_stage(name, options[int(no_skips) :], words[split + 1 :], no_skips=no_skips)


# ---- tests -----------------------------------------------------------------------------------------------------------


def run_stage(stage: str, options: list[str], arguments: list[str], *, no_skips: bool) -> int:
    """Run tests, repeat those of other programs that fail, and say what happened. Gives the exit code."""
    os.environ[MARK] = uuid.uuid4().hex
    with TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        kept = [f"--junitxml={report}", "-o", "junit_family=xunit1"]
        code = subprocess.run([*PYTEST, *options, *kept, *arguments], check=False).returncode
        cases, seconds = read_report(report) if report.exists() else ([], 0.0)
    failed = list(dict.fromkeys(case.test for case in cases if case.outcome == "failed"))
    flaky = (
        [test for test in failed if passes_alone(test, options)] if code == 1 and len(failed) <= MOST_REPEATED else []
    )
    counts = Counter(({case.test: case.outcome for case in cases} | dict.fromkeys(failed, "failed")).values())
    said = ", ".join(f"{counts[name]} {name}" for name in ("failed", "passed", "skipped", "xfailed") if counts[name])
    lines = [f"{stage}: {said or 'no tests'} in {seconds:.2f}s"]
    lines += [f"  skipped {count}: {reason}" for reason, count in skips(cases).most_common()]
    lines += [f"FAILED {test}" for test in failed if test not in flaky]
    lines += [f"FLAKY {test}" for test in flaky]
    wrong = []
    if no_skips and counts["skipped"]:
        wrong.append("this stage has what its tests need: none may be skipped")
    wrong += [f"outlives the tests: {command}" for command in end_survivors()]
    if (count := count_flaky(lines)) > MOST_FLAKY:
        wrong.append(f"{count} tests are flaky: expected {MOST_FLAKY} at most")
    lines += [f"ERROR {text}" for text in wrong]
    print("\n".join(lines), flush=True)
    if kept_in := os.environ.get("STAGES"):
        with Path(kept_in).open("a", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)
    if code == 1 and failed and failed == flaky:
        code = 0
    return code or int(bool(wrong))


def read_report(path: Path) -> tuple[list[Case], float]:
    """The tests of a report, and how long they took (s)."""
    suite = next(ElementTree.parse(path).getroot().iter("testsuite"))
    return [case_of(element) for element in suite.iter("testcase")], float(suite.get("time", 0))


def case_of(element: ElementTree.Element) -> Case:
    file, name = element.get("file", ""), element.get("name", "")
    classes = element.get("classname", "").removeprefix(file.removesuffix(".py").replace("/", ".")).strip(".")
    test = "::".join(part for part in (file, *classes.split("."), name) if part)
    if element.find("failure") is not None or element.find("error") is not None:
        return Case(test, "failed")
    skipped = element.find("skipped")
    if skipped is None:
        return Case(test, "passed")
    if skipped.get("type") == "pytest.xfail":
        return Case(test, "xfailed")
    reason, text = skipped.get("message", ""), skipped.text or ""
    of_module = reason == "collection skipped"
    return Case(test, "skipped", text.partition("Skipped: ")[2].rstrip("')\"") if of_module else reason)


def skips(cases: list[Case]) -> Counter[str]:
    return Counter(case.reason for case in cases if case.outcome == "skipped")


def passes_alone(test: str, options: list[str]) -> bool:
    """Whether a test is one of other programs, and passes by itself."""
    marked = " or ".join(REPEATED)
    print(f"\nonce more, alone, if it is marked {marked}: {test}", flush=True)
    return subprocess.run([*PYTEST, *options, "-m", marked, test], check=False).returncode == 0


def end_survivors() -> list[str]:
    """End the processes of this stage that are still there, and give their commands."""
    until = time.monotonic() + LEAVING
    while (left := survivors()) and time.monotonic() < until:
        time.sleep(0.1)
    for process in left:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    return [command for command in left.values() if command]


def survivors() -> dict[int, str]:
    """The processes that have this stage's mark, with their commands (Linux: elsewhere none are seen)."""
    mark = f"{MARK}={os.environ[MARK]}".encode()
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile, or is another's
            if int(folder.name) != os.getpid() and mark in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (
                    (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                )
    return found


def count_flaky(lines: list[str]) -> int:
    """The flaky tests of this stage and of those before it."""
    path = Path(os.environ.get("STAGES", os.devnull))
    before = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return sum(line.startswith("FLAKY ") for line in (*before, *lines))


# ---- a machine without programs --------------------------------------------------------------------------------------


def run_bare(command: list[str]) -> int:
    """Run a command with a PATH that lacks what tests may do without. Gives its exit code."""
    with TemporaryDirectory() as folder:
        for program in visible(os.environ["PATH"]):
            link = Path(folder, program.name)
            if not link.is_symlink():
                link.symlink_to(program)
        environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "NODE_PATH")}
        # what a virtual environment is made from has to last longer than these links
        python = shutil.which(os.environ.get("PYTHON", "")) or sys.executable
        environment |= {"PATH": folder, "PYTHON": python}
        return subprocess.run(command, env=environment, check=False).returncode


def visible(path: str) -> Iterator[Path]:
    """The programs of a PATH that are not hidden, in its order."""
    for folder in filter(os.path.isdir, path.split(os.pathsep)):
        for program in sorted(Path(folder).absolute().iterdir()):
            if os.access(program, os.X_OK) and not any(fnmatch(program.name, hidden) for hidden in HIDDEN):
                yield program


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
