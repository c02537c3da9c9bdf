"""Each mule finishes its trip and parks; then the team can be deployed anew (mission.bpmn, night.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_all_finish_their_trip_and_park(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(61)
    m.expect("Mule_1").waits_at("Trip").passed("Last Trip")
    m.expect("SHIFT").completed(within=20).never_entered("Look for Them")
    for mule in ("Mule_1", "Mule_2"):
        m.expect(mule).completed().passed("Trip").before("Park")
    m.expect("SHIFT").passed("ready to deploy")


def test_somebody_looks_for_a_mule_that_does_not_park(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(5).fault("Mule_2", "engine")
    m.run_until("SHIFT", at="Look for Them")
    assert m.now == 180
    m.expect("SHIFT").never_entered("ready to deploy")
    m.complete("SHIFT", "Look for Them")
    m.expect("SHIFT").completed(within=1)


def test_the_night_begins_with_the_same_robots(mission: MissionLoader) -> None:
    m = mission.load("../night.bpmn")
    m.expect("Mule_1").completed(within=30).passed("Charge")
    m.expect("SHIFT").completed(within=30)
