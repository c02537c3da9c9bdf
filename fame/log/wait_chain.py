"""Follow what the tokens of a robot wait for through the team: who could send it, and what those wait for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from itertools import chain
from typing import Any

from fame.bpmn.model import Body, Definitions, Event
from fame.clock import SECOND
from fame.dataclasses import dataclass, field
from fame.errors import display_name
from fame.log.elements import UNKNOWN, ElementInfo, element_info
from fame.log.wait_reasons import silences, suspension, wait_text
from fame.middleware.interface import ENGINE, resolve
from fame.robot.robot_state import RobotState
from fame.robot.wait_sentences import sentence
from fame.text import printable

_FROM_OUTSIDE = frozenset(("timer", "conditional", "signal", "message"))
"""Triggers of events that listen beside a token and can take it away."""


@dataclass(eq=False, slots=True)
class WaitChain:
    """The waits of a team at one moment: the state of each robot, the files that it runs, its clock (ns).

    `publishers`: topic -> the nodes that publish on it, for starts, of which no token says it.
    """

    states: Mapping[str, RobotState]
    files: Mapping[str, Sequence[Definitions]]
    now: Mapping[str, int] = field(default_factory=dict)
    publishers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    _told: set[str] = field(default_factory=set)
    _infos: dict[str, Mapping[str, ElementInfo]] = field(default_factory=dict)

    def lines(self, robot: str, token: Mapping[str, Any]) -> Iterator[str]:
        """Yield what the robots wait for that publish what a token of `robot` waits for, to the
        end. Each is told once."""
        self._told = {robot}
        yield from self._senders(token, 1)
        if text := self.circle_text(self.circle(robot)):
            yield printable(f"  {text}")

    def _senders(self, token: Mapping[str, Any], depth: int) -> Iterator[str]:
        for topic, senders in senders_of(token).items():
            for sender in senders:
                if sender not in self._told:
                    self._told.add(sender)
                    yield from self._robot(sender, topic, "  " * depth, depth)

    def _robot(self, robot: str, topic: str, indent: str, depth: int) -> Iterator[str]:
        """What one that publishes on a topic does now."""
        if robot not in self.states:
            yield printable(indent + sentence("stranger", node=robot, topic=topic))
            return
        waits = self._waits(robot)
        if not waits:
            yield printable(f"{indent}{robot} {self._idle(robot, topic)}")
        for wait in waits:
            seconds = (
                f", for {max(0, self.now.get(robot, 0) - wait['since']) / SECOND:.1f} s" if "since" in wait else ""
            )
            by = f" ({suspended})" if (suspended := suspension(wait)) else ""
            text = "; ".join([wait_text(wait) + by, *silences(wait, self.now.get(robot, 0))])
            yield printable(f"{indent}{robot} waits at {self._label(robot, wait)}{seconds}, for {text}")
            yield from self._senders(wait, depth + 1)

    # ---- circles -----------------------------------------------------------------------------------------------------

    def circle(self, robot: str) -> Sequence[str]:
        """Return the robots that wait for `robot`, among those that it waits for, with it, in order; or none."""
        reached = self._awaited(robot)
        if robot not in reached:
            return ()
        found = sorted(one for one in reached if one == robot or robot in self._awaited(one))
        return found if len(found) > 1 else ()

    def circle_text(self, circle: Sequence[str]) -> str:
        """Return that robots wait for each other, and what can end that, in words; empty without any."""
        if not circle:
            return ""
        ways = dict.fromkeys(way for one in circle for way in self._ways_out(one, circle))
        end = sentence("ways_out", ways="; ".join(ways)) if ways else sentence("no_way_out")
        return f"{sentence('circle', robots=', '.join(circle[:-1]) + ' and ' + circle[-1])}; {end}"

    def _awaited(self, robot: str) -> set[str]:
        """The robots that a robot waits for, through others too."""
        found: set[str] = set()
        ahead = [robot]
        while ahead:
            for wait in self._waits(ahead.pop()):
                senders = set(chain.from_iterable(senders_of(wait).values()))
                new = (senders & self.states.keys()) - found
                found |= new
                ahead.extend(new)
        return found

    def _ways_out(self, robot: str, circle: Sequence[str]) -> Iterator[str]:
        """What may move a robot of a circle although none of the others does."""
        for wait in self._waits(robot):
            if not _is_held_by(wait, circle):
                yield f"{robot}, {self._label(robot, wait)}, for {wait_text(wait)}"
            inside = {*self.states[robot].path(wait.get("scope", 0)), wait["element"]}
            for body in self._bodies(robot):
                if not inside.isdisjoint(node.id for node in body.nodes):
                    yield from (f"{robot}, {way}" for way in ways_out(body, inside))

    # ---- robots ------------------------------------------------------------------------------------------------------

    def _waits(self, robot: str) -> list[Mapping[str, Any]]:
        """The tokens of a robot that wait; without an instance, the starts of its process that something triggers."""
        state = self.states[robot]
        if state.tokens or self._runs(robot):
            return list(state.tokens.values())
        bodies = [
            each.body for file in self.files.get(robot, ()) for each in file.processes if each.id == state.process
        ]
        events = chain.from_iterable(body.events("start") for body in bodies)
        return [self._start(robot, event) for event in events if event.definitions]

    def _start(self, robot: str, event: Event) -> Mapping[str, Any]:
        """A start event, as a token that waits there."""
        topics = [resolve(topic.qualified, robot) for topic, _ in event.topics()]
        publishers = {topic: self.publishers.get(topic, ()) for topic in topics}
        texts = [sentence("topic", topic=topic) for topic in topics] or [each.trigger for each in event.definitions]
        kind = "topic" if topics else "start"
        return {
            "element": event.id,
            "kind": kind,
            "text": " or ".join(texts),
            "topics": topics,
            "publishers": publishers,
        }

    def _idle(self, robot: str, topic: str) -> str:
        """What a robot does of which no token waits."""
        if self._runs(robot):
            return sentence("at_work")
        if self.states[robot].instances:
            return sentence("ended", topic=topic)
        return sentence("not_started")

    def _bodies(self, robot: str) -> Iterator[Body]:
        for file in self.files.get(robot, ()):
            for process in file.processes:
                yield from process.body.bodies()

    def _runs(self, robot: str) -> bool:
        return any(status == "running" for _, status in self.states[robot].instances.values())

    def _label(self, robot: str, wait: Mapping[str, Any]) -> str:
        if robot not in self._infos:
            self._infos[robot] = element_info(self.files.get(robot, ()))
        return display_name(wait["element"], self._infos[robot].get(wait["element"], UNKNOWN).name)


def ways_out(body: Body, inside: Set[str]) -> Iterator[str]:
    """Yield the boundary events and event sub-processes of a body that can take a token away,
    which is `inside` these."""
    handlers = (node.body for node in body.nodes if node.triggered_by_event and node.id not in inside)
    starts = chain.from_iterable(each.events("start") for each in handlers if each is not None)
    for event in (*chain.from_iterable(map(body.boundary, inside)), *starts):
        if any(each.trigger in _FROM_OUTSIDE for each in event.definitions):
            yield f"{event.display_name}, a {' or '.join(each.trigger for each in event.definitions)} event"


def senders_of(wait: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the robots, or other nodes, that publish on each topic that a token waits for."""
    found = wait.get("publishers", {})
    return {
        topic: list(dict.fromkeys(node.strip("/").removesuffix(f"/{ENGINE}") for node in found.get(topic, ())))
        for topic in wait.get("topics", ())
    }


def _is_held_by(wait: Mapping[str, Any], circle: Sequence[str]) -> bool:
    """Whether only messages of these robots can move a token; one that joins others moves with them."""
    if wait.get("suspended") or wait.get("kind") not in ("topic", "join"):
        return False
    return all(set(each) <= set(circle) for each in senders_of(wait).values())
