"""Robots whose sender fell silent all start or all abort, whatever arrives when: shown on every reachable state."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest

from fame.deploy.termination import (
    NONE_STARTED,
    Abort,
    Ask,
    Instruction,
    KeepWaiting,
    PeerAnswered,
    Ready,
    ReportAsking,
    Silence,
    StartCandidate,
    reply,
    step,
)

TWO = Ready(frozenset({"B", "C"}))
ASKING = replace(TWO, asking=True)


@pytest.mark.parametrize(
    ("state", "event", "action"),
    [
        (TWO, Instruction("hold"), KeepWaiting()),
        (TWO, Instruction("start"), StartCandidate()),
        (TWO, Instruction("abort"), Abort()),
        (TWO, Silence(), Ask()),
        (Ready(frozenset()), Silence(), Abort(NONE_STARTED)),
        (ASKING, Silence(), Ask()),
        (ASKING, Instruction("hold"), ReportAsking()),
        (ASKING, Instruction("start"), ReportAsking()),
        (ASKING, Instruction("start", begun=True), StartCandidate()),
        (ASKING, Instruction("abort"), Abort()),
        (ASKING, PeerAnswered("B", "started"), StartCandidate()),
        (ASKING, PeerAnswered("B", "aborted"), Abort("the sender fell silent, and B does not start it")),
        (ASKING, PeerAnswered("B", "ready"), None),
        (ASKING, PeerAnswered("B", "asking"), None),
        (ASKING, PeerAnswered("D", "aborted"), None),
        (replace(ASKING, asked=frozenset({"C"})), PeerAnswered("B", "asking"), Abort(NONE_STARTED)),
        (replace(TWO, asked=frozenset({"B", "C"})), Silence(), Abort(NONE_STARTED)),
    ],
)
def test_what_a_robot_that_is_ready_does(state, event, action):
    assert step(state, event)[1] == action


@pytest.mark.parametrize(
    ("state", "started", "answer"),
    [(None, True, "started"), (None, False, "aborted"), (TWO, False, "ready"), (ASKING, False, "asking")],
)
def test_what_a_robot_answers_to_another_one(state, started, answer):
    assert reply(state, started=started) == answer


# ---- every state that a team can reach -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Team:
    """A sender and its robots. `robots`: ``new`` (has not voted), a `Ready`, ``started`` or ``aborted``.

    Whatever a robot or the sender ever said may arrive at any later time, or never: what was said is `said` (robot and
    answer), and the sender's `votes`, its decision, and whether it knows that one has started.
    """

    robots: tuple[object, ...]
    said: frozenset[tuple[int, str]] = frozenset()
    sender: str = "load"
    begun: bool = False


NAMES = "ABC"


def successors(team: Team) -> Iterator[Team]:
    """What may happen next."""
    everyone = range(len(team.robots))
    if team.sender == "load":
        yield replace(team, sender="abort")
        if all((number, "ready") in team.said for number in everyone):
            yield replace(team, sender="start")
    if team.sender == "start" and any((number, "started") in team.said for number in everyone):
        yield replace(team, begun=True)
    for number in everyone:
        for state, answer in changes(team, number):
            robots = (*team.robots[:number], state, *team.robots[number + 1 :])
            yield replace(team, robots=robots, said=team.said | ({(number, answer)} if answer else set()))


def changes(team: Team, number: int) -> Iterator[tuple[object, str]]:
    """What one robot may become, and what it says then."""
    robot = team.robots[number]
    others = [other for other in range(len(team.robots)) if other != number]
    if robot == "new":
        yield Ready(frozenset(NAMES[other] for other in others)), "ready"
        if any((other, "asking") in team.said for other in others) or team.sender == "abort":
            yield "aborted", reply(None, started=False)
    if not isinstance(robot, Ready):
        return
    events = [Silence(), *(PeerAnswered(NAMES[other], answer) for other, answer in team.said if other != number)]
    if team.sender in ("start", "abort"):
        events += [Instruction(team.sender), Instruction(team.sender, begun=team.begun)]
    for event in events:
        state, action = step(robot, event)
        if isinstance(action, StartCandidate):
            yield "started", "started"
        elif isinstance(action, Abort):
            yield "aborted", "aborted"
        else:
            yield state, "asking" if state.asking else ""


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_in_no_reachable_state_has_one_robot_started_and_another_one_aborted(robots):
    first = Team(("new",) * robots)
    seen, left = {first}, [first]
    while left:
        team = left.pop()
        assert not {"started", "aborted"} <= set(team.robots), team
        following = [each for each in successors(team) if each != team]
        assert following or not any(isinstance(robot, Ready) for robot in team.robots), f"nothing can end {team}"
        left += [each for each in set(following) if each not in seen]
        seen.update(following)
    assert {team.robots for team in seen} >= {("started",) * robots, ("aborted",) * robots}
