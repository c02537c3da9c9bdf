"""The state of a robot as recordings and live views have it: tokens, variables, instances, and visits of elements.

What happens is in messages of three channels (docs/recording_format.md). A state is made of a key, and changed by every
later message, in order: recorders, engines that are watched, and readers all fold messages here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from fame.dataclasses import dataclass, field

EVENTS_TOPIC, MODEL_TOPIC = "bpmn_events", "bpmn_model"
"""Topics on which a robot tells what happens in it (`fame.robot.live`)."""
EVENTS, VARIABLES, WAITING = "/fame/events", "/fame/variables", "/fame/waiting"
"""The channels of what changes in a robot."""
COUNTED = frozenset(("enter", "leave", "take", "cancel", "fail"))
"""Marks that are counted by element."""
_ENDED = 20
"""Ended instances that a state keeps."""


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
    ended      status -> how many instances have ended with it; `instances` has the last of them only
    """

    process: str = ""
    instances: dict[int, tuple[str, str]] = field(default_factory=dict)
    tokens: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    scopes: dict[int, ScopeState] = field(default_factory=dict)
    counts: dict[str, dict[str, int]] = field(default_factory=dict)
    ended: dict[str, int] = field(default_factory=dict)

    @classmethod
    def from_key(cls, data: Mapping[str, Any]) -> RobotState:
        """Return the state that a key message has for one robot."""
        state = cls(process=data["process"], counts={id: dict(each) for id, each in data["counts"].items()})
        state.instances = {each["instance"]: (each["process"], each["status"]) for each in data["instances"]}
        state.ended = ended_of(data)
        state.tokens = {token["key"]: token for token in data["tokens"]}
        for change in data["variables"]:
            state._change_scope(change)
        return state

    def to_key(self) -> dict[str, Any]:
        """Return the same as `from_key` takes: a copy, which later changes leave as it is."""
        return {
            "process": self.process,
            "instances": [
                {"instance": key, "process": process, "status": status}
                for key, (process, status) in self.instances.items()
            ],
            "tokens": list(self.tokens.values()),
            "variables": [
                {"instance": scope.instance, "scope": key, "path": list(scope.path), "set": dict(scope.values)}
                for key, scope in self.scopes.items()
            ],
            "counts": {id: dict(each) for id, each in self.counts.items()},
            "ended": dict(self.ended),
        }

    def apply(self, topic: str, data: Mapping[str, Any]) -> None:
        """Change it by a message of one of the three topics; messages of others are ignored."""
        if topic == EVENTS:
            counts = self.counts
            for group in data["events"]:
                for mark in group["marks"]:
                    try:
                        counts[mark[0]][mark[1]] += 1
                    except KeyError:  # the first of its kind, or one that is not counted
                        self._apply_mark(group["instance"], mark)
        elif topic == VARIABLES:
            for change in data["changes"]:
                self._change_scope(change)
        elif topic == WAITING:
            for key in data["gone"]:
                self.tokens.pop(key, None)
            self.tokens.update((token["key"], token) for token in data["tokens"])

    def visible(self, place: Mapping[str, Any]) -> dict[str, Any]:
        """Return the variables that an event or token sees (`scope`, `sees`): name -> value in the nearest scope."""
        found: dict[str, Any] = {}
        for key in reversed(place.get("sees", (place["scope"],))):
            if key in self.scopes:
                found.update(self.scopes[key].values)
        return found

    def _apply_mark(self, instance: int, mark: Sequence[Any]) -> None:
        element, what = mark[:2]
        if what in COUNTED:
            self.counts.setdefault(element, {})[what] = 1
        elif what == "start":
            self.instances[instance] = element, "running"
        elif what == "end":
            self.instances[instance] = element, str(mark[2])
            self.ended[str(mark[2])] = self.ended.get(str(mark[2]), 0) + 1
            ended = [key for key, (_, status) in self.instances.items() if status != "running"]
            for key in ended[:-_ENDED]:
                del self.instances[key]

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


def ended_of(key: Mapping[str, Any]) -> dict[str, int]:
    """Return how many instances of a robot have ended with each status, by its part of a key message.

    Keys of older recordings have only the last ones.
    """
    over = Counter(each["status"] for each in key["instances"] if each["status"] != "running")
    return {status: int(number) for status, number in key.get("ended", over).items()}
