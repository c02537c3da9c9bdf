"""How wrong the clocks of robots may be: questions on ``/<robot>/bpmn_clock``, which engines answer with their time.

An engine's time, between a question and its answer, is known to half of what passed in between. The doubt of its clock
is how far it may be from that of who asks, at the quickest answer so far.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count

from fame.clock import SECOND, Entry, Scheduler
from fame.closing import Closing
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.log.live_team import STRING, LiveTeam
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node, Publisher
from fame.robot.live import CLOCK_TOPIC
from fame.text import read_json

_SOON, _PERIOD = SECOND // 4, 2 * SECOND
"""Interval of questions before and after the first answer of every robot (ns)."""


class ClockDoubts(Closing):
    """Measures the clocks of a team. `now` is the time of the mission (ns since the epoch of `team`).

    `put` gets the name of a robot and its doubt (ns), at first and whenever that is less.
    """

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        team: LiveTeam,
        now: Callable[[], int],
        put: Callable[[str, int], object],
    ) -> None:
        self._node, self._scheduler, self._team, self._now, self._put = node, scheduler, team, now, put
        self._ends: dict[str, Publisher] = {}
        self._asked: dict[str, tuple[str, int]] = {}  # robot -> number of the question, and when it was asked
        self._best: dict[str, int] = {}  # the shortest round trip (ns)
        self._numbers = count()
        self._next: Entry = scheduler.after(_SOON, self._ask)

    def _ask(self) -> None:
        for robot in self._team.robots if self._team.epoch is not None else ():
            if robot not in self._ends:
                topic = f"/{robot}/{CLOCK_TOPIC}"
                self._ends[robot] = self._node.publisher(topic, STRING)
                self._node.subscription(topic, STRING, partial(self._on_answer, robot))
                continue  # until it is matched
            self._asked[robot] = f"{id(self):x}-{next(self._numbers)}", self._now()
            self._ends[robot].publish(messages.create(STRING, json.dumps({"ask": self._asked[robot][0]})))
        self._next = self._scheduler.after(_SOON if self._ends.keys() - self._best.keys() else _PERIOD, self._ask)

    def _on_answer(self, robot: str, message: AnyMessage) -> None:
        with suppress(ValueError, TypeError, LookupError, AttributeError):  # from a stranger
            answer = read_json(message.data, 1000)
            number, asked = self._asked.get(robot, ("", 0))
            if answer.get("answer") != number:
                return
            trip = max(0, self._now() - asked)
            time = int(answer["time"]) + nanoseconds_between(self._team.epoch, parse_datetime(answer["epoch"]))  # type: ignore[arg-type]
            if trip < self._best.get(robot, trip + 1):
                self._best[robot] = trip
                self._put(robot, abs(time - asked - trip // 2) + trip // 2)

    def close(self) -> None:
        """Ask no more."""
        self._next.cancel()
