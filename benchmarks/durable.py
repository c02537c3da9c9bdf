"""What durable execution costs, and how fast an engine is back: one JSON line per row, then a table.

Rows of `engine.py` are run through a robot's node (`fame.Simulation`) without and with a journal, in turns; the share
is the additional processor time. `resume` reads the journal of a process of 1000 elements with 100 waiting tokens, and
restores its engine, model included. `fsync` is the median time of one write to the disk at hand.

    python benchmarks/durable.py
    python benchmarks/durable.py --only throw --rounds 15
    python benchmarks/durable.py --cases 500        # instead: engines killed at 500 seeded records (`durable_cases.py`)
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import fame
from fame.bpmn import read_text
from fame.robot.durable import DurableRecorder
from fame.robot.journal import Journal, StateDirectory
from fame.robot.restoring import restored
from models import CASES, VARIABLES, Case, Drawing, file, started

ROWS = ("sequence", "throw and catch", "throw and catch, typed", "event sub-process, outside", "instances")


def timed(case: Case, folder: Path, journaled: bool) -> float:
    """Processor seconds of a row in one node, with or without a journal: of a row that is one stimulus, the best of 20.

    Both begin a journal: the disk leaves the same caches behind.
    """
    simulation = fame.Simulation(read_text(case.make(case.size), file="generated.bpmn"), "P", VARIABLES)
    directory = StateDirectory(folder)
    recorder = DurableRecorder(simulation.node, Journal(directory, {}))
    recorder.begin()
    recorder.journal.sync = lambda then: then()  # type: ignore[method-assign,assignment]
    if not journaled:
        recorder.close()
    gc.collect()
    found = spent(simulation.run)
    if case.signals or case.instances:
        found += spent(lambda: [simulation.signal("A") for _ in range(case.size * case.signals)])
        found += spent(lambda: [simulation.start(VARIABLES) for _ in range(case.size * case.instances - 1)])
    else:
        found = min(found, *(spent(lambda: simulation.start(VARIABLES)) for _ in range(19)))
    if journaled:
        recorder.close()
    recorder.journal.close()
    directory.close()
    return found


def spent(act: Callable[[], object]) -> float:
    """Processor seconds that something takes."""
    begun = time.process_time()
    act()
    return time.process_time() - begun


def cost(case: Case, rounds: int) -> dict[str, Any]:
    """The best of several turns without and with a journal."""
    plain, journaled = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            plain.append(timed(case, Path(folder) / f"{number}-plain", False))
            journaled.append(timed(case, Path(folder) / str(number), True))
    stimuli = case.size if case.signals or case.instances else 1
    share = min(journaled) / min(plain) - 1
    return {"row": case.name, "plain_s": round(min(plain), 6), "journal_s": round(min(journaled), 6),
            "share": round(share, 3),
            "us_per_stimulus": round((min(journaled) - min(plain)) / stimuli * 1e6, 1)}  # fmt: skip


def large() -> str:
    """A process of 1000 elements of which 100 hold a token."""
    drawing: Drawing = started()
    drawing.put("parallelGateway", "g")
    for branch in range(100):
        drawing.script(f"a{branch}_0", "x = x + 1", after="g")
        for number in range(1, 9):
            drawing.script(f"a{branch}_{number}", "x = x + 1")
        drawing.put("userTask", f"u{branch}")
    return file(drawing)


def resume(rounds: int) -> dict[str, Any]:
    """Milliseconds of processor time until such an engine is back, once the interpreter is loaded."""
    text, found, reading = large(), [], []
    with tempfile.TemporaryDirectory() as folder:
        directory = StateDirectory(folder)
        simulation = fame.Simulation(read_text(text, file="generated.bpmn"), "P", VARIABLES)
        recorder = DurableRecorder(simulation.node, Journal(directory, {}))
        recorder.begin()
        simulation.run()
        recorder.close()
        recorder.journal.close()
        for _ in range(rounds):
            gc.collect()
            begun = time.process_time()
            simulation = fame.Simulation(read_text(text, file="generated.bpmn"), "P", VARIABLES)
            loaded = time.process_time()
            contents = directory.read()
            assert contents is not None
            tables = restored(simulation.node, contents)
            again = DurableRecorder(simulation.node, Journal.resume(directory, contents))
            again.go_on(tables, 0.0)
            found.append(time.process_time() - begun)
            reading.append(time.process_time() - loaded)
            assert len(simulation.instances[0].waiting) == 100
            again.close()
            again.journal.close()
        directory.close()
    return {"row": "resume 1000 elements, 100 tokens", "ms": round(min(found) * 1e3, 1),
            "without_the_model_ms": round(min(reading) * 1e3, 1)}  # fmt: skip


def disk() -> dict[str, Any]:
    """The median of 200 writes of one record each."""
    found = []
    with tempfile.TemporaryDirectory(dir=".") as folder:
        directory = StateDirectory(folder)
        journal = Journal(directory, {})
        journal.begin_segment({})
        for number in range(200):
            journal.append({"number": number, "text": "x" * 300})
            begun = time.perf_counter()
            journal.flush()
            found.append(time.perf_counter() - begun)
        journal.close()
        directory.close()
    return {"row": "fdatasync of one record", "median_ms": round(statistics.median(found) * 1e3, 3)}


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """All that is asked for."""
    for case in CASES:
        if case.name in ROWS and arguments.only in case.name:
            yield cost(case, arguments.rounds)
    if arguments.only in "resume":
        yield resume(arguments.rounds)
    if arguments.only in "fsync":
        yield disk()


def kill(cases: int, seed: int) -> int:
    """Kill engines at seeded records. Returns 1 if something was different afterwards."""
    import durable_cases

    different = False
    for row in durable_cases.rows(cases, seed):
        print(json.dumps(row), flush=True)
        different = different or bool(row["different"])
    return int(different)


def main() -> None:
    """Run the rows."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="rows with this in their name")
    parser.add_argument("--rounds", type=int, default=7, help="turns of each (default: 7)")
    parser.add_argument(
        "--cases",
        type=int,
        metavar="N",
        help="kill engines at N seeded records of two missions; exit code 1 on a difference",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the records (default: 1)")
    arguments = parser.parse_args()
    print(json.dumps({"load": os.getloadavg()[0]}))
    if arguments.cases is not None:
        sys.exit(kill(arguments.cases, arguments.seed))
    for row in rows(arguments):
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
