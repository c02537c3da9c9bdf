"""``--robots`` and ``--fault``: one model for any number of robots, and what the others do when one of them breaks."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document

from fame.cli import main
from fame.errors import ConfigError
from fame.scenario import Fault, Result, Scenario

EXAMPLE = Path(__file__).parent.parent / "examples" / "agriculture.yaml"


def load(**options: Any) -> Scenario:
    return Scenario.load(EXAMPLE, **options)


def refused(**options: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        load(**options).run()
    return caught.value.text


def own(result: Result, robot: str) -> Any:
    return next(one for one in result.robots if one.name == robot)


# ---- robots ----------------------------------------------------------------------------------------------------------


def test_robots_of_the_file_stay_where_they_are_and_the_others_are_like_them() -> None:
    few, many = load().world, load(robots={"Tractor": 12}).world
    assert few is not None
    assert many is not None
    assert many.robots[:4] == few.robots
    assert [robot.name for robot in many.robots[4:]] == [f"Tractor_{number}" for number in range(4, 13)]
    assert {robot.parameters for robot in many.robots[1:]} == {few.robots[1].parameters}
    places = [robot.at for robot in many.robots]
    assert min(math.dist(a, b) for a in places for b in places if a != b) > 0.7


def test_the_seed_places_them() -> None:
    def places(seed: int) -> list[tuple[float, float]]:
        world = load(robots={"Tractor": 8}, seed=seed).world
        assert world is not None
        return [robot.at for robot in world.robots]

    assert places(1) == places(1) != places(2)
    assert places(1)[:4] == places(2)[:4]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2, 12])  # three are the example, which test_agriculture runs
def test_the_model_is_the_same_for_any_number(count: int) -> None:
    result = load(robots={"tractor": count}).run()
    assert (result.status, result.messages) == ("completed", [])
    assert [robot.name for robot in result.robots] == ["Drone", *(f"Tractor_{n}" for n in range(1, count + 1))]
    assert result.world is not None
    assert all(weed["cut"] is not None for weed in result.world["weeds"].values())


def test_without_any_tractor_the_drone_keeps_asking_until_the_time_is_up() -> None:
    result = load(robots={"Tractor": 0}, duration=60).run()
    assert (result.status, len(result.robots)) == ("timeout", 1)
    place = '"tractor_position" (Event_TractorPosition)'
    assert f"Drone waits at {place} for topic /tractor_position, which no other node publishes" in result.messages


def test_a_team_of_which_nobody_is_left_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(EXAMPLE.with_name("convoy.yaml")), "--robots", "Car=0"]) == 2
    assert "expected at least one robot to run" in capsys.readouterr().err


def test_a_model_without_a_world_has_as_many_engines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pools = '<participant id="a" name="Ant" processRef="P"><participantMultiplicity/></participant>'
    drawn = f'<collaboration id="C">{pools}</collaboration><process id="P"><startEvent id="s"/></process>'
    (tmp_path / "ants.bpmn").write_text(document(drawn))
    assert main(["run", str(tmp_path / "ants.bpmn"), "--robots", "Ant=3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {name: robot["completed"] for name, robot in told["robots"].items()} == {"Ant_1": 1, "Ant_2": 1, "Ant_3": 1}


def test_what_cannot_be_is_refused() -> None:
    assert refused(robots={"Plough": 2}) == "unknown pool 'Plough' in Plough=2; pools are: Drone, Tractor"
    text = "expected a multi-instance pool in Drone=2, got pool 'Drone', which is a single robot"
    assert refused(robots={"Drone": 2}) == text
    assert "got room for" in refused(robots={"Tractor": 2000})
    assert refused(robots={"Tractor": 10**12}) == f"expected at most 100000 robots, got Tractor={10**12}"


# ---- faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_an_engine_that_dies_says_nothing_more_and_the_others_go_on() -> None:
    at = 20.0
    result = load(faults=[Fault("Tractor_1", at, "engine")]).run()
    dead = own(result, "Tractor_1")
    assert (result.status, dead.failed, dead.waits) == ("failed", 1, ())
    (error,) = dead.errors
    assert (error.code, error.text) == ("engine", "its engine died at 20 s")
    assert [robot.failed for robot in result.robots if robot is not dead] == [0, 0, 0]
    assert own(result, "Drone").completed == 1
    assert [event.detail for event in result.reports if event.robot == "Tractor_1"] == ["fault: engine"]
    assert result.world is not None
    cut = [weed["by"] for weed in result.world["weeds"].values() if (weed["cut"] or 0) > at]
    assert cut
    assert "Tractor_1" not in cut


@pytest.mark.long
def test_a_tractor_without_an_engine_is_braked_by_its_watchdog() -> None:
    early = load(faults=[Fault("Tractor_1", 20.0, "engine")], duration=25.0).run().world
    late = load(faults=[Fault("Tractor_1", 20.0, "engine")], duration=60.0).run().world
    assert early is not None
    assert late is not None
    keys = ("x", "y", "heading")
    assert [early["robots"]["Tractor_1"][key] for key in keys] == [late["robots"]["Tractor_1"][key] for key in keys]
    assert early["robots"]["Tractor_1"]["x"] != -1.0


@pytest.mark.long
@pytest.mark.parametrize(("kind", "code"), [("range", "sensor_lost"), ("wheels", "blocked")])
def test_a_behaviour_says_what_is_broken(kind: str, code: str) -> None:
    result = load(faults=[Fault("Tractor_1", 10.0, kind)]).run()
    assert result.status == "failed"
    assert {error.code for error in own(result, "Tractor_1").errors} == {code}
    assert own(result, "Drone").completed == 1
    assert result.world is not None
    assert result.world["robots"]["Tractor_1"]["faults"] == [kind]


@pytest.mark.long
def test_a_fault_is_repeatable() -> None:
    results = [load(faults=[Fault("Tractor_2", 40.0, "engine")], duration=80).run().to_json() for _ in range(2)]
    assert results[0] | {"wall": 0} == results[1] | {"wall": 0}


def test_a_fault_that_cannot_be_is_refused_before_anything_moves() -> None:
    text = "unknown robot 'Tractor_9' in --fault; robots are: Drone, Tractor_1, Tractor_2, Tractor_3"
    assert refused(faults=[Fault("Tractor_9", 1.0, "engine")]) == text
    text = "unknown fault 'legs' of Tractor_1; known are: engine, range, wheels"
    assert refused(faults=[Fault("Tractor_1", 1.0, "legs")]) == text
    for time in (-1.0, math.nan, math.inf):
        assert "at a second from 0 on" in refused(faults=[Fault("Tractor_1", time, "range")])


@pytest.mark.parametrize(
    ("option", "text", "right"),
    [
        ("--robots", "Tractor", "POOL=N, as in Tractor=12"),
        ("--robots", "Tractor=-1", "POOL=N, as in Tractor=12"),
        ("--fault", "Tractor_1:engine", "a fault ROBOT@SECOND:KIND, as in Tractor_2@40:engine"),
        ("--fault", "Tractor_1@-4:engine", "a fault ROBOT@SECOND:KIND, as in Tractor_2@40:engine"),
    ],
)
def test_what_cannot_be_read_is_said(option: str, text: str, right: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(EXAMPLE), option, text]) == 2
    assert f"argument {option}: expected {right}, got {text!r}" in capsys.readouterr().err


def test_both_need_everything_in_one_process(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(EXAMPLE), "--middleware", "dds", "--robots", "Tractor=2"]) == 2
    assert "--robots needs --middleware local" in capsys.readouterr().err


@pytest.mark.long_but("5*")
@pytest.mark.parametrize(("time", "behaviour"), [(5.0, "Turn"), (25.0, "GoTo")])
def test_a_car_that_stands_still_is_blocked_whatever_it_is_at(time: float, behaviour: str) -> None:
    cars = Scenario.load(EXAMPLE.parent / "ground_vehicles.yaml", faults=[Fault("REX", time, "wheels")])
    result = cars.run()
    assert result.status == "failed"
    assert result.simulated < time + 60
    error = next(error for robot in result.robots for error in robot.errors)
    assert (error.code, Path(error.file).stem) == ("blocked", behaviour)
