"""Values as plain data for recordings and watchers, with orjson and without it, and in snapshots."""

import json
from array import array
from collections import Counter, defaultdict, deque
from typing import Any, cast

import numpy
import pytest

from fame.engine.encoding import decode, encode
from fame.fast_json import json_bytes
from fame.middleware import messages
from fame.middleware.messages import message_type
from fame.middleware.typesystem import register
from fame.robot import plain_values
from fame.robot.plain_values import content_of, encoded, plain

VALUES = [
    messages.create("geometry_msgs/Twist", {"linear": {"x": 0.5, "y": -1.0}}),
    messages.create("std_msgs/String", {"data": 'a "quoted" line\nand ÿ'}),
    messages.create("sensor_msgs/Range", {"range": float("inf"), "max_range": 4.0}),
    messages.create("std_msgs/ColorRGBA", {"r": 0.25}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{"position": {"x": 0.1, "y": 1e-7}}] * 3}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{"position": {"x": float("nan")}}]}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{}] * (plain_values.ITEMS + 1)}),
    messages.create("sensor_msgs/BatteryState", {"cell_voltage": [0.1, 0.2]}),
    messages.create("nav_msgs/Odometry", {"child_frame_id": "100 %s", "pose": {"covariance": [0.5] * 36}}),
    messages.create("geometry_msgs/Point", {"x": float("nan"), "y": float("-inf"), "z": 2.0}),
    messages.create("std_msgs/String", {"data": "an infinite banana"}),
    messages.create("std_msgs/Bool", {"data": True}),
    messages.create("std_msgs/Empty"),
    messages.create("nav_msgs/Odometry", {"pose": {"covariance": [float("nan")] * 36}}),
    cast(Any, message_type("geometry_msgs/Point"))(x=numpy.float64(1.5), y=2, z=None),  # nothing is converted
    cast(Any, message_type("geometry_msgs/Point"))(x=numpy.float64(1.5), y=2, z=0.0),
    cast(Any, message_type("std_msgs/Bool"))(data=1),
    cast(Any, message_type("std_msgs/String"))(data=numpy.str_("a")),
    cast(Any, message_type("std_msgs/UInt8"))(data=-1 << 70),
    cast(Any, message_type("std_msgs/UInt64"))(data=2**64 - 1),
    messages.create("sensor_msgs/RegionOfInterest", {"height": 3, "do_rectify": True}),
    messages.create("sensor_msgs/Imu", {"header": {"frame_id": "imu", "stamp": {"sec": -1}}}),
    messages.create("sensor_msgs/CameraInfo", {"k": [float("inf")] * 9}),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_message_is_the_same_without_orjson(value: object, monkeypatch: pytest.MonkeyPatch) -> None:
    fast = plain(value)
    monkeypatch.setattr(plain_values, "orjson", None)
    assert plain(value) == fast


def test_an_array_of_messages_is_a_list() -> None:
    register("geometry_msgs/Point[2] ends", "plain_values_msgs/msg/Line")
    value = messages.create("plain_values_msgs/msg/Line", {"ends": [{"x": 1.0}, {"y": 2.0}]})
    assert plain(value) == {"ends": [{"x": 1.0, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 2.0, "z": 0.0}]}
    assert json.loads(encoded(value)[1]) == plain(value)


def test_values_are_the_same_only_if_their_json_is() -> None:
    assert encoded([1])[1] != encoded([True])[1] != encoded([1.0])[1]
    assert encoded(1)[1] != encoded(True)[1] != encoded(1.0)[1] == encoded(numpy.float64(1))[1]
    assert encoded(float("nan"))[1] == encoded(float("nan"))[1]
    array = numpy.array([1.0, 2.0])
    before, text = encoded(array)
    assert encoded(numpy.array([1.0, 2.0]))[1] == text
    array[1] = 3.0
    assert (json_bytes(before), encoded(array)[1] != text) == (b"[1.0,2.0]", True)


@pytest.mark.parametrize("value", [*VALUES, [1 << 70], {"a": "\ud800"}], ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("around", [1, 1 << 70])
def test_what_is_encoded_is_written_as_it_would_be(value: object, around: int) -> None:
    assert json_bytes([encoded(value)[0], around]) == json_bytes([plain(value), around])


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (numpy.float64(0.5), 0.5),
        (numpy.float32(0.5), 0.5),
        (numpy.int8(-3), -3),
        (numpy.bool_(True), True),
        (numpy.complex128(1 + 2j), "1+2j"),
        (numpy.array(2.5), 2.5),
        (numpy.array([[1, 2], [3, 4]]), [[1, 2], [3, 4]]),
        (numpy.array([0.1, numpy.nan], dtype="f"), [0.10000000149011612, "NaN"]),
        (numpy.array([1, 2], dtype=">i2"), [1, 2]),
        (numpy.array([True]), [True]),
        (numpy.array([], dtype=int), []),
        (numpy.zeros(17), {"$cut": "array of 17"}),
        (numpy.array([None, [1]], dtype=object), [None, [1]]),
        (array("d", [0.5, 1.5]), [0.5, 1.5]),
        (memoryview(b"ab"), [97, 98]),
        (memoryview(bytes(100)), {"$cut": "list of 100", "first": [0, 0, 0, 0]}),
        (bytearray(b"ab"), {"$cut": "2 bytes"}),
        (range(3), [0, 1, 2]),
        ({1, 2}, [1, 2]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_numbers_and_arrays_of_any_library_are_json(value: object, written: object) -> None:
    assert plain(value) == json.loads(json_bytes(plain(value))) == written


def test_what_is_in_a_value_tells_whether_it_was_changed_in_place() -> None:
    for value, change in (
        ([1, [2]], lambda each: each[1].append(3)),
        ({"a": 1}, lambda each: each.update(a=True)),
        (numpy.array([1.0]), lambda each: each.fill(2.0)),
        ([VALUES[0]], lambda each: each.append(VALUES[1])),
    ):
        before = content_of(value)
        assert before == content_of(value) is not None
        change(value)  # type: ignore[no-untyped-call]
        assert before != content_of(value)
    assert content_of([VALUES[0], []]) is None


def test_containers_of_any_kind_may_change_in_place() -> None:
    changeable = [[], {}, {1}, deque([1]), defaultdict(list), Counter("a"), array("d"), bytearray(b"a"), ([],), object]
    assert [plain_values.is_changeable(value) for value in changeable] == [True] * 9 + [False]
    fixed = [1, "a", b"a", (1, "a"), frozenset((1,)), numpy.float64(1), None, VALUES[0], range(3)]
    assert not any(map(plain_values.is_changeable, fixed))


def test_a_list_that_contains_itself_is_cut() -> None:
    around: list[object] = [1]
    around.append(around)
    assert json_bytes(plain(around)).startswith(b"[1," * 8 + b'{"$cut"')


class Length(float):
    """A subclass of float with a text of its own, as those of numpy have."""

    def __repr__(self) -> str:
        return f"Length({float(self)})"


def test_a_float_of_another_library_that_is_not_finite_is_stored_and_read_again() -> None:
    stored = json.loads(json.dumps(encode([Length("inf"), Length("-inf"), 2.5])))
    assert decode(stored) == [float("inf"), float("-inf"), 2.5]
