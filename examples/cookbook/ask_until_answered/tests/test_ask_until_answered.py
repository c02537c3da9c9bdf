"""SCOUT asks until HELPER, which is busy at first, answers (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_the_first_request_after_the_own_work_is_answered(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect("SCOUT").completed(within=6.5)
    m.expect("HELPER").passed("need_help").after("Own Work")
    assert [message.time for message in m.published("/need_help")] == [0, 2, 4, 6]
    m.expect("HELPER").completed(within=3)


def test_it_goes_on_asking_a_helper_that_has_died(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(1).fault("HELPER", "engine")
    m.advance(60)
    m.expect("SCOUT").waits_at("Gateway_Answer").never_entered("answered")
    assert len(m.published("/need_help")) == 31
