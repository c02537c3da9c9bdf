"""What runs of real engines show, no exploration denies: collaborations made at random, and what they taught."""

import pytest
from collaborations import Steps, text_of
from compare_explorations import LIMIT, denied
from sliced_scripts import denied as denied_of_scripts

import fame
from fame.check.explore import Exploration
from fame.check.explore.findings import FAILING
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.scenario.explore.exploration import explore


def explored(robots: dict[str, Steps], *sentences: str) -> Exploration:
    """Of robots A and B, of which A may call H."""
    properties = [parse(sentence, NOWHERE, sentence) for sentence in sentences]
    model = fame.read(text_of({"B": ["work"], **robots}, calls=["H"]).encode())
    return explore(model, delivery="run", limit=LIMIT, properties=properties)


@pytest.mark.long_but("*-5")
@pytest.mark.parametrize(("part", "size"), [*((part, 5) for part in range(20)), *((part, 50) for part in range(2, 12))])
def test_no_run_shows_what_an_exploration_denies(part: int, size: int) -> None:
    """Elements entered, errors not caught, deadlocks and properties violated."""
    looked = [denied(seed) for seed in range(part * size, part * size + size)]
    assert not [difference for _, differences in looked for difference in differences]
    assert any(whole for whole, _ in looked)


@pytest.mark.long_but("*-40")
@pytest.mark.parametrize(("part", "size"), [*((part, 40) for part in range(2)), *((part, 500) for part in range(1, 5))])
def test_no_run_of_scripts_does_what_their_exploration_denies(part: int, size: int) -> None:
    """Scripts with aliases, changes in place and exceptions, of which an exploration leaves parts out."""
    assert not [one for seed in range(part * size, part * size + size) for one in denied_of_scripts(seed)]


@pytest.mark.parametrize("inside", [["run n = 1"], [("guard", ["raise c"], "error", ["end"])]])
def test_a_behaviour_may_be_over_in_the_instant_in_which_it_is_called(inside: Steps) -> None:
    """What others throw as they start arrives after it; it was called lost."""
    result = explored({"A": [("call", "H"), "catch go"], "B": ["throw go"], "H": inside}, "A completes")
    assert [proof.verdict for proof in result.properties] == ["proved"]
    assert not any(finding.kind in (*FAILING, "always-lost") for finding in result.findings)


@pytest.mark.parametrize(
    "inside", [[("and", ["work"], [("if", "n == 1", ["end"], ["work"])])], ["work", "until n == 2"]], ids=["join", "if"]
)
def test_a_behaviour_that_waits_forever_is_a_deadlock(inside: Steps) -> None:
    """It was one step, which ends."""
    (finding,) = (one for one in explored({"A": ["run n = 1", ("call", "H")], "H": inside}).findings if one.robots)
    assert (finding.kind, finding.robots) == ("deadlock", ("A",))


@pytest.mark.parametrize(
    "text",
    ["await sleep(1)\nif robot.now: raise ValueError", "import lib; lib.go()", "y = {}.k", "o = None\ny = o.k",
     "with 5: pass", "class C(5): pass", "@5\ndef f(): pass", "def f(x=nope): pass", "y = 20000 + nope",
     "await sleep(1)\ny = nope", "await receive('x', timeout=1)"],
)  # fmt: skip
@pytest.mark.parametrize("code", ["error", "error script"])
def test_a_script_that_is_not_executed_may_fail_where_that_is_caught(text: str, code: str) -> None:
    """The error event was called unreachable."""
    result = explored({"A": [("guard", [f"run {text}"], code, ["throw lost"])]}, "never A throws /lost")
    assert [one.verdict for one in result.properties] == ["refuted"]
    assert not any("A_boundary" in place.element for one in result.findings for place in one.places)


def test_a_script_that_raises_and_is_not_executed_may_fail() -> None:
    (finding,) = explored({"A": ["run await sleep(1)\nif robot.now: raise ValueError"]}).findings
    assert (finding.kind, finding.text) == ("error", 'A: "script" (A_script_2) fails: error script not caught')
