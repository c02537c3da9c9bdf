"""A drone looks for weeds; the tractor that is closest to one cuts it (models/agriculture.bpmn)."""

from __future__ import annotations

from typing import Any

from fame.middleware import Link, NetworkConfig, Partition
from fame.testing import MissionLoader, MissionUnderTest

MODEL = "models/agriculture.bpmn"
WEED = {"x": 4.0, "y": 3.0}


def field(mission: MissionLoader, *tractors: tuple[float, float], **options: Any) -> MissionUnderTest:
    """The drone surveys for a minute; tractors stand at these places."""
    m = mission.load(MODEL, robots={"Tractor": len(tractors)}, **options)
    m.stub("TakeOff", after=2, sets={"x_base": 0.0, "y_base": 0.0})
    m.stub("Survey", after=60)
    m.stub("ReturnToBase", after=5)
    m.stub("Land", after=2)
    for number, (x, y) in enumerate(tractors, 1):
        said = {"pose": {"pose": {"position": {"x": x, "y": y}}}}
        m.fake_topic(f"/Tractor_{number}/odom", values=[said] * 200, every=1)
    return m


def test_without_weeds_the_drone_comes_home(mission: MissionLoader) -> None:
    m = field(mission, (0, 0))
    m.expect("Drone").completed(within=80)
    m.expect("Drone").passed("Explore").before("Return to Base")
    m.expect("Tractor_1").never_entered("weed_position")


def test_the_closest_tractor_cuts_the_weed_and_the_other_is_not_needed(mission: MissionLoader) -> None:
    m = field(mission, (20, 15), (5, 3))
    go = m.stub("GoTo", after=8)
    m.advance(10).signal("weed_found", WEED)
    m.expect("Tractor_2").completed(within=40).passed("Cut Grass").before("2 s")
    m.expect("Tractor_1").completed(within=1).passed("not needed")
    assert [(call.robot, call.variables["x_goal"]) for call in go.calls] == [("Tractor_2", 4.0)]
    assert [force.message.torque.z for force in m.published("/Tractor_2/blade_force")] == [1.0, 0.0]
    m.expect("Drone").completed(within=120)


def test_a_weed_that_cannot_be_reached_is_noted(mission: MissionLoader) -> None:
    m = field(mission, (5, 3))
    m.stub("GoTo", after=1, raises="unreachable")
    m.advance(10).signal("weed_found", WEED)
    m.expect("Tractor_1").completed(within=40).passed("Report Weed")
    m.expect("Drone").passed("Note It").completed(within=120).passed("Land")  # and goes on exploring


def test_the_drone_asks_again_if_no_tractor_answers_in_time(mission: MissionLoader) -> None:
    away = NetworkConfig(partitions=(Partition(("Drone", "Tractor_1"), 11, 30),))
    m = field(mission, (5, 3), network=away)
    m.stub("GoTo", after=1)
    m.advance(12).signal("weed_found", WEED)
    m.expect("Tractor_1").completed(within=60)
    assert len(m.published("/weed_position")) > 1


def test_a_tractor_that_hears_no_decision_gives_up(mission: MissionLoader) -> None:
    cut = NetworkConfig((Link(),), (Partition(("Drone", "Tractor_1"), 15, 60),))
    m = field(mission, (5, 3), network=cut)
    m.stub("GoTo")
    m.advance(12).signal("weed_found", WEED)
    m.expect("Tractor_1").completed(within=60).passed("30 s")
    m.expect("Tractor_1").never_entered("Go To")
    assert m.run.network is not None
    assert m.run.network.losses() == ["the network lost 1 message on /closest_tractor from Drone to Tractor_1"]
