"""Questions on ``/<robot>/bpmn_clock``, which engines answer with their time: how far their clocks are from one's own.

An engine's time, between a question and its answer, is known to half of what passed in between. The doubt of its clock
is how far it may be from that of who asks, at the quickest answer so far.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from functools import partial
from itertools import count
from typing import Any, NamedTuple

from fame.clock import SECOND, Entry, Scheduler
from fame.closing import Closing
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.log.live_team import LiveTeam
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node, Publisher
from fame.robot.clock_server import CLOCK_TOPIC, STRING
from fame.text import read_json

_SOON, _PERIOD = SECOND // 4, 2 * SECOND
"""Interval of questions before and after the first answer of every robot (ns)."""
DAY = 86_400 * SECOND
"""A clock that is as far ahead or behind has another date: `fame run` in processes begins in 1970 (ns)."""


class ClockAnswer(NamedTuple):
    """What an answer says. `trip`: from the question to it (ns); `ahead`: of one's own clock, in the middle of the trip
    (ns); `answer`: as it came."""

    trip: int
    ahead: int
    answer: Mapping[str, Any]


class ClockQuestions(Closing):
    """Asks the `robots` for their time. `now` is one's own (ns since the date that `epoch` gives; None: not yet known).

    `on_answer` gets the name of a robot and each of its answers.
    """

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        robots: Callable[[], Iterable[str]],
        now: Callable[[], int],
        epoch: Callable[[], datetime | None],
        on_answer: Callable[[str, ClockAnswer], object],
    ) -> None:
        self._node, self._scheduler, self._robots, self._on_answer = node, scheduler, robots, on_answer
        self._now, self._epoch = now, epoch
        self._ends: dict[str, Publisher] = {}
        self._asked: dict[str, tuple[str, int]] = {}  # robot -> number of the question, and when it was asked
        self._answered: set[str] = set()
        self._numbers = count()
        self._next: Entry = scheduler.after(_SOON, self._ask)

    def _ask(self) -> None:
        for robot in self._robots() if self._epoch() is not None else ():
            if robot not in self._ends:
                topic = f"/{robot}/{CLOCK_TOPIC}"
                self._ends[robot] = self._node.publisher(topic, STRING)
                self._node.subscription(topic, STRING, partial(self._on_message, robot))
                continue  # until it is matched
            self._asked[robot] = f"{id(self):x}-{next(self._numbers)}", self._now()
            self._ends[robot].publish(messages.create(STRING, json.dumps({"ask": self._asked[robot][0]})))
        self._next = self._scheduler.after(_SOON if self._ends.keys() - self._answered else _PERIOD, self._ask)

    def _on_message(self, robot: str, message: AnyMessage) -> None:
        with suppress(ValueError, TypeError, LookupError, AttributeError):  # from a stranger
            answer = read_json(message.data, 1000)
            number, asked = self._asked.get(robot, ("", 0))
            if answer.get("answer") != number:
                return
            trip = max(0, self._now() - asked)
            time = int(answer["time"]) + nanoseconds_between(self._epoch(), parse_datetime(answer["epoch"]))  # type: ignore[arg-type]
            self._answered.add(robot)
            self._on_answer(robot, ClockAnswer(trip, time - asked - trip // 2, answer))

    def forget(self) -> None:
        """Take no answer to what was asked until now."""
        self._asked.clear()

    def close(self) -> None:
        """Ask no more."""
        self._next.cancel()


class ClockDoubts(Closing):
    """Measures the clocks of a team. `now` is the time of the mission (ns since the epoch of `team`).

    `put` gets the name of a robot and its doubt (ns), at first and whenever that is less. `ahead` (ns): of `now`, the
    first clock that answered, if it has another date; doubts count from it then.
    """

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        team: LiveTeam,
        now: Callable[[], int],
        put: Callable[[str, int], object],
    ) -> None:
        self._put = put
        self._best: dict[str, int] = {}  # the shortest round trip (ns)
        self.ahead: int | None = None
        self._questions = ClockQuestions(node, scheduler, lambda: team.robots, now, lambda: team.epoch, self._on_answer)

    def _on_answer(self, robot: str, answer: ClockAnswer) -> None:
        if self.ahead is None:
            self.ahead = answer.ahead if abs(answer.ahead) > DAY else 0
        if answer.trip < self._best.get(robot, answer.trip + 1):
            self._best[robot] = answer.trip
            self._put(robot, abs(answer.ahead - self.ahead) + answer.trip // 2)

    def restart(self) -> None:
        """Measure anew: `now` goes by another clock."""
        self.ahead = None
        self._best.clear()
        self._questions.forget()

    def close(self) -> None:
        """Ask no more."""
        self._questions.close()
