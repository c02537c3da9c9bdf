"""What tools of ROS read of a recording: mcap's decoder the file itself, rosbags a bag that it is converted to."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from deployment_field import Field, patrol
from rosbags.highlevel import AnyReader

from fame.errors import ConfigError
from fame.log.recording import Recording
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
from fame.middleware import messages
from fame.middleware.interface import LATCHED, SENSOR_DATA, SIGNAL
from fame.mining.conversion import convert

TRANSFORMS = "tf2_msgs/msg/TFMessage"


def record(path: Path, topics: str) -> None:
    """A team, of whose nodes one has said its map before, one measures with best effort, one publishes /tf."""
    field = Field("p")
    driver, robot = field.middleware.node("driver", "p"), field.middleware.node("state_publisher")
    driver.publisher("map", "std_msgs/msg/Float64", LATCHED).publish(messages.create("std_msgs/msg/Float64", 0.5))
    scan = driver.publisher("scan", "std_msgs/msg/Int32", SENSOR_DATA)
    frames = robot.publisher("/tf", TRANSFORMS, SIGNAL)
    parts = field.middleware, field.scheduler
    options = TeamRecorderOptions(topics=topics)
    with path.open("wb") as stream, TeamRecorder(*parts, lambda: RecordingFile(stream), options):
        field.deploy(patrol(1), robots=["p"])
        for number in range(3):
            scan.publish(messages.create("std_msgs/msg/Int32", number))
            frames.publish(messages.create(TRANSFORMS, {"transforms": [{"child_frame_id": "base_link"}]}))
            field.pass_time(1)


def test_all_topics_of_a_team_are_read_by_mcap_and_by_rosbags(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    record(file, "all")
    convert(file, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as bag:
        found = [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]
    assert Counter(topic for topic, _ in found) == {"/p/map": 1, "/p/scan": 3, "/tf": 3}
    assert [message.data for topic, message in found if topic in ("/p/scan", "/p/map")] == [0.5, 0, 1, 2]
    assert {message.transforms[0].child_frame_id for topic, message in found if topic == "/tf"} == {"base_link"}
    with pytest.raises(ConfigError, match="expected a new folder"):
        convert(file, tmp_path / "bag")

    decoders = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoders.DecoderFactory()])
        decoded = [(item.channel.topic, item.decoded_message) for item in reader.iter_decoded_messages(["/p/scan"])]
    assert [message.data for _, message in decoded] == [0, 1, 2]


def test_without_all_topics_neither_sensors_nor_frames_are_recorded(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", "signals")
    with Recording(tmp_path / "run.mcap") as recording:
        assert not {"/p/map", "/p/scan", "/tf"} & recording.topics.keys()
