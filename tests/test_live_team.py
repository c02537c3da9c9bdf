"""A team in many processes is followed and recorded: what the engines tell gives the same recording as one process."""

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from datetime import timedelta
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from fame.clock import EPOCH, SECOND, Scheduler, date_text
from fame.closing import Closing
from fame.deploy import STATUS_QOS, EngineNode, Report
from fame.deploy.options import EngineOptions
from fame.log import Recording
from fame.log.channels import CLOCKS, EVENTS, KEY, VARIABLES, WAITING
from fame.log.live_team import LiveTeam, _Source
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.robot.journal import StateDirectory
from fame.robot.robot_state import RobotState
from fame.version import PROTOCOL
from tests.bpmn_text import process

COUNTING = process("""
  <startEvent id="Start"><outgoing>f0</outgoing></startEvent>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Count" />
  <scriptTask id="Count" scriptFormat="python"><incoming>f0</incoming><incoming>f2</incoming><outgoing>f1</outgoing>
    <script>n = globals().get('n', 0) + 1
seen = [n]</script></scriptTask>
  <sequenceFlow id="f1" sourceRef="Count" targetRef="Wait" />
  <intermediateCatchEvent id="Wait" name="a moment"><incoming>f1</incoming><outgoing>f2</outgoing>
    <timerEventDefinition id="t"><timeDuration>PT0.1S</timeDuration></timerEventDefinition></intermediateCatchEvent>
  <sequenceFlow id="f2" sourceRef="Wait" targetRef="Count" />""")


class Field(Closing):
    """Engines, a watcher and what it is told, on local topics and one simulated clock."""

    def __init__(self, scheduler: Scheduler | None = None) -> None:
        self.scheduler = Scheduler() if scheduler is None else scheduler  # one with nothing to do is false
        self.middleware = LocalMiddleware(self.scheduler)
        self.engines: list[EngineNode] = []
        self.told: list[tuple[str, int, Any]] = []

    def close(self) -> None:
        for engine in self.engines:
            engine.close()
        self.middleware.close()

    def engine(self, name: str, **options: Any) -> EngineNode:
        engine = EngineNode(
            name, scheduler=self.scheduler, middleware=self.middleware, options=EngineOptions(**options)
        )
        self.engines.append(engine)
        return engine

    def deploy(self, name: str, text: str = COUNTING) -> None:
        node = self.middleware.node("sender")
        publisher = node.publisher(f"/{name}/bpmn_process", "std_msgs/msg/String")
        publisher.publish(messages.create("std_msgs/msg/String", text))

    def watch(self) -> LiveTeam:
        return LiveTeam(
            self.middleware.node("watcher"), self.middleware, self.scheduler, lambda *told: self.told.append(told)
        )

    def run(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def watch_mission(self, seconds: float = 2) -> LiveTeam:
        """Start REX, watch it, and let it count for some seconds."""
        self.engine("REX")
        team = self.watch()
        self.run(1)
        self.deploy("REX")
        self.run(seconds)
        return team


@pytest.fixture
def field() -> Iterator[Field]:
    with Field() as found:
        yield found


def test_who_watches_from_the_beginning_is_told_every_event(field: Field) -> None:
    team = field.watch_mission(5)
    team.close()
    marks = [
        mark for topic, _, data in field.told if topic == EVENTS for each in data["events"] for mark in each["marks"]
    ]
    assert marks[0] == ["P", "start"]
    counted = Counter(mark[0] for mark in marks if mark[1] == "leave")
    running = field.engines[0].running
    assert running is not None
    visits = running.instances[0].visits
    assert 35 < counted["Count"] <= visits["Count"]
    assert team.state.robots["REX"].marks_of("Count")["leave"] == counted["Count"]
    assert not team.gaps


def test_tokens_wait_since_a_time_of_the_teams_clock(field: Field) -> None:
    team = field.watch()
    for name, ahead in (("REX", 0), ("DINGO", 100)):
        field.engine(name, epoch=EPOCH + timedelta(seconds=ahead))
        field.run(1)
        field.deploy(name)
        field.run(1)
    late = field.watch()  # gets keys first
    field.run(6)
    team.close()
    late.close()
    for state in (team.state, late.state):
        waits = {
            name: token["since"] // SECOND for name, robot in state.robots.items() for token in robot.tokens.values()
        }
        assert abs(waits["DINGO"] - waits["REX"] - 100) <= 1


def test_who_comes_later_gets_everything_first(field: Field) -> None:
    field.engine("REX")
    field.deploy("REX")
    field.run(5)
    team = field.watch()
    field.run(3)
    team.close()
    assert field.told[0][0] == KEY
    state, running = team.state.robots["REX"], field.engines[0].running
    assert running is not None
    assert state.marks_of("Count")["leave"] == running.instances[0].visits["Count"]
    (scope,) = state.scopes.values()
    assert scope.values["n"] == running.instances[0].variables["n"]
    (token,) = state.tokens.values()
    assert (token["element"], token["kind"]) == ("Wait", "timer")


def test_an_engine_that_nobody_watches_tells_nothing(field: Field) -> None:
    engine = field.engine("REX")
    field.deploy("REX")
    published: list[str] = []
    field.middleware.tap(lambda publisher: published.append if publisher.topic.endswith("bpmn_events") else None)
    field.run(5)
    assert not published
    team = field.watch()
    field.run(2)
    assert 5 < len(published) <= 2 * 20 + 1
    team.close()
    field.run(1)
    told = len(published)
    field.run(2)
    assert len(published) == told
    assert engine.state == "running"


def test_lost_batches_are_counted_and_the_next_key_mends_the_state(field: Field) -> None:
    team = field.watch_mission()
    subscription = next(
        end
        for node in field.middleware.nodes
        for end in node.endpoints
        if node.name == "watcher" and getattr(end, "topic", "") == "/REX/bpmn_events"
    )
    on_message, dropped = subscription._callback, 0  # type: ignore[union-attr]

    def drop(message: object) -> None:
        nonlocal dropped
        dropped += 1
        if dropped > 3:
            on_message(message)

    subscription._callback = drop  # type: ignore[union-attr]
    field.run(10)
    team.close()
    assert team.gaps == {"REX": 3}
    assert [data["gaps"] for topic, _, data in field.told if topic == KEY and "gaps" in data] == [{"REX": 3}]
    reports = [str(data) for topic, _, data in field.told if topic == EVENTS and "'report'" in str(data)]
    assert ["3 batches of events lost" in text for text in reports] == [True]
    running = field.engines[0].running
    assert running is not None
    assert team.state.robots["REX"].marks_of("Count")["leave"] == running.instances[0].visits["Count"]


def test_who_was_cut_off_and_comes_back_misses_nothing_unseen(field: Field) -> None:
    team = field.watch_mission()
    node = next(node for node in field.middleware.nodes if node.name == "watcher")
    subscription = next(end for end in node.endpoints if getattr(end, "topic", "") == "/REX/bpmn_events")
    subscription.close()
    field.run(3)
    node.subscription("/REX/bpmn_events", "std_msgs/msg/String", subscription._callback)  # type: ignore[union-attr]
    field.run(3)
    team.close()
    assert 1 <= team.gaps["REX"] <= 5
    running = field.engines[0].running
    assert running is not None
    assert team.state.robots["REX"].marks_of("Count")["leave"] == running.instances[0].visits["Count"]


def test_a_new_process_begins_anew(field: Field) -> None:
    team = field.watch_mission()
    field.deploy("REX", COUNTING.replace('id="Count"', 'id="Again"').replace('Ref="Count"', 'Ref="Again"'))
    field.run(2)
    team.close()
    state = team.state.robots["REX"]
    assert not state.marks_of("Count")
    assert state.marks_of("Again")["leave"] > 10


def test_simulated_time_that_begins_again_goes_on_from_the_last_time(field: Field) -> None:
    """A simulation is started again: its robots have other sessions, and their time begins at 0."""
    team, last = field.watch(), 0
    for session in (1, 2):
        for number, time in enumerate((2 * SECOND, 9 * SECOND, 10 * SECOND)):
            change = ["events", time, {"robot": "REX", "events": []}]
            batch = {"epoch": date_text(EPOCH), "session": session, "batch": number, "time": time, "changes": [change]}
            batch["protocol"] = PROTOCOL
            team._take("REX", team._sources.setdefault("REX", _Source()), batch | ({} if number else {"begins": "P"}))
            field.run(1)
        times = [time for topic, time, _ in field.told if topic == EVENTS]
        assert [round((later - times[0]) / SECOND, 3) for later in times[-3:]] == [last + one for one in (0, 7, 8)]
        last = 8
    team.close()


def test_a_team_recorder_writes_a_recording(field: Field, tmp_path: Path) -> None:
    field.engine("REX")
    field.engine("DINGO")
    with (
        (tmp_path / "run.mcap").open("wb") as stream,
        TeamRecorder(field.middleware, field.scheduler, lambda: RecordingFile(stream)),
    ):
        field.run(1)
        field.deploy("REX")
        field.run(1)
        field.deploy("DINGO")
        field.run(3)
    with Recording(tmp_path / "run.mcap") as recording:
        assert recording.robots == ["DINGO", "REX"]
        assert recording.models.keys() == {"REX.bpmn", "DINGO.bpmn"}
        times = [message.time for message in recording.messages()]
        assert times == sorted(times)
        last = recording.state(recording.end)
        for robot in recording.robots:
            events = [event for event in recording.events(robots=[robot]) if event.what == "leave"]
            counts = Counter(event.element for event in events)
            recorded = chain.from_iterable(each.items() for each in last.robots[robot].counts.values())
            assert counts == {id: each["leave"] for id, each in recorded if "leave" in each}
        assert {message.topic for message in recording.messages()} == {EVENTS, VARIABLES, WAITING, KEY, CLOCKS}


def test_what_is_no_batch_is_ignored(field: Field) -> None:
    node = field.middleware.node("stranger", "REX")
    publisher = node.publisher("bpmn_events", "std_msgs/msg/String")
    team = field.watch()
    field.run(1)
    for text in (
        "",
        "[]",
        "{}",
        '{"epoch": 1}',
        '{"epoch":"1970-01-01T00:00:00Z","session":1,"batch":"x","changes":[]}',
    ):
        publisher.publish(messages.create("std_msgs/msg/String", text))
    field.run(1)
    assert not field.told
    team.close()


def test_a_change_that_cannot_be_recorded_is_said(field: Field) -> None:
    notes: list[str] = []
    node = field.middleware.node("watcher")
    team = LiveTeam(node, field.middleware, field.scheduler, lambda *told: field.told.append(told), note=notes.append)
    robot = field.middleware.node("/REX/fame_engine").publisher("/REX/bpmn_events", "std_msgs/msg/String")
    field.run(1)
    batch = {"robot": "REX", "session": 1, "batch": 1, "epoch": date_text(EPOCH), "time": 0, "begins": "P"}
    changes = [["variables", 0, {"robot": "REX", "changes": 1}]] * 2
    robot.publish(
        messages.create("std_msgs/msg/String", json.dumps({**batch, "protocol": PROTOCOL, "changes": changes}))
    )
    field.run(1)
    team.close()
    assert len(notes) == 1
    assert notes[0].startswith("something that a robot reported cannot be recorded (TypeError")
    assert notes[0].endswith("is it of another build of FAME, though of the same protocol?")


RESTARTED = "its engine restarted; its mission is lost"


def reports_of(field: Field) -> list[str]:
    """What was told of robots besides their events."""
    marks = [
        mark for topic, _, data in field.told if topic == EVENTS for each in data["events"] for mark in each["marks"]
    ]
    return [str(mark[2]) for mark in marks if mark[1] == "report"]


def test_a_mission_is_lost_with_its_engine_though_another_one_has_its_name(field: Field) -> None:
    team = field.watch_mission()
    assert team.state.robots["REX"].tokens
    field.engines.pop(0).close()
    field.engine("REX")
    field.run(8)
    assert reports_of(field) == [RESTARTED]
    assert list(team.restarted) == ["REX"]
    state = team.state.robots["REX"]
    assert state == RobotState()
    (at,) = (time for topic, time, data in field.told if topic == EVENTS and "restarted" in str(data))
    assert 5 < at / SECOND < 8  # when it was noticed, not when the last batch came
    field.deploy("REX")
    field.run(2)
    team.close()
    assert not team.restarted
    assert team.state.robots["REX"].tokens
    assert reports_of(field) == [RESTARTED]


def test_a_mission_that_another_engine_replaces_at_once_is_lost_too(field: Field) -> None:
    team = field.watch_mission()
    field.engines.pop(0).close()
    field.engine("REX")
    field.run(0.5)
    field.deploy("REX")
    field.run(2)
    team.close()
    assert reports_of(field) == [RESTARTED]
    assert team.state.robots["REX"].marks_of("Count")["leave"] < 25  # those of the new one alone
    assert not team.restarted


def test_an_engine_that_continues_its_mission_has_lost_nothing(field: Field, tmp_path: Path) -> None:
    team = field.watch()
    with closing(StateDirectory(tmp_path)) as folder:
        field.engine("REX", state=folder)
        field.run(1)
        field.deploy("REX")
        field.run(2)
        field.engines.pop(0).close()
    field.run(6)
    with closing(StateDirectory(tmp_path)) as folder:
        engine = field.engine("REX", state=folder)
        field.run(8)
        assert engine.state == "running"
        field.engines.pop(0).close()
    team.close()
    assert RESTARTED not in reports_of(field)
    assert team.state.robots["REX"].tokens
    assert not team.restarted


def test_a_second_engine_of_a_name_does_not_take_the_mission_of_the_first(field: Field) -> None:
    team = field.watch_mission()
    (engine,) = field.engines
    other = Report(robot="REX", state="waiting", born=engine.born + 1, time=9.0).to_json()
    statuses = field.middleware.node("other", "REX").publisher("bpmn_status", "std_msgs/msg/String", STATUS_QOS)
    for _ in range(8):
        statuses.publish(messages.create("std_msgs/msg/String", other))
        field.run(1)
    team.close()
    assert not reports_of(field)
    assert team.state.robots["REX"].tokens


@pytest.mark.parametrize(("said", "mend"), [({}, "update REX"), ({"protocol": PROTOCOL + 1}, "update FAME here")])
def test_a_robot_of_another_protocol_is_named_and_nothing_of_it_is_taken(
    field: Field, said: dict[str, int], mend: str
) -> None:
    notes: list[str] = []
    node = field.middleware.node("watcher")
    team = LiveTeam(node, field.middleware, field.scheduler, lambda *told: field.told.append(told), note=notes.append)
    robot = field.middleware.node("/REX/fame_engine").publisher("/REX/bpmn_events", "std_msgs/msg/String")
    field.run(1)
    for number in (1, 2):
        batch = {"robot": "REX", "session": 1, "batch": number, "epoch": date_text(EPOCH), "time": 0, "begins": "P"}
        robot.publish(messages.create("std_msgs/msg/String", json.dumps({**batch, "changes": [], **said})))
        field.run(1)
    assert len(notes) == 1
    assert notes == [*team.foreign.values()]
    assert notes[0].startswith("events of REX are not read: REX runs ")
    assert mend in notes[0]
    assert not field.told
    field.engine("REX")
    field.deploy("REX")
    field.run(2)
    team.close()
    assert not team.foreign
    assert "P" in {process for process, _ in team.state.robots["REX"].instances.values()}
