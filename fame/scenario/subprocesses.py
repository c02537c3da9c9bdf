"""Processes of FAME that belong together: started by us, heard by us, and ended together, whatever happens.

A Ctrl-C in the terminal does not reach them: they are ended in order. Should we be killed, they notice it and end too
(`orphaned`).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fame.clock import date_text
from fame.scenario.process import PARENT

if TYPE_CHECKING:
    from fame.scenario.plan import Plan

ENDING = 5.0
"""How long a process may take to end (s)."""


class Subprocesses:
    """The processes by name. `hear` gets their lines on stderr, with the name, in threads of ours."""

    def __init__(self, hear: Callable[[str, str], object]) -> None:
        self._hear = hear
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._threads: list[threading.Thread] = []
        self.last: dict[str, str] = {}

    def start(self, name: str, words: Sequence[str]) -> None:
        """Start ``fame`` with the words of a command line."""
        root = Path(__file__).resolve().parents[2]
        paths = [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        process = subprocess.Popen(
            [sys.executable, "-m", "fame", *words],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), PARENT: str(os.getpid())},
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._processes[name] = process
        thread = threading.Thread(target=self._listen, args=(name, process), daemon=True)
        self._threads.append(thread)
        thread.start()

    def pid(self, name: str) -> int:
        """The number of a process."""
        return self._processes[name].pid

    def ended(self) -> list[str]:
        """Those that are no more, and why, a line each."""
        return [
            f"{name} {_cause(code)}" + (f": {self.last[name]}" if name in self.last else "")
            for name, process in self._processes.items()
            if (code := process.poll()) is not None
        ]

    def end(self) -> list[str]:
        """End all, and wait for it. Returns those that had to be killed, a line each."""
        for process in self._processes.values():
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGINT)
        until, stubborn = time.monotonic() + ENDING, []
        for name, process in self._processes.items():
            try:
                process.wait(max(0.1, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                stubborn.append(f"{name} did not end by itself within {ENDING:g} s")
        for thread in self._threads:
            thread.join()
        return stubborn

    def _listen(self, name: str, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        with process.stderr as lines:
            for line in lines:
                self.last[name] = line.strip()
                self._hear(name, line.rstrip())


def command_lines(
    scenario: Plan, backend: str, *, speed: float | None, lockstep: bool, types: Sequence[Path], trust: Path
) -> dict[str, list[str]]:
    """The processes of a scenario, and what each is started with after ``fame``: the world, and an engine per robot.

    `trust` is the file of the public key that the engines trust.
    """
    from sim2d.registry import absolute

    lines: dict[str, list[str]] = {}
    places = [word for place in types for word in ("--types", str(place.resolve()))]
    tail = ["--middleware", backend]
    files = ["--files", str(Path(scenario.definitions.file).resolve().parent)]
    kinds: dict[str, str] = {}
    time: list[str] = []
    if scenario.world is not None:
        pace = ["--speed", str(speed)] if speed is not None else []
        waits = ["--pause", *(word for robot in scenario.cast for word in ("--lockstep", robot))] if lockstep else []
        lines["world"] = ["world", scenario.file, "--seed", str(scenario.seed), *pace, *waits, *tail]
        folder = Path(scenario.world.source.file).parent
        kinds = {robot.name: absolute(robot.type, folder) for robot in scenario.world.robots}
        time = ["--lockstep" if lockstep else "--use-sim-time"]
    for robot in scenario.cast:
        kind = ["--type", kinds[robot]] if robot in kinds else []
        own = ["--trust", str(trust), "--unsigned-tasks", *kind, *files]
        lines[robot] = ["engine", robot, *own, *time, "--epoch", date_text(scenario.epoch), *places, *tail]
    return lines


def _cause(code: int) -> str:
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"
