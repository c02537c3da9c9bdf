"""Models of every dialect run, and those that say the same do the same; whole missions in the style of the original."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document, extensions

import fame
import fame.bpmn
from fame.clock import SECOND
from fame.robot import Event
from fame.scenario import Result, Scenario

MODELS = Path(__file__).parent / "models"
DIALECTS = sorted((MODELS / "dialects").glob("*.bpmn"))
FAR, NEAR = {"x": -1.5, "y": 2.25}, {"x": 0.5, "y": 0.25}


@dataclass(frozen=True)
class Run:
    """What happened: (simulated s, element, what), the answers that others heard, and the variables at the end."""

    log: list[tuple[float, str, str]]
    answers: list[Any]
    variables: dict[str, Any]


def run(path: Path, weed: dict[str, float]) -> Run:
    """Run the process of a file until it waits, 5 s later tell it of a weed, and run it to its end."""
    log: list[tuple[float, str, str]] = []
    answers: list[Any] = []
    simulation = fame.Simulation(
        fame.read(path), "Answer", observer=lambda event: log.append((event.time / SECOND, event.element, event.what))
    )
    simulation.middleware.node("peer").subscription("/answer", "geometry_msgs/msg/Vector3", answers.append)
    simulation.scheduler.at(5 * SECOND, lambda: simulation.node.deliver("/weed_found", weed))
    (instance,) = simulation.run().instances
    assert instance.error is None
    assert instance.status == "completed"
    return Run(log, answers, instance.variables)


def test_there_is_a_model_in_each_dialect() -> None:
    assert [path.stem for path in DIALECTS] == ["camunda7", "camunda8", "fame_g0", "fame_g1", "fame_g2", "python"]


@pytest.mark.parametrize("path", DIALECTS, ids=lambda path: path.stem)
def test_a_model_does_what_it_says(path: Path) -> None:
    far, near = run(path, FAR), run(path, NEAR)
    assert [(answer.x, answer.y, answer.z) for answer in far.answers] == [(3.75, 2.25, 0.0)]
    assert near.answers == []
    assert far.variables["distance"] == 3.75
    assert (5.0, "Sum", "leave") in far.log
    assert (7.0, "Tell", "leave") in far.log
    assert (5.0, "End_Near", "leave") in near.log


@pytest.mark.parametrize("weed", [FAR, NEAR], ids=["far", "near"])
def test_the_same_process_has_the_same_log_in_every_dialect(weed: dict[str, float]) -> None:
    logs = [run(path, weed).log for path in DIALECTS]
    assert len(logs[0]) > 20
    assert all(log == logs[0] for log in logs)


# ---- whole missions with JavaScript in the style of the original -----------------------------------------------------


def play(name: str) -> tuple[Result, list[Event]]:
    events: list[Event] = []
    result = Scenario.load(MODELS / "javascript" / f"{name}.yaml").run(observer=events.append)
    return result, events


@pytest.fixture(scope="module")
def ground_vehicles() -> tuple[Result, list[Event]]:
    return play("ground_vehicles")


@pytest.fixture(scope="module")
def agriculture() -> tuple[Result, list[Event]]:
    return play("agriculture")


def times(events: list[Event], robot: str, element: str, what: str = "leave") -> list[float]:
    """When an element of a robot was completed, or entered (s)."""
    return [
        event.time / SECOND for event in events if (event.robot, event.element, event.what) == (robot, element, what)
    ]


@pytest.mark.long
def test_the_ground_vehicles_find_and_destroy_the_target(ground_vehicles: tuple[Result, list[Event]]) -> None:
    result, _ = ground_vehicles
    assert (result.status, result.messages) == ("completed", [])
    dingo = result.world["robots"]["DINGO"]
    assert dingo["distances"]["target"] < 0.3
    assert dingo["led"] == "red"
    assert result.world["collisions"] == []


@pytest.mark.long
def test_scripts_of_the_mission_return_at_once_and_their_callbacks_go_on(
    ground_vehicles: tuple[Result, list[Event]],
) -> None:
    _, events = ground_vehicles
    assert times(events, "DINGO", "GoTo_Drive") == times(events, "DINGO", "GoTo_Drive", "enter")
    polls = times(events, "DINGO", "GoTo_Pause")
    assert len(polls) > 2
    assert {round(later - former, 6) for former, later in pairwise(polls)} == {2.0}


@pytest.mark.long
def test_the_drone_finds_the_weeds_and_the_closest_tractors_cut_them(agriculture: tuple[Result, list[Event]]) -> None:
    result, events = agriculture
    assert (result.status, result.messages) == ("completed", [])
    weeds = result.world["weeds"]
    assert all(weed["cut"] is not None for weed in weeds.values())
    assert {weed["by"] for weed in weeds.values()} == {"Tractor_1", "Tractor_2"}
    assert (weeds["thistle"]["by"], weeds["dock"]["by"]) == ("Tractor_1", "Tractor_2")
    assert len(times(events, "Drone", "Weed_Found")) == 3


@pytest.mark.long
def test_the_survey_goes_on_where_it_was_after_a_weed(agriculture: tuple[Result, list[Event]]) -> None:
    result, events = agriculture
    found, chosen = times(events, "Drone", "Weed_Found"), times(events, "Drone", "Weed_Choose")
    taken = times(events, "Drone", "Survey_Split")
    assert len(taken) == 6
    assert not any(begin < time < end for begin, end in zip(found, chosen, strict=True) for time in taken)
    assert times(events, "Drone", "Survey_Plan") == taken[:1]
    drone = result.world["robots"]["Drone"]
    assert drone["landed"]
    assert abs(drone["x"] + 1) < 0.2
    assert abs(drone["y"]) < 0.2


@pytest.mark.long
def test_a_mission_in_javascript_is_the_same_each_time(agriculture: tuple[Result, list[Event]]) -> None:
    assert play("agriculture")[1] == agriculture[1]


def test_an_output_of_camunda_7_sees_those_before_it_but_not_behind_an_input() -> None:
    """The process has the earlier ones by then; an input of the same name hides its own (`OutputParameter` there)."""
    outputs = '<camunda:outputParameter name="y">${x + 1}</camunda:outputParameter>' + (
        '<camunda:outputParameter name="z">${y + 1}</camunda:outputParameter>'
    )
    found = []
    for given in ("", '<camunda:inputParameter name="y">10</camunda:inputParameter>'):
        held = extensions(f"<camunda:inputOutput>{given}{outputs}</camunda:inputOutput>")
        model = document(
            '<process id="P" isExecutable="true"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
            f'<scriptTask id="t">{held}<script>pass</script></scriptTask></process>'
        )
        variables = fame.Simulation(fame.bpmn.read_text(model), variables={"x": 1}).run().instances[0].variables
        found.append((variables["y"], variables["z"]))
    assert found == [(2, 3), (2, 11)]
