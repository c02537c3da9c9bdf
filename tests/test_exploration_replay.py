"""Every deadlock, lost signal and mission that never completes is reproduced by real engines along its run."""

from pathlib import Path

import pytest
from collaborations import Steps, generated, philosophers, team
from compare_explorations import compare

from fame.bpmn.model import Definitions
from fame.check.explore import Exploration, Finding
from fame.check.explore.findings import FAILING
from fame.scenario import Scenario
from fame.scenario.explore.exploration import cast_of, explore
from fame.testing.by_hand import MissionByHand
from fame.testing.explored_runs import play

WITHIN = 30.0


def scenario_of(model: str | Definitions, **options: object) -> Scenario:
    """The same team as is explored."""
    definitions, library, cast = cast_of(model, options.get("robots", {}), ())  # type: ignore[arg-type]
    return Scenario(file=definitions.file, definitions=definitions, library=library, cast=cast, world=None, seed=0,
                    duration=600.0)  # fmt: skip


def played(model: str | Definitions, finding: Finding, folder: Path, **options: object) -> MissionByHand:
    """The mission after the run of a finding, and after everything that was left has gone on."""
    mission = play(MissionByHand(scenario_of(model, **options), folder, lenient=True), finding.run)
    mission.go_on(lambda: not running(mission), WITHIN)
    return mission


def running(mission: MissionByHand) -> set[str]:
    return {robot for robot in mission.robots if mission.node(robot).engine.instances}


def failing(result: Exploration) -> list[Finding]:
    return [one for one in result.findings if one.kind in FAILING]


@pytest.fixture(params=["run", "fast", "any"])
def delivery(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.long_but("*-[0-4]")
@pytest.mark.parametrize("seed", range(40))
def test_generated_collaborations(seed: int, delivery: str, tmp_path: Path) -> None:
    model = team(generated(seed))
    for finding in failing(explore(model, delivery=delivery, limit=1_000, samples=False)):
        mission = played(model, finding, tmp_path)
        assert mission.skipped == []
        waiting = running(mission)
        assert waiting
        assert finding.kind == "never" or set(finding.robots) <= waiting, finding.text
        mission.close()


def test_philosophers(delivery: str, tmp_path: Path) -> None:
    model = team(philosophers(3, ordered=False))
    (finding,) = failing(explore(model, delivery=delivery))
    everybody = {f"{who}{n}" for who in ("Phil", "Fork") for n in range(3)}
    mission = played(model, finding, tmp_path)
    assert running(mission) == everybody == set(finding.robots)
    mission.close()


def test_an_award_to_somebody_who_waits_no_more(tmp_path: Path) -> None:
    """The fault that the warehouse had: nobody accepts the parcel, and the dispatcher waits for its delivery."""
    bidder: Steps = ["start offer", "throw bid", ("race", ["catch award", "throw done"], ["timer PT3S", "end"])]
    dispatcher: Steps = ["throw offer", "queue bid", "timer PT1S", "throw award", "catch done"]
    model = team({"Dispatcher": dispatcher, "Carrier": bidder})
    (finding,) = failing(explore(model, delivery="run"))
    assert any("misses /award" in str(step) for step in finding.run)
    mission = played(model, finding, tmp_path)
    assert mission.skipped == []
    assert running(mission) == set(finding.robots) == {"Dispatcher"}
    mission.close()


def test_a_mended_mission_completes_along_the_same_run(tmp_path: Path) -> None:
    broken: dict[str, Steps] = {"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}
    (finding,) = failing(explore(team(broken), delivery="run"))
    mended = {**broken, "B": ["work", "queue go", "throw done"]}
    for steps, waiting in ((broken, {"A", "B"}), (mended, set())):
        mission = played(team(steps), finding, tmp_path)
        assert running(mission) == waiting
        mission.close()


@pytest.mark.long_but("sabotage", "shuttle")
@pytest.mark.parametrize("name", ["ground_vehicles", "shuttle", "sabotage", "agriculture_return", "convoy"])
def test_single_faults_of_shipped_missions(name: str, tmp_path: Path) -> None:
    """Their scripts decide on values of sensors: as in the run."""
    model = f"models/{name}.bpmn"
    result = explore(model, delivery="run", faults=True)
    faults = [one for one in result.findings if one.kind == "fault"]
    assert faults
    assert not failing(result)
    for finding in faults:
        mission = played(model, finding, tmp_path)
        assert mission.skipped == []
        assert set(finding.robots) <= running(mission), finding.text
        mission.close()


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(10))
def test_explorations_of_collaborations_made_at_random_say_what_their_runs_show(part: int, tmp_path: Path) -> None:
    compared = [compare(seed, tmp_path) for seed in range(part, 50, 10)]
    assert [text for _, found in compared for text in found] == []
    assert sum(whole for whole, _ in compared) >= len(compared) // 2
