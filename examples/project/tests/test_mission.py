"""SCOUT calls HELPER (mission.bpmn). Run with: fame test"""

from __future__ import annotations

from fame.testing import MissionLoader


def test_the_helper_joins_the_scout_in_the_world(mission: MissionLoader) -> None:
    m = mission.load("mission.yaml")
    m.expect("SCOUT").completed(within=120)
    m.expect("HELPER").completed()
    assert m.world.summary()["collisions"] == []


def test_a_scout_that_nobody_joins_turns_its_light_red(mission: MissionLoader) -> None:
    m = mission.load("mission.bpmn")
    m.stub("GoTo", after=8)  # SCOUT is there after 8 s
    m.advance(1).fault("HELPER", "engine")
    m.advance(66)  # it still waits
    m.expect("SCOUT").never_entered("nobody comes")
    m.expect("SCOUT").completed(within=5)
    assert [led.message.r for led in m.published("/SCOUT/led")] == [1.0]


def test_a_scout_that_finds_no_way_turns_its_light_red(mission: MissionLoader) -> None:
    m = mission.load("mission.bpmn")
    m.stub("GoTo", raises="unreachable")
    m.expect("SCOUT").completed(within=5).never_entered("arrived")
    assert [led.message.r for led in m.published("/SCOUT/led")] == [1.0]
