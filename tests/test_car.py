"""The car obeys and brakes as motors, tyres and its watchdog let it."""

import math

import pytest
from grounds import ground

from sim2d.robot import robot_class

QUIET = {"odom": {"position_noise": 0, "heading_noise": 0, "speed_noise": 0}, "range": {"noise": 0}}


def test_a_car_without_a_command_stays_where_it_is():
    g = ground()
    g.run(5)
    assert g.world.robots["REX"].pose == (1, 2, 0)


def test_a_car_drives_ahead_at_the_speed_that_cmd_vel_asks_for():
    g = ground(rex={"watchdog": 0})
    g.run(0)
    g.drive(0.5)
    g.run(1)
    begin = g.world.robots["REX"].pose
    g.run(3)
    end = g.world.robots["REX"].pose
    assert end.x - begin.x == pytest.approx(1.0, abs=1e-6)
    assert (end.y, end.heading) == pytest.approx((2, 0), abs=1e-9)


def test_a_car_turns_to_the_left_with_a_positive_rate():
    g = ground(rex={"watchdog": 0})
    g.run(0)
    g.drive(0, 1)
    g.run(1.6)
    assert g.world.robots["REX"].pose.heading == pytest.approx(1.55, abs=0.02)


def test_a_car_goes_in_a_circle_of_speed_over_rate():
    g = ground(rex={"watchdog": 0, "at": [3, 1]})
    g.run(0)
    g.drive(0.5, 0.5)
    g.run(2 * math.pi)  # half a turn
    assert g.world.robots["REX"].pose.y == pytest.approx(3, abs=0.1)


def test_speed_is_cut_to_its_limit():
    g = ground(rex={"watchdog": 0, "max_speed": 0.4})
    g.run(0)
    g.drive(99)
    g.run(1)
    begin = g.world.robots["REX"].pose.x
    g.run(2)
    assert g.world.robots["REX"].pose.x - begin == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize(("friction", "deceleration"), [("rubber", 4.22), ("smooth", 1.18), (0.2, 1.96)])
@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_a_car_takes_the_braking_distance_of_its_tyres(friction, deceleration, speed):
    g = ground(rex={"watchdog": 0, "friction": friction})
    g.run(0)
    g.drive(speed)
    g.run(2)
    begin = g.world.robots["REX"].pose.x
    g.drive(0)
    g.run(4)
    assert g.world.robots["REX"].pose.x - begin == pytest.approx(speed**2 / 2 / deceleration, abs=0.012)


def test_a_car_brakes_when_no_command_came_for_as_long_as_its_watchdog_waits():
    g = ground(rex={"watchdog": 0.5})
    g.run(0)
    g.drive(0.5)
    g.run(2)
    stopped = g.world.robots["REX"].pose
    assert 1.2 < stopped.x < 1.3
    g.run(3)
    assert g.world.robots["REX"].pose == stopped


def test_a_car_takes_what_is_no_number_for_a_stop():
    g = ground(rex={"watchdog": 0})
    g.run(0)
    g.drive(0.5)
    g.run(1)
    g.drive(math.nan, math.inf)
    g.run(2)
    stopped = g.world.robots["REX"].pose
    g.run(3)
    assert g.world.robots["REX"].pose == stopped


def test_a_car_is_stopped_by_an_obstacle_and_reports_one_collision():
    g = ground(rex={"watchdog": 0}, obstacles=[{"name": "rock", "at": [2, 2], "radius": 0.3}])
    g.run(0)
    g.drive(0.5)
    g.run(5)
    assert g.world.robots["REX"].pose.x == pytest.approx(2 - 0.3 - 0.125, abs=0.02)
    assert [(a, b) for _, a, b in g.world.collisions] == [("REX", "rock")]
    assert g.world.collisions[0].time == pytest.approx(1.28, abs=0.05)


def test_a_car_pushes_another_and_both_have_collided_once():
    g = ground(rex={"watchdog": 0}, robots={"DINGO": {"type": "car", "at": [2, 2]}})
    g.run(0)
    g.drive(0.8)
    g.run(3)
    summary = g.world.summary()
    assert summary["robots"]["DINGO"]["x"] > 2.01
    assert summary["robots"]["DINGO"]["collisions"] == summary["robots"]["REX"]["collisions"] == 1


def test_the_safe_state_of_a_car_stops_it():
    g = ground(rex={"watchdog": 0})
    g.run(0)
    g.drive(0.5)
    g.run(1)
    for topic, kind, fields in robot_class("car").SAFE_STATE:
        g.say(f"/REX/{topic}", kind, fields)
    g.run(2)
    stopped = g.world.robots["REX"].pose
    g.run(3)
    assert g.world.robots["REX"].pose == stopped


@pytest.mark.parametrize(
    ("colour", "name"),
    [
        ({"r": 1.0, "a": 0.0}, "red"),
        ({"g": 1.0, "a": 1.0}, "green"),
        ({"r": 0.2, "g": 0.2}, "yellow"),
        ({"r": 1.0, "g": 0.3}, "red"),
        ({"a": 1.0}, "off"),
    ],
)
def test_a_lit_led_is_judged_by_its_colour_even_with_alpha_zero(colour, name):
    g = ground()
    g.run(0)
    assert g.world.robots["REX"].appearance.led == "off"
    g.say("/REX/led", "std_msgs/msg/ColorRGBA", colour)
    g.run(1)
    assert g.world.robots["REX"].appearance.led == name
