"""The world is what its file says, refuses what cannot be, and runs the same way every time."""

import hashlib
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import pymunk
import pytest
from grounds import Ground, ground

from fame.config.values import ConfigValue
from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from sim2d.config import read_world, world_config
from sim2d.ground import Circle, Polygon, convex
from sim2d.world import World

ROOT = Path(__file__).parents[1]
WORLD = """\
size: [6, 4]
obstacles:
  - {name: rock, at: [2, 2], radius: 0.3}
  - {at: [4, 1], size: [0.5, 1.2], angle: 90}
  - {polygon: [[4, 3], [4.3, 3.5], [4.6, 3]]}
targets:
  - {name: target, at: [5, 3.5], radius: 0.1}
robots:
  REX:   {type: car, at: [0.5, 0.5], heading: 90}
  DINGO: {type: car, at: [0.5, 3.5], friction: smooth, range: {max: 3.0}}
"""


def read(tmp_path, text):
    file = tmp_path / "world.yaml"
    file.write_text(text, encoding="utf-8")
    return read_world(file)


# ---- what a file says ------------------------------------------------------------------------------------------------


def test_a_world_file_says_bounds_obstacles_targets_and_robots(tmp_path):
    world = read(tmp_path, WORLD)
    assert world.bounds == (0, 0, 6, 4)
    assert [thing.name for thing in world.obstacles] == ["rock", "obstacle_2", "obstacle_3"]
    assert world.obstacles[0].shape == Circle((2, 2), 0.3)
    assert isinstance(world.obstacles[1].shape, Polygon)
    assert sorted(world.obstacles[1].shape.corners)[0] == pytest.approx((3.4, 0.75))
    assert [(robot.name, robot.at) for robot in world.robots] == [("REX", (0.5, 0.5)), ("DINGO", (0.5, 3.5))]
    assert world.robots[0].heading == pytest.approx(math.pi / 2)
    assert world.robots[1].parameters.friction == 0.12
    assert world.robots[1].parameters.range.max == 3
    assert world.robots[1].parameters.range.noise == 0.01


def test_the_example_of_the_documentation_can_be_read(tmp_path):
    text = (ROOT / "docs" / "world.md").read_text(encoding="utf-8")
    example = text.partition("```yaml\n")[2].partition("```")[0]
    assert [robot.name for robot in read(tmp_path, example).robots] == ["REX", "DINGO"]


@pytest.mark.parametrize(
    ("found", "instead", "line", "complaint"),
    [
        ("size: [6, 4]", "sise: [6, 4]", 1, "sise: unknown key; did you mean 'size'?"),
        ("size: [6, 4]", "size: [6]", 1, "size: expected [width, height] in m, got [6]"),
        ("size: [6, 4]", "size: [6, 0]", 1, "size: expected ground of 0.01 to 1000 m on each side, got [6, 0]"),
        (
            "size: [6, 4]",
            "step: 0.01",
            1,
            "expected either size: [w, h] or bounds: [xmin, ymin, xmax, ymax], got neither",
        ),
        ("size: [6, 4]", "size: [6, 4]\nstep: 0", 2, "step: expected a number from 0.0001 to 0.05, got 0"),
        ("radius: 0.3", "radius: 0", 3, "obstacles[0].radius: expected a number above 0, got 0"),
        ("radius: 0.3", "radius: .nan", 3, "obstacles[0].radius: expected a finite number above 0, got nan"),
        ("radius: 0.3", "radius: big", 3, "obstacles[0].radius: expected a number above 0, got 'big'"),
        ("radius: 0.3", "r: 0.3", 3, "obstacles[0].r: unknown key; known are: name, at, radius, size, angle, polygon"),
        (", radius: 0.3", "", 3, "obstacles[0]: expected one of radius, size and polygon, got none"),
        (
            "radius: 0.3",
            "radius: 0.3, size: [1, 1]",
            3,
            "expected one of radius, size and polygon, got radius and size",
        ),
        ("at: [2, 2], radius", "radius", 3, "obstacles[0]: expected the key at: [x, y] in m"),
        ("at: [2, 2]", "at: [2, .inf]", 3, "obstacles[0].at[1]: expected a finite number, got inf"),
        ("at: [2, 2]", "at: [20, 2]", 3, "obstacles[0]: expected a place inside [0.0, 0.0, 6.0, 4.0]; rock is"),
        (
            "size: [0.5, 1.2]",
            "size: [0.5, -1]",
            4,
            "obstacles[1].size: expected a width and a height above 0, got [0.5, -1]",
        ),
        (
            "size: [0.5, 1.2], angle",
            "size: [0.5, 1.2], angel",
            4,
            "obstacles[1].angel: unknown key; did you mean 'angle'",
        ),
        ("[4.3, 3.5], [4.6, 3]", "[5, 3]", 5, "obstacles[2].polygon: expected the corners of a convex polygon"),
        ("[4.6, 3]]", "[4.6, 3], [4.3, 3.2]]", 5, "of a convex polygon"),
        (
            "  - {polygon",
            "  - {name: rock, polygon",
            5,
            "expected a name of its own, got a second obstacle named 'rock'",
        ),
        (
            "type: car, at: [0.5, 0.5]",
            "type: cart, at: [0.5, 0.5]",
            9,
            "robots.REX.type: expected a robot type, got 'cart'; did",
        ),
        (
            "type: car, at: [0.5, 0.5]",
            "at: [0.5, 0.5]",
            9,
            "robots.REX: expected the key type: one of car, ",
        ),
        ("at: [0.5, 0.5]", "at: [0.5, 5]", 9, "robots.REX.at: expected a place on the ground"),
        ("heading: 90", "headng: 90", 9, "robots.REX.headng: unknown key; did you mean 'heading'?"),
        ("heading: 90", "watchdog: -1", 9, "robots.REX.watchdog: expected a number of at least 0, got -1"),
        (
            "friction: smooth",
            "friction: smoth",
            10,
            "robots.DINGO.friction: expected a number or a name, got 'smoth'; did you mean 'smooth'?",
        ),
        ("max: 3.0", "maxi: 3.0", 10, "robots.DINGO.range.maxi: unknown key; did you mean 'max'?"),
        ("max: 3.0", "min: 3.0", 10, "robots.DINGO.range.min: expected min to be at most max (2), got 3"),
        ("max: 3.0", "max: 0.01", 10, "robots.DINGO.range.max: expected min to be at most max (0.01), got 0.02"),
        (
            "max: 3.0",
            "noise: 1.0e+300",
            10,
            "robots.DINGO.range.noise: expected a number from 0 to 1e+09, got 1e+300",
        ),
        ("max: 3.0", "rate: 1.0e-320", 10, "range.rate: expected a number of at least 1e-06, got 1e-320"),
        ("max: 3.0", "rays: 1000000", 10, "expected a whole number from 2 to 1000, got 1000000"),
        (
            "heading: 90",
            f"heading: {10**400}",
            9,
            "robots.REX.heading: expected a number from -1e+09 to 1e+09, got a larger",
        ),
        ("size: [6, 4]", "step: 1.0e-12\nsize: [6, 4]", 1, "step: expected a number from 0.0001 to 0.05, got 1e-12"),
        (
            "size: [6, 4]",
            "resolution: 0.01\nsize: [900, 900]",
            1,
            "resolution: expected a resolution of at least 0.18, got a map of 8",
        ),
        ("name: rock", 'name: "r\\0ck"', 3, "a text of one line without control characters"),
        ("max: 3.0", "rays: 2.5", 10, "robots.DINGO.range.rays: expected a whole number from 2 to 1000, got 2.5"),
        ("  DINGO:", "  rex:", 10, "robots.rex: expected names that differ in more than case, got 'REX' and 'rex'"),
        ("  DINGO:", "  REX:", 10, "robots.REX: is given twice"),
        (
            "  DINGO:",
            "  big dog:",
            10,
            "expected a name of ASCII letters, digits and _ that begins with a letter, got 'big dog'",
        ),
        (
            "  DINGO:",
            "  Käfer:",
            10,
            "expected a name of ASCII letters, digits and _ that begins with a letter, got 'Käfer'",
        ),
        ("targets:\n  - {name: target, at: [5, 3.5], radius: 0.1}", "targets: 3", 6, "targets: expected a list, got 3"),
        ("robots:", "robots: [", 10, "is not valid YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_file_line_and_key(tmp_path, found, instead, line, complaint):
    assert WORLD.count(found) == 1
    with pytest.raises(ConfigError) as error:
        read(tmp_path, WORLD.replace(found, instead))
    where = f"world.yaml:{line}: " if line else "world.yaml: "
    assert where in str(error.value)
    assert complaint in str(error.value)


def test_a_file_that_is_missing_empty_or_no_text_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read_world(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="expected a mapping of keys to values, got an empty file"):
        read(tmp_path, "")
    (tmp_path / "picture.yaml").write_bytes(b"\x89PNG\xff")
    with pytest.raises(ConfigError, match="is not UTF-8 text"):
        read_world(tmp_path / "picture.yaml")


def test_an_alias_that_contains_itself_is_refused_without_end_of_memory(tmp_path):
    with pytest.raises(ConfigError, match="obstacles"):
        read(tmp_path, "size: [6, 4]\nobstacles: &a [*a]\n")


@pytest.mark.parametrize(
    ("place", "thing"),
    [
        ([2, 2], "overlaps rock"),
        ([0.05, 2], "overlaps wall"),
        ([5, 3.5], "overlaps target"),
        ([0.6, 3.5], "overlaps DINGO"),
    ],
)
def test_a_robot_that_stands_in_something_is_refused(tmp_path, place, thing):
    robots = "  DINGO: {type: car, at: [0.5, 3.5]}\n" + f"  REX: {{type: car, at: {place}}}\n"
    config = read(tmp_path, WORLD.partition("  REX:")[0] + robots)
    with pytest.raises(ConfigError, match=f"world.yaml:10: robots.REX: expected a free place; REX {thing}"):
        Ground(config)


@pytest.mark.parametrize(
    ("corners", "right"),
    [
        ([(0, 0), (1, 0), (0, 1)], True),
        ([(0, 0), (0, 1), (1, 0)], True),
        ([(0, 0), (1, 0), (2, 0), (2, 2)], True),
        ([(0, 0), (1, 0), (2, 0)], False),
        ([(0, 0), (1, 0)], False),
        ([(0, 0), (2, 0), (1, 1), (2, 2), (0, 2)], False),
        ([(0, 0), (0, 0), (1, 0), (1, 1)], False),
        ([(math.cos(i * 4 * math.pi / 5), math.sin(i * 4 * math.pi / 5)) for i in range(5)], False),
    ],
)
def test_only_convex_corners_make_a_polygon(corners, right):
    assert (convex(corners) is not None) is right


# ---- how it runs -----------------------------------------------------------------------------------------------------


def test_world_time_is_a_count_of_steps():
    g = ground(step=0.007)
    g.run(7)
    assert g.world.steps == 1000
    assert g.world.now == 7.0


def test_a_world_that_was_stopped_stands_still_and_goes_on_when_started():
    g = ground(rex={"watchdog": 0})
    g.run(0)
    g.drive(0.5)
    g.run(1)
    g.world.stop()
    there = g.world.robots["REX"].pose
    g.scheduler.run(g.scheduler.now + 10**9)
    assert g.world.robots["REX"].pose == there
    g.world.start()
    g.scheduler.run(g.scheduler.now + 10**9)
    assert g.world.now == 2
    assert g.world.robots["REX"].pose.x == pytest.approx(there.x + 0.5)


def test_a_world_can_be_stopped_from_within_a_step():
    g = ground()
    g.world.watchers.append(lambda world: world.stop() if world.steps == 10 else None)
    g.run(1)
    assert g.world.steps == 10


def test_without_walls_a_robot_leaves_the_ground():
    g = ground(walls=False, rex={"watchdog": 0, "at": [5.5, 2]})
    g.run(0)
    g.drive(1)
    g.run(3)
    assert g.world.robots["REX"].pose.x > 7
    assert not g.world.collisions


def test_the_summary_says_where_robots_are_and_how_far_from_targets():
    g = ground(targets=[{"name": "weed", "at": [4, 6 - 2.1], "radius": 0.05}], rex={"heading": 540})
    g.run(1)
    summary = g.world.summary()
    assert json.loads(json.dumps(summary)) == summary
    assert summary == {
        "time": 1.0,
        "robots": {
            "REX": {
                "x": 1.0,
                "y": 2.0,
                "heading": pytest.approx(math.pi, abs=1e-4) if summary["robots"]["REX"]["heading"] > 0 else -3.1416,
                "led": "off",
                "faults": [],
                "collisions": 0,
                "distances": {"weed": round(math.dist((1, 2), (4, 3.9)), 4)},
            }
        },
        "weeds": {},
        "collisions": [],
    }


def test_a_robot_is_broken_by_name_and_the_summary_says_so():
    g = ground()
    g.run(1)
    g.world.fault("REX", "wheels")
    g.drive(1)
    g.run(2)
    assert g.world.summary()["robots"]["REX"]["faults"] == ["wheels"]
    assert g.world.robots["REX"].pose == (1, 2, 0)
    with pytest.raises(ConfigError, match="unknown fault 'wings' of REX, a car; known are: range, wheels"):
        g.world.fault("REX", "wings")
    with pytest.raises(ConfigError, match="unknown robot 'RIX' in a fault; did you mean 'REX'"):
        g.world.fault("RIX", "wheels")


def outcome(seed: int) -> tuple[int, str]:
    """How many collisions two cars have, and a digest of all that they say."""
    g = ground(
        seed=seed,
        obstacles=[{"at": [2.5, 2.1], "radius": 0.3}],
        rex={"watchdog": 0},
        robots={"DINGO": {"type": "car", "at": [1, 3], "heading": -40, "watchdog": 0}},
    )
    types = {"odom": "nav_msgs/msg/Odometry", "range": "sensor_msgs/msg/Range"}
    heard = [g.hear(f"/{name}/{topic}", type) for name in ("REX", "DINGO") for topic, type in types.items()]
    g.run(0)
    g.drive(0.6, 0.2)
    g.drive(0.8, 0.0, "DINGO")
    g.run(10)
    text = repr([[messages.to_mapping(message) for message in topic] for topic in heard]) + repr(g.world.collisions)
    return len(g.world.collisions), hashlib.sha256(text.encode()).hexdigest()


def test_no_robot_is_anywhere_that_is_not_finite():
    g = ground()
    g.run(1)
    g.world.robots["REX"].body.velocity = (math.nan, 0.0)
    with pytest.raises(MissionError, match="REX: its simulation has failed: it is at Pose"):
        g.run(2)


@pytest.mark.long
def test_the_same_seed_gives_the_same_bytes_in_another_process():
    code = "import sys; sys.path[:0] = ['tests']; from test_world import outcome; print(*outcome(1))"
    command = [sys.executable, "-c", code]
    there = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    first, other = outcome(1), outcome(2)
    assert there == [*map(str, first)]
    assert first[0] > 0
    assert first[1] != other[1]


def test_two_cars_with_all_their_sensors_drive_without_a_collision():
    g = ground(
        obstacles=[{"at": [3, 1], "radius": 0.3}, {"at": [3, 3], "size": [1, 0.2]}],
        targets=[{"at": [5, 3], "radius": 0.1}],
        rex={"watchdog": 0},
        robots={"DINGO": {"type": "car", "at": [5, 1], "watchdog": 0}},
    )
    g.run(0)
    g.drive(0.3, 0.5)
    g.drive(0.3, 0.5, "DINGO")
    g.run(4)
    assert g.world.collisions == []


def test_a_mapping_without_a_file_is_refused_by_its_keys():
    with pytest.raises(ConfigError, match=r"^world.robots.REX.type: expected a robot type, got 'boat'"):
        world_config(ConfigValue({"size": [1, 1], "robots": {"REX": {"type": "boat"}}}, "world"))


def test_a_closed_world_leaves_nothing_to_the_collector() -> None:
    at = ground(obstacles=[{"name": "rock", "at": [3, 3], "radius": 0.5}])
    at.world.close()
    assert not at.world.space.shapes
    assert not at.world.space.bodies


def test_a_world_that_cannot_be_built_leaves_nothing_either() -> None:
    spaces: list[pymunk.Space] = []
    with pytest.raises(ConfigError) as caught:
        ground(obstacles=[{"name": "rock", "at": [1, 2], "radius": 0.5}])
    frame = caught.value.__traceback__
    while frame is not None:
        spaces += [item.space for item in frame.tb_frame.f_locals.values() if isinstance(item, World)]
        frame = frame.tb_next
    assert spaces
    assert not any(space.shapes or space.bodies for space in spaces)


@pytest.mark.parametrize("text", ["walls: !!bool maybe", "step: !!int ''", "size: !!timestamp x", "size: " + "[" * 600])
def test_what_yaml_itself_stumbles_over_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"is not valid YAML|is nested too deeply"):
        read(tmp_path, text)


def test_a_list_of_lists_of_itself_many_times_is_refused_at_once(tmp_path: Path) -> None:
    lists = [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]" for level in range(1, 12)]
    with pytest.raises(ConfigError, match="expected a text as key"):
        read(tmp_path, "size: &a0 [x]\n1: 2\n" + "\n".join(lists))
    nested: list = ["x"]
    for _ in range(30):
        nested = [nested] * 10
    with pytest.raises(ConfigError, match=r"size: expected .*, got \[\["):
        world_config({"size": nested})


def test_a_world_that_goes_on_measures_nothing_twice() -> None:
    g = ground(rex={"type": "tractor", "battery": {"capacity": 0.01}})
    heard = g.hear("/REX/odom", "nav_msgs/msg/Odometry")
    g.run(1)
    before = g.world.summary(), len(heard)
    for _ in range(3):
        g.world.stop()
        g.world.start()
        g.run(1)
    assert (g.world.summary(), len(heard)) == before
    g.run(1.05)
    assert len(heard) == before[1] + 1


@pytest.mark.parametrize(
    ("number", "limits", "text"),
    [
        (1e12, {"above": 0}, "a number above 0 and at most 1e+09, got 1000000000000.0"),
        (1e12, {"minimum": 0, "maximum": 1e15}, "a number from 0 to 1e+09, got 1000000000000.0"),
        (-(10**20), {"minimum": 0}, "a number from 0 to 1e+09, got a smaller whole number"),
        (12345678.5, {"maximum": 12345678}, "a number of at most 12345678, got 12345678.5"),
    ],
)
def test_a_refused_number_is_told_the_limits_that_hold(number: float, limits: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"expected {text}") + "$"):
        ConfigValue(number).number(**limits)
