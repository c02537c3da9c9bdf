"""FAME as a contender: `fame.Simulation`, without an observer; with ``state`` the journal of `fame engine --state`."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

from measuring import Prepared, answer

import fame
from fame.robot.durable import DurableRecorder
from fame.robot.journal import Journal, StateDirectory


def read(file: str, order: dict[str, Any]) -> Callable[[], Prepared]:
    """The model, parsed; each simulation compiles it."""
    definitions = fame.read(Path(file).read_bytes(), file=file)  # by its path it is read once
    fame.Simulation(definitions, order["process"])

    def prepare() -> Prepared:
        simulation = fame.Simulation(definitions, order["process"], order["variables"])
        journal = None
        if sys.argv[3:] == ["state"]:
            folder = tempfile.TemporaryDirectory()
            journal = Journal(StateDirectory(folder.name), {})
            DurableRecorder(simulation.node, journal).begin()

        def run() -> dict[str, Any]:
            simulation.run()
            for _ in range(order["signals"]):
                simulation.signal("A")
            for _ in range(order["instances"] - 1):
                simulation.start(order["variables"])
            last = simulation.instances[-1]
            if last.status != "completed" and not order["signals"]:
                raise SystemExit(f"the process is {last.status}: {last.error or last.waiting}")
            if journal is not None:
                journal.close()  # all is on the disk
                folder.cleanup()
            return {name: last.variables.get(name) for name in order["variables"]}

        return run

    return prepare


if __name__ == "__main__":
    answer(read)
