"""What may go wrong in what is drawn, explored in a process of its own, which the next change ends.

The process executes what an exploration executes, scripts without effects, and has bounds of time and memory. It gets
the drawn model on its standard input, behind a line of JSON, and writes a line of JSON.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from typing import TYPE_CHECKING, Any, cast

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions, SubProcess, Task
from fame.bpmn.reader import read_bytes
from fame.check import Finding, Level
from fame.check.scope import Fix
from fame.closing import Closing
from fame.dataclasses import asdict
from fame.errors import FameError

if TYPE_CHECKING:
    from fame.check.explore import Exploration

SECONDS = 20.0
"""How long an exploration may take."""
MEMORY = 4_000_000_000
"""Bytes that it may have."""
STATES = 100_000
MOST = 2
"""Explorations at a time; of more the oldest are ended."""
_RUNS = 20
"""Findings whose runs are told."""


class Explorer(Closing):
    """Explores models for the windows of pages, one for each. `subject`: the scenario, or the model."""

    def __init__(self, subject: Path, model: Path, library: Sequence[Path] = (), types: Sequence[Path] = ()) -> None:
        paths = {"subject": subject, "model": model, "library": library, "types": types}
        self._job = json.dumps(paths, default=lambda one: str(one) if isinstance(one, Path) else list(one))
        self._lock = threading.Lock()
        self._running = dict[str, Popen[bytes]]()

    def close(self) -> None:
        """End all."""
        for window in list(self._running):
            self.stop(window)

    def stop(self, window: str) -> None:
        """End what is explored for a window."""
        with self._lock:
            self._end(window)

    def _end(self, window: str) -> None:
        process = self._running.pop(window, None)
        if process is not None:
            process.kill()

    def explore(self, window: str, content: bytes) -> Mapping[str, Any]:
        """Explore a model, instead of what was explored for the window before, and return what was found.

        That is empty if the window has stopped it.
        """
        with self._lock:
            self._end(window)
            alive = [one for one in self._running.values() if one.poll() is None]
            for oldest in alive[: max(0, len(alive) - MOST + 1)]:
                oldest.kill()  # its window is told so
            command = [sys.executable, "-m", "fame.edit.exploring"]
            process = self._running[window] = Popen(command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL)
        with process:
            answer, _ = process.communicate(self._job.encode() + b"\n" + content)
        with self._lock:
            stopped = self._running.get(window) is not process
            if not stopped:
                del self._running[window]
        if process.returncode:
            return {} if stopped else _unknown(f"it ended without a result; {MOST} windows at most explore at a time")
        found: Mapping[str, Any] = json.loads(answer)
        return found


def _unknown(text: str) -> dict[str, Any]:
    return {"status": "partial", "text": f"not explored: {text}", "findings": []}


# ---- in the process --------------------------------------------------------------------------------------------------


def explored(content: bytes, job: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what is found in a model, and in the scenario that it is drawn for."""
    from fame.middleware.messages import register_files
    from fame.scenario import Scenario
    from fame.scenario.explore.exploration import explore
    from fame.scenario.scenario import scenario_findings

    for folder in job["types"]:
        register_files(folder)
    subject, library = Path(job["subject"]), [Path(one) for one in job["library"]]
    model = read_bytes(content, file=job["model"])
    team: Definitions | Scenario = model
    found, folders = list[Finding](), Library(library)
    if subject.suffix.lower() in (".yaml", ".yml"):
        found = scenario_findings(subject, library=library, model=model)
        if any(one.level == "error" for one in found):
            return _unknown("the scenario has errors") | {"findings": [asdict(one) for one in found]}
        team = Scenario.load(subject, library=library, model=model)
        folders = team.library
    # samples would run the scenario itself, with all that its scripts do
    result = explore(team, library=library, limit=STATES, seconds=SECONDS, samples=False)
    text = result.partly() if result.status == "partial" else result.summary().removeprefix(f"{result.file}: ")
    findings = [asdict(one) for one in found] + list(_findings(result, model, folders))
    return {"status": result.status, "text": text, "findings": findings}


def _findings(result: Exploration, model: Definitions, library: Library) -> Iterator[Mapping[str, Any]]:
    """The errors and warnings of an exploration, each with the steps that lead to it."""
    from fame.check.explore.trace import Place

    drawn = places(model, library)
    by_id = dict[str, set[str]]()  # steps do not say of which file their elements are
    for (_, id), place in drawn.items():
        by_id.setdefault(id, set()).add(place)
    only = {id: min(found) for id, found in by_id.items() if len(found) == 1}
    shown = [one for one in result.findings if one.level != "note" and one.kind != "fault"]
    nodes = {one.id: one for process in model.processes for one in process.body.walk()}
    around = {inner.id: node.id for node in nodes.values() if node.body is not None for inner in node.body.nodes}
    first = [next(iter(one.places), Place("")) for one in shown]
    told = [drawn.get((one.file, one.element), "") for one in first]
    known = [(one.level, one.text, place, one.run, one.codes) for one, place in zip(shown, told, strict=True)]
    known += [("error", str(one), "", one.run, ()) for one in result.properties if one.verdict == "refuted"]
    for number, (level, text, place, run, codes) in enumerate(known):
        steps = [
            {
                "text": step.text,
                "element": only.get(step.element, ""),
                "waits": [(robot, only[id]) for robot, id in step.waits if only.get(id)],
            }
            for step in (run if number < _RUNS else ())
        ]
        host = place if isinstance(nodes.get(place), Task | CallActivity | SubProcess) else around.get(place, "")
        fix = Fix(f"catch {codes[0]}", host, "catcher", codes[0]) if codes and host else None
        yield {**asdict(Finding(cast("Level", level), text, element=place, fix=fix)), "steps": steps}


def places(model: Definitions, library: Library) -> dict[tuple[str, str], str]:
    """Return where each element (file, id) is drawn in a model: itself, or the one call that leads to it; empty if
    there are several."""
    drawn = {(model.file, one.id): one.id for one in model.elements()}
    through = dict[tuple[str, str], set[str]]()
    for process in model.processes:
        for call in process.body.calls():
            with suppress(FameError):  # which an error of the exploration has told
                home, called = library.find(model, call)
                for file, inner in library.closure(home, called):
                    for node in inner.body.walk():
                        through.setdefault((file.file, node.id), set()).add(call.id)
    return {key: min(calls) if len(calls) == 1 else "" for key, calls in through.items()} | drawn


def main() -> None:
    """Explore the model on the standard input."""
    import resource

    os.nice(10)
    with suppress(ValueError, OSError):  # of a system that has a lower bound, or none
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    job = json.loads(sys.stdin.buffer.readline())
    try:
        found = explored(sys.stdin.buffer.read(), job)
    except FameError as error:
        found = _unknown(str(error))
    except MemoryError:
        found = _unknown(f"it needs more than {MEMORY // 10**9} GB of memory")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
