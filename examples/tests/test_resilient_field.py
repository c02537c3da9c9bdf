"""The drone keeps account of weeds, and asks again for one that is not cut (models/agriculture_resilient.bpmn)."""

from __future__ import annotations

from typing import Any

from fame.middleware import NetworkConfig, Partition
from fame.testing import MissionLoader, MissionUnderTest

MODEL = "models/agriculture_resilient.bpmn"
WEED = {"x": 4.0, "y": 3.0}


def field(mission: MissionLoader, *tractors: tuple[float, float], **options: Any) -> MissionUnderTest:
    """The drone surveys for half a minute; tractors stand at these places."""
    m = mission.load(MODEL, robots={"Tractor": len(tractors)}, **options)
    m.stub("TakeOff", after=2, sets={"x_base": 0.0, "y_base": 0.0})
    m.stub("Survey", after=30)
    m.stub("ReturnToBase", after=5)
    m.stub("Land", after=2)
    for number, (x, y) in enumerate(tractors, 1):
        said = {"pose": {"pose": {"position": {"x": x, "y": y}}}}
        m.fake_topic(f"/Tractor_{number}/odom", values=[said] * 400, every=1)
    return m


def asked_for(m: MissionUnderTest) -> int:
    """How often the drone has asked the tractors where they are."""
    return len(m.published("/weed_position"))


def test_without_weeds_the_drone_comes_home(mission: MissionLoader) -> None:
    m = field(mission, (0, 0))
    m.expect("Drone").completed(within=45).has(open_weeds=[])
    m.expect("Drone").passed("Explore").before("Return to Base")
    assert len(m.published("/mission_over")) == 1


def test_a_weed_that_is_cut_is_crossed_off(mission: MissionLoader) -> None:
    m = field(mission, (20, 15), (5, 3))
    m.stub("GoTo", after=8)
    m.advance(10).signal("weed_found", WEED)
    m.run_until("Drone", at="assigned")
    m.expect("Drone").has(open_weeds=[(4.0, 3.0)])
    m.expect("Drone").completed(within=60).has(open_weeds=[])
    m.expect("Tractor_2").passed("Cut Grass").before("2 s")
    m.expect("Tractor_1").passed("not needed")
    assert asked_for(m) == 1


def test_the_drone_waits_for_a_weed_that_is_still_being_cut(mission: MissionLoader) -> None:
    m = field(mission, (5, 3))
    m.stub("GoTo", after=40)
    m.advance(10).signal("weed_found", WEED)
    m.run_until("Drone", at="Flow_AllCut_NextNews")
    m.expect("Drone").never_entered("Return to Base")
    m.expect("Drone").completed(within=60)
    m.expect("Drone").passed("Event_NextWeedCut").before("Return to Base")


def test_a_weed_that_cannot_be_reached_is_given_up_after_a_minute_without_news(mission: MissionLoader) -> None:
    m = field(mission, (5, 3))
    m.stub("GoTo", after=40, raises="unreachable")
    m.advance(10).signal("weed_found", WEED)
    m.expect("Drone").completed(within=150)
    m.expect("Drone").passed("Weed Unreachable").before("Event_NoNews")
    m.expect("Drone").passed("Flow_AnyLeft_ReturnToBase")
    m.expect("Drone").never_entered("Take Up Again")
    m.expect("Tractor_1").passed("Report Weed")


def test_another_tractor_cuts_the_weed_of_one_that_is_out_of_order(mission: MissionLoader) -> None:
    m = field(mission, (5, 3), (20, 15))
    go = m.stub("GoTo", after=8, raises=["engine", None])
    m.advance(10).signal("weed_found", WEED)
    m.expect("Drone").completed(within=200)
    m.expect("Drone").passed("60 s").before("Take Up Again")
    m.expect("Tractor_1").passed("Report Failure").before("out of order")
    m.expect("Tractor_2").passed("Cut Grass")
    assert [call.robot for call in go.calls] == ["Tractor_1", "Tractor_2"]
    assert asked_for(m) == 2


def test_the_drone_gives_a_weed_up_if_no_tractor_is_left(mission: MissionLoader) -> None:
    m = field(mission, (5, 3))
    m.stub("GoTo", after=8, raises="engine")
    m.advance(10).signal("weed_found", WEED)
    m.expect("Drone").completed(within=250).has(open_weeds=[])
    m.expect("Drone").passed("Flow_AnyAnswer_NoteAssignment")
    m.expect("Drone").passed("Take Up Again", times=1)
    m.expect("Tractor_1").completed()


def test_a_tractor_that_hears_no_decision_is_asked_again(mission: MissionLoader) -> None:
    cut = NetworkConfig(partitions=(Partition(("Drone", "Tractor_1"), 15, 60),))
    m = field(mission, (5, 3), network=cut)
    m.stub("GoTo", after=8)
    m.advance(10).signal("weed_found", WEED)
    m.expect("Drone").completed(within=200)
    m.expect("Tractor_1").passed("30 s").before("Cut Grass")
    assert asked_for(m) == 2


def test_a_tractor_that_is_called_home_drives_to_the_yard(mission: MissionLoader) -> None:
    m = mission.load("models/agriculture_return.bpmn", robots={"Tractor": 1})
    go = m.stub("GoTo", after=20)
    m.expect().completed(within=20).passed("called home").before("Return to Base")
    assert (go.calls[0].variables["x_goal"], go.calls[0].variables["y_goal"]) == (-1.0, 7.5)


def test_a_tractor_that_finds_no_way_home_says_so(mission: MissionLoader) -> None:
    m = mission.load("models/agriculture_return.bpmn", robots={"Tractor": 1})
    m.stub("GoTo", after=20, raises="unreachable")
    m.expect().failed("unreachable", at="Return to Base", within=30).never_entered("at home")
