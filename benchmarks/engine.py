"""How many flow nodes the engine passes in a second: one JSON line per model, then a table.

Each model (`models.py`) is run on the bare engine (face `engine`: a host without clock and topics), through
`fame.Simulation` (face `simulation`), with a `fame.EventLog` that keeps every event (face `log`), with a function that
is called for every event (face `observer`), and with the log written to a file (face `file`). A line tells flow nodes
per second (completed elements, scripts included; the best of several runs, since noise only ever slows), the CPU and
wall time of that run in seconds, and the peak memory of the process so far in MB. `flat` lines tell how CPU time and
memory per pass of a loop grow with their number.

    python benchmarks/engine.py
    python benchmarks/engine.py --only loop --face engine
    python benchmarks/engine.py --against SpiffWorkflow --against bpmn-engine

With `--against`, the same models run on other engines too (`against.py`), each of them in processes of its own, in
turns with FAME; the table has the ratios.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from against import ENGINES, AbsentError, Comparison, contenders

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Definitions, Expression
from fame.engine import Engine, compile_program
from fame.scripting import compile_expression, compile_script
from fame.scripting.interface import interface
from models import CASES, VARIABLES, Case, loop, sequence

ROUNDS = 7
FACES = ("engine", "simulation", "log", "observer", "file")
LOOPS = (2_000, 20_000, 200_000)

# ---- faces -------------------------------------------------------------------------------------------------------


class Host:
    """A world without time and topics, for the engine alone."""

    def __init__(self, types: dict[str, str]) -> None:
        self.types = types
        self.instances: list[Any] = []

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Any:
        compiler = compile_script if script else compile_expression
        return compiler(expression, file=file, element=element)

    def publish(self, topic: str, value: Any) -> Any:
        from fame.middleware import messages

        type = self.types.get(topic)
        return value if type is None else messages.create(type, value)

    def begun(self, instance: Any) -> None:
        pass

    def ended(self, instance: Any) -> None:
        self.instances.append(instance)

    def make_safe(self, reason: str) -> None:
        pass


def on_engine(model: Definitions, signals: int, instances: int) -> tuple[float, float, int]:
    """CPU and wall seconds, and completed elements, on the bare engine."""
    from fame.bpmn.topics import topic_table

    process = model.process("P")
    assert process is not None
    types = {name: use.declared for name, use in topic_table(model).items() if use.declared}
    host: Any = Host(types)

    def library(name: str, file: str, call: Any) -> Any:
        return model.process(call.called), file

    program = compile_program(process, host=host, library=library)
    builtins = interface(robot=None, signal=print, log=lambda level, text: None)
    engine = Engine(program, host, lambda: {"__builtins__": builtins})

    def run() -> None:
        engine.begin(dict(VARIABLES))
        for _ in range(signals):
            engine.deliver("/A", None)
        for _ in range(instances - 1):
            engine.start(dict(VARIABLES))

    cpu, wall = timed(run)
    done = [*host.instances, *engine.instances.values()]
    return cpu, wall, sum(sum(instance.visits.values()) for instance in done)


def on_simulation(model: Definitions, signals: int, instances: int, observer: Any = None) -> tuple[float, float, int]:
    """The same through `fame.Simulation`."""
    simulation = fame.Simulation(model, "P", VARIABLES, observer=observer)

    def run() -> None:
        simulation.run()
        for _ in range(signals):
            simulation.signal("A")
        for _ in range(instances - 1):
            simulation.start(VARIABLES)

    cpu, wall = timed(run)
    return cpu, wall, sum(sum(instance.visits.values()) for instance in simulation.instances)


def with_log(model: Definitions, signals: int, instances: int) -> tuple[float, float, int]:
    """With every event kept in memory."""
    return on_simulation(model, signals, instances, fame.EventLog())


def with_observer(model: Definitions, signals: int, instances: int) -> tuple[float, float, int]:
    """With every event given to a function, one by one."""
    events: list[Any] = []
    return on_simulation(model, signals, instances, events.append)


def with_file(model: Definitions, signals: int, instances: int) -> tuple[float, float, int]:
    """With every event written to a file of JSON lines."""
    from fame.log import logging_to

    with tempfile.TemporaryDirectory() as folder, logging_to(Path(folder) / "run.jsonl", [model]) as write:
        return on_simulation(model, signals, instances, write)


RUNS = {"engine": on_engine, "simulation": on_simulation, "log": with_log, "observer": with_observer, "file": with_file}


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall seconds of a call."""
    gc.collect()
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return time.process_time() - cpu, time.perf_counter() - wall


def read(text: str) -> Definitions:
    return read_text(text, file="generated.bpmn")


def measure(case: Case, face: str, rounds: int) -> dict[str, Any]:
    """The best of several runs."""
    model = read(case.make(case.size))
    found = [RUNS[face](model, case.size * case.signals, case.size * case.instances) for _ in range(rounds)]
    cpu, wall, elements = min(found)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"case": case.name, "size": case.size, "face": face, "elements": elements,
            "per_second": round(elements / cpu), "cpu": round(cpu, 6), "wall": round(wall, 6),
            "peak_mb": round(peak)}  # fmt: skip


def reading(count: int, rounds: int) -> dict[str, Any]:
    """Parsing and compiling, until the first token could move."""
    text = sequence(count)
    cpu, wall = min(timed(lambda: fame.Simulation(read(text), "P")) for _ in range(rounds))
    return {"case": f"read and compile {count}", "size": count, "face": "simulation", "elements": count,
            "per_second": round(count / cpu), "cpu": round(cpu, 6), "wall": round(wall, 6)}  # fmt: skip


def starting(count: int, rounds: int) -> dict[str, Any]:
    """A further simulation of a model, until the first token could move: the mean of a hundred."""
    model = read(sequence(count))
    fame.Simulation(model, "P")
    hundred = min(timed(lambda: [fame.Simulation(model, "P") for _ in range(100)]) for _ in range(rounds))
    cpu, wall = (seconds / 100 for seconds in hundred)
    return {"case": f"start {count} again", "size": count, "face": "simulation", "elements": count,
            "per_second": round(count / cpu), "cpu": round(cpu, 6), "wall": round(wall, 6)}  # fmt: skip


def flatness(rounds: int) -> Iterator[dict[str, Any]]:
    """Nanoseconds of CPU time for an element, in loops of several lengths by turns; and peak memory of each."""
    models = {count: read(loop(count)) for count in LOOPS}
    for face in ("engine", "simulation"):
        found: dict[int, list[float]] = {count: [] for count in LOOPS}
        for _ in range(rounds):
            for count, model in models.items():
                for _ in range(max(1, LOOPS[1] // count)):
                    cpu, _, elements = RUNS[face](model, 0, 0)
                    found[count].append(cpu / elements)
        cost = {count: round(min(seconds) * 1e9, 1) for count, seconds in found.items()}
        spread = round(max(cost.values()) / min(cost.values()), 3)
        yield {"flat": "ns per element", "face": face, **{str(count): ns for count, ns in cost.items()},
               "ratio": spread}  # fmt: skip
    peaks = {str(count): peak_of(loop(count)) for count in LOOPS}
    ratio = round(max(peaks.values()) / min(peaks.values()), 3)
    yield {"flat": "peak MB", "face": "simulation", **peaks, "ratio": ratio}


def peak_of(model: str) -> float:
    """Peak memory in MB of a process that runs a model once."""
    program = Path(__file__).resolve().parent / "contenders" / "fame_robots.py"
    order = {"process": "P", "variables": dict(VARIABLES), "signals": 0, "instances": 0, "seconds": 0}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.bpmn"
        file.write_text(model, encoding="utf-8")
        command = [sys.executable, str(program), str(file), json.dumps(order)]
        answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return round(float(json.loads(answer)["peak_mb"]), 1)


def lines(only: str, faces: tuple[str, ...], rounds: int) -> Iterator[dict[str, Any]]:
    """The results, one at a time."""
    for case in CASES:
        if only in case.name:
            for face in faces:
                yield measure(case, face, rounds)
    for count in (1000, 10_000):
        if only in f"read and compile {count}":
            yield reading(count, min(rounds, 5))
    if only in "start 100 again":
        yield starting(100, rounds)
    if only in "loop":
        yield from flatness(rounds)


def table(found: list[dict[str, Any]], faces: tuple[str, ...]) -> str:
    """Million elements per CPU second, in Markdown."""
    rates = {(line["case"], line["face"]): f"{line['per_second'] / 1e6:.2f}" for line in found if "case" in line}
    rows = [["model", *faces], ["---"] + ["---:"] * len(faces)]
    names = [case.name for case in CASES if (case.name, faces[0]) in rates]
    rows += [[name, *(rates[name, face] for face in faces)] for name in names]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description="Flow nodes per second.")
    parser.add_argument("--only", default="", metavar="TEXT", help="models with this in their name")
    parser.add_argument("--face", choices=FACES, action="append", help="how FAME is run (default: all)")
    parser.add_argument("--rounds", type=int, help=f"turns of each (default: {ROUNDS}; beside other engines 5)")
    parser.add_argument("--against", choices=tuple(ENGINES), action="append", help="compare with another engine")
    parser.add_argument("--limit", type=float, default=10.0, metavar="S", help="CPU seconds for one turn of an engine")
    parser.add_argument("--quick", action="store_true", help="one turn, and little time for each: numbers are rough")
    arguments = parser.parse_args()
    rounds = arguments.rounds or (1 if arguments.quick else 5 if arguments.against else ROUNDS)
    if arguments.against:
        limit, seconds = (3.0, 0.1) if arguments.quick else (arguments.limit, 0.3)
        try:
            comparison = Comparison(contenders(arguments.against))
        except AbsentError as error:
            parser.error(str(error))
        for line in comparison.run(arguments.only, rounds, limit, seconds):
            print(json.dumps(line), flush=True)
        print("", comparison.table(arguments.only), sep="\n")
        return
    faces = tuple(arguments.face or FACES)
    found = []
    for line in lines(arguments.only, faces, rounds):
        print(json.dumps(line), flush=True)
        found.append(line)
    print("", table(found, faces), sep="\n")


if __name__ == "__main__":
    main()
