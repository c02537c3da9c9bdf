"""FAME as a contender: `fame.Simulation`, without an observer."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

from measuring import Prepared, answer

import fame


def read(file: str, order: dict[str, Any]) -> Callable[[], Prepared]:
    """The model, parsed; each simulation compiles it."""
    definitions = fame.read(file)
    fame.Simulation(definitions, order["process"])

    def prepare() -> Prepared:
        simulation = fame.Simulation(definitions, order["process"], order["variables"])

        def run() -> dict[str, Any]:
            simulation.run()
            for _ in range(order["signals"]):
                simulation.signal("A")
            for _ in range(order["instances"] - 1):
                simulation.start(order["variables"])
            last = simulation.instances[-1]
            if last.status != "completed" and not order["signals"]:
                raise SystemExit(f"the process is {last.status}: {last.error or last.waiting}")
            return {name: last.variables.get(name) for name in order["variables"]}

        return run

    return prepare


if __name__ == "__main__":
    answer(read)
