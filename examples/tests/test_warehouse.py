"""Robots bid for parcels and carry them through doors to packing stations (models/warehouse.bpmn)."""

from __future__ import annotations

from typing import Any

from fame.middleware import NetworkConfig, Partition
from fame.testing import MissionLoader, MissionUnderTest

MODEL = "models/warehouse.bpmn"
TRIGGER = "std_srvs/srv/Trigger"
DONE = {"success": True}


def hall(mission: MissionLoader, *carriers: tuple[float, float], charges: Any = (), **options: Any) -> MissionUnderTest:
    """Carriers at these places; a way takes 10 s. `charges`: what the battery of the first one tells every 10 s."""
    m = mission.load(MODEL, robots={"Carrier": len(carriers)}, **options)
    m.stub("NavigateToPose", after=10)
    m.stub("DockRobot", after=5)
    m.stub("UndockRobot", after=2)
    for door in ("east", "west"):
        m.fake_service(f"/door_{door}/open", TRIGGER, response=DONE)
    for number, (x, y) in enumerate(carriers, 1):
        said = {"pose": {"pose": {"position": {"x": x, "y": y}}}}
        m.fake_topic(f"/Carrier_{number}/odom", values=[said] * 500, every=0.5)
        for service in ("load", "unload"):
            m.fake_service(f"/Carrier_{number}/{service}", TRIGGER, response=DONE)
    m.fake_topic("/Carrier_1/battery_state", values=[{"percentage": charge} for charge in charges], every=10)
    return m


def test_six_parcels_are_delivered_and_the_shift_is_over(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1), (1, 3))
    m.stub("NavigateThroughPoses", after=10)
    m.expect("Dispatcher").completed(within=240)
    assert sorted(said.value for said in m.published("/parcel_delivered")) == [f"parcel_{n}" for n in range(1, 7)]
    m.expect("Dispatcher").passed("Assign Parcel").before("shift over")
    m.expect("Carrier_1").passed("Open East Door").before("Open West Door")


def test_the_carrier_that_is_closest_to_the_shelf_gets_the_parcel(mission: MissionLoader) -> None:
    m = hall(mission, (9, 1), (2, 7))
    m.stub("NavigateThroughPoses", after=10)
    m.advance(1)
    m.expect("Dispatcher").passed("Note Bid", times=2).before("Choose Lowest")
    assert [said.value for said in m.published("/parcel_awarded")][:1] == ["Carrier_2"]
    m.expect("Carrier_2").waits_at("Fetch Parcel")
    m.expect("Carrier_1").never_entered("Fetch Parcel").passed("not mine")


def test_while_all_are_busy_the_next_parcel_waits_for_a_free_carrier(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    m.stub("NavigateThroughPoses", after=5)
    m.run_until("Dispatcher", at="carrier_free")
    m.run_until("Dispatcher", at="Flow_Free_Again")
    m.expect("Carrier_1").passed("Return")
    m.expect("Dispatcher").never_entered("Flow_Pause_Again")


def test_it_offers_a_parcel_again_after_half_a_minute(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    m.stub("NavigateThroughPoses", after=60)
    m.advance(40)
    m.expect("Dispatcher").passed("30 s", times=1)
    assert [said.message.header.frame_id for said in m.published("/parcel_offered")] == [
        "parcel_1",
        "parcel_2",
        "parcel_2",
    ]


def test_a_station_that_cannot_be_reached_is_replaced_by_the_next_one(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    way = m.stub("NavigateThroughPoses", after=10, raises=["aborted", None])
    m.run_until(published="/parcel_delivered")
    m.expect("Carrier_1").passed("not reachable").before("Unload")
    assert [call.variables["poses_goal"][-1] for call in way.calls[:2]] == [[14.2, 7.7], [14.2, 2.3]]


def test_stations_that_are_all_blocked_are_tried_by_turns(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    way = m.stub("NavigateThroughPoses", after=10, raises=["aborted", "aborted", "aborted", None])
    m.run_until(published="/parcel_delivered")
    assert [call.variables["poses_goal"][-1] for call in way.calls[:4]] == 2 * [[14.2, 7.7], [14.2, 2.3]]


def test_a_carrier_that_does_not_come_through_the_east_door_opens_it_again(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    m.stub("NavigateThroughPoses", after=130)
    m.run_until("Carrier_1", at="Flow_EastClosed_OpenEast")
    m.run_until("Carrier_1", at="Go to Station")
    m.expect("Carrier_1").passed("Open East Door", times=2).never_entered("Unload")


def test_a_carrier_that_does_not_come_home_opens_the_west_door_again(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1))
    m.stub("NavigateThroughPoses", after=90)
    m.run_until("Carrier_1", at="Flow_WestClosed_OpenWest")
    m.run_until("Carrier_1", at="Return")
    m.expect("Carrier_1").passed("Open West Door", times=2).passed("Go to Station")


def test_a_carrier_with_a_low_battery_charges_and_then_goes_on_to_the_shelf(mission: MissionLoader) -> None:
    m = hall(mission, (1, 1), charges=[0.9, 0.2, 0.5, 0.9])
    m.stub("NavigateThroughPoses", after=10)
    m.run_until("Carrier_1", at="charged")
    m.expect("Carrier_1").passed("Dock").before("charged")
    m.expect("Carrier_1").never_entered("Load")
    m.run_until("Carrier_1", at="Load")
    m.expect("Carrier_1").passed("Undock").after("charged")


def test_a_carrier_that_hears_no_award_takes_the_parcel_for_not_its_own(mission: MissionLoader) -> None:
    cut = NetworkConfig(partitions=(Partition(("Dispatcher", "Carrier_1"), 0.5, 20),))
    m = hall(mission, (1, 1), network=cut)
    m.stub("NavigateThroughPoses", after=10)
    m.advance(5)
    m.expect("Carrier_1").passed("3 s").before("not mine")
    assert m.run.network is not None
    assert "the network lost 1 message on /parcel_awarded from Dispatcher to Carrier_1" in m.run.network.losses()


def test_a_parcel_that_nobody_accepts_is_offered_again(mission: MissionLoader) -> None:
    """The award comes after 4 s, when the carrier has given up waiting for it."""
    cut = NetworkConfig(partitions=(Partition(("Dispatcher", "Carrier_1"), 0.5, 4),))
    m = hall(mission, (1, 1), network=cut)
    m.stub("NavigateThroughPoses", after=5)
    m.run_until("Dispatcher", at="Flow_NoReply_Again")
    m.expect("Dispatcher").completed(within=400)
    m.expect("Carrier_1").passed("3 s").before("parcel_accepted")
    assert sorted(said.value for said in m.published("/parcel_delivered")) == [f"parcel_{n}" for n in range(1, 7)]
