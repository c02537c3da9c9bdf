"""FEEL as models of Camunda 8 use it: its functions, dates and types, and what it costs."""

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml
from bpmn_text import process

from fame.bpmn import read_text
from fame.bpmn.model import Expression, Language
from fame.clock import EPOCH
from fame.scripting import BudgetExceeded, compile_expression, effects_of
from fame.scripting.feel.functions import FUNCTIONS
from fame.scripting.interface import interface
from fame.simulation import Simulation

HERE = Path(__file__).parent
TOPICS: dict[str, list[list[Any]]] = yaml.safe_load((HERE / "feel" / "cases.yaml").read_text("utf-8"))
CASES = [(text, expected) for cases in TOPICS.values() for text, expected in cases]
PAGE = (HERE.parent / "docs" / "feel.md").read_text("utf-8")


def feel(text: str, /, **variables: Any) -> Any:
    return compile_expression(Expression(text, "feel", 1))(variables)


@pytest.mark.parametrize(("text", "expected"), CASES, ids=[case[0] for case in CASES])
def test_an_expression_gives(text: str, expected: Any) -> None:
    result = feel(text)
    assert result == expected
    assert (result is None) == (expected is None)
    assert isinstance(result, bool) == isinstance(expected, bool)


def test_there_is_a_case_for_every_function() -> None:
    called = " ".join(text for text, _ in CASES)
    elsewhere = {"random number", "uuid", "assert", "now", "today", "cycle"}
    assert {name for name in FUNCTIONS if f"{name}(" not in called} == elsewhere


def test_the_page_lists_every_function() -> None:
    spans = set(re.findall(r"`([a-z][a-z0-9 ]+)\(", PAGE))
    assert spans - {"function"} == set(FUNCTIONS)


# ---- the mission that it is evaluated in -----------------------------------------------------------------------------


def mission(*expressions: str, epoch: datetime = EPOCH) -> list[Any]:
    """What they come to in a mission, 90 s after its beginning."""
    outputs = "".join(
        f'<camunda:outputParameter name="x{number}">={text}</camunda:outputParameter>'
        for number, text in enumerate(expressions)
    )
    content = f"""<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/><scriptTask id="t">
    <extensionElements><camunda:inputOutput>{outputs}</camunda:inputOutput></extensionElements>
    <script>await sleep(90)</script></scriptTask>"""
    variables = Simulation(read_text(process(content)), epoch=epoch).run().instances[0].variables
    return [variables[f"x{number}"] for number, _ in enumerate(expressions)]


def test_now_is_on_the_clock_of_the_mission() -> None:
    epoch = datetime(2026, 3, 1, 23, 59, tzinfo=UTC)
    assert mission("now()", "today()", epoch=epoch) == ["2026-03-02T00:00:30Z", "2026-03-02"]
    assert mission("now()") == ["1970-01-01T00:01:30Z"]
    assert mission('(now() - @"1970-01-01T00:00Z") / @"PT1S"') == [90]
    assert feel("now()") is None


def test_chance_is_the_same_in_each_run() -> None:
    first = mission("random number()", "random number()", "uuid()")
    assert first == mission("random number()", "random number()", "uuid()")
    assert 0 <= first[0] < 1 != first[1] != first[0]
    assert re.fullmatch(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", first[2])


def test_what_is_asserted_fails_with_its_cause() -> None:
    assert feel("assert(x, x > 3)", x=4) == 4
    with pytest.raises(AssertionError, match="x must be set"):
        feel('assert(x, x != null, "x must be set")')


def test_a_date_that_a_variable_brings_back_as_text_is_one() -> None:
    assert feel("day of week(due)", due="2019-09-17") == "Tuesday"
    assert feel('due < date("2020-01-01")', due="2019-09-17") is True
    assert feel("date(due) + wait", due="2019-09-17", wait="P1D") == "2019-09-18"


def test_fields_of_messages_are_entries_too() -> None:
    robot = type("Report", (), {})()
    robot.__dict__ |= {"name": "REX", "battery": 0.5}
    assert feel('get value(robot, "battery")', robot=robot) == 0.5
    assert feel("get entries(robot).key", robot=robot) == ["name", "battery"]
    assert feel('robots[name = "REX"].battery', robots=[robot]) == [0.5]


@pytest.mark.parametrize(
    ("text", "reads"),
    [
        ("sort(robots, function(a, b) a.battery < b.battery)", {"robots"}),
        ("robots[battery > 0.2].name", {"robots"}),
        ("robots[item.battery > 0.2]", {"robots"}),
        ("substring(string: s, start position: n)", {"s", "n"}),
        ("{f: function(x) x + k, r: f(1)}.r", {"k"}),
        ("for r in robots return r.x + partial[-1]", {"robots"}),
        ("now() < due", {"due"}),
    ],
)
def test_it_reads_variables_but_no_fields_and_parameters(text: str, reads: set[str]) -> None:
    found = effects_of(Expression(text, "feel", 1))
    assert (found.reads, found.sets) == (reads, frozenset())


# ---- what it costs ---------------------------------------------------------------------------------------------------

ENDLESS = [
    "count(for i in 1..1000000000 return i)",
    "some i in 1..100000000000 satisfies i < 0",
    "every i in 1..100000000000, j in 1..9 satisfies true",
    "for i in 1..64 return if i = 1 then [1] else concatenate(partial[-1], partial[-1])",
    'for i in 1..64 return if i = 1 then "ab" else partial[-1] + partial[-1]',
    "for i in 1..64 return flatten(if i = 1 then [1] else [partial[-1], partial[-1]])",
    "for i in 1..64 return string(if i = 1 then [1] else [partial[-1], partial[-1]])",
    "for i in 1..1000000000 return xs[item > 0]",
    "{f: function(n) f, r: for i in 1..1000000000 return f(i)}",
    'for i in 1..1000000000 return @"2026-01-01" + @"P1D" * i',
    'matches(string join(for i in 1..5000 return "a"), "(a*)*(a*)*(a*)*b")',
]


@pytest.mark.parametrize("text", ENDLESS)
def test_a_loop_counts_against_the_budget_of_the_step(text: str) -> None:
    variables = {"xs": [1, 2, 3], "__builtins__": interface(robot=None, signal=print, log=print, budget=100_000)}
    evaluate = compile_expression(Expression(text, "feel", 1))
    with pytest.raises(BudgetExceeded, match="more than 10000 loop passes and function calls"):
        evaluate(variables)


def test_each_evaluation_has_the_whole_budget() -> None:
    variables = {"__builtins__": interface(robot=None, signal=print, log=print, budget=10_000)}
    evaluate = compile_expression(Expression("count(for i in 1..900 return i)", "feel", 1))
    assert [evaluate(variables) for _ in range(5)] == [900] * 5


@pytest.mark.parametrize(
    "text", ["9 ** 9 ** 9 ** 9", "floor(1.5, 999999999)", "round(5, -999999999)", "decimal(1.5, 10 ** 15)"]
)
def test_a_number_that_would_take_for_ever_is_null(text: str) -> None:
    assert feel(text) is None


@pytest.mark.parametrize("language", ["feel", "juel"])
def test_a_product_has_an_end(language: Language) -> None:
    large = 10**1000
    product = " * ".join(["x"] * 9)
    evaluate = compile_expression(Expression("${" + product + "}" if language == "juel" else product, language, 1))
    if language == "feel":
        assert evaluate({"x": large}) is None
    else:
        with pytest.raises(OverflowError, match="more than 1233 digits"):
            evaluate({"x": large})
    assert evaluate({"x": 10**100}) == 10**900


def test_the_patterns_that_nest_repetitions_take_the_time_of_others() -> None:
    assert feel(f'matches("{"a" * 60}!", "^(a+)+$")') is False
    assert feel(f'matches("{"a" * 60}", "^(a|a)*$")') is True
    assert feel(f'replace("{"ab" * 30}", "(a*b*)*", "-")') == "--"


def test_functions_of_camunda_7_expressions_are_bounded_likewise() -> None:
    def juel(text: str) -> Any:
        return compile_expression(Expression("${" + text + "}", "juel", 1))({})

    assert juel("round(2.567, 2)") == 2.57
    assert juel("max(1, 3) + count([1, 2])") == 5
    with pytest.raises(TypeError, match=r"round\(1.5, 999999999\)"):
        juel("round(1.5, 999999999)")
    with pytest.raises(TypeError, match="'weed' is not a number"):
        juel("abs('weed')")
