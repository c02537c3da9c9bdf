"""The state of a run at an instant: tokens, counts, scopes, variables, waits. What happens changes it, event by event.

The page changes its own in the same way (page/store.js): both are tried with the cases of tests/page/state_cases.json.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from fame.dataclasses import dataclass, field, replace
from fame.view.catalogue import NOWHERE

WHATS: tuple[str, ...] = ("start", "enter", "leave", "take", "cancel", "fail", "end", "log", "report", "answer")
"""Kinds of events; an event has the number of its kind."""
START, ENTER, LEAVE, TAKE, CANCEL, FAIL, END = range(7)
COMPLETED, FAILED, CANCELLED = range(3)


class TokenKey(NamedTuple):
    """Where tokens are: robot, instance, scope and element, by number."""

    robot: int
    instance: int
    scope: int
    element: int


@dataclass(slots=True)
class ScopeInfo:
    """A scope: the file of its elements, the scope around it, the element that opened it, how deep it is."""

    instance: int
    file: int
    parent: int = NOWHERE
    opener: int = NOWHERE
    depth: int = 0


@dataclass(slots=True)
class RunState:
    """The state of a run at an instant.

    tokens     where -> [number of tokens, since when]. Scopes of which a key message told only the path, and not the
               number, have numbers below NOWHERE
    counts     (robot, element) -> [completed, failed, cancelled]
    scopes     (robot, scope) -> what is known of it
    variables  (robot, scope) -> name -> [value, since when]
    waits      robot -> key of a waiting token -> what it waits for
    ends       robot -> how many of its instances have ended and failed, how and when (ns) the last one ended; -1 if
               that is not known
    poses      robot -> its last pose; ``world``: name -> what changed
    """

    tokens: dict[TokenKey, list[int]] = field(default_factory=dict)
    counts: defaultdict[tuple[int, int], list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0, 0]))
    scopes: dict[tuple[int, int], ScopeInfo] = field(default_factory=dict)
    variables: dict[tuple[int, int], dict[str, list[Any]]] = field(default_factory=dict)
    waits: dict[int, dict[str, Any]] = field(default_factory=dict)
    ends: dict[int, tuple[int, int, str, int]] = field(default_factory=dict)
    poses: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)

    def count(self, robot: int, element: int, outcome: int, by: int = 1) -> None:
        """Count executions of an element with an outcome."""
        self.counts[robot, element][outcome] += by

    def add(self, key: TokenKey, since: int) -> None:
        """Add a token at a place, there since a time (ns)."""
        held = self.tokens.get(key)
        if held is None:
            self.tokens[key] = [1, since]
        else:
            held[0] += 1

    def event(self, time: int, key: TokenKey, what: int) -> None:
        """Change the state by an event."""
        if what == ENTER:
            self.add(key, time)
        elif what == TAKE:
            self.count(key.robot, key.element, COMPLETED)
        elif what in (LEAVE, CANCEL, FAIL):
            self._left(key if key in self.tokens else self._by_path(key), what)
        elif what == END:
            self._ended(key)

    def _by_path(self, key: TokenKey) -> TokenKey:
        """The place of the same token, if only the path of its scope is known."""
        same = (one for one in self.tokens if one.scope < NOWHERE and one == key._replace(scope=one.scope))
        return next(same, key)

    def _left(self, key: TokenKey, what: int) -> None:
        held = self.tokens.get(key)
        if held is not None:
            held[0] -= 1
            if not held[0]:
                del self.tokens[key]
        elif what == FAIL:  # an error end event has completed and then fails: it counts as a failure
            self.count(key.robot, key.element, COMPLETED, -1)
        outcome = {LEAVE: COMPLETED, CANCEL: CANCELLED, FAIL: FAILED}[what]
        self.count(key.robot, key.element, outcome)

    def _ended(self, key: TokenKey) -> None:
        """End an instance, and with it whatever it still did."""
        for other in [other for other in self.tokens if other[:2] == key[:2]]:
            self.count(other.robot, other.element, CANCELLED, self.tokens.pop(other)[0])
        for place in [place for place, info in self.scopes.items() if (place[0], info.instance) == key[:2]]:
            del self.scopes[place]

    def change_variables(
        self, time: int, robot: int, scope: int, values: Mapping[str, Any] | None, unset: Iterable[str] = ()
    ) -> list[str]:
        """Set and unset variables of a scope, or close it (no `values`). Returns which of `unset` there were."""
        if values is None:
            self.variables.pop((robot, scope), None)
            return []
        known = self.variables.setdefault((robot, scope), {})
        known.update((name, [value, time]) for name, value in values.items())
        return [name for name in unset if known.pop(name, None) is not None]

    def change_waits(self, robot: int, tokens: Iterable[Mapping[str, Any]], gone: Iterable[str]) -> None:
        """Drop tokens that no longer wait (keys), then set those that wait."""
        known = self.waits.setdefault(robot, {})
        for key in gone:
            known.pop(key, None)
        known.update((token["key"], token) for token in tokens)

    def end(self, robot: int, status: str, time: int) -> None:
        """Note that an instance ended with a status."""
        ended, failed, _, _ = self.ends.get(robot, (0, 0, "", -1))
        self.ends[robot] = ended + 1, failed + (status == "failed"), status, time

    def forget(self, robot: int) -> None:
        """Drop everything about the mission of a robot."""
        by_robot: tuple[dict[Any, Any], ...] = self.tokens, self.counts, self.scopes, self.variables
        for known in by_robot:
            for key in [key for key in known if key[0] == robot]:
                del known[key]
        self.waits.pop(robot, None)
        self.ends.pop(robot, None)

    def move(self, robot: int, element: Callable[[int], int], file: Callable[[int], int]) -> None:
        """Move everything about the mission of a robot to other elements and files, as these functions say."""
        self.tokens = {
            key._replace(element=element(key.element)) if key.robot == robot else key: held
            for key, held in self.tokens.items()
        }
        old = {place: self.counts.pop(place) for place in list(self.counts) if place[0] == robot}
        for (_, number), counts in old.items():
            for outcome, by in enumerate(counts):
                self.count(robot, element(number), outcome, by)
        self.scopes = {
            place: replace(info, file=file(info.file), opener=element(info.opener)) if place[0] == robot else info
            for place, info in self.scopes.items()
        }
        if waits := self.waits.get(robot):
            self.waits[robot] = {key: {**token, "e": element(token["e"])} for key, token in waits.items()}

    def forget_closed_scopes(self) -> None:
        """Drop the scopes that hold no token, and whose inner scopes hold none."""
        needed: set[tuple[int, int]] = set()
        for key in self.tokens:
            place = (key.robot, key.scope)
            while place in self.scopes and place not in needed:
                needed.add(place)
                place = (key.robot, self.scopes[place].parent)
        roots = {place for place, info in self.scopes.items() if info.parent == NOWHERE}
        self.scopes = {place: info for place, info in self.scopes.items() if place in needed or place in roots}

    def to_json(self) -> dict[str, Any]:
        """Return the state, fit for JSON."""
        return {
            "tokens": [[*key, *held] for key, held in self.tokens.items()],
            "counts": [[*key, *counts] for key, counts in self.counts.items() if any(counts)],
            "scopes": [scope_row(place, info) for place, info in self.scopes.items()],
            "variables": [[*place, dict(values)] for place, values in self.variables.items()],
            "waits": [[robot, list(waits.values())] for robot, waits in self.waits.items()],
            "ends": [[robot, *ends] for robot, ends in self.ends.items()],
            "poses": [[robot, pose] for robot, pose in self.poses.items()],
            "world": dict(self.world),
        }


def scope_row(place: tuple[int, int], info: ScopeInfo) -> list[int]:
    """Return a scope as the page gets it: robot, number, instance, scope around it, element that opened it, depth."""
    return [*place, info.instance, info.parent, info.opener, info.depth]
