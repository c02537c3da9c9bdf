"""The planner finds short ways around what is in the map, and says so where there is none."""

import math
from itertools import pairwise

import numpy as np
import pytest
from grounds import ground

from fame.middleware import messages
from robots.planner import nearest_free, route
from sim2d.grid import Grid, from_message, inflate, rasterise
from sim2d.ground import Circle, box

MAP, PLAN, GOAL = "nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
BOUNDS = (0.0, 0.0, 6.0, 4.0)


def length(places):
    return sum(math.dist(a, b) for a, b in pairwise(places))


def plan(g, x, y, **pose):
    heard = g.hear("/REX/plan", PLAN)
    g.run(0)
    g.say("/REX/goal_pose", GOAL, {"pose": {"position": {"x": x, "y": y}, **pose}})
    g.run(0.1)
    (path,) = heard
    return [(at.pose.position.x, at.pose.position.y) for at in path.poses], path


def clearance(places, obstacle, radius):
    """The least distance (m) from a way to a disc."""
    samples = [np.linspace(a, b, 200) for a, b in pairwise(places)]
    return min(float(np.hypot(*(line - obstacle).T).min()) for line in samples) - radius


# ---- the map ---------------------------------------------------------------------------------------------------------


def test_the_map_shows_obstacles_and_the_rim_but_no_target_and_no_robot():
    obstacles, targets = [{"at": [3, 2], "radius": 0.3}], [{"at": [5, 3], "radius": 0.2}]
    g = ground(obstacles=obstacles, targets=targets)
    g.run(1)
    heard = g.hear("/REX/map", MAP, latched=True)  # as one that comes late
    g.run(1.1)
    grid = from_message(heard[0])
    assert grid.occupied.shape == (82, 122)
    assert grid.origin == pytest.approx((-0.05, -0.05))

    def occupied(x, y):
        return bool(grid.occupied[math.floor((y + 0.05) / 0.05), math.floor((x + 0.05) / 0.05)])

    assert occupied(3, 2)
    assert occupied(3.29, 2)
    assert not occupied(3.4, 2)
    assert not occupied(5, 3)
    assert not occupied(1, 2)
    assert occupied(-0.01, 2)
    assert not occupied(0.01, 2)


@pytest.mark.parametrize("yaw", [math.pi / 2, math.pi, -0.7])
def test_a_turned_map_is_turned_about_its_origin(yaw):
    cells = np.zeros((20, 30), dtype=np.int8)
    cells[5, 10] = 100
    turn = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    origin = {"position": {"x": 1.0, "y": 2.0}, "orientation": turn}
    info = {"resolution": 0.1, "width": 30, "height": 20, "origin": origin}
    grid = from_message(messages.create(MAP, {"info": info, "data": cells.ravel()}))

    def occupied(x, y):
        """At a place on the map as it was drawn."""
        place = 1 + x * math.cos(yaw) - y * math.sin(yaw), 2 + x * math.sin(yaw) + y * math.cos(yaw)
        return bool(grid.occupied[grid.cell(place)])

    assert all(occupied(1.0 + x, 0.5 + y) for x in (0.01, 0.05, 0.09) for y in (0.01, 0.05, 0.09))
    assert not any(occupied(x, y) for x, y in ((0.5, 0.5), (1.5, 0.5), (1.0, 1.0), (2.9, 1.9), (0.05, 1.9)))
    if yaw == -0.7:
        assert grid.occupied[0, 0]  # outside of the map


@pytest.mark.parametrize("shape", [Circle((2.03, 1.51), 0.33), box((3, 2), 0.7, 0.4, 0.5)])
def test_every_cell_that_an_obstacle_touches_is_occupied(shape):
    grid = rasterise(BOUNDS, [shape], 0.05)
    for degree in range(360):
        x, y = _on_edge(shape, math.radians(degree))
        row, column = math.floor((y - grid.origin[1]) / 0.05), math.floor((x - grid.origin[0]) / 0.05)
        assert grid.occupied[row, column]
    assert grid.occupied[1:-1, 1:-1].sum() * 0.05**2 < 0.6


def _on_edge(shape, angle):
    x, y = math.cos(angle), math.sin(angle)
    if isinstance(shape, Circle):
        return shape.centre[0] + shape.radius * x, shape.centre[1] + shape.radius * y
    turned = 0.35 * max(-1, min(1, 1.4 * x)), 0.2 * max(-1, min(1, 1.4 * y))
    cos, sin = math.cos(0.5), math.sin(0.5)
    return shape.centre[0] + turned[0] * cos - turned[1] * sin, shape.centre[1] + turned[0] * sin + turned[1] * cos


def test_inflation_reaches_as_far_as_it_says_in_every_direction():
    cells = np.zeros((41, 41), dtype=np.bool_)
    cells[20, 20] = True
    inflated = inflate(Grid(cells, 0.1, (0.0, 0.0)), 1.0).occupied
    rows, columns = np.indices(cells.shape)
    assert (inflated == (np.hypot(rows - 20, columns - 20) <= 10)).all()


# ---- the search ------------------------------------------------------------------------------------------------------


def test_the_way_over_open_ground_is_a_straight_line():
    grid = rasterise(BOUNDS, [], 0.05)
    assert route(grid, (0.51, 0.52), (5.23, 3.31), 0) == [(0.51, 0.52), (5.23, 3.31)]


def test_the_way_around_a_wall_is_the_shorter_one():
    grid = inflate(rasterise(BOUNDS, [box((3, 1.5), 0.1, 3, 0)], 0.05), 0.2)  # from the lower edge up to y = 3
    way = route(grid, (1, 2), (5, 2), 0)
    best = 2 * math.dist((1, 2), (2.75, 3.25)) + 0.5
    assert best - 0.1 < length(way) < 1.03 * best
    assert max(y for _, y in way) == pytest.approx(3.25, abs=0.1)


def test_there_is_no_way_through_a_closed_wall():
    grid = rasterise(BOUNDS, [box((3, 2), 0.1, 4, 0)], 0.05)
    assert route(grid, (1, 2), (5, 2), 0) is None


def test_a_goal_in_an_obstacle_is_replaced_by_the_nearest_free_place_if_that_is_near_enough():
    grid = rasterise(BOUNDS, [Circle((3, 2), 0.3)], 0.05)
    assert route(grid, (1, 2), (3, 2), 0.2) is None
    way = route(grid, (1, 2), (3, 2), 0.5)
    assert math.dist(way[-1], (3, 2)) == pytest.approx(0.36, abs=0.04)


def test_a_start_too_close_to_an_obstacle_is_left_by_the_shortest_way():
    grid = inflate(rasterise(BOUNDS, [], 0.05), 0.3)
    way = route(grid, (0.1, 2), (4, 2), 0)
    assert way[0] == (0.1, 2)
    assert math.dist(way[0], way[1]) < 0.3
    assert way[-1] == (4, 2)


def test_the_start_is_a_way_to_itself_and_outside_the_map_there_is_none():
    grid = rasterise(BOUNDS, [], 0.05)
    assert route(grid, (1, 1), (1, 1), 0) == [(1, 1), (1, 1)]
    assert route(grid, (1, 1), (7, 1), 9) is None
    assert nearest_free(Grid(np.ones((3, 3), dtype=np.bool_), 1, (0, 0)), (1, 1), math.inf) is None


def test_there_is_a_way_between_many_discs():
    random = np.random.default_rng(3)
    discs = [Circle((x, y), 0.35) for x, y in random.uniform(1, 9, (25, 2)).tolist()]
    grid = inflate(rasterise((0, 0, 10, 10), discs, 0.05), 0.2)
    assert route(grid, (0.3, 0.3), (9.7, 9.7), 0.5) is not None


# ---- the node --------------------------------------------------------------------------------------------------------


def test_a_goal_is_answered_with_a_path_around_obstacles():
    g = ground(obstacles=[{"at": [3, 2], "radius": 0.3}])
    places, path = plan(g, 5, 2, orientation={"z": 1, "w": 0})
    assert places[0] == pytest.approx((1, 2), abs=0.03)
    assert places[-1] == (5, 2)
    assert clearance(places, (3, 2), 0.3) > 0.15
    assert length(places) < 4.3
    assert path.header.frame_id == "map"
    assert path.poses[-1].pose.orientation.z == 1
    first = path.poses[0].pose.orientation
    assert 2 * math.atan2(first.z, first.w) == pytest.approx(
        math.atan2(places[1][1] - places[0][1], places[1][0] - places[0][0])
    )


def test_the_planner_knows_no_target():
    g = ground(targets=[{"at": [3, 2], "radius": 0.3}])
    assert len(plan(g, 5, 2)[0]) == 2


@pytest.mark.parametrize("goal", [(5, 2), (9, 9), (math.nan, 1)], ids=["behind walls", "outside", "no number"])
def test_an_unreachable_goal_is_answered_with_an_empty_path(goal):
    g = ground(obstacles=[{"at": [3, 2], "size": [0.1, 4]}])
    assert plan(g, *goal)[0] == []


def test_a_goal_that_comes_before_map_and_odometry_is_answered_when_they_are_there():
    g = ground()
    heard = g.hear("/REX/plan", PLAN)
    g.say("/REX/goal_pose", GOAL, {"pose": {"position": {"x": 5.0, "y": 2.0}}})
    g.scheduler.run()
    assert heard == []
    g.run(0.1)
    assert len(heard) == 1
    assert len(heard[0].poses) == 2


@pytest.mark.parametrize("distance", [3.0, 1e6])
def test_inflation_by_more_than_the_ground_leaves_nothing_free(distance):
    assert inflate(rasterise((0, 0, 6, 1), [], 0.05), distance).occupied.all()


def test_a_passage_that_is_too_narrow_is_left_by_its_end_and_not_through_its_wall():
    walls = [box((3, y), 3.0, 0.1, 0.0) for y in (1.7, 2.3)]
    ground = rasterise((0, 0, 6, 4), walls, 0.05)
    way = route(inflate(ground, 0.5), (3.2, 2.0), (3.0, 3.5), 0.0, ground)
    assert way is not None
    assert all(abs(y - 2.0) < 0.25 for x, y in way if 1.5 < x < 4.5 and y < 2.7)
    assert way[1][0] > 4.5


def test_on_a_coarse_map_the_way_keeps_clear_of_the_walls_all_the_same():
    g = ground(resolution=0.5, rex={"planner": {"margin": 0, "tolerance": 1}})
    plans = g.hear("/REX/plan", "nav_msgs/msg/Path")
    g.run(0.1)
    g.say("/REX/goal_pose", "geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 5.0, "y": 0.02}}})
    g.run(0.2)
    assert min(pose.pose.position.y for pose in plans[0].poses) > g.world.robots["REX"].drive.radius
