"""What a robot's end of a deployment knows, receives and does: the data of `fame.deploy.robot_protocol`.

`RobotDeployment` is how far a robot is. A `RobotEvent` is what happens to it, a `RobotAction` what
`fame.deploy.engine_node` does.
"""

from __future__ import annotations

from typing import Literal

from fame.dataclasses import dataclass, replace
from fame.deploy.envelope import Envelope, Problem
from fame.deploy.termination import PeerAnswered, Ready, Silence

# ---- state -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Candidate:
    """A process that is loaded and is to replace what runs.

    commit  what was promised, once it is ready
    asked   whether the other robots have been asked since the sender fell silent
    holds   whether what runs is suspended, since the others did not answer at once
    """

    envelope: Envelope
    stage: Literal["matching", "promising", "ready", "replacing", "starting"] = "matching"
    commit: Ready | None = None
    asked: bool = False
    holds: bool = False

    @property
    def has_promised(self) -> bool:
        """Whether it was answered `ready`."""
        return self.stage in ("ready", "replacing", "starting")

    @property
    def asks(self) -> bool:
        """Whether it asks the other robots, since its sender fell silent."""
        return self.commit is not None and self.commit.asking

    @property
    def why_it_holds(self) -> str:
        """The reason, for people."""
        missing, reborn = (self.commit.unheard, self.commit.reborn) if self.commit is not None else ((), frozenset())
        text = f"the sender fell silent, and what became of it at {', '.join(sorted(missing))} is not known"
        return f"{text}: {', '.join(sorted(reborn))} was started anew" if reborn else text


@dataclass(frozen=True, slots=True)
class Kept:
    """A promise whose process is not loaded: it was set aside for a newer one, or the engine before gave it.

    commit  what was promised and set aside; its robot asked the others, and takes no plain ``start`` any more
    """

    envelope: Envelope
    commit: Ready | None = None

    @property
    def answer(self) -> str:
        """What a robot that asks is told."""
        return "ready" if self.commit is None else "asking"


@dataclass(frozen=True, slots=True)
class RobotDeployment:
    """How far a robot is.

    running  the envelope of what runs, without its model
    waiting  the newest envelope that is not loaded yet; it keeps waiting while it is being loaded
    loading  the envelope whose model is being loaded, even if it has been aborted meanwhile
    newest   `Envelope.order` of the newest that was loaded: older ones are ``stale``
    promises what it was ready to start and has not loaded (again) yet, oldest first
    answers  the last final answer to each of the last 100 deployments, oldest first
    born     as of `Report`: what an engine before may have promised is not known
    """

    robot: str
    running: Envelope | None = None
    waiting: Envelope | None = None
    loading: Envelope | None = None
    candidate: Candidate | None = None
    newest: tuple[int, str] = (-1, "")
    promises: tuple[Kept, ...] = ()
    answers: tuple[Reply, ...] = ()
    born: int = 0

    @property
    def deployed(self) -> str:
        """The deployment that runs, or nothing."""
        return self.running.deployment if self.running is not None else ""

    def answer_to(self, deployment: str) -> Reply | None:
        """Return the last final answer."""
        return next((one for one in self.answers if one.deployment == deployment), None)

    def candidate_of(self, deployment: str) -> Candidate | None:
        """Return the candidate, if it came with this deployment."""
        same = self.candidate is not None and self.candidate.envelope.deployment == deployment
        return self.candidate if same else None

    def knows(self, deployment: str) -> bool:
        """Return whether it is under way here, promised or answered."""
        under_way = any(one is not None and one.deployment == deployment for one in (self.waiting, self.loading))
        answered = self.candidate_of(deployment) is not None or self.answer_to(deployment) is not None
        return under_way or answered or self.kept(deployment) is not None

    def kept(self, deployment: str) -> Kept | None:
        """Return the promise for a deployment, if it waits."""
        return next((kept for kept in self.promises if kept.envelope.deployment == deployment), None)

    @property
    def holds(self) -> bool:
        """Whether what runs is to stay suspended, since the fate of a promise is not known."""
        holds = self.candidate is not None and self.candidate.holds
        return holds or any(kept.commit is not None for kept in self.promises)


def resumed(robot: str, envelope: Envelope, born: int = 0) -> RobotDeployment:
    """Return the state of a robot whose engine goes on with what it had been running."""
    answers = (Reply("started", envelope.deployment),)
    return RobotDeployment(
        robot, running=replace(envelope, model=""), newest=envelope.order, answers=answers, born=born
    )


# ---- events ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Received:
    """An envelope that was read and verified."""

    envelope: Envelope


@dataclass(frozen=True, slots=True)
class LoadDue:
    """The time to load the waiting model has come (after `ScheduleLoad`)."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """The result of `Load`: a process, or an error, with its place where it has one."""

    error: str = ""
    problem: Problem | None = None


@dataclass(frozen=True, slots=True)
class Matched:
    """The result of `AwaitEndpoints`: the promised ends that are missing, as ``topic (publisher)``, and why others do
    not match."""

    missing: tuple[str, ...] = ()
    apart: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Mapped:
    """The result of `MapState`: an error if the state does not fit the new model."""

    error: str = ""


@dataclass(frozen=True, slots=True)
class Promised:
    """The result of `Promise`: an error if the disk refuses it."""

    error: str = ""


@dataclass(frozen=True, slots=True)
class Replaced:
    """What ran has ended, its scripts included (after `Replace`)."""


@dataclass(frozen=True, slots=True)
class Started:
    """The candidate's process runs, and that is on the disk (after `RunCandidate`). `reason`: why not as it was to."""

    reason: str = ""


@dataclass(frozen=True, slots=True)
class Stopped:
    """The engine ends."""


RobotEvent = (
    Received | LoadDue | Loaded | Matched | Mapped | Promised | Silence | PeerAnswered | Replaced | Started | Stopped
)


# ---- actions ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Reply:
    """Report an answer to a deployment. `repeated`: it was given before, so it goes only to the sender that asked."""

    answer: str
    deployment: str
    reason: str = ""
    problem: Problem | None = None
    repeated: bool = False


@dataclass(frozen=True, slots=True)
class Observe:
    """Report to the observer of this engine."""

    text: str


@dataclass(frozen=True, slots=True)
class ScheduleLoad:
    """Give `LoadDue` as soon as all messages of this moment are in: of a burst only the newest is loaded."""


@dataclass(frozen=True, slots=True)
class Load:
    """Read, check and compile the model beside what runs; then give `Loaded`."""

    envelope: Envelope


@dataclass(frozen=True, slots=True)
class Discard:
    """Close the process that has just been loaded: it is not wanted any more."""


@dataclass(frozen=True, slots=True)
class AwaitEndpoints:
    """Wait `Envelope.matching` s for the promised other ends of the candidate's topics; give `Matched`."""

    envelope: Envelope


@dataclass(frozen=True, slots=True)
class MapState:
    """Find out whether the state of what runs fits the candidate; give `Mapped`. It is suspended, unless previewed."""


@dataclass(frozen=True, slots=True)
class Promise:
    """Keep on disk what the robot is about to promise, if it has a state directory; give `Promised`."""


@dataclass(frozen=True, slots=True)
class Forget:
    """A promise that waited is decided: remove it from disk. What runs goes on unless the robot `holds`."""

    deployment: str


@dataclass(frozen=True, slots=True)
class AwaitSender:
    """Give `Silence` after this many seconds, unless this action or the end of the candidate comes before."""

    seconds: float


@dataclass(frozen=True, slots=True)
class AskOthers:
    """Ask the other robots of the deployment what became of it; give `PeerAnswered` for each answer."""


@dataclass(frozen=True, slots=True)
class Hold:
    """Suspend what runs, in the safe state."""


@dataclass(frozen=True, slots=True)
class Drop:
    """Close the candidate; what runs goes on unless the robot `holds`."""


@dataclass(frozen=True, slots=True)
class SetAside:
    """Close the candidate, whose promise stays: a newer one is loaded."""


@dataclass(frozen=True, slots=True)
class Replace:
    """Cancel what runs, or let it stay suspended for a migration; when its scripts have left, give `Replaced`."""


@dataclass(frozen=True, slots=True)
class RunCandidate:
    """Start the candidate's process, or let it take over the state of what ran; then give `Started`.

    A robot with a state directory does so when that is on the disk.
    """


RobotAction = (
    Reply | Observe | ScheduleLoad | Load | Discard | AwaitEndpoints | MapState | Promise | Forget | AwaitSender
    | AskOthers | Hold | Drop | SetAside | Replace | RunCandidate
)  # fmt: skip
