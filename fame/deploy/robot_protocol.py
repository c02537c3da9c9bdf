"""The robot's end of a deployment as a pure state machine: ``step(state, event) -> (state, actions)``.

Theory of operation. A robot has at most one process that runs, one *candidate* to replace it, and one envelope that
waits to be loaded::

    waiting ──> loading ──> matching ──topics are matched──> ready ──start──> replacing ──> starting ──> running
       │           │           └──abort, newer one,            └──abort, or no robot was started
       │           │              topic without other end
       └───────────┴──abort, newer one, model is wrong

The candidate begins when its model is loaded. What runs is not touched before the candidate starts. A bare model (phase
``run``) has no sender that waits for an answer: it is never ready, and starts as soon as its topics are matched.

Invariants, checked for every reachable state in ``tests/test_robot_protocol.py``:

- A robot that answered ``ready`` has given its promise: only ``abort`` of its sender or the decision with the other
  robots (`fame.deploy.termination`) drops the candidate. A newer one waits meanwhile.
- What the engine before had promised is neither refused nor aborted on its own: this one becomes ready for it, too.
- A promise whose robot holds, since nobody knows what became of it, is set aside for a newer deployment. If that starts
  here, the older one is ``stale``; if not, the robot holds for the older one again. It never takes a plain ``start``.
- Of the envelopes that wait only the newest is loaded; the others are answered ``superseded``.
- A promise that the disk refuses is not made (the answer is ``refused``); nor does such a robot ask the others.
- Only what is on the disk is answered ``started``: an engine that is killed before is ready again, and nobody was told
  otherwise. What is starting is not replaced meanwhile.
- What began before this engine was born, and was never received by it, is ``unknown``, never ``aborted``.
- The same deployment is never loaded twice: the last answer to it is repeated.
- Every model is answered in the end.
- What is for a robot without a process replaces none, and nothing that is under way.
- A preview of a migration neither holds nor replaces anything, and is refused while a deployment is under way.

Nothing here sends, waits, loads or looks at a clock: `fame.deploy.engine_node` carries the actions out.
"""

from __future__ import annotations

from dataclasses import replace

from fame.deploy import termination
from fame.deploy.envelope import Envelope, Problem
from fame.deploy.robot_state import (
    AskOthers,
    AwaitEndpoints,
    AwaitSender,
    Candidate,
    Discard,
    Drop,
    Forget,
    Hold,
    Kept,
    Load,
    LoadDue,
    Loaded,
    Mapped,
    MapState,
    Matched,
    Observe,
    Promise,
    Promised,
    Received,
    Replace,
    Replaced,
    Reply,
    RobotAction,
    RobotDeployment,
    RobotEvent,
    RunCandidate,
    ScheduleLoad,
    SetAside,
    Started,
    Stopped,
)
from fame.deploy.termination import Instruction, PeerAnswered, Ready, Silence

ASKING, ASKING_PER_ROBOT = 1.0, 0.1
"""How often a robot that holds asks the other robots, at most and for each of the team (s): each asks all others."""
_ANSWERS = 100
_NOT_LOADED = "no such deployment is loaded here"
_NOT_READY = "it is not ready: the other ends of its topics are not there yet"
_NEWER = "a newer one waits; its sender decides, since others may have been started"
_NOT_READY_FOR_PEER = "the sender fell silent; it was not ready here"
_REBORN = "the engine was started after that deployment began; what the one before promised is not known"
_ENDS = "the engine ends"
_UNDER_WAY = "another deployment is under way; ask again when it is over"
_HAS_ONE = "it has a process, and this was for a robot that has none"
_SET_ASIDE = "its sender fell silent, and a newer deployment is under way"
_REPLACED = "the newer deployment {} was started in its place"
_STARTING = "it starts as soon as its state can be written"


# ---- transitions -----------------------------------------------------------------------------------------------------


def step(state: RobotDeployment, event: RobotEvent) -> tuple[RobotDeployment, tuple[RobotAction, ...]]:
    """Return the next state, and what is to be done in this order. An event that does not fit the
    state changes nothing."""
    move = _Transition(state)
    match event:
        case Received(envelope):
            move.receive(envelope)
        case LoadDue():
            move.load()
        case Loaded():
            move.loaded(event)
        case Matched(missing, apart):
            move.matched(missing, apart)
        case Mapped(error):
            move.mapped(error)
        case Promised(error):
            move.promised(error)
        case Silence() | PeerAnswered():
            move.decide(event)
        case Replaced():
            move.replaced()
        case Started(reason):
            move.started(reason)
        case Stopped():
            move.stop()
    return move.state, tuple(move.actions)


class _Transition:
    """One step: the state as it becomes, and the actions so far."""

    def __init__(self, state: RobotDeployment) -> None:
        self.state = state
        self.actions: list[RobotAction] = []

    # ---- envelopes ----

    def receive(self, envelope: Envelope) -> None:
        deployment, waiting = envelope.deployment, self.state.waiting
        if envelope.phase in ("load", "run"):
            self._receive_model(envelope)
        elif envelope.phase == "ask":
            self._answer_peer(envelope)
        elif (kept := self.state.kept(deployment)) is not None:
            if envelope.phase == "abort":
                self._release(kept)
            elif kept.commit is not None:
                self._do(Reply("asking", deployment, _SET_ASIDE))
        elif waiting is not None and waiting.deployment == deployment:
            if envelope.phase == "abort":
                self.state = replace(self.state, waiting=None)
                self._answer("aborted", deployment)
                self._load_next()
        elif (candidate := self.state.candidate_of(deployment)) is None:
            self._repeat(deployment, Reply("refused", deployment, _NOT_LOADED))
        else:
            self._receive_decision(candidate, Instruction(envelope.phase, envelope.begun))

    def _receive_model(self, envelope: Envelope) -> None:
        deployment, waiting = envelope.deployment, self.state.waiting
        newest = max(self.state.newest, waiting.order) if waiting is not None else self.state.newest
        if envelope.phase == "load" and self._is_known(deployment):
            self._repeat(deployment, Reply("", deployment))
        elif envelope.phase == "load" and envelope.order <= newest and not self._is_promised(deployment):
            self._do(Reply("stale", deployment, f"sequence {envelope.sequence} is not newer than {newest[0]}"))
        elif envelope.joins and self.state.running is not None and not self._is_promised(deployment):
            self._do(Reply("refused", deployment, _HAS_ONE))
        elif self._has_no_room(envelope):
            self._do(Reply("refused", deployment, _UNDER_WAY))
        else:
            self.state = replace(self.state, waiting=envelope)
            if waiting is None:
                self._do(ScheduleLoad())
            elif not self._is_promised(waiting.deployment):
                self._answer("superseded", waiting.deployment)

    def _has_no_room(self, envelope: Envelope) -> bool:
        """Whether something goes first: what the engine before had promised, or what a bare model, a preview or what
        comes late must not set aside."""
        promises = self.state.promises
        if self._is_promised(envelope.deployment):
            return False
        if envelope.preview or envelope.joins:
            return bool(self.state.waiting or self.state.loading or self.state.candidate or promises)
        if not promises:
            return False
        return envelope.phase == "run" or promises[-1].commit is None

    def _is_promised(self, deployment: str) -> bool:
        """Whether a promise for this deployment waits until it is loaded (again)."""
        return self.state.kept(deployment) is not None

    def _release(self, kept: Kept) -> None:
        """Abort, for the sender or a person, what was promised and is not loaded."""
        deployment, waiting = kept.envelope.deployment, self.state.waiting
        self._forget(deployment)
        if waiting is not None and waiting.deployment == deployment:
            self.state = replace(self.state, waiting=None)
        if self.state.candidate_of(deployment) is not None:
            self._drop("aborted")
        else:
            self._answer("aborted", deployment)
            self._load_next()

    def _forget(self, deployment: str) -> None:
        """Drop a promise that waited: it is decided."""
        if self._taken(deployment) is not None:
            self._do(Forget(deployment))

    def _taken(self, deployment: str) -> Kept | None:
        """Take the promise for a deployment out of those that wait. Returns it, if there was one."""
        kept = self.state.kept(deployment)
        self.state = replace(self.state, promises=tuple(one for one in self.state.promises if one is not kept))
        return kept

    def _is_known(self, deployment: str) -> bool:
        """Whether a deployment is under way or was answered."""
        waiting = self.state.waiting
        under_way = (waiting is not None and waiting.deployment == deployment) or self.state.candidate_of(deployment)
        return bool(under_way) or self.state.answer_to(deployment) is not None

    def _receive_decision(self, candidate: Candidate, instruction: Instruction) -> None:
        """Follow the sender's word on the candidate; one that is being started already needs none."""
        deployment = candidate.envelope.deployment
        if candidate.stage == "ready":
            self.decide(instruction)
            self._ask_sender_for_room()
        elif not candidate.has_promised and instruction.phase == "abort":
            self._drop("aborted")
        elif not candidate.has_promised and instruction.phase == "start":
            self._do(Reply("refused", deployment, _NOT_READY))
        elif candidate.stage == "starting":
            self._do(Reply("ready", deployment, _STARTING))

    def _answer_peer(self, envelope: Envelope) -> None:
        """Tell another robot, whose sender is silent, the outcome of the deployment here."""
        deployment = envelope.deployment
        candidate = self.state.candidate_of(deployment)
        if candidate is not None and candidate.stage in ("replacing", "starting"):
            return  # `started` follows as soon as that is on the disk
        answered = self.state.answer_to(deployment)
        running = self.state.running is not None and self.state.running.deployment == deployment
        started = running or (answered is not None and answered.answer == "started")
        if (kept := self.state.kept(deployment)) is not None:
            self._do(Reply(kept.answer, deployment))
            return
        if answered is not None and answered.answer == "stale":  # it asked, and has started a newer one since
            self._do(Reply("asking", deployment, answered.reason))
            return
        answer = termination.reply(candidate.commit if candidate is not None else None, started=started)
        if answer == "aborted" and envelope.born != self.state.born and not self.state.knows(deployment):
            self._do(Reply("unknown", deployment, _REBORN))
            return
        reason = _NOT_READY_FOR_PEER if answer == "aborted" else ""
        if answer == "aborted":
            self._renounce(envelope, reason)
        self._do(Reply(answer, deployment, reason))

    def _renounce(self, envelope: Envelope, reason: str) -> None:
        """Never become ready for a deployment: neither now nor when its model arrives later."""
        self.state = replace(self.state, newest=max(self.state.newest, envelope.order))
        if self.state.waiting is not None and self.state.waiting.deployment == envelope.deployment:
            self.state = replace(self.state, waiting=None)
            self._answer("aborted", envelope.deployment, reason)
        elif self.state.candidate_of(envelope.deployment) is not None:
            self._drop("aborted", reason)

    # ---- from the envelope that waits to the candidate ----

    def load(self) -> None:
        envelope, candidate = self.state.waiting, self.state.candidate
        if envelope is None or self.state.loading is not None:
            return
        if candidate is not None and self._is_promised(candidate.envelope.deployment):
            self._set_aside()
        elif candidate is not None and candidate.stage == "ready" and candidate.holds and envelope.phase == "load":
            self.state = replace(
                self.state, promises=(*self.state.promises, Kept(candidate.envelope, candidate.commit))
            )
            self._set_aside()
        elif candidate is not None and candidate.stage == "starting":
            self.state = replace(self.state, waiting=None)
            self._answer("refused", envelope.deployment, f"{candidate.envelope.deployment}: {_STARTING}")
            return
        elif candidate is not None and candidate.has_promised:
            self._ask_sender_for_room()
            return
        self._drop("superseded")
        self.state = replace(self.state, loading=envelope, newest=max(self.state.newest, envelope.order))
        self._do(Load(envelope))

    def loaded(self, result: Loaded) -> None:
        envelope, wanted = self.state.loading, self.state.waiting == self.state.loading
        if envelope is None:
            return
        self.state = replace(self.state, loading=None, waiting=None if wanted else self.state.waiting)
        if wanted and result.error:
            self._forget(envelope.deployment)
            self._answer("refused", envelope.deployment, result.error, result.problem)
            self._load_next()
        elif wanted:
            self.state = replace(self.state, candidate=Candidate(envelope))
            self._do(AwaitEndpoints(envelope))
        else:
            if not result.error:
                self._do(Discard())
            self._load_next()

    def matched(self, missing: tuple[str, ...], apart: tuple[str, ...]) -> None:
        candidate = self.state.candidate
        if candidate is None or candidate.stage != "matching":
            return
        if (missing or apart) and not self._is_promised(candidate.envelope.deployment):
            absent = f"{', '.join(missing)} not discovered within {candidate.envelope.matching:g} s" if missing else ""
            self._drop("refused", "; ".join(filter(None, (*apart, absent))))
        elif candidate.envelope.phase == "run":
            self._replace(candidate)
        elif candidate.envelope.migrate and self.state.running is not None:
            self._do(*([] if candidate.envelope.preview else [Hold()]), MapState())
        elif candidate.envelope.preview:
            self._drop("previewed", "it runs nothing, and would start the model")
        else:
            self._promise(candidate)

    def mapped(self, error: str) -> None:
        candidate = self.state.candidate
        if candidate is None or candidate.stage != "matching":
            return
        if candidate.envelope.preview:
            self._drop("previewed", error)
        elif error and not self._is_promised(candidate.envelope.deployment):
            self._drop("refused", error)
        else:
            self._promise(candidate)

    def _promise(self, candidate: Candidate) -> None:
        self.state = replace(self.state, candidate=replace(candidate, stage="promising"))
        if (kept := self._taken(candidate.envelope.deployment)) is not None:  # it is on the disk
            self._become_ready(candidate, kept.commit)
        else:
            self._do(Promise())

    def promised(self, error: str) -> None:
        """Become ready: from now on only the sender, or the others of its team, decide. With an `error`, refuse."""
        candidate = self.state.candidate
        if candidate is None or candidate.stage != "promising":
            return
        if error:
            self._drop("refused", error)
            return
        self._become_ready(candidate, None)

    def _become_ready(self, candidate: Candidate, commit: Ready | None) -> None:
        """Answer `ready`, or go on asking with the `commit` of a promise that was set aside: then the robot holds."""
        if commit is None:
            commit = Ready(frozenset(candidate.envelope.team) - {self.state.robot})
        holds = commit.asking
        candidate = replace(candidate, stage="ready", commit=commit, asked=holds, holds=holds)
        self.state = replace(self.state, candidate=candidate)
        if holds:
            self._do(
                Hold(),
                _await_answers(candidate),
                Reply("asking", candidate.envelope.deployment, candidate.why_it_holds),
            )
        else:
            self._do(AwaitSender(candidate.envelope.silence))
            self._answer("ready", candidate.envelope.deployment)

    def _set_aside(self) -> None:
        self.state = replace(self.state, candidate=None)
        self._do(SetAside())

    # ---- a candidate that is ready ----

    def decide(self, event: termination.TerminationEvent) -> None:
        candidate = self.state.candidate
        if candidate is None or candidate.commit is None or candidate.stage != "ready":
            return
        commit, action = termination.step(candidate.commit, event)
        candidate = replace(candidate, commit=commit)
        self.state = replace(self.state, candidate=candidate)
        match action:
            case termination.KeepWaiting():
                self._do(AwaitSender(candidate.envelope.silence))
            case termination.Ask():
                self._ask_others(candidate)
            case termination.ReportAsking():
                self._do(Reply("asking", candidate.envelope.deployment, candidate.why_it_holds))
            case termination.StartCandidate():
                self._replace(candidate)
            case termination.Abort(reason):
                self._drop("aborted", reason)

    def _ask_others(self, candidate: Candidate) -> None:
        """Ask the other robots. Those that are there answer at once: only a robot that asks again has to hold."""
        self._do(AskOthers(), _await_answers(candidate))
        self._do(Reply("asking", candidate.envelope.deployment, candidate.why_it_holds))
        if candidate.asked:
            self._hold(candidate)
        holds = candidate.asked
        self.state = replace(self.state, candidate=replace(candidate, asked=True, holds=holds))

    def _hold(self, candidate: Candidate) -> None:
        reason = f"holds deployment {candidate.envelope.deployment}: {candidate.why_it_holds}"
        if not candidate.holds:
            self._do(Hold(), Observe(reason))
        waiting = self.state.waiting
        if waiting is not None and waiting.phase == "load":
            self._load_next()
        elif waiting is not None:
            self.state = replace(self.state, waiting=None)
            self._answer("refused", waiting.deployment, f"{reason}; fame abort {self.state.robot} ends that")

    def _ask_sender_for_room(self) -> None:
        """Tell the sender of a candidate that is ready that a newer one waits: the promise itself stays."""
        candidate = self.state.candidate
        if self.state.waiting is not None and candidate is not None and candidate.stage == "ready":
            self._do(Reply("superseded", candidate.envelope.deployment, _NEWER))

    # ---- the end of a candidate ----

    def _replace(self, candidate: Candidate) -> None:
        self.state = replace(self.state, candidate=replace(candidate, stage="replacing"))
        self._do(Replace())

    def replaced(self) -> None:
        candidate = self.state.candidate
        if candidate is not None and candidate.stage == "replacing":
            self.state = replace(self.state, candidate=replace(candidate, stage="starting"))
            self._do(RunCandidate())
            self._load_next()

    def started(self, reason: str) -> None:
        candidate = self.state.candidate
        if candidate is None or candidate.stage != "starting":
            return
        envelope, promises = candidate.envelope, self.state.promises
        self.state = replace(self.state, candidate=None, running=replace(envelope, model=""), promises=())
        if envelope.again:
            reason = "it had this process before, and takes it up again from the start"
        if reason:
            self._do(Observe(reason))
        self._answer("started", envelope.deployment, reason)
        for kept in promises:
            self._answer("stale", kept.envelope.deployment, _REPLACED.format(envelope.deployment))
        self._load_next()

    def _drop(self, answer: str, reason: str = "") -> None:
        """Forget the candidate, if there is one, with a final answer."""
        if (candidate := self.state.candidate) is not None:
            self.state = replace(self.state, candidate=None)
            self._do(Drop())
            self._answer(answer, candidate.envelope.deployment, reason)
            self._load_next()

    def stop(self) -> None:
        waiting, candidate = self.state.waiting, self.state.candidate
        promises = {kept.envelope.deployment for kept in self.state.promises}
        self.state = replace(self.state, waiting=None, promises=())
        if waiting is not None and waiting.deployment not in promises:
            self._answer("aborted", waiting.deployment, _ENDS)
        if candidate is not None:  # after a promise not even a robot that ends may say that it aborted
            promised = candidate.has_promised or candidate.envelope.deployment in promises
            self._drop("left" if promised else "aborted", _ENDS)
        for deployment in sorted(promises - {candidate.envelope.deployment if candidate is not None else ""}):
            self._answer("left", deployment, _ENDS)

    # ---- actions ----

    def _do(self, *actions: RobotAction) -> None:
        self.actions += actions

    def _load_next(self) -> None:
        """Load what waits; else, unless something is under way, the newest promise that was set aside."""
        promises, under_way = self.state.promises, self.state.loading or self.state.candidate
        if self.state.waiting is None and promises and promises[-1].commit is not None and not under_way:
            self.state = replace(self.state, waiting=promises[-1].envelope)
        if self.state.waiting is not None and self.state.loading is None:
            self._do(ScheduleLoad())

    def _answer(self, answer: str, deployment: str, reason: str = "", problem: Problem | None = None) -> None:
        """Give an answer that is repeated to every sender that asks again."""
        reply = Reply(answer, deployment, reason, problem)
        others = tuple(one for one in self.state.answers if one.deployment != deployment)
        self.state = replace(self.state, answers=(*others, reply)[-_ANSWERS:])
        self._do(reply)

    def _repeat(self, deployment: str, otherwise: Reply) -> None:
        known = self.state.answer_to(deployment)
        self._do(replace(known, repeated=True) if known is not None else otherwise)


def _await_answers(candidate: Candidate) -> AwaitSender:
    return AwaitSender(max(ASKING, ASKING_PER_ROBOT * len(candidate.envelope.team)))
