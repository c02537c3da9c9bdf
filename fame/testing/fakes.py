"""Fakes for a mission under test: topics, services, actions and people, all in simulated time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fame.clock import SECOND
from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from fame.middleware.actions import CANCEL, FEEDBACK
from fame.middleware.interface import SIGNAL, AnyMessage, DeferredResponse, Node, QoS
from fame.middleware.local import LocalClient, LocalNode
from fame.testing.series import read_recorded, read_series
from fame.testing.trace import TraceStep
from fame.text import ros_name, suggestion

if TYPE_CHECKING:
    from fame.testing.mission import MissionUnderTest

_Fake = TypeVar("_Fake", "FakeTopic", "FakeService", "FakeAction")

_SUCCEEDED, _CANCELLED, _ABORTED = 4, 5, 6
"""The status of a goal that has ended (action_msgs/msg/GoalStatus)."""


class Fakes:
    """The fakes of one mission. Those made before the mission begins exist from its beginning."""

    def __init__(self, mission: MissionUnderTest) -> None:
        self._mission = mission
        self._waiting: list[FakeTopic | FakeService | FakeAction] = []
        self._all: list[FakeTopic | FakeService | FakeAction | _Person] = []

    def topic(self, topic: str, type: str, **given: Any) -> FakeTopic:
        return self._made(FakeTopic(self._mission, _full(topic), type, **given))

    def service(self, name: str, type: str, **given: Any) -> FakeService:
        return self._made(FakeService(self._mission, _full(name), type, **given))

    def action(self, name: str, type: str, **given: Any) -> FakeAction:
        return self._made(FakeAction(self._mission, _full(name), type, **given))

    def person(self, robot: str, tasks: Mapping[str, Mapping[str, Any] | None], after: float) -> None:
        found = {
            id: dict(values or {}) for task, values in tasks.items() for id in self._mission.elements.find(robot, task)
        }
        person = _Person(self._mission, robot, found, after)
        self._mission.trace.listeners.append(person.on_step)
        self._all.append(person)

    def begin(self) -> None:
        """Make the endpoints."""
        for fake in self._waiting:
            fake.begin(self._mission.outside)

    def unused(self) -> list[str]:
        """Return those that the mission has not used so far, each as the call that made it."""
        return [str(fake) for fake in self._all if not fake.used]

    def _made(self, fake: _Fake) -> _Fake:
        self._all.append(fake)
        if self._mission.begun:
            fake.begin(self._mission.outside)
        else:
            self._waiting.append(fake)
        return fake


def _full(name: str) -> str:
    return f"/{ros_name(name).removeprefix('/')}"


class FakeTopic:
    """A fake publisher. The type may be omitted if the mission uses the topic.

    values, every  messages from time 0 on, one each `every` simulated s (the last one is not repeated)
    series         (simulated s, message) pairs, or a mapping
    csv            a file with a column ``stamp`` (s) and one for each field (``pose.x``)
    bag            a bag of ROS (from its first message on), or a recording of FAME (from the start of its run)
    """

    def __init__(
        self,
        mission: MissionUnderTest,
        topic: str,
        type: str,
        *,
        values: Sequence[Any] | None = None,
        every: float = 0.1,
        series: Mapping[float, Any] | Iterable[tuple[float, Any]] | None = None,
        csv: str | Path | None = None,
        bag: str | Path | None = None,
        qos: QoS = SIGNAL,
    ) -> None:
        self.topic: str = topic
        self._mission, self._type, self._qos = mission, type, qos
        if sum(given is not None for given in (values, series, csv, bag)) > 1:
            raise ConfigError(f"fake_topic({topic!r}): expected one of values, series, csv, bag")
        if not every > 0:
            raise ConfigError(f"fake_topic({topic!r}): every: expected a number above 0, got {every!r}")
        self._series: list[tuple[float, Any]] = [(number * every, value) for number, value in enumerate(values or ())]
        if series is not None:
            self._series = list(series.items() if isinstance(series, Mapping) else series)
            if not all(isinstance(pair, tuple) and len(pair) == 2 for pair in self._series):
                raise ConfigError(f"fake_topic({topic!r}): series: expected (seconds, message) pairs, got {series!r}")
        elif csv is not None:
            self._series = read_series(Path(csv))
        for time, _ in self._series:
            if not (isinstance(time, int | float) and 0 <= time < math.inf):
                raise ConfigError(f"fake_topic({topic!r}): expected times from 0 s on, got {time!r}")
        self._bag = bag
        self._sent = self._heard = False

    def __str__(self) -> str:
        return f"fake_topic({self.topic!r})"

    @property
    def used(self) -> bool:
        """Whether it has published something to which somebody subscribed, then or now."""
        return self._heard or (self._sent and self._publisher.subscriber_count() > 0)

    def begin(self, node: Node) -> None:
        """Make the publisher, and schedule what is to be published."""
        type = self._type or self._known_type()
        self._publisher = node.publisher(self.topic, type, self._qos)
        if self._bag is not None:
            self._series = read_recorded(Path(self._bag), self.topic, type)
        made: list[tuple[float, AnyMessage]] = []
        former: Any = self  # no value
        for time, value in self._series:
            if value is not former:  # ``values=[place] * 1000`` is one message
                former, message = value, messages.create(self._publisher.type, value)
            made.append((time, message))
        scheduler = self._mission.run.scheduler
        for time, message in made:
            scheduler.after(round(time * SECOND), partial(self._publish, message))

    def publish(self, value: Any = None, **fields: Any) -> None:
        """Publish a message now: a payload, or fields. Raises MessageError if it does not fit."""
        self._mission.settle()
        if not self._mission.begun:
            raise ConfigError(f"fake_topic({self.topic!r}): publish before the mission begins: give values or series")
        self._publish(messages.create(self._publisher.type, fields or value))
        self._mission.settle()

    def _publish(self, message: AnyMessage) -> None:
        self._publisher.publish(message)
        self._sent = True
        self._heard = self._heard or self._publisher.subscriber_count() > 0

    def _known_type(self) -> str:
        topics = self._mission.run.middleware.topics
        if self.topic not in topics:
            text = f"no process uses the topic {self.topic}; {suggestion(self.topic, sorted(topics))}"
            raise ConfigError(f"{text}, or give its type")
        return topics[self.topic].type


class FakeService:
    """A fake service: `response` is a message, a mapping, or a function of the request; `after` in s.

    With `fail` it takes requests and never answers. `requests` has what was requested.
    """

    name: str

    def __init__(
        self,
        mission: MissionUnderTest,
        name: str,
        type: str,
        *,
        response: Any = None,
        after: float = 0.0,
        fail: bool = False,
    ) -> None:
        self.name = name
        self.requests: list[AnyMessage] = []
        self._mission, self._type, self._response, self._after, self._fail = mission, type, response, after, fail
        _, answer = messages.service(type)
        if not callable(response):
            messages.create(answer, response)  # refused now, not when it is called

    def __str__(self) -> str:
        return f"fake_service({self.name!r})"

    @property
    def used(self) -> bool:
        """Whether something was requested."""
        return bool(self.requests)

    def begin(self, node: Node) -> None:
        """Offer the service. Raises ConfigError if the mission calls one of this name with another type."""
        _expect_called_type(self._mission, self.name, self._type)
        node.service(self.name, self._type, self._handle)

    def _handle(self, request: AnyMessage) -> Any:
        self.requests.append(request)
        later = DeferredResponse()
        if not self._fail:
            value = self._response(request) if callable(self._response) else self._response
            self._mission.run.scheduler.after(round(self._after * SECOND), partial(later.respond, value))
        return later


class FakeAction:
    """A fake action server. A goal ends `after` simulated s.

    feedback  messages, evenly spread over that time
    result    a message, a mapping, or a function of the goal
    fail      ``"rejected"``, ``"aborted"`` (also True), or False

    `goals` has the goals that came, `cancelled` how many were cancelled.
    """

    name: str

    def __init__(
        self,
        mission: MissionUnderTest,
        name: str,
        type: str,
        *,
        after: float = 0.0,
        feedback: Sequence[Any] = (),
        result: Any = None,
        fail: bool | str = False,
    ) -> None:
        if fail not in (False, True, "aborted", "rejected"):
            raise ConfigError(f"fake_action({name!r}): fail: expected aborted or rejected, got {fail!r}")
        self.name = name
        self.goals: list[AnyMessage] = []
        self.cancelled: int = 0
        self._mission, self._type, self._after = mission, messages.action(type), after
        self._feedback, self._result, self._fail = feedback, result, fail
        for part, value in (("Result", result), *(("Feedback", one) for one in feedback)):
            if not callable(value):
                messages.create(f"{self._type}_{part}", value)  # refused now, not when a goal has come
        self._results: dict[bytes, DeferredResponse] = {}
        self._ended: set[bytes] = set()

    def __str__(self) -> str:
        return f"fake_action({self.name!r})"

    @property
    def used(self) -> bool:
        """Whether a goal has come."""
        return bool(self.goals)

    def begin(self, node: Node) -> None:
        """Offer the action."""
        below, type = f"{self.name}/_action", self._type
        self._publisher = node.publisher(f"{below}/feedback", f"{type}_FeedbackMessage", FEEDBACK)
        node.service(f"{below}/send_goal", f"{type}_SendGoal", self._on_goal)
        node.service(f"{below}/get_result", f"{type}_GetResult", lambda request: self._later(request.goal_id))
        node.service(f"{below}/cancel_goal", CANCEL, self._on_cancel)

    def _on_goal(self, request: AnyMessage) -> Any:
        self.goals.append(request.goal)
        if self._fail == "rejected":
            return None
        id, scheduler = bytes(request.goal_id.uuid), self._mission.run.scheduler
        for number, value in enumerate(self._feedback):
            time = self._after * (number + 1) / (len(self._feedback) + 1)
            scheduler.after(round(time * SECOND), partial(self._give_feedback, id, value))
        result = self._result(request.goal) if callable(self._result) else self._result
        status = _ABORTED if self._fail else _SUCCEEDED
        scheduler.after(round(self._after * SECOND), partial(self._end, id, status, result))
        return {"accepted": True}

    def _give_feedback(self, id: bytes, value: Any) -> None:
        if id not in self._ended:
            fields = {"goal_id": {"uuid": id}, "feedback": value}
            self._publisher.publish(messages.create(f"{self._type}_FeedbackMessage", fields))

    def _end(self, id: bytes, status: int, result: Any) -> None:
        if id not in self._ended:
            self._ended.add(id)
            later = self._results.setdefault(id, DeferredResponse())
            later.respond({"status": status, "result": result} if result is not None else {"status": status})

    def _on_cancel(self, request: AnyMessage) -> Any:
        id = bytes(request.goal_info.goal_id.uuid)
        self.cancelled += 1
        self._end(id, _CANCELLED, None)
        return {"goals_canceling": [{"goal_id": {"uuid": id}}]}

    def _later(self, goal_id: AnyMessage) -> DeferredResponse:
        return self._results.setdefault(bytes(goal_id.uuid), DeferredResponse())


def _expect_called_type(mission: MissionUnderTest, name: str, type: str) -> None:
    """Raise ConfigError if a robot has a client of this service with another type."""
    for robot in mission.run.nodes:
        ends = robot.node.endpoints if isinstance(robot.node, LocalNode) else ()
        for end in ends:
            if isinstance(end, LocalClient) and end.name == name and end.type != type:
                raise ConfigError(f"fake_service({name!r}): {robot.name} calls it as {end.type}, got {type}")


class _Person:
    """Completes tasks of a robot, some time after a token has come there."""

    def __init__(
        self, mission: MissionUnderTest, robot: str, tasks: Mapping[str, Mapping[str, Any]], after: float
    ) -> None:
        self._mission, self._robot, self._tasks, self._after = mission, robot, tasks, after
        self.used = False  # whether a token has come to one of the tasks

    def __str__(self) -> str:
        names = " or ".join(self._mission.elements.shown(self._robot, task) for task in self._tasks)
        return f"person of {self._robot} at {names}"

    def on_step(self, step: TraceStep) -> None:
        """Plan to complete the task that a token has entered."""
        if step.what == "enter" and step.robot == self._robot and step.element in self._tasks:
            self.used = True
            self._mission.run.scheduler.after(round(self._after * SECOND), partial(self._complete, step.element))

    def _complete(self, element: str) -> None:
        with suppress(MissionError):  # the token has left meanwhile
            self._mission.node(self._robot).complete(element, self._tasks[element])
