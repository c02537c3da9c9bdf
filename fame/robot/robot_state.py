"""The state of a robot as recordings and live views have it: scopes and their variables, tokens, instances, visits.

What happens is in messages of three channels (docs/recording_format.md, which has the table of events and their
effects). A state is made of a key, and changed by every later message, in order: recorders, engines that are watched,
readers and pages all fold messages here. The page does the same in JavaScript; both are tried with the cases of
tests/page/state_cases.json.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

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
    """An open scope.

    instance  the number of its process instance
    parent    the scope around it; 0: it is that of a process
    inside    the activities and event sub-processes that lead into it from `parent` (ids, outermost first)
    file      its elements are of this model: a number among those of the robot
    values    its own variables; `since`: when each was set (ns)
    """

    instance: int
    parent: int = 0
    inside: tuple[str, ...] = ()
    file: int = 0
    values: dict[str, Any] = field(default_factory=dict)
    since: dict[str, int] = field(default_factory=dict, compare=False)

    def to_json(self, scope: int) -> dict[str, Any]:
        """Return what a message says when this scope opens: empty members are left out."""
        return {
            "scope": scope,
            "instance": self.instance,
            **({"parent": self.parent} if self.parent else {}),
            **({"inside": list(self.inside)} if self.inside else {}),
            **({"file": self.file} if self.file else {}),
        }


class ElementOutcomes(NamedTuple):
    """How often an element was completed, failed and was cancelled."""

    completed: int
    failed: int
    cancelled: int


@dataclass(slots=True)
class RobotState:
    """The state of one robot.

    process    the id of its process
    instances  number of an instance -> id of its process, and its status
    scopes     number of an open scope -> what is known of it
    active     (scope, id of an element) -> number of tokens that have entered it, since when (ns)
    tokens     key of a token that waits -> what it waits for, as in ``/fame/waiting``
    counts     number of a file -> id of an element -> how often a token entered, left ... it
    ended      status -> how many instances have ended with it; `instances` has the last of them only
    ended_at   when the last one ended (ns); -1 if that is not known
    """

    process: str = ""
    instances: dict[int, tuple[str, str]] = field(default_factory=dict)
    scopes: dict[int, ScopeState] = field(default_factory=dict)
    active: dict[tuple[int, str], list[int]] = field(default_factory=dict)
    tokens: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    counts: dict[int, dict[str, dict[str, int]]] = field(default_factory=dict)
    ended: dict[str, int] = field(default_factory=dict)
    ended_at: int = field(default=-1, compare=False)

    @classmethod
    def from_key(cls, data: Mapping[str, Any], time: int = 0) -> RobotState:
        """Return the state that a key message of a time (ns) has for one robot."""
        state = cls(process=data["process"], ended=dict(data["ended"]))
        state.instances = {each["instance"]: (each["process"], each["status"]) for each in data["instances"]}
        state.tokens = {token["key"]: token for token in data["tokens"]}
        for each in data["scopes"]:
            state.open_scope(each)
            state._change_scope(each, time)
        state.active = {(each["scope"], each["element"]): [each["number"], each["since"]] for each in data["active"]}
        for file, elements in data["counts"].items():
            state.counts[int(file)] = {id: dict(each) for id, each in elements.items()}
        return state

    def to_key(self) -> dict[str, Any]:
        """Return the same as `from_key` takes: a copy, which later changes leave as it is."""
        return {
            "process": self.process,
            "instances": [
                {"instance": key, "process": process, "status": status}
                for key, (process, status) in self.instances.items()
            ],
            "scopes": [
                {**scope.to_json(key), **({"set": dict(scope.values)} if scope.values else {})}
                for key, scope in self.scopes.items()
            ],
            "active": [
                {"scope": scope, "element": element, "number": number, "since": since}
                for (scope, element), (number, since) in self.active.items()
            ],
            "tokens": list(self.tokens.values()),
            "counts": {
                str(file): {id: dict(each) for id, each in elements.items()} for file, elements in self.counts.items()
            },
            "ended": dict(self.ended),
        }

    def apply(self, topic: str, data: Mapping[str, Any], time: int) -> None:
        """Change it by a message of a time (ns) of one of the three topics; messages of others are ignored."""
        if topic == EVENTS:
            for opened in data.get("opens", ()):
                self.open_scope(opened)
            for group in data["events"]:
                self._apply_marks(time, group["instance"], group["scope"], group["marks"])
        elif topic == VARIABLES:
            for change in data["changes"]:
                self._change_scope(change, time)
        elif topic == WAITING:
            for key in data["gone"]:
                self.tokens.pop(key, None)
            self.tokens.update((token["key"], token) for token in data["tokens"])

    # ---- what is asked of it -----------------------------------------------------------------------------------------

    def around(self, scope: int) -> Iterator[ScopeState]:
        """Yield a scope and those around it, as far as they are known, the innermost first."""
        left = len(self.scopes)  # a foreign message may have made a circle
        while (known := self.scopes.get(scope)) is not None and left:
            yield known
            scope, left = known.parent, left - 1

    def path(self, scope: int) -> tuple[str, ...]:
        """Return the ids of the activities and event sub-processes that a scope is inside, the outermost first."""
        return tuple(id for known in reversed([*self.around(scope)]) for id in known.inside)

    def visible(self, scope: int) -> dict[str, Any]:
        """Return the variables that a scope sees: name -> value in the nearest scope."""
        found: dict[str, Any] = {}
        for known in reversed([*self.around(scope)]):
            found.update(known.values)
        return found

    def outcomes(self) -> Iterator[tuple[int, str, ElementOutcomes]]:
        """Yield file (number), id and outcomes of each element."""
        active: Counter[tuple[int, str]] = Counter()
        for (scope, element), (number, _) in self.active.items():
            active[self.file_of(scope), element] += number
        for file, elements in self.counts.items():
            for id, marks in elements.items():
                yield file, id, outcomes_of(marks, active[file, id])

    def marks_of(self, element: str) -> Counter[str]:
        """Return how often a token entered, left ... an element, whatever file it is of."""
        found: Counter[str] = Counter()
        for elements in self.counts.values():
            found.update(elements.get(element, {}))
        return found

    def file_of(self, scope: int) -> int:
        """Return the number of the file of the elements in a scope; 0 if it is not known."""
        known = self.scopes.get(scope)
        return known.file if known is not None else 0

    # ---- changes -----------------------------------------------------------------------------------------------------

    def open_scope(self, data: Mapping[str, Any]) -> None:
        """Open a scope, as a message of events or a key says."""
        inside = tuple(data.get("inside", ()))
        self.scopes[data["scope"]] = ScopeState(data["instance"], data.get("parent", 0), inside, data.get("file", 0))

    def _apply_marks(self, time: int, instance: int, scope: int, marks: Sequence[Sequence[Any]]) -> None:
        active, file = self.active, self.file_of(scope)
        counts = self.counts.get(file, {})
        for mark in marks:
            element, what = mark[0], mark[1]
            try:
                counts[element][what] += 1
            except KeyError:  # the first of its kind, or one that is not counted
                if what not in COUNTED:
                    self._apply_mark(time, instance, mark)
                    continue
                counts = self.counts.setdefault(file, counts)
                counts.setdefault(element, {})[what] = 1
            if what == "take":
                continue
            held = active.get((scope, element))
            if what == "enter":
                if held is None:
                    active[scope, element] = [1, time]
                else:
                    held[0] += 1
            elif held is not None:
                held[0] -= 1
                if not held[0]:
                    del active[scope, element]

    def _apply_mark(self, time: int, instance: int, mark: Sequence[Any]) -> None:
        element, what = mark[:2]
        if what == "start":
            self.instances[instance] = element, "running"
        elif what == "end":
            self._cancel(instance)
            self.instances[instance] = element, str(mark[2])
            self.ended[str(mark[2])] = self.ended.get(str(mark[2]), 0) + 1
            self.ended_at = time
            ended = [key for key, (_, status) in self.instances.items() if status != "running"]
            for key in ended[:-_ENDED]:
                del self.instances[key]

    def _cancel(self, instance: int) -> None:
        """Cancel whatever an instance that has ended still did."""
        for (scope, element), (number, _) in [*self.active.items()]:
            known = self.scopes.get(scope)
            if known is not None and known.instance == instance:
                counts = self.counts.setdefault(known.file, {}).setdefault(element, {})
                counts["cancel"] = counts.get("cancel", 0) + number
                del self.active[scope, element]

    def _change_scope(self, change: Mapping[str, Any], time: int) -> None:
        if change.get("gone"):
            self.scopes.pop(change["scope"], None)
            return
        scope = self.scopes[change["scope"]]
        scope.values.update(change.get("set", {}))
        scope.since.update(dict.fromkeys(change.get("set", ()), time))
        for name in change.get("unset", ()):
            scope.values.pop(name, None)
            scope.since.pop(name, None)


def outcomes_of(marks: Mapping[str, int], active: int) -> ElementOutcomes:
    """Return the outcomes of an element by the counts of its marks; `active` tokens are there now.

    An error end event has the marks leave and fail, which count as one failure.
    """
    left, failed, cancelled = marks.get("leave", 0), marks.get("fail", 0), marks.get("cancel", 0)
    twice = min(failed, max(0, active - (marks.get("enter", 0) - left - failed - cancelled)))
    return ElementOutcomes(left + marks.get("take", 0) - twice, failed, cancelled)
