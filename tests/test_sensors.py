"""Odometry and range: what they tell, how wrong they are, and that each has chance of its own."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
from grounds import ground

from sim2d.randomness import generator

ROOT = Path(__file__).parents[1]
RANGE, ODOMETRY = "sensor_msgs/msg/Range", "nav_msgs/msg/Odometry"


def ranges(g, until=0.0):
    heard = g.hear("/REX/range", RANGE)
    g.run(until)
    return [message.range for message in heard]


def exact(**of_range):
    return {"range": {"noise": 0, **of_range}}


def test_sensors_speak_twenty_times_a_second_from_the_start():
    g = ground()
    odom, range_ = g.hear("/REX/odom", ODOMETRY), g.hear("/REX/range", RANGE)
    g.run(2)
    assert len(odom) == len(range_) == 41
    stamps = [message.header.stamp.sec + message.header.stamp.nanosec / 1e9 for message in odom]
    assert stamps == pytest.approx([number / 20 for number in range(41)])


def test_the_range_is_that_of_the_nearest_thing_measured_from_the_nose():
    g = ground(rex=exact(), obstacles=[{"at": [2.5, 2], "radius": 0.3}, {"at": [2.9, 2], "size": [0.1, 3]}])
    assert ranges(g) == pytest.approx([2.5 - 0.3 - 1.125])


def test_targets_other_robots_and_walls_are_seen_as_well():
    g = ground(rex=exact(), targets=[{"at": [2, 2], "radius": 0.1}])
    assert ranges(g) == pytest.approx([2 - 0.1 - 1.125])
    g = ground(rex=exact(), robots={"DINGO": {"type": "car", "at": [2, 2]}})
    assert ranges(g) == pytest.approx([2 - 0.125 - 1.125])
    g = ground(rex={**exact(), "at": [5, 2]})
    assert ranges(g) == pytest.approx([1 - 0.125])


def test_what_is_beside_the_cone_is_not_seen():
    beside = [{"at": [2, 2 + math.tan(math.radians(20))], "radius": 0.05}]
    assert ranges(ground(rex=exact(), targets=beside)) == [math.inf]
    assert ranges(ground(rex=exact(field_of_view=60), targets=beside))[0] < 1


def test_what_is_too_far_reads_plus_infinity_and_what_is_too_near_minus_infinity():
    assert ranges(ground(rex=exact())) == [math.inf]
    assert ranges(ground(rex=exact(min=0.2), targets=[{"at": [1.3, 2], "radius": 0.1}])) == [-math.inf]


def test_a_thing_that_is_touched_is_still_seen():
    g = ground(rex={**exact(), "watchdog": 0}, obstacles=[{"at": [2, 2], "size": [0.2, 1]}])
    heard = g.hear("/REX/range", RANGE)
    g.run(0)
    g.drive(0.5)
    g.run(4)
    assert g.world.collisions
    assert heard[-1].range == -math.inf


def test_range_noise_has_the_spread_it_was_given():
    g = ground(rex={"range": {"noise": 0.02}}, obstacles=[{"at": [2.5, 2], "size": [0.2, 2]}])
    errors = [distance - (2.4 - 1.125) for distance in ranges(g, until=50)]
    spread = math.sqrt(sum(error**2 for error in errors) / len(errors))
    assert spread == pytest.approx(0.02, rel=0.1)


def test_odometry_is_wrong_by_little_and_stays_so():
    g = ground(rex={"watchdog": 0})
    heard = g.hear("/REX/odom", ODOMETRY)
    g.run(0)
    g.drive(0.3, 0.3)
    errors = []
    for second in range(1, 120):
        g.run(second)
        pose, true = heard[-1].pose.pose, g.world.robots["REX"].pose
        errors.append(math.dist((pose.position.x, pose.position.y), true[:2]))
        heading = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
        assert abs(math.remainder(heading - true.heading, math.tau)) < 0.015
        assert heard[-1].twist.twist.linear.x == pytest.approx(0.3, abs=0.03)
    assert 0 < max(errors[:60]) < 0.025
    assert 0 < max(errors[60:]) < 0.025


def test_odometry_says_how_wrong_it_may_be():
    g = ground(rex={"odom": {"position_noise": 0.02}})
    heard = g.hear("/REX/odom", ODOMETRY)
    g.run(0)
    assert heard[0].pose.covariance[0] == pytest.approx(0.0004)


def test_another_robot_does_not_change_what_a_sensor_draws():
    def noise(**more):
        g = ground(obstacles=[{"at": [2.5, 2], "size": [0.2, 2]}], **more)
        return ranges(g, until=3)

    assert noise() == noise(robots={"DINGO": {"type": "car", "at": [5, 3]}})
    assert noise() != noise(seed=2)


def test_a_generator_is_the_same_in_every_process():
    here = generator(7, "REX", "range").standard_normal()
    program = (
        "from sim2d.randomness import generator; print(repr(float(generator(7, 'REX', 'range').standard_normal())))"
    )
    there = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert float(there) == here
    assert generator(7, "REX", "odom").standard_normal() != here
    assert generator(8, "REX", "range").standard_normal() != here
