"""Values of variables as plain data in a journal, and again."""

from __future__ import annotations

import json
import math
from collections import defaultdict, deque
from datetime import UTC, date, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process

import fame
from fame.bpmn.reader import read_text
from fame.engine.snapshot import decode, encode
from fame.errors import MissionError
from fame.middleware import messages
from fame.robot.stored_values import Loader, dump

MODEL = read_text(
    process(
        '<startEvent id="s"/><scriptTask id="a"><script>import math\nfrom os.path import join</script></scriptTask>'
    ),
    file="m.bpmn",
)
LOADER = Loader(fame.Simulation(MODEL).node.mission)


def again(value: Any) -> Any:
    return decode(json.loads(json.dumps(encode(value, dump))), LOADER)


@pytest.mark.parametrize(
    "value",
    [
        1 + 2j, math.inf, -0.0, 10**30, "ü\x00", b"\xff", bytearray(b"x"), (1, [2, {"k": {3}}]), {1: "a", (2, 3): None},
        {"$dict": 1}, datetime(2026, 1, 2, 3, tzinfo=UTC), date(2026, 1, 2), timedelta(1, 2, 3), Decimal("1.10"),
        Fraction(1, 3), range(1, 9, 2), deque([1, (2,)], 5), Path("a/b"), [math, math.hypot],
        {"path": Path("x"), "z": [1j]}, messages.create("geometry_msgs/msg/Point", {"x": 1.5}),
    ],
)  # fmt: skip
def test_it_is_the_same_again(value: Any) -> None:
    found = again(value)
    assert found == value
    assert type(found) is type(value)


def test_a_dict_with_defaults_loses_only_these() -> None:
    assert again(defaultdict(list, {"a": [1]})) == {"a": [1]}


def test_an_array_is_one_again() -> None:
    numpy = pytest.importorskip("numpy")
    value = numpy.arange(6, dtype="float32").reshape(2, 3)
    found = again(value)
    assert found.dtype == value.dtype
    assert (found == value).all()


@pytest.mark.parametrize("value", [object(), lambda: 1, (i for i in ())])
def test_what_cannot_be_stored_is_said(value: Any) -> None:
    with pytest.raises(MissionError, match="cannot be kept in a snapshot"):
        again(value)


def test_nothing_is_imported_that_no_script_imports() -> None:
    import subprocess

    with pytest.raises(MissionError, match="module subprocess, which no script of the model imports"):
        again(subprocess.run)
