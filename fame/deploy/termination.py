"""Cooperative termination of the two-phase commit: what a robot that is ready does when its sender falls silent.

A robot that answered ``ready`` starts when its sender says so, and others may have started already: it must not decide
alone. So it holds, and asks the others::

    ready ──silence──> asking ──one has started──> start
      │                   ├──one has aborted, or every other one asks, too──> abort
      ├──start──> start   ├──start, since one has started──> start
      └──abort──> abort   └──abort──> abort

What robots answer each other is irrevocable, so it does not matter how late it arrives:

``started``  it runs.
``aborted``  it has made no promise (or was released from it), and never will for this deployment.
``asking``   it takes no plain ``start`` from its sender any more. If all ask, no robot has started and none will.

``unknown`` decides nothing: an engine that was started after the deployment began does not know what the one before
promised. Those who ask hold until their sender or a person decides.

However long messages take, and whichever process dies or is stopped, no robot starts while another one aborts. The
price: a robot that receives neither an instruction of its sender nor enough answers holds until a person aborts.

State and events in, state and actions out: nothing here sends, waits or looks at a clock.
"""

from __future__ import annotations

from fame.dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Ready:
    """A robot that answered ready: the `others` of its deployment, and those of them that are known to ask as well.

    `reborn` are those whose engine was started anew: what the one before promised is not known.
    """

    others: frozenset[str]
    asking: bool = False
    asked: frozenset[str] = frozenset()
    reborn: frozenset[str] = frozenset()

    @property
    def unheard(self) -> frozenset[str]:
        """The other robots whose state is unknown."""
        return self.others - self.asked


# ---- events ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Instruction:
    """An instruction of the sender: ``hold``, ``start`` (`begun`: one of the robots has started) or ``abort``."""

    phase: str
    begun: bool = False


@dataclass(frozen=True, slots=True)
class PeerAnswered:
    """Another robot's answer to this deployment."""

    robot: str
    answer: str


@dataclass(frozen=True, slots=True)
class Silence:
    """No instruction and no deciding answer was received for a while."""


# ---- actions ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class KeepWaiting:
    """Wait for the sender; give `Silence` if it does not send anything for a while."""


@dataclass(frozen=True, slots=True)
class Ask:
    """Hold, ask the others, and report this; give `Silence` after a while without a decision."""


@dataclass(frozen=True, slots=True)
class ReportAsking:
    """Report to the sender that this robot is asking the others."""


@dataclass(frozen=True, slots=True)
class StartCandidate:
    """Start the candidate."""


@dataclass(frozen=True, slots=True)
class Abort:
    """Drop the candidate and keep the running process."""

    reason: str = ""


TerminationEvent = Instruction | PeerAnswered | Silence
TerminationAction = KeepWaiting | Ask | ReportAsking | StartCandidate | Abort
NONE_STARTED = "the sender fell silent before it started any robot"


def step(state: Ready, event: TerminationEvent) -> tuple[Ready, TerminationAction | None]:
    """Return the next state, and the action if there is one. After `StartCandidate` and `Abort` nothing follows."""
    match event:
        case Instruction(phase="abort"):
            return state, Abort()
        case Instruction(phase="start", begun=begun) if begun or not state.asking:
            return state, StartCandidate()
        case Instruction():
            return state, ReportAsking() if state.asking else KeepWaiting()
        case PeerAnswered(robot, _) if robot not in state.others:
            return state, None
        case PeerAnswered(answer="started"):
            return state, StartCandidate()
        case PeerAnswered(robot, "aborted"):
            return state, Abort(f"the sender fell silent, and {robot} does not start it")
        case PeerAnswered(robot, "asking"):
            return _alone_or(replace(state, asked=state.asked | {robot}), None)
        case PeerAnswered(robot, "unknown"):
            return replace(state, reborn=state.reborn | {robot}), None
        case Silence():
            return _alone_or(replace(state, asking=True), Ask())
    return state, None


def _alone_or(state: Ready, action: TerminationAction | None) -> tuple[Ready, TerminationAction | None]:
    return state, Abort(NONE_STARTED) if state.asking and not state.unheard else action


def reply(state: Ready | None, *, started: bool) -> str:
    """Return what a robot answers to another one that asks. `state` is its own if it is ready.

    Whoever answers ``aborted`` promises never to become ready.
    """
    if started:
        return "started"
    if state is None:
        return "aborted"
    return "asking" if state.asking else "ready"
