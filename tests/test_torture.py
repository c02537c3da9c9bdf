"""Teams under faults, each run decided by its seed: what once failed holds, and a planted bug is found."""

import gc
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fame.log import Recording
from tests.torture.__main__ import outcome
from tests.torture.invariants import judge
from tests.torture.missions import ROBOTS
from tests.torture.plan import Plan, Step, draw
from tests.torture.planted import planted
from tests.torture.team import Team

DOCS = Path(__file__).parents[1] / "docs"
FOUND = sorted((Path(__file__).parent / "torture" / "found").glob("*.json"))


@pytest.fixture(autouse=True)
def _collected_teams() -> Iterator[None]:
    """Collect a team before `pytest_runtest_setup` keeps what is there: it has grown old, with 100 MB."""
    yield
    gc.collect()


@pytest.mark.long_but("seed_727", "seed_1038104")
@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.stem)
def test_what_once_failed_holds(file: Path) -> None:
    assert judge(Team(Plan.from_json(file.read_text()))) == []


def test_a_seed_gives_the_same_run_each_time() -> None:
    first, second = Team(draw(5)), Team(Plan.from_json(draw(5).to_json()))
    assert judge(first) == judge(second) == []
    assert first.lines == second.lines
    disks = [{name: machine.disk.content for name, machine in team.machines.items()} for team in (first, second)]
    assert disks[0] == disks[1]
    assert any(disks[0].values())
    assert len(first.lines) > 20


def test_a_run_is_recorded_without_being_changed_and_byte_for_byte_the_same_again(tmp_path: Path) -> None:
    lines, folders = outcome(draw(5))[2], (tmp_path / "first", tmp_path / "second")
    for folder in folders:
        folder.mkdir()
        assert outcome(draw(5), folder)[2] == lines
    first, second = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in folders)
    assert first == second
    with Recording(sorted(folders[0].glob("A-*.mcap"))[0]) as recording:
        assert {event.robot for event in recording.events()} == {"A"}


def test_a_run_without_an_end_is_a_finding() -> None:
    starts_itself = ["beside", 1, [["throw", 2, "a"], ["timer", 3, "PT2S"]], "a", [["throw", 4, "a"], ["note", 5]]]
    mission = {"robots": {"A": [starts_itself]}, "calls": {}, "calm": False, "edits": {}}
    plan = Plan(1, (Step(0.0, "start", "A"), Step(0.5, "deploy", "1", 1)), heal=5.0, mission=mission)
    assert [one for one in outcome(plan)[0] if "A does not come to rest" in one]


def _compared(mission: dict[str, Any], *steps: Step) -> tuple[list[str], int, int]:
    """What does not hold where robots have directories but for B; of how many robots and missions that is known."""
    mission = {"calls": {}, "calm": True, "edits": {}, "robots": mission}
    steps = *(Step(0.0, "directory", robot) for robot in mission["robots"] if robot != "B"), *steps
    steps = *(Step(0.1, "start", robot) for robot in mission["robots"]), Step(0.5, "deploy", "1", 1), *steps
    found, struck, _ = outcome(Plan(1, tuple(steps), heal=15.0, mission=mission))
    return found, struck["robots compared with a reference"], struck["missions compared as a whole"]


def test_a_robot_that_hears_of_none_that_forgets_is_compared() -> None:
    hearing, alone = [["times", 1, 2, [["hear", 2, "B"]]]], [["timer", 3, "PT3S"], ["note", 4]]
    robots = {"A": hearing, "B": [["times", 5, 2, [["tell", 6]]]], "C": alone}
    assert _compared(robots, Step(6.0, "kill", "B", 1.0), Step(7.0, "kill", "C", 1.0)) == ([], 1, 0)


def test_a_mission_that_has_begun_nowhere_begins_after_the_faults() -> None:
    robots = {"A": [["work", 1, "2"]], "C": [["timer", 2, "PT3S"]]}
    assert _compared(robots, Step(1.2, "kill sender")) == ([], 2, 1)


def test_what_runs_beside_the_robots_is_struck_while_it_runs() -> None:
    steps = [Step(0.0, "watched"), Step(0.0, "drives"), *(Step(0.1, "start", robot) for robot in ROBOTS)]
    steps += [Step(3.0, "kill monitor", "", 1.0), Step(3.0, "kill server", "", 1.0)]
    assert {"kill monitor / running", "kill server / running"} <= set(outcome(Plan(1, tuple(steps), heal=5.0))[1])


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("a promise that is not read again", "promise_read"),
        ("a start before its record", "seed_253789720"),
        ("a robot that stops listening", "seed_2723"),
        ("work twice after a migration", "work_twice"),
        ("a goal that runs on without a word", "goal_refused"),
    ],
)
def test_a_planted_bug_is_found(name: str, file: str) -> None:
    plan = Plan.from_json((Path(__file__).parent / "torture" / "found" / f"{file}.json").read_text())
    with planted(name):
        assert judge(Team(plan)) != []


def test_each_invariant_stands_for_a_sentence_of_the_docs() -> None:
    before, _, rest = (DOCS / "reliability.md").read_text().partition("| what must hold |")
    rows, _, after = rest.partition("\n\n")
    for row in rows.splitlines()[2:]:
        quotes = re.findall(r'"(.+?)" \(\[\w+\]\(([\w.]*)#', row)
        assert quotes, row
        for sentence, file in quotes:
            text = (DOCS / file).read_text() if file else before + after
            assert sentence in " ".join(text.split()), sentence
