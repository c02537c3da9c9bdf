"""A carrier that cannot deliver undoes what it has done, the last thing first (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_without_a_way_the_part_goes_back_and_the_bay_is_released(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect().completed(within=20).passed("Put Back").before("Release Bay")
    m.expect_property("part_first").holds()
    assert len(m.published("/not_delivered")) == 1


def test_a_delivery_is_not_undone(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.set(blocked=False)
    m.expect().completed(within=20).passed("delivered")
    m.expect().never_entered("Put Back").never_entered("Release Bay")
