"""An engine keeps a log of its own, of bounded size; the logs of a team are merged by time."""

from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from fame.cli import main
from fame.clock import EPOCH, SECOND
from fame.fleet.engine_log import EngineLog
from fame.log import Recording
from fame.log.channels import EVENTS, KEY, WAITING
from fame.log.merging import merge
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder
from fame.robot.live import ElementFeed
from fame.view import Replay
from tests.test_live_team import COUNTING, Field


@pytest.fixture
def field() -> Iterator[Field]:
    field = Field()
    yield field
    for engine in field.engines:
        engine.close()
    field.middleware.close()


def engine_with_log(field: Field, name: str, folder: Path, epoch: datetime = EPOCH, **options: int) -> EngineLog:
    folder.mkdir(exist_ok=True)
    notes: list[str] = []
    log = EngineLog(folder, name, field.scheduler, notes.append, wall_time=lambda: 0.0, **options)
    field.engine(name, log=log, epoch=epoch)
    return log


def finish(field: Field, *logs: EngineLog) -> None:
    for engine in field.engines:
        engine.close()
    field.engines.clear()
    for log in logs:
        log.close()


def left(recording: Recording, robot: str) -> Counter[str]:
    return Counter(event.element for event in recording.events(robots=[robot]) if event.what == "leave")


def test_an_engine_that_nobody_watches_keeps_everything(field: Field, tmp_path: Path) -> None:
    log = engine_with_log(field, "REX", tmp_path)
    field.deploy("REX")
    field.run(10)
    running = field.engines[0].running
    assert running is not None
    visits = running.instances[0].visits
    finish(field, log)
    (path,) = tmp_path.iterdir()
    assert path.name == "REX-19700101T000000.mcap"
    with Recording(path) as recording:
        assert not recording.warnings
        assert left(recording, "REX")["Count"] == visits["Count"]
        assert recording.models.keys() == {"REX.bpmn"}


def test_how_a_process_ended_is_kept_when_another_one_takes_its_place(field: Field, tmp_path: Path) -> None:
    log = engine_with_log(field, "REX", tmp_path)
    field.deploy("REX")
    field.run(1.01)
    field.deploy("REX", COUNTING.replace("0.1S", "0.2S"))
    field.run(1.01)
    finish(field, log)
    with Recording(tmp_path / "REX-19700101T000000.mcap") as recording:
        events = [event for event in recording.events(robots=["REX"]) if event.element != "f2"]
    assert [(event.element, event.what, event.detail) for event in events[-3:]] == [
        ("Wait", "enter", None), ("Wait", "cancel", None), ("P", "end", "cancelled"),
    ]  # fmt: skip
    assert events[-3].time == SECOND


def test_files_are_of_bounded_size_and_number_and_each_can_be_read(field: Field, tmp_path: Path) -> None:
    log = engine_with_log(field, "REX", tmp_path, files=3, size=3000)
    field.deploy("REX")
    field.run(60)
    finish(field, log)
    files = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert len(files) == 3
    for path in files:
        with Recording(path) as recording:
            first = next(iter(recording.messages()))
            assert first.topic == KEY
            state = recording.state(recording.end).robots["REX"]
            began = recording.state(recording.start).robots["REX"].marks_of("Count")["leave"]
            assert state.marks_of("Count")["leave"] >= began + left(recording, "REX")["Count"] - 1


def test_a_folder_that_cannot_be_written_does_not_stop_the_mission(field: Field, tmp_path: Path) -> None:
    log = engine_with_log(field, "REX", tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    (tmp_path / "gone").write_text("a file")
    field.deploy("REX")
    field.run(5)
    assert field.engines[0].state == "running"
    assert log._broken
    finish(field, log)


def test_logs_of_a_team_are_merged_by_time(field: Field, tmp_path: Path) -> None:
    logs = [engine_with_log(field, name, tmp_path / name) for name in ("REX", "DINGO")]
    with (
        (tmp_path / "team.mcap").open("wb") as stream,
        TeamRecorder(field.middleware, field.scheduler, lambda: RecordingFile(stream)),
    ):
        field.run(1)
        field.deploy("REX")
        field.run(2)
        field.deploy("DINGO")
        field.run(5)
    field.run(4)  # the recorder has lost the network
    finish(field, *logs)
    own = [str(next((tmp_path / name).iterdir())) for name in ("REX", "DINGO")]
    merged = tmp_path / "merged.mcap"
    assert main(["log", "merge", str(tmp_path / "team.mcap"), *own, "-o", str(merged)]) == 0
    with Recording(merged) as recording:
        assert recording.robots == ["DINGO", "REX"]
        times = [message.time for message in recording.messages()]
        assert times == sorted(times)
        for robot, path in zip(("REX", "DINGO"), own, strict=True):
            with Recording(path) as alone:
                assert left(recording, robot) == left(alone, robot)
                last = alone.state(alone.end).robots[robot]
            assert recording.state(recording.end).robots[robot] == last
        assert recording.topics[EVENTS].count > 50


def test_merged_tokens_wait_since_a_time_of_the_merged_clock(field: Field, tmp_path: Path) -> None:
    ahead = {"REX": 0, "DINGO": 100}
    logs = [engine_with_log(field, name, tmp_path / name, EPOCH + timedelta(seconds=by)) for name, by in ahead.items()]
    for name in ahead:
        field.deploy(name)
    field.run(5)
    finish(field, *logs)
    merged = tmp_path / "merged.mcap"
    assert main(["log", "merge", *(str(next((tmp_path / name).iterdir())) for name in ahead), "-o", str(merged)]) == 0
    with Recording(merged) as recording:
        for message in recording.messages((WAITING,)):
            assert all(message.time - SECOND < token["since"] <= message.time for token in message.json()["tokens"])
        state = recording.state(recording.end)
        (token,) = state.robots["DINGO"].tokens.values()
        assert token["since"] > 100 * SECOND


def test_after_a_crash_a_replay_of_merged_logs_shows_what_the_robot_does_since(field: Field, tmp_path: Path) -> None:
    for number in range(2):
        log = engine_with_log(field, "REX", tmp_path / str(number))
        field.run(1)
        field.deploy("REX")
        field.run(3)
        log.close()  # as if the engine died: its end is not recorded
        finish(field)
    merged = tmp_path / "merged.mcap"
    assert (
        main(["log", "merge", *(str(next((tmp_path / str(one)).iterdir())) for one in (0, 1)), "-o", str(merged)]) == 0
    )
    with Replay(merged) as replay:
        replay.wait()
        assert [row[4] for row in replay._packer.key_json()["tokens"]] == [1]


def test_every_step_is_published_for_the_viewer_of_the_original(field: Field) -> None:
    feed = ElementFeed(field.middleware.node("fame_dt", "REX"))
    field.engine("REX", observer=feed)
    told: list[str] = []
    field.middleware.node("viewer").subscription(
        "/fame_dt", "std_msgs/msg/String", lambda message: told.append(message.data)
    )
    field.deploy("REX")
    field.run(1)
    first = ["Start/enter/REX-1", "Start/leave/REX-1", "f0/take/REX-1", "Count/enter/REX-1", "Count/leave/REX-1"]
    assert told[:5] == first


def test_merged_logs_show_each_model_while_it_ran(field: Field, tmp_path: Path) -> None:
    log = engine_with_log(field, "REX", tmp_path / "logs")
    for name in ("first", "second", "third"):
        field.deploy("REX", COUNTING.replace("a moment", name))
        field.run(2)
    finish(field, log)
    paths = list((tmp_path / "logs").iterdir())
    assert len(paths) == 3
    merge(paths, tmp_path / "all.mcap")
    with Replay(tmp_path / "all.mcap") as replay:
        replay.wait()
        elements, shown = replay.catalogue.elements_json(), dict[int, str]()
        for block in replay._packer.blocks:
            waits = ((t, elements[e].get("name")) for t, e in zip(block.columns["t"], block.columns["e"], strict=True))
            shown.update((t, name) for t, name in waits if name in ("first", "second", "third"))
        for path in paths:
            with Recording(path) as recording:
                name = next(
                    name for name in ("first", "second", "third") if name.encode() in recording.models["REX.bpmn"]
                )
                # In the instant of a change both models have events.
                times = {event.time for event in recording.events(recording.start + 2) if event.element == "Wait"}
            assert len(times) > 10
            assert {shown[time] for time in times} == {name}
        assert not replay.notices
