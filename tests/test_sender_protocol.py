"""The sender's end of a deployment decides as it should; together with the robots' ends all start or none does."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import pytest

from fame.clock import SECOND
from fame.deploy import robot_protocol, robot_state, termination
from fame.deploy.envelope import Envelope
from fame.deploy.options import DeploymentOptions
from fame.deploy.robot_state import RobotDeployment
from fame.deploy.sender_protocol import (
    HOLDING,
    REFUSALS,
    Approve,
    Approved,
    Begun,
    CancelTimers,
    Closed,
    End,
    PatienceEnded,
    Prepare,
    Refused,
    RivalFound,
    RobotAnswered,
    RobotProgress,
    SendEnvelope,
    SenderAction,
    SenderEvent,
    SenderState,
    StartTimer,
    StatusReceived,
    TimerFired,
    step,
)

NEW = SenderState((RobotProgress("A"), RobotProgress("B")), sequence=7)
LATE = 100 * SECOND


def answered(robot: str, answer: str, now: int = 0) -> RobotAnswered:
    return RobotAnswered(robot, answer, "", now)


def after(*events: SenderEvent, state: SenderState = NEW) -> tuple[SenderState, list[SenderAction]]:
    """The state after some events, and what is to be done for the last one."""
    actions: tuple[SenderAction, ...] = ()
    for event in events:
        state, actions = step(state, event)
    return state, list(actions)


LOAD = (Begun(0), StatusReceived("A", 3), StatusReceived("B", 9), TimerFired(0))
READY = (*LOAD, answered("A", "ready"), answered("B", "ready"))
ABORT = [CancelTimers(), SendEnvelope("A", "abort"), SendEnvelope("B", "abort"), End()]


@pytest.mark.parametrize(
    ("events", "actions"),
    [
        ((Begun(0),), [StartTimer(0.02)]),
        ((Begun(0), StatusReceived("A", 3), TimerFired(0)), [StartTimer(0.02)]),
        (
            (Begun(0), TimerFired(SECOND)),
            [Prepare(), SendEnvelope("A", "load"), SendEnvelope("B", "load"), StartTimer(1.0)],
        ),
        (LOAD, [Prepare(), SendEnvelope("A", "load"), SendEnvelope("B", "load"), StartTimer(1.0)]),
        (
            (*LOAD, answered("A", "ready"), TimerFired(0)),
            [SendEnvelope("A", "hold"), SendEnvelope("B", "load"), StartTimer(1.0)],
        ),
        (READY, [SendEnvelope("A", "start"), SendEnvelope("B", "start"), StartTimer(1.0)]),
        ((*READY, answered("A", "started"), TimerFired(0)), [SendEnvelope("B", "start", begun=True), StartTimer(1.0)]),
        ((*READY, answered("A", "started"), answered("B", "started")), [CancelTimers(), End()]),
        ((*READY, answered("A", "superseded")), []),
        ((*READY, Closed()), [CancelTimers()]),
        ((*READY, PatienceEnded(10.0)), [CancelTimers(), End()]),
        ((*LOAD, answered("A", "asking")), ABORT),
        ((*LOAD, RivalFound("A")), ABORT),
        ((*LOAD, Refused("it is late")), ABORT),
        ((*READY, Refused("it is late")), []),
        ((*LOAD, PatienceEnded(10.0)), ABORT),
        ((*LOAD, Closed()), ABORT[:-1]),
        ((*LOAD, TimerFired(LATE)), ABORT),
        ((*LOAD, answered("A", "ready"), answered("B", "ready", LATE)), ABORT),
        ((Begun(0), PatienceEnded(10.0)), [CancelTimers(), End()]),
        ((*LOAD, answered("A", "refused"), answered("B", "ready"), TimerFired(0)), []),
    ],
)
def test_what_a_sender_does(events, actions):
    assert after(*events)[1] == actions


HUNDRED = replace(NEW, robots=tuple(RobotProgress(f"R{number}") for number in range(100)))


def test_a_large_team_is_asked_less_often():
    said = [StatusReceived(each.robot, 3) for each in HUNDRED.robots]
    assert after(Begun(0), *said, TimerFired(0), state=HUNDRED)[1][-1] == StartTimer(5.0)


def test_a_deployment_waits_longer_for_a_large_team_and_on_a_busy_machine():
    assert [DeploymentOptions(load=lambda load=load: load).patience_of(20) for load in (1.0, 3.0)] == [20, 60]
    assert DeploymentOptions(load=lambda: 3.0).patience_of(2) == 30
    assert DeploymentOptions(load=lambda: 3.0, patience=7.0).patience_of(20) == 7.0


def test_robots_wait_longer_for_the_sender_of_a_large_team_and_for_one_whose_timers_are_late():
    assert NEW.silence == 5
    assert HUNDRED.silence == 50
    late = after(Begun(0), TimerFired(round(1.52 * SECOND)), TimerFired(3 * SECOND))[0]
    assert late.silence == pytest.approx(7.5)
    assert after(TimerFired(10 * SECOND), state=late)[0].silence == late.silence  # robots have been told
    assert after(Begun(0), TimerFired(LATE))[0].silence == 30


def test_a_sender_that_robots_still_wait_for_goes_on():
    late = (Begun(0), StatusReceived("A", 3), StatusReceived("B", 9), TimerFired(2 * SECOND))
    assert after(*late, TimerFired(9 * SECOND))[0].phase == "load"
    assert after(*late, TimerFired(13 * SECOND))[0].failed


HELD = [SendEnvelope("A", "hold"), SendEnvelope("B", "hold")]
TOO_LONG = round(HOLDING * SECOND)


@pytest.mark.parametrize(
    ("events", "actions"),
    [
        (READY, [Approve()]),
        ((*READY, Approved("", 0)), [SendEnvelope("A", "start"), SendEnvelope("B", "start"), StartTimer(1.0)]),
        ((*READY, Approved("B waits forever", 0)), ABORT),
        ((*READY, TimerFired(SECOND)), [*HELD, StartTimer(1.0)]),
        ((*READY, TimerFired(SECOND), TimerFired(4 * SECOND)), [*HELD, StartTimer(HOLDING - 4)]),
        ((*READY, TimerFired(SECOND), TimerFired(TOO_LONG)), ABORT),
        ((*READY, TimerFired(TOO_LONG), Approved("", TOO_LONG)), []),
        ((*READY, answered("B", "superseded")), ABORT),
        ((*READY, answered("B", "superseded"), Approved("", 0)), []),
        ((*READY, Closed()), ABORT[:-1]),
    ],
)
def test_a_migration_starts_when_it_is_approved_and_not_later_than_robots_may_be_held(events, actions):
    assert after(*events, state=replace(NEW, migrates=True))[1] == actions


def test_without_a_migration_nobody_is_held_and_robots_may_take_their_time():
    late = (*LOAD, answered("A", "ready"), *(TimerFired(number * SECOND) for number in range(1, 9)))
    assert after(*late, answered("B", "ready", 9 * SECOND))[0].phase == "start"


def test_a_preview_ends_when_all_robots_have_answered_and_nothing_is_aborted():
    preview = replace(NEW, migrates=True, preview=True)
    state, actions = after(*LOAD, answered("A", "refused"), state=preview)
    assert (state.phase, actions) == ("load", [])
    state, actions = step(state, answered("B", "previewed"))
    assert (state.phase, state.failed, list(actions)) == ("over", True, [CancelTimers(), End()])
    state, _ = after(*LOAD, answered("A", "previewed"), answered("B", "previewed"), state=preview)
    assert (state.phase, state.failed) == ("over", False)


@pytest.mark.parametrize("answer", sorted(REFUSALS))
def test_one_refusal_ends_it_for_all(answer):
    state, actions = after(*LOAD, answered("A", "ready"), answered("B", answer))
    assert actions == ABORT
    assert (state.phase, state.failed, state.robots[0].reason) == ("over", True, "called off because of B")


def test_the_number_of_a_deployment_is_above_all_that_its_robots_have_seen():
    assert after(*LOAD)[0].sequence == 10
    assert after(*LOAD, StatusReceived("A", 99))[0].sequence == 10


def test_with_keys_every_robot_is_heard_before_it_is_loaded():
    signed = replace(NEW, signed=True)
    assert after(Begun(0), StatusReceived("A", 0), TimerFired(LATE), state=signed)[1] == [StartTimer(0.02)]


@pytest.mark.parametrize(
    ("events", "reasons"),
    [
        (
            (Begun(0), StatusReceived("A", 3), PatienceEnded(10.0)),
            ("was not asked yet because of B", "did not answer within 10 s"),
        ),
        ((*LOAD, answered("A", "refused")), ("", "had not answered yet")),
        (
            (*READY, answered("A", "started"), PatienceEnded(10.0)),
            ("", "was ready, and did not answer the start"),
        ),
        (
            (*READY, answered("A", "started"), RobotAnswered("B", "ready", "its disk is full", 0), PatienceEnded(10.0)),
            ("", "its disk is full"),
        ),
        ((*LOAD, TimerFired(LATE)), ("this command was stopped for 100 s and starts no robot",) * 2),
    ],
)
def test_why_a_deployment_failed(events, reasons):
    assert tuple(each.reason for each in after(*events)[0].robots) == reasons


# ---- every state that a sender and its robots can reach ------------------------------------------------------------


@dataclass(frozen=True)
class Team:
    """A sender and its robots. Whatever one of them ever said may arrive at any later time, or never.

    sent     the envelopes of the sender, and of robots that ask: robot, phase, whether one has started
    reports  robot and answer
    """

    sender: SenderState
    robots: tuple[RobotDeployment, ...]
    sent: frozenset[tuple[str, str, bool]] = frozenset()
    reports: frozenset[tuple[str, str]] = frozenset()


def successors(team: Team) -> Iterator[Team]:
    for event in sender_events(team):
        state, actions = step(team.sender, event)
        assert not any(isinstance(action, End) for action in actions) or state.phase == "over"
        sent = {(one.robot, one.phase, one.begun) for one in actions if isinstance(one, SendEnvelope)}
        state = replace(state, robots=tuple(RobotProgress(each.robot, each.state) for each in state.robots))
        yield replace(team, sender=state, sent=team.sent | sent)
    for number, robot in enumerate(team.robots):
        for event in robot_events(team, robot):
            yield moved(team, number, event)


def sender_events(team: Team) -> Iterator[SenderEvent]:
    yield TimerFired(0)
    yield TimerFired(LATE)
    yield PatienceEnded(10.0)
    if team.sender.phase == "approval":
        yield from (Approved("", 0), Approved("B waits forever", 0))
    yield from (answered(robot, answer) for robot, answer in team.reports)


def robot_events(team: Team, robot: RobotDeployment) -> Iterator[robot_state.RobotEvent]:
    for name, phase, begun in team.sent:
        if name == robot.robot:
            yield robot_state.Received(envelope(name, phase, begun=begun))
    yield from (termination.PeerAnswered(other, answer) for other, answer in team.reports if other != robot.robot)
    yield robot_state.LoadDue()
    if robot.loading is not None:
        yield from (robot_state.Loaded(), robot_state.Loaded("is wrong"))
    stage = robot.candidate.stage if robot.candidate is not None else ""
    results = {
        "matching": robot_state.Matched(),
        "promising": robot_state.Promised(),
        "ready": termination.Silence(),
        "replacing": robot_state.Replaced(),
        "starting": robot_state.Started(),
    }
    if stage:
        yield results[stage]


@cache
def envelope(robot: str, phase: str, *, begun: bool = False) -> Envelope:
    return Envelope(deployment="d1", sequence=1, robot=robot, phase=phase, team=["A", "B"], begun=begun)


def moved(team: Team, number: int, event: robot_state.RobotEvent) -> Team:
    """The team after an event at one robot."""
    name = team.robots[number].robot
    robot, actions = robot_protocol.step(team.robots[number], event)
    robot = replace(robot, answers=tuple(robot_state.Reply(one.answer, one.deployment) for one in robot.answers))
    sent = {(other, "ask", False) for other in "AB" if other != name and robot_state.AskOthers() in actions}
    said = {(name, action.answer) for action in actions if isinstance(action, robot_state.Reply) and action.answer}
    robots = (*team.robots[:number], robot, *team.robots[number + 1 :])
    return replace(team, robots=robots, sent=team.sent | sent, reports=team.reports | said)


def outcome(robot: RobotDeployment) -> str:
    return "started" if robot.deployed else "kept" if robot.candidate is None and robot.answers else "open"


@pytest.mark.long_but("False")
@pytest.mark.parametrize("migrates", [False, True])
def test_in_no_reachable_state_has_one_robot_started_and_another_one_kept_what_it_had(migrates):
    loading = after(*LOAD, state=replace(NEW, migrates=migrates))[0]
    first = Team(
        loading, (RobotDeployment("A"), RobotDeployment("B")), frozenset({("A", "load", False), ("B", "load", False)})
    )
    seen, left = {first}, [first]
    outcomes = set()
    while left:
        team = left.pop()
        reached = {outcome(robot) for robot in team.robots}
        assert reached != {"started", "kept"}, team
        phases = {phase for _, phase, _ in team.sent}
        assert not {"start", "abort"} <= phases, team
        outcomes.add(tuple(sorted(reached)))
        for following in successors(team):
            if following not in seen:
                seen.add(following)
                left.append(following)
    assert {("started",), ("kept",)} <= outcomes
