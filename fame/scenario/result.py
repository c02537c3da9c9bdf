"""Progress and result of a run, in one process or in many."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from fame.bpmn.library import comes_with_fame
from fame.clock import EPOCH, SECOND, date_text
from fame.dataclasses import dataclass, field
from fame.errors import MissionError
from fame.middleware.interface import TopicInfo
from fame.robot import Event, PendingStarts, WaitingToken
from fame.robot.waiting_tokens import A_PERSON

if TYPE_CHECKING:
    from fame.bpmn.pools import Pool
    from fame.deploy import Report
    from fame.properties.judgement import Judgement
    from fame.robot import RobotNode


HEADS = ("robot", "instances", "elements", "status")
"""Columns of a table of robots (`RobotResult.row`)."""

Status = Literal["completed", "failed", "timeout", "interrupted"]


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a run: simulated s, and the current activity of each robot."""

    simulated: float
    duration: float
    robots: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class TeamStatus:
    """The status of a team: mission time (s), last report of each robot, and process ids."""

    time: float
    reports: Mapping[str, Report]
    pids: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class RobotResult:
    """The result of one robot. `elements` is the number of completed elements; `waits` are the tokens still waiting.

    `untaken`: how many BPMN messages reached it that no event took, by topic.
    `ahead`: whether timers of start events were still pending.
    """

    name: str
    instances: int
    completed: int
    failed: int
    elements: int
    errors: tuple[MissionError, ...]
    waits: tuple[WaitingToken, ...]
    ahead: PendingStarts = ""
    untaken: Mapping[str, int] = field(default_factory=dict)

    @property
    def running(self) -> int:
        """The number of instances that had not ended."""
        return self.instances - self.completed - self.failed

    @property
    def summary(self) -> str:
        """How its instances ended: ``completed``, ``1 failed, 2 running``, or what the start events wait for."""
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
    """The result of a run. A notebook shows a table of its robots.

    `simulated` and `wall` are in s; `world` is the summary of the final world. `ending` says why the mission was not
    over at the end: its time was up, or it was stuck; else it is empty. `never_started` are the pools that were
    required but not started, `problems` errors of operating-system processes, or before the mission began. `epoch` is
    the date of second 0. `judgements` are about the properties of the scenario.
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
    judgements: tuple[Judgement, ...] = ()

    @property
    def exit_code(self) -> int:
        """The exit code of `fame run`: 130 interrupted, 1 not completed or violated, 3 pending or not known, else 0.

        Of a run that was cut while a property is violated it is that of the property, of one that ended at its
        duration also while one is pending.
        """
        own = {"completed": 0, "interrupted": 130}.get(self.status, 1)
        if not self.judgements:
            return own
        from fame.properties.judgement import exit_code

        cut = {"completed": {"violated", "pending"}, "timeout": {"violated", "pending"}, "interrupted": {"violated"}}
        if cut.get(self.status, set()) & {each.verdict for each in self.judgements}:
            return exit_code(self.judgements)
        return own or exit_code(self.judgements)

    @property
    def messages(self) -> list[str]:
        """One line for each error and waiting token, and for what is wrong in the world (`_world_messages`)."""
        alone = "; a model alone has no world: a scenario has one" if self.world is None else ""
        errors = (error for robot in self.robots for error in robot.errors)
        lines = [*self.problems, *(f"{error}{alone if _needs_world(error) else ''}" for error in errors)]
        if self.status == "timeout" or (self.status == "failed" and self.ending):
            lines.append(f"{self.ending} after {self.simulated:g} simulated seconds{alone}")
        if self.status != "completed":
            lines += [f"pool {name} never started: no robot of it ran its process" for name in self.never_started]
            waits = [wait for robot in self.robots for wait in robot.waits]
            lines += map(str, waits)
            waiting = next((wait for wait in waits if wait.text == A_PERSON), None)
            if waiting is not None:
                here = f"--complete {waiting.robot}@S:{waiting.element} does it at simulated second S"
                lines.append(f"{here}; fame complete reaches robots in processes of their own (--middleware dds)")
        for robot in self.robots:
            for topic, count in robot.untaken.items():
                number = "1 message" if count == 1 else f"{count} messages"
                lines.append(
                    f"{robot.name}: {number} on {topic} reached it, and no event took {'it' if count == 1 else 'them'}"
                )
        return [*lines, *_world_messages(self.world)] if self.world is not None else lines

    @property
    def told(self) -> list[tuple[Event, int]]:
        """The reports in order; of those that are alike, the time of the first, the text of the last, and how many."""
        found: dict[object, tuple[Event, int]] = {}
        for place, event in enumerate(self.reports):
            key = alike(event) or place
            first, count = found.get(key, (event, 0))
            found[key] = (event._replace(time=first.time), count + 1)
        return list(found.values())

    def to_json(self) -> dict[str, Any]:
        """Return everything, JSON-serialisable."""
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
                    "waits": [
                        {"element": wait.element, "place": wait.place, "for": wait.text, "suspended": wait.suspended}
                        for wait in robot.waits
                    ],
                    "untaken": dict(robot.untaken),
                }
                for robot in self.robots
            },
            "never_started": list(self.never_started),
            "world": self.world,
            "properties": [judgement.to_json() for judgement in self.judgements],
            "reports": [
                {"time": event.time / SECOND, "robot": event.robot, "element": event.element, "text": event.detail}
                for event in self.reports
            ],
            "messages": self.messages,
        }

    def _repr_html_(self) -> str:
        """Return a table with a row for each robot, for notebooks."""
        from html import escape

        def line(tag: str, cells: Iterable[object]) -> str:
            return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"

        caption = f"<caption>{self.status}: {self.simulated:.1f} s simulated</caption>"
        lines = [line("th", HEADS), *(line("td", robot.row) for robot in self.robots)]
        messages = [f"<p>{escape(message)}</p>" for message in self.messages]
        return "\n".join(["<table>", caption, *lines, "</table>", *messages])


def _needs_world(error: MissionError) -> bool:
    """Whether a behaviour of FAME's library failed, by no mistake in a script: perhaps no robot is there."""
    return error.code != "script" and comes_with_fame(error.file)


def _world_messages(world: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each pair that collided, empty battery, parcel that is not where it is wanted, and weed left."""
    collided: dict[frozenset[str], list[Mapping[str, Any]]] = {}
    for one in world["collisions"]:
        collided.setdefault(frozenset((one["a"], one["b"])), []).append(one)
    for first, *more in collided.values():
        times = f" {len(more) + 1} times, first" if more else ""
        yield f"{first['a']} collided with {first['b']}{times} at {first['time']:g} s"
    for name, robot in world["robots"].items():
        if robot.get("battery") == 0:
            yield f"the battery of {name} is empty"
    for name, parcel in world.get("parcels", {}).items():
        if parcel["to"] and (parcel["carrier"] or parcel["station"] != parcel["to"]):
            place = f"on {parcel['carrier']}" if parcel["carrier"] else f"at {parcel['station'] or 'no station'}"
            yield f"parcel {name} is {place}, not at {parcel['to']}"
    for name, weed in world["weeds"].items():
        if weed["by"] is None:
            yield f"weed {name} was not cut"


def never_started(cast: Mapping[str, Pool], robots: Sequence[RobotResult]) -> tuple[str, ...]:
    """Return the pools that no robot has started and whose process is not optional."""
    started = {cast[robot.name].name for robot in robots if robot.instances}
    required = dict.fromkeys(pool.name for pool in cast.values() if not pool.process.optional)
    return tuple(name for name in required if name not in started)


def is_over(robots: Sequence[RobotResult]) -> bool:
    """Return whether a process has run, none is running, and no timer will start one."""
    return at_rest(robots) and not any(robot.ahead for robot in robots)


def at_rest(robots: Sequence[RobotResult]) -> bool:
    """Return whether a process has run, none is running, and only endless timer cycles are pending."""
    return any(robot.instances for robot in robots) and not any(
        robot.running or robot.ahead == "due" for robot in robots
    )


def status_of(robots: Sequence[RobotResult], unstarted: Sequence[str]) -> Status:
    """Return the status of a run that was not interrupted."""
    if any(robot.failed for robot in robots):
        return "failed"
    if not at_rest(robots):
        return "timeout"
    return "failed" if unstarted else "completed"


def robot_result(node: RobotNode, waits: tuple[WaitingToken, ...]) -> RobotResult:
    """Return the result of one robot, from its engine; `waits` are its waiting tokens."""
    return RobotResult(
        name=node.name,
        instances=node.started,
        completed=node.completed,
        failed=node.failed,
        elements=node.elements,
        errors=tuple(instance.error for instance in node.instances if instance.error is not None),
        waits=waits,
        ahead=node.pending_starts,
        untaken=node.untaken(),
    )


def reported_result(robot: str, report: Report | None) -> RobotResult:
    """Return the result of one robot, from its last report."""
    if report is None:
        return RobotResult(robot, 0, 0, 0, 0, (), ())
    return RobotResult(
        name=robot,
        instances=report.started,
        completed=report.completed,
        failed=report.failed,
        elements=report.elements,
        errors=tuple(_error(robot, error) for error in report.errors),
        waits=tuple(_wait(robot, wait) for wait in report.waits),
        ahead=report.ahead,  # type: ignore[arg-type]
        untaken=report.untaken,
    )


def _error(robot: str, fields: Mapping[str, Any]) -> MissionError:
    return MissionError(
        fields.get("text", ""),
        robot=robot,
        element=fields.get("element", ""),
        name=fields.get("name", ""),
        file=fields.get("file", ""),
        line=fields.get("line", 0),
        code=fields.get("code", ""),
    )


def _wait(robot: str, fields: Mapping[str, Any]) -> WaitingToken:
    since = round(fields.get("since", 0.0) * SECOND)
    element, text = fields.get("element", ""), fields.get("for", "")
    place, suspended = fields.get("place", ""), fields.get("suspended", "")
    return WaitingToken(robot, element, text, since, fields.get("topics", {}), place, suspended)


def mistyped_topics(graph: Iterable[TopicInfo], alike: float = 0.85) -> Iterator[tuple[str, str]]:
    """Yield the full name of each node that publishes a probably mistyped topic, and a message about it.

    Names are compared within a namespace; they are alike from that ratio of `difflib` on.
    """
    subscribed: dict[str, dict[str, str]] = defaultdict(dict)
    unsubscribed: list[TopicInfo] = []
    for info in graph:
        namespace, _, name = info.name.rpartition("/")
        if info.subscribers:
            subscribed[namespace][name.lower()] = name
        else:
            unsubscribed.append(info)
    for info in unsubscribed:
        namespace, _, name = info.name.rpartition("/")
        for similar in difflib.get_close_matches(name.lower(), subscribed[namespace], 1, alike):
            for node in dict.fromkeys(info.publishers):
                right = f"{namespace}/{subscribed[namespace][similar]}"
                yield node, f"publishes on {info.name}, which has no subscriber; did you mean {right}?"


_NUMBER = re.compile(r"\b\d+\b")


def alike(event: Event) -> object:
    """Return what reports have in common that differ in numbers only, such as how many messages
    were lost; None for a log."""
    return (event.robot, event.element, _NUMBER.sub("#", str(event.detail))) if event.what == "report" else None
