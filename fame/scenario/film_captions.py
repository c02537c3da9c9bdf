"""The current activity of each robot's process in words: captions of progress lines and animations."""

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
    """The priority of concurrent activities: the highest is shown."""

    CONTAINER = 0
    WAIT = 1
    TASK = 2


class _Phrase(NamedTuple):
    """The text for a token that rests at an element."""

    rank: _Rank
    text: str


class Captions:
    """The caption of each robot, from events: its outermost activity, and the task or wait inside it.

    `cast` has the process of each robot: before it starts, the caption is what its start events wait for. Waits in
    called processes are not shown, because a robot that drives waits for its odometry all the time.
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
            self._set(0, robot, text)

    def add(self, event: Event) -> None:
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
                self._set(event.time, event.robot, f"({event.detail})" + (f", {again}" if again else ""))
        else:
            return
        if active:
            self._set(event.time, event.robot, _caption([self._phrases[element] for _, _, element in active]))

    def _set(self, time: int, robot: str, text: str) -> None:
        if self.now.get(robot, "") != text:
            self.now[robot] = text
            self.labels.append((time / SECOND, robot, text))


def _caption(phrases: Sequence[_Phrase]) -> str:
    """The outermost of several phrases, and the last of those with the highest rank."""
    highest = max(phrase.rank for phrase in phrases)
    inner = next(phrase.text for phrase in reversed(phrases) if phrase.rank == highest)
    outer = phrases[0]
    return inner if outer.text == inner or outer.rank is _Rank.WAIT else f"{outer.text}: {inner}"


def _phrases(body: Body) -> Iterator[tuple[str, _Phrase]]:
    """The phrase of each element where a token can rest."""
    named = {node.id: node for node in body.nodes}
    targets = {
        node.id: [named[flow.target] for flow in body.flows if flow.source == node.id and flow.target in named]
        for node in body.nodes
    }
    for node in body.nodes:
        phrase = _phrase(node, targets[node.id])
        if phrase is not None:
            yield node.id, phrase
        if node.body is not None:
            yield from _phrases(node.body)


def _phrase(node: FlowNode, targets: Sequence[FlowNode]) -> _Phrase | None:
    match node:
        case SubProcess():
            return _Phrase(_Rank.CONTAINER, node.label)
        case Task(kind="user" | "manual"):
            return _Phrase(_Rank.TASK, f"{node.label}, waits for a person")
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
    """The phrase of a wait. The name of a timer event is expected to say how long, or until when."""
    timed = all(node.defined(TimerDefinition) for node in nodes)
    return f"waits{':' if timed else ' for'} {' or '.join(_name(node) for node in nodes)}"


def _name(node: FlowNode) -> str:
    """What people see at an element: its name, or the topic that it waits for."""
    topics = [topic.qualified for topic, _ in node.topics()]
    return node.name or " or ".join(topics) or node.label


def _start(process: Process) -> str:
    """The topics and times that start a process; empty if it starts at once."""
    starts = process.body.events("start")
    return _wait(*starts) if starts and all(start.definitions for start in starts) else ""
