"""FAME beside other engines: the same models, in turns, each engine in a process of its own.

A model is tried in a hundredth, a twentieth, a tenth of its size and whole; an engine is out of it at the first size
that it does not finish in its time, or whose result is wrong, and is compared at the last one that it does. What is
counted are the elements that a run completes, which are the same for all. A turn gives the best of its runs, and the
table the median of the turns: of an engine, and of its ratio to FAME in the same round.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from operator import truediv
from pathlib import Path
from statistics import median
from typing import Any

from models import CASES, VARIABLES, Case, in_javascript, in_services

HERE = Path(__file__).resolve().parent / "contenders"
NPM = "bpmn-engine@25.0.1"
CAMUNDA = "camunda-python==0.1.2"
STACK = 900_000
"""kB of stack for an engine that recurses: with the usual one it ends after some hundred elements."""

MOST_OTHERS = 20
"""How many times the processor time of a turn it may take by the clock, where others use the machine."""


class AbsentError(Exception):
    """An engine is not installed, and how it would be."""


@dataclass(frozen=True)
class Engine:
    """How an engine is called, with file and order; `translate` makes its file of the model."""

    name: str
    command: Callable[[str, str], list[str]]
    translate: Callable[[str], str] = str


def fame_robots() -> Engine:
    return Engine("FAME", lambda file, order: [sys.executable, str(HERE / "fame_robots.py"), file, order])


def spiffworkflow() -> Engine:
    try:
        said = version("SpiffWorkflow")
    except PackageNotFoundError:
        raise AbsentError("SpiffWorkflow is not installed; pip install SpiffWorkflow") from None
    program = str(HERE / "spiffworkflow.py")
    return Engine(f"SpiffWorkflow {said}", lambda file, order: [sys.executable, program, file, order])


def bpmn_engine() -> Engine:
    """Installed on first use, into a folder of the system for temporary files."""
    folder = Path(tempfile.gettempdir()) / f"fame-{NPM}"
    install = ["npm", "install", "--silent", "--prefix", str(folder), NPM]
    try:
        if not (folder / "node_modules" / "bpmn-engine").exists():
            subprocess.run(install, check=True, capture_output=True)
        subprocess.run(["node", "--version"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        raise AbsentError(f"bpmn-engine needs node and npm, and {' '.join(install)}") from None
    program = ["node", f"--stack-size={STACK}", str(HERE / "bpmn_engine.mjs")]
    name = f"bpmn-engine {NPM.partition('@')[2]}"
    return Engine(name, lambda file, order: [*program, file, order, str(folder)], in_javascript)


def camunda_python(*more: str) -> Engine:
    """Installed on first use, as bpmn-engine is; it needs Python 3.12."""
    folder = Path(tempfile.gettempdir()) / f"fame-{CAMUNDA}"
    try:
        if not (folder / "bin" / "pip").exists():
            subprocess.run(["python3.12", "-m", "venv", str(folder)], check=True, capture_output=True)
        subprocess.run([str(folder / "bin" / "pip"), "install", "--quiet", CAMUNDA], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        raise AbsentError(f"camunda-python needs python3.12, and pip install {CAMUNDA}") from None
    program = [str(folder / "bin" / "python"), str(HERE / "camunda_python.py")]
    name = " with ".join((f"camunda-python {CAMUNDA.rpartition('=')[2]}", *more))
    return Engine(name, lambda file, order: [*program, file, order, *more], in_services)


def fame_state() -> Engine:
    return Engine("FAME with state", lambda file, order: [*fame_robots().command(file, order), "state"])


ENGINES: Mapping[str, Callable[[], Engine]] = {
    "SpiffWorkflow": spiffworkflow,
    "bpmn-engine": bpmn_engine,
    "camunda-python": camunda_python,
    "camunda-python-sqlite": partial(camunda_python, "sqlite"),
    "FAME-state": fame_state,
}


# ---- one run -----------------------------------------------------------------------------------------------------


@dataclass
class Measured:
    """What an engine did with a model of a size: seconds of each turn, or why it does not count."""

    case: str
    size: int
    engine: str
    elements: int = 0
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    read: list[float] = field(default_factory=list)
    peak_mb: float = 0.0
    failure: str = ""

    def line(self) -> dict[str, Any]:
        """As JSON."""
        about: dict[str, Any] = {"case": self.case, "size": self.size, "engine": self.engine}
        if self.failure:
            return about | {"failure": self.failure}
        about |= {"elements": self.elements, "per_second": round(self.elements / median(self.cpu))}
        seconds = {name: round(median(getattr(self, name)), 6) for name in ("cpu", "wall", "read")}
        return about | seconds | {"peak_mb": round(self.peak_mb)}


def unlimited_stack() -> None:
    """For the child: as much stack as the system grants."""
    _, hard = resource.getrlimit(resource.RLIMIT_STACK)
    resource.setrlimit(resource.RLIMIT_STACK, (hard, hard))


def processor_time() -> float:
    """Of all children that have ended (s). A limit of the system's would make their own clocks coarse."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def turn(engine: Engine, case: Case, size: int, folder: Path, limit: float, seconds: float) -> dict[str, Any] | str:
    """One turn of an engine: its answer, or the reason for its absence."""
    file = folder / f"{case.name}-{size}-{engine.name}.bpmn"
    if not file.exists():
        file.write_text(engine.translate(case.make(size)), encoding="utf-8")
    order = {"process": "P", "variables": dict(VARIABLES), "seconds": seconds,
             "signals": size * case.signals, "instances": size * case.instances}  # fmt: skip
    command = engine.command(str(file), json.dumps(order))
    before = processor_time()
    try:
        found = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=MOST_OTHERS * limit,
            check=False,
            preexec_fn=unlimited_stack,
        )
    except subprocess.TimeoutExpired:
        return f"not done after {MOST_OTHERS * limit:g} s of the clock"
    if processor_time() - before > limit:
        return f"not done after {limit:g} s"
    if found.returncode:
        return reason(found)
    answer: dict[str, Any] = json.loads(found.stdout.splitlines()[-1])
    for name, value in case.expected(size).items():
        if answer["variables"].get(name) != value:
            return f"wrong result: {name} is {answer['variables'].get(name)}, not {value}"
    return answer


def reason(found: subprocess.CompletedProcess[str]) -> str:
    """Why a process ended badly, in its own words."""
    if found.returncode < 0:
        return f"killed by signal {-found.returncode}"
    lines = [line.strip() for line in found.stderr.splitlines() if line.strip()]
    telling = [line for line in lines if "Error" in line or "Exception" in line] or lines[-1:] or ["no reason given"]
    return telling[0][:160]


def elements_of(case: Case, size: int) -> int:
    """How many elements a run completes, by FAME's count."""
    import fame
    from fame.bpmn import read_text

    simulation = fame.Simulation(read_text(case.make(size), file="generated.bpmn"), "P", VARIABLES).run()
    for _ in range(size * case.signals):
        simulation.signal("A")
    for _ in range(size * case.instances - 1):
        simulation.start(VARIABLES)
    return sum(instance.visits.total() for instance in simulation.instances)


# ---- all of them -------------------------------------------------------------------------------------------------


@dataclass
class Comparison:
    """All that was measured, by case, size and engine."""

    engines: Sequence[Engine]
    found: dict[tuple[str, int, str], Measured] = field(default_factory=dict)

    def last(self, case: Case, engine: Engine) -> Measured | None:
        """The largest size of a case that an engine has finished."""
        done = [said for (name, _, who), said in self.found.items()
                if (name, who) == (case.name, engine.name) and not said.failure]  # fmt: skip
        return done[-1] if done else None

    def run(self, only: str, rounds: int, limit: float, seconds: float) -> Iterator[dict[str, Any]]:
        """Measure, and give each result as it is there."""
        with tempfile.TemporaryDirectory() as folder:
            for case in CASES:
                if only in case.name and not case.own:
                    yield from self.one(case, partial(turn, folder=Path(folder), limit=limit, seconds=seconds), rounds)

    def one(self, case: Case, take: Callable[..., Any], rounds: int) -> Iterator[dict[str, Any]]:
        """One case: a round in each size, to see who finishes; further ones at the largest size of each, and whole."""
        own, *others = self.engines
        running = others
        for size in (max(2, case.size // 100), case.size // 20, case.size // 10, case.size):
            running = self.round(case, size, (own, *running), take)
        largest = {engine: said.size for engine in others if (said := self.last(case, engine)) is not None}
        for size in sorted({*largest.values(), case.size}):
            for _ in range(rounds - 1):
                self.round(case, size, (own, *(engine for engine in others if largest.get(engine) == size)), take)
        yield from (said.line() for (name, _, _), said in self.found.items() if name == case.name)

    def round(self, case: Case, size: int, engines: Sequence[Engine], take: Callable[..., Any]) -> list[Engine]:
        """A turn of each engine, the first of which is FAME; the others that finished."""
        elements = elements_of(case, size)
        finished = []
        for engine in engines:
            said = self.found.setdefault(
                (case.name, size, engine.name), Measured(case.name, size, engine.name, elements)
            )
            answer = take(engine, case, size)
            if isinstance(answer, str):
                said.failure = answer
                continue
            for name in ("cpu", "wall", "read"):
                getattr(said, name).append(answer[name])
            said.peak_mb = max(said.peak_mb, answer["peak_mb"])
            finished.append(engine)
        return [engine for engine in finished if engine is not self.engines[0]]

    def table(self, only: str) -> str:
        """Elements per CPU second of each at the last size that it finished, and how many times faster FAME is there.

        As Markdown, with a row for reading, and what was not finished below.
        """
        own, *others = self.engines
        head = ["model", own.name, *(text for engine in others for text in (engine.name, "at size", "FAME is"))]
        cases = [case for case in CASES if only in case.name and not case.own]
        rows = [head, ["---"] + ["---:"] * (len(head) - 1)]
        rows += [self.row(case, case.name, lambda said: said.cpu) for case in cases]
        rows += [self.row(case, f"reading: {case.name}", lambda said: said.read) for case in cases[:1]]
        failed = [f"- {said.case} {said.size:,}, {said.engine}: {said.failure}"
                  for said in self.found.values() if said.failure]  # fmt: skip
        table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        return "\n".join([table, *(["", "Not finished:", "", *failed] if failed else [])])

    def row(self, case: Case, name: str, seconds: Callable[[Measured], list[float]]) -> list[str]:
        """One row of it, of rates by those seconds."""
        own, *others = self.engines
        ours = self.last(case, own)
        row = [name, f"{ours.elements / median(seconds(ours)):,.0f}" if ours is not None else "-"]
        for engine in others:
            theirs = self.last(case, engine)
            if theirs is None:
                row += ["-", "-", "-"]
            else:
                beside = self.found[case.name, theirs.size, own.name]
                times = median(map(truediv, seconds(theirs), seconds(beside)))
                row += [f"{theirs.elements / median(seconds(theirs)):,.0f}", f"{theirs.size:,}", f"{times:,.0f} x"]
        return row


def contenders(names: Sequence[str]) -> list[Engine]:
    """FAME and the engines named. Raises AbsentError."""
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    return [fame_robots(), *(ENGINES[name]() for name in names)]
