"""What each robot's process is at, in words: captions of progress lines and films."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from fame.bpmn.model import (
    Activity,
    Body,
    Definitions,
    Event as BpmnEvent,
    FlowNode,
    Gateway,
    Process,
    SubProcess,
    Task,
    TimerDefinition,
)
from fame.clock import SECOND
from fame.robot import Event


class _Rank(IntEnum):
    """What tells more of a robot: of several things that it is at, the highest is told."""

    CONTAINER = 0
    WAIT = 1
    TASK = 2


class _Phrase(NamedTuple):
    """What a robot is at while a token rests at an element."""

    rank: _Rank
    text: str


class Captions:
    """What each robot's process is at, told from events: its outermost activity, and what it does or waits for in it.

    `cast` are the processes of the robots, by name: until one starts, it says what it waits for. What a called process
    waits for is not told: a robot that goes somewhere waits for its odometry all the time.
    """

    def __init__(self, files: Sequence[Definitions], cast: Mapping[str, Process]) -> None:
        self._phrases = {
            id: phrase
            for file in reversed(files)
            for process in file.processes
            for id, phrase in _phrases(process.body)
            if phrase.rank is not _Rank.WAIT or process in cast.values()
        }
        self._starts = {robot: _start(process) for robot, process in cast.items()}
        self._active: dict[str, dict[tuple[int, int, str], None]] = {}
        self.now: dict[str, str] = {}
        self.labels: list[tuple[float, str, str]] = []
        for robot, text in self._starts.items():
            self._say(0, robot, text)

    def add(self, event: Event) -> None:
        """Take note of an event."""
        active = self._active.setdefault(event.robot, {})
        key = (event.instance, event.scope, event.element)
        if event.what == "enter" and event.element in self._phrases:
            active[key] = None
        elif event.what in ("leave", "cancel", "fail") and key in active:
            del active[key]
        elif event.what == "end":
            for other in [other for other in active if other[0] == event.instance]:
                del active[other]
            if not active:
                again = self._starts.get(event.robot)
                self._say(event.time, event.robot, f"({event.detail})" + (f", {again}" if again else ""))
        else:
            return
        if active:
            self._say(event.time, event.robot, _told([self._phrases[element] for _, _, element in active]))

    def _say(self, time: int, robot: str, text: str) -> None:
        if self.now.get(robot, "") != text:
            self.now[robot] = text
            self.labels.append((time / SECOND, robot, text))


def _told(phrases: Sequence[_Phrase]) -> str:
    """The outermost of several phrases, and the last of those that tell most."""
    highest = max(phrase.rank for phrase in phrases)
    inner = next(phrase.text for phrase in reversed(phrases) if phrase.rank == highest)
    outer = phrases[0]
    return inner if outer.text == inner or outer.rank is _Rank.WAIT else f"{outer.text}: {inner}"


def _phrases(body: Body) -> Iterator[tuple[str, _Phrase]]:
    """What a robot is at at each element where a token can rest."""
    named = {node.id: node for node in body.nodes}
    targets = {
        node.id: [named[flow.target] for flow in body.flows if flow.source == node.id and flow.target in named]
        for node in body.nodes
    }
    for node in body.nodes:
        phrase = _phrase(node, targets[node.id])
        if phrase is not None:
            yield node.id, phrase
        if isinstance(node, SubProcess):
            yield from _phrases(node.body)


def _phrase(node: FlowNode, targets: Sequence[FlowNode]) -> _Phrase | None:
    match node:
        case SubProcess():
            return _Phrase(_Rank.CONTAINER, node.label)
        case Task(kind="user" | "manual"):
            return _Phrase(_Rank.TASK, f"{node.label}, waits for somebody")
        case Task(kind="receive"):
            return _Phrase(_Rank.WAIT, _wait(node))
        case Activity():
            return _Phrase(_Rank.TASK, node.label)
        case BpmnEvent(place="catch"):
            return _Phrase(_Rank.WAIT, _wait(node))
        case Gateway(kind="event"):
            return _Phrase(_Rank.WAIT, node.label if node.name else _wait(*targets))
    return None


def _wait(*nodes: FlowNode) -> str:
    """What is waited for: what a timer is called says how long, or until when."""
    timed = all(isinstance(node, BpmnEvent) and _is_timer(node) for node in nodes)
    return f"waits{':' if timed else ' for'} {' or '.join(node.label for node in nodes)}"


def _is_timer(event: BpmnEvent) -> bool:
    return any(isinstance(definition, TimerDefinition) for definition in event.definitions)


def _start(process: Process) -> str:
    """What a process waits for that has not begun; empty if it begins at once."""
    starts = [node for node in process.body.nodes if isinstance(node, BpmnEvent) and node.place == "start"]
    return _wait(*starts) if starts and all(start.definitions for start in starts) else ""
