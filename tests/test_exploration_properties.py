"""Properties in an exploration: proved, or refuted by a run; reduced and full searches agree, and so do real runs."""

from contextlib import nullcontext
from html import escape
from pathlib import Path

import pytest
from collaborations import Steps, team
from compare_explorations import judged_differently
from test_watch_property import SENTENCE, team as watching

from fame.bpmn.reader import read_text
from fame.check.explore.properties import Judged
from fame.cli import main
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.scenario.explore.exploration import explore
from fame.testing import ExpectationError, MissionLoader

TWO: dict[str, Steps] = {
    "A": ["work", "throw a", "work"],
    "B": ["catch a", "work", "throw b"],
    "C": ["work", "catch b"],
}
LOOP: dict[str, Steps] = {"A": [("loop", ["work", "throw a"])], "B": ["catch a", "throw b"]}
FOREVER: dict[str, Steps] = {"A": [("while", ["work"])], "B": ["work", "throw b"]}
RAISES: dict[str, Steps] = {"A": ["run raise ValueError('x')"], "B": ["run assert 1 > 2"]}
SKIPPED: dict[str, Steps] = {
    "A": ["run x = 0", "work", "run y = 1 / x"],
    "B": ["run x = [1, 2]; y = x", "run z = 1 / 2", "work"],
    "C": ["run import json; z = json.loads('')"],
}
OPAQUE: dict[str, Steps] = {"A": ["run import os; assert os.getpid() < 2"], "B": ["work"]}
COUNTS: dict[str, Steps] = {
    "A": ["run n = 0", "work", "run n += 1", "run n = n + 1", "work", "throw a"],
    "B": ["run n = 0; k = 5", "work", "catch a", "run n = 2"],
}
REMOVES: dict[str, Steps] = {"A": ["run n = 0", "work", "run del n", "work"], "B": ["work"]}
LAST: dict[str, Steps] = {"A": ["run n = 0", "work", "run n = 5"], "B": ["work"]}
DRAWS: dict[str, Steps] = {"A": ["run import os; n = os.getpid()", "work", "run n = 3", "throw a", "work"]}
MANY: dict[str, Steps] = {"C": ["throw go", "catch done"], "F": ["catch go", "work", "throw done"]}


def judged(robots: dict[str, Steps], sentence: str, several: tuple[str, ...] = (), **options: object) -> Judged:
    made = parse(sentence, NOWHERE, "p")
    (found,) = explore(team(robots, several), properties=[made], **options).properties  # type: ignore[arg-type]
    return found


@pytest.mark.parametrize(
    ("robots", "sentence", "verdict"),
    [
        (TWO, "B throws /b only after A throws /a", "proved"),
        (TWO, "A throws /a only after B throws /b", "refuted"),
        (TWO, "C completes", "refuted"),  # it misses b while it works
        (TWO, "A completes", "proved"),
        (TWO, "never A completes", "refuted"),
        (TWO, "after A throws /a, B throws /b", "proved"),
        (TWO, "between A throws /a and A completes, B throws /b", "refuted"),
        (TWO, "never C fails", "proved"),
        (TWO, "after A fails, B completes", "not triggered"),
        (LOOP, "A throws /a at most 2 times", "refuted"),
        (LOOP, "B throws /b at most 1 times", "proved"),
        (LOOP, "B completes", "proved"),
        (REMOVES, "always A.n < 3", "not known"),
        (FOREVER, "B completes", "proved"),
        (FOREVER, "A completes", "refuted"),
        (RAISES, "never A fails", "refuted"),
        (SKIPPED, "never A fails", "not known"),
        (SKIPPED, "never A fails at A_script_6", "not known"),
        (SKIPPED, "never A fails at A_script_2", "proved"),
        (SKIPPED, "A completes", "not known"),
        (SKIPPED, "never B fails", "proved"),
        (SKIPPED, "never C fails", "not known"),
        (RAISES, "B completes", "refuted"),
        (OPAQUE, "never A fails", "refuted"),
        (OPAQUE, "B completes", "not known"),
        (TWO, "A completes within 5 s", "not known"),
        (TWO, "always A.battery > 0.1", "not known"),
        (COUNTS, "always A.n < 3", "proved"),
        (COUNTS, "always A.n < 2", "refuted"),
        (COUNTS, "never A.n == 1", "proved"),  # only within an instant
        (COUNTS, "never A.n == 0 until A throws /a", "refuted"),
        (COUNTS, "after A throws /a, always A.n == 2", "proved"),
        (COUNTS, "always B.n <= A.n", "proved"),  # it takes over what A has
        (COUNTS, "never B.n == A.n", "refuted"),
        (COUNTS, "always B.k == 5", "proved"),  # which decides nothing
        (COUNTS, "always B.never > 1", "not known"),
        (LAST, "always A.n < 5", "refuted"),  # with which its instance ends
        (DRAWS, "always A.n >= 0", "not known"),
        (DRAWS, "after A throws /a, always A.n > 5", "refuted"),
    ],
)
def test_verdicts(robots: dict[str, Steps], sentence: str, verdict: str) -> None:
    found = judged(robots, sentence, delivery="run")
    assert found.verdict == verdict, found
    assert verdict == "refuted" or not found.run


def test_a_property_that_a_skipped_statement_may_violate_names_it() -> None:
    assert judged(SKIPPED, "never A fails").text == (
        "A's A_script_6 may raise an error: an exploration does not execute `y = 1 / x`"
    )


@pytest.mark.parametrize(
    ("script", "error"),
    [
        ("y = 1 / 0", "ZeroDivisionError: division by zero"),
        ("y = [1][3]", "IndexError"),
        ("a, b = 1, 2, 3", "ValueError"),
        ("y = int('abc')", "ValueError"),
        ("z = 2; y = 1 / 0", "ZeroDivisionError"),
        ("y = 1 / 2", ""),
        ("y = 2 ** 0.5", ""),
        ("me = robot.name", ""),
    ],
)
def test_a_script_that_constants_let_fail_fails_although_nothing_needs_its_value(script: str, error: str) -> None:
    found = explore(team({"A": [f"run {script}", "throw x"], "B": ["work"]}), delivery="run")
    (text, *more) = [one.text for one in found.findings if one.kind == "error"] or [""]
    assert (error in text, bool(text), more) == (True, bool(error), [])


def test_a_refutation_has_a_run_that_ends_with_it() -> None:
    found = judged(TWO, "never B throws /b", delivery="run")
    steps = [str(step) for step in found.run]
    assert steps[:2] == ['A\'s "work" ends, throws /a', "B receives /a"]
    assert steps[-2] == 'B\'s "work" ends, throws /b'
    assert len(steps) <= 5


def test_a_pool_means_each_of_its_robots_and_one_of_them_breaks_the_symmetry() -> None:
    model = team(MANY, ("F",))
    sentences = ("F throws /done", "some F throws /done", "F throws /done each time only after F catches /go")
    for sentence in sentences:
        assert judged(MANY, sentence, ("F",)).verdict == "proved"
    equal = explore(model, delivery="run").states
    assert explore(model, delivery="run", properties=[parse(sentences[2], NOWHERE, "p")]).states <= 2 * equal
    found = judged(MANY, "F_1 throws /done", ("F",))
    assert found.verdict == "proved"
    assert "names F_1" in found.text


def test_a_partial_search_proves_nothing() -> None:
    found = judged(TWO, "B throws /b only after A throws /a", limit=2, delivery="run")
    assert (found.verdict, found.text) == ("not known", "not all states were explored")


def test_an_element_inside_a_behaviour_is_not_judged() -> None:
    """The ground vehicles call behaviours whose inside the exploration takes for one step."""
    made = [parse(f"DINGO {one}", NOWHERE, "p") for one in ('starts "Head for Goal"', 'starts "Go To"')]
    inside, outside = explore("models/ground_vehicles.bpmn", properties=made, delivery="run").properties
    assert (inside.verdict, outside.verdict) == ("not known", "refuted")
    assert "is inside a behaviour" in inside.text


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(20))
def test_reduced_and_full_searches_and_real_runs_agree(part: int) -> None:
    compared = 0
    for seed in range(part, 60, 20):
        count, differences = judged_differently(seed)
        assert not differences, differences
        compared += count
    assert compared


@pytest.mark.parametrize(
    ("watched", "sentence", "verdict"),
    [
        (SENTENCE, "never B throws /safe", "refuted"),
        (SENTENCE, "B throws /safe only after A throws /go", "proved"),  # while it is pending
        (SENTENCE, "B throws /safe at most 1 times", "proved"),
        ("A throws /done only after A throws /go", "never B throws /safe", "proved"),
        ("A throws /go only after A throws /done", "never B throws /safe", "refuted"),
        ("A throws /go only after A throws /done", "B throws /safe only after A throws /go", "proved"),
        ("A throws /go only after A throws /done", "B throws /safe at most 1 times", "proved"),
        ("always A.battery > 0.1", "B throws /safe only after A throws /go", "refuted"),  # at any time
    ],
)
def test_the_signal_of_a_watched_property_comes_from_its_monitor(watched: str, sentence: str, verdict: str) -> None:
    text = watching("PT1S", ends="false").replace(SENTENCE, escape(watched))
    model, made = read_text(text, file="team.bpmn"), [parse(sentence, NOWHERE, "p")]
    for reduced in (True, False):
        found = explore(model, properties=made, reduced=reduced)
        assert [one.verdict for one in found.properties] == [verdict]
        assert found.outside == ()


def test_exit_codes(tmp_path: Path, mission: MissionLoader, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "two.bpmn"
    model.write_bytes(team({"A": ["work", "throw a"], "B": ["catch a"]}).source)
    for sentence, code in {"B completes": 0, "never B completes": 1, "A completes within 5 s": 3}.items():
        (tmp_path / "two.properties.yaml").write_text(f"properties:\n  p: {sentence}\n")
        assert main(["check", "--explore", str(model)]) == code
        shown = capsys.readouterr().out
        assert "property p is " in shown
        assert ("but it is not known whether p may be violated" in shown) == (code == 3)
        fails = pytest.raises(ExpectationError, match=r"p may be violated|property p is refuted")
        with fails if code else nullcontext():
            mission.explore(model)
