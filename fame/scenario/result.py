"""How a run goes, and how it went."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from html import escape
from typing import TYPE_CHECKING, Any, Literal

from fame.clock import EPOCH, SECOND, date_text
from fame.errors import MissionError
from fame.robot import Event, PendingStarts, WaitingToken
from fame.robot.waiting_tokens import SOMEBODY

if TYPE_CHECKING:
    from fame.deploy import Report
    from sim2d.record import Record

HEADS = ("robot", "instances", "elements", "status")
"""Of a table of robots (`RobotResult.row`)."""

Status = Literal["completed", "failed", "timeout", "interrupted"]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is: simulated s, and what each robot is at."""

    simulated: float
    duration: float
    robots: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class TeamStatus:
    """How things stand: s of the mission, what robots said last, and the number of each process."""

    time: float
    reports: Mapping[str, Report]
    pids: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class RobotResult:
    """How it went for one robot. `elements`: how many were completed; `waits`: what still waited at the end.

    `ahead`: whether timers of start events were still to come.
    """

    name: str
    instances: int
    completed: int
    failed: int
    elements: int
    errors: tuple[MissionError, ...]
    waits: tuple[WaitingToken, ...]
    ahead: PendingStarts = ""

    @property
    def running(self) -> int:
        """How many instances had not ended."""
        return self.instances - self.completed - self.failed

    @property
    def summary(self) -> str:
        """How its instances ended: ``completed``, ``1 failed, 2 running``, or what it waited for before any started."""
        if not self.instances:
            return "; ".join(["never started", *(f"waits for {wait.text}" for wait in self.waits)])
        counts = ((self.failed, "failed"), (self.running, "running"), (self.completed, "completed"))
        present = [(count, word) for count, word in counts if count]
        return present[0][1] if len(present) == 1 else ", ".join(f"{count} {word}" for count, word in present)

    @property
    def row(self) -> tuple[str, int, int, str]:
        """Its cells in a table with the columns `HEADS`."""
        return self.name, self.instances, self.elements, self.summary


@dataclass(frozen=True, slots=True)
class Result:
    """How a run went. A notebook shows a table of its robots.

    `simulated` and `wall` in s; `world` is how things stand in it; `labels` caption a film.
    `ending` says why it was not over when it ended: its time was up, or nothing could move any more; else it is empty.
    `never_started` are the pools without which it is not completed, `problems` what went wrong with the processes of
    robots, or before the mission began. `epoch` is the date of second 0.
    """

    status: Status
    seed: int
    robots: tuple[RobotResult, ...]
    simulated: float
    wall: float
    reports: tuple[Event, ...]
    ending: str
    world: Mapping[str, Any] | None
    epoch: datetime = EPOCH
    never_started: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    record: Record | None = field(default=None, repr=False)
    labels: tuple[tuple[float, str, str], ...] = field(default=(), repr=False)

    @property
    def exit_code(self) -> int:
        """That of the command: 0 completed, 1 not, 130 interrupted."""
        return {"completed": 0, "interrupted": 130}.get(self.status, 1)

    @property
    def messages(self) -> list[str]:
        """What went wrong, a line each, for people; also the weeds that are left, if the mission is completed."""
        lines = [*self.problems, *(str(error) for robot in self.robots for error in robot.errors)]
        if self.status == "timeout" or (self.status == "failed" and self.ending):
            alone = "; a model alone has no world: a scenario has one" if self.world is None else ""
            lines.append(f"{self.ending} after {self.simulated:g} simulated seconds{alone}")
        if self.status != "completed":
            lines += [f"pool {name} never started: no robot of it ran its process" for name in self.never_started]
            waits = [wait for robot in self.robots for wait in robot.waits]
            lines += [f"{wait.robot} waits at {wait.element} for {wait.text}" for wait in waits]
            asked = next((wait for wait in waits if wait.text == SOMEBODY), None)
            if asked is not None:
                here = f"--complete {asked.robot}@S:{asked.element} does it at simulated second S"
                lines.append(f"{here}; fame complete reaches robots in processes of their own (--middleware dds)")
        weeds = self.world["weeds"] if self.world is not None else {}
        lines += [f"nobody cut the weed {name}" for name, weed in weeds.items() if weed["by"] is None]
        return lines

    def to_json(self) -> dict[str, Any]:
        """Everything but the record, fit for JSON."""
        return {
            "status": self.status,
            "seed": self.seed,
            "epoch": date_text(self.epoch),
            "simulated": round(self.simulated, 9),
            "wall": round(self.wall, 3),
            "robots": {
                robot.name: {
                    "instances": robot.instances,
                    "completed": robot.completed,
                    "failed": robot.failed,
                    "elements": robot.elements,
                    "errors": [error.to_json() for error in robot.errors],
                    "waits": [{"element": wait.element, "for": wait.text} for wait in robot.waits],
                }
                for robot in self.robots
            },
            "never_started": list(self.never_started),
            "world": self.world,
            "reports": [
                {"time": event.time / SECOND, "robot": event.robot, "element": event.element, "text": event.detail}
                for event in self.reports
            ],
            "messages": self.messages,
        }

    def _repr_html_(self) -> str:
        """Return a table with a row for each robot, for notebooks."""

        def line(tag: str, cells: Iterable[object]) -> str:
            return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"

        caption = f"<caption>{self.status}: {self.simulated:.1f} s simulated</caption>"
        lines = [line("th", HEADS), *(line("td", robot.row) for robot in self.robots)]
        messages = [f"<p>{escape(message)}</p>" for message in self.messages]
        return "\n".join(["<table>", caption, *lines, "</table>", *messages])
