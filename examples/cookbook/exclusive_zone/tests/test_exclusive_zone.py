"""Cars cross the zone one at a time, in the order in which they have asked (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_one_crosses_after_the_other(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Car": 4})
    m.expect("Car_4").completed(within=30)
    starts = [m.expect(car).entered("Cross").times[0] for car in ("Car_1", "Car_2", "Car_3", "Car_4")]
    assert starts == [2, 7, 12, 17]
    m.expect_property("alone_1").holds()
    m.expect_property("alone_2").holds()


def test_a_car_that_dies_in_the_zone_keeps_it(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.run_until("Car_1", at="Cross").fault("Car_1", "engine")
    m.advance(60)
    m.expect("Car_2").waits_at("zone_granted").never_entered("Cross")
