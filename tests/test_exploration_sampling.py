"""When a limit binds: the schedule of a run, fewer robots, random runs."""

import re
from dataclasses import replace
from itertools import count
from pathlib import Path
from random import Random
from types import SimpleNamespace

import pytest
from collaborations import Step, Steps, philosophers, team, text_of, varied
from compare_explorations import run

import fame
from fame.check.explore import Exploration, exploration
from fame.check.explore.findings import FAILING, Finding
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.scenario.explore import run as explored_run
from fame.scenario.explore.exploration import explore
from fame.scenario.explore.run import with_run
from fame.scenario.scenario import Scenario

_SEEDS = 60
LATE: dict[str, Steps] = {"A": ["timer PT1S", "throw go", "catch done"], "B": ["timer PT2S", "catch go", "throw done"]}


def cut(robots: dict[str, Steps], several: tuple[str, ...] = (), **options: object) -> Exploration:
    return explore(fame.read(text_of(robots, several).encode()), limit=1, **options)  # type: ignore[arg-type]


def test_what_a_plain_run_shows_is_found_whatever_the_limit() -> None:
    (error,) = [one for one in cut(LATE).findings if one.level == "error"]
    assert error.text.startswith("lost signal: A waits at")
    assert [step.kind for step in error.run] == ["timer", "miss", "timer"]


def test_a_run_that_a_limit_cuts_goes_on_after_an_error_that_nothing_catches() -> None:
    robots: dict[str, Steps] = {"A": ["timer PT1S", "error c"], "B": ["timer PT5S", "work", "catch go"]}
    robots["C"] = ["timer PT9S", ("or", ["throw go"], ["error d"])]
    result = cut(robots)
    assert result.sampled[0] == "the order of fame run"
    (second,) = (one for one in result.findings if one.kind == "error" and "C: " in one.text)
    assert "; then B waits at" in second.text
    assert [step.kind for step in second.run][-1] == "timer"


def test_a_run_that_is_not_followed_to_its_end_is_named_as_such() -> None:
    endless: dict[str, Steps] = {
        robot: ["run n = 0", ("while", ["work", f"run n = (n + 1) % {top}", ("if", "n == 70", ["stop"], ["work"])])]
        for robot, top in {"A": 61, "B": 59, "C": 53}.items()
    }
    result = cut(endless)
    assert result.sampled[0] == "the order of fame run, followed for 10,000 steps"
    assert result.status == "partial"


def test_a_partial_search_says_not_that_a_signal_is_always_lost() -> None:
    robots: dict[str, Steps] = {
        "A": ["throw x", "timer PT9S"],
        "B": ["timer PT5S", ("race", ["catch x"], ["timer PT1S"])],
    }
    text = text_of(robots).encode()
    (whole,) = [one for one in explore(fame.read(text)).findings if one.kind == "always-lost"]
    assert " is always lost " in whole.text
    (part,) = [one for one in explore(fame.read(text), limit=2).findings if one.kind == "always-lost"]
    assert "/x is lost in every explored delivery, in a partial search, on B" in part.text


def test_fewer_robots_are_explored_and_a_deadlock_with_them_is_named_as_such() -> None:
    pair: dict[str, Steps] = {"C": ["throw go", "catch done", "catch done"], "F": ["catch go", "work", "throw done"]}
    result = explore(fame.read(text_of(pair, ("F",)).encode()), robots={"F": 3}, limit=2, delivery="run")
    assert "fewer robots (F=1)" in result.sampled
    (one,) = [one for one in result.findings if one.kind == "fewer"]
    assert one.text.startswith("with fewer robots (F=1): deadlock: C waits")
    assert result.status == "partial"  # three robots are enough


def test_the_first_error_ends_an_exploration_if_that_is_asked_for() -> None:
    model, made = team(philosophers(9, ordered=False)), [parse("Phil0 completes", NOWHERE, "p")]
    found = explore(model, delivery="run", first=True, properties=made)
    assert (found.status, found.states, found.sampled) == ("failed", 0, ("the order of fame run",))
    assert found.findings[0].kind == "deadlock"
    assert [one.verdict for one in found.properties] == ["not known"]
    found = explore(team(philosophers(4, ordered=True)), delivery="run", first=True)
    assert (found.status, found.exhaustive) == ("completed", True)
    late = explore(fame.read(text_of(LATE).encode()), first=True)
    assert [search.cuts for search in late.searches] == [("ended at the first error",)] * 2


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(10))
def test_deadlocks_of_plain_runs_are_not_missed(part: int) -> None:
    """Models in which all times are named, and nothing else is unknown."""
    shown = 0
    for seed in range(part, _SEEDS, 10):
        robots, options = varied(seed)
        text = text_of(robots, **options, drawn=Random(seed))
        drawn = run(text)
        if drawn is None or drawn.errors or not drawn.waiting:
            continue
        shown += 1
        found = explore(fame.read(text.encode()), limit=1, delivery="run").findings
        stuck = [{place.element for place in one.places} for one in found if one.kind in FAILING]
        assert any(one <= drawn.waiting for one in stuck), f"seed {seed}: {sorted(drawn.waiting)}"
    assert shown


def test_a_scenario_is_run_itself_as_its_world_decides_how_long_behaviours_take(tmp_path: Path) -> None:
    """B waits 20 s for A, whose behaviour takes 30 s; no search knows that, and random runs hardly show it."""
    waits: list[Step] = ["stop"]
    for _ in range(20):
        waits = [("race", ["catch go", "throw done"], ["timer PT1S", *waits])]
    robots: dict[str, Steps] = {"A": ["run n = 30", "run await sleep(n)", "throw go", "catch done"], "B": waits}
    (tmp_path / "late.bpmn").write_text(text_of(robots))
    scenario = tmp_path / "late.yaml"
    scenario.write_text("model: late.bpmn\nduration: 60\n")
    assert not explore(tmp_path / "late.bpmn", limit=1, delivery="run").failed
    found = explore(scenario, limit=1, delivery="run")
    assert (found.status, found.sampled[-1]) == ("failed", "a run of the scenario (seed 0)")
    (one,) = [one for one in found.findings if one.kind == "run"]
    assert "A waits at" in one.text
    assert "/done" in one.text
    assert explore(scenario, limit=1, delivery="run", samples=False).status == "partial"
    assert not explore(scenario, limit=1, delivery="run", samples=False, first=True).sampled
    (tmp_path / "late.bpmn").write_text(text_of(robots, accept={"A": "run: somebody ends it"}))
    assert [one.accepted for one in explore(scenario, limit=1).findings if one.kind == "run"] == ["somebody ends it"]


def run_beside(folder: Path, text: str, seconds: float | None) -> tuple[str, list[Finding]]:
    """What a run of a scenario without a world adds to an exploration: its name, and findings."""
    (folder / "m.bpmn").write_text(text)
    (folder / "s.yaml").write_text("model: m.bpmn\nduration: 100000000\n")
    nothing = replace(explore(folder / "m.bpmn", limit=1, samples=False), findings=(), sampled=())
    found = with_run(nothing, Scenario.load(folder / "s.yaml"), seconds)
    return found.sampled[0], list(found.findings)


@pytest.mark.parametrize("seconds", [None, 600.0])
def test_a_run_is_found_to_be_stuck_with_a_time_limit_and_without(tmp_path: Path, seconds: float | None) -> None:
    name, (one,) = run_beside(tmp_path, text_of({"A": ["catch go"]}), seconds)
    assert name == "a run of the scenario (seed 0)"
    assert "the mission is stuck: no token can move after 0 simulated seconds" in one.text


@pytest.mark.parametrize(("steps", "expected"), [(["error c"], [True]), (["work"], [])])
def test_of_a_run_that_its_time_limit_cuts_errors_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: Steps, expected: list[bool]
) -> None:
    """The wall clock goes on by 1 s each time it is read."""
    monkeypatch.setattr(explored_run, "time", SimpleNamespace(monotonic=count().__next__))
    name, found = run_beside(tmp_path, text_of({"A": steps, "B": [("while", ["work"])]}), 5.0)
    assert name == "a run of the scenario (seed 0), not to its end"
    assert ["error c was not caught" in one.text for one in found] == expected


@pytest.mark.parametrize(("accepting", "expected"), [("b", ""), ("bc", "b is late; c is late")])
def test_an_accepted_wait_excuses_no_other_wait_of_its_robot(tmp_path: Path, accepting: str, expected: str) -> None:
    robots: dict[str, Steps] = {"B": [("or", ["throw b", "throw c"], ["work"])]}
    text = text_of({"A": [("and", ["catch b", "end"], ["catch c", "end"])]} | robots)
    for name in accepting:
        given = f'<camunda:property name="accept" value="run: {name} is late; deadlock: {name} is late"/>'
        kept = f"<extensionElements><camunda:properties>{given}</camunda:properties></extensionElements>"
        text = text.replace(f'name="{name}">', f'name="{name}">{kept}')
    _, (one,) = run_beside(tmp_path, text, None)
    assert (one.accepted, one.text.count("A waits at")) == (expected, 2)
    found = explore(tmp_path / "m.bpmn", delivery="run").findings
    assert [one.accepted for one in found if one.kind in FAILING] == [expected], "the search agrees"


WAITING: dict[str, Steps] = {
    robot: [("or", [f"catch {robot.lower()}1"], [f"catch {robot.lower()}2"]), "throw go"] for robot in "AB"
} | {"C": ["catch go", *(f"throw {robot}{number}" for robot in "ab" for number in (1, 2))]}
"""Two robots, each of which waits forever for one of two signals."""


@pytest.mark.parametrize("accepted", [False, True])
def test_findings_that_the_time_does_not_suffice_for_are_counted(
    monkeypatch: pytest.MonkeyPatch, accepted: bool
) -> None:
    text = text_of(WAITING)
    if accepted:
        given = '<extensionElements><camunda:properties><camunda:property name="accept" value="deadlock: late"/>'
        text = re.sub("(<process [^>]*[^/]>)", rf"\1{given}</camunda:properties></extensionElements>", text)
    model = fame.read(text.encode())
    whole = explore(model, delivery="run")
    monkeypatch.setattr(exploration, "FINDING", 0.0)
    part = explore(model, delivery="run", seconds=3600, samples=False)
    assert [len([one for one in result.findings if one.kind == "deadlock"]) for result in (whole, part)] == [4, 1]
    assert part.states == whole.states
    assert (
        "NOT all findings made (3 states in which robots wait forever not looked into; delivery run, " in part.summary()
    )
    assert (whole.status, part.status) == (("completed", "partial") if accepted else ("failed", "failed"))
    assert explore(model, delivery="run", seconds=3600).sampled, "parts are explored besides"


def test_single_faults_that_the_time_does_not_suffice_for_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    pair: dict[str, Steps] = {"A": ["work", "throw x", "catch y"], "B": ["catch x", "work", "throw y"]}
    model = fame.read(text_of(pair).encode())
    (whole,) = explore(model, delivery="run", faults=True).searches
    monkeypatch.setattr(exploration, "FINDING", 0.0)
    (part,) = explore(model, delivery="run", faults=True, seconds=3600, samples=False).searches
    assert len(part.faults) == 1
    assert part.left_out == (f"{len(whole.faults) - 1} single faults not looked into",)


def test_what_waits_after_errors_is_counted_where_the_time_does_not_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    model = fame.read(text_of(WAITING | {"C": ["work", ("or", ["error c"], WAITING["C"][1:])]}).encode())
    monkeypatch.setattr(exploration, "FINDING", 0.0)
    part = explore(model, delivery="run", seconds=3600, samples=False)
    assert "3 states after errors in which robots wait forever not looked into" in part.cuts
    (error,) = (one for one in part.findings if one.kind == "error")
    assert "waits at" in error.text, "one of the four is told"
