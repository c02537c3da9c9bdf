"""The state of a team at one time of its recording, and the messages that give it.

A state is read from a key message, and changed by every later message of ``/fame/events``, ``/fame/variables`` and
``/fame/waiting``, in order. Seeking and playing give the same state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from fame.clock import SECOND
from fame.dataclasses import dataclass, field
from fame.log.channels import KEY, PROPERTIES, WAITING
from fame.robot.robot_state import RobotState

Put = Callable[[str, int, Mapping[str, Any]], object]
"""Takes the topic of a channel, a time (ns) and the content of a message."""


@dataclass(slots=True)
class TeamState:
    """The state of a team at `time` (ns), by robot."""

    time: int = 0
    robots: dict[str, RobotState] = field(default_factory=dict)

    @property
    def runs(self) -> bool:
        """Return whether an instance of a robot runs."""
        return any(status == "running" for one in self.robots.values() for _, status in one.instances.values())

    @classmethod
    def from_key(cls, time: int, data: Mapping[str, Any]) -> TeamState:
        """Return the state that a key message holds."""
        return cls(time, {name: RobotState.from_key(robot, time) for name, robot in data["robots"].items()})

    def apply(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        """Change it by the next message."""
        self.time = time
        if "robot" in data:
            self.robots.setdefault(data["robot"], RobotState()).apply(topic, data, time)


class KeyWriter:
    """Passes changes of a team on to `put`, and before the first one of each second the state until then: a key.

    state  of the team, up to the last change
    last   the time of the last message (ns); -1 before the first
    """

    def __init__(self, put: Put) -> None:
        self._put = put
        self.state: TeamState = TeamState()
        self.last: int = -1
        self._key_due = 0

    def change(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        """Pass on a message of a time (ns)."""
        if time > self.last and time >= self._key_due:
            self.key(time)
        self.state.apply(time, topic, data)
        self._put(topic, time, data)
        self.last = time

    def key(self, time: int, gaps: Mapping[str, int] | None = None) -> None:
        """Pass on a key. `gaps`: the robots that a replay continues from here, and how much was lost.

        They come first, where a reader sees them at once.
        """
        self.state.time = time
        robots = {name: robot.to_key() for name, robot in self.state.robots.items()}
        self._put(KEY, time, {"robots": robots} if gaps is None else {"gaps": gaps, "robots": robots})
        self.last, self._key_due = time, time + SECOND


def shift_times(topic: str, data: Mapping[str, Any], by: int) -> Mapping[str, Any]:
    """Return a message of FAME's own channels with the times that it contains on a clock `by` ns ahead."""
    if not by or topic not in (WAITING, KEY, PROPERTIES):
        return data
    if topic == PROPERTIES:
        return {**data, **{name: data[name] + by / SECOND for name in ("time", "began") if data[name] is not None}}
    if topic == WAITING:
        return {**data, "tokens": _shift_tokens(data["tokens"], by)}
    shifted = {
        name: {**robot, **{part: _shift_tokens(robot[part], by) for part in ("tokens", "active")}}
        for name, robot in data["robots"].items()
    }
    return {**data, "robots": shifted}


_TIMES = ("since", "gone", "silent")
"""What a token has of times, besides that of its last message."""


def _shift_tokens(tokens: Iterable[Mapping[str, Any]], by: int) -> list[dict[str, Any]]:
    shifted = [{**token, **{name: token[name] + by for name in _TIMES if name in token}} for token in tokens]
    for token in shifted:
        if "missed" in token:
            token["missed"] = {**token["missed"], "time": token["missed"]["time"] + by}
    return shifted
