"""Finds the message that a catching event took: a recording has messages and marks, but not what connects them.

An event takes the first message of its instant that was sent after it began to wait, and so behind all that its robot
had taken by then; one with a queue the oldest that this keeps. What each goes to one token (BPMN messages, what is
addressed) is known if there is one alone. What a network delays is not known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from fame.bpmn.model import Definitions, Event, FlowNode, SignalDefinition, Topic

_Key = tuple[str, int, str]  # robot, scope, element


class Signals:
    """The messages of a team that runs some models. `begin` each instant, `add` its messages, then follow the marks."""

    def __init__(self, models: Sequence[Definitions]) -> None:
        self._nodes = dict[str, FlowNode]()
        self._queued, self._single = set[str](), set[str]()  # topics: with a queue; of messages that one token takes
        for node in (node for file in models for process in file.processes for node in process.body.walk()):
            self._nodes.setdefault(node.id, node)
            for topic, _ in node.topics():
                is_signal = any(one.topic is topic for one in node.defined(SignalDefinition))
                self._single |= set() if is_signal and topic.to is None else {topic.qualified}
                self._queued |= {topic.qualified} if topic.queue else set()
        self._thrown = {topic.qualified for node in self._nodes.values() for topic, thrown in node.topics() if thrown}
        self._boundary = dict[str, list[str]]()  # activity -> its boundary events
        for node in self._nodes.values():
            if isinstance(node, Event) and node.attached_to:
                self._boundary.setdefault(node.attached_to, []).append(node.id)
        self._ids = dict[str, list[str]]()  # topic -> its messages so far
        self._first = dict[str, int]()  # topic -> that of this instant
        self._passed = dict[tuple[str, str], int]()  # robot, topic -> behind what the robot has taken last
        self._parents, self._opened = dict[tuple[str, int], int](), dict[tuple[str, int], Mapping[str, int]]()
        self._entered, self._next = dict[_Key, Mapping[str, int]](), dict[tuple[_Key, str], int]()
        self._used = set[tuple[str, int]]()

    def begin(self) -> None:
        """Begin an instant."""
        self._first = {topic: len(ids) for topic, ids in self._ids.items()}

    def add(self, topic: str, id: str) -> None:
        """Add a message that was sent at this instant."""
        self._ids.setdefault(topic, []).append(id)

    def opens(self, robot: str, scope: int, parent: int | None) -> None:
        """Open a scope, with its queues."""
        self._parents[robot, scope] = parent or 0
        self._opened[robot, scope] = {_of(robot, each): self._front(robot, _of(robot, each)) for each in self._queued}

    def throws(self, robot: str, element: str) -> list[str]:
        """Return the topics that an element throws on."""
        return [_of(robot, topic.qualified) for topic, thrown in self._topics(element) if thrown]

    def is_thrown(self, robot: str, topic: str) -> bool:
        """Return whether an element of the models throws on a topic, in some robot."""
        return topic in self._thrown or topic.replace(f"/{robot}/", "~/", 1) in self._thrown

    def catches(self, element: str) -> list[Topic]:
        """Return the topics that an element catches from."""
        return [topic for topic, thrown in self._topics(element) if not thrown]

    def enter(self, robot: str, scope: int, element: str) -> None:
        """A token comes to an element, and waits there."""
        events = (element, *self._boundary.get(element, ()))
        names = [_of(robot, topic.qualified) for event in events for topic in self.catches(event)]
        if names:
            self._entered[robot, scope, element] = {name: self._front(robot, name) for name in names}

    def taken_by(self, robot: str, scope: int, element: str) -> tuple[str, str] | None:
        """Return topic and message that a token has taken which leaves an event, if that is known."""
        for topic in self.catches(element):
            name = _of(robot, topic.qualified)
            place = self._taken(robot, scope, self._nodes[element], topic, name)
            if place is not None:
                self._passed[robot, name] = max(place + 1, self._front(robot, name))
                return name, self._ids[name][place]
        return None

    def _taken(self, robot: str, scope: int, node: FlowNode, topic: Topic, name: str) -> int | None:
        """Which of the messages of a topic an event has taken."""
        end, first = len(self._ids.get(name, ())), self._first.get(name, 0)
        if topic.qualified in self._single or node.keys_of(topic):
            free = [place for place in range(first, end) if (name, place) not in self._used]
            self._used |= {(name, place) for place in free if len(free) == 1}
            return free[0] if len(free) == 1 else None
        host = node.attached_to if isinstance(node, Event) else ""
        is_start = isinstance(node, Event) and node.place == "start"
        home = self._parents.get((robot, scope), 0) if is_start else scope
        key = ((robot, home, node.id), name)
        begun = self._entered.get((robot, scope, host or node.id), {}).get(name, 0)
        if topic.queue and not host:
            begun = self._opened.get((robot, home), {}).get(name, first)
        repeats = host or is_start or topic.queue  # it goes on catching
        place = max(begun, self._next.get(key, 0) if repeats else 0, first - topic.queue)
        self._next[key] = place + 1 if place < end else place
        return place if place < end else None

    def _front(self, robot: str, topic: str) -> int:
        """Where the messages begin that a robot has not had when it comes to a place."""
        return max(self._first.get(topic, 0), self._passed.get((robot, topic), 0))

    def _topics(self, element: str) -> Iterator[tuple[Topic, bool]]:
        node = self._nodes.get(element)
        return node.topics() if node is not None else iter(())


def _of(robot: str, topic: str) -> str:
    return topic.replace("~", f"/{robot}", 1)
