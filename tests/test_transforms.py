"""Transforms between frames: what a robot's buffer answers, what scripts ask, what the world says on /tf."""

import math

import numpy as np
import pytest
from deployment_field import definitions, process

import fame
from fame.bpmn.reader import read_text
from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.scripting.transforms import TF, TransformBuffer
from sim2d.world import World

Quaternion = tuple[float, float, float, float]


def matrix(place: tuple[float, float, float], turn: Quaternion) -> np.ndarray:
    """The 4 x 4 matrix of a pose (textbook formula, apart from the buffer's)."""
    x, y, z, w = turn
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = place
    return pose


def fields(parent: str, child: str, place=(0.0, 0.0, 0.0), turn: Quaternion = (0.0, 0.0, 0.0, 1.0), at: float = 0.0):
    """The fields of a message with one transform, `at` s."""
    stamp = {"sec": int(at), "nanosec": round(at % 1 * SECOND)}
    rotation = dict(zip("xyzw", map(float, turn), strict=True))
    transform = {"translation": dict(zip("xyz", map(float, place), strict=True)), "rotation": rotation}
    header = {"frame_id": parent, "stamp": stamp}
    return {"transforms": [{"header": header, "child_frame_id": child, "transform": transform}]}


def put(buffer: TransformBuffer, *what, static: bool = False, **more) -> None:
    buffer.put(messages.create(TF, fields(*what, **more)), static=static)


def found(buffer: TransformBuffer, target: str, source: str, at=None) -> np.ndarray:
    transform = buffer.lookup(target, source, at).transform
    place, turn = transform.translation, transform.rotation
    return matrix((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))


def yaw(degrees: float) -> Quaternion:
    return (0.0, 0.0, math.sin(math.radians(degrees) / 2), math.cos(math.radians(degrees) / 2))


def test_any_two_frames_of_a_tree_are_those_of_multiplied_matrices() -> None:
    random, buffer = np.random.default_rng(7), TransformBuffer("REX")
    in_map = {"map": np.eye(4)}
    for number in range(12):
        parent = str(random.choice(list(in_map)))
        turn = random.normal(size=4)
        pose = random.normal(size=3), tuple(turn / np.linalg.norm(turn))
        put(buffer, parent, f"f{number}", *pose, static=number % 3 == 0, at=5.0)
        in_map[f"f{number}"] = in_map[parent] @ matrix(*pose)
    for target, below in in_map.items():
        for source, above in in_map.items():
            assert found(buffer, target, source) == pytest.approx(np.linalg.inv(below) @ above, abs=1e-9)


def test_it_interpolates_at_the_latest_time_that_all_frames_have_reached() -> None:
    buffer = TransformBuffer("REX")
    for second in (0.0, 1.0, 2.0):
        put(buffer, "map", "odom", (second, 0.0, 0.0), yaw(90 * second), at=second)
    put(buffer, "odom", "base_link", at=1.5)
    answer = buffer.lookup("map", "base_link")
    assert (answer.header.stamp.sec, answer.header.stamp.nanosec) == (1, SECOND // 2)
    assert found(buffer, "map", "base_link") == pytest.approx(matrix((1.5, 0.0, 0.0), yaw(135)))
    stamp = messages.create("builtin_interfaces/msg/Time", {"sec": 0, "nanosec": SECOND // 4})
    assert found(buffer, "map", "odom", stamp) == pytest.approx(matrix((0.25, 0.0, 0.0), yaw(22.5)))
    assert buffer.lookup("map", "base_link", stamp) is None  # nothing is extrapolated
    put(buffer, "map", "odom", at=12.5)  # what is older than 10 s is forgotten
    assert buffer.lookup("map", "odom", stamp) is None


def test_what_is_no_transform_changes_nothing() -> None:
    buffer = TransformBuffer("REX")
    assert buffer.lookup("map", "base_link") is None
    put(buffer, "map", "base_link", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 0.0))
    put(buffer, "map", "base_link", (1.0, 2.0, 3.0), (math.nan, 0.0, 0.0, 1.0))
    put(buffer, "map", "map")
    assert buffer.lookup("map", "base_link") is None
    put(buffer, "a", "b")
    put(buffer, "b", "a")  # a ring
    assert buffer.lookup("map", "a") is None


ASKS = definitions(
    process(
        "REX",
        '<startEvent id="s"/><scriptTask id="ask"><script>'
        'await receive("/tf", "tf2_msgs/msg/TFMessage")\n'
        'here = robot.transform("map", "base_link").transform.translation.x\n'
        'lost = robot.transform("map", "camera")</script></scriptTask>',
        ("s", "ask"),
    )
)


def test_a_script_asks_for_its_own_frame_in_a_simulation() -> None:
    mission = fame.Simulation(read_text(ASKS), process="REX")
    mission.run(until=1)
    mission.signal("/tf", fields("map", "robot/base_link", (4.0, 0.0, 0.0)))
    mission.run(until=2)
    assert mission.instances[0].variables["here"] == 4.0
    assert mission.instances[0].variables["lost"] is None


def test_the_world_says_where_its_robots_are() -> None:
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    heard: list = []
    middleware.node("tool").subscription("/tf", TF, heard.append)
    world = World(
        {"bounds": [0, 0, 10, 10], "robots": {"REX": {"type": "car", "at": [3, 4]}}},
        scheduler=scheduler, middleware=middleware,
    )  # fmt: skip
    world.start()
    scheduler.run(SECOND)
    world.close()
    (last,) = heard[-1].transforms
    assert (last.header.frame_id, last.child_frame_id) == ("map", "REX/base_link")
    assert (last.transform.translation.x, last.transform.translation.y) == pytest.approx((3, 4), abs=0.1)
