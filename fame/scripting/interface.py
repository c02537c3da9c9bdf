"""The script interface: the names that scripts find besides their variables, in their ``__builtins__``.

A name is looked up in the variables first, so a variable named `robot` hides the interface. Each process instance has
its own dict, so that its scripts cannot reach those of another instance.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Mapping
from datetime import datetime
from random import Random
from typing import Any

from fame.clock import EPOCH, SECOND, date_at
from fame.dataclasses import dataclass, field
from fame.engine.host import BpmnError
from fame.middleware.interface import AnyMessage
from fame.scripting.budget import DEFAULT, Budget
from fame.scripting.requests import Act, Call, Inbox, MessageQueue, Receive, Sleep, Until, check_seconds, check_topic

NAMES = ("robot", "signal", "BpmnError", "log", "print", "math", "sleep", "receive", "until")
"""The names of the interface. A variable of such a name hides it."""

_ABSENT = {"input", "breakpoint", "help", "exit", "quit", "copyright", "credits", "license"}
"""Builtins of a terminal, which a robot does not have."""

ALWAYS = {
    **{name: value for name, value in vars(builtins).items() if name not in _ABSENT},
    **{"BpmnError": BpmnError, "math": math, "sleep": Sleep, "receive": Receive, "until": Until},
}
"""The names that are the same for all."""

Publish = Callable[[str, str, Any], object]
Emit = Callable[[str, str], object]


@dataclass(frozen=True, slots=True)
class Robot:
    """The robot that runs the script. `namespace` has no slashes; topic names are relative to it.

    `_publish` takes topic, type and a mapping of fields (or a message) and may raise MessageError; `_clock` returns the
    time of the mission (s), `_epoch` is the date of its time 0. `random` are the robot's own
    random numbers: the same in runs with the same seed.
    """

    name: str
    namespace: str
    _publish: Publish = field(repr=False)
    _inbox: Inbox = field(repr=False)
    _clock: Callable[[], float] = field(repr=False)
    _epoch: datetime = field(default=EPOCH, repr=False)
    random: Random = field(default_factory=Random, repr=False)

    @property
    def now(self) -> float:
        """The time of the mission (s), which `sleep` and timers use: simulated or wall-clock time."""
        return self._clock()

    @property
    def date(self) -> datetime:
        """The date and time of the mission (UTC): its epoch (1970 unless the scenario sets another) plus `now`."""
        return date_at(self._epoch, round(self._clock() * SECOND))

    def publish(
        self, topic: str, type: str, message: AnyMessage | Mapping[str, Any] | None = None, /, **fields: Any
    ) -> None:
        """Send a message: ``robot.publish("cmd_vel", "geometry_msgs/msg/Twist", linear={"x": 0.5})``.

        Raises MessageError if a field or value does not fit the type.
        """
        check_topic("robot.publish", topic)
        if message is not None and fields:
            raise TypeError("robot.publish: either a whole message or fields by name, not both")
        self._publish(topic, type, fields if message is None else message)

    def subscribe(self, topic: str, type: str | None = None, queue: int = 10) -> MessageQueue:
        """``async for message in robot.subscribe("odom")``: all messages from now on; up to `queue` are buffered."""
        check_topic("robot.subscribe", topic)
        return self._inbox.queue(topic, type, queue)

    def latest(self, topic: str, type: str | None = None) -> AnyMessage | None:
        """Return the latest message on a topic, None if there has been none."""
        check_topic("robot.latest", topic)
        return self._inbox.latest(topic, type)

    def transform(self, target: str, source: str, at: AnyMessage | None = None) -> AnyMessage | None:
        """Return the pose of frame `source` in frame `target`, None if ``/tf`` and ``/tf_static`` have not told it.

        It is a geometry_msgs/msg/TransformStamped: the latest, or that `at` a stamp of the last 10 s.
        """
        for frame in (target, source):
            if not isinstance(frame, str) or not frame:
                raise TypeError(f"robot.transform: {frame!r} is not the name of a frame")
        return self._inbox.transform(target, source, at)

    def call(self, service: str, type: str, /, **fields: Any) -> Call:
        """``response = await robot.call("tello_action", "tello_msgs/srv/TelloAction", cmd="takeoff")``."""
        check_topic("robot.call", service)
        return Call(service, type, fields)

    def act(
        self,
        action: str,
        type: str,
        /,
        on_feedback: Callable[[AnyMessage], object] | None = None,
        *,
        wait_cancelled: float = 0.0,
        **fields: Any,
    ) -> Act:
        """``result = await robot.act("navigate_to_pose", "nav2_msgs/action/NavigateToPose", pose={...})``.

        `wait_cancelled` is for how long it waits until cancelled goals of the action have ended (s), before BpmnError
        ``still_running``.
        """
        check_topic("robot.act", action)
        check_seconds("robot.act: wait_cancelled", wait_cancelled)
        return Act(action, type, fields, on_feedback, wait_cancelled or 0.0)


def mission_date(variables: Mapping[str, Any]) -> datetime | None:
    """Return the date and time (UTC) of the mission that has these variables, None outside of a mission."""
    robot = _robot(variables)
    return None if robot is None else robot.date


def random_source(variables: Mapping[str, Any]) -> Random | None:
    """Return the random numbers of the robot that has these variables, None outside of a mission."""
    robot = _robot(variables)
    return None if robot is None else robot.random


def _robot(variables: Mapping[str, Any]) -> Robot | None:
    builtins = variables.get("__builtins__")
    robot = builtins.get("robot") if isinstance(builtins, dict) else None
    return robot if isinstance(robot, Robot) else None


class Log:
    """``log("text", x)`` and, by level, ``log.debug``, ``log.info``, ``log.warning``, ``log.error``."""

    __slots__ = ("_emit",)

    def __init__(self, emit: Emit) -> None:
        self._emit = emit

    def __call__(self, *values: Any) -> None:
        self._emit("info", _joined(values))

    info = __call__

    def debug(self, *values: Any) -> None:
        self._emit("debug", _joined(values))

    def warning(self, *values: Any) -> None:
        self._emit("warning", _joined(values))

    def error(self, *values: Any) -> None:
        self._emit("error", _joined(values))


def interface(
    *, robot: Robot | None, signal: Callable[..., object], log: Emit, budget: int = DEFAULT
) -> dict[str, Any]:
    """Return a new ``__builtins__`` for the variables of one process instance.

    `signal(name, payload=None)` throws a signal; `log(level, text)` writes a line of log, as ``print`` in
    a script does. `budget` limits the loop iterations and function calls of one step.
    """
    logger = Log(log)

    def print_to_log(
        *values: Any, sep: str | None = " ", end: str | None = "\n", file: Any = None, flush: bool = False
    ) -> None:
        if file is not None:
            print(*values, sep=sep, end=end, file=file, flush=flush)
        else:
            log("info", f"{_joined(values, ' ' if sep is None else sep)}{end or ''}".removesuffix("\n"))

    names = ALWAYS | {"robot": robot, "signal": signal, "log": logger, "print": print_to_log}
    Budget(names, budget)
    return names


def another(names: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of the interface for another process instance, with its own budget."""
    copy = names.copy()
    Budget(copy, DEFAULT)
    return copy


def _joined(values: tuple[Any, ...], separator: str = " ") -> str:
    return separator.join(map(str, values))
