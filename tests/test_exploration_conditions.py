"""An unknown condition that is asked again with unchanged variables has the same outcome."""

from __future__ import annotations

from pathlib import Path

import pytest
from collaborations import Steps, team, text_of
from compare_explorations import replayed

import fame
from fame.check.explore import Exploration
from fame.check.explore.remembering import remembered
from fame.scenario.exploration import explore

ASKED = ("if", "x > 3", ["throw go"], ["work"])
AGAIN = ("if", "x > 3", ["work"], ["throw go"])
UNKNOWN = "run x = robot.now"
TYPED = ('data-number="{}" name="x "><extensionElements><camunda:properties><camunda:property name="type" '
         'value="std_msgs/msg/Bool"/></camunda:properties></extensionElements>')  # fmt: skip


def stuck(steps: Steps, **robots: Steps) -> bool:
    """Whether B may wait for ever for what A throws at the one gateway or at the other."""
    found = result_of({"A": steps, "B": ["catch go"], **robots})
    assert found.exhaustive
    return any(one.kind in ("deadlock", "lost") for one in found.findings)


def result_of(robots: dict[str, Steps]) -> Exploration:
    return explore(team(robots), delivery="run")


@pytest.mark.parametrize(
    "between",
    [[], ["work"], ["run y = robot.now"], [("and", ["work"], ["timer PT5S"])], ["fail c"], ["send m"]],
)
def test_a_condition_has_one_outcome_while_its_variable_is_unchanged(between: Steps) -> None:
    assert not stuck([UNKNOWN, ASKED, *between, AGAIN], **({"M": ["receive m"]} if "send m" in between else {}))


@pytest.mark.parametrize(
    "between",
    [
        [UNKNOWN],
        ["person"],
        ["run x += 1"],
        ["run (x, y) = (robot.now, 2)"],
        ["run if robot.now == 7: x = 3"],
        [("and", [UNKNOWN], ["work"])],
        [("or", [UNKNOWN], ["work"])],
        [("guard", ["work"], "timer PT5S", [UNKNOWN])],
        [("scope", ["work"], "timer PT5S", [UNKNOWN])],
        [("watch", ["work"], "timer PT5S", [UNKNOWN])],
        [("beside", ["work"], "timer PT5S", [UNKNOWN])],
        [("each", 2, [UNKNOWN])],
        [("turns", 2, [UNKNOWN])],
        ["run match robot.now:\n  case x: pass"],
        ["run for x in [robot.now]: pass"],
        ["run import math as x"],
    ],
)
def test_a_variable_that_is_set_in_between_makes_another_outcome_possible(between: Steps) -> None:
    assert stuck([UNKNOWN, ASKED, *between, AGAIN])


CONDITIONS = [
    "x",
    "not x",
    "x > 3 and y &lt; 2",
    "x > y",
    "x in (3, y)",
    "len(x) > 3",
    "x[0] > 3",
    "x.data",
    "3 &lt; x > 1",
    "any(one > 3 for one in x)",
    "${x > 3 and y > 2}",
    "${x.data}",
    "=x > 3 or y = 2",
    '=contains(x, "a") and count(y) > 2',
    "${not (x > 3) or (y > 2)}",
]


@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_condition_that_only_reads_variables_has_one_outcome(condition: str) -> None:
    begun, asked, again = (UNKNOWN, "run y = robot.now"), ("if", condition, *ASKED[2:]), ("if", condition, *AGAIN[2:])
    assert not stuck([*begun, asked, "work", "run z = x", again])
    assert not stuck([*begun, ("each", 1, [asked, "work", again])])
    assert stuck([*begun, asked, UNKNOWN, again])
    assert stuck([*begun, asked, "person", again])


@pytest.mark.parametrize("changed", ["z.append(3)", "z[0] = 3", "z += [3]", "f(z)", "z.data = True", "y = 3"])
@pytest.mark.parametrize("condition", ["len(x) > y", "x and y", "x[0] > y"])
def test_what_a_script_may_change_in_place_may_have_another_outcome(condition: str, changed: str) -> None:
    begun = (UNKNOWN, "run y = robot.now", "run z = x", "run w = z if x else y")  # `z` decides something
    asked, again = ("if", condition, *ASKED[2:]), ("if", condition, *AGAIN[2:])
    assert stuck([*begun, asked, f"run {changed}", again, ("if", "z", ["work"], ["timer PT1S"])])


@pytest.mark.parametrize(
    "condition",
    ["robot.random.random() > x", "x.pop()", "x.take() > 3", "x()", "${abs(x) > 3}", "=now() > x"],
)
def test_what_may_change_without_a_write_is_never_remembered(condition: str) -> None:
    assert stuck([UNKNOWN, ("if", condition, *ASKED[2:]), "work", ("if", condition, *AGAIN[2:])])


def test_a_script_that_waits_may_set_its_variables_at_any_time_until_it_ends() -> None:
    sets, asks = "run await sleep(1); x = robot.now", [ASKED, "work", AGAIN]
    assert not stuck([sets, *asks])
    assert not stuck([UNKNOWN, ("and", ["run await sleep(1); y = robot.now"], asks)])
    assert stuck([UNKNOWN, ("and", [sets], asks)])
    assert stuck([UNKNOWN, ASKED, sets, AGAIN])


def test_a_message_that_comes_again_makes_another_outcome_possible() -> None:
    asked, again = ("if", "x.data", *ASKED[2:]), ("if", "x.data", *AGAIN[2:])

    def heard(*steps: object) -> bool:
        text = text_of({"A": ["catch x", *steps], "B": ["catch go"]})
        for number in range(text.count('name="x"')):
            text = text.replace('name="x">', TYPED.format(number), 1)
        found = explore(fame.read(text.encode()), delivery="run")
        assert found.exhaustive
        return any(place.element.startswith("B_catch_go") for one in found.findings for place in one.places)

    assert not heard(asked, "work", again)
    assert heard(asked, "catch x", again)


def test_what_may_be_set_in_ways_that_are_not_seen_is_never_remembered() -> None:
    def of(*steps: object) -> list[str]:
        (process,) = team({"A": [UNKNOWN, ASKED, *steps]}).processes
        return [*remembered([process.body])]

    assert of("work", "catch x", "person") == ["?python x > 3"]
    assert not of("run global x")
    assert not of("run class C: pass")
    assert not of("run import x")


def test_a_loop_asks_its_condition_again_only_if_something_sets_its_variable() -> None:
    loop = [("if", "x > 3", [("while", ["work", ("if", "x > 3", ["work"], ["stop"])])], [])]
    assert any(one.kind == "never" for one in result_of({"A": [UNKNOWN, *loop]}).findings)
    changed = [("if", "x > 3", [("while", [UNKNOWN, "work", ("if", "x > 3", ["work"], ["stop"])])], [])]
    assert not any(one.kind == "never" for one in result_of({"A": [UNKNOWN, *changed]}).findings)


def test_outcomes_that_nothing_asks_for_again_make_no_states() -> None:
    once = result_of({"A": [UNKNOWN, ("if", "x > 3", ["run z = 1"], ["run z = 1"]), "work", "timer PT1S"]})
    none = result_of({"A": [UNKNOWN, "work", "timer PT1S"]})
    assert once.states == none.states


def test_the_run_of_a_deadlock_behind_a_remembered_condition_can_be_replayed(tmp_path: Path) -> None:
    robots: dict[str, Steps] = {"A": [UNKNOWN, ASKED, "work", ("if", "x > 3", ["work"], ["catch go"])], "B": ["work"]}
    text = text_of(robots)
    found = [
        one for one in explore(fame.read(text.encode()), delivery="run").findings if one.kind in ("deadlock", "lost")
    ]
    assert found
    for one in found:
        assert not list(replayed(text, one, tmp_path))
