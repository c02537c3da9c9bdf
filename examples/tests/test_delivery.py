"""A car delivers to three doors, tries each three times, and else unloads at home (models/delivery)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "models/delivery/delivery.bpmn"


def test_each_door_gets_its_parcel(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    go = m.stub("GoTo", after=10)
    m.expect().completed(within=60).has(attempts_made=[1, 1, 1])
    m.expect().passed("Load").before("Deliver to Each")
    m.expect().never_entered("Go Home").never_entered("Unload")
    assert [(call.variables["x_goal"], call.variables["y_goal"]) for call in go.calls] == [(5, 0.6), (5, 2), (5, 3.4)]


def test_a_door_that_is_blocked_for_a_while_is_tried_again(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.stub("GoTo", after=10, raises=["unreachable", None])
    m.run_until(at="5 s")
    m.expect().passed("Count", times=1)
    m.expect().completed(within=60).has(attempts_made=[2, 1, 1])


def test_after_three_attempts_it_goes_home_and_unloads(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.stub("GoTo", raises=["unreachable", "unreachable", "unreachable", None])
    m.expect().completed(within=60)
    m.expect().passed("Count", times=2)
    m.expect().passed("Go Home").before("Unload")
    m.expect().never_entered("Report")
