"""The page of a team on the network: robots appear as they come, with their models, tokens and variables."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from view_page import becomes, beyond, eventually, frames, opened, shot, until, violations

from fame.clock import SECOND, Scheduler, WallScheduler
from fame.errors import FameError
from fame.log import Recording
from fame.log.live_team import LiveTeam
from fame.log.merging import merge
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder
from fame.middleware import messages
from fame.middleware.simulated_time import CLOCK, CLOCK_QOS, CLOCK_TYPE, clock_message
from fame.view import Replay, TeamView
from fame.view.state import ENTER
from tests.bpmn_text import document, process
from tests.deployment_field import Field as DeploymentField, definitions, process as process_of
from tests.test_live_team import COUNTING, Field as LiveField
from tests.test_view_blocks import replayed

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
SIGNING = process("""
  <startEvent id="Start"><outgoing>f0</outgoing></startEvent>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Sign" />
  <userTask id="Sign" name="Sign"><incoming>f0</incoming><outgoing>f1</outgoing></userTask>
  <sequenceFlow id="f1" sourceRef="Sign" targetRef="Rest" />
  <intermediateCatchEvent id="Rest" name="a rest"><incoming>f1</incoming>
    <timerEventDefinition id="t"><timeDuration>PT1H</timeDuration></timerEventDefinition></intermediateCatchEvent>""")

TWICE = process("""
  <startEvent id="Bad"><outgoing>f0</outgoing>
    <timerEventDefinition id="t0"><timeDuration>PT1S</timeDuration></timerEventDefinition></startEvent>
  <sequenceFlow id="f0" sourceRef="Bad" targetRef="Grip" />
  <scriptTask id="Grip" scriptFormat="python"><incoming>f0</incoming>
    <script>raise ValueError("no grip")</script></scriptTask>
  <startEvent id="Good">
    <timerEventDefinition id="t1"><timeDuration>PT2S</timeDuration></timerEventDefinition></startEvent>""")

DIAGRAM = """<bpmndi:BPMNDiagram id="diagram"><bpmndi:BPMNPlane id="plane" bpmnElement="P">
  <bpmndi:BPMNShape id="shape" bpmnElement="Sign"><dc:Bounds x="9" y="9" width="99" height="80" /></bpmndi:BPMNShape>
</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""


class Field(LiveField):
    """Engines and a page, on local topics."""

    def __init__(self, scheduler: Scheduler, **options: Any) -> None:
        super().__init__(scheduler)
        self.view = TeamView(self.middleware, scheduler, **options)

    def deploy(self, name: str, text: str = SIGNING) -> None:
        super().deploy(name, text)

    def waiting(self) -> set[tuple[str, str]]:
        packer = self.view._packer
        return {
            (packer.robots[robot], token["element"])
            for robot, state in packer.state.robots.items()
            for token in state.tokens.values()
        }

    def until(self, condition: Callable[[], object]) -> None:
        """Run on the wall clock until a condition holds."""
        eventually(lambda: (self.run(0.05), condition())[1])

    def close(self) -> None:
        self.view.close()
        super().close()


@pytest.fixture
def field() -> Iterator[Field]:
    field = Field(Scheduler())
    yield field
    field.close()


def test_an_empty_network_says_what_to_do(field: Field) -> None:
    field.run(2)
    mission = field.view.mission()
    assert mission["robots"] == []
    assert mission["empty"][0] == "No robot on the network yet"
    assert "fame engine NAME" in mission["empty"][1]


def test_robots_appear_with_their_models_and_tokens(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    assert field.waiting() == {("REX", "Sign")}
    mission = field.view.mission()
    assert [one["name"] for one in mission["robots"]] == ["REX"]
    assert "Sign" in {one.get("name") for one in mission["elements"]}


def test_robots_have_the_order_of_their_names_whichever_came_first(field: Field) -> None:
    for robot in ("Car_10", "Car_9", "Ada"):
        field.engine(robot)
        field.run(1)
        field.deploy(robot)
        field.run(2)
    mission = field.view.mission()
    names = [one["name"] for one in mission["robots"]]
    assert names == ["Car_10", "Car_9", "Ada"]
    assert [names[number] for number in mission["order"]] == ["Ada", "Car_9", "Car_10"]


def test_a_robot_that_was_there_before_is_shown_with_what_it_does(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(2)
    with TeamView(field.middleware, field.scheduler) as late:
        field.run(8)
        (found,) = late._packer.state.robots.values()
        assert [token["element"] for token in found.tokens.values()] == ["Sign"]
        assert len(found.active) == 1


def test_a_page_that_was_open_before_gets_what_a_robot_already_did(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(20)
    with TeamView(field.middleware, field.scheduler) as late:
        known, _ = late.news(None)
        field.run(8)
        _, news = late.news(known)
        (block,) = [one["block"] for one in news if one["type"] == "data"]
        assert block["key"]["tokens"]
        assert block["start"] > 20 * SECOND  # the axis of the page begins here


def test_a_second_robot_joins_while_the_first_is_watched(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    field.engine("DINGO")
    field.run(1)
    field.deploy("DINGO")
    field.run(8)
    assert field.waiting() == {("REX", "Sign"), ("DINGO", "Sign")}
    field.engines.pop(0).close()
    field.run(5)
    assert ("DINGO", "Sign") in field.waiting()


def test_each_robot_has_the_pool_of_its_own_model(field: Field) -> None:
    for name in ("REX", "DINGO"):
        pool = f'<participant id="{name}_pool" name="{name}" processRef="{name}_process"/>'
        start = f'<process id="{name}_process"><startEvent id="{name}_start"/></process>'
        field.engine(name)
        field.run(1)
        field.deploy(name, document(f'<collaboration id="C">{pool}</collaboration>{start}'))
        field.run(2)
    mission = field.view.mission()
    pools = {robot["name"]: mission["elements"][robot["pool"]]["id"] for robot in mission["robots"]}
    assert pools == {"REX": "REX_pool", "DINGO": "DINGO_pool"}


def named(text: str, name: str) -> str:
    return text.replace('name="Sign"', f'name="{name}"')


def shown(view: TeamView | Replay) -> dict[str, str]:
    """Robots and the names of the elements at which the page shows their tokens."""
    packer = view._packer
    elements, key = packer.catalogue.elements_json(), packer.key_json()
    found = {packer.robots[robot]: elements[element].get("name", "") for robot, _, _, element, *_ in key["tokens"]}
    for robot, tokens in key["waits"]:
        for token in tokens:
            assert elements[token["e"]].get("name", "") == found[packer.robots[robot]]
    return found


def test_robots_whose_models_have_the_same_ids_are_each_at_their_own_elements(field: Field) -> None:
    for name in ("REX", "DINGO"):
        field.engine(name)
        field.run(1)
        field.deploy(name, named(SIGNING, f"{name} signs"))
        field.run(2)
    assert shown(field.view) == {"REX": "REX signs", "DINGO": "DINGO signs"}


def test_a_model_that_was_changed_and_deployed_again_is_the_one_that_is_shown(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    for name in ("first", "second", "first"):
        field.deploy("REX", named(SIGNING, name))
        field.run(2)
        assert shown(field.view) == {"REX": name}


@pytest.fixture
def redeployed(field: Field, tmp_path: Path) -> Path:
    """The recording of two robots, one of which gets three models with the same ids, 2 s after each other."""
    text = SIGNING.replace("</definitions>", f"{DIAGRAM}</definitions>")
    for name in ("REX", "DINGO"):
        field.engine(name)
    with (
        (tmp_path / "run.mcap").open("wb") as stream,
        TeamRecorder(field.middleware, field.scheduler, lambda: RecordingFile(stream)),
    ):
        field.run(1)
        for robot, name in (("REX", "first"), ("DINGO", "another"), ("REX", "second"), ("REX", "first")):
            field.deploy(robot, named(text, name))
            field.run(2)
    return tmp_path / "run.mcap"


def test_the_page_draws_the_model_that_a_robot_ran_then(chromium: Browser, redeployed: Path) -> None:
    with Replay(redeployed) as replay:
        replay.wait()
        with opened(chromium, replay) as page:
            rex = "fame.mission.robots.findIndex((one) => one.name === 'REX')"
            page.evaluate(f"fame.select({{robot: {rex}}})")
            for second, name in ((2, "first"), (6, "second"), (8, "first"), (6, "second")):
                page.evaluate(f"fame.player.seek({second}e9 - 1)")
                until(page, f"fame.diagram.sheet.textContent.includes('{name}')")


def test_a_recording_shows_each_robot_in_the_model_that_it_ran_then(redeployed: Path, tmp_path: Path) -> None:
    merge([redeployed], tmp_path / "merged.mcap")
    for path in (tmp_path / "run.mcap", tmp_path / "merged.mcap"):
        with Recording(path) as recording:
            models, runs = recording.models, recording.runs
        ran = {robot: [named_in(models[name]) for _, _, (name,) in each] for robot, each in runs.items()}
        assert ran == {"REX": ["first", "second", "first"], "DINGO": ["another"]}
        with Replay(path) as replay:
            replay.wait()
            elements = replay.catalogue.elements_json()
            entered = [
                elements[element]["name"]
                for block in replay._packer.blocks
                for element, what in zip(block.columns["e"], block.columns["w"], strict=True)
                if what == ENTER and elements[element]["tag"] == "userTask"
            ]
            assert entered == ["first", "another", "second", "first"]
            assert shown(replay) == {"REX": "first", "DINGO": "another"}
            for second, name in ((2, "first"), (4, "first"), (6, "second"), (8, "first")):
                waits = waiting_at(replay, second * SECOND - 1)["REX"]
                assert {elements[token["e"]]["name"] for token in waits} == {name}, second


def waiting_at(replay: Replay, time: int) -> dict[str, list[dict[str, Any]]]:
    """The waiting tokens of each robot at a time (ns), as the page gets them before everything is read."""
    block = replay.at(time)
    known = {robot: {token["key"]: token for token in tokens} for robot, tokens in block["key"]["waits"]}
    for when, robot, tokens, gone in block["waits"]:
        if when <= time:
            waits = known.setdefault(robot, {})
            waits.update((token["key"], token) for token in tokens)
            for key in gone:
                waits.pop(key, None)
    return {replay._packer.robots[robot]: list(waits.values()) for robot, waits in known.items()}


def named_in(source: bytes) -> str:
    return next(name for name in ("first", "second", "another") if f'name="{name}"'.encode() in source)


def test_a_robot_that_was_migrated_is_shown_in_its_new_model() -> None:
    def team(first: str, then: str) -> str:
        tasks = f'<userTask id="first" name="{first}"/><userTask id="then" name="{then}"/>'
        pool = '<participant id="pool" name="REX" processRef="p"/>'
        inside = process_of("p", f'<startEvent id="s"/>{tasks}', ("s", "first"), ("first", "then"))
        return definitions(f'<collaboration id="C">{pool}</collaboration>', inside)

    field = DeploymentField("REX")
    with TeamView(field.middleware, field.scheduler) as view:
        field.deploy(team("old", "old too"))
        assert shown(view) == {"REX": "old"}
        field.deploy(team("new", "new too"), "d2", 2, migrate=True)
        assert shown(view) == {"REX": "new"}
        field.engines["REX"].running.complete("first")
        field.pass_time(2)
        assert shown(view) == {"REX": "new too"}
        assert replayed(view._packer.blocks[-1])["tokens"] == view._packer.key_json()["tokens"]


def test_a_robot_that_has_left_is_named_until_it_is_back(field: Field) -> None:
    for name in ("REX", "DINGO"):
        field.engine(name)
        field.run(1)
        field.deploy(name)
    field.run(3)
    known, _ = field.view.news(None)
    assert field.view.mission()["notices"] == []
    field.engines.pop(0).close()
    field.run(2)
    assert field.view.mission()["notices"] == ["REX has left the network: what it did last is shown"]
    assert {"type": "reload", "version": field.view.mission()["version"]} in field.view.news(known)[1]
    field.engine("REX")
    field.run(2)
    assert field.view.mission()["notices"] == []


def test_a_robot_of_an_older_fame_is_lost_and_a_line_says_what_to_update(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    field.engine("REX")
    field.run(1)
    known, _ = field.view.news(None)
    monkeypatch.setattr("fame.robot.live.PROTOCOL", 1)
    field.deploy("REX")
    field.run(2)
    (notice,) = field.view.mission()["notices"]
    assert notice.startswith("events of REX are not read: REX runs an older FAME (protocol 1)")
    assert "update REX" in notice
    assert list(field.view._lost()) == ["REX"]
    assert {"type": "reload", "version": field.view.mission()["version"]} in field.view.news(known)[1]


def test_a_robot_whose_engine_restarted_without_its_mission_is_lost_and_waits_for_nobody(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    assert field.waiting() == {("REX", "Sign")}
    field.engines.pop(0).close()
    field.engine("REX")
    field.run(8)
    assert field.waiting() == set()
    assert field.view._packer.key_json()["tokens"] == []
    assert list(field.view._lost()) == ["REX"]
    assert field.view.mission()["notices"] == ["REX: its engine restarted; its mission is lost"]
    assert field.view._running("REX") == ""
    told = [str(detail) for block in field.view._packer.blocks for detail in block.details.values()]
    assert "its engine restarted; its mission is lost" in told
    field.deploy("REX")
    field.run(2)
    assert field.waiting() == {("REX", "Sign")}
    assert (field.view._lost(), field.view.mission()["notices"]) == ({}, [])


def test_a_robot_on_the_network_has_its_battery_and_is_lost_if_it_says_nothing_for_five_seconds(field: Field) -> None:
    field.engine("REX")
    battery = field.middleware.node("base").publisher("/REX/battery_state", "sensor_msgs/msg/BatteryState")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    battery.publish(messages.create("sensor_msgs/msg/BatteryState", {"percentage": 0.4}))
    field.run(1)
    assert field.view._charges == {"REX": 0.4}
    field.engines[0].status.close()
    field.run(4)
    assert field.view._lost() == {}
    field.run(2.5)
    assert list(field.view._lost()) == ["REX"]


def test_time_goes_on_with_the_clock_of_the_world_while_nothing_happens(field: Field) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    clock = field.middleware.node("world").publisher(CLOCK, CLOCK_TYPE, CLOCK_QOS)
    known, end = field.view.news(None)[0], field.view._packer.end
    clock.publish(clock_message(end + 30 * SECOND))
    field.run(0.1)
    (news,) = field.view.news(known)[1]
    assert news["time"] == field.view.mission()["end"] == pytest.approx(end + 29.5 * SECOND, abs=SECOND)


def test_the_page_only_shows_unless_it_is_told_otherwise(field: Field) -> None:
    assert field.view.mission()["control"] == []
    with pytest.raises(FameError, match="fame view --control"):
        field.view.control({"do": "complete", "robot": "REX", "element": "Sign"})


def test_with_control_a_task_of_a_running_robot_is_completed() -> None:
    field = Field(WallScheduler(), control=True)
    field.engine("REX")
    field.run(0.2)
    field.deploy("REX")
    field.until(lambda: field.waiting() == {("REX", "Sign")})
    said: list[Any] = []

    def ask() -> None:
        said.append(field.view.control({"do": "complete", "robot": "REX", "element": "Sign", "value": '{"by": "Ada"}'}))
        field.scheduler.stop()

    thread = threading.Thread(target=ask)
    thread.start()
    field.run(20)
    thread.join(10)
    field.until(lambda: field.waiting() == {("REX", "Rest")})
    assert said == [{"said": "REX: completed"}]
    field.close()


REPAIRED = process("""
  <startEvent id="Start"><outgoing>f0</outgoing></startEvent>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Drive" />
  <scriptTask id="Drive" scriptFormat="python"><incoming>f0</incoming><outgoing>f1</outgoing>
    <script>left = 10 / speed</script></scriptTask>
  <sequenceFlow id="f1" sourceRef="Drive" targetRef="Sign" />
  <userTask id="Sign"><incoming>f1</incoming><outgoing>f2</outgoing></userTask>
  <sequenceFlow id="f2" sourceRef="Sign" targetRef="Rest" />
  <userTask id="Rest"><incoming>f2</incoming></userTask>""")


def asked_of(field: Field, commands: list[dict[str, Any]]) -> list[Any]:
    """The answers to what a page asks for in a thread of its own: objects, or the texts of errors."""
    answers: list[Any] = []

    def ask() -> None:
        for command in commands:
            try:
                answers.append(field.view.control(command))
            except FameError as error:
                answers.append(str(error))
        field.scheduler.stop()

    thread = threading.Thread(target=ask)
    thread.start()
    field.run(20)
    thread.join(10)
    return answers


def test_with_control_an_element_is_retried_a_variable_set_a_token_moved() -> None:
    field = Field(WallScheduler(), control=True)
    field.engine("REX", hold_errors=True)
    field.run(0.2)
    field.deploy("REX", REPAIRED)
    field.until(lambda: field.waiting() == {("REX", "Drive")})
    (robot,) = field.view._packer.state.robots.values()
    assert [token["kind"] for token in robot.tokens.values()] == ["incident"]
    commands = [
        {"do": "retry", "element": "Drive", "value": '{"speed": 4}'},
        {"do": "set", "name": "load", "value": "2.5"},
        {"do": "move", "element": "Sign", "to": "Rest"},
    ]
    answers = asked_of(field, [{"robot": "REX", **command} for command in commands])
    assert answers == [
        {"said": "REX: retried"},
        {"said": "REX: set: load; not a variable before: load"},
        {"said": "REX: moved"},
    ]
    field.until(lambda: field.waiting() == {("REX", "Rest")})
    (robot,) = field.view._packer.state.robots.values()
    values = {name: value for scope in robot.scopes.values() for name, value in scope.values.items()}
    assert values == {"speed": 4, "left": 2.5, "load": 2.5}
    for wrong, text in (({"do": "set"}, "name of a variable"), ({"do": "move", "element": "Rest"}, "token moves to")):
        with pytest.raises(FameError, match=text):
            field.view.control({"robot": "REX", **wrong})
    field.close()


def test_with_control_a_robot_is_taken_over_steered_and_given_back() -> None:
    field = Field(WallScheduler(), control=True)
    field.engine("REX")
    twists: list[Any] = []
    outside = field.middleware.node("base")
    outside.subscription("/REX/cmd_vel_manual", "geometry_msgs/msg/Twist", twists.append)
    field.run(0.2)
    field.deploy("REX")
    field.until(lambda: field.waiting() == {("REX", "Sign")})
    asked = {"robot": "REX", "lease": "1", "who": "ann"}
    commands = [
        {"do": "take_over", **asked},
        {"do": "steer", **asked, "speed": 0.4, "turn": -1},
        {"do": "steer", **asked, "lease": "2", "speed": 9, "turn": 0},
        {"do": "take_over", **asked, "who": "bob", "lease": "2"},
        {"do": "note", "robot": "REX", "text": "take_over refused, asked for", "who": "eve"},
        {"do": "continue", **asked},
        {"do": "steer", **asked, "speed": 1, "turn": 0},
    ]  # fmt: skip

    not_held = "this page does not steer REX: take over first"
    assert asked_of(field, commands) == [
        {"said": "REX: taken over", "steers": True}, {}, not_held,
        "REX refused: REX: ann (unverified) steers it; fame suspend stops it", {"said": "REX: noted"},
        {"said": "REX: continued"}, not_held,
    ]  # fmt: skip
    field.until(
        lambda: (
            "take_over refused, asked for by eve (unverified)"
            in {str(detail) for block in field.view._packer.blocks for detail in block.details.values()}
        )
    )
    assert [(twist.linear.x, twist.angular.z) for twist in twists] == [(0.4, -1.0)]
    field.close()


def test_people_retry_set_and_move_with_the_buttons_of_the_page(chromium: Browser) -> None:
    field = Field(WallScheduler(), control=True)
    field.engine("REX", hold_errors=True)
    field.run(1)
    field.deploy("REX", REPAIRED)
    thread = threading.Thread(target=field.run, args=(600,))
    thread.start()
    try:
        with opened(chromium, field.view, has_touch=True) as page:
            waits = "[...fame.state.waits.get(0).values()].map((one) => one.element).join()"
            page.get_by_role("button", name="Set and retry").tap()
            page.get_by_label("Other variables").fill("speed = 4")
            page.locator("dialog").get_by_role("button", name="Retry").tap()
            until(page, f"{waits} === 'Sign'")
            page.get_by_role("button", name="Set", exact=True).tap()
            page.get_by_label("Name").fill("load")
            page.get_by_label("Value").fill("2.5")
            page.get_by_label("Value").press("Enter")
            until(page, "[...fame.state.variables.values()].some((one) => one.values.get('load')?.[0] === 2.5)")
            page.get_by_role("button", name="Move").tap()
            page.locator("dialog select").select_option(label="Rest")
            page.get_by_role("button", name="Move", exact=True).tap()
            until(page, f"{waits} === 'Rest'")
    finally:
        field.scheduler.stop()
        thread.join(60)
        field.close()


def test_a_robot_of_whose_instances_one_failed_is_failed_whatever_completed_after_it(
    chromium: Browser, field: Field
) -> None:
    field.engine("REX")
    field.run(1)
    field.deploy("REX", TWICE)
    field.run(1.5)
    assert [ends[:-1] for ends in field.view._packer.key_json()["ends"]] == [[0, 1, 1, "failed"]]
    field.run(3)
    assert [ends[:-1] for ends in field.view._packer.key_json()["ends"]] == [[0, 2, 1, "completed"]]
    with TeamView(field.middleware, field.scheduler) as late:
        field.run(8)
        assert late._packer.blocks[-1].key["ends"] == [[0, 2, 1, "completed", -1]]
        for view in (field.view, late):
            with opened(chromium, view, tab="team") as page:
                until(page, "fame.team.rows.length === 1")
                assert page.locator(".robot .state").inner_text().split("\n") == [
                    "failed",
                    "waits for Bad or Good",
                    "1 of 2 instances failed",
                ]
                shot(page, "failed")
                assert violations(page) == []
    field.deploy("REX")
    field.run(2)
    assert field.view._packer.key_json()["ends"] == []


def test_a_page_that_is_opened_shows_nothing_of_an_earlier_instant(
    chromium: Browser, field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While its diagram is on its way, it does not know yet which instant its address names."""
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    plane, comes = field.view.plane, threading.Event()
    comes.set()
    monkeypatch.setattr(field.view, "plane", lambda number: (comes.wait(60), plane(number))[1])
    with opened(chromium, field.view, tab="team") as page:
        comes.clear()
        page.reload()
        until(page, "fame.store.blocks[0].data")
        frames(page)
        assert page.evaluate("[fame.team.rows.length, fame.state]") == [0, None]
        comes.set()
        until(page, "fame.team.rows.length === 1")
        assert page.evaluate("fame.team.shown > fame.store.start")


def test_the_page_says_that_nothing_comes_any_more_though_its_connection_is_open(
    chromium: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = threading.Event()
    field = Field(Scheduler())
    field.engine("REX")
    field.run(1)
    field.deploy("REX")
    field.run(3)
    try:
        with opened(chromium, field.view, tab="team") as page:
            page.wait_for_timeout(6000)  # nothing new, but beats
            becomes(page, "document.querySelector('#chips').innerText", "live")
            monkeypatch.setattr(
                field.view, "news", lambda known: (goes_on.wait(60), TeamView.news(field.view, known))[1]
            )
            until(page, "document.getElementById('top').classList.contains('gone')")
            shot(page, "gone")
            assert "The page shows the last state" in page.locator("#notices").inner_text()
            assert "The page shows the last state" in page.locator("#toast").inner_text()
            assert page.locator("#chips").inner_text() == "not live"
            assert beyond(page) == []
            assert violations(page) == []
            goes_on.set()
            until(page, "!document.getElementById('top').classList.contains('gone')")
            assert page.locator("#chips").inner_text() == "live"
            assert page.locator("#notices").inner_text() == ""
    finally:
        goes_on.set()
        field.close()


def test_a_recording_with_lost_batches_goes_on_from_the_next_key(field: Field, tmp_path: Path) -> None:
    with (tmp_path / "gap.mcap").open("wb") as stream:
        file = RecordingFile(stream)
        node = field.middleware.node("watcher")
        with LiveTeam(node, field.middleware, field.scheduler, file.put) as team:
            field.engine("REX")
            field.run(1)
            field.deploy("REX", COUNTING)
            field.run(2)
            (source,) = team._sources.values()
            source.batch -= 3  # as if three batches had not come
            field.run(10)
        file.finish()
    with Replay(tmp_path / "gap.mcap") as source:
        source.wait()
        found = source._packer
        (state,) = found.state.robots.values()
        assert state.tokens.keys() == team.state.robots["REX"].tokens.keys()
        assert len(state.active) == 1
        lost = [detail for block in found.blocks for detail in block.details.values() if "lost" in str(detail)]
        assert len(lost) == 1
        assert "batches of events lost" in lost[0]


@pytest.mark.processes
def test_the_page_shows_a_team_in_many_processes(chromium: Browser) -> None:
    words = [sys.executable, "-m", "fame"]
    viewer = subprocess.Popen([*words, "view", "--no-open"], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    team = subprocess.Popen(
        [*words, "run", "examples/ground_vehicles.yaml", "--middleware", "dds", "--duration", "60", "--quiet"],
        cwd=ROOT,
    )
    try:
        assert viewer.stdout is not None
        page = chromium.new_page()
        page.set_default_timeout(60_000)
        page.goto(viewer.stdout.readline().strip())
        until(page, "window.fame && fame.mission.robots.length === 2")
        until(page, "fame.mission.planes.some((one) => one.title.includes('REX') || one.file.includes('ground'))")
        until(page, "fame.state && [...fame.state.tokens.values()].some((one) => one.r === 0 || one.r === 1)")
        until(page, "fame.state.poses.size === 2")
        page.close()
    finally:
        for each in (team, viewer):
            each.terminate()
            each.communicate(timeout=60)
