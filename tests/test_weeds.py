"""Weeds are read and told of; any number of robots is placed on free ground."""

import itertools
import math
from dataclasses import replace

import pytest
from grounds import Ground, ground

from fame.errors import ConfigError
from sim2d.config import world_config
from sim2d.grid import place

FIELD = {
    "size": [20, 15],
    "obstacles": [{"at": [13, 5], "radius": 2}, {"at": [6, 10], "size": [3, 2], "angle": 20}],
    "weeds": [{"name": "thistle", "at": [4, 9], "radius": 0.2}, {"at": [13, 5]}],
    "robots": {
        "Drone": {"type": "drone", "at": [1, 1]},
        "Tractor_1": {"type": "tractor", "at": [2, 13]},
        "Tractor_2": {"type": "tractor", "at": [18, 7], "heading": 180, "max_speed": 0.7},
    },
}


def config(**changes):
    return world_config({**FIELD, **changes})


def test_weeds_have_names_places_and_sizes_and_may_be_in_an_obstacle():
    weeds = config().weeds
    assert [(weed.name, weed.at, weed.radius) for weed in weeds] == [
        ("thistle", (4, 9), 0.2),
        ("weed_2", (13, 5), 0.1),
    ]


@pytest.mark.parametrize(
    ("weeds", "complaint"),
    [
        ([{"name": "thistle"}], r"weeds\[0\]: expected the key at"),
        ([{"at": [30, 1]}], r"weeds\[0\].at: expected a place on the ground, .*, got \[30, 1\]"),
        ([{"at": [3, 1], "radius": 0}], r"weeds\[0\].radius: expected a number above 0, got 0"),
        ([{"at": [3, 1], "size": 1}], r"weeds\[0\].size: unknown key"),
        ([{"at": [3, 1], "name": "a"}, {"at": [4, 1], "name": "a"}], "a second weed named 'a'"),
        (3, "weeds: expected a list, got 3"),
    ],
)
def test_a_wrong_weed_is_refused(weeds, complaint):
    with pytest.raises(ConfigError, match=complaint):
        config(weeds=weeds)


def test_the_summary_tells_of_weeds_that_grow():
    g = Ground(config())
    g.run(0)
    assert g.world.summary()["weeds"] == {
        "thistle": {"x": 4, "y": 9, "cut": None, "by": None},
        "weed_2": {"x": 13, "y": 5, "cut": None, "by": None},
    }


# ---- placement -------------------------------------------------------------------------------------------------------


def test_as_many_robots_as_asked_for_stand_free_and_apart():
    robots = place(config(), "Tractor", 12, seed=3)
    assert [robot.name for robot in robots] == ["Drone", *(f"Tractor_{number}" for number in range(1, 13))]
    for one, other in itertools.combinations(robots, 2):
        assert math.dist(one.at, other.at) > 0.9
    Ground(replace(config(), robots=robots))  # refuses robots that stand in something


def test_those_of_the_file_keep_their_places_and_the_others_are_like_the_last_of_them():
    robots = {robot.name: robot for robot in place(config(), "Tractor", 3, seed=1)}
    assert robots["Tractor_1"].at == (2, 13)
    assert robots["Tractor_2"].at == (18, 7)
    assert robots["Tractor_3"].type == "tractor"
    assert robots["Tractor_3"].parameters.max_speed == 0.7


def test_fewer_than_in_the_file_are_the_first_of_them():
    assert [robot.name for robot in place(config(), "Tractor", 1, seed=1)] == ["Drone", "Tractor_1"]
    assert [robot.name for robot in place(config(), "Tractor", 0, seed=1)] == ["Drone"]


def test_places_are_those_of_the_seed_and_do_not_depend_on_how_many_follow():
    assert place(config(), "Tractor", 6, seed=1) == place(config(), "Tractor", 6, seed=1)
    assert place(config(), "Tractor", 6, seed=1) != place(config(), "Tractor", 6, seed=2)
    assert place(config(), "Tractor", 9, seed=1)[:7] == place(config(), "Tractor", 6, seed=1)


def test_a_kind_that_is_not_in_the_file_and_ground_that_is_full_are_refused():
    with pytest.raises(
        ConfigError, match="expected a robot Plough_1 to copy for Plough=2; robots are: Drone, Tractor_1"
    ):
        place(config(), "Plough", 2, seed=1)
    with pytest.raises(ConfigError, match=r"expected room for 998 more robots like Tractor_2, got room for \d+"):
        place(config(), "Tractor", 1000, seed=1)


@pytest.mark.parametrize("many", [100, pytest.param(1000, marks=pytest.mark.long)])
def test_many_robots_find_free_ground(many: int) -> None:
    wide = config(size=[80, 60], resolution=0.1)
    robots = place(wide, "Tractor", many, seed=1)
    assert len(robots) == many + 1
    g = Ground(replace(wide, robots=robots))
    g.run(0.1)
    assert g.world.collisions == []


def test_arms_in_the_world_are_kept_clear_of() -> None:
    arms = {"Arm_1": {"type": "mh5", "at": [5, 5]}, "Bench": {"type": "ur5e", "at": [3, 3]}}
    config = world_config({"size": [6, 6], "robots": {**arms, "Car_1": {"type": "car", "at": [1, 1]}}})
    for name in ("Car", "Arm"):
        robots = place(config, name, 5, 1)
        assert len(Ground(replace(config, robots=robots)).world.robots) == len(robots)


def test_a_weed_in_an_obstacle_is_not_cut_from_beside_it() -> None:
    rex = {"type": "tractor", "watchdog": 0}
    g = ground(rex=rex, obstacles=[{"at": [1, 3.2], "radius": 0.96}], weeds=[{"at": [1, 2.2]}, {"at": [1, 2.27]}])
    g.run(0)
    g.say("/REX/blade_force", "geometry_msgs/msg/Wrench", {"torque": {"z": 1.0}})
    g.run(2)
    assert [weed["by"] for weed in g.world.summary()["weeds"].values()] == ["REX", None]


@pytest.mark.parametrize("resolution", [0.05, 0.3, 1.0])
def test_ground_that_is_no_multiple_of_a_cell_has_robots_in_no_wall(resolution: float) -> None:
    cars = {"Car_1": {"type": "car", "at": [0.5, 0.5]}}
    config = world_config({"size": [4.37, 3.71], "resolution": resolution, "robots": cars})
    for seed in range(20):
        robots = place(config, "Car", 5, seed)
        assert len(Ground(replace(config, robots=robots)).world.robots) == 5
