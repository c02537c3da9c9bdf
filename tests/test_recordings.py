"""A recording has what happened in a run, its variables, what tokens waited for, and the world, at any time of it."""

import json
import random
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from recorded_runs import record

import fame
from fame.cli import main
from fame.errors import ConfigError
from fame.log import About, Recording, TeamState, logging_to
from fame.log.channels import EVENTS, VARIABLES, WAITING
from fame.log.recording_file import RecordingFile
from fame.middleware import messages
from fame.robot.events import EventLog, combine_observers
from fame.robot.plain_values import plain
from fame.scenario import Scenario
from tests.bpmn_text import process

EXAMPLES = Path(__file__).parent.parent / "examples"
SECOND = 1_000_000_000
CHANGES = (EVENTS, VARIABLES, WAITING)

FORMAT_1 = Path(__file__).with_name("recordings") / "format_1.mcap"
"""A call of a process with a sub-process that waits twice, until its boundary timer, and an event sub-process."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, EventLog]:
    """Twenty seconds of the agriculture example, as a recording and as events."""
    path = tmp_path_factory.mktemp("recordings") / "run.mcap"
    pytest.MonkeyPatch().setattr("fame.log.mcap_writer.CHUNK", 1 << 14)  # several chunks also of a short run
    scenario, events = Scenario.load(EXAMPLES / "agriculture.yaml", duration=20), EventLog()
    about = About(metadata={"seed": "1"}, attachments=[("scenario/s.yaml", "application/yaml", b"seed: 1\n")])
    with logging_to(path, scenario.closures(), about) as log:
        scenario.run(observer=combine_observers([events, log]))
    return path, events


def test_the_events_are_those_of_the_run(run: tuple[Path, EventLog]) -> None:
    path, events = run
    with Recording(path) as recording:
        written = [tuple(event) for event in recording.events()]
        written += [(recording.end, "", 0, 0, "", "verdict", each) for each in recording.verdicts]
        written += [tuple(recording.ended or ())]
    # Events of several robots at one instant are written robot by robot.
    assert Counter(map(str, written)) == Counter(str(tuple(event)) for event in events)
    assert [event[0] for event in written] == sorted(event[0] for event in written)


def test_seeking_gives_the_state_that_playing_gives(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        times = random.Random(1).sample(range(recording.start, recording.end), 25)
        played = TeamState()
        messages = list(recording.messages(CHANGES))
        place = 0
        for time in sorted(times):
            while place < len(messages) and messages[place].time <= time:
                played.apply(messages[place].time, messages[place].topic, messages[place].json())
                place += 1
            sought = recording.state(time)
            for name, robot in sought.robots.items():
                known = played.robots.get(name)
                if known is not None:
                    robot.process = known.process
                    assert robot == known, (name, time)
                else:
                    assert not robot.tokens


def test_a_recording_that_is_opened_again_is_read_and_closed_independently(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        with recording.reopen() as again:
            assert next(again.messages()) == next(recording.messages())
        for other in (recording.reopen(), recording.reopen()):
            for one, same in zip(recording.messages(), other.messages(), strict=True):
                assert one == same
            other.close()


def test_the_last_state_is_that_of_the_end(run: tuple[Path, EventLog]) -> None:
    path, events = run
    entered = Counter(event.element for event in events if event.robot == "Drone" and event.what == "enter")
    with Recording(path) as recording:
        state = recording.state(recording.end)
        counts = [counts for each in state.robots["Drone"].counts.values() for counts in each.items()]
        assert {id: each["enter"] for id, each in counts if "enter" in each} == entered
        assert "Drone" in recording.robots


def test_the_end_of_a_run_that_is_cut_shows_what_was_active(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        assert recording.state(recording.end).robots["Drone"].tokens


def test_a_token_says_where_it_is_and_what_it_waits_for(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        tokens = recording.state(10 * SECOND).robots["Drone"].tokens.values()
        assert tokens
        for token in tokens:
            assert token["element"]
            assert token["text"] or token["kind"] == "join"
            assert token["since"] <= 10 * SECOND


def test_the_world_is_recorded_with_robots_and_ground(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        assert recording.world(10 * SECOND)["Drone"]["type"] == "drone"
        assert len(recording.ground(0)["bounds"]) == 4
        moved = {recording.world(time * SECOND)["Drone"]["x"] for time in range(1, 20)}
        assert len(moved) > 3


def test_models_scenario_and_metadata_are_in_it(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        assert recording.metadata["format"] == "2"
        assert recording.metadata["seed"] == "1"
        assert recording.attachments["scenario/s.yaml"] == b"seed: 1\n"
        name, text = next(iter(recording.models.items()))
        assert fame.bpmn.read_bytes(text, file=name).processes


def test_signals_are_recorded_as_messages_of_ros_2(run: tuple[Path, EventLog]) -> None:
    with Recording(run[0]) as recording:
        topic = recording.topics["/weed_position"]
        assert (topic.encoding, topic.type) == ("cdr", "geometry_msgs/msg/Vector3")
        assert "/Drone/odom" not in recording.topics
        first = next(recording.messages(["/weed_position"]))
        assert first.node == "/Drone/fame_engine"
        assert recording.decode(first).keys() == {"x", "y", "z"}


def test_all_topics_are_recorded_if_wanted(tmp_path: Path) -> None:
    record(Scenario.load(EXAMPLES / "agriculture.yaml", duration=2), tmp_path / "all.mcap", topics="all")
    with Recording(tmp_path / "all.mcap") as recording:
        assert recording.topics["/Drone/odom"].count == len(list(recording.messages(["/Drone/odom"]))) > 10
        last = list(recording.messages(["/Drone/odom"]))[-1]
        assert recording.decode(last)["child_frame_id"]


def test_messages_of_types_of_ones_own_are_read_with_their_schema(tmp_path: Path) -> None:
    script = """
from fame.log import Recording
import sys
with Recording(sys.argv[1]) as recording:
    print(recording.decode(next(recording.messages(["/seen"]))))
"""
    messages.register("float64 x\nstd_msgs/Header header\n", "farm_msgs/msg/Sighting")
    model = """
      <startEvent id="Start"><outgoing>f</outgoing></startEvent>
      <sequenceFlow id="f" sourceRef="Start" targetRef="Seen" />
      <endEvent id="Seen" name="seen"><incoming>f</incoming><extensionElements>
        <camunda:properties><camunda:property name="type" value="farm_msgs/msg/Sighting" />
        <camunda:property name="payload" value="{x: 2.5}" /></camunda:properties></extensionElements>
        <signalEventDefinition id="d" /></endEvent>"""
    path = tmp_path / "m.bpmn"
    path.write_text(process(model))
    with logging_to(tmp_path / "own.mcap", [fame.read(path)]) as log:
        fame.Simulation(path, observer=log).run()
    command = [sys.executable, "-c", script, tmp_path / "own.mcap"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "'x': 2.5" in done.stdout, done.stderr


SCRIPT = """
import numpy
from fame.middleware.messages import create
x, text, seen, array, number, code = 1, "a", [1, 2], numpy.zeros(3), numpy.float64(0.5), 1
point = create("geometry_msgs/Point", {"x": 0.5})
await sleep(1)
seen = [1, 2]
await sleep(1)
seen.append(3)
array[1] = 2.0
await sleep(1)
x, point, code = 1.0, create("geometry_msgs/Point", {"y": float("nan")}), len
await sleep(1)
x, number = True, None
del text
await sleep(1)
"""
STEPS: list[dict[str, object]] = [
    {"x": 1, "text": "a", "seen": [1, 2], "array": [0, 0, 0], "number": 0.5, "code": 1, "point": {"x": 0.5, "y": 0}},
    {"seen": [1, 2, 3], "array": [0, 2, 0]},
    {"x": 1.0, "point": {"x": 0, "y": "NaN"}},
    {"x": True, "number": None},
]


def test_only_changes_of_variables_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(
        process(
            '<startEvent id="S"><outgoing>f</outgoing></startEvent><sequenceFlow id="f" sourceRef="S" targetRef="T"/>'
            f'<scriptTask id="T" scriptFormat="python"><incoming>f</incoming><script>{SCRIPT}</script></scriptTask>'
        )
    )
    with logging_to(tmp_path / "run.mcap", [fame.read(path)]) as log:
        fame.Simulation(path, observer=log).run()
    found, gone = list[dict[str, object]](), list[list[str]]()
    with Recording(tmp_path / "run.mcap") as recording:
        for message in recording.messages([VARIABLES]):
            for change in json.loads(message.data)["changes"]:
                if "set" in change:
                    found.append(change["set"])
                gone.append(change.get("unset", []))
    for step in found:
        if "point" in step:
            assert isinstance(step["point"], dict)
            assert step["point"].pop("z") == 0
    assert [{name: (type(value), value) for name, value in step.items()} for step in found] == [
        {name: (type(value), value) for name, value in step.items()} for step in STEPS
    ]
    assert ["code"] in gone
    assert ["text"] in gone


def test_equal_runs_give_equal_recordings(tmp_path: Path) -> None:
    written = []
    (tmp_path / "b.mcap").write_bytes(b"an older and longer file" * 100_000)
    for name in ("a.mcap", "b.mcap"):
        path = record(Scenario.load(EXAMPLES / "agriculture.yaml", duration=3), tmp_path / name)
        written.append(path.read_bytes())
    assert written[0] == written[1]
    with Recording(tmp_path / "b.mcap") as recording:
        assert not recording.warnings


def test_a_run_is_the_same_with_and_without_a_recording(run: tuple[Path, EventLog]) -> None:
    events = EventLog()
    Scenario.load(EXAMPLES / "agriculture.yaml", duration=20).run(observer=events)
    assert list(map(str, events)) == list(map(str, run[1]))


def test_a_recording_that_was_cut_short_opens_as_far_as_it_is_whole(run: tuple[Path, EventLog], tmp_path: Path) -> None:
    data = run[0].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    with Recording(run[0]) as whole, Recording(tmp_path / "cut.mcap") as cut:
        assert not whole.warnings
        assert "incomplete" in cut.warnings[0]
        assert 0 < cut.end < whole.end
        assert list(cut.events()) == list(whole.events(end=cut.end))[: len(list(cut.events()))]


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_recording_is_read_or_refused_in_one_line(
    run: tuple[Path, EventLog], tmp_path: Path, seed: int
) -> None:
    data, chance, path = bytearray(run[0].read_bytes()), random.Random(seed), tmp_path / "damaged.mcap"
    for _ in range(chance.choice((1, 20))):
        data[chance.randrange(len(data))] = chance.randrange(256)
    path.write_bytes(data)
    with suppress(ConfigError), Recording(path) as recording:  # no other error
        assert list(recording.events()) or recording.warnings  # nothing is left out in silence


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a full disk to try")
def test_a_full_disk_is_told_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.mcap").symlink_to("/dev/full")
    command = ["run", str(EXAMPLES / "agriculture.yaml"), "--duration", "5", "--quiet"]
    assert main([*command, "--log", str(tmp_path / "run.mcap")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("run.mcap: cannot be written: No space left on device")


@pytest.mark.parametrize(
    ("content", "text"),
    [(b"{}", "is not an MCAP file"), (b"", "is not an MCAP file"), (b"\x89MCAP0\r\n", "cut short before anything")],
)
def test_what_is_no_recording_is_refused_in_one_line(content: bytes, text: str, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(ConfigError, match=text):
        Recording(tmp_path / "x.mcap")


def test_a_newer_format_and_a_foreign_file_are_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    for name, metadata in (("newer.mcap", {"format": "3", "fame": "9.0"}), ("foreign.mcap", None)):
        with (tmp_path / name).open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            if metadata:
                writer.add_metadata("fame", metadata)
            schema = writer.register_schema("a", "jsonschema", b"{}")
            channel = writer.register_channel("/odom", "json", schema)
            writer.add_message(channel, 1, b"{}", 1)
            writer.finish()
    with pytest.raises(ConfigError, match="expected format 2 or older, got format 3 of FAME 9"):
        Recording(tmp_path / "newer.mcap")
    with pytest.raises(ConfigError, match="expected a recording of FAME"):
        Recording(tmp_path / "foreign.mcap")


@pytest.mark.parametrize("is_whole", [True, False])
def test_a_newer_format_without_a_message_is_refused_as_newer(tmp_path: Path, is_whole: bool) -> None:
    with (tmp_path / "newer.mcap").open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({"format": "99"})
        (file.finish if is_whole else file.flush)()
    with pytest.raises(ConfigError, match="expected format 2 or older, got format 99"):
        Recording(tmp_path / "newer.mcap")


def test_a_recording_without_a_message_is_empty(tmp_path: Path) -> None:
    with (tmp_path / "empty.mcap").open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({})
        file.finish()
    with Recording(tmp_path / "empty.mcap") as recording:
        assert (recording.robots, recording.duration, recording.warnings) == ([], 0.0, [])


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (float("nan"), "NaN"),
        (list(range(100)), {"$cut": "list of 100", "first": [0, 1, 2, 3]}),
        ("x" * 2000, {"$cut": "text of 2000", "first": "x" * 80}),
        ({"a": (1, 2.5, None)}, {"a": [1, 2.5, None]}),
        ([["y" * 900] * 10], {"$cut": "list of 9033 characters"}),
    ],
)
def test_large_values_are_cut_and_say_so(value: object, written: object) -> None:
    assert plain(value) == written


def places(recording: Recording, time: int) -> list[tuple[str, ...]]:
    """Where tokens are active in REX: the activities around, and the element."""
    state = recording.state(time).robots["REX"]
    return sorted((*state.path(scope), id) for (scope, id), (number, _) in state.active.items() for _ in range(number))


WAITS = [("call",), ("call", "sub"), *[("call", "sub", "each")] * 2, ("handler", "handler")]
WAITS += [("handler", "watch")]
"""Where tokens of format_1.mcap are after 2 s."""


def test_a_recording_of_format_1_tells_what_scopes_are() -> None:
    with Recording(FORMAT_1) as recording, recording.reopen() as other:
        assert (recording.metadata["format"], [*recording.models]) == ("2", ["nested.bpmn"])
        assert places(recording, 2 * SECOND) == places(other, 2 * SECOND) == WAITS
        assert places(recording, 7 * SECOND // 2) == [("call",), ("call", "rest"), *WAITS[-2:]]
        state = recording.state(2 * SECOND).robots["REX"]
        seen = {state.path(scope): state.visible(scope) for scope, _ in state.active}
        assert seen["handler",] == {"x": 1}
        assert seen["call", "sub"]["loopCounter"] in (1, 2)
        assert {id: tuple(outcomes) for _, id, outcomes in recording.state(recording.end).robots["REX"].outcomes()} == {
            **dict.fromkeys(("ps", "f1", "qs", "q1", "set", "q2", "ss", "s1", "hs", "h1"), (1, 0, 0)),
            **dict.fromkeys(("late", "q3", "rest", "q4", "qe", "call"), (1, 0, 0)),
            **dict.fromkeys(("handler", "watch"), (0, 0, 0)),
            "sub": (0, 0, 1),
            "each": (0, 0, 2),
        }


def test_a_recording_of_format_1_may_begin_in_the_middle(tmp_path: Path) -> None:
    """As one of a team does, where batches were lost: of most scopes it has the path alone."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with FORMAT_1.open("rb") as old, (tmp_path / "middle.mcap").open("wb") as stream:
        reader, writer = make_reader(old), Writer(stream)
        writer.start()
        writer.add_metadata("fame", {"format": "1"})
        for attached in reader.iter_attachments():
            writer.add_attachment(0, 0, attached.name, attached.media_type, attached.data)
        for schema, channel, message in reader.iter_messages():
            if message.log_time < 3 * SECOND:
                continue
            known = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            number = writer.register_channel(channel.topic, channel.message_encoding, known)
            writer.add_message(number, message.log_time, message.data, message.log_time)
        writer.finish()
    with Recording(tmp_path / "middle.mcap") as recording, Recording(FORMAT_1) as whole:
        assert places(recording, 7 * SECOND // 2) == [("call",), ("call", "rest"), *WAITS[-2:]]
        assert places(recording, recording.end) == places(whole, whole.end) == WAITS[-2:]
        assert [event.what for event in recording.events()] == [event.what for event in whole.events(3 * SECOND)]
