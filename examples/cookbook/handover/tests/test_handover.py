"""A part is always in a hand, and never torn (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_the_giver_may_be_there_first(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect("TAKER").completed(within=20).passed("taken")
    m.expect("GIVER").passed("offered").before("Open Gripper")
    m.expect_property("never_dropped").holds()
    m.expect_property("never_torn").holds()


def test_a_part_that_slips_stays_with_the_giver(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.set("TAKER", slips=True)
    m.expect("GIVER").completed(within=20).passed("kept")
    m.expect("GIVER").never_entered("Open Gripper")
    m.expect("TAKER").completed(within=1)
