"""Who is supplied when: decided without any middleware."""

import pytest

from fame.clock import SECOND
from fame.deploy.late_joiners import (
    CalledOff,
    DeploymentEnded,
    JoinersState,
    Left,
    Polled,
    Reported,
    RobotStarted,
    Supply,
    Withdraw,
    Withhold,
    step,
)

WAIT = Reported("A", "waiting"), Reported("B", "waiting")
TURNS = WAIT[0], Polled(0), DeploymentEnded(), WAIT[1], Polled(6 * SECOND), DeploymentEnded()
"""Each of two has failed without the other."""


def after(*events, supplied: frozenset[str] = frozenset()) -> list[Supply]:
    state, actions = JoinersState(supplied=supplied), ()
    for event in events:
        state, actions = step(state, event)
    return list(actions)


@pytest.mark.parametrize(
    ("events", "robots"),
    [
        ((Polled(0),), None),
        ((*WAIT, Polled(0)), ("A", "B")),
        ((*WAIT, Reported("A", "running"), Polled(0)), ("B",)),
        ((*WAIT, Left("B"), Polled(0)), ("A",)),
        ((*WAIT, Polled(0), Polled(60 * SECOND)), None),
        ((*WAIT, Polled(0), DeploymentEnded(), Polled(5 * SECOND)), None),
        ((*WAIT, Polled(0), DeploymentEnded(), Polled(10 * SECOND)), ("A", "B")),
        ((*WAIT, Polled(0), RobotStarted("A"), DeploymentEnded(), Polled(10 * SECOND)), ("B",)),
        ((*WAIT, Polled(0), RobotStarted("A"), DeploymentEnded(), WAIT[0], Polled(SECOND)), ("A",)),
        ((*WAIT, Polled(0), CalledOff("A"), DeploymentEnded(), Polled(SECOND)), ("A",)),
        ((*WAIT, Polled(0), CalledOff("A"), DeploymentEnded(), Polled(10 * SECOND)), ("A", "B")),
        ((*TURNS, Polled(12 * SECOND)), None),
        ((*TURNS, Reported("C", "waiting"), Polled(12 * SECOND)), ("C",)),
        ((*TURNS, Polled(16 * SECOND)), ("A", "B")),
        ((*TURNS, Left("B"), Polled(12 * SECOND)), ("A",)),
        ((WAIT[0], Polled(0), Left("A"), DeploymentEnded(), WAIT[0], Polled(SECOND)), ("A",)),
    ],
)
def test_who_is_supplied(events, robots):
    assert [action.robots for action in after(*events)] == ([robots] if robots else [])


def test_a_team_that_has_gone_on_to_another_model_gets_no_late_joiner():
    other = Reported("C", "running", ours=False)
    assert after(*WAIT, other, Polled(0)) == [Withhold(("A", "B"))]
    assert after(*WAIT, other, Polled(0), Polled(1)) == []
    assert [each.robots for each in after(*WAIT, other, Left("C"), Polled(0))] == [("A", "B")]
    assert [each.robots for each in after(WAIT[0], other, Reported("B", "idle", ours=True), Polled(0))] == [("A",)]


def test_what_a_team_has_left_while_a_late_joiner_is_supplied_is_called_off():
    has, left = (Reported("C", "running", ours=ours) for ours in (True, False))
    assert after(WAIT[0], has, Polled(0), Reported("A", "loading")) == []
    assert after(WAIT[0], has, Polled(0), left) == [Withdraw()]
    assert after(WAIT[0], has, Polled(0), DeploymentEnded(), left) == []


def test_a_robot_that_had_the_model_before_is_told_so():
    assert after(*WAIT, Polled(0), supplied=frozenset({"B"})) == [Supply(("A", "B"), frozenset({"B"}))]
    again = after(WAIT[0], Polled(0), RobotStarted("A"), DeploymentEnded(), WAIT[0], Polled(SECOND))
    assert again == [Supply(("A",), frozenset({"A"}))]
    by_report = after(Reported("A", "running", ours=True), Left("A"), WAIT[0], Polled(0))
    assert by_report == [Supply(("A",), frozenset({"A"}))]  # the answer that it had started came too late
