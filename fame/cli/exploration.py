"""``fame check --explore``: explore the reachable states of missions, and print what may go wrong in them."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import ArgumentGroup, natural, positive
from fame.cli.output import coloured, print_json, progress_line, table
from fame.errors import NOT_KNOWN, ConfigError, FameError
from fame.text import writable, write_file

if TYPE_CHECKING:
    from fame.check.explore import Exploration, Finding
    from fame.scenario.explore.coverage_file import CoverageReport

_ONLY = (
    "robots",
    "delivery",
    "timers",
    "faults",
    "limit",
    "seconds",
    "first",
    "all",
    "trace",
    "allow_partial",
    "report",
    "coverage",
)
"""Options that mean something with --explore alone."""


STATUSES = ("completed", "partial", "failed")
"""Of explorations, the worst last."""
_CODES = {"completed": 0, "failed": 1, "partial": NOT_KNOWN}


def add_arguments(group: ArgumentGroup) -> None:
    """Declare the options that go with ``--explore``, which are refused without it."""
    group.set_defaults(unexplored=_refuse_without_explore)
    group.add_argument(
        "--robots", action="append", default=[], metavar="POOL=N",
        help="number of robots for a multi-instance pool (default: that of the scenario, or the pool's minimum, at "
             "least 2)",
    )  # fmt: skip
    group.add_argument(
        "--delivery", action="append", default=[], choices=("run", "fast", "any"),
        help="run: as in fame run; fast: in any order, before anything that takes time; any: at any time. "
             "May be given several times (default: run, then fast)",
    )  # fmt: skip
    group.add_argument(
        "--timers", default=None, choices=("any", "ordered"),
        help="order in which the timers of a robot fire: any (default), or by their durations",
    )  # fmt: skip
    group.add_argument("--faults", action="store_true", help="also explore the consequences of each single fault")
    group.add_argument(
        "--limit", type=natural, default=None, metavar="N", help="maximum number of states (default: 200000)"
    )
    group.add_argument("--seconds", type=positive, default=None, metavar="S", help="maximum time, for all deliveries")
    group.add_argument(
        "--first", action="store_true",
        help="end at the first error; explore the order of fame run, fewer robots and random runs before all states",
    )  # fmt: skip
    group.add_argument(
        "--allow-partial", action="store_true",
        help="exit code 0 instead of 3 if no error was found, but not all states were explored",
    )  # fmt: skip
    group.add_argument("--all", action="store_true", help="also show findings without consequences")
    group.add_argument(
        "--trace",
        type=Path,
        metavar="DIR",
        help="write the run to each error to DIR: as a failing test (fame test), a recording (fame view) and a picture",
    )
    group.add_argument(
        "--report", type=Path, metavar="FILE.html",
        help="write a page for people who sign: what was checked, with which options and result, and what was not",
    )  # fmt: skip
    group.add_argument(
        "--coverage", type=Path, metavar="FILE.json", help="for --report: the coverage that fame test --cov-json wrote"
    )


def _refuse_without_explore(arguments: Namespace) -> None:
    """Raise ConfigError for an option that needs ``--explore``."""
    for name in _ONLY:
        if getattr(arguments, name):
            raise ConfigError(f"--{name.replace('_', '-')} needs --explore")


def run(arguments: Namespace) -> int:
    """Explore every file; exit code 1 after an error that is not accepted, else 3 if not all states were explored."""
    from fame.scenario.explore.coverage_file import read_coverage
    from fame.scenario.explore.exploration import explore

    robots = _robots(arguments.robots)
    if arguments.coverage is not None and arguments.report is None:
        raise ConfigError("--coverage needs --report")
    if arguments.report is not None and len(set(arguments.models)) != 1:
        raise ConfigError(f"--report is about one mission: expected one file, got {len(set(arguments.models))}")
    coverage = read_coverage(arguments.coverage) if arguments.coverage is not None else None
    if arguments.report is not None:
        writable(arguments.report, *filter(None, (*arguments.models, arguments.coverage)))
    results = []
    for path in dict.fromkeys(arguments.models):
        with _progress(path) as show:
            result = explore(
                path,
                robots=robots,
                library=arguments.library,
                delivery=tuple(dict.fromkeys(arguments.delivery)) or ("run", "fast"),
                timers=arguments.timers or "any",
                faults=arguments.faults,
                limit=200_000 if arguments.limit is None else arguments.limit,
                seconds=arguments.seconds,
                first=arguments.first,
                progress=show,
            )
        results.append(result)
        if arguments.report is not None:
            _report(result, arguments, path, robots, coverage)
        if arguments.trace is not None:
            _write(result, arguments, path, robots)
        if not arguments.json:
            for line in report(result, everything=arguments.all):
                print(coloured(line, sys.stdout))
    status = max((result.status for result in results), key=STATUSES.index)
    if arguments.json:
        print_json({"status": status, "explorations": [as_json(one) for one in results]})
    return 0 if status == "partial" and arguments.allow_partial else _CODES[status]


@contextmanager
def _progress(path: Path) -> Iterator[Callable[[int, int], object]]:
    """Show on stderr how far an exploration is; how many states there are is not known before its end."""
    with progress_line(sys.stderr) as line:
        last, before = time.monotonic(), 0

        def show(states: int, frontier: int) -> None:
            nonlocal last, before
            now = time.monotonic()
            if line is not None and now - last >= _EVERY:
                rate = max(states - before, 0) / (now - last)
                line.write(f"{path}: {states:,} states, {rate:,.0f} per second, {frontier:,} in the frontier")
                last, before = now, states

        yield show


_EVERY = 0.2  # s between two looks at how far it is


def _report(
    result: Exploration, arguments: Namespace, path: Path, robots: dict[str, int], coverage: CoverageReport | None
) -> None:
    """Write the page for people who sign."""
    from fame import __version__
    from fame.scenario import Scenario
    from fame.scenario.explore.safety_report import safety_report

    scenario = Scenario.load(path, robots=robots, library=arguments.library)
    text = safety_report(
        result,
        scenario,
        command=arguments.command_line,
        version=__version__,
        faults=arguments.faults,
        coverage=coverage,
    )
    write_file(arguments.report, text)


def _write(result: Exploration, arguments: Namespace, path: Path, robots: dict[str, int]) -> None:
    """Write the runs of what was found."""
    from fame.scenario import Scenario
    from fame.testing.explored_runs import write_runs

    if path.suffix == ".bpmn":  # of which fewer robots would be run than are explored
        robots = dict(Counter(pool for robot, pool in result.robots.items() if robot != pool))
    scenario = Scenario.load(path, robots=robots, library=arguments.library)
    written = write_runs(result, scenario, arguments.trace, robots, path)
    if written:
        runs = sum(file.suffix == ".py" for file in written)
        what = f"{runs} run{'s' if runs > 1 else ''}"
        print(f"fame: wrote {what} to {arguments.trace}: for fame test and fame view, and as pictures", file=sys.stderr)


def _robots(given: list[str]) -> dict[str, int]:
    """``POOL=N`` as a mapping. Raises FameError."""
    numbers = {}
    for text in given:
        pool, _, number = text.partition("=")
        if not pool or not number.isdecimal():
            raise FameError(f"--robots: expected POOL=N, got {text!r}")
        numbers[pool] = int(number)
    return numbers


def report(result: Exploration, *, everything: bool = False) -> Iterator[str]:
    """Yield the lines for people. The first one says whether all states were explored."""
    yield result.summary()
    if result.outside:
        yield f"  from outside, at any time: {', '.join(result.outside)}"
    if result.sampled:
        yield f"  explored besides, in part: {'; '.join(result.sampled)}"
    if result.shortened:
        names = ", ".join(f"{element} of {robot}" for robot, element in result.shortened)
        yield f"  taken to be short, though their lengths are not known: lists at {names}"
    if result.midway:
        names = ", ".join(f"{element} of {robot}" for robot, element in result.midway)
        yield f"  taken to publish when they end, though they do so before: scripts at {names}"
    if result.widened:
        names = ", ".join(f"{name} of {robot}" for robot, name in result.widened)
        yield f"  with too many values to tell apart, so unknown after a while: {names}"
    for judged in result.properties:
        yield ""
        yield f"{'error: ' if judged.verdict == 'refuted' else ''}{judged}"
        yield from (f"  {number:3}. {step}" for number, step in enumerate(judged.run, 1))
    shown = [one for one in result.findings if everything or one.accepted or one.kind not in ("unneeded", "fault")]
    for finding in shown:
        yield ""
        yield f"{finding.level}: {finding.text}"
        if finding.accepted:
            yield f"  accepted: {finding.accepted}"
        elif finding.run and (finding.level == "error" or everything):
            yield from finding.steps()
    yield from _fault_table(result)
    yield ""
    yield _summary(result, len(result.findings) - len(shown))


def _fault_table(result: Exploration) -> Iterator[str]:
    rows = [row for search in result.searches for row in search.faults]
    if rows:
        yield ""
        yield table(("fault", "delivery", "outcome"), rows)


def _summary(result: Exploration, hidden: int) -> str:
    levels = [one.level for one in result.findings if one.kind != "unneeded" and not one.accepted]
    levels += ["error" for one in result.properties if one.verdict == "refuted"]
    accepted = sum(bool(one.accepted) for one in result.findings)
    parts = [f"{levels.count(level)} {level}{'s' if levels.count(level) > 1 else ''}"
             for level in ("error", "warning") if level in levels]  # fmt: skip
    parts += [f"{accepted} accepted"] if accepted else []
    if result.status == "partial":
        parts.insert(0, result.partly())
    elif not result.exhaustive:
        parts[-1] += f", in a partial search ({result.states:,} of unknown)"
    text = ", ".join(parts) or "No problems found."
    return text + (f" ({hidden} without consequences: --all)" if hidden else "")


def as_json(result: Exploration) -> dict[str, Any]:
    return {
        "file": result.file,
        "status": result.status,
        "exhaustive": result.exhaustive,
        "cuts": list(result.cuts),
        "sampled": list(result.sampled),
        "robots": dict(result.robots),
        "states": result.states,
        "seconds": round(result.seconds, 3),
        "outside": list(result.outside),
        "shortened": [list(one) for one in result.shortened],
        "midway": [list(one) for one in result.midway],
        "widened": [list(one) for one in result.widened],
        "searches": [
            {name: value for name, value in asdict(search).items() if name != "judged"} for search in result.searches
        ],
        "properties": [
            {
                "property": judged.name,
                "sentence": judged.sentence,
                "verdict": judged.verdict,
                "text": judged.text,
                "delivery": judged.delivery,
                "run": [step.text for step in judged.run],
            }
            for judged in result.properties
        ],
        "findings": [finding_as_json(one) for one in result.findings],
    }


def finding_as_json(finding: Finding) -> dict[str, Any]:
    return {
        "kind": finding.kind,
        "level": finding.level,
        "text": finding.text,
        "accepted": finding.accepted,
        "delivery": finding.delivery,
        "doomed": finding.doomed,
        "elements": [asdict(place) for place in finding.places],
        "run": [
            {"robot": step.robot, "kind": step.kind, "element": step.element, "detail": step.detail, "text": step.text}
            for step in finding.run
        ],
    }
