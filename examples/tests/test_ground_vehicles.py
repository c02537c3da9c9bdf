"""REX finds the target, DINGO destroys it (models/ground_vehicles.bpmn). Run with: fame test examples/tests"""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL, SCENARIO = "models/ground_vehicles.bpmn", "examples/ground_vehicles.yaml"


def test_the_target_is_destroyed_after_it_was_found(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.stub("Explore", after=40, signals={"target_found": {"x": 5.5, "y": 0.6}})
    go = m.stub("GoTo", after=20)
    m.run_until("DINGO", at="Go To")
    m.expect("REX").passed("Explore").before("done")
    m.expect("DINGO").never_entered("Fire")
    m.expect("DINGO").completed(within=20)
    m.expect("REX").completed()
    assert go.calls[0].variables["x_goal"] == 5.5
    assert [led.message.r for led in m.published("/DINGO/led")] == [1.0]


def test_without_a_target_nothing_is_fired_at(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.stub("Explore", after=40)
    m.advance(300)
    m.expect("REX").waits_at("done")
    m.expect("DINGO").never_entered("target_found")


def test_dingo_fails_if_there_is_no_way(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.stub("Explore", signals={"target_found": {"x": 5.5, "y": 0.6}})
    m.stub("GoTo", raises="unreachable")
    m.advance(1)
    m.expect("DINGO").failed("unreachable", at="Go To").never_entered("Fire")


def test_in_the_world_it_takes_less_than_two_minutes(mission: MissionLoader) -> None:
    m = mission.load(SCENARIO)
    m.expect("DINGO").completed(within=120)
    assert m.world.summary()["robots"]["DINGO"]["led"] == "red"
    assert m.world.summary()["collisions"] == []
