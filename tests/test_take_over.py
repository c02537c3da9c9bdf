"""A person takes a robot over, steers it in the world, and hands it back to its mission."""

import math
from pathlib import Path
from typing import Any

import pytest

from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from fame.testing import MissionUnderTest

EXAMPLES = Path(__file__).parents[1] / "examples"


def pose(mission: MissionUnderTest, robot: str = "REX") -> Any:
    return mission.world.robots[robot].pose


def moved(mission: MissionUnderTest, seconds: float, robot: str = "REX") -> float:
    """How far a robot comes in some seconds (m)."""
    before = pose(mission, robot)
    mission.advance(seconds)
    after = pose(mission, robot)
    return math.hypot(after.x - before.x, after.y - before.y)


@pytest.fixture
def cars(mission: Any) -> MissionUnderTest:
    """Two cars on their way."""
    found: MissionUnderTest = mission.load(EXAMPLES / "ground_vehicles.yaml")
    return found.advance(9)  # between two looks


def told(mission: MissionUnderTest) -> list[str]:
    return [event.detail for event in mission.reports]


@pytest.mark.long
def test_a_robot_that_is_taken_over_stops_and_obeys_the_person_at_their_speed(cars: MissionUnderTest) -> None:
    assert moved(cars, 1) > 0.1
    hand = cars.take_over("REX", who="ann")
    cars.advance(1)
    assert moved(cars, 5) < 0.01
    before = pose(cars)
    hand.steer(-9.0, seconds=1.0)
    after = pose(cars)
    assert 0.3 < math.hypot(after.x - before.x, after.y - before.y) < 0.51
    assert told(cars)[-1] == "taken over by ann"


def test_without_a_command_for_the_time_of_the_dead_man_it_stops(cars: MissionUnderTest) -> None:
    hand = cars.take_over("REX")
    cars.advance(1)
    hand.steer(-0.5, seconds=0.5)
    assert moved(cars, 0.2) > 0.05
    cars.advance(0.4)
    assert moved(cars, 2) < 0.01
    assert hand.is_held


def test_what_others_command_is_masked_meanwhile_and_by_hand_nothing_is_steered_that_is_not_taken_over(
    cars: MissionUnderTest,
) -> None:
    type = "geometry_msgs/msg/Twist"
    command, by_hand = (cars.outside.publisher(f"/REX/{name}", type) for name in ("cmd_vel", "cmd_vel_manual"))
    hand = cars.take_over("REX")
    cars.advance(1)
    command.publish(messages.create(type, {"linear": {"x": -1.0}}))
    assert moved(cars, 1) < 0.01
    hand.lose()
    cars.advance(4)
    by_hand.publish(messages.create(type, {"linear": {"x": -1.0}}))
    assert moved(cars, 1) < 0.01
    command.publish(messages.create(type, {"linear": {"x": -1.0}}))
    assert moved(cars, 1) > 0.3


def test_who_is_lost_steers_no_longer_and_the_mission_stays_suspended(cars: MissionUnderTest) -> None:
    hand = cars.take_over("REX", who="ann")
    with pytest.raises(MissionError, match="REX: ann steers it; fame suspend stops it"):
        cars.take_over("REX", who="bob")
    hand.lose()
    cars.advance(2.9)
    assert hand.is_held
    cars.advance(0.2)
    suspension = cars.node("REX").suspension
    assert (suspension.holder, suspension.by) == ("", "ann")
    assert "ann steers no longer: lost" in told(cars)
    assert moved(cars, 3) < 0.01
    cars.take_over("REX", who="bob").resume()
    assert (suspension.holder, suspension.by) == ("", "")
    before = pose(cars)
    cars.run_until(condition=lambda: abs(pose(cars).x - before.x) > 0.1, within=60)


def test_whoever_suspends_it_takes_it_from_who_steers(cars: MissionUnderTest) -> None:
    hand = cars.take_over("REX", who="ann")
    cars.node("REX").suspension.suspend("bob")
    assert not hand.is_held
    hand.steer(-0.5, seconds=1.5)
    assert moved(cars, 1) < 0.01
    with pytest.raises(MissionError, match="no longer: take over again"):
        cars.node("REX").suspension.take_over("ann", hand._lease)


@pytest.mark.long
def test_after_it_was_steered_the_mission_ends_as_ever(cars: MissionUnderTest) -> None:
    hand = cars.take_over("REX")
    cars.advance(1)
    hand.steer(-0.5, 0.5, seconds=1.0)
    hand.resume()
    cars.run_until(completed="REX")
    cars.run_until(completed="DINGO")


def test_an_activity_is_skipped_or_failed_by_its_label(cars: MissionUnderTest) -> None:
    hand = cars.take_over("REX")
    with pytest.raises(ConfigError, match="Fire"):
        hand.skip("Fire")
    hand.restart("Explore")
    assert cars.is_at("REX", cars.elements.find("REX", "Explore"))
    cars.advance(3)
    cars.take_over("REX").fail("Explore")
    assert "failed by a person" in told(cars)
    assert cars.node("REX").instances[-1].error.code == "taken_over"


@pytest.mark.long
def test_a_drone_that_is_taken_over_hovers_and_flies_by_hand(mission: Any) -> None:
    field: MissionUnderTest = mission.load(EXAMPLES / "agriculture.yaml")
    field.advance(20)
    drone = next(name for name, body in field.world.robots.items() if body.type == "drone")
    hand = field.take_over(drone)
    field.advance(3)
    assert moved(field, 2, drone) < 0.02
    assert field.world.robots[drone].status["altitude"] > 0.4
    before = pose(field, drone)
    hand.steer(5.0, seconds=2.0)
    after = pose(field, drone)
    assert 0.5 < math.hypot(after.x - before.x, after.y - before.y) < 1.1


@pytest.mark.long
def test_an_arm_only_holds(mission: Any) -> None:
    cell: MissionUnderTest = mission.load(EXAMPLES / "reassembly.yaml")
    cell.advance(5)
    arm = next(name for name, body in cell.world.robots.items() if body.type == "ur5e")
    hand = cell.take_over(arm)
    cell.advance(2)
    before = cell.world.robots[arm].appearance.limb
    hand.steer(0.5, seconds=1.0)
    assert cell.world.robots[arm].appearance.limb == before
    hand.resume()
    cell.run_until(completed=arm)
