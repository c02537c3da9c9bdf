"""The state machine of a property for certain robots: what an event, a value or the passing of time does to it.

The state of a part is a tuple of plain data::

    (phase, since, memory, slack, triggered)

phase      WAITING for the scope, OPEN, ANSWERED (open, and nothing left to do), CLOSED for good, VIOLATED, UNKNOWN
since      ns: when the scope, or the oldest trigger that is not answered, began
memory     of the pattern: a count, whether the other event came, the keys that wait; when it was violated (ns)
slack      the least so far: s of a bound, the unit of a condition, or how many times are left
triggered  NOT_TRIGGERED; TRIGGERED when there was something to judge; UNCERTAIN when something was lost and only a
           violation is certain; VALUELESS while a condition has no value yet

States are hashable and can be kept and restored. Without a bound nothing depends on time: a host that gives 0 for every
step has finitely many states. Times are ns; events of one time are judged in the order in which they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

from fame.dataclasses import dataclass
from fame.properties.conditions import Condition, Reading

WAITING, OPEN, ANSWERED, CLOSED, VIOLATED, UNKNOWN = range(6)
NOT_TRIGGERED, TRIGGERED, UNCERTAIN, VALUELESS = range(4)
OPENS, CLOSES, MAIN, OTHER, FAILS, CANCELS = 1, 2, 4, 8, 16, 32
"""The roles of an event in a sentence, added up. The last two say how a start ended, of ``each`` patterns."""
SECOND = 1_000_000_000

PartState: TypeAlias = tuple[int, int, Any, float | None, int]
VerdictWord = Literal["holds", "violated", "pending", "not triggered", "not known"]


class Verdict(NamedTuple):
    """A verdict and the slack at the tightest instant (None without one).

    `time` (ns): of the violation; when a pending one is due, None without a bound. `part`: which one decided.
    """

    word: VerdictWord
    slack: float | None = None
    time: int | None = None
    part: int = 0


@dataclass(frozen=True, slots=True)
class Part:
    """A property for certain robots. Steps are pure functions of its state.

    binding     pool -> robot
    opens, closes   whether its scope begins, or ends, with an event
    bound       ns; `count` of ``at most``; `keyed`: events belong together by a key
    each        each start of an element or instance has an end of its own; which of them ends is not told
    condition   of ``always`` and ``never``
    """

    pattern: str
    binding: Mapping[str, str]
    opens: bool = False
    closes: bool = False
    bound: int | None = None
    count: int = 0
    keyed: bool = False
    each: bool = False
    condition: Condition | None = None

    @property
    def initial(self) -> PartState:
        """The state before anything happened."""
        return (WAITING, 0, None, None, NOT_TRIGGERED) if self.opens else self._opened(0, None, None)

    def _opened(self, time: int, slack: float | None, key: Any) -> PartState:
        memory: Any = 0 if self.pattern == "at most" else None
        if self.keyed:
            memory = ((key, time),) if self.pattern == "exists" else ()
        return OPEN, time, memory, slack, int(self.condition is None and self.pattern in _JUDGED_WHEN_OPEN)

    def step(self, state: PartState, time: int, roles: int, key: Any = None, doubt: int = 0) -> PartState:
        """Return the state after an event with these `roles` at `time`; `key`: its field, of keyed patterns.

        `doubt` (ns): how far its time and that of what opened the scope may be apart from what they are; an answer so
        close to the bound is not known.
        """
        phase = state[0]
        if phase >= CLOSED:
            return state
        if phase == OPEN and self.bound is not None and time > state[1] + self.bound + doubt:
            return self._violated(state, state[1] + self.bound)
        if roles & CLOSES and phase != WAITING:
            if phase == OPEN and self.pattern == "exists":
                return self._violated(state, time)
            triggered = UNCERTAIN if state[4] == VALUELESS else state[4]
            state = (WAITING if self.opens else CLOSED, 0, None, state[3], triggered)
        elif phase == OPEN and roles & (MAIN | OTHER):
            new = _INSIDE[self.pattern](self, state, time, roles, key)
            if doubt and self._is_doubtful(state, new, time, key, doubt):
                new = *new[:3], state[3], UNCERTAIN
            state = new
        if roles & OPENS and state[0] <= ANSWERED:
            return self._open(state, time, key)
        return state

    def _open(self, state: PartState, time: int, key: Any) -> PartState:
        phase, since, memory, slack, triggered = state
        if self.each:
            failed, first, *starts = memory or (False, 0)
            begun = (failed, first, *starts, time) if starts else (failed, time, time)
            return OPEN, begun[2], begun, slack, max(triggered, TRIGGERED)
        anew = self.closes and self.pattern in _JUDGED_FROM_LAST
        if phase in (WAITING, ANSWERED) or anew:
            opened = self._opened(time, slack, key)
            return (*opened[:4], max(triggered, opened[4]))
        if self.keyed and self.pattern == "exists" and all(key != known for known, _ in memory):
            return phase, since, (*memory, (key, time)), slack, triggered
        return state

    def _is_doubtful(self, old: PartState, new: PartState, time: int, key: Any, doubt: int) -> bool:
        """Whether an event answered what waits so close to the bound that it may be on the other side of it."""
        if self.bound is None or new is old:
            return False
        asked = next(begun for known, begun in old[2] if known == key) if self.keyed else old[1]
        return bool(abs(asked + self.bound - time) <= doubt)

    def expire(self, state: PartState, time: int, doubt: int = 0) -> PartState:
        """Return the state when the instant `time` is over; `doubt` (ns) as for `step`."""
        if self.bound is not None and state[0] == OPEN and time >= state[1] + self.bound + doubt:
            return self._violated(state, state[1] + self.bound)
        return state

    def sample(self, state: PartState, time: int, reading: Reading) -> PartState:
        """Return the state after its condition was read."""
        phase, since, memory, slack, triggered = state
        if phase != OPEN:
            return state
        if reading is None:
            return phase, since, memory, slack, _WITHOUT_VALUE[triggered]
        holds, own = reading
        if holds is None:
            return phase, since, memory, slack, UNCERTAIN
        if own is not None and (slack is None or own < slack):
            slack = own
        if not holds:
            return self._violated((phase, since, memory, slack, triggered), time)
        return phase, since, memory, slack, UNCERTAIN if triggered == UNCERTAIN else TRIGGERED

    def _violated(self, state: PartState, time: int) -> PartState:
        slack = state[3] if self.condition is not None else None
        return VIOLATED, state[1], time, slack, TRIGGERED

    def lose(self, state: PartState) -> PartState:
        """Return the state after events or values were lost: what is not certain any more is not known."""
        phase, since, memory, slack, _ = state
        if phase >= CLOSED:
            return state
        if self.pattern in ("always", "never", "at most") and not (self.opens or self.closes):
            return phase, since, memory, slack, UNCERTAIN
        return UNKNOWN, since, memory, slack, UNCERTAIN

    def finish(self, state: PartState, time: int) -> PartState:
        """Return the state when nothing can come any more."""
        state = self.expire(state, time)
        return self._violated(state, time) if state[0] == OPEN and self.pattern == "exists" else state

    def verdict(self, state: PartState, number: int = 0) -> Verdict:
        """Return the verdict so far."""
        phase, _, memory, slack, triggered = state
        if phase == VIOLATED:
            return Verdict("violated", slack, memory, number)
        if phase == UNKNOWN or triggered >= UNCERTAIN:
            return Verdict("not known", slack, None, number)
        if phase == OPEN and self.pattern == "exists":
            return Verdict("pending", slack, self.deadline(state), number)
        if not triggered:
            return Verdict("not triggered", slack, None, number)
        return Verdict("holds", slack, None, number)

    def deadline(self, state: PartState) -> int | None:
        """When (ns) it has to be told that time has passed; None: never."""
        return state[1] + self.bound if state[0] == OPEN and self.bound is not None else None


# ---- patterns: what an event does while the scope is open ------------------------------------------------------------

_WITHOUT_VALUE = (VALUELESS, UNCERTAIN, UNCERTAIN, VALUELESS)
"""What becomes of `triggered` when the condition has no value: none yet, or no more."""
_JUDGED_WHEN_OPEN = ("never", "at most", "exists")
"""Patterns that are judged as soon as their scope is open; the others need an event or a value in it."""
_JUDGED_FROM_LAST = ("only after", "each time only after")
"""Patterns that hold in every open scope if they hold in the one that was opened last, and only then."""


def _never(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    return part._violated(state, time) if roles & MAIN else state


def _at_most(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, count, slack, triggered = state
    if not roles & MAIN:
        return state
    left = part.count - count - 1
    if left < 0:
        return part._violated(state, time)
    return phase, since, count + 1, left if slack is None else min(slack, left), triggered


def _only_after(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, came, slack, triggered = state
    if roles & MAIN:
        if not came:
            return part._violated(state, time)
        triggered = TRIGGERED
    return phase, since, came or bool(roles & OTHER), slack, triggered


def _each_time_only_after(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, fresh, slack, triggered = state
    fresh = fresh or ()
    if roles & MAIN:
        if key not in fresh:
            return part._violated(state, time)
        fresh, triggered = tuple(known for known in fresh if known != key), TRIGGERED
    if roles & OTHER and key not in fresh:
        fresh = (*fresh, key)
    return phase, since, fresh, slack, triggered


def _exists(part: Part, state: PartState, time: int, roles: int, key: Any) -> PartState:
    phase, since, memory, slack, triggered = state
    if not roles & MAIN:
        return state
    if part.each:
        return _each_ends(part, state, time, roles)
    if part.keyed:
        asked = next((begun for known, begun in memory if known == key), None)
        if asked is None:
            return state
        memory = tuple(asking for asking in memory if asking[0] != key)
    else:
        asked, memory = since, None
    if part.bound is not None:
        left = (asked + part.bound - time) / SECOND
        slack = left if slack is None or left < slack else slack
    if memory:
        return phase, memory[0][1], memory, slack, triggered
    return ((ANSWERED if part.closes else WAITING) if part.opens else CLOSED), since, None, slack, triggered


def _each_ends(part: Part, state: PartState, time: int, roles: int) -> PartState:
    """One of what started has ended, and nobody knows which.

    If it is the oldest each time, all are as early as they can be: what is late then is late. They are surely in time
    if all that overlap have ended before the first of them would be late. What has failed may be kept as an incident,
    and be cancelled later: another end, of something that has ended.
    """
    _, _, (failed, first, *starts), slack, triggered = state
    if roles & CANCELS and failed:
        triggered = UNCERTAIN
    failed = failed or bool(roles & FAILS)
    if len(starts) > 1:
        return OPEN, starts[1], (failed, first, *starts[1:]), slack, triggered
    if part.bound is not None:
        left = (first + part.bound - time) / SECOND
        slack = left if slack is None or left < slack else slack
        triggered = UNCERTAIN if left < 0 else triggered
    return WAITING, 0, (failed, 0), slack, triggered


_INSIDE: Mapping[str, Callable[[Part, PartState, int, int, Any], PartState]] = {
    "never": _never,
    "always": lambda part, state, time, roles, key: state,
    "at most": _at_most,
    "only after": _only_after,
    "each time only after": _each_time_only_after,
    "exists": _exists,
}
