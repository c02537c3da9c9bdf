"""Of several splitters the oldest leads: decided without any middleware."""

from dataclasses import replace

import pytest

from fame.clock import SECOND
from fame.deploy.leader_election import (
    Beat,
    ElectionEvent,
    ElectionState,
    Lead,
    SplitterStatus,
    SplitterStatusReceived,
    StandBy,
    Woken,
    step,
)

NEW = ElectionState(born=10)
NOBODY = Lead(frozenset(), gone=False)


def heard(born: int, second: float, state: str = "standby", deployed: str = "") -> SplitterStatusReceived:
    return SplitterStatusReceived(SplitterStatus(born=born, state=state, deployed=deployed), round(second * SECOND))


def beat(second: float) -> Beat:
    return Beat(round(second * SECOND))


def after(*events: ElectionEvent) -> tuple[ElectionState, list]:
    state, actions = NEW, ()
    for event in events:
        state, actions = step(state, event)
    return state, list(actions)


@pytest.mark.parametrize(
    ("events", "actions"),
    [
        ((beat(1),), [NOBODY]),
        ((beat(1), beat(2)), []),
        ((heard(20, 0.5), beat(1)), [NOBODY]),
        ((heard(5, 0.5), beat(1)), []),
        ((beat(1), heard(5, 1.5), beat(2)), [StandBy("there is an older splitter")]),
        ((heard(5, 0.5), beat(1), beat(2), beat(3), beat(4)), [Lead(frozenset(), gone=True)]),
        (
            (heard(5, 0.5, "keeping", "d1"), beat(1), beat(2), beat(3), beat(4)),
            [Lead(frozenset({"d1"}), gone=True)],
        ),
        ((beat(1), heard(20, 1.5, "keeping", "d2"), Woken(SECOND * 2)), [StandBy("it was stopped or cut off, and "
          "listens what became of the team")]),
    ],
)  # fmt: skip
def test_what_a_splitter_does(events, actions):
    assert after(*events)[1] == actions


def test_a_leader_that_was_stopped_listens_before_it_leads_again():
    state, actions = after(beat(1), beat(20))
    assert [type(action) for action in actions] == [StandBy]
    state, actions = step(state, heard(20, 20.5, "keeping", "d2"))
    assert step(state, beat(21))[1] == (Lead(frozenset({"d2"}), gone=False),)


def test_what_an_older_one_had_deployed_is_not_forgotten_while_its_successor_is_stopped():
    state, _ = after(heard(5, 0.5, "keeping", "d1"), beat(1), beat(20))
    assert not state.leads
    assert step(state, beat(21))[1] == (Lead(frozenset({"d1"}), gone=True),)


@pytest.mark.parametrize("stops", range(32))
def test_after_every_stop_one_splitter_leads_and_it_is_the_oldest(stops):
    """Three splitters, of which some are stopped for a while; whoever goes on hears what was said last."""
    stopped = [(number, begin) for number, begin in enumerate((3, 6, 9, 3, 12)) if stops & 1 << number]
    states = [replace(NEW, born=born) for born in (10, 11, 12)]
    for second in range(1, 40):
        awake = [n for n in range(3) if not any(who % 3 == n and begin <= second < begin + 6 for who, begin in stopped)]
        for one in awake:
            states[one], _ = step(states[one], beat(second))
        for one in awake:
            status = "keeping" if states[one].leads else "standby"
            for other in awake:
                states[other], _ = step(states[other], heard(states[one].born, second + 0.5, status, "d"))
    assert [state.leads for state in states] == [True, False, False]
