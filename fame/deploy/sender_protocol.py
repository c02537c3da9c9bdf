"""The sender's end of a deployment as a pure state machine: ``step(state, event) -> (state, actions)``.

Theory of operation. One model goes to all its robots, and all of them start or none does::

    discovery ──all have reported, or time is up──> load ──all are ready──> start ──all have answered──> over
        │                                            │                       └──patience ends──> over, failed
        └────────────────────────────────────────────┴──one refuses, patience ends, two engines of one name,
                                                        the sender itself was stopped──> abort to all ──> over, failed

A migration is approved between ``load`` and ``start``: what runs is suspended everywhere, so that its state can be
looked at as a whole, and it may not stay suspended for more than `HOLDING` s. A preview only asks all robots, and ends
when all have answered.

``load``, ``hold`` and ``start`` are repeated every second: to receive one twice has no effect but the answer. A robot
that is ready waits for its sender and then decides with the others (`fame.deploy.termination`), so a sender that was
stopped for longer must not start anybody. How long that is grows with the team and with how late timers are here, as
they are on a machine that has much to do: a sender tells its robots with the model.

Invariants, checked for every reachable state in ``tests/test_sender_protocol.py``:

- ``start`` is sent only after every robot has answered ``ready``; after the first one ``abort`` is never sent.
- ``abort`` is sent to all or to none. After the end nothing is sent, and the end is reported once.

Nothing here sends, waits or looks at a clock: events carry the time (ns) where it matters, and `fame.deploy.sender`
carries the actions out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from fame.clock import SECOND
from fame.dataclasses import dataclass, replace
from fame.deploy.envelope import LONGEST_SILENCE, SILENCE

SETTLE = 0.02
"""Between the endpoints of a sender and its first message (s): DDS drops messages of a sender that it has not matched
yet, and repeats them only 100 to 300 ms later."""
DISCOVERY = 0.5
"""How long a sender without keys waits for reports of all robots before it loads (s)."""
REPEAT, REPEAT_PER_ROBOT = 1.0, 0.05
"""After how long a robot that did not answer is asked again, at least and for each of the team (s)."""
HOLDING = 4.8
"""How long robots may be held for a migration before it starts or is aborted (s)."""
SILENCE_PER_ROBOT, SILENCE_PER_LATENESS, LONGEST_LATENESS = 0.5, 5.0, 6.0
"""How long robots wait for their sender, at least: s for each of the team, and how many times the greatest lateness of
a timer before the model was sent, of which at most some s count: longer ones are of a sender that was stopped."""
REFUSALS = frozenset({"refused", "stale", "superseded", "aborted", "left"})
"""Answers that end a deployment for all."""
_VOTES = REFUSALS | {"ready", "asking"}
_PREVIEWS = REFUSALS | {"previewed"}
_RESULTS = (REFUSALS - {"superseded"}) | {"started"}


# ---- state -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RobotProgress:
    """How far one robot is: its last answer, or ``silent``; with the reason; `took` how long it was until then (s).

    It is `called_off` if it was not started because of other robots.
    """

    robot: str
    state: str = "silent"
    reason: str = ""
    took: float = 0.0
    called_off: bool = False

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.robot, self.state, self.reason)))


@dataclass(frozen=True, slots=True)
class SenderState:
    """How far a deployment is.

    sequence  above that of every report received during discovery, whatever the clocks of their senders said
    signed    whether keys are used: then every robot must have reported before it is loaded
    reported  the robots that have reported anything
    begun     when it began, `spoke` when all were last told something (ns)
    late      the greatest lateness of a timer before robots were loaded, `woken` the last timer (ns)
    migrates  whether what runs is to go over: it is approved before it starts
    preview   whether it only asks what would become of what runs
    holding   since when a robot has been ready for a migration (ns); -1 if none is
    """

    robots: tuple[RobotProgress, ...]
    sequence: int = 0
    signed: bool = False
    phase: Literal["discovery", "load", "approval", "start", "over"] = "discovery"
    failed: bool = False
    reported: frozenset[str] = frozenset()
    begun: int = 0
    spoke: int = 0
    late: int = 0
    woken: int = 0
    migrates: bool = False
    preview: bool = False
    holding: int = -1

    @property
    def silence(self) -> float:
        """After how long without an envelope robots that are ready ask each other (s)."""
        late = SILENCE_PER_LATENESS * min(LONGEST_LATENESS, self.late / SECOND)
        return min(LONGEST_SILENCE, max(SILENCE, SILENCE_PER_ROBOT * len(self.robots), late))


# ---- events ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Begun:
    now: int


@dataclass(frozen=True, slots=True)
class StatusReceived:
    """A robot has reported, with the newest `sequence` that it has seen."""

    robot: str
    sequence: int


@dataclass(frozen=True, slots=True)
class RobotAnswered:
    """A robot has answered this deployment."""

    robot: str
    answer: str
    reason: str
    now: int


@dataclass(frozen=True, slots=True)
class RivalFound:
    """Two engines say that they are this robot."""

    robot: str


@dataclass(frozen=True, slots=True)
class TimerFired:
    """The time of `StartTimer` is over."""

    now: int


@dataclass(frozen=True, slots=True)
class PatienceEnded:
    """The robots had `patience` s in all."""

    patience: float


@dataclass(frozen=True, slots=True)
class Closed:
    """The sender leaves: what is not decided yet is aborted."""


@dataclass(frozen=True, slots=True)
class Approved:
    """The migrated state of all robots has been looked at (after `Approve`); `refusal` says why it must not start."""

    refusal: str
    now: int


@dataclass(frozen=True, slots=True)
class Refused:
    """What is sent must not start any more."""

    reason: str


SenderEvent = (
    Begun | StatusReceived | RobotAnswered | RivalFound | TimerFired | PatienceEnded | Closed | Approved | Refused
)


# ---- actions ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Prepare:
    """Give all models that are to be loaded the `sequence`, and the engines that have reported."""


@dataclass(frozen=True, slots=True)
class SendEnvelope:
    """Send an envelope of this phase to a robot. `begun`: one of the robots has started."""

    robot: str
    phase: str
    begun: bool = False


@dataclass(frozen=True, slots=True)
class StartTimer:
    """Give `TimerFired` after this many seconds, in place of an earlier timer."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Approve:
    """Find out whether the migrated state of all robots is one to start from; give `Approved`."""


@dataclass(frozen=True, slots=True)
class CancelTimers:
    """Wait for nothing any more."""


@dataclass(frozen=True, slots=True)
class End:
    """Report to the caller that the deployment is over."""


SenderAction = Prepare | SendEnvelope | StartTimer | Approve | CancelTimers | End


# ---- transitions -----------------------------------------------------------------------------------------------------


def step(state: SenderState, event: SenderEvent) -> tuple[SenderState, tuple[SenderAction, ...]]:
    """Return the next state, and what is to be done in this order. After the end nothing changes."""
    if state.phase == "over":
        return state, ()
    match event:
        case Begun(now):
            return replace(state, begun=now, woken=now), (StartTimer(SETTLE),)
        case StatusReceived():
            return _on_status(state, event), ()
        case RobotAnswered():
            return _answered(state, event)
        case RivalFound(robot) if state.phase != "start":
            return _end(_map(state, lambda each: _rival(each, robot)), failed=True)
        case TimerFired(now):
            return _timer(state, now)
        case PatienceEnded(patience):
            return _end(_map(state, lambda each: _impatient(state, each, patience)), failed=True)
        case Approved(refusal, now) if state.phase == "approval":
            return _refused(state, refusal) if refusal else _start(state, now)
        case Refused(reason) if state.phase != "start":
            return _refused(state, reason)
        case Closed():
            return _stop(state, failed=True)
    return state, ()


def _on_status(state: SenderState, event: StatusReceived) -> SenderState:
    number = max(state.sequence, event.sequence + 1) if state.phase == "discovery" else state.sequence
    if event.robot in state.reported and number == state.sequence:
        return state
    return replace(state, reported=state.reported | {event.robot}, sequence=number)


def _timer(state: SenderState, now: int) -> tuple[SenderState, tuple[SenderAction, ...]]:
    """Load when all robots have reported; then repeat the request to each robot."""
    if state.phase == "discovery":
        state = replace(state, late=max(state.late, now - state.woken - round(SETTLE * SECOND)), woken=now)
        waits = state.signed or now < state.begun + round(DISCOVERY * SECOND)
        if waits and len(state.reported) < len(state.robots):
            return state, (StartTimer(SETTLE),)
        state, actions = _send_all(replace(state, phase="load"), now)
        return state, (Prepare(), *actions)
    if state.phase in ("load", "approval") and _was_stopped(state, now):
        return _end_stopped(state, now)
    if state.phase in ("load", "approval") and 0 <= state.holding <= now - round(HOLDING * SECOND):
        return _refused(state, f"robots would be held for more than {HOLDING:g} s, and no robot is started")
    return _send_all(state, now)


def _send_all(state: SenderState, now: int) -> tuple[SenderState, tuple[SenderAction, ...]]:
    if state.phase == "start":
        begun = any(each.state == "started" for each in state.robots)
        sent = [SendEnvelope(each.robot, "start", begun) for each in state.robots if each.state == "ready"]
    else:
        sent = [SendEnvelope(each.robot, "load" if each.state == "silent" else "hold") for each in state.robots]
    repeat = max(REPEAT, REPEAT_PER_ROBOT * len(state.robots))
    if state.holding >= 0 and state.phase != "start":
        repeat = max(SETTLE, min(repeat, HOLDING - (now - state.holding) / SECOND))
    return replace(state, spoke=now), (*sent, StartTimer(repeat))


def _answered(state: SenderState, event: RobotAnswered) -> tuple[SenderState, tuple[SenderAction, ...]]:
    took = (event.now - state.begun) / SECOND
    if state.phase == "load" and state.preview and event.answer in _PREVIEWS:
        state = _progress(state, event, took)
        states = {each.state for each in state.robots}
        return _end(state, failed=states != {"previewed"}) if "silent" not in states else (state, ())
    if state.phase in ("load", "approval") and event.answer in _VOTES:
        return _vote(_progress(state, event, took), event.now)
    if state.phase == "start" and (event.answer in _RESULTS or _why_not_yet(state, event)):
        state = _progress(state, event, took)
        states = {each.state for each in state.robots}
        return _end(state, failed=states != {"started"}) if "ready" not in states else (state, ())
    if state.phase in ("discovery", "load") and not event.answer and event.reason:  # why it does not answer yet
        return _map(state, lambda each: replace(each, reason=event.reason) if each.robot == event.robot else each), ()
    return state, ()


def _why_not_yet(state: SenderState, event: RobotAnswered) -> bool:
    """Whether a robot says why it has not started yet."""
    waits = any(each.robot == event.robot and each.state == "ready" for each in state.robots)
    return waits and event.answer == "ready" and event.reason != ""


def _vote(state: SenderState, now: int) -> tuple[SenderState, tuple[SenderAction, ...]]:
    """End it for all after one refusal; start all when all are ready, which is not undone."""
    states = {each.state for each in state.robots}
    if states & (REFUSALS | {"asking"}):
        return _end(state, failed=True)
    if state.migrates and state.holding < 0:
        state = replace(state, holding=now)
    if states != {"ready"} or state.phase == "approval":
        return state, ()
    if state.migrates:
        return replace(state, phase="approval"), (Approve(),)
    return _start(state, now)


def _start(state: SenderState, now: int) -> tuple[SenderState, tuple[SenderAction, ...]]:
    if _was_stopped(state, now):
        return _end_stopped(state, now)
    return _send_all(replace(state, phase="start"), now)


def _refused(state: SenderState, refusal: str) -> tuple[SenderState, tuple[SenderAction, ...]]:
    """End a migration that must not start: each robot goes on with what it had."""
    return _end(_map(state, lambda each: replace(each, state="refused", reason=each.reason or refusal)), failed=True)


def _was_stopped(state: SenderState, now: int) -> bool:
    """Whether robots may have given this sender up, so that no robot may be started any more."""
    return now - state.spoke > state.silence * SECOND


def _end_stopped(state: SenderState, now: int) -> tuple[SenderState, tuple[SenderAction, ...]]:
    still = (now - state.spoke) / SECOND
    reason = f"this command was stopped for {still:.0f} s and starts no robot"
    return _end(_map(state, lambda each: replace(each, reason=each.reason or reason)), failed=True)


def _impatient(state: SenderState, progress: RobotProgress, patience: float) -> RobotProgress:
    if progress.state == "silent" and (state.phase != "discovery" or progress.robot not in state.reported):
        return replace(progress, reason=progress.reason or f"did not answer within {patience:g} s")
    if state.phase == "start" and progress.state == "ready":
        return replace(progress, reason=progress.reason or "was ready, and did not answer the start")
    return progress


def _rival(progress: RobotProgress, robot: str) -> RobotProgress:
    reason = f"two engines say that they are {robot}, and neither can prove it"
    return replace(progress, reason=reason) if progress.robot == robot else progress


def _end(state: SenderState, *, failed: bool) -> tuple[SenderState, tuple[SenderAction, ...]]:
    if failed and state.phase != "start" and not state.preview:
        state = _explain(state)
    state, actions = _stop(state, failed=failed)
    return state, (*actions, End())


def _stop(state: SenderState, *, failed: bool) -> tuple[SenderState, tuple[SenderAction, ...]]:
    undecided = state.phase in ("load", "approval") and not state.preview
    aborted = [SendEnvelope(each.robot, "abort") for each in state.robots] if failed and undecided else []
    return replace(state, phase="over", failed=failed), (CancelTimers(), *aborted)


def _explain(state: SenderState) -> SenderState:
    """Separate the robots that caused the failure from the others."""
    failing = {each.robot for each in state.robots if each.state in REFUSALS | {"asking"} or each.reason}
    names = ", ".join(each.robot for each in state.robots if each.robot in failing)
    silent = "had not answered yet" if state.phase in ("load", "approval") else f"was not asked yet because of {names}"

    def explained(progress: RobotProgress) -> RobotProgress:
        reason = silent if progress.state == "silent" else f"called off because of {names}"
        return progress if progress.robot in failing else replace(progress, reason=reason, called_off=True)

    return _map(state, explained)


def _map(state: SenderState, change: Callable[[RobotProgress], RobotProgress]) -> SenderState:
    return replace(state, robots=tuple(map(change, state.robots)))


def _progress(state: SenderState, event: RobotAnswered, took: float) -> SenderState:
    progress = RobotProgress(event.robot, event.answer, event.reason, took)
    return _map(state, lambda each: progress if each.robot == event.robot else each)
