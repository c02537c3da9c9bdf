"""Models as people wrote them who knew the original FaMe or Camunda, and not us: odd but legal, they run as meant.

Each is in tests/models/unusual. All run a second time as `fame convert` writes them, to the same log.
"""

from pathlib import Path
from typing import Any

import pytest
from test_formats import BOOL, INT, VECTOR, Play, xyz

import fame
from fame.bpmn.conversion import convert
from fame.check import check
from fame.clock import SECOND
from fame.robot import Event
from fame.scenario import Scenario

MODELS = Path(__file__).parent / "models" / "unusual"
TEXT = "std_msgs/msg/String"


@pytest.fixture(params=["as it is", "converted"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The models as they are, and as they are converted."""
    if request.param == "as it is":
        return MODELS
    for path in MODELS.rglob("*.bpmn"):
        new = tmp_path / path.relative_to(MODELS)
        new.parent.mkdir(exist_ok=True)
        new.write_bytes(convert(fame.read(path)))
    return tmp_path


def team(path: Path, **options: Any) -> list[tuple[float, str, str]]:
    """Run a collaboration without a world: (s, robot, element) of each element completed."""
    events: list[Event] = []
    result = Scenario.load(path, **options).run(observer=events.append)
    assert (result.status, [str(error) for robot in result.robots for error in robot.errors]) == ("completed", [])
    return [(event.time / SECOND, event.robot, event.element) for event in events if event.what == "leave"]


def test_a_drone_finds_a_weed_and_the_closest_of_three_tractors_cuts_it(folder: Path) -> None:
    done = team(folder / "weed_control.bpmn", robots={"tractor": 3}, semantics="original")
    assert [(time, robot) for time, robot, element in done if element == "Cut"] == [(5.0, "tractor_3")]
    assert sorted(robot for _, robot, element in done if element == "Not_Me") == ["tractor_1", "tractor_2"]
    explored = [time for time, _, element in done if element == "Explore"]
    assert explored == [0.0, 2.0, 4.0, 7.0, 9.0]  # the handler took 1 s, then it flew on


def test_without_semantics_original_the_exploration_is_over_after_the_weed(folder: Path) -> None:
    done = team(folder / "weed_control.bpmn", robots={"tractor": 3})
    assert [element for _, robot, element in done if robot == "drone"][-2:] == ["Closest", "Weed"]


def test_a_list_is_split_in_a_loop_that_polls_every_two_seconds(folder: Path) -> None:
    done = team(folder / "patrol.bpmn")
    splits = [(robot, time) for time, robot, element in done if element == "Split"]
    assert splits == [("Alpha", 0.0), ("Beta", 0.0), ("Alpha", 4.0), ("Alpha", 8.0)]
    assert [(robot, element) for _, robot, element in done if element in ("Fast", "Slow")] == [
        ("Alpha", "Fast"), ("Beta", "Slow"),
    ]  # fmt: skip


def test_the_oldest_form_with_a_handler_beside(folder: Path) -> None:
    play = Play("conveyor", folder=folder, process="Belt").hear(belt="geometry_msgs/msg/Twist", note=TEXT, alarm=BOOL)
    play.say(1, "/piece", TEXT, "bolt").say(2, "/jam", BOOL, True).say(3, "/jam", BOOL, True).run()
    assert [(message.linear.x, message.linear.y, message.angular.z) for message in play.heard["belt"]] == [
        (1.0, 0.25, -1.0), (0.0, 0.0, 0.0),
    ]  # fmt: skip
    assert [message.data for message in play.heard["note"]] == ["piece bolt, number 1"]
    assert [message.data for message in play.heard["alarm"]] == [True, True]
    assert play.times("Note") == [5.0]


def test_processes_within_processes_within_call_activities(folder: Path) -> None:
    play = Play("beacon", folder=folder, process="Process_1").hear(blinked=INT).run()
    assert [message.data for message in play.heard["blinked"]] == [1, 2, 100]
    assert play.variables["blinks"] == 3


def test_labels_name_topics_and_data_stands_on_the_data_object(folder: Path) -> None:
    play = Play("rescue", folder=folder, process="Process_Rescue").hear(report=TEXT)
    play.say(1, "/help_needed", VECTOR, {"x": 2.5, "y": 1.0}).say(20, "/help_needed", VECTOR, {"x": 3.0})
    play.say(22, "/false_alarm", BOOL, True).run()
    assert [message.data for message in play.heard["report"]] == ["at 2.5, 1.0", "going home"]
    assert (play.times("Late"), play.times("Cancelled")) == ([11.0], [22.0])


@pytest.mark.parametrize(
    ("heading", "probes", "view", "measured"),
    [(60, ["a", "b", "c"], "wide", ["a", "b"]), (10, [], "narrow", []), (0, [], None, [])],
)
def test_a_process_of_camunda_7_with_all_that_its_modeler_offers(
    heading: int, probes: list[str], view: str | None, measured: list[str], folder: Path
) -> None:
    seen: list[str] = []
    services = {"measure": lambda variables: seen.append(variables["probe"])}
    sim = fame.Simulation(
        fame.read(folder / "inspection.bpmn"), variables={"heading": heading, "views": 0, "site": {"probes": probes}},
        services=services,
    )  # fmt: skip
    sim.run(until=150)
    (instance,) = sim.instances
    assert "Sign" in instance.waiting
    assert instance.variables["nagged"] == 2
    sim.complete("Sign")
    assert instance.status == "completed"
    views = 1 if view is not None else 0
    assert (seen, instance.variables.get("view"), instance.variables["views"]) == (measured, view, views)
    assert instance.visits["Nothing"] == (1 if view is None and not measured else 0)


def test_a_process_of_camunda_8_with_lists_paths_and_correlated_messages(folder: Path) -> None:
    jobs: list[Any] = []

    def load(variables: dict[str, Any]) -> None:
        jobs.append(dict(variables["job"]))
        variables["loaded"] = "full"

    sim = fame.Simulation(fame.read(folder / "delivery.bpmn"), variables={}, services={"load": load})
    heard: list[Any] = []
    sim.middleware.node("peer").subscription("/delivered", VECTOR, heard.append)
    sim.run(until=0)
    sim.message("order", {"id": 7, "weight": 2.5, "parcels": [{"weight": 9.0}, {"weight": 0.0}]})
    (instance,) = sim.instances
    assert jobs == [{"number": 7, "weight": 2.5}]
    assert instance.variables["cargo"] == {"state": "full"}
    sim.run()
    assert sim.now == 2.0
    sim.message("signed", {"id": 8})
    assert instance.waiting == ["Signed"]
    sim.message("signed", {"id": 7})
    assert instance.status == "completed"
    assert [xyz(message) for message in heard] == [(2.5, 18.0, 0.0)]


def test_both_forms_in_one_file_the_properties_come_first(folder: Path) -> None:
    play = Play("handed_on", folder=folder, process="Process_1").hear(ready=VECTOR).run()
    assert [xyz(message) for message in play.heard["ready"]] == [(6.0, 1.0, 0.0)]
    assert play.variables["prepared"] == "field: north!"


WORLD = """model: {}
world:
  size: [8, 6]
  robots:
    Drone: {{type: drone, at: [2, 3], odom: {{position_noise: 0}}}}
"""


def test_a_drone_is_flown_by_its_service_from_scripts_and_tasks(folder: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "pilot.yaml"
    scenario.write_text(WORLD.format(folder / "pilot.bpmn"))
    result = Scenario.load(scenario).run()
    assert (result.status, result.messages) == ("completed", [])
    drone = result.world["robots"]["Drone"]
    assert drone["landed"]
    assert drone["x"] == pytest.approx(3.0, abs=0.35)
    assert any("takeoff: 1" in str(event.detail) for event in result.reports)


def test_the_traps_of_scripts(folder: Path) -> None:
    play = Play("traps", folder=folder, process="Traps").hear(said=TEXT).say(5, "words", TEXT, "this").run()
    assert play.times("Rung") == [2.5]
    assert (play.variables["best"], play.variables["list"]) == (7, [{"n": 10}, {"n": 20}])
    assert "rang" not in play.variables
    assert play.times("Caught") == [5.0]
    assert "cannot read this" in play.variables["why"]
    assert [message.data for message in play.heard["said"]] == ["bare text", "best is 7"]


def test_none_of_them_has_an_error_to_tell() -> None:
    found = [one for path in MODELS.rglob("*.bpmn") for one in check(fame.read(path))]
    assert [str(one) for one in found if one.level == "error"] == []
