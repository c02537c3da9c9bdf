"""The run beside the model that is drawn: begun by the page, and changed with the model while it lasts.

A run of its own thread follows the commands of the page (`fame.view.control`). When the model has been written, its
robots go over to it where they are, as ``fame deploy --migrate`` lets those of a team; where a token cannot, the page
is told, and may begin again: a new run with the same seed, as fast as possible to the same instant, where it pauses.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from fame.bpmn.model import Human
from fame.closing import Closing
from fame.errors import FameError
from fame.scenario import Scenario
from fame.scenario.run import Run
from fame.view.catalogue import Catalogue
from fame.view.control import RunControl, speed_of
from fame.view.live import LiveRun
from fame.view.mission import mission_json
from fame.view.sink import PageSink


class _Page(LiveRun):
    """The page of a run, which takes commands once it has been repeated to the instant where the last one was."""

    def advance(self, run: Run, until: int) -> None:
        super().advance(run, until)
        if self._repeats is not None and self.control_of_run.pause_at is None:
            self.hand_over()


class EditedRun(Closing):
    """The source of a page with the run of `subject`, a model or a scenario; without one until the page begins it."""

    def __init__(self, subject: Path, library: Sequence[Path] = ()) -> None:
        self._subject, self._library = subject, tuple(library)
        self._lock = threading.RLock()
        self._number = 0  # of the run
        self._run: _Page | None = None
        self._thread = threading.Thread()
        self._nothing = PageSink(Catalogue([]))

    def close(self) -> None:
        """End the run, if there is one."""
        run, self._run = self._run, None
        if run is not None:
            with suppress(FameError):  # it is over
                run.control_of_run.call(_interrupt)
            self._thread.join(timeout=_GRACE)

    def _begin(self, command: Mapping[str, Any], time: int | None = None) -> None:
        """Begin a run, as fast as possible to `time` (ns) if there is one. What runs goes on if that fails."""
        scenario = self._scenario()
        control = RunControl(speed=speed_of(command.get("speed", 1.0)), pause_at=time)
        run, made, free = _Page(scenario, control), Future[None](), threading.Event()
        if command.get("to"):
            control.goal = _number(run, str(command["to"]))
        thread = threading.Thread(target=_work, args=(scenario, run, made, free), name="fame edit: run", daemon=True)
        thread.start()
        made.result()
        self.close()
        self._run, self._thread, self._number = run, thread, self._number + 1
        free.set()

    def _scenario(self) -> Scenario:
        return Scenario.load(self._subject, library=self._library)

    # ---- for the page ------------------------------------------------------------------------------------------------

    @property
    def _shown(self) -> PageSink:
        return self._run or self._nothing

    def mission(self) -> Mapping[str, Any]:
        run, title = self._run, self._subject.stem
        found = run.mission() if run is not None else mission_json("live", title, self._nothing.catalogue, ())
        return {**found, "number": self._number}

    def plane(self, number: int) -> Mapping[str, Any]:
        return self._shown.plane(number)

    def block(self, number: int) -> Mapping[str, Any]:
        return self._shown.block(number)

    def tasks(self, element: str) -> list[Human]:
        return self._shown.tasks(element)

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        run, (which, old) = self._run, known or (None, None)
        begins = [{"type": "begin"}] if known is not None and which is not run else []  # it has blocks of another one
        has, news = run.news(old if which is run else None) if run is not None else (None, [])
        return (run, has), [*begins, *news]

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Carry out a command: ``begin`` (to an element: `to`), ``again``, ``end``; ``change`` to the model as it is.

        All others are of the run. Raises FameError.
        """
        with self._lock:
            act, run = command.get("do"), self._run
            if act == "end":
                self.close()
            elif act == "begin":
                self._begin(command)
            elif run is None:
                raise FameError("nothing runs")
            elif act == "again":
                self._begin(command, run.time)
            elif act == "change":
                return self._change(run)
            elif act == "run_to":
                return run.control({"do": act, "element": _number(run, str(command.get("to")))})
            else:
                return run.control(command)
        return {}

    def _change(self, run: _Page) -> Mapping[str, Any]:
        """Let the robots go over to the model as it is now, or say which tokens cannot."""
        found = run.control_of_run.call(partial(run.migrate, plan=self._scenario()))
        blocked = [
            {"robot": robot, "element": token.element, "text": str(token)}
            for robot, foreseen in found.items()
            for token in foreseen.tokens
            if token.fate == "blocked"
        ]
        return {"blocked": blocked, "time": run.time}


_GRACE = 5.0
"""How long a run may take to end (s)."""


def _interrupt(run: Run) -> None:
    run.interrupted = True
    run.scheduler.stop()


def _number(run: LiveRun, id: str) -> int:
    """The number of an element. Raises FameError."""
    found = run.catalogue.candidates(id)
    if not found:
        raise FameError(f"{id} is not in the model that runs: save it first")
    return found[0]


def _work(scenario: Scenario, page: _Page, made: Future[None], free: threading.Event) -> None:
    """Make a run, and do it once the one before is over; in a thread of its own, whose page tells how it ends."""
    try:
        run = Run(scenario, False, page.observer, None, pace=page)
    except Exception as error:  # of whatever the scenario names
        made.set_exception(error if isinstance(error, FameError) else FameError(f"{type(error).__name__}: {error}"))
        return
    made.set_result(None)
    free.wait()
    try:
        page.end(run.result().status)
    except Exception as error:
        page.end("failed", f"{type(error).__name__}: {error}")
