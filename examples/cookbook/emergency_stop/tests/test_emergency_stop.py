"""A stop suspends all mules; they go on where they were, or stay (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_all_stand_until_they_may_go_on_where_they_were(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(7).signal("emergency_stop")
    m.advance(60)
    for mule in m.robots:
        m.expect(mule).waits_at("Gateway_How").never_entered("Drive Back")
    m.signal("go_on")
    for mule in m.robots:
        m.expect(mule).completed(within=8).passed("Drive Out", times=1)
        m.expect(mule).passed("back")


def test_it_works_again_and_a_trip_can_end_there(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(2).signal("emergency_stop")
    m.advance(1).signal("go_on")
    m.advance(1).signal("emergency_stop")
    m.advance(1).signal("abort")
    for mule in m.robots:
        m.expect(mule).completed(within=1).never_entered("Load")
