"""Conditions and values: ${...}, =..., and Python, and what they may not reach."""

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from fame.bpmn.model import Expression, Language
from fame.clock import Scheduler
from fame.engine import Variables
from fame.errors import ModelError
from fame.middleware import messages, typesystem
from fame.middleware.local import LocalMiddleware
from fame.properties.conditions import field_of
from fame.robot.plain_values import plain
from fame.scripting import Robot, Runner, compile_expression, mission_date
from fame.scripting.data import fields_of
from fame.scripting.interface import interface


@dataclass
class Point:
    x: float = 0.0
    y: float = 0.0


@dataclass
class Odometry:
    position: Point = field(default_factory=Point)
    covariance: Any = field(default_factory=lambda: np.array([0.5, 1.5]))
    robots: Any = field(default_factory=list)


def evaluate(text: str, language: Language, /, **variables: Any) -> Any:
    return compile_expression(Expression(text, language, 1))(variables)


def juel(text: str, /, **variables: Any) -> Any:
    return evaluate("${" + text + "}", "juel", **variables)


def feel(text: str, /, **variables: Any) -> Any:
    return evaluate(text, "feel", **variables)


JUEL_CASES: list[tuple[str, dict[str, Any], Any]] = [
    ("1 + 2 * 3", {}, 7),
    ("(1 + 2) * 3", {}, 9),
    ("10 - 2 - 3", {}, 5),
    ("7 / 2", {}, 3.5),
    ("7 div 2", {}, 3.5),
    ("-7 % 3", {}, -1),
    ("7 mod 4", {}, 3),
    ("-x + 1", {"x": 3}, -2),
    ("1.5e2 + .5", {}, 150.5),
    ("x > 3 and y.z == 2", {"x": 4, "y": {"z": 2}}, True),
    ("x > 3 && y.z == 2", {"x": 4, "y": {"z": 3}}, False),
    ("x gt 3 or x lt 1", {"x": 0}, True),
    ("a eq b || a ne b", {"a": 1, "b": 2}, True),
    ("x ge 3 and x le 3", {"x": 3}, True),
    ("!a and not b", {"a": False, "b": False}, True),
    ("not a == b", {"a": False, "b": True}, True),
    ("a or b and c", {"a": True, "b": False, "c": False}, True),
    ("x == 'weed'", {"x": "weed"}, True),
    ('x != "weed"', {"x": "weed"}, False),
    (r"'it\'s ' + name", {"name": "REX"}, "it's REX"),
    ("'5' + 3", {}, 8),
    ("'5' == 5", {}, True),
    ("'a' == 5", {}, False),
    ("'10' > 9", {}, True),
    ("x == null", {"x": None}, True),
    ("x == null", {"x": 0}, False),
    ("null < 1", {}, False),
    ("1 < null", {}, False),
    ("null + 1", {}, 1),
    ("true == 'true'", {}, True),
    ("empty x", {"x": []}, True),
    ("empty x", {"x": ""}, True),
    ("empty x", {"x": 0}, False),
    ("not empty x", {"x": [1]}, True),
    ("empty x", {}, True),
    ("x > 0 ? 'go' : 'stop'", {"x": 1}, "go"),
    ("x > 0 ? 'go' : x < 0 ? 'back' : 'stop'", {"x": 0}, "stop"),
    ("xs[0] + xs[1]", {"xs": [1, 2]}, 3),
    ("xs[5]", {"xs": [1, 2]}, None),
    ("m['a key'].b[1]", {"m": {"a key": {"b": (1, 2)}}}, 2),
    ("m.missing.deeper", {"m": {}}, None),
    ("odom.position.x", {"odom": Odometry(Point(1.5, 2.0))}, 1.5),
    ("odom['position'].y > 1", {"odom": Odometry(Point(1.5, 2.0))}, True),
    ("odom.covariance[1]", {"odom": Odometry()}, 1.5),
    ("xs.size() > 1 and xs.contains(2)", {"xs": [1, 2]}, True),
    ("s.startsWith('RE')", {"s": "REX"}, True),
    ("[1, x, 'a']", {"x": 2}, [1, 2, "a"]),
    ("{'x': x, y: 1}", {"x": 2}, {"x": 2, "y": 1}),
    ("max(a, b) - abs(c)", {"a": 1, "b": 5, "c": -2}, 3),
    ("-stamp % 10000000000000000000", {"stamp": 12345678901234567891}, -2345678901234567891),
    ("xs.indexOf(5)", {"xs": [1, 2]}, -1),
    ("xs.indexOf(2)", {"xs": (1, 2)}, 1),
    ("xs[i / 2]", {"xs": [1, 2], "i": 2}, 2),
    (r"'\uD83D\uDE00'", {}, "\U0001f600"),
]

FEEL_CASES: list[tuple[str, dict[str, Any], Any]] = [
    ("1 + 2 * 3 ** 2", {}, 19),
    ("x = 3", {"x": 3}, True),
    ("x != 3", {"x": 3}, False),
    ("x = null", {}, True),
    ("x > 3", {}, None),
    ("x > 3 and y = 1", {"y": 2}, False),
    ("x > 3 or y = 1", {"y": 1}, True),
    ("x > 3 or y = 1", {"y": 2}, None),
    ("true and null", {}, None),
    ("not(x > 3)", {"x": 1}, True),
    ("not(null)", {}, None),
    ("missing.a.b", {}, None),
    ("1 + null", {}, None),
    ('1 + "a"', {}, None),
    ("1 / 0", {}, None),
    ('"a" + "b"', {}, "ab"),
    ('1 = "1"', {}, None),
    ("if x > 0 then 1 else 2", {"x": 1}, 1),
    ("if x > 0 then 1 else 2", {}, 2),
    ("if a then if b then 1 else 2 else 3", {"a": True, "b": False}, 2),
    ("x between 1 and 3", {"x": 3}, True),
    ("x between 1 and 3 and true", {"x": 4}, False),
    ("x in [1..3]", {"x": 3}, True),
    ("x in [1..3)", {"x": 3}, False),
    ("x in (1..3]", {"x": 1}, False),
    ("x in (1, 2, 5)", {"x": 5}, True),
    ("x in [1, 2]", {"x": 5}, False),
    ("x in (< 3, >= 10)", {"x": 12}, True),
    ("x in names", {"x": "a", "names": ["a", "b"]}, True),
    ("xs[1]", {"xs": [10, 20, 30]}, 10),
    ("xs[-1]", {"xs": [10, 20, 30]}, 30),
    ("xs[4]", {"xs": [10, 20, 30]}, None),
    ("xs[0]", {"xs": [10]}, None),
    ("[][1]", {}, None),
    ("xs[item > 15]", {"xs": [10, 20, 30]}, [20, 30]),
    ("ps[x > 1].y", {"ps": [{"x": 1, "y": 1}, {"x": 2, "y": 5}]}, [5]),
    ("count(xs[item > 15])", {"xs": [10, 20, 30]}, 2),
    ("sum([1, 2, 3]) + min(4, 2) - max([1, 7])", {}, 1),
    ("mean([1, 2, 3])", {}, 2),
    ("sum([])", {}, None),
    ("floor(1.7) + ceiling(1.2) + abs(-3)", {}, 6),
    ('number("2.5") + 1', {}, 3.5),
    ("string(true)", {}, "true"),
    ('contains("weed", "ee")', {}, True),
    ("list contains(xs, 2)", {"xs": [1, 2]}, True),
    ('starts with(name, "tractor")', {"name": "tractor_1"}, True),
    ("string length(name)", {"name": "abc"}, 3),
    ("is defined(x)", {}, False),
    ("for i in 1..3 return i * i", {}, [1, 4, 9]),
    ("some x in xs satisfies x > 2", {"xs": [1, 2, 3]}, True),
    ("every x in xs satisfies x > 2", {"xs": [1, 2, 3]}, False),
    ('{a: 1, "b c": x}.a', {"x": 2}, 1),
    ("-x", {"x": 2}, -2),
    ("odom.position.x > 1", {"odom": Odometry(Point(1.5))}, True),
    ("odom.position.z", {"odom": Odometry()}, None),
    ("10 ** 400", {}, None),
    ("1 + 1 // and a remark", {}, 2),
    ("string(6 / 2)", {}, "3"),
    ("36893488147419103234 / 2", {}, 18446744073709551617),
    ("xs = [1, 2]", {"xs": (1, 2)}, True),
    ('contains(5, "a")', {}, None),
    ("upper case(x)", {"x": 5}, None),
    ("sqrt(-1) = null", {}, True),
    ("modulo(5, 0)", {}, None),
    ('max([1, "a"])', {}, None),
    ('number("weed")', {}, None),
    ("{a: 1, b: a + 1}.b", {"a": 5}, 2),
    ("{a: a, b: for x in [a] return x}.b[1]", {"a": 5}, 5),
    ("for i in 0..4 return if i = 0 then 1 else i * partial[-1]", {}, [1, 1, 2, 6, 24]),
    ("for i in [1, 2], j in [3, 4] return i * j", {}, [3, 4, 6, 8]),
    ("for i in 1..3, j in 1..i return j", {}, [1, 1, 2, 1, 2, 3]),
    ("some i in [1, 2], j in [2, 3] satisfies i = j", {}, True),
    ("every i in [1, 2], j in [2, 3] satisfies i < j", {}, False),
    ('duration("PT2H") + duration("PT30M")', {}, "PT2H30M"),
    ('duration("PT2H") - duration("PT3H")', {}, "-PT1H"),
    ('duration("PT1H") * 2', {}, "PT2H"),
    ('0.5 * duration("PT1H")', {}, "PT30M"),
    ('duration("PT1H") / 4', {}, "PT15M"),
    ('duration("PT1H") / 0', {}, None),
    ('duration("P1D") > duration("PT12H")', {}, True),
    ('duration("PT1H") = duration("PT60M")', {}, True),
    ('duration("P1M") > duration("P30D")', {}, None),
    ('duration("PT1H") in [duration("PT30M")..duration("PT90M")]', {}, True),
    ('wait + duration("PT1M")', {"wait": "PT1H"}, "PT1H1M"),
    ('date and time("2012-12-24T23:59:00") + duration("PT1M")', {}, "2012-12-25T00:00:00"),
    ('date and time("2026-01-31T12:00:00Z") + duration("P1M")', {}, "2026-02-28T12:00:00Z"),
    ('date and time("2026-01-02T00:00:00Z") - date and time("2026-01-01T12:00:00Z")', {}, "PT12H"),
    ('date and time("2026-01-02T00:00:00Z") = date and time("2026-01-02T01:00:00+01:00")', {}, True),
    ('date and time("weed") + duration("PT1M")', {}, None),
    ('"in " + string(duration("PT1M"))', {}, "in PT1M"),
    ("not x = 4", {"x": 3}, True),
    ("not(x = 4) and true", {"x": 3}, True),
    ('substring("foobar", 0)', {}, None),
    ('substring("foobar", -10)', {}, None),
    ('substring("foobar", -2, 1)', {}, "a"),
    (r'"\U01F40E\uD83D\uDE00"', {}, "\U0001f40e\U0001f600"),
    ("größe > 1 and class = 3", {"größe": 2, "class": 3}, True),
]


@pytest.mark.parametrize(("text", "variables", "expected"), JUEL_CASES, ids=[case[0] for case in JUEL_CASES])
def test_a_camunda_7_expression_gives(text: str, variables: dict[str, Any], expected: Any) -> None:
    result = juel(text, **variables)
    assert result == expected
    assert type(result) is type(expected)


@pytest.mark.parametrize(("text", "variables", "expected"), FEEL_CASES, ids=[case[0] for case in FEEL_CASES])
def test_a_feel_expression_gives(text: str, variables: dict[str, Any], expected: Any) -> None:
    result = feel(text, **variables)
    assert result == expected
    assert (result is None) == (expected is None)


NUMPY = {"yes": np.bool_(True), "byte": np.uint8(200), "long": np.int64(2**62), "half": np.float16(0.5), "no": {}}


@pytest.mark.parametrize(
    ("text", "expected"),
    [("yes == true", True), ("!yes", False), ("byte + 100", 300), ("long * 4", 2**64), ("half * 3", 1.5)],
)
def test_a_scalar_of_numpy_is_a_number_or_truth_value_like_any_other(text: str, expected: Any) -> None:
    assert (juel(text, **NUMPY), type(juel(text, **NUMPY))) == (expected, type(expected))
    in_feel = text.replace("==", "=").replace("!yes", "not(yes)")
    assert feel(in_feel, **NUMPY) == expected


@pytest.mark.parametrize("value", [math.nan, [1], {"a": 1}], ids=["nan", "list", "mapping"])
@pytest.mark.parametrize("text", ["x && true", "x || true", "!x", "x ? 1 : 2"])
def test_what_is_neither_true_nor_false_decides_nothing(text: str, value: Any) -> None:
    with pytest.raises(TypeError, match="expected true or false, got"):
        juel(text, x=value)


def test_methods_convert_nothing_and_say_how_many_arguments_they_take() -> None:
    assert juel("[x.equals('5'), [1, 2].indexOf(true), [1].contains(true), [1, 2].contains(2)]", x=5) == [
        False, -1, False, True,
    ]  # fmt: skip
    for text, message in (
        ("x.contains()", "`contains` takes one argument"),
        ("x.size(1)", "`size` takes no arguments"),
    ):
        with pytest.raises(ModelError, match=message):
            juel(text, x=[1])
    with pytest.raises(TypeError, match="'1_0' is not a number"):
        juel("x * 2", x="1_0")


def test_a_hash_brace_is_as_good_as_a_dollar_brace() -> None:
    assert evaluate("#{x + 1}", "juel", x=1) == 2


def test_a_camunda_7_expression_names_what_is_not_set() -> None:
    with pytest.raises(NameError, match="`x` is not set"):
        juel("x > 3")
    with pytest.raises(NameError, match="Point has no field `z`; it has x, y"):
        juel("p.z", p=Point())


def test_a_number_of_any_length_is_one() -> None:
    assert juel("1" * 5000) == math.inf
    assert feel("1" * 5000) == math.inf


def test_entries_of_a_context_leave_the_variables_alone() -> None:
    variables = {"a": 5, "partial": 7}
    evaluate = compile_expression(Expression("{a: 1, partial: for x in [2] return x + a}", "feel"))
    assert evaluate(variables) == {"a": 1, "partial": [3]}
    assert variables == {"a": 5, "partial": 7}


@pytest.mark.parametrize("text", ["true + 1", "xs + 1"])
def test_what_is_no_number_is_not_added(text: str) -> None:
    with pytest.raises(TypeError, match="is not a number"):
        juel(text, xs=[1])


def test_texts_and_numbers_that_have_no_order_are_an_error() -> None:
    with pytest.raises(TypeError, match="'weed' is not a number"):
        juel("x > 3", x="weed")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("x.__class__", "leading underscore"),
        ("__builtins__", "leading underscore"),
        ("x['__class__']", "leading underscore"),
        ("x[k]", "leading underscore"),
        ("f", "not data"),
        ("f.x", "not data"),
        ("math.pi", "not data"),
        ("m.f", "not data"),
        ("p.method", "no field"),
        ("T", "not data"),
        ("s.format(1)", "cannot be called"),
        ("f(1)", "no function"),
        ("open('x')", "no function"),
        ("s.upper", "no field"),
    ],
)
def test_python_behind_the_data_is_out_of_reach(text: str, what: str) -> None:
    class WithMethod(Point):
        def method(self) -> None: ...

    variables = {
        "x": {},
        "k": "__class__",
        "f": len,
        "m": {"f": len},
        "math": math,
        "p": WithMethod(),
        "T": Point,
        "s": "",
    }
    for run in (juel, feel):
        if run is feel and ("[" in text or "no field" in what or "cannot be called" in what):
            continue
        with pytest.raises((ModelError, TypeError, NameError), match=what):
            run(text, **variables)


def test_feel_finds_no_python_behind_the_data_either() -> None:
    assert feel("s.upper", s="") is None
    assert feel("xs[k]", xs=[1], k="__class__") == []


@pytest.mark.parametrize(
    ("text", "language", "complaint"),
    [
        ("${x >}", "juel", "expected a value, got the end"),
        ("${(x}", "juel", r"expected `\)`, got the end"),
        ("${x y}", "juel", "expected an operator or the end, got `y`"),
        ("${}", "juel", "empty"),
        ("${x @ y}", "juel", "`@` was not expected"),
        ("${'abc}", "juel", "no closing brace"),
        ("${round(1, 2, 3)}", "juel", r"`round` takes \(n, scale\?\)"),
        ("${append()}", "juel", r"`append` takes \(list, items\.\.\.\)"),
        ("'abc", "feel", "text without an end"),
        ("if x then 1", "feel", "expected `else`"),
        ("substr(x)", "feel", "there is no function `substr` here; did you mean substring?"),
        ("(" * 500 + "1" + ")" * 500, "feel", "nested more than"),
        ("1" + " + 1" * 1000, "feel", "more than 300 operators"),
        ("${x" + ".y" * 1000 + "}", "juel", "more than 300 operators"),
        ("x = 1", "python", "not valid Python: .*use `==` to compare"),
        ("x > (3", "python", "was never closed"),
        ("", "python", "not valid Python"),
        ("await sleep(1)", "python", "'await' outside"),
    ],
)
def test_a_wrong_expression_is_refused_with_its_place(text: str, language: Language, complaint: str) -> None:
    with pytest.raises(ModelError, match=complaint) as caught:
        compile_expression(Expression(text, language, 7), file="m.bpmn", element="Flow_1")
    assert (caught.value.file, caught.value.line, caught.value.element) == ("m.bpmn", 7, "Flow_1")


def test_the_line_of_a_complaint_counts_lines_inside_the_expression() -> None:
    for language, text in (("juel", "${a\n and\n }"), ("feel", "a\nand\n!"), ("python", "(a\n and\n ]")):
        with pytest.raises(ModelError) as caught:
            compile_expression(Expression(text, language, 10))  # type: ignore[arg-type]
        assert caught.value.line == 12, language


def test_a_python_condition_may_have_several_lines() -> None:
    assert evaluate("\n  x > 3   # near\n  and y\n", "python", x=4, y=True) is True


def test_expressions_see_inner_variables_before_outer_ones() -> None:
    variables = Variables({"x": 1, "y": 2}, {"x": 10})
    for language, text in (("juel", "${x + y}"), ("feel", "x + y"), ("python", "x + y")):
        assert compile_expression(Expression(text, language))(variables) == 12  # type: ignore[arg-type]


def test_expressions_know_the_robot_by_name_alone() -> None:
    scheduler = Scheduler()
    node = LocalMiddleware(scheduler).node("engine", "REX")
    robot = Robot("REX", "REX", print, Runner(scheduler, node, print).inbox, lambda: 0.0)
    variables = {"closest": "REX", "__builtins__": interface(robot=robot, signal=print, log=print)}
    assert compile_expression(Expression("${closest == robot.name}", "juel"))(variables) is True
    assert compile_expression(Expression("closest = robot.namespace", "feel"))(variables) is True
    with pytest.raises(NameError, match="has no field `publish`; it has name, namespace"):
        compile_expression(Expression("${robot.publish}", "juel"))(variables)


def test_a_template_is_filled_in_as_text() -> None:
    assert evaluate("PT${n}S", "template", n=2) == "PT2S"
    assert evaluate("PT2S", "template") == "PT2S"
    assert evaluate("${a}-${b.c}", "template", a=True, b={"c": None}) == "true-"


def test_a_long_sum_does_not_break_the_parser() -> None:
    assert feel(" + ".join(["1"] * 200)) == 200


def judge(text: str, language: Language, value: Any) -> bool:
    """What a condition comes to that is one variable."""
    result = compile_expression(Expression(text, language, 1, condition=True))({"x": value})
    assert isinstance(result, bool)
    return result


@pytest.mark.parametrize(("text", "language"), [("${x}", "juel"), ("x", "feel")])
@pytest.mark.parametrize(
    ("value", "truth"),
    [
        (True, True),
        (False, False),
        ("true", True),
        ("false", False),
        (" False ", False),
        ("", False),
        (None, False),
        (1, True),
        (0, False),
        (0.0, False),
        (np.bool_(False), False),
        (np.float64(2), True),
    ],
)
def test_a_condition_takes_a_value_as_it_says(text: str, language: Language, value: Any, truth: bool) -> None:
    assert judge(text, language, value) is truth


@pytest.mark.parametrize(("text", "language"), [("${x}", "juel"), ("x", "feel")])
@pytest.mark.parametrize(
    "value", ["weed", "0", [], [1], {"data": False}, Point(), "y" * 99, math.nan, np.float32("nan")]
)
def test_what_is_neither_true_nor_false_is_no_condition(text: str, language: Language, value: Any) -> None:
    with pytest.raises(TypeError, match=r"the condition: expected true or false, got .{1,60}"):
        judge(text, language, value)


def test_a_value_stays_what_it_is() -> None:
    assert juel("x", x="false") == "false"
    assert feel("x", x=[1]) == [1]


@pytest.mark.parametrize("language", ["payload", "template", "value"])
def test_the_signs_that_stand_for_expressions_inside_are_refused(language: Language) -> None:
    with pytest.raises(ModelError, match="U\\+E000 and U\\+E001 cannot be used"):
        evaluate("\ue0005\ue001", language)


def test_the_date_of_the_mission_is_found_from_the_variables_of_any_scope() -> None:
    scheduler = Scheduler()
    node = LocalMiddleware(scheduler).node("test", "REX")
    inbox = Runner(scheduler, node, print).inbox
    robot = Robot("REX", "REX", print, inbox, lambda: 1.5, datetime(2026, 1, 1, tzinfo=UTC))
    outer = {"__builtins__": interface(robot=robot, signal=print, log=print), "robot": "a variable of that name"}
    assert mission_date(Variables(outer, {"x": 1})) == datetime(2026, 1, 1, 0, 0, 1, 500_000, tzinfo=UTC)
    assert mission_date({"x": 1}) is None


@pytest.mark.parametrize(
    ("text", "language"),
    [
        ("${det.class == 'person' and det.from == 3}", "juel"),
        ("${det.class_ == 'person'}", "juel"),  # as until 0.3
        ('=det.class = "person" and det.from = 3', "feel"),
        ('=[det][class = "person"].from = [3]', "feel"),
        ("det.class_ == 'person' and det.from_ == 3", "python"),
    ],
)
def test_a_field_has_the_name_of_its_msg_in_every_language(
    text: str, language: Language, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(typesystem, "_definitions", dict(typesystem._table()))
    type = messages.register("string class\nint32 from\nPart in", "keyword_msgs/msg/Detection")[0]
    messages.register("bool is", "keyword_msgs/msg/Part")
    det = messages.create(type, {"class": "person", "from": 3, "in": {"is": True}})
    assert compile_expression(Expression(text, language))({"det": det}) is True
    assert fields_of(det).keys() == {"class", "from", "in"}
    assert plain(det) == messages.to_mapping(det) == {"class": "person", "from": 3, "in": {"is": True}}
    assert field_of(det, ("in", "is")) is True  # as properties name it
