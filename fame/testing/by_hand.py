"""A mission under test that runs step by step: the test triggers every end, arrival and timer.

Behaviours, scripts that wait and services are steps that the test ends; messages between robots arrive, or are lost,
when it says so; timers fire when it says so. There is no world, and what only the world knows is unknown: the test says
what is decided on it. So a test can take any of the ways that `fame check --explore` explores (docs/exploration.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fame.bpmn.pools import shared_topics
from fame.check.explore.abstraction import Abstraction, abstraction
from fame.check.explore.canonical import stimuli
from fame.check.explore.kinds import kinds_of
from fame.check.explore.mismatches import given_values
from fame.check.explore.team import codes_named
from fame.clock import SECOND
from fame.errors import FameError
from fame.properties.conditions import subjects
from fame.robot import RobotNode
from fame.robot.events import Observer
from fame.scenario import Scenario
from fame.scenario.run import Run
from fame.testing.failure import failure
from fame.testing.manual_robots import HeldNetwork, StandInHost, stand_ins
from fame.testing.mission import MissionUnderTest
from fame.text import topic_of


class _RunByHand(Run):
    """A run without world, whose messages and timers are held."""

    hosts: Mapping[str, StandInHost]
    mail: HeldNetwork
    abstract: Abstraction

    def _build_nodes(self, strict: bool) -> list[RobotNode]:
        plan = self.scenario
        kinds = kinds_of(plan.cast, plan.variables)
        pools = list({pool.name: pool for pool in kinds.values()}.values())
        shared = shared_topics(plan.definitions, pools, plan.library)
        values = (value for one in plan.properties for value in subjects(one) if value.kind == "variable")
        read = frozenset(str(value.path[0]) for value in values)
        parameters = given_values(plan.variables.values())
        self.abstract = abstraction(
            plan.definitions, pools, plan.library, dict(shared), read=read, parameters=parameters,
            named=codes_named(plan.properties),
        )  # fmt: skip
        self.mail = self.middleware.network = HeldNetwork(self.scheduler, self.abstract.facts.shared)
        nodes = {robot: self._node(robot, shared, strict, compiled=False) for robot in plan.cast}
        for node in nodes.values():
            node.host.timers.hold()
        self.hosts = stand_ins(nodes, kinds, self.abstract)
        return list(nodes.values())


_LONGEST = 1e9
"""The end of a run by hand (s): its times mean nothing."""


class MissionByHand(MissionUnderTest):
    """A mission that runs step by step: ``mission.load("patrol.bpmn", by_hand=True)``.

    Each step takes a simulated second. A step that is not possible raises ExpectationError, which shows the state;
    `lenient`: it is left out.
    """

    def __init__(self, scenario: Scenario, folder: Path, *, lenient: bool = False) -> None:
        super().__init__(scenario, folder)
        self._lenient = lenient
        self._decisions: dict[tuple[str, str], list[int]] = {}
        self.skipped: list[str] = []

    def make_run(self, observer: Observer) -> Run:
        """Make the run: without world, faults, completions, and bounds: its times mean nothing."""
        nothing: dict[str, Any] = dict.fromkeys(("faults", "completions", "signals"), ())
        properties = tuple(one for one in self.scenario.properties if one.bound is None)
        plan = replace(self.scenario, world=None, network=None, properties=properties, duration=_LONGEST, **nothing)
        run = _RunByHand(plan, False, observer, None)
        for (robot, element), ways in self._decisions.items():
            run.hosts[robot].decided[element].extend(ways)
        return run

    @property
    def by_hand(self) -> _RunByHand:
        """The run."""
        run = self.run
        assert isinstance(run, _RunByHand)
        return run

    @property
    def is_complete(self) -> bool:
        """Whether the mission is over; until then a test could do something that is possible."""
        return self.run.over

    # ---- steps -------------------------------------------------------------------------------------------------------

    def finish(self, *where: str, raises: str | None = None) -> MissionByHand:
        """End a waiting behaviour, service or script, or let it raise an error: ``finish("REX", "Go To")``."""
        __tracebackhide__ = True
        robot, element = self._split(where)
        host = self._host(robot)
        found = host.under_way(self.elements.find(robot, element))
        if found:
            host.finish(found[0], raises)
        return self._done(robot, f"to be at {element!r}, so that it ends", bool(found))

    def block(self, *where: str) -> MissionByHand:
        """Let a waiting behaviour, service or script never end."""
        __tracebackhide__ = True
        robot, element = self._split(where)
        host = self._host(robot)
        found = host.under_way(self.elements.find(robot, element))
        if found:
            host.block(found[0])
        return self._done(robot, f"to be at {element!r}, so that it blocks", bool(found))

    def arrive(self, *where: str) -> MissionByHand:
        """Deliver the next message on a topic to a robot: ``arrive("DINGO", "/target_found")``."""
        __tracebackhide__ = True
        robot, topic = self._split(where)
        arrive = self.by_hand.mail.take(robot, topic_of(topic))
        if arrive is not None:
            arrive()
        return self._done(robot, f"a message on {topic_of(topic)} on its way to it", arrive is not None)

    def lose(self, *where: str) -> MissionByHand:
        """Lose the next message on a topic to a robot."""
        __tracebackhide__ = True
        robot, topic = self._split(where)
        lost = self.by_hand.mail.take(robot, topic_of(topic))
        return self._done(robot, f"a message on {topic_of(topic)} on its way to it", lost is not None)

    def fire(self, *where: str) -> MissionByHand:
        """Fire the timer of an event: ``fire("REX", "Timeout")``."""
        __tracebackhide__ = True
        robot, element = self._split(where)
        fired = self._fire(robot, self.elements.find(robot, element))
        return self._done(robot, f"a timer at {element!r}", fired)

    def activate(self, *where: str) -> MissionByHand:
        """Start an element of an open ad-hoc sub-process."""
        __tracebackhide__ = True
        robot, element = self._split(where)
        ids = self.elements.find(robot, element)
        offered = [id for id in self.node(robot).offers() if id in ids]
        if offered:
            self.node(robot).activate(offered[0])
        return self._done(robot, f"to offer {element!r}", bool(offered))

    def complete(self, *where: str, **values: Any) -> MissionByHand:
        """Complete a user, manual or receive task that waits, with results: ``complete("Sign", approved=True)``."""
        __tracebackhide__ = True
        robot, element = self._split(where)
        ids = self.elements.find(robot, element)
        waits = [wait.element for wait in self.node(robot).waiting_tokens() if wait.element in ids]
        if waits:
            self._fill_in(robot, waits[0], values)
        return self._done(robot, f"to wait at {element!r} for a person", bool(waits))

    def decide(self, robot: str, element: str, *ways: bool | int) -> MissionByHand:
        """Say what is decided at an element about something unknown, for the next times: True, False, or a number.

        What is not said is decided in turn.
        """
        name, numbers = self.robot(robot), [int(not way) if isinstance(way, bool) else way for way in ways]
        for id in self.elements.find(name, element):
            if self.begun:
                self._host(name).decided[id].extend(numbers)
            else:
                self._decisions.setdefault((name, id), []).extend(numbers)
        return self

    def go_on(self, condition: Callable[[], object], within: float) -> bool:
        """Let everything that is left go on until a condition holds; whether it holds.

        Again and again, each time in a second: messages arrive, steps end, people do their tasks, and if nothing of
        this is left, the next timer of each robot fires.
        """
        end = self.by_hand.scheduler.now + round(within * SECOND)
        while not condition() and self.by_hand.scheduler.now < end and self._go_on_once():
            pass
        return bool(condition())

    # ---- how ---------------------------------------------------------------------------------------------------------

    def _publish(self, robot: str, topic: str, payload: Any) -> None:
        if payload is not None or not robot:
            super()._publish(robot, topic, payload)
        else:
            self._host(robot).from_outside(topic)

    def _host(self, robot: str) -> StandInHost:
        return self.by_hand.hosts[robot]

    def _fill_in(self, robot: str, element: str, values: Mapping[str, Any]) -> None:
        """Complete a task; what a person is asked for there and has not said is unknown."""
        asked = self.by_hand.abstract.given.get(element, set())
        self.node(robot).complete(element, dict.fromkeys(asked, self._host(robot).values.unknown) | {**values})

    def _done(self, robot: str, expected: str, possible: bool) -> MissionByHand:
        """Note that a step has ended, or was not possible."""
        __tracebackhide__ = True
        if not possible:
            text = f"{robot}: expected {expected}"
            if not self._lenient:
                raise failure(self, text)
            self.skipped.append(text)
        self.pass_time()
        return self

    def pass_time(self) -> None:
        """Let the step take effect, and one second pass."""
        for node in self.run.nodes:
            node.runner.poll()
        self.settle()
        self.advance(1)

    def _fire(self, robot: str, elements: frozenset[str] | None = None) -> bool:
        """Let the timer of one of some elements fire, by default the one that is due first."""
        timers = self.node(robot).host.timers
        due = {
            key: time
            for key, node in stimuli(self.node(robot).engine).timers.items()
            if (elements is None or node.id in elements) and (time := timers.due(key)) is not None
        }
        if due:
            timers.fire(min(due, key=due.__getitem__))
        return bool(due)

    def _go_on_once(self) -> bool:
        """Let everything continue once. Returns whether something happened."""
        run, moved = self.by_hand, False
        while run.mail.mail:
            _, _, _, arrive = run.mail.mail.pop(0)
            arrive()
            self.settle()
            moved = True
        robots = [robot for robot in self.robots if robot not in run.dead]
        for robot in robots:
            moved |= self._go_on_alone(robot)
        if not moved:
            moved = sum(map(self._fire, robots)) > 0
        self.pass_time()
        return moved and not run.over

    def _go_on_alone(self, robot: str) -> bool:
        """Let the steps, people and surroundings of a robot go on once."""
        host, engine = self._host(robot), self.node(robot).engine
        found, moved = stimuli(engine), False
        for wait in found.scripts.values():
            if wait.alive and wait.started:
                host.finish(wait, None)
                moved = True
        for wait in found.people:
            try:
                self._fill_in(robot, wait.node.id, {})
                moved = True
            except FameError:  # it has ended meanwhile
                continue
        for topic in sorted(found.topics & self.by_hand.abstract.facts.outside):
            host.from_outside(topic)
            moved = True
        self.settle()
        return moved
