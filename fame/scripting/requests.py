"""Awaitable requests of scripts.

`sleep(2)` does nothing by itself. ``await`` yields the request to the runner (`fame.scripting.runner`), which sends
the result or throws the error. There is no event loop, and nothing else can be awaited.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any


class Request:
    """Base class of everything that a script can await."""

    __slots__ = ()

    def __await__(self) -> Generator[Request, Any, Any]:
        return (yield self)


@dataclass(frozen=True, slots=True)
class Sleep(Request):
    """``await sleep(2)``: continue after this time on the engine's clock (s)."""

    seconds: float

    def __post_init__(self) -> None:
        check_seconds("sleep", self.seconds)

    def __str__(self) -> str:
        return f"sleep({self.seconds:g})"


@dataclass(frozen=True, slots=True)
class Receive(Request):
    """``await receive("odom", timeout=1)``: the next message that arrives on a topic; TimeoutError after `timeout` s.

    `type` is ``pkg/msg/Type``; it may be omitted if a publisher or the model declares it.
    """

    topic: str
    type: str | None = None
    timeout: float | None = None

    def __post_init__(self) -> None:
        check_topic("receive", self.topic)
        check_seconds("receive: timeout", self.timeout)

    def __str__(self) -> str:
        return f"receive({self.topic!r})"


@dataclass(frozen=True, slots=True)
class Until(Request):
    """``await until(lambda: battery < 20)``: continue when the condition is true; TimeoutError after `timeout` s.

    The condition is evaluated at once, then after every step of a script or of the engine and after every message of
    this robot: whatever can change a variable. For a condition that depends on time alone, use `sleep`.
    """

    condition: Callable[[], Any]
    timeout: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.condition):
            raise TypeError("until: expected a function that is called repeatedly, as in until(lambda: x > 3)")
        check_seconds("until: timeout", self.timeout)

    def __str__(self) -> str:
        return "until(...)"


@dataclass(frozen=True, slots=True)
class Next(Request):
    """The next message of a subscription: what ``async for`` awaits."""

    queue: MessageQueue

    def __str__(self) -> str:
        return str(self.queue)


@dataclass(frozen=True, slots=True)
class Call(Request):
    """``await robot.call("spawn", "pkg/srv/Spawn", x=1.0)``: the response of a service."""

    service: str
    type: str
    fields: Mapping[str, Any] | None

    def __str__(self) -> str:
        return f"call({self.service!r})"


@dataclass(frozen=True, slots=True)
class Act(Request):
    """``await robot.act("navigate_to_pose", "nav2_msgs/action/NavigateToPose", pose=...)``: the result of an action.

    `feedback` is called with the feedback of the action. BpmnError ``rejected``, ``aborted`` or ``canceled`` if it does
    not succeed. Cancelling the script cancels the goal.
    """

    action: str
    type: str
    fields: Mapping[str, Any] | None
    feedback: Callable[[Any], object] | None = None

    def __str__(self) -> str:
        return f"act({self.action!r})"


class MessageQueue:
    """``async for message in robot.subscribe("odom")``: the last `depth` messages not yet taken, oldest first."""

    __slots__ = ("__weakref__", "messages", "topic", "waiting")

    def __init__(self, topic: str, depth: int) -> None:
        if not isinstance(depth, int) or depth < 1:
            raise ValueError(f"subscribe: queue={depth!r}: expected a number of messages to keep, at least 1")
        self.topic: str = topic
        self.messages: deque[Any] = deque(maxlen=depth)
        self.waiting: dict[Callable[[], object], None] = {}

    def __str__(self) -> str:
        return f"next message of {self.topic}"

    def put(self, message: Any) -> None:
        """Add a message and wake all scripts that wait for one."""
        self.messages.append(message)
        for wake in tuple(self.waiting):
            wake()

    def __aiter__(self) -> MessageQueue:
        return self

    def __anext__(self) -> Next:
        return Next(self)


def check_seconds(what: str, seconds: Any) -> None:
    """Raises TypeError or ValueError unless it is None or a finite number of seconds, not negative."""
    if seconds is None and what != "sleep":
        return
    try:
        wrong = not math.isfinite(seconds) or seconds < 0
    except TypeError:
        raise TypeError(f"{what}: {seconds!r} is not a number of seconds") from None
    if wrong:
        raise ValueError(f"{what}: {seconds!r} s: expected a finite number, 0 or more")


def check_topic(what: str, topic: Any) -> None:
    """Raises TypeError unless it is the name of a topic."""
    if not isinstance(topic, str) or not topic:
        raise TypeError(f"{what}: {topic!r} is not the name of a topic")
