"""Messages: types of ROS 2 Jazzy and registered ones, filling, plain data, and the wire."""

import copy
import json
import math
import re
import subprocess
import sys
from collections import UserDict, deque
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fame.errors import MessageError, ValueChanged
from fame.middleware import codec, typesystem
from fame.middleware.definitions import check_size, from_text
from fame.middleware.messages import (
    bare,
    create,
    default_payload,
    fields,
    is_wrapper,
    message_type,
    register,
    register_files,
    service,
    to_mapping,
    type_name,
    types,
)

WIRE = Path(__file__).resolve().parents[2] / "shared" / "data" / "ros2_jazzy_wire" / "samples.json"

INT32 = "an integer from -2147483648 to 2147483647 (int32)"


@pytest.fixture(autouse=True)
def _no_type_outlives_its_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typesystem, "_definitions", dict(typesystem._table()))
    monkeypatch.setattr(typesystem, "_broken", {})


# ---- types -----------------------------------------------------------------------------------------------------------


def test_all_types_of_the_common_interfaces_can_be_made_read_and_written() -> None:
    names = types()
    assert names == sorted(names)
    assert {"std_msgs/msg/String", "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"} <= set(names)
    assert len(names) >= 162
    for name in names:
        message = create(name)
        assert type_name(message) == name
        assert create(name, json.loads(json.dumps(to_mapping(message)))) == message


def test_a_type_may_be_named_without_msg() -> None:
    assert message_type("geometry_msgs/Twist") is message_type("geometry_msgs/msg/Twist")
    assert type_name(create(" std_msgs/String ")) == "std_msgs/msg/String"


@pytest.mark.parametrize(
    ("name", "suggestion"),
    [
        ("Vector3", "did you mean geometry_msgs/msg/Vector3"),
        ("geometry_msgs/msg/vector3", "did you mean geometry_msgs/msg/Vector3"),
        ("geometry_msg/Twist", "did you mean geometry_msgs/msg/Twist"),
        ("sensor_msgs/msg/LaserScanner", "did you mean sensor_msgs/msg/LaserScan"),
        ("std_srvs/srv/Trigger", "this is a service; its messages are std_srvs/srv/Trigger_Request and"),
        ("", "there is no such message type"),
        (
            "my_msgs/msg/Load",
            r"; the folder that has my_msgs is named in fame.yaml, here or above \(types: \[FOLDER\]\), or by --types",
        ),
    ],
)
def test_an_unknown_type_is_refused_with_the_names_most_like_it(name: str, suggestion: str) -> None:
    with pytest.raises(MessageError, match=suggestion):
        message_type(name)


def test_fields_are_told_as_a_msg_file_writes_them() -> None:
    assert fields("geometry_msgs/PoseWithCovariance") == {"pose": "geometry_msgs/msg/Pose", "covariance": "float64[36]"}
    assert fields("sensor_msgs/JointState")["name"] == "string[]"
    assert fields("std_msgs/Char") == {"data": "uint8"}
    assert fields("std_msgs/Empty") == {}


def test_constants_of_a_type_are_attributes_of_its_class() -> None:
    assert message_type("sensor_msgs/Range").INFRARED == 1
    assert create("sensor_msgs/BatteryState").POWER_SUPPLY_STATUS_CHARGING == 1


def test_a_wrapper_is_a_type_whose_only_field_is_data() -> None:
    assert is_wrapper("std_msgs/msg/String")
    assert not is_wrapper("std_msgs/msg/Empty")
    assert not is_wrapper("std_msgs/msg/Float64MultiArray")
    assert bare(create("std_msgs/String", "REX")) == "REX"
    point = create("geometry_msgs/Point")
    assert bare(point) is point
    assert default_payload("std_msgs/Bool") is False
    assert default_payload("geometry_msgs/Vector3") == {"x": 0.0, "y": 0.0, "z": 0.0}


def test_what_is_no_message_has_no_type_name() -> None:
    with pytest.raises(MessageError, match="expected a message, got 'Twist'"):
        type_name("Twist")  # type: ignore[arg-type]


# ---- defaults --------------------------------------------------------------------------------------------------------


def test_defaults_are_zeros_and_those_of_ros() -> None:
    odometry = create("nav_msgs/Odometry")
    assert odometry.pose.pose.position.x == 0.0
    assert odometry.pose.pose.orientation.w == 1.0
    assert odometry.child_frame_id == ""
    assert odometry.twist.covariance.shape == (36,)
    assert odometry.twist.covariance.dtype == np.float64


def test_messages_of_defaults_share_nothing() -> None:
    first, second = create("nav_msgs/Odometry"), create("nav_msgs/Odometry")
    first.pose.pose.position.x = 5.0
    first.pose.covariance[0] = 5.0
    path = create("nav_msgs/Path")
    path.poses.append(create("geometry_msgs/PoseStamped"))
    assert second.pose.pose.position.x == 0.0
    assert second.pose.covariance[0] == 0.0
    assert create("nav_msgs/Path").poses == []


# ---- filling ---------------------------------------------------------------------------------------------------------


def test_a_mapping_fills_the_fields_that_it_names() -> None:
    twist = create("geometry_msgs/Twist", {"linear": {"x": 0.5}})
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.5, 0.0, 0.0)


@pytest.mark.parametrize("make", [dict, MappingProxyType, UserDict])
def test_any_mapping_will_do(make: Any) -> None:
    assert create("geometry_msgs/Point", make({"x": 1, "z": 2})) == create("geometry_msgs/Point", {"x": 1.0, "z": 2.0})


def test_a_message_of_the_type_is_taken_as_it_is_at_any_depth() -> None:
    position = create("geometry_msgs/Point", {"x": 1})
    assert create("geometry_msgs/Point", position) is position
    assert create("geometry_msgs/Pose", {"position": position}).position is position
    assert create("geometry_msgs/Polygon", {"points": (create("geometry_msgs/Point32", {"y": 2}),)}).points[0].y == 2.0


@pytest.mark.parametrize(
    ("type", "value", "data"),
    [
        ("std_msgs/Bool", "true", True),
        ("std_msgs/Bool", "False", False),
        ("std_msgs/Bool", 1, True),
        ("std_msgs/Bool", np.True_, True),
        ("std_msgs/Int32", "7", 7),
        ("std_msgs/Int32", 7.0, 7),
        ("std_msgs/Int64", 2**63 - 1, 2**63 - 1),
        ("std_msgs/Int8", np.int64(-128), -128),
        ("std_msgs/Byte", b"\xff", 255),
        ("std_msgs/Float64", 3, 3.0),
        ("std_msgs/Float64", "1.5", 1.5),
        ("std_msgs/Float64", np.float32(0.5), 0.5),
        ("std_msgs/Float32", float("inf"), float("inf")),
        ("std_msgs/String", "closest", "closest"),
        ("std_msgs/String", 5, "5"),
        ("std_msgs/String", True, "true"),
        ("std_msgs/String", "grün \U0001f600", "grün \U0001f600"),
        ("std_msgs/String", {"data": "x"}, "x"),
    ],
)
def test_what_says_the_same_in_another_form_is_converted(type: str, value: Any, data: Any) -> None:
    message = create(type, value)
    assert message.data == data
    assert message.data.__class__ is data.__class__


@pytest.mark.parametrize(
    "values",
    [[1, "2", 3.0], (1, 2, 3), deque([1, 2, 3]), np.array([1, 2, 3]), np.array([1.0, 2.0, 3.0]), range(1, 4)],
    ids=["list", "tuple", "deque", "integers", "floats", "range"],
)
def test_any_sequence_of_numbers_fills_an_array(values: Any) -> None:
    position = create("sensor_msgs/JointState", {"position": values}).position
    assert position.dtype == np.float64
    assert position.tolist() == [1.0, 2.0, 3.0]


def test_an_array_is_copied_so_that_its_owner_may_go_on_with_it() -> None:
    source = np.zeros(3)
    message = create("sensor_msgs/JointState", {"position": source})
    source[0] = 9.0
    assert message.position[0] == 0.0


def test_bytes_fill_an_array_of_bytes() -> None:
    for value in (b"\x00\xff", bytearray(b"\x00\xff"), [0, 255]):
        assert create("std_msgs/UInt8MultiArray", {"data": value}).data.tolist() == [0, 255]
        assert create("std_msgs/ByteMultiArray", {"data": value}).data.tolist() == [0, 255]


@pytest.mark.parametrize(
    ("seconds", "sec", "nanosec"),
    [(0, 0, 0), (1.5, 1, 500_000_000), (-0.25, -1, 750_000_000), (0.9999999999, 1, 0), (2 * 10**9, 2 * 10**9, 0)],
)
def test_a_time_is_a_number_of_seconds(seconds: float, sec: int, nanosec: int) -> None:
    stamp = create("std_msgs/Header", {"stamp": seconds}).stamp
    assert (stamp.sec, stamp.nanosec) == (sec, nanosec)
    assert create("builtin_interfaces/Duration", {"sec": sec, "nanosec": nanosec}) == create(
        "builtin_interfaces/Duration", seconds
    )


@pytest.mark.parametrize(
    ("type", "value", "text"),
    [
        ("geometry_msgs/Vector3", {"x": "fast"}, "geometry_msgs/msg/Vector3: x: expected a number, got 'fast'"),
        ("geometry_msgs/Vector3", {"x": None}, "geometry_msgs/msg/Vector3: x: expected a number, got nothing (null)"),
        ("geometry_msgs/Vector3", {"x": True}, "geometry_msgs/msg/Vector3: x: expected a number, got true"),
        ("geometry_msgs/Vector3", {"x": [1]}, "geometry_msgs/msg/Vector3: x: expected a number, got a list"),
        ("geometry_msgs/Vector3", {"x": 10**400}, "expected a number"),
        (
            "geometry_msgs/Twist",
            {"linear": {"vx": 1}},
            "Twist: linear.vx: there is no such field; those of geometry_msgs/msg/Vector3 are x, y, z",
        ),
        ("std_msgs/Empty", {"x": 1}, "x: there is no such field; those of std_msgs/msg/Empty are none"),
        (
            "nav_msgs/Path",
            {"poses": [{}, {"pose": {"position": {"y": "a"}}}]},
            "nav_msgs/msg/Path: poses[1].pose.position.y: expected a number, got 'a'",
        ),
        ("sensor_msgs/JointState", {"position": [1, [2]]}, "position[1]: expected a number, got a list"),
        ("sensor_msgs/JointState", {"position": np.zeros((2, 2))}, "position[0]: expected a number, got a list"),
        ("sensor_msgs/JointState", {"position": 1.5}, "position: expected a list (float64[]), got 1.5"),
        ("sensor_msgs/JointState", {"position": {"a": 1}}, "expected a list (float64[]), got a mapping with a"),
        ("sensor_msgs/JointState", {"name": "arm"}, "name: expected a list (string[]), got 'arm'"),
        ("sensor_msgs/JointState", {"name": ["arm", {}]}, "name[1]: expected a text, got an empty mapping"),
        ("geometry_msgs/PoseWithCovariance", {"covariance": [1, 2]}, "expected 36 values (float64[36]), got 2"),
        (
            "geometry_msgs/PoseWithCovariance",
            {"covariance": np.zeros(37)},
            "expected 36 values (float64[36]), got 37",
        ),
        ("std_msgs/Int8", 128, "std_msgs/msg/Int8: data: expected an integer from -128 to 127 (int8), got 128"),
        ("std_msgs/UInt8", -1, "data: expected an integer from 0 to 255 (uint8), got -1"),
        ("std_msgs/Char", 256, "data: expected an integer from 0 to 255 (uint8), got 256"),
        ("std_msgs/UInt64", 2**64, "expected an integer from 0 to 18446744073709551615 (uint64)"),
        ("std_msgs/Int32", 1.5, f"data: expected {INT32}, got 1.5"),
        ("std_msgs/Int32", "1.5", f"data: expected {INT32}, got '1.5'"),
        ("std_msgs/Int32", float("nan"), f"data: expected {INT32}, got nan"),
        ("std_msgs/Int32", False, f"data: expected {INT32}, got false"),
        (
            "std_msgs/UInt8MultiArray",
            {"data": np.array([1, 300])},
            "[1]: expected an integer from 0 to 255 (uint8), got 300",
        ),
        (
            "std_msgs/Int32MultiArray",
            {"data": np.array([1.5])},
            f"data[0]: expected {INT32}, got 1.5",
        ),
        ("std_msgs/Float32", 1e39, "data: expected a number of at most 3.4e38 (float32), got 1e+39"),
        ("std_msgs/Bool", "yes", "data: expected true or false, got 'yes'"),
        ("std_msgs/Bool", 2, "data: expected true or false, got 2"),
        ("std_msgs/String", ["a"], "data: expected a text, got a list"),
        ("std_msgs/String", "a\0b", "expected a text without NUL characters"),
        ("std_msgs/String", "\ud800", "expected a text of valid characters (UTF-8)"),
        ("std_msgs/Header", {"stamp": "now"}, "expected seconds, or a mapping with sec and nanosec, got 'now'"),
        (
            "std_msgs/Header",
            {"stamp": 1e10},
            f"stamp: expected {INT32}, got 10000000000",
        ),
        (
            "std_msgs/Header",
            {"stamp": float("nan")},
            "expected seconds, or a mapping with sec and nanosec, got nan",
        ),
        ("geometry_msgs/Point", 5, "Point: expected geometry_msgs/msg/Point or a mapping with x, y, z, got 5"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_path_what_it_is_and_what_would_be_right(
    type: str, value: Any, text: str
) -> None:
    with pytest.raises(MessageError) as caught:
        create(type, value)
    assert text in str(caught.value)


def test_a_message_of_another_type_is_refused_even_with_the_same_fields() -> None:
    with pytest.raises(MessageError, match=r"position: expected geometry_msgs/msg/Point .*, got a geometry_msgs/msg/V"):
        create("geometry_msgs/Pose", {"position": create("geometry_msgs/Vector3")})


def test_the_error_knows_type_and_field() -> None:
    with pytest.raises(MessageError) as caught:
        create("geometry_msgs/Twist", {"angular": {"z": "left"}})
    assert (caught.value.type, caught.value.field) == ("geometry_msgs/msg/Twist", "angular.z")


# ---- messages as objects ---------------------------------------------------------------------------------------------


def test_messages_compare_by_value() -> None:
    value = {"pose": {"covariance": list(range(36))}}
    first, second = create("nav_msgs/Odometry", value), create("nav_msgs/Odometry", value)
    assert first == second
    second.pose.covariance[3] = -1.0
    assert first != second
    assert create("geometry_msgs/Point") != create("geometry_msgs/Vector3")
    assert copy.deepcopy(first) == first


def test_a_message_shows_its_fields_and_what_differs_inside_them_in_one_short_line() -> None:
    assert repr(create("std_msgs/Bool")) == "Bool(data=False)"
    assert repr(create("std_msgs/Empty")) == "Empty()"
    twist = create("geometry_msgs/Twist", {"linear": {"x": 0.5}})
    assert repr(twist) == "Twist(linear=Vector3(x=0.5), angular=Vector3())"
    scan = create("sensor_msgs/JointState", {"name": ["a"], "position": [0.5] * 100})
    assert "name=['a'], position=[0.5, 0.5, 0.5, 0.5, ... 100 in all], velocity=[]" in repr(scan)
    assert len(repr(create("std_msgs/String", "x" * 10_000))) < 120


def test_plain_data_is_json_even_of_numbers_that_numpy_made() -> None:
    message = create("std_msgs/Int64")
    message.data = np.int64(3)
    assert json.dumps(to_mapping(message)) == '{"data": 3}'
    image = create("sensor_msgs/Image", {"data": b"\x01\xff"})
    assert to_mapping(image)["data"] == [1, 255]


numbers = st.floats(allow_nan=False)


@given(st.tuples(numbers, numbers, numbers), st.lists(numbers, min_size=36, max_size=36), st.text(max_size=8))
def test_a_message_survives_plain_data_and_the_wire(
    xyz: tuple[float, float, float], covariance: list[float], frame: str
) -> None:
    value = {
        "header": {"frame_id": frame.replace("\0", "")},
        "pose": {"pose": {"position": dict(zip("xyz", xyz, strict=True))}, "covariance": covariance},
    }
    message = create("geometry_msgs/PoseWithCovarianceStamped", value)
    assert create("geometry_msgs/PoseWithCovarianceStamped", json.loads(json.dumps(to_mapping(message)))) == message
    assert codec.deserialize(codec.serialize(message), "geometry_msgs/PoseWithCovarianceStamped") == message


# ---- registered types ------------------------------------------------------------------------------------------------


def test_a_registered_type_is_like_any_other() -> None:
    text = """
        # a wheel
        uint8 LEFT=0
        uint8 RIGHT=1
        uint8 side 1   # which one
        float64 radius 0.15
        string<=5 label "front"
        float64[3] axis [0, 1, 0]
        int8[<=2] codes
        Header header
        string from
    """
    assert register(text, "robot_msgs/msg/Wheel") == ["robot_msgs/msg/Wheel"]
    assert register(text, "robot_msgs/msg/Wheel") == ["robot_msgs/msg/Wheel"]
    wheel = create("robot_msgs/Wheel", {"from": "axle", "codes": [1]})
    assert (wheel.side, wheel.radius, wheel.label, wheel.axis.tolist()) == (1, 0.15, "front", [0, 1, 0])
    assert wheel.RIGHT == 1
    assert wheel.from_ == "axle"
    assert to_mapping(wheel)["from"] == "axle"
    assert codec.deserialize(codec.serialize(wheel), "robot_msgs/Wheel") == wheel
    with pytest.raises(MessageError, match="label: expected a text of at most 5 bytes, got 'front left'"):
        create("robot_msgs/Wheel", {"label": "front left"})
    with pytest.raises(MessageError, match=r"codes: expected at most 2 values \(int8\[<=2\]\), got 3"):
        create("robot_msgs/Wheel", {"codes": [1, 2, 3]})


@pytest.mark.parametrize(
    ("text", "name", "reason"),
    [
        ("float64", "robot_msgs/msg/Bad", "cannot read 'float64'"),
        ("float64 x\nfloat64 ?", "robot_msgs/msg/Bad", "cannot read 'float64 ?'"),
        ("float64 x\nint8 x", "robot_msgs/msg/Bad", "x: there are two fields of this name"),
        ("foat64 x", "robot_msgs/msg/Bad", "x: there is no primitive type 'foat64'"),
        ("wstring x", "robot_msgs/msg/Bad", "x: wstring is not supported"),
        ("int8 x", "Bad", "a type is named like"),
        ("int8 x", "robot_msgs/msg/../Bad", "a type is named like"),
        ("int8 x", "robot_msgs/srv/Bad", "a line of --- between them"),
        ("int8 x", "std_msgs/msg/String", "of this name already, with other content"),
    ],
)
def test_a_bad_definition_is_refused_and_leaves_nothing_behind(text: str, name: str, reason: str) -> None:
    before = types()
    with pytest.raises(MessageError) as caught:
        register(text, name)
    assert reason in str(caught.value)
    assert types() == before


@pytest.mark.parametrize(
    ("line", "default"),  # as rosidl_adapter reads them
    [
        ("string x yes", "yes"),
        ("string x null", "null"),
        ("string x 12:30", "12:30"),
        ("string x 1.10", "1.10"),
        ("string x a: b  # and so on", "a: b"),
        ("string x [y]", "[y]"),
        (r"string x 'it\'s'", "it's"),
        ('string x "  two  "', "  two  "),
        ('string x "a" b', '"a" b'),
        ("string[] x [on, \"a, b\", 'c' ]", ["on", "a, b", "c"]),
        ("string[] x []", []),
        ("int32 x 010", 10),
        ("int64 x -0x10", -16),
        ("int32 x 1_000", 1000),
        ("int32[2] x [010, 011]", [10, 11]),
        ("float64 x 1e3", 1000.0),
        ("bool x TRUE", True),
        ("bool[2] x [true, 0]", [True, False]),
    ],
)
@pytest.mark.filterwarnings("ignore::fame.errors.ValueChanged")
def test_the_default_of_a_field_is_that_of_ros(line: str, default: Any) -> None:
    (content,) = from_text(line, "robot_msgs/msg/Default")
    assert content.defaults == {"x": default}


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("int32 X=010", 10), ("int8 X = -0x10 # and so on", -16), ("uint8 X=0o17", 15), ("int32 X=1_000", 1000),
        ("bool X=1", True), ("float64 X=1", 1.0), ("float32 X=-.5", -0.5), ("string X='a=b'", "a=b"),
        ("string X= yes # no", "yes"), ("char X=65", 65),
    ],
)  # fmt: skip
def test_a_constant_is_read_as_a_default_is(line: str, value: Any) -> None:
    (content,) = from_text(line, "robot_msgs/msg/Constant")
    assert [*content.constants.items()] == [("X", value)]
    assert type(content.constants["X"]) is type(value)


@pytest.mark.parametrize("line", ["uint8 X=300", "int32 X=1e3", "bool X=yes", "string x a=b", "Other X=1"])
def test_a_constant_that_does_not_fit_its_type_is_refused(line: str) -> None:
    with pytest.raises(MessageError, match=f"cannot read '{line}'"):
        from_text(line, "robot_msgs/msg/Constant")


def test_a_default_that_earlier_releases_read_in_another_way_is_noted() -> None:
    text = "robot_msgs/msg/Default: x: `off` is now the text 'off'; earlier releases read the text 'false'"
    with pytest.warns(ValueChanged, match=re.escape(text)):
        from_text("string x off\nstring y free", "robot_msgs/msg/Default")


def test_a_default_that_does_not_fit_is_told_when_the_type_is_first_used() -> None:
    register("int8 x 500", "robot_msgs/msg/Odd")
    with pytest.raises(MessageError, match=r"robot_msgs/msg/Odd: x: its default does not fit: expected .*, got 500"):
        create("robot_msgs/Odd")


def test_a_type_can_be_registered_before_what_it_refers_to() -> None:
    register("Rim rim\nrobot_msgs/Rim[] spares", "robot_msgs/msg/Tyre")
    with pytest.raises(MessageError, match="robot_msgs/msg/Tyre: rim: its type robot_msgs/msg/Rim is not known"):
        create("robot_msgs/Tyre")
    register("float64 width", "robot_msgs/msg/Rim")
    assert create("robot_msgs/Tyre", {"spares": [{"width": 2}]}).spares[0].width == 2.0


def test_a_type_that_contains_itself_is_refused() -> None:
    register("robot_msgs/Egg egg", "robot_msgs/msg/Hen")
    register("robot_msgs/Hen[] hens", "robot_msgs/msg/Egg")
    with pytest.raises(MessageError, match="a type cannot contain itself"):
        create("robot_msgs/Hen")


def test_services_are_two_messages() -> None:
    assert service("std_srvs/SetBool") == ("std_srvs/srv/SetBool_Request", "std_srvs/srv/SetBool_Response")
    request, response = register("float64 angle\n---\nbool done\nstring reason", "robot_msgs/srv/Turn")
    assert service("robot_msgs/srv/Turn") == (request, response)
    assert fields(request) == {"angle": "float64"}
    assert fields(response) == {"done": "bool", "reason": "string"}
    assert to_mapping(create("std_srvs/srv/Trigger_Request")) == {}
    with pytest.raises(MessageError, match="no such service type; did you mean std_srvs/srv/Trigger"):
        service("Trigger")
    register("nowhere_msgs/Thing thing\n---", "robot_msgs/srv/Bring")
    with pytest.raises(MessageError, match="thing: its type nowhere_msgs/msg/Thing is not known"):
        service("robot_msgs/srv/Bring")


def test_a_directory_of_definitions_is_registered_as_a_whole(tmp_path: Path) -> None:
    package = tmp_path / "farm_msgs"
    (package / "msg").mkdir(parents=True)
    (package / "srv").mkdir()
    (package / "msg" / "Field.msg").write_text("farm_msgs/Row[] rows\n")
    (package / "msg" / "Row.msg").write_text("float64 length\r\n")
    (package / "srv" / "Mow.srv").write_text("Field field\n---\n")
    expected = ["farm_msgs/msg/Field", "farm_msgs/msg/Row", "farm_msgs/srv/Mow_Request", "farm_msgs/srv/Mow_Response"]
    assert register_files(package) == expected
    assert create("farm_msgs/srv/Mow_Request", {"field": {"rows": [{"length": 5}]}}).field.rows[0].length == 5.0
    assert register_files(package / "msg" / "Row.msg", package="yard_msgs") == ["yard_msgs/msg/Row"]


def test_the_size_of_a_type_counts_levels_fields_and_bytes() -> None:
    texts = {"t/msg/Inner": "float64 a\nstring b", "t/msg/Outer": "Inner[3] inner\nint8 c"}
    found = {each.name: each for name, text in texts.items() for each in from_text(text, name)}
    known = check_size("t/msg/Outer", found.get, {})
    assert known == {"t/msg/Inner": (1, 2, 272), "t/msg/Outer": (2, 3, 200 + 3 * 272 + 1)}
    with pytest.raises(MessageError, match="t/msg/None: its definition is not known"):
        check_size("t/msg/None", found.get, {})


def test_a_place_without_definitions_is_refused(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "Missing.msg"):
        with pytest.raises(MessageError, match=r"there is no \.msg, \.srv or \.action file at"):
            register_files(place)
    (tmp_path / "Lost.msg").write_text("nowhere_msgs/Thing thing\n")
    with pytest.raises(MessageError, match="thing: its type nowhere_msgs/msg/Thing is not known"):
        register_files(tmp_path / "Lost.msg", package="lost_msgs")


def test_a_bad_definition_is_left_out_of_its_directory_and_named_where_it_is_needed(tmp_path: Path) -> None:
    (tmp_path / "Good.msg").write_text("float64 length\n")
    (tmp_path / "Lost.msg").write_text("nowhere_msgs/Thing thing\n")
    (tmp_path / "Loses.srv").write_text("Lost lost\n---\n")
    (tmp_path / "Half.action").write_text("float64 x\n---\n")
    (tmp_path / "Latin.msg").write_bytes(b"# \xe9\nfloat64 x\n")
    assert register_files(tmp_path, package="half_msgs") == ["half_msgs/msg/Good"]
    assert [name for name in types() if name.startswith("half_msgs")] == ["half_msgs/msg/Good"]
    needs = {
        "Lost.msg: .* nowhere_msgs/msg/Thing is not known": lambda: create("half_msgs/Lost"),
        "Loses.srv: .* nowhere_msgs/msg/Thing is not known": lambda: service("half_msgs/Loses"),
        "Half.action: .* an action is a goal, a result and a feedback": lambda: typesystem.action("half_msgs/Half"),
        "Latin.msg: .*utf-8": lambda: create("half_msgs/msg/Latin"),
    }
    for text, need in needs.items():
        with pytest.raises(MessageError, match=f"no such .* type; its file cannot be used: .*{text}"):
            need()
    (tmp_path / "Half.action").write_text("float64 x\n---\n---\n")
    register_files(tmp_path, package="half_msgs")
    assert typesystem.action("half_msgs/Half") == "half_msgs/action/Half"


def test_a_type_that_is_there_with_other_content_is_refused_and_nothing_added(tmp_path: Path) -> None:
    (tmp_path / "Bool.msg").write_text("int8 data\n")
    (tmp_path / "Abacus.msg").write_text("int8 data\n")
    with pytest.raises(MessageError, match="with other content"):
        register_files(tmp_path, package="std_msgs")
    assert "std_msgs/msg/Abacus" not in types()


# ---- the wire --------------------------------------------------------------------------------------------------------

needs_wire_samples = pytest.mark.skipif(not WIRE.exists(), reason="needs samples.json of ros2_jazzy_wire")


@needs_wire_samples
def test_what_ros_2_wrote_is_read_and_written_back_byte_for_byte() -> None:
    samples = json.loads(WIRE.read_text())["samples"]
    assert len(samples) > 100
    for sample in samples:
        cdr, name = bytes.fromhex(sample["cdr"]), sample["type"]
        value = sample["fields"]
        message = create(name, ord(value["data"]) if name == "std_msgs/msg/Byte" else value)
        written = codec.serialize(message)
        assert cdr[: len(written)] == written
        assert len(cdr) - len(written) < 4
        assert codec.deserialize(cdr, name) == message
        assert to_mapping(codec.deserialize(cdr, name)) == to_mapping(message)


@needs_wire_samples
def test_type_hashes_are_those_of_ros_2() -> None:
    hashes = json.loads(WIRE.read_text())["type_hashes"]
    assert {name: codec.type_hash(name) for name in hashes} == hashes


@needs_wire_samples
def test_defaults_are_those_that_ros_2_sends() -> None:
    seen = set()
    for sample in json.loads(WIRE.read_text())["samples"]:
        if sample["type"] not in seen:
            seen.add(sample["type"])
            assert codec.deserialize(bytes.fromhex(sample["cdr"]), sample["type"]) == create(sample["type"])


@pytest.mark.parametrize("data", ["", "00010000", "00010000ffffff7f616263", "0707000000"])
def test_bytes_that_are_not_the_message_are_refused(data: str) -> None:
    with pytest.raises(MessageError, match=f"std_msgs/msg/String: cannot read {len(data) // 2} bytes of CDR"):
        codec.deserialize(bytes.fromhex(data), "std_msgs/String")


def test_a_quaternion_takes_a_yaw() -> None:
    turned = create("geometry_msgs/msg/Pose", {"orientation": math.pi / 2}).orientation
    assert (turned.x, turned.y) == (0, 0)
    assert (turned.z, turned.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    with pytest.raises(MessageError, match="orientation: expected a mapping with x, y, z and w, or a yaw in rad"):
        create("geometry_msgs/msg/Pose", {"orientation": "north"})


# ---- weight ----------------------------------------------------------------------------------------------------------


def test_the_heavy_packages_are_imported_when_the_first_type_is_asked_for() -> None:
    program = (
        "import sys; import fame.middleware.messages as m; print('rosbags' in sys.modules, 'numpy' in sys.modules);"
        "m.create('geometry_msgs/Twist'); print('rosbags' in sys.modules, 'numpy' in sys.modules)"
    )
    root = Path(__file__).resolve().parents[1]
    result = subprocess.run([sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False", "True", "False"]
