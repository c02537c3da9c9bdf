"""The robot's end of a deployment decides as it should, in every state that it can reach and without any middleware."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import pytest

from fame.deploy.envelope import Envelope, Problem
from fame.deploy.robot_protocol import step
from fame.deploy.robot_state import (
    AskOthers,
    AwaitEndpoints,
    AwaitSender,
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
from fame.deploy.termination import NONE_STARTED, PeerAnswered, Silence

FIRST = Envelope(deployment="d1", sequence=1, robot="A", phase="load", team=["A", "B"])
SECOND = replace(FIRST, deployment="d2", sequence=2)
THIRD = replace(FIRST, deployment="d3", sequence=3)
JOINS = replace(THIRD, joins=True)
BARE = Envelope(deployment="plain-1", sequence=-1, robot="A", phase="run")


def after(*events: RobotEvent, robot: str = "A") -> tuple[RobotDeployment, list[RobotAction]]:
    """The state after some events, and what is to be done for the last one."""
    state, actions = RobotDeployment(robot), ()
    for event in events:
        state, actions = step(state, event)
    return state, list(actions)


def told(phase: str, envelope: Envelope = FIRST, **options) -> Received:
    return Received(replace(envelope, phase=phase, **options))


LOADED = (Received(FIRST), LoadDue(), Loaded())
READY = (*LOADED, Matched(), Promised())
STARTING = (*READY, told("start"), Replaced())
RUNS = (*STARTING, Started())
MIGRATES = (Received(replace(SECOND, migrate=True)), LoadDue(), Loaded(), Matched())
PREVIEWS = (Received(replace(SECOND, migrate=True, preview=True)), LoadDue(), Loaded(), Matched())
UNDER_WAY = "another deployment is under way; ask again when it is over"
HAS_ONE = "it has a process, and this was for a robot that has none"
REBORN = "the engine was started after that deployment began; what the one before promised is not known"
WHEN_WRITTEN = "it starts as soon as its state can be written"
NOT_READY = "the sender fell silent; it was not ready here"
HOLDS = (*READY, Silence(), Silence())
WHY = "the sender fell silent, and what became of it at B is not known"
HELD = f"holds deployment d1: {WHY}; fame abort A ends that"
ASKS = [AskOthers(), AwaitSender(1.0), Reply("asking", "d1", WHY)]
ASIDE = (*HOLDS, Received(SECOND), LoadDue())
AWAY = "its sender fell silent, and a newer deployment is under way"
REPLACED = "the newer deployment d2 was started in its place"
NEWER = (*ASIDE, Loaded(), Matched(), Promised(), told("start", SECOND), Replaced(), Started())
AGAIN = (*ASIDE, Loaded(), told("abort", SECOND), LoadDue(), Loaded(), Matched())


@pytest.mark.parametrize(
    ("events", "actions"),
    [
        ((Received(FIRST),), [ScheduleLoad()]),
        ((Received(FIRST), LoadDue()), [Load(FIRST)]),
        ((Received(BARE), LoadDue(), Loaded(), Matched()), [Replace()]),
        (LOADED, [AwaitEndpoints(FIRST)]),
        (READY, [AwaitSender(5.0), Reply("ready", "d1")]),
        ((*READY, told("hold")), [AwaitSender(5.0)]),
        (
            (Received(replace(FIRST, silence=25.0)), LoadDue(), Loaded(), Matched(), Promised()),
            [AwaitSender(25.0), Reply("ready", "d1")],
        ),
        ((*RUNS, *MIGRATES), [Hold(), MapState()]),
        ((*RUNS, *MIGRATES, Mapped()), [Promise()]),
        ((*LOADED, Matched()), [Promise()]),
        ((*LOADED, Matched(), Promised("full")), [Drop(), Reply("refused", "d1", "full")]),
        ((*LOADED, Matched(), told("abort")), [Drop(), Reply("aborted", "d1")]),
        ((*LOADED, Matched(), Stopped()), [Drop(), Reply("aborted", "d1", "the engine ends")]),
        ((told("ask", born=7),), [Reply("unknown", "d1", REBORN)]),
        ((*HOLDS, Received(SECOND)), [ScheduleLoad()]),
        ((*ASIDE,), [SetAside(), Load(SECOND)]),
        ((*HOLDS, Received(BARE), Silence()), [*ASKS, Reply("refused", BARE.deployment, HELD)]),
        ((*ASIDE, told("ask")), [Reply("asking", "d1")]),
        ((*ASIDE, told("start")), [Reply("asking", "d1", AWAY)]),
        ((*ASIDE, told("abort")), [Forget("d1"), Reply("aborted", "d1")]),
        ((*ASIDE, Received(BARE)), [Reply("refused", BARE.deployment, UNDER_WAY)]),
        ((*ASIDE, Loaded("is wrong")), [Reply("refused", "d2", "is wrong"), ScheduleLoad()]),
        ((*ASIDE, Loaded(), told("abort", SECOND)), [Drop(), Reply("aborted", "d2"), ScheduleLoad()]),
        (
            (*ASIDE, Loaded(), Received(THIRD), LoadDue()),
            [Drop(), Reply("superseded", "d2"), ScheduleLoad(), Load(THIRD)],
        ),
        ((*AGAIN,), [Hold(), AwaitSender(1.0), Reply("asking", "d1", WHY)]),
        ((*AGAIN, Received(SECOND)), [Reply("aborted", "d2", repeated=True)]),
        ((*AGAIN, Received(THIRD), LoadDue()), [SetAside(), Load(THIRD)]),
        ((*NEWER, told("ask")), [Reply("asking", "d1", REPLACED)]),
        ((*NEWER[:-1], Started()), [Reply("started", "d2"), Reply("stale", "d1", REPLACED)]),
        ((*ASIDE, Stopped()), [Reply("aborted", "d2", "the engine ends"), Reply("left", "d1", "the engine ends")]),
        (
            (Received(FIRST), told("ask", born=7)),
            [Reply("aborted", "d1", NOT_READY), Reply("aborted", "d1", NOT_READY)],
        ),
        ((*HOLDS, PeerAnswered("B", "unknown")), []),
        ((*RUNS, *MIGRATES, Mapped(), Promised()), [AwaitSender(5.0), Reply("ready", "d2")]),
        ((*RUNS, *MIGRATES, Mapped("no")), [Drop(), Reply("refused", "d2", "no")]),
        ((*RUNS, *PREVIEWS), [MapState()]),
        ((*RUNS, *PREVIEWS, Mapped("no")), [Drop(), Reply("previewed", "d2", "no")]),
        ((Received(JOINS), LoadDue()), [Load(JOINS)]),
        ((*RUNS, Received(JOINS)), [Reply("refused", "d3", HAS_ONE)]),
        *(((*before, Received(JOINS)), [Reply("refused", "d3", UNDER_WAY)]) for before in (READY, LOADED, HOLDS)),
        ((*READY, PREVIEWS[0]), [Reply("refused", "d2", UNDER_WAY)]),
        ((*LOADED, PREVIEWS[0]), [Reply("refused", "d2", UNDER_WAY)]),
        ((Received(FIRST), PREVIEWS[0]), [Reply("refused", "d2", UNDER_WAY)]),
        ((*READY, told("start")), [Replace()]),
        (STARTING, [RunCandidate()]),
        (RUNS, [Reply("started", "d1")]),
        ((*STARTING, told("ask")), []),
        ((*STARTING, told("start")), [Reply("ready", "d1", WHEN_WRITTEN)]),
        ((*STARTING, told("abort")), [Reply("ready", "d1", WHEN_WRITTEN)]),
        ((*STARTING, Received(SECOND), LoadDue()), [Reply("refused", "d2", f"d1: {WHEN_WRITTEN}")]),
        ((*READY, told("start"), Received(SECOND), LoadDue(), Replaced()), [RunCandidate(), ScheduleLoad()]),
        ((*READY, told("start"), Received(SECOND), LoadDue(), *RUNS[-2:]), [Reply("started", "d1"), ScheduleLoad()]),
        ((*STARTING, Stopped()), [Drop(), Reply("left", "d1", "the engine ends")]),
        ((*READY, told("abort")), [Drop(), Reply("aborted", "d1")]),
        ((*LOADED, told("abort")), [Drop(), Reply("aborted", "d1")]),
        ((Received(FIRST), told("abort")), [Reply("aborted", "d1")]),
        ((Received(FIRST), LoadDue(), told("abort"), Loaded()), [Discard()]),
        ((*READY, told("start"), Received(FIRST)), [Reply("ready", "d1", repeated=True)]),
        ((*READY, Received(FIRST)), [Reply("ready", "d1", repeated=True)]),
        ((Received(FIRST), Received(FIRST)), [Reply("", "d1")]),
        ((Received(FIRST), Received(SECOND)), [Reply("superseded", "d1")]),
        ((Received(SECOND), Received(FIRST)), [Reply("stale", "d1", "sequence 1 is not newer than 2")]),
        (
            (Received(replace(SECOND, deployment="d9")), Received(SECOND)),
            [Reply("stale", "d2", "sequence 2 is not newer than 2")],
        ),
        ((*LOADED, Received(SECOND), LoadDue()), [Drop(), Reply("superseded", "d1"), ScheduleLoad(), Load(SECOND)]),
        ((*READY, Stopped()), [Drop(), Reply("left", "d1", "the engine ends")]),
        ((*READY, told("start"), Stopped()), [Drop(), Reply("left", "d1", "the engine ends")]),
        ((*LOADED, Stopped()), [Drop(), Reply("aborted", "d1", "the engine ends")]),
        ((*READY, told("ask")), [Reply("ready", "d1")]),
        ((*RUNS, told("ask")), [Reply("started", "d1")]),
        ((*HOLDS, PeerAnswered("B", "started")), [Replace()]),
        ((*HOLDS, PeerAnswered("B", "asking")), [Drop(), Reply("aborted", "d1", NONE_STARTED)]),
    ],
)
def test_what_a_robot_does(events, actions):
    assert after(*events)[1] == actions


def test_a_model_that_is_wrong_is_refused_with_its_place():
    problem = Problem("A.bpmn", 3, "t", "is wrong")
    _, actions = after(Received(FIRST), LoadDue(), Loaded(str(problem), problem))
    assert actions == [Reply("refused", "d1", "A.bpmn:3: t: is wrong", problem)]


def test_what_runs_is_suspended_when_the_others_did_not_answer_at_once():
    assert Hold() not in after(*READY, Silence())[1]
    asked, wait, report, hold, note = after(*HOLDS)[1]
    assert (asked, wait, hold) == (AskOthers(), AwaitSender(1.0), Hold())
    assert (report.answer, note.text) == ("asking", f"holds deployment d1: {report.reason}")
    assert not {Hold, Observe} & set(map(type, after(*HOLDS, Silence())[1]))


def test_robots_of_a_large_team_ask_each_other_less_often():
    team = [f"R{number}" for number in range(100)]
    large = replace(FIRST, robot="R0", team=team, silence=50.0)
    ready = (Received(large), LoadDue(), Loaded(), Matched(), Promised())
    assert AwaitSender(10.0) in after(*ready, Silence(), robot="R0")[1]


def test_a_robot_that_has_answered_aborted_to_another_one_never_becomes_ready():
    state, actions = after(told("ask"), Received(FIRST))
    assert [action.answer for action in actions] == ["stale"]
    assert state.waiting is None


def test_an_answer_is_remembered_for_a_hundred_deployments():
    events = [Received(replace(FIRST, deployment=f"d{number}", sequence=number)) for number in range(150)]
    state, _ = after(*events)
    assert [reply.deployment for reply in state.answers] == [f"d{number}" for number in range(49, 149)]


# ---- every state that a robot can reach ------------------------------------------------------------------------------


ANY_TIME = (
    *(told(phase) for phase in ("load", "hold", "start", "abort", "ask")),
    told("ask", born=7),
    told("start", begun=True),
    *(told(phase, SECOND) for phase in ("load", "start", "abort")),
    Received(JOINS),
    Received(BARE),
    LoadDue(),
    Stopped(),
)


def possible(state: RobotDeployment) -> Iterator[RobotEvent]:
    """The events that can happen in a state: anything may be received, results follow what was begun."""
    yield from ANY_TIME
    if state.promises:
        yield Received(state.promises[-1].envelope)
    if state.loading is not None:
        yield from (Loaded(), Loaded("is wrong"))
    stage = state.candidate.stage if state.candidate is not None else ""
    if stage == "matching":
        yield from (Matched(), Matched(("/go (subscriber)",)))
    if stage == "promising":
        yield from (Promised(), Promised("the disk is full"))
    if stage == "ready":
        yield from (
            Silence(),
            *(PeerAnswered("B", each) for each in ("started", "aborted", "asking", "ready", "unknown")),
        )
    if stage == "replacing":
        yield Replaced()
    if stage == "starting":
        yield Started()


@cache
def reachable() -> list[tuple[RobotDeployment, RobotEvent, RobotDeployment, tuple[RobotAction, ...]]]:
    first = {RobotDeployment("A"), RobotDeployment("A", promises=(Kept(FIRST),))}
    seen, left, transitions = set(first), list(first), []
    while left:
        state = left.pop()
        for event in possible(state):
            following, actions = step(state, event)
            transitions.append((state, event, following, actions))
            following = replace(following, answers=summary(following.answers))
            if following not in seen:
                seen.add(following)
                left.append(following)
    return transitions


def summary(answers: tuple[Reply, ...]) -> tuple[Reply, ...]:
    """Of old answers the protocol asks only whether there is one and whether it was ``started``."""
    brief = {reply.deployment: reply.answer == "started" for reply in answers if reply.deployment != BARE.deployment}
    return tuple(Reply("started" if brief[name] else "aborted", name) for name in sorted(brief))


def test_every_transition_keeps_what_the_protocol_promises():
    states = set()
    for state, event, following, actions in reachable():
        states.add(following)
        about = (state, event, following, actions)
        assert following.loading is None or following.candidate is None, about
        answers = [action for action in actions if isinstance(action, Reply) and not action.repeated]
        if state.running != following.running:
            assert event == Started(), about
            assert state.candidate is not None, about
            assert state.candidate.stage == "starting", about
        promised = state.candidate is not None and state.candidate.has_promised
        said = {answer.answer for answer in answers}
        if "ready" in said:
            assert event == Promised() or promised or state.promises, about  # only what is on the disk is promised
        if "started" in said:
            assert event == Started() or state.answer_to(event.envelope.deployment).answer == "started", about
        if isinstance(event, Received) and event.envelope.born and "aborted" in said:
            assert state.waiting or state.candidate or state.loading or state.answer_to("d1"), about
        for kept in state.promises:
            final = {one.answer for one in answers if one.deployment == kept.envelope.deployment}
            if {"aborted", "refused", "superseded"} & final:  # nor does an engine that is born again
                assert event in (told("abort", kept.envelope), Loaded("is wrong")), about
            if state.kept(kept.envelope.deployment) and not following.kept(kept.envelope.deployment):
                ready = following.candidate_of(kept.envelope.deployment)
                assert final or Forget(kept.envelope.deployment) in actions or (ready and ready.has_promised), about
        if promised and isinstance(event, Received | LoadDue):
            deployment = state.candidate.envelope.deployment
            kept = following.candidate_of(deployment) or following.kept(deployment)
            assert kept or event.envelope.phase == "abort", about  # a newer model never breaks a promise
        if SetAside() in actions:
            assert following.holds or not state.holds, about  # what runs stays suspended
        if isinstance(event, Stopped) and promised:
            said = [answer.answer for answer in answers if answer.deployment == state.candidate.envelope.deployment]
            assert said[-1] == "left", about  # others may have started
        if Load(SECOND) in actions or Load(FIRST) in actions:
            again = following.kept(following.loading.deployment)
            assert again or following.answer_to(following.loading.deployment) is None, about  # never loaded twice
        if Load(JOINS) in actions:
            assert (state.running, state.candidate, state.promises) == (None, None, ()), about  # it replaces nothing
        if following.waiting is not None and state.waiting is None:
            assert ScheduleLoad() in actions, about
        if state.waiting is not None and following.waiting not in (None, state.waiting):
            kept = state.kept(state.waiting.deployment)
            assert kept or any(one.deployment == state.waiting.deployment for one in answers), about
    assert len(states) > 500


def test_what_the_engine_before_promised_is_loaded_though_a_newer_one_was_renounced():
    state, actions = step(RobotDeployment("A", promises=(Kept(FIRST),)), told("ask", SECOND, born="earlier"))
    assert [one for one in actions if isinstance(one, Reply)][-1].deployment == "d2"
    assert step(replace(state, newest=SECOND.order), Received(FIRST))[1] == (ScheduleLoad(),)


def test_a_robot_that_nobody_talks_to_any_more_comes_to_rest():
    """Results arrive and timers fire, but no envelope: whatever waits is loaded, and no promise is made forever."""
    for state in {following for _, _, following, _ in reachable()}:
        for _ in range(20):
            if (event := next_result(state)) is None:
                break
            state, _ = step(state, event)
        assert state.waiting is None or state.candidate is not None, state
        assert not state.promises or state.candidate is not None, state
        assert state.loading is None, state
        assert state.candidate is None or state.candidate.asks, state


def next_result(state: RobotDeployment) -> RobotEvent | None:
    if state.loading is not None:
        return Loaded()
    if state.promises and state.candidate is None and state.waiting is None:
        return Received(state.promises[-1].envelope)
    if state.candidate is None:
        return LoadDue() if state.waiting is not None else None
    if state.candidate.stage == "matching":
        return Matched()
    if state.candidate.stage == "promising":
        return Promised()
    if state.candidate.stage == "replacing":
        return Replaced()
    if state.candidate.stage == "starting":
        return Started()
    return None if state.candidate.holds else Silence()
