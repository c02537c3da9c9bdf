"""Values as JSON for recordings and watchers, with orjson and without it, and in snapshots."""

from __future__ import annotations

import json

import pytest

from fame.engine.snapshot import decode, encode
from fame.middleware import messages
from fame.robot import plain_values

VALUES = [
    messages.create("geometry_msgs/Twist", {"linear": {"x": 0.5, "y": -1.0}}),
    messages.create("std_msgs/String", {"data": 'a "quoted" line\nand ÿ'}),
    messages.create("sensor_msgs/Range", {"range": float("inf"), "max_range": 4.0}),
    messages.create("std_msgs/ColorRGBA", {"r": 0.25}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{"position": {"x": 0.1, "y": 1e-7}}] * 3}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{"position": {"x": float("nan")}}]}),
    messages.create("geometry_msgs/PoseArray", {"poses": [{}] * (plain_values.ITEMS + 1)}),
    messages.create("sensor_msgs/BatteryState", {"cell_voltage": [0.1, 0.2]}),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_message_is_the_same_without_orjson(value: object, monkeypatch: pytest.MonkeyPatch) -> None:
    plain_values._RECENT.clear()
    fast = json.loads(plain_values.json_text(value))
    plain_values._RECENT.clear()
    monkeypatch.setattr(plain_values, "orjson", None)
    assert json.loads(plain_values.json_text(value)) == fast


class Length(float):
    """A subclass of float with a text of its own, as those of numpy have."""

    def __repr__(self) -> str:
        return f"Length({float(self)})"


def test_a_float_of_another_library_that_is_not_finite_is_stored_and_read_again() -> None:
    stored = json.loads(json.dumps(encode([Length("inf"), Length("-inf"), 2.5])))
    assert decode(stored) == [float("inf"), float("-inf"), 2.5]
