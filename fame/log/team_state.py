"""The state of a team at one time of its recording: tokens, variables, instances, and visits of elements.

A state is read from a key message, and changed by every later message of ``/fame/events``, ``/fame/variables`` and
``/fame/waiting``, in order. Seeking and playing give the same state.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.robot.change_text import COUNTED, forget_ended

_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode


@dataclass(slots=True)
class ScopeState:
    """The variables of one scope: its instance, the activities that it is inside (ids, outermost first), and values."""

    instance: int
    path: tuple[str, ...]
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class RobotState:
    """The state of one robot.

    process    the id of its process
    instances  number of an instance -> id of its process, and its status
    tokens     key of a token that waits -> what it waits for, as in ``/fame/waiting``
    scopes     number of a scope -> its own variables
    counts     id of an element -> how often a token entered, left ... it
    """

    process: str = ""
    instances: dict[int, tuple[str, str]] = field(default_factory=dict)
    tokens: dict[str, dict[str, Any]] = field(default_factory=dict)
    scopes: dict[int, ScopeState] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)

    @classmethod
    def from_key(cls, data: Mapping[str, Any]) -> RobotState:
        """The state that a key message has for one robot."""
        state = cls(process=data["process"], counts={id: dict(each) for id, each in data["counts"].items()})
        state.instances = {each["instance"]: (each["process"], each["status"]) for each in data["instances"]}
        state.tokens = {token["key"]: token for token in data["tokens"]}
        for change in data["variables"]:
            state._change_scope(change)
        return state

    def to_key(self) -> dict[str, Any]:
        """The same as `from_key` takes."""
        return {
            "process": self.process,
            "instances": [
                {"instance": key, "process": process, "status": status}
                for key, (process, status) in self.instances.items()
            ],
            "tokens": list(self.tokens.values()),
            "variables": [
                {"instance": scope.instance, "scope": key, "path": list(scope.path), "set": scope.values}
                for key, scope in self.scopes.items()
            ],
            "counts": self.counts,
        }

    def apply(self, topic: str, data: Mapping[str, Any]) -> None:
        """Change it by a message of one of the three topics; messages of others are ignored."""
        if topic == EVENTS:
            for group in data["events"]:
                for mark in group["marks"]:
                    self._apply_mark(group["instance"], mark)
        elif topic == VARIABLES:
            for change in data["changes"]:
                self._change_scope(change)
        elif topic == WAITING:
            self.tokens.update((token["key"], token) for token in data["tokens"])
            for key in data["gone"]:
                self.tokens.pop(key, None)

    def _apply_mark(self, instance: int, mark: list[Any]) -> None:
        element, what = mark[:2]
        if what in COUNTED:
            counts = self.counts.setdefault(element, {})
            counts[what] = counts.get(what, 0) + 1
        elif what == "start":
            self.instances[instance] = element, "running"
        elif what == "end":
            self.instances[instance] = element, str(mark[2])
            forget_ended(self.instances)

    def _change_scope(self, change: Mapping[str, Any]) -> None:
        if change.get("gone"):
            self.scopes.pop(change["scope"], None)
            return
        scope = self.scopes.get(change["scope"])
        if scope is None:
            scope = self.scopes[change["scope"]] = ScopeState(change["instance"], tuple(change["path"]))
        scope.values.update(change.get("set", {}))
        for name in change.get("unset", ()):
            scope.values.pop(name, None)


@dataclass(slots=True)
class TeamState:
    """The state of a team at `time` (ns), by robot."""

    time: int = 0
    robots: dict[str, RobotState] = field(default_factory=dict)

    @classmethod
    def from_key(cls, time: int, data: Mapping[str, Any]) -> TeamState:
        """The state that a key message holds."""
        return cls(time, {name: RobotState.from_key(robot) for name, robot in data["robots"].items()})

    def key_text(self, gaps: Mapping[str, int] | None = None) -> str:
        """The key message, as JSON. `gaps`: the robots that a replay continues from here, and how much was lost.

        They come first, where a reader sees them at once.
        """
        robots = {name: robot.to_key() for name, robot in self.robots.items()}
        return _encode({"robots": robots} if gaps is None else {"gaps": gaps, "robots": robots})

    def apply(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        """Change it by the next message."""
        self.time = time
        if "robot" in data:
            self.robots.setdefault(data["robot"], RobotState()).apply(topic, data)


def shift_times(topic: str, data: Mapping[str, Any], by: int) -> Mapping[str, Any]:
    """A message of ``/fame/waiting`` or ``/fame/key`` with the times that it contains on a clock `by` ns ahead."""
    if not by or topic not in (WAITING, KEY):
        return data
    if topic == WAITING:
        return {**data, "tokens": _shift_tokens(data["tokens"], by)}
    robots = {name: {**robot, "tokens": _shift_tokens(robot["tokens"], by)} for name, robot in data["robots"].items()}
    return {**data, "robots": robots}


def _shift_tokens(tokens: Iterable[Mapping[str, Any]], by: int) -> list[dict[str, Any]]:
    shifted = [{**token, "since": token["since"] + by} for token in tokens]
    for token in shifted:
        if "missed" in token:
            token["missed"] = {**token["missed"], "time": token["missed"]["time"] + by}
    return shifted
