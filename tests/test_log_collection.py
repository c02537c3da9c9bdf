"""Recordings of engines are fetched over the network: by part, only what is not here, and by who may."""

import argparse
import json
from pathlib import Path

import pytest
from deployment_field import Field

from fame.cli import main
from fame.cli.fleet.collection import _Source, moment
from fame.deploy.envelope import STRING
from fame.errors import DeploymentError
from fame.fleet.log_server import PART
from fame.middleware import messages

CONTENT = bytes(range(256)) * (2 * PART // 256 + 50)


@pytest.fixture
def field(tmp_path: Path) -> Field:
    field = Field()
    (tmp_path / "log").mkdir()
    (tmp_path / "secret.mcap").write_text("s")
    (tmp_path / "log" / "A-20261129T080000.mcap").write_bytes(CONTENT)
    (tmp_path / "log" / "B-20261129T080000.mcap").write_text("of another robot")
    field.add("A", recordings=tmp_path / "log")
    field.listen("A")
    return field


def source(field: Field, key: object = None, born: int = 0) -> _Source:
    return _Source("A", field.person, field.scheduler, key, born)  # type: ignore[arg-type]


def test_what_is_not_here_is_appended_and_the_rest_stays(field: Field, tmp_path: Path):
    robot, here = source(field), tmp_path / "got" / "A" / "run.mcap"
    ((name, size, _),) = robot.files()
    assert (name, size) == ("A-20261129T080000.mcap", len(CONTENT))
    assert robot.fetch(name, here, size) == size
    assert here.read_bytes() == CONTENT
    here.write_bytes(CONTENT[:1000])
    assert robot.fetch(name, here, size) == size - 1000
    assert here.read_bytes() == CONTENT
    assert robot.fetch(name, here, size) == 0


@pytest.mark.parametrize("here", [b"?" + CONTENT[1:2000], CONTENT[:PART] + bytes(5000), CONTENT[:-5] + bytes(5)])
def test_what_does_not_end_as_the_file_of_the_robot_is_not_continued(field: Field, tmp_path: Path, here: bytes):
    path = tmp_path / "run.mcap"
    path.write_bytes(here)  # of another robot with this name, or what a loss of power has left
    with pytest.raises(DeploymentError, match=r"run\.mcap does not end as the robot's file did: remove it"):
        source(field).fetch("A-20261129T080000.mcap", path, len(CONTENT))
    assert path.read_bytes() == here


@pytest.mark.parametrize("name", ["../secret.mcap", "B-20261129T080000.mcap", "/etc/passwd", "A-gone.mcap"])
def test_no_other_file_is_given(field: Field, tmp_path: Path, name: str):
    with pytest.raises(DeploymentError, match="there is no such recording"):
        source(field).fetch(name, tmp_path / "x", 10)


def test_what_another_release_asks_is_refused_by_the_name_of_the_field(field: Field):
    answers: list[str] = []
    field.person.subscription("/A/bpmn_log", STRING, lambda message: answers.append(message.data))
    asks = field.person.publisher("/A/bpmn_log", STRING)
    for text in ('{"id": "q", "compressed": true}', '{"id": 1}', '{"answer": "q"}', "[]", "{"):
        asks.publish(messages.create(STRING, text))
    field.pass_time(1)
    assert [json.loads(text) for text in answers] == [
        {"answer": "q", "error": "this FAME does not know what is asked: field 'compressed'"}
    ]


def test_a_file_that_became_shorter_is_told(field: Field, tmp_path: Path):
    (tmp_path / "log" / "A-20261129T080000.mcap").write_text("short")
    with pytest.raises(DeploymentError, match="has become shorter; 5 of 9 bytes are here"):
        source(field).fetch("A-20261129T080000.mcap", tmp_path / "x", 9)


def test_a_robot_that_does_not_answer_is_given_up(field: Field):
    field.engines["A"].close()
    with pytest.raises(DeploymentError, match="did not answer within 10 s"):
        source(field).files()


@pytest.mark.parametrize("unsigned_tasks", [False, True])
def test_with_keys_only_who_signs_is_answered(tmp_path: Path, field: Field, unsigned_tasks: bool):
    pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'fame-robots[dds]'")
    import time

    from fame.deploy.signing import new_keys, read_private, read_trusted

    field.engines["A"].close()
    secret, public = new_keys(tmp_path / "team")
    options = {"recordings": tmp_path / "log", "trusted": read_trusted([public]), "wall_time": time.time}
    engine = field.add("A", **options, unsigned_tasks=unsigned_tasks)
    with pytest.raises(DeploymentError, match="not signed"):
        source(field).files()
    assert source(field, read_private(secret), engine.born).files()
    with pytest.raises(DeploymentError, match="another run"):
        source(field, read_private(secret), engine.born + 1).files()


def test_a_file_where_the_recordings_are_to_go_is_refused_before_any_robot_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "got").write_text("mine")
    assert main(["log", "collect", "-o", str(tmp_path / "got")]) == 2
    assert capsys.readouterr().err == f"fame: error: {tmp_path / 'got'}: expected a folder, got a file\n"


def test_moments_are_dates_or_durations_ago():
    assert moment("1970-01-01T01:00:00Z") == 3600
    assert 0 < moment("PT1H") - moment("PT2H") - 3600 + 60 < 120
    with pytest.raises(argparse.ArgumentTypeError, match="expected a date or a duration"):
        moment("yesterday")
