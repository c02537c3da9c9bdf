"""An unknown condition that is asked again with an unchanged variable has the same outcome."""

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


@pytest.mark.parametrize("condition", ["robot.random.random() > 0.5", "robot.now > 3", "len(x) > 3", "x[0] > 3"])
def test_what_may_change_without_a_write_is_never_remembered(condition: str) -> None:
    assert stuck([UNKNOWN, ("if", condition, *ASKED[2:]), "work", ("if", condition, *AGAIN[2:])])


def test_what_else_than_a_script_sets_is_never_remembered() -> None:
    def of(*steps: object) -> dict[str, str]:
        (process,) = team({"A": [UNKNOWN, ASKED, *steps]}).processes
        return remembered([process.body], {})

    assert of("work", "catch y") == {"?python x > 3": "x"}
    assert not of("catch x")
    assert not of("person")
    assert not of("run global x")
    assert not of("run class C: pass")
    assert not of("run x = 4; await sleep(1); x = 2")


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
