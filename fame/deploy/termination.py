"""Cooperative termination of the two-phase commit: what a robot that is ready does when its sender falls silent.

Whoever has said ``ready`` starts when it is told to, and others may have been told already: it must not decide alone.
So it holds, and asks the others::

    ready ──silence──> asking ──one has started──> start
      │                   ├──one has aborted, or every other one asks, too──> abort
      ├──start──> start   ├──start, since one has started──> start
      └──abort──> abort   └──abort──> abort

What robots tell each other is irrevocable, so it does not matter how late it arrives:

``started``  it runs.
``aborted``  it has not promised anything (or was released from its promise), and never will for this deployment.
``asking``   it takes no plain ``start`` from its sender any more. If all ask, nobody has started and nobody will.

However long messages take, and whoever dies or stands still, no robot starts while another one aborts. The price: a
robot that hears neither its sender nor what it needs of the others goes on holding until a person aborts.

State and events in, state and actions out: nothing here sends, waits or looks at a clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Ready:
    """A robot that has said ready: the `others` that start with it, and those of them that are known to ask."""

    others: frozenset[str]
    asking: bool = False
    asked: frozenset[str] = frozenset()

    @property
    def unheard(self) -> frozenset[str]:
        """The others that have not said anything that helps."""
        return self.others - self.asked


# ---- events ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Told:
    """A word of the sender: ``hold``, ``start`` (`begun`: one of the robots has started) or ``abort``."""

    phase: str
    begun: bool = False


@dataclass(frozen=True, slots=True)
class Answered:
    """What another robot says about this deployment."""

    robot: str
    answer: str


@dataclass(frozen=True, slots=True)
class Silence:
    """Nothing helpful was said for a while."""


# ---- actions ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Wait:
    """Wait for the sender: if it says nothing for a while, that is `Silence`."""


@dataclass(frozen=True, slots=True)
class Ask:
    """Hold, ask the others, and report it; after a while without a decision, that is `Silence` again."""


@dataclass(frozen=True, slots=True)
class Report:
    """Tell the sender that it asks, since it wants something else."""


@dataclass(frozen=True, slots=True)
class Start:
    """Start it."""


@dataclass(frozen=True, slots=True)
class Abort:
    """Drop it: what ran before goes on."""

    reason: str = ""


Event = Told | Answered | Silence
Action = Wait | Ask | Report | Start | Abort
NOBODY = "the sender fell silent, and nobody was told to start"


def step(state: Ready, event: Event) -> tuple[Ready, Action | None]:
    """What an event makes of a robot that is ready, and what it does. After `Start` and `Abort` nothing follows."""
    match event:
        case Told(phase="abort"):
            return state, Abort()
        case Told(phase="start", begun=begun) if begun or not state.asking:
            return state, Start()
        case Told():
            return state, Report() if state.asking else Wait()
        case Answered(robot, _) if robot not in state.others:
            return state, None
        case Answered(answer="started"):
            return state, Start()
        case Answered(robot, "aborted"):
            return state, Abort(f"the sender fell silent, and {robot} does not start it")
        case Answered(robot, "asking"):
            return _alone_or(replace(state, asked=state.asked | {robot}), None)
        case Silence():
            return _alone_or(replace(state, asking=True), Ask())
    return state, None


def _alone_or(state: Ready, action: Action | None) -> tuple[Ready, Action | None]:
    return state, Abort(NOBODY) if state.asking and not state.unheard else action


def reply(state: Ready | None, *, started: bool) -> str:
    """What a robot answers to another one that asks. `state` is its own if it is ready.

    Whoever answers ``aborted`` promises never to become ready.
    """
    if started:
        return "started"
    if state is None:
        return "aborted"
    return "asking" if state.asking else "ready"
