"""Values of variables as plain data in a journal, and again."""

from __future__ import annotations

import heapq
import json
import math
import os
import re
import subprocess
from collections import ChainMap, Counter, OrderedDict, defaultdict, deque, namedtuple
from datetime import UTC, date, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from functools import reduce
from http import HTTPStatus
from pathlib import Path
from random import uniform
from typing import Any

import pytest
from bpmn_text import process

import fame
from fame.bpmn.reader import read_text
from fame.engine.data import Temporal
from fame.engine.encoding import decode, encode
from fame.engine.host import BpmnError
from fame.errors import MissionError, ModelError
from fame.middleware import messages
from fame.robot.stored_values import StoredValues, refuse_unstorable
from fame.scripting.requests import Sleep

MODEL = read_text(
    process(
        '<startEvent id="s"/><scriptTask id="a"><script>import os, heapq, http\nfrom os.path import join\n'
        "from functools import reduce\nfrom random import uniform</script></scriptTask>"
    ),
    file="m.bpmn",
)
MISSION = fame.Simulation(MODEL).node.mission
STORED = StoredValues(MISSION)


def again(value: Any) -> Any:
    return decode(json.loads(json.dumps(encode(value, STORED.dump))), STORED.load)


@pytest.mark.parametrize(
    "value",
    [
        1 + 2j, math.inf, -0.0, 10**30, "ü\x00", b"\xff", bytearray(b"x"), (1, [2, {"k": {3}}]), {1: "a", (2, 3): None},
        {"$dict": 1}, datetime(2026, 1, 2, 3, tzinfo=UTC), date(2026, 1, 2), timedelta(1, 2, 3), Decimal("1.10"),
        Fraction(1, 3), range(1, 9, 2), deque([1, (2,)], 5), Path("a/b"), [math, math.hypot],
        [10**5000], [1, -(10**5000)], {10**5000: 1}, [None, "a", 10**5000], Fraction(10**5000, 3), range(10**5000),
        int, len, ValueError, os.path, os.path.join, os.getcwd, heapq.heappush, reduce, uniform, BpmnError, Sleep,
        Counter("abba"), OrderedDict(b=1, a=[2]), defaultdict(list, {"a": [(1,)]}), HTTPStatus.OK, [HTTPStatus.OK],
        Temporal("2026-01-02"), {"due": Temporal("P1D")},
        {"path": Path("x"), "z": [1j]}, messages.create("geometry_msgs/msg/Point", {"x": 1.5}),
    ],
)  # fmt: skip
def test_it_is_the_same_again(value: Any) -> None:
    found = again(value)
    assert found == value
    assert type(found) is type(value)


def test_a_mapping_that_is_no_dict_becomes_one() -> None:
    assert again(ChainMap({"message": 1}, {"a": 2})) == {"message": 1, "a": 2}


class Level(int):
    """A class of the mission's own."""


class Names(set[str]):
    pass


def test_a_value_of_an_own_class_becomes_a_plain_one() -> None:
    for value, plain in ((Level(3), 3), ([Level(3)], [3]), (Names({"a"}), {"a"})):
        found = again(value)
        assert found == plain
        assert type(found) is type(plain)


def test_an_array_is_one_again() -> None:
    numpy = pytest.importorskip("numpy")
    value = numpy.arange(6, dtype="float32").reshape(2, 3)
    found = again(value)
    assert found.dtype == value.dtype
    assert (found == value).all()


def test_a_number_of_numpy_is_one_again() -> None:
    numpy = pytest.importorskip("numpy")
    for kind in (numpy.int32, numpy.float64, numpy.str_):  # some are of classes that are derived of plain ones
        assert type(again([kind(3)])[0]) is kind


@pytest.mark.parametrize(
    "make", ["zeros(1).view(numpy.recarray)", "zeros(1, [('a', 'i4')])", "array([[1, 2], None], object)[:1]"]
)
def test_an_array_that_would_be_another_one_is_not_stored(make: str) -> None:
    numpy = pytest.importorskip("numpy")
    with pytest.raises(MissionError, match="cannot be kept in a snapshot"):
        again(eval(f"numpy.{make}", {"numpy": numpy}))


class Fails(dict[str, Any]):
    """An object of a library whose own code fails."""

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError(name)

    def items(self) -> Any:
        raise RuntimeError("items")


class FailsAsObject:
    def __getattribute__(self, name: str) -> Any:
        raise RuntimeError(name)


@pytest.mark.parametrize(
    "value",
    [
        object(), lambda: 1, (i for i in ()), eval, open, __import__, Fails, [Fails(a=1)], [FailsAsObject()],
        type(None), subprocess.run, namedtuple("Pair", "a b")(1, 2),
    ],
)  # fmt: skip
def test_what_cannot_be_stored_is_said(value: Any) -> None:
    with pytest.raises(MissionError, match="cannot be kept in a snapshot"):
        again(value)


def test_nothing_is_imported_that_no_script_imports() -> None:
    lost: list[str] = []
    load = StoredValues(MISSION, lost.append).load
    for module, name in (("subprocess", "run"), ("builtins", "eval"), ("_heapq", "heappush")):
        assert decode([1, {"$object": {"module": module, "name": name}}], load) == [1, None]
    assert lost[0] == (
        "a value of the state is lost: subprocess run is of no module that a script of the model imports"
    )
    assert len(lost) == 3


def test_names_of_modules_do_not_lead_into_their_loaders() -> None:
    with pytest.raises(MissionError, match="cannot be imported again"):
        STORED.load({"module": "math", "name": "__loader__"})


# ---- models whose state cannot be stored -----------------------------------------------------------------------------

ENV = "const env = this.environment.variables;"


def two(language: str, first: str, second: str) -> Any:
    """A mission with two scripts."""
    text = process(
        f'<startEvent id="s"/><scriptTask id="a" name="First" scriptFormat="{language}"><script><![CDATA[{first}]]>'
        f'</script></scriptTask><scriptTask id="b" scriptFormat="{language}"><script><![CDATA[{second}]]></script>'
        '</scriptTask><sequenceFlow id="sa" sourceRef="s" targetRef="a"/>'
        '<sequenceFlow id="ab" sourceRef="a" targetRef="b"/>'
    )
    return fame.Simulation(read_text(text, file="m.bpmn")).node.mission


@pytest.mark.parametrize(
    ("language", "first", "second", "said"),
    [
        ("python", "def f(): return 1", "y = f()", "defines 'f', a function or class that later steps use"),
        ("python", "class P: pass", "y = P()", "defines 'P'"),
        ("javascript", f"{ENV} env.f = (x) => x + 1;", f"{ENV} env.y = env.f(1);", "defines 'f'"),
        ("javascript", f"{ENV} env.f = function () {{}};", f"{ENV} env.f();", "defines 'f'"),
        ("javascript", f"{ENV} function go() {{}} env.f = go;", f"{ENV} env.f();", "defines 'f'"),
        ("javascript", f"{ENV} class P {{}} env.P = P;", f"{ENV} new env.P();", "defines 'P'"),
        ("javascript", "setTimeout(() => 1, 10);", "1;", "sets a timer whose callback runs when"),
        (
            "javascript", 'this.environment.variables.node.createSubscription("std_msgs/msg/String", "/x", (m) => m);',
            "1;", "creates a subscription that is still there",
        ),
    ],
)  # fmt: skip
def test_what_a_script_leaves_behind_that_cannot_be_stored_is_named(
    language: str, first: str, second: str, said: str
) -> None:
    with pytest.raises(ModelError, match=re.escape(said)) as found:
        refuse_unstorable(two(language, first, second))
    assert '"First" (a)' in str(found.value)


@pytest.mark.parametrize(
    ("language", "first", "second"),
    [
        ("python", "def f(): return 1\nx = f()", "y = x"),
        ("python", "from math import hypot", "y = hypot(3, 4)"),
        ("javascript", f"{ENV} const f = (x) => x + 1; env.x = f(1);", f"{ENV} env.y = env.x;"),
        ("javascript", f"{ENV} env.f = (x) => x + 1;", "1;"),
        ("javascript", "setTimeout(() => next(), 10);", "1;"),
    ],
)
def test_what_no_later_step_uses_may_be_left_behind(language: str, first: str, second: str) -> None:
    refuse_unstorable(two(language, first, second))
