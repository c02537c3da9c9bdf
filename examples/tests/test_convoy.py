"""Cars set off together, or after half a minute without those that are missing (models/convoy.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "models/convoy.bpmn"


def test_all_wait_for_the_last_one_and_set_off_together(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Car": 5})
    m.stub("GoTo", after=[1, 2, 3, 4, 9, 5])
    m.advance(8.5)
    m.expect("Car_5").waits_at("To the Line")
    for number in range(1, 5):
        m.expect(f"Car_{number}").waits_at("Wait for the Others").passed("1 s")
    m.advance(2)
    starts = {m.expect(robot).entered("Set Off").times[0] for robot in m.robots}
    assert max(starts) - min(starts) <= 1
    m.expect("Car_1").never_entered("30 s").completed(within=10)


def test_a_car_that_broke_down_is_left_behind_after_half_a_minute(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Car": 5})
    m.stub("GoTo", after=1)
    m.advance(0.5).fault("Car_3", "engine")
    m.advance(29)
    m.expect("Car_1").never_entered("Set Off")
    m.expect("Car_1").completed(within=5)
    m.expect("Car_1").passed("30 s").before("Set Off")
