"""An engine with a state directory ends, and the next one goes on: deployment, answers, refusals, trust."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from errno import EIO, ENOSPC
from pathlib import Path
from typing import Any, BinaryIO
from unittest.mock import Mock

import pytest
from action_server import DRIVE, Server
from bpmn_text import properties
from deployment_field import Field, definitions, patrol, process

from fame.bpmn.reader import read_text
from fame.clock import EPOCH, SECOND, Scheduler
from fame.deploy import STRING, EngineNode, Envelope, model_hash
from fame.deploy.late_joiners import LateJoiners
from fame.deploy.options import DeploymentOptions
from fame.deploy.requests import AbortClient, TaskClient, TaskRequest
from fame.deploy.resumed_mission import ResumedMission
from fame.deploy.sender import Sender
from fame.engine import Engine
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.actions import ActionServer
from fame.middleware.interface import DeferredResponse
from fame.middleware.simulated_time import ClockFollower
from fame.robot.disk import File, SystemDisk
from fame.robot.journal import StateDirectory

POOL = '<collaboration id="C"><participant id="A" name="A" processRef="p"/></collaboration>'
MISSION = definitions(
    POOL,
    '<signal id="S" name="go"/><signal id="R" name="~/recovered"/>',
    process(
        "p",
        '<startEvent id="s"/><scriptTask id="t"><script>count = 1</script></scriptTask>'
        '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>'
        '<intermediateThrowEvent id="w"><signalEventDefinition signalRef="S"/></intermediateThrowEvent>'
        '<userTask id="u"/>'
        '<subProcess id="h" triggeredByEvent="true"><startEvent id="hs" isInterrupting="false">'
        '<signalEventDefinition signalRef="R"/></startEvent>'
        '<scriptTask id="k"><script>away = recovered</script></scriptTask>'
        '<sequenceFlow id="hf" sourceRef="hs" targetRef="k"/></subProcess>',
        ("s", "t"),
        ("t", "c"),
        ("c", "w"),
        ("w", "u"),
    ),
)


class FaultyDisk(SystemDisk):
    """A disk that may be full, of which files may be unreadable, and which power loss leaves as it was synced."""

    full = False
    unreadable = ""

    def __init__(self) -> None:
        self.synced: dict[Path, int] = {}

    def write(self, path: Path, *, new: bool) -> File:
        if self.full and new:
            raise OSError(ENOSPC, "No space left on device")
        file, synced = super().write(path, new=new), self.synced
        synced[path] = path.stat().st_size  # what another name had

        class Synced:
            write, truncate, close = file.write, file.truncate, file.close

            def sync(self) -> None:
                file.sync()
                synced[path] = path.stat().st_size

        return Synced()

    def lose_power(self) -> None:
        for path in filter(Path.exists, self.synced):
            os.truncate(path, self.synced[path])

    def read(self, path: Path) -> BinaryIO:
        if self.unreadable and path.name == self.unreadable:
            raise OSError(EIO, "Input/output error")
        return super().read(path)


class Durable(Field):
    """A field of one robot with a state directory."""

    robot = "A"

    def __init__(self, folder: Path, **options: Any) -> None:
        super().__init__()
        self.folder, self.options = folder, options
        self.notes: list[str] = []
        self.disk = FaultyDisk()
        self.start()
        self.listen(self.robot)

    def start(self) -> None:
        """Start an engine on the directory."""
        self.state = StateDirectory(self.folder, self.disk)
        self.add(self.robot, state=self.state, on_report=lambda event: self.notes.append(event.detail), **self.options)

    def crash(self) -> None:
        """The engine ends without a word: nothing more is written, all its endpoints are gone."""
        engine = self.engines.pop(self.robot)
        if engine.running is not None:
            runner = engine.running.runner
            for task in runner._tasks.values():
                if task.due is not None:
                    task.due.cancel()
            runner._tasks.clear()
            runner._untils.clear()
            engine.running.host.timers.close()
        engine._keeper.recorder._quiet = True
        engine._keeper.recorder.journal.close()
        engine._keeper.recorder = None
        engine.close()
        self.state.close()

    @property
    def engine(self) -> EngineNode:
        return self.engines[self.robot]


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Durable]:
    made = Durable(tmp_path / "state")
    yield made
    for engine in made.engines.values():
        engine.close()


def test_it_goes_on_where_it_was_and_says_what_it_runs(field: Durable) -> None:
    field.deploy(MISSION)
    assert field.engine.running.instances[0].waiting == ["c"]
    before = field.engine.hash
    field.crash()
    field.pass_time(20)
    field.start()
    assert (field.engine.deployed, field.engine.hash) == ("d1", before)
    field.pass_time(1)
    assert (field.engine.state, field.engine.deployed, field.engine.hash) == ("running", "d1", before)
    assert field.engine.running.instances[0].waiting == ["c"]
    assert field.variables("A")["count"] == 1
    assert field.engine.running.instances[0].visits["t"] == 1


def test_in_simulated_time_it_goes_on_when_it_knows_the_time(tmp_path: Path) -> None:
    field = Durable(tmp_path / "state")
    field.engine.close()
    field.state.close()

    def start(now: int) -> ClockFollower:
        time = ClockFollower(field.scheduler)
        field.options["time"] = time
        field.start()
        field.pass_time(0.5)
        time.on_clock(now * SECOND)
        return time

    start(100)
    timed = MISSION.replace(
        '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/>',
        '<intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT5S</timeDuration></timerEventDefinition>',
    )
    field.deploy(timed)
    field.options["time"].on_clock(101 * SECOND)
    field.crash()
    time = start(103)
    assert field.engine.state == "loading"
    field.pass_time(0.5)
    assert field.engine.state == "running"
    assert field.variables("A")["away"] == 3.0  # since the last record
    for now, waiting in ((104.9, ["c"]), (105.1, ["u"])):
        time.on_clock(round(now * SECOND))
        field.pass_time(0.1)
        assert field.engine.running.instances[0].waiting == waiting
    field.engine.close()


def test_it_raises_recovered_with_the_seconds_that_it_was_away(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    field.pass_time(20)
    field.start()
    field.pass_time(1)
    assert 20 <= field.variables("A")["away"] < 40
    assert field.engine.running.instances[0].visits["k"] == 1


def test_what_recovered_has_started_is_started_once(field: Durable) -> None:
    text = "begun = globals().get('begun', 0) + 1\nawait sleep(60)"
    field.deploy(MISSION.replace("away = recovered", text))
    field.crash()
    field.start()
    field.pass_time(2)
    assert field.variables("A")["begun"] == 1


def test_a_sender_that_stays_leaves_it_running(field: Durable) -> None:
    field.deploy(MISSION)
    sent: list[Any] = []
    field.crash()
    field.start()
    definitions = read_text(MISSION, file="team.bpmn")
    sender = Sender("test", field.scheduler, field.middleware, DeploymentOptions())
    sender.send = lambda *arguments, **more: sent.append(arguments)  # type: ignore[method-assign]
    joiners = LateJoiners(definitions, sender, supplied=["A"])
    field.pass_time(20)
    joiners.close()
    assert sent == []
    assert field.engine.running.instances[0].visits["t"] == 1


def test_the_answer_to_its_deployment_is_repeated(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    field.start()
    field.said.clear()
    field.deploy(MISSION, id="d1", sequence=1)
    assert {report.answer for report in field.said if report.deployment == "d1"} == {"started"}
    assert field.engine.running.instances[0].visits["t"] == 1


def test_a_new_deployment_takes_the_place_of_what_is_being_resumed(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    field.start()
    field.deploy(patrol(7).replace("<process", POOL + "<process", 1), id="d2", sequence=2)
    assert field.engine.deployed == "d2"
    assert field.variables("A")["mark"] == 7
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.engine.deployed, field.variables("A")["mark"]) == ("d2", 7)
    assert len(list(field.folder.glob("journal-*"))) == 1


def test_an_engine_that_is_stopped_in_order_goes_on_as_well(field: Durable) -> None:
    field.deploy(MISSION)
    field.engines.pop("A").close()
    field.state.close()
    field.start()
    field.pass_time(1)
    assert field.engine.running.instances[0].waiting == ["c"]
    field.engine.running.deliver("/go", None)
    assert field.engine.running.instances[0].waiting == ["u"]


def test_a_bare_model_is_resumed_too(field: Durable) -> None:
    field.send("A", patrol(3))
    field.pass_time(1)
    field.crash()
    field.start()
    field.pass_time(1)
    assert field.variables("A")["mark"] == 3


def test_a_mission_that_is_over_stays_over(field: Durable) -> None:
    field.deploy(MISSION)
    field.engine.running.deliver("/go", None)
    field.engine.running.complete("u")
    field.crash()
    field.start()
    field.pass_time(1)
    assert field.engine.state == "idle"
    assert (field.engine.running.completed, field.engine.running.instances[0].status) == (1, "completed")
    assert field.notes[-1] == "its mission had ended"


def test_a_model_whose_state_cannot_be_stored_is_refused(field: Durable) -> None:
    text = definitions(
        POOL,
        process(
            "p",
            '<startEvent id="s"/><scriptTask id="a"><script>def twice(x): return 2 * x</script></scriptTask>'
            '<scriptTask id="b"><script>y = twice(2)</script></scriptTask>',
            ("s", "a"),
            ("a", "b"),
        ),
    )
    refused = field.deploy(text)
    assert "defines 'twice', a function or class that later steps use" in str(refused.robots["A"])
    assert "which an engine with --state cannot store" in str(refused.robots["A"])


def test_imports_of_scripts_are_made_again(field: Durable) -> None:
    text = definitions(
        POOL,
        process(
            "p",
            '<startEvent id="s"/><scriptTask id="a"><script>import json as j\nfrom math import hypot</script>'
            "</scriptTask>"
            '<userTask id="u"/><scriptTask id="b"><script>y = j.loads("2") + hypot(3, 4)</script></scriptTask>',
            ("s", "a"),
            ("a", "u"),
            ("u", "b"),
        ),
    )
    field.deploy(text)
    field.crash()
    field.start()
    field.pass_time(1)
    field.engine.running.complete("u")
    assert field.variables("A")["y"] == 7


def test_the_state_of_another_robot_is_refused(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    with pytest.raises(ConfigError, match="is the state of robot 'A', not of 'B'"):
        field.add("B", state=StateDirectory(field.folder))


def test_a_deployment_that_was_changed_on_the_disk_is_refused(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    (path,) = field.folder.glob("deployment-*")
    path.write_bytes(path.read_bytes().replace(b"count = 1", b"count = 2"))
    with pytest.raises(ConfigError, match="is damaged, or not the deployment that the journal names"):
        field.start()


def test_with_trusted_keys_what_was_not_signed_is_refused(field: Durable, tmp_path: Path) -> None:
    ed25519 = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ed25519")
    field.deploy(MISSION)
    field.crash()
    field.options["trusted"] = [ed25519.Ed25519PrivateKey.generate().public_key()]
    with pytest.raises(ConfigError, match="not signed; this robot runs only deployments signed with a trusted key"):
        field.start()


def test_damage_is_never_a_silent_fresh_start(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    (path,) = field.folder.glob("journal-*")
    path.write_bytes(path.read_bytes()[10:])
    with pytest.raises(ConfigError, match="is not a journal of a FAME engine, or its first line is damaged"):
        field.start()


@pytest.mark.parametrize(
    ("error", "text"),
    [(OSError(ENOSPC, "No space left on device"), "No space left on device"), (MemoryError(), "no memory is left")],
)
def test_a_full_disk_or_memory_holds_the_mission_until_there_is_room(
    field: Durable, monkeypatch: pytest.MonkeyPatch, error: Exception, text: str
) -> None:
    field.deploy(MISSION)
    heard: list[Any] = []
    field.person.subscription("/go", "std_msgs/msg/Empty", heard.append)
    journal = field.engine._keeper.recorder.journal

    def full(*arguments: Any) -> None:
        raise error

    monkeypatch.setattr(journal, "append", full)
    monkeypatch.setattr(journal, "begin_segment", full)
    field.engine.running.deliver("/go", None)
    field.pass_time(3)
    assert heard == []
    assert f"holds: its state cannot be written: {text}" in field.notes
    monkeypatch.undo()
    field.pass_time(2)
    assert len(heard) == 1
    assert "continues: its state can be written again" in field.notes
    field.crash()
    field.start()
    field.pass_time(1)
    assert field.engine.running.instances[0].waiting == ["u"]


@pytest.mark.parametrize("resumed", [False, True])
def test_a_directory_that_is_removed_holds_the_mission_until_it_is_made_again(field: Durable, resumed: bool) -> None:
    field.deploy(MISSION)
    if resumed:
        field.crash()
        field.start()
        field.pass_time(1)
    shutil.rmtree(field.folder)
    field.pass_time(1.5)
    gone = f"holds: its state cannot be written: {field.folder} was removed or replaced; make it again"
    assert (field.engine.state, gone in field.notes) == ("suspended", True)
    field.pass_time(3)
    assert not field.folder.exists()
    field.folder.mkdir()
    field.pass_time(2)
    assert field.engine.state == "running"
    with pytest.raises(ConfigError, match="is in use by another engine"):
        StateDirectory(field.folder)
    field.engine.running.deliver("/go", None)
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.engine.deployed, field.engine.running.instances[0].waiting) == ("d1", ["u"])


def test_a_value_for_whose_text_there_is_no_room_holds_the_mission(
    field: Durable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With less, the library that writes the text would end the process."""
    field.deploy(MISSION)

    def full(size: int) -> None:
        raise MemoryError(size)

    monkeypatch.setattr("fame.robot.state_tables._LARGE", 9)
    monkeypatch.setattr("fame.robot.state_tables.bytearray", full, raising=False)
    field.engine.running.set_variables({"count": [2, 2]})
    field.pass_time(2)
    assert field.engine.state == "suspended"
    assert "holds: its state cannot be written: no memory is left" in field.notes
    monkeypatch.undo()
    field.pass_time(2)
    assert field.engine.state == "running"


def no_memory(engine: Engine) -> None:
    """Instead of `Engine.run`: lose the tokens that were to move."""
    if engine.ready:
        engine.ready.clear()
        raise MemoryError


def publish_go(field: Durable) -> None:
    field.person.publisher("/go", "std_msgs/msg/Empty").publish(messages.create("std_msgs/msg/Empty"))
    field.pass_time(0.5)


def test_a_step_without_memory_is_held_and_the_mission_goes_on_from_its_last_record(
    field: Durable, monkeypatch: pytest.MonkeyPatch
) -> None:
    field.deploy(MISSION)
    monkeypatch.setattr(Engine, "run", no_memory)
    monkeypatch.setattr("fame.deploy.engine_node._RESERVE", 2**62)
    publish_go(field)
    field.pass_time(3)
    assert (field.engine.state, field.said[-1].error, field.notes[-1]) == (
        "suspended",
        "no memory is left",
        "holds: no memory is left",
    )
    monkeypatch.undo()
    field.pass_time(2)
    assert (field.engine.state, field.said[-1].error, field.notes[-1]) == ("running", "", "continues its mission")
    assert (field.variables("A")["count"], field.engine.running.instances[0].waiting) == (1, ["c"])
    publish_go(field)
    assert field.engine.running.instances[0].waiting == ["u"]
    end_engine(field, in_order=False)
    assert field.engine.running.instances[0].waiting == ["u"]


def test_without_a_state_a_step_without_memory_suspends_the_mission_until_a_deployment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    field = Field("A")
    field.deploy(MISSION)
    with monkeypatch.context() as patched:
        patched.setattr(Engine, "run", no_memory)
        publish_go(field)  # type: ignore[arg-type]
    field.pass_time(3)
    text = "no memory was left in a step of its mission, which may be half done; deploy again"
    assert (field.engines["A"].state, field.said[-1].error) == ("suspended", text)
    field.deploy(MISSION, "d2", 2)
    assert (field.engines["A"].state, field.variables("A")["count"]) == ("running", 1)


def test_a_request_that_finds_no_memory_is_refused_and_not_half_done(
    field: Durable, monkeypatch: pytest.MonkeyPatch
) -> None:
    field.deploy(MISSION)
    publish_go(field)
    answered: list[Any] = []
    asked = TaskRequest(id="r", element="u")
    with monkeypatch.context() as patched:
        patched.setattr(Engine, "run", no_memory)
        client = TaskClient("A", asked, node=field.person, scheduler=field.scheduler, answered=answered.append)
        field.pass_time(3)
        client.close()
    field.pass_time(2)
    said = [(report.answer, report.reason) for report in answered]
    assert said == [("refused", "no memory is left, and its mission is held")]
    assert field.engine.running.instances[0].waiting == ["u"]


def test_what_does_not_reach_the_disk_at_the_end_is_reported(field: Durable, monkeypatch: pytest.MonkeyPatch) -> None:
    field.deploy(MISSION)
    recorder = field.engine._keeper.recorder

    def full(*arguments: Any) -> None:
        raise OSError(ENOSPC, "No space left on device")

    monkeypatch.setattr(recorder.journal, "append", full)
    recorder.note("the last change")
    recorder.close()
    said = "its last changes are not on the disk, and what they send is not sent: No space left on device"
    assert field.notes[-1] == said


def test_a_signal_leaves_when_it_is_on_the_disk_and_not_before(field: Durable, monkeypatch: pytest.MonkeyPatch) -> None:
    field.deploy(MISSION)
    order: list[str] = []
    recorder = field.engine._keeper.recorder
    file = recorder.journal._file
    sync = file.sync
    monkeypatch.setattr(file, "sync", lambda: (order.append("disk"), sync()))
    field.person.subscription("/go", "std_msgs/msg/Empty", lambda message: order.append("signal"))
    field.engine.running.deliver("/go", None)
    field.pass_time(1)
    assert order == ["disk", "signal"]


def test_a_request_is_answered_when_it_is_on_the_disk_or_the_answer_says_that_it_is_not(
    field: Durable, monkeypatch: pytest.MonkeyPatch
) -> None:
    field.deploy(MISSION)
    order: list[str] = []
    file = field.engine._keeper.recorder.journal._file
    sync = file.sync
    with monkeypatch.context() as patched:
        patched.setattr(file, "sync", lambda: (order.append("disk"), sync()))
        before = len(field.said)
        request(field, act="suspend", who="ann@desk")
        order += [report.answer for report in field.said[before:] if report.answer]
    assert order == ["disk", "suspended"]
    journal = field.engine._keeper.recorder.journal
    with monkeypatch.context() as patched:
        for name in ("append", "begin_segment"):
            patched.setattr(journal, name, Mock(side_effect=OSError(ENOSPC, "No space left on device")))
        request(field, act="continue", who="ann@desk")
        request(field, act="suspend", who="ann@desk")
        answers = [(report.answer, report.reason) for report in field.said if report.answer]
    assert answers[-1] == (
        "suspended",
        "it is lost in a crash before its state can be written: No space left on device",
    )


def test_a_signal_that_may_not_have_left_is_sent_again(field: Durable) -> None:
    field.deploy(MISSION)
    heard: list[Any] = []
    recorder = field.engine._keeper.recorder
    recorder._let_leave = lambda batch: None  # the robot ends between the disk and the network
    field.engine.running.deliver("/go", None)
    field.crash()
    field.person.subscription("/go", "std_msgs/msg/Empty", heard.append)
    field.start()
    field.pass_time(1)
    assert len(heard) == 1
    assert field.engine.running.instances[0].waiting == ["u"]
    field.crash()
    field.start()
    field.pass_time(1)
    assert len(heard) == 1


def test_messages_that_come_while_it_is_loading_are_taken_afterwards(field: Durable) -> None:
    field.deploy(MISSION)
    field.crash()
    field.start()
    field.scheduler.run(field.scheduler.now)  # loaded, and its endpoints are there
    other = field.middleware.node("other")
    publisher = other.publisher("/go", "std_msgs/msg/Empty")

    publisher.publish(messages.create("std_msgs/msg/Empty"))
    field.pass_time(1)
    assert field.engine.running.instances[0].waiting == ["u"]


FAILING = definitions(
    POOL,
    process(
        "p",
        '<startEvent id="s"/><scriptTask id="a"><script>y = 10 / x</script></scriptTask><userTask id="u"/>',
        ("s", "a"),
        ("a", "u"),
    )
    .replace('<scriptTask id="a">', '<scriptTask id="z"><script>x = 0</script></scriptTask><scriptTask id="a">', 1)
    .replace('targetRef="a"', 'targetRef="z"', 1)
    .replace("</process>", '<sequenceFlow id="za" sourceRef="z" targetRef="a"/></process>'),
)


@pytest.fixture
def holding(tmp_path: Path) -> Iterator[Durable]:
    made = Durable(tmp_path / "state", hold_errors=True)
    made.deploy(FAILING)
    yield made
    for engine in made.engines.values():
        engine.close()


def request(field: Durable, **parts: Any) -> None:
    """Somebody asks the robot for something on ``bpmn_task``."""
    text = TaskRequest(id=f"task-{field.scheduler.now}-{len(field.said)}", **{"element": "", **parts}).to_json()
    field.person.publisher("/A/bpmn_task", STRING).publish(messages.create(STRING, text))
    field.pass_time(1)


def test_an_incident_is_in_the_status_and_survives_a_crash(holding: Durable) -> None:
    report = holding.said[-1]
    assert report.state == "incident"
    assert report.incidents == [{"element": "a", "code": "script", "text": "ZeroDivisionError: division by zero"}]
    holding.crash()
    holding.start()
    holding.pass_time(2)
    assert holding.said[-1].incidents == report.incidents
    request(holding, act="retry", element="a", values={"x": 5}, who="ann@desk")
    assert (holding.said[-1].state, holding.variables("A")["y"]) == ("running", 2)


def test_repairs_are_in_the_journal_and_the_log_with_who_asked(holding: Durable) -> None:
    request(holding, act="set", values={"x": 2}, who="ann@desk")
    assert holding.said[-1].state == "incident"
    request(holding, act="retry", element="a", who="ann@desk")
    request(holding, act="move", element="u", to="a", who="bob@field")
    text = holding.engine._keeper.directory.segments()[-1].read_text()
    for note in ("set x=2 by ann@desk (unverified)", "a: retried by ann@desk (unverified)"):
        assert note in text
        assert any(note.removeprefix("a: ") in said for said in holding.notes)
    assert "u: moved to a by bob@field (unverified)" in text
    assert holding.engine.running.instances[0].visits["a"] == 2


def test_repairs_that_are_not_possible_are_refused(holding: Durable) -> None:
    request(holding, act="retry", element="u")
    assert "u: has no incident; incidents are at: a" in {report.reason for report in holding.said}
    request(holding, act="move", element="a", to="nowhere")
    assert any("nowhere: is not in the scope of a" in report.reason for report in holding.said)
    request(holding, act="fly", element="a")
    assert any(report.answer == "refused" and "no task, expected" in report.reason for report in holding.said)


def asked(field: Durable, id: str, element: str = "u", **parts: Any) -> tuple[str, str]:
    """Somebody asks the robot, perhaps again: the answer and its reason."""
    field.said.clear()
    text = TaskRequest(id=id, element=element, **parts).to_json()
    field.person.publisher("/A/bpmn_task", STRING).publish(messages.create(STRING, text))
    field.pass_time(1)
    (found,) = {(report.answer, report.reason) for report in field.said if report.deployment == id}
    return found


ROUNDS = MISSION.replace('<userTask id="u"/>', '<userTask id="u"/><sequenceFlow id="uu" sourceRef="u" targetRef="u"/>')
"""`MISSION`, whose user task waits again when it is done."""


@pytest.mark.parametrize("after", ["", "a deployment", "a deployment while it is loading", "no memory"])
def test_what_was_asked_before_a_crash_is_answered_as_before_and_not_done_again(
    field: Durable, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    field.deploy(ROUNDS)
    early = asked(field, "early")
    publish_go(field)
    answers = [early, asked(field, "one", values={"n": 1}), asked(field, "set", "", act="set", values={"m": 1})]
    assert [answer for answer, _ in answers] == ["refused", "completed", "set"]
    if after == "no memory":
        with monkeypatch.context() as patched:
            patched.setattr(Engine, "run", no_memory)
            request(field, element="u")
        field.pass_time(3)
    elif after == "a deployment while it is loading":
        field.crash()
        monkeypatch.setattr(ResumedMission, "resume", lambda self: None)
        field.start()
    else:
        end_engine(field, in_order=False)
    if "deployment" in after:
        field.deploy(ROUNDS, "d2", 2)
        publish_go(field)
    assert [asked(field, "early"), asked(field, "one", values={"n": 1}), asked(field, "set", "", act="set")] == answers
    (instance,) = [one for one in field.engine.running.instances if one.status == "running"]
    assert instance.visits["u"] == (1 if "deployment" not in after else 0)
    assert asked(field, "two") == ("completed", "")


def test_an_answer_is_in_the_record_of_what_was_done(field: Durable) -> None:
    field.deploy(ROUNDS)
    publish_go(field)
    asked(field, "one", values={"n": 1})
    found = [record.get("set", {}) for record in field.engine._keeper.directory.read().records()]
    assert [set["answers"] for set in found if "0 n" in set.get("values", {})] == [{"one": ["completed", "", ""]}]


def test_the_oldest_answers_are_forgotten_on_the_disk_too(field: Durable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.deploy.requests._ANSWERS", 2)
    field.deploy(MISSION)
    for id in ("one", "two", "three"):
        asked(field, id, "", act="note", to="hello")
    end_engine(field, in_order=False)
    assert list(field.engine._keeper.answers) == ["two", "three"]


def test_after_a_migration_it_resumes_the_new_model(field: Durable) -> None:
    field.deploy(MISSION)
    changed = MISSION.replace("count = 1", "count = 2").replace(
        '<userTask id="u"/>', '<userTask id="u"/><userTask id="v"/>'
    )
    changed = changed.replace("</process>", '<sequenceFlow id="uv" sourceRef="u" targetRef="v"/></process>')
    field.deploy(changed, "d2", 2, migrate=True)
    assert (field.engine.deployed, field.engine.running.instances[0].waiting) == ("d2", ["c"])
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.engine.deployed, field.variables("A")["count"]) == ("d2", 1)
    field.engine.running.deliver("/go", None)
    field.engine.running.complete("u")
    assert field.engine.running.instances[0].waiting == ["v"]


def test_after_a_migration_the_instances_that_are_over_are_kept(field: Durable) -> None:
    field.deploy(MISSION)
    field.engine.running.deliver("/go", None)
    field.engine.running.complete("u")
    changed = MISSION.replace('<scriptTask id="t">', '<task id="new"/><scriptTask id="t">')
    changed = changed.replace('targetRef="t"', 'targetRef="new"').replace(
        "</process>", '<sequenceFlow id="nt" sourceRef="new" targetRef="t"/></process>'
    )
    field.deploy(changed, "d2", 2, migrate=True)
    field.crash()
    field.start()
    field.pass_time(1)
    (instance,) = field.engine.running.instances
    assert (instance.status, instance.variables["count"]) == ("completed", 1)
    assert (instance.visits["t"], instance.visits["u"], instance.visits["new"]) == (1, 1, 0)


def told(field: Durable, id: str, sequence: int, model: str, *phases: str, **options: Any) -> None:
    """Send a robot the envelopes of a deployment, as a sender does."""
    loaded = {"model": model, "hash": model_hash(model.encode()), "team": ["A"], **options}
    for phase in phases:
        more = loaded if phase == "load" else {}
        field.send("A", Envelope(deployment=id, sequence=sequence, robot="A", phase=phase, **more).to_json())


def test_a_deployment_that_arrives_while_an_engine_resumes_starts(field: Durable) -> None:
    other = field.middleware.node("other")
    end = other.subscription("/x", STRING, lambda message: None)
    told(field, "d1", 1, MISSION, "load", promises={"/x": "subscriber"})
    field.pass_time(0.1)
    told(field, "d1", 1, MISSION, "start")
    field.pass_time(1)
    assert field.engine.deployed == "d1"
    end.close()
    field.crash()
    field.start()
    field.pass_time(1)
    told(field, "d2", 2, patrol(7), "load", promises={"/x": "subscriber"})
    field.pass_time(4.5)  # what ran before goes on without the other end
    assert (field.engine.deployed, field.engine.state) == ("d1", "loading")
    other.subscription("/x", STRING, lambda message: None)
    field.pass_time(0.1)
    told(field, "d2", 2, patrol(7), "start")
    field.pass_time(1)
    assert (field.engine.deployed, field.engine.state, field.variables("A")) == ("d2", "running", {"mark": 7})


def test_a_robot_that_held_when_a_newer_one_came_keeps_both_promises_across_a_crash(field: Durable) -> None:
    field.deploy(MISSION)
    told(field, "d2", 2, patrol(7), "load", team=["A", "B"])
    field.pass_time(20)
    assert field.engine.state == "holding"
    told(field, "d3", 3, patrol(8), "load", team=["A", "B"])
    field.pass_time(1)
    assert (field.engine.state, field.said[-1].candidate) == ("ready", "d3")
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.engine.state, field.said[-1].candidate) == ("ready", "d3")
    told(field, "d3", 3, "", "abort")
    field.pass_time(1)
    assert (field.engine.state, field.said[-1].candidate) == ("holding", "d2")
    told(field, "d2", 2, "", "start")  # the engine before had said that it asks
    field.pass_time(1)
    assert (field.engine.state, field.engine.deployed) == ("holding", "d1")
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="start", begun=True).to_json())
    field.pass_time(1)
    assert (field.engine.deployed, field.variables("A")) == ("d2", {"mark": 7})
    field.crash()
    field.start()
    field.pass_time(1)
    assert (field.engine.deployed, field.engine.state, field.said[-1].candidate) == ("d2", "running", "")


def test_a_robot_that_asked_the_others_takes_no_plain_start_after_a_crash(field: Durable) -> None:
    field.deploy(MISSION)
    told(field, "d2", 2, patrol(7), "load", team=["A", "B"])
    field.pass_time(8)
    ask = Envelope(deployment="d2", sequence=2, robot="A", phase="ask").to_json()
    field.send("A", ask)
    field.pass_time(0.1)
    assert field.answers()[-1] == "asking"
    field.crash()
    field.start()
    for _ in range(3):  # at once, while its mission and its promise are loaded, and after that
        told(field, "d2", 2, "", "start")
        field.send("A", ask)
        field.pass_time(0.5)
    assert {said.answer for said in field.said[-6:] if said.deployment == "d2"} <= {"asking", ""}
    assert (field.engine.state, field.engine.deployed) == ("holding", "d1")
    told(field, "d2", 2, "", "abort")
    field.pass_time(1)
    assert (field.engine.state, field.engine.deployed) == ("running", "d1")


def test_a_robot_asks_the_others_when_that_is_on_the_disk(field: Durable) -> None:
    field.deploy(MISSION)
    told(field, "d2", 2, patrol(7), "load", team=["A", "B"])
    field.pass_time(1)
    field.disk.full = True
    field.pass_time(20)
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="ask").to_json())
    field.pass_time(0.1)
    assert field.answers()[-1] == "ready"
    assert any("asks nobody: that cannot be written" in note for note in field.notes)
    field.disk.full = False
    field.pass_time(20)
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="ask").to_json())
    field.pass_time(0.1)
    assert field.answers()[-1] == "asking"


def test_a_promise_that_the_disk_refuses_is_answered_refused(field: Durable) -> None:
    field.deploy(MISSION)
    field.disk.full = True
    told(field, "d2", 2, patrol(7), "load")
    field.pass_time(1)
    answer = next(report for report in field.said if report.deployment == "d2" and report.answer)
    assert (answer.answer, "its promise cannot be written" in answer.reason) == ("refused", True)
    assert (field.engine.deployed, field.engine.state) == ("d1", "running")


def test_only_what_is_on_the_disk_is_said_to_have_started(field: Durable) -> None:
    field.deploy(MISSION)
    told(field, "d2", 2, patrol(7), "load")
    field.pass_time(1)
    field.disk.full = True
    told(field, "d2", 2, "", "start")
    told(field, "d3", 3, patrol(8), "load")
    field.pass_time(2)
    now = field.said[-1]
    assert (now.state, now.deployed, now.candidate) == ("suspended", "d1", "d2")
    assert now.error == "its state cannot be written: No space left on device"
    assert [said.answer for said in field.said if said.deployment == "d2" and said.answer] == ["ready"]
    assert [said.answer for said in field.said if said.deployment == "d3"] == ["refused"]
    answers: list[tuple[str, str]] = []
    end = AbortClient("A", node=field.person, scheduler=field.scheduler, ended=lambda *said: answers.append(said))
    field.pass_time(1)
    end.close()
    assert answers == [("ready", "it starts as soon as its state can be written")]
    field.crash()
    field.disk.full = False
    field.start()
    field.pass_time(1)
    assert (field.engine.deployed, field.said[-1].candidate, field.said[-1].state) == ("d1", "d2", "ready")
    field.disk.full = True
    told(field, "d2", 2, "", "start")
    field.pass_time(1)
    field.disk.full = False
    field.pass_time(2)
    assert (field.engine.deployed, field.engine.state, field.variables("A")) == ("d2", "running", {"mark": 7})


def test_what_began_before_an_engine_was_born_is_unknown_to_it() -> None:
    field = Field("A", "B")
    ask = Envelope(deployment="d1", sequence=1, robot="B", phase="ask", born=field.engines["B"].born - 1)
    field.send("B", ask.to_json())
    field.pass_time(0.1)
    assert field.answers() == ["unknown"]
    field.send("B", replace(ask, born=field.engines["B"].born).to_json())
    field.pass_time(0.1)
    assert field.answers() == ["unknown", "aborted"]


TIMED = MISSION.replace(
    '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/>',
    '<intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT20S</timeDuration></timerEventDefinition>',
)


def test_a_clock_set_back_during_an_outage_delays_no_timer(field: Durable) -> None:
    field.deploy(TIMED)  # 12 s
    field.crash()
    field.options["epoch"] = EPOCH - timedelta(hours=1)
    field.start()
    field.pass_time(21)
    assert field.engine.running.instances[0].waiting == ["u"]


@pytest.mark.parametrize("set_by", [3600, -3600])
@pytest.mark.parametrize("before", [True, False], ids=["before it is deployed", "while it waits"])
@pytest.mark.parametrize("dies", [True, False], ids=["killed", "without memory"])
def test_a_clock_that_is_set_while_the_engine_runs_moves_no_timer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, set_by: int, before: bool, dies: bool
) -> None:
    monkeypatch.setattr(Scheduler, "is_simulated", False)
    field = Durable(tmp_path)
    field.engine.close()
    field.state.close()
    begun = datetime.now(UTC)  # files have the true date
    clock = [begun.timestamp() - set_by]
    field.options["epoch"] = begun - timedelta(seconds=set_by)
    field.options["wall_time"] = lambda: clock[0] + field.scheduler.now / SECOND
    field.start()
    if before:
        clock[0] += set_by
    field.deploy(TIMED)
    clock[0] = begun.timestamp()
    field.pass_time(3)
    if dies:
        field.crash()
        field.options["epoch"] = begun
        field.start()
    else:
        field.engine._on_no_memory()
    field.pass_time(2)
    assert field.engine.running.instances[0].waiting == ["c"]
    assert dies or field.variables("A")["away"] < 3
    field.pass_time(15)
    assert field.engine.running.instances[0].waiting == ["u"]


def test_after_power_loss_a_robot_has_the_state_that_it_promised_to_migrate(field: Durable) -> None:
    quiet = re.sub("<intermediateThrowEvent.*?</intermediateThrowEvent>", '<task id="w"/>', TIMED)
    without_c = quiet.replace('id="c"', 'id="x"').replace('"c"', '"x"')
    field.deploy(quiet)
    field.pass_time(9)  # nothing leaves, so nothing has to be on the disk
    assert field.engine.running.instances[0].waiting == ["u"]
    told(field, "d2", 2, without_c, "load", migrate=True)
    field.pass_time(1)
    assert field.engine.state == "ready"
    field.disk.lose_power()
    field.crash()
    field.start()
    field.pass_time(1)
    told(field, "d2", 2, without_c, "start")
    field.pass_time(1)
    assert (field.engine.deployed, field.engine.running.instances[0].waiting) == ("d2", ["u"])


def test_on_a_disk_that_is_full_at_the_restart_the_mission_is_suspended_and_says_so(field: Durable) -> None:
    field.deploy(TIMED)
    field.crash()
    field.pass_time(20)
    field.disk.full, heard = True, []
    field.person.subscription("/go", "std_msgs/msg/Empty", heard.append)
    field.start()
    field.pass_time(2)
    assert (field.said[-1].state, field.said[-1].error) == (
        "suspended",
        "its state cannot be written: No space left on device",
    )
    assert not heard
    field.disk.full = False
    field.pass_time(3)
    assert (field.said[-1].state, field.said[-1].error, len(heard)) == ("running", "", 1)
    assert field.engine.running.instances[0].waiting == ["u"]


def test_a_promise_that_cannot_be_read_ends_no_engine(field: Durable) -> None:
    field.deploy(MISSION)
    told(field, "d2", 2, patrol(7), "load", team=["A", "B"])
    field.pass_time(1)
    assert field.engine.state == "ready"
    field.crash()
    field.disk.unreadable = "promise"
    field.start()
    field.pass_time(1)
    assert (field.engine.state, field.engine.deployed) == ("suspended", "d1")  # others may run what it has lost
    assert any("what it had promised to start is lost" in note for note in field.notes)
    field.send("A", Envelope(deployment="d2", sequence=2, robot="A", phase="ask", born=1).to_json())
    field.pass_time(0.1)
    assert field.answers()[-1] == "unknown"


# ---- goals -----------------------------------------------------------------------------------------------------------

DRIVES = definitions(
    POOL,
    '<signal id="S" name="go"/><signal id="R" name="~/recovered"/>',
    process(
        "p",
        '<startEvent id="s"/><endEvent id="e"/><userTask id="u"/>'
        f'<serviceTask id="t">{properties(action="drive", type=DRIVE, payload="{distance: 9}")}</serviceTask>'
        '<boundaryEvent id="b" attachedToRef="t"><signalEventDefinition signalRef="S"/></boundaryEvent>',
        ("s", "t"),
        ("t", "e"),
        ("b", "u"),
    ).replace("<extensionElements", '<extensionElements xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'),
)
REFUSED = "/A/drive: a cancelled goal still runs: its server refuses to cancel it"


@pytest.fixture
def driver(field: Durable) -> Server:
    return Server(field.middleware.node("driver", "A"))


def end_engine(field: Durable, *, in_order: bool) -> None:
    """End the engine, and start the next one."""
    if in_order:
        field.engines.pop("A").close()
        field.state.close()
    else:
        field.crash()
    field.notes.clear()
    field.start()
    field.pass_time(2)


def test_a_goal_that_was_cancelled_before_a_crash_is_followed_until_it_ends(field: Durable, driver: Server) -> None:
    driver.obeys = False
    field.deploy(DRIVES)
    field.engine.running.deliver("/go", None)
    field.pass_time(1)
    for _ in range(2):
        end_engine(field, in_order=False)
        assert (field.engine.running.runner.cancelled.texts(), field.notes.count(REFUSED)) == ([REFUSED], 1)
        assert REFUSED in field.said[-1].warnings
    driver.end(driver.cancelled[0], 4)
    field.pass_time(2)
    assert field.notes[-1] == "/A/drive: the cancelled goal has ended"
    assert REFUSED not in field.said[-1].warnings


def test_the_goal_of_a_task_that_is_cancelled_before_it_starts_again_is_cancelled(
    field: Durable, driver: Server
) -> None:
    field.deploy(DRIVES.replace('signalRef="S"', 'signalRef="R"'))
    end_engine(field, in_order=False)
    assert (field.engine.running.instances[0].waiting, len(driver.cancelled), driver.goals) == (["u"], 1, {})


@pytest.mark.parametrize("in_order", [False, True])
def test_a_task_that_was_suspended_takes_up_its_last_goal(field: Durable, driver: Server, in_order: bool) -> None:
    field.deploy(DRIVES)
    field.engine.running.hold("test")
    field.pass_time(1)
    field.engine.running.release("test")
    field.pass_time(1)
    end_engine(field, in_order=in_order)
    (instance,) = field.engine.running.instances
    assert (instance.status, len(driver.goals), len(driver.cancelled)) == ("running", 1, 2 if in_order else 1)


@pytest.mark.parametrize(("retry", "status", "goals"), [("safe", "running", 1), ("never", "failed", 0)])
def test_a_goal_that_an_engine_cancels_when_it_is_stopped_is_lost(
    field: Durable, driver: Server, retry: str, status: str, goals: int
) -> None:
    stated = f'<camunda:property name="retry" value="{retry}"/></camunda:properties>'
    field.deploy(DRIVES.replace("</camunda:properties>", stated))
    end_engine(field, in_order=True)
    (instance,) = field.engine.running.instances
    assert (instance.status, len(driver.goals), len(driver.cancelled)) == (status, goals, 1)
    assert (
        f"act('drive'): it was cancelled when the engine ended, and its fate is unknown; retry: {retry}" in field.notes
    )


@pytest.mark.parametrize("ends_by", ["deployment", "crash"])
def test_a_goal_that_arrives_after_its_cancellation_is_cancelled_all_the_same(
    field: Durable, monkeypatch: pytest.MonkeyPatch, ends_by: str
) -> None:
    held: list[Callable[[], object]] = []
    accept = ActionServer._send_goal

    def delayed(self: ActionServer, request: Any) -> Any:
        response = DeferredResponse()
        held.append(lambda: response.respond(accept(self, request)))
        return response if len(held) == 1 else accept(self, request)

    monkeypatch.setattr(ActionServer, "_send_goal", delayed)
    driver = Server(field.middleware.node("driver", "A"))
    field.deploy(DRIVES)
    if ends_by == "crash":
        end_engine(field, in_order=False)
    else:
        told(field, "d2", 2, patrol(7), "load")
        field.pass_time(1)
        told(field, "d2", 2, "", "start")
        field.pass_time(0.5)
    held[0]()
    (first, *others) = reversed(driver.goals)
    field.pass_time(5)
    assert (driver.cancelled, list(driver.goals)) == ([first], others)
    assert len(others) == (ends_by == "crash")
    assert field.engine.running.runner.cancelled.table() == {}


@pytest.mark.parametrize("comes_to", ["resume", "_go_on"])
def test_a_deployment_cancels_the_goal_of_a_mission_that_has_not_gone_on_yet(
    field: Durable, driver: Server, monkeypatch: pytest.MonkeyPatch, comes_to: str
) -> None:
    field.deploy(DRIVES)
    (goal,) = driver.goals
    monkeypatch.setattr(ResumedMission, comes_to, lambda self, *arguments: None)  # it is loading, or waits for topics
    end_engine(field, in_order=False)
    told(field, "d2", 2, patrol(7), "load")
    field.pass_time(1)
    told(field, "d2", 2, "", "start")
    field.pass_time(1)
    assert field.engine.deployed == "d2"
    assert driver.cancelled == [goal]
