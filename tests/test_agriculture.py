"""The drone and the tractors: one model for any number of them, and what happens when something goes wrong."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

import fame
from fame.bpmn.pools import assign_pools, pools_of
from fame.clock import SECOND
from fame.log import logging_to
from fame.robot import Event
from fame.robot.events import combine_observers
from fame.scenario import Result, Scenario
from fame.scenario.films import read_run
from sim2d.config import world_config
from sim2d.record import WorldRecord

EXAMPLE = Path("examples/agriculture.yaml")
RESILIENT = Path("examples/agriculture_resilient.yaml")
MODEL = Path("models/agriculture.bpmn")
BASE = {"Drone": {"type": "drone", "at": [-1, 0]}}
FIELD = {"x_max": "6.0", "y_max": "4.0"}
"""A field small enough for a test that is quick."""


@dataclass(frozen=True)
class Run:
    """A run, its events, and, where it was recorded, where robots truly were."""

    result: Result
    events: list[Event]
    record: WorldRecord | None = None
    labels: Sequence[tuple[float, str, str]] = ()

    @property
    def weeds(self) -> dict[str, dict[str, Any]]:
        return self.result.world["weeds"]

    @property
    def reports(self) -> list[tuple[str, str]]:
        return [(event.robot, event.detail) for event in self.result.reports if event.what == "log"]

    def times(self, element: str, robot: str = "Drone", what: str = "leave") -> list[float]:
        """When an element of a robot was completed, or entered, s."""
        there = (robot, element, what)
        return [event.time / SECOND for event in self.events if (event.robot, event.element, event.what) == there]

    def place(self, robot: str, time: float) -> tuple[float, float]:
        record = self.record
        assert record
        sample = min(range(len(record.times)), key=lambda n: abs(record.times[n] - time))
        return next(track.poses[sample][:2] for track in record.tracks if track.name == robot)


def play(robots: dict[str, Any], *, recorded: bool = False, field: dict[str, str] | None = None, **world: Any) -> Run:
    """Run the mission in a world of one's own."""
    text = MODEL.read_text()
    for name, value in (field or {}).items():
        before = {"x_max": "20.0", "y_max": "15.0"}[name]
        changed = text.replace(f'"{name}" value="{before}"', f'"{name}" value="{value}"')
        assert changed != text
        text = changed
    ground = world_config({"bounds": [-2, -1, 8, 6], **world, "robots": {**BASE, **robots}})
    definitions = fame.bpmn.read_text(text, file=str(MODEL))
    cast = assign_pools(pools_of(definitions), [robot.name for robot in ground.robots])
    loaded = Scenario.load(EXAMPLE, duration=600)
    return observed(replace(loaded, definitions=definitions, world=ground, cast=cast), recorded=recorded)


def observed(scenario: Scenario, *, recorded: bool) -> Run:
    events: list[Event] = []
    if not recorded:
        return Run(scenario.run(observer=events.append), events)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with logging_to(path, scenario.closures()) as log:
            observer = combine_observers([events.append, log])
            result = scenario.run(observer=observer)
        run = read_run(path)
        assert run.world is not None
        return Run(result, events, run.world, run.labels)


def tractors(*places: tuple[float, float], **parameters: Any) -> dict[str, Any]:
    return {f"Tractor_{n}": {"type": "tractor", "at": list(at), **parameters} for n, at in enumerate(places, 1)}


def weeds(*places: tuple[float, float]) -> list[dict[str, Any]]:
    return [{"at": list(at)} for at in places]


def assert_all_went_well(run: Run) -> None:
    result = run.result
    assert (result.status, result.messages, run.reports) == ("completed", [], [])
    assert [name for name, weed in run.weeds.items() if weed["by"] is None] == []
    assert result.world["collisions"] == []
    drone = result.world["robots"]["Drone"]
    assert drone["landed"]
    assert math.dist((drone["x"], drone["y"]), BASE["Drone"]["at"]) < 0.3


# ---- the mission -----------------------------------------------------------------------------------------------------


@pytest.fixture(
    scope="module",
    params=[pytest.param(1, marks=pytest.mark.long), 2, pytest.param(3, marks=pytest.mark.long)],
    ids="{} tractors".format,
)
def played(request: pytest.FixtureRequest) -> Run:
    """The example; with fewer tractors, on a smaller field."""
    if request.param == 3:
        return observed(Scenario.load(EXAMPLE), recorded=True)
    places = ((1, 0), (6, 0))[: request.param]
    return play(tractors(*places), recorded=True, field=FIELD, weeds=weeds((1, 1), (3, 3), (4, 1), (5.5, 3.5)))


def test_any_number_of_tractors_cuts_all_weeds_without_a_collision_and_the_drone_lands_at_its_base(played: Run) -> None:
    assert_all_went_well(played)
    verdicts = [each.verdict for each in played.result.judgements]
    assert verdicts == ["holds"] * 3 or "Tractor_2" not in played.result.world["robots"]  # one alone is too slow


def test_each_weed_is_announced_once(played: Run) -> None:
    assert len(played.times("Event_Survey_WeedFound")) == len(played.weeds)


def test_each_weed_is_cut_by_the_tractor_that_was_nearest_when_asked(played: Run) -> None:
    """Of those that answered: who is busy does not."""
    robots = [name for name in played.result.world["robots"] if name != "Drone"]
    for decided in played.times("Event_ClosestTractor"):
        asked = max(time for time in played.times("Event_WeedPosition") if time < decided)
        answered = [
            (robot, time)
            for robot in robots
            for time in played.times("Event_TractorPositionThrown", robot)
            if asked <= time < decided
        ]
        (chosen,) = [robot for robot in robots if decided in played.times("Activity_GoTo", robot, "enter")]
        cuts = [weed for weed in played.weeds.values() if weed["by"] == chosen and weed["cut"] > decided]
        weed = min(cuts, key=lambda weed: weed["cut"])
        far = {robot: math.dist(played.place(robot, time), (weed["x"], weed["y"])) for robot, time in answered}
        assert far[chosen] == min(far.values())


def test_a_caption_says_that_a_tractor_waits_for_the_choice(played: Run) -> None:
    said = {(robot, text) for _, robot, text in played.labels}
    assert {("Tractor_1", "Wait for the Choice"), ("Tractor_1", "Go To"), ("Tractor_1", "Cut Grass")} <= said


def test_where_two_boundaries_of_the_field_meet_it_is_explored_all_the_same() -> None:
    run = play(tractors((3, 3)), field={"x_max": "0.0", "y_max": "0.0"}, weeds=weeds((0.5, 0.5)))
    assert_all_went_well(run)


@pytest.mark.long
def test_a_weed_inside_an_obstacle_is_reported_and_the_mission_goes_on() -> None:
    pond = {"name": "pond", "at": [3, 2], "radius": 0.8}
    run = play(tractors((0, 2)), field=FIELD, obstacles=[pond], weeds=weeds((3, 2), (5.5, 3.5)))
    assert run.result.status == "completed"
    assert [weed["by"] for weed in run.weeds.values()] == [None, "Tractor_1"]
    assert run.result.messages == [f"weed {next(iter(run.weeds))} was not cut"]
    assert [robot for robot, _ in run.reports] == ["Tractor_1", "Drone"]
    assert "no way to the weed at (3.0" in run.reports[0][1] or "no way to the weed at (2.9" in run.reports[0][1]
    assert run.result.world["robots"]["Drone"]["landed"]


def test_a_tractor_passes_what_is_not_on_its_map() -> None:
    stone = {"name": "stone", "at": [3, 2], "radius": 0.25}
    run = play(tractors((0, 2)), field=FIELD, targets=[stone], weeds=weeds((5.5, 2)))
    assert_all_went_well(run)
    assert run.times("Activity_StepAside", "Tractor_1")


@pytest.mark.long
def test_a_tractor_that_cannot_move_any_more_leaves_its_weed_uncut_and_the_others_go_on() -> None:
    robots = tractors((1, 0), (6, 5))
    robots["Tractor_1"]["battery"] = {"charge": 0.0005}
    run = play(robots, field=FIELD, weeds=weeds((3, 0.5), (5, 3.5)))
    assert run.result.status == "failed"
    assert [weed["by"] for weed in run.weeds.values()] == [None, "Tractor_2"]
    assert [error.code for robot in run.result.robots for error in robot.errors] == ["blocked"]
    assert run.result.messages[-1] == f"weed {next(iter(run.weeds))} was not cut"
    assert run.result.world["robots"]["Drone"]["landed"]


@pytest.mark.long
def test_a_weed_that_nobody_reports_cut_is_given_to_another_tractor() -> None:
    run = observed(Scenario.load(RESILIENT), recorded=False)
    assert run.result.status == "completed"
    assert [each.verdict for each in run.result.judgements] == ["holds"] * 3
    assert run.weeds["thistle"]["by"] == "Tractor_1"
    assert run.weeds["nettle"]["by"] == "Tractor_2"
    assert run.reports == [("Tractor_1", "warning: out of order: blocked")]
    assert run.result.world["robots"]["Tractor_1"]["battery"] == 0
    assert run.result.world["robots"]["Drone"]["landed"]


# ---- the drone's question --------------------------------------------------------------------------------------------

Answer = tuple[float, str, float]
"""When (s), who, and how far from the weed (m)."""


def ask(answers: Iterable[Answer], until: float) -> tuple[dict[str, Any], list[tuple[float, str]]]:
    """The drone's variables after it has found a weed at second 0, and when it said what."""
    said: list[tuple[float, str]] = []

    def note(event: Event) -> None:
        if event.what == "leave" and event.element in ("Event_WeedPosition", "Event_ClosestTractor"):
            said.append((event.time / SECOND, event.element.removeprefix("Event_")))

    drone = fame.Simulation(fame.read(MODEL), process="Drone", robot="Drone", observer=note).run(until=0)
    drone.signal("weed_found", {"x": 1.0, "y": 2.0})
    for time, name, far in answers:
        drone.run(until=time)
        drone.signal("tractor_position", {"header": {"frame_id": name}, "vector": {"x": 1.0 + far, "y": 2.0}})
    drone.run(until=until)
    return drone.instances[0].variables, said


def test_of_three_answers_the_closest_is_chosen() -> None:
    variables, _ = ask([(0.1, "Tractor_1", 5), (0.2, "Tractor_2", -3), (0.3, "Tractor_3", 4)], until=10)
    assert variables["closest_tractor"] == "Tractor_2"


def test_of_two_that_are_equally_near_the_one_that_answered_first_is_chosen() -> None:
    variables, _ = ask([(0.1, "Tractor_9", 5), (0.2, "Tractor_2", -5), (0.3, "Tractor_1", 5)], until=10)
    assert variables["closest_tractor"] == "Tractor_9"


def test_the_choice_falls_10_s_after_the_request_however_late_the_answers_come() -> None:
    _, said = ask([(0.1, "Tractor_1", 5), (9.9, "Tractor_2", 4)], until=30)
    assert said == [(0, "WeedPosition"), (10, "ClosestTractor")]


def test_as_long_as_nobody_answers_the_drone_asks_again() -> None:
    variables, said = ask([(25, "Tractor_1", 5)], until=40)
    assert said == [(0, "WeedPosition"), (10, "WeedPosition"), (20, "WeedPosition"), (30, "ClosestTractor")]
    assert variables["closest_tractor"] == "Tractor_1"


def test_the_next_weed_begins_without_a_closest_tractor() -> None:
    drone = fame.Simulation(fame.read(MODEL), process="Drone", robot="Drone").run(until=0)
    for weed, name in ((1.0, "Tractor_1"), (9.0, "Tractor_2")):
        drone.signal("weed_found", {"x": weed, "y": 0.0})
        far = weed + {"Tractor_1": 0.5, "Tractor_2": 3.0}[name]
        drone.signal("tractor_position", {"header": {"frame_id": name}, "vector": {"x": far, "y": 0.0}})
        drone.run(until=drone.now + 10)
        assert drone.instances[0].variables["closest_tractor"] == name


# ---- the tractor's answer --------------------------------------------------------------------------------------------


@pytest.fixture
def tractor() -> fame.Simulation:
    """A tractor at (3, 4) that has been asked for a weed at (1, 2), and has answered."""
    simulation = fame.Simulation(fame.read(MODEL), process="Tractor", robot="Tractor_7").run(until=0)
    simulation.signal("weed_position", {"x": 1.0, "y": 2.0})
    return simulation.signal("~/odom", {"pose": {"pose": {"position": {"x": 3.0, "y": 4.0}}}})


def test_it_answers_with_its_name_and_place_and_waits(tractor: fame.Simulation) -> None:
    (instance,) = tractor.instances
    names = ("tractor_name", "x_tractor", "y_tractor", "x_weed", "y_weed")
    assert [instance.variables[name] for name in names] == ["Tractor_7", 3, 4, 1, 2]
    assert instance.visits["Event_TractorPositionThrown"] == 1
    assert list(instance.waiting) == ["Gateway_WhoIsClosest"]


def test_another_one_is_closest_and_it_ends(tractor: fame.Simulation) -> None:
    tractor.signal("closest_tractor", "Tractor_1")
    assert tractor.instances[0].status == "completed"
    assert tractor.instances[0].visits["Activity_GoTo"] == 0


def test_nobody_decides_and_it_ends_after_30_s(tractor: fame.Simulation) -> None:
    assert tractor.run(until=29.9).instances[0].status == "running"
    assert tractor.run(until=30).instances[0].status == "completed"


def test_it_is_the_closest_and_asks_its_planner_for_the_way(tractor: fame.Simulation) -> None:
    tractor.signal("closest_tractor", "Tractor_7")
    assert list(tractor.instances[0].waiting) == ["Gateway_Answer"]


def test_it_asks_again_until_its_planner_answers(tractor: fame.Simulation) -> None:
    tractor.signal("closest_tractor", "Tractor_7").run(until=12)
    assert tractor.instances[0].visits["Event_GoalPose"] == 3
    here = {"pose": {"position": {"x": 3.0, "y": 4.0}}}
    tractor.signal("~/plan", {"poses": [here, {"pose": {"position": {"x": 1.0, "y": 2.0}}}]})
    assert list(tractor.instances[0].waiting) == ["Event_GoTo_Odometry"]
    tractor.signal("~/plan", {})  # an answer to an earlier request is not taken for one to the next
    assert list(tractor.instances[0].waiting) == ["Event_GoTo_Odometry"]


def test_its_planner_never_answers_and_the_weed_is_out_of_reach(tractor: fame.Simulation) -> None:
    tractor.signal("closest_tractor", "Tractor_7").run(until=31)
    assert tractor.instances[0].visits["Event_GoalPose"] == 6
    assert tractor.instances[0].visits["Event_NoPlanner"] == 1


def test_while_it_is_busy_it_does_not_answer(tractor: fame.Simulation) -> None:
    tractor.signal("weed_position", {"x": 8.0, "y": 8.0})
    assert len(tractor.instances) == 1
    assert "trigger dropped" in tractor.reports[0].detail
