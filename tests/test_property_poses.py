"""Distances between robots whose positions come from topics: in one frame, and not older than a second."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from collaborations import team
from test_live_properties import TEAM, Judged

from fame.cli import main
from fame.clock import SECOND
from fame.middleware import messages
from fame.properties import Judge, Property, Vocabulary, compile
from fame.properties.files import read_properties
from fame.properties.vocabulary import RobotTerms
from fame.scenario import Scenario

POSE, COVARIANCE, ODOMETRY = (
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"
)  # fmt: skip
FILE = "properties:\n  apart: always distance(A, B) > 1\nposes: {A: /A/pose, B: ~/odom}\n"


def pose(type: str, x: float, frame: str = "map") -> Any:
    place: dict[str, Any] = {"position": {"x": x}}
    return messages.create(type, {"header": {"frame_id": frame}, "pose": place if type == POSE else {"pose": place}})


@pytest.fixture
def made(tmp_path: Path) -> tuple[Property, ...]:
    path = tmp_path / "team.properties.yaml"
    path.write_text(FILE)
    return read_properties(path)


@pytest.fixture
def judge(made: tuple[Property, ...]) -> Judge:
    robots = {robot: RobotTerms(f"P_{robot}", {}, {}, {}, {}) for robot in "AB"}
    return Judge([compile(each, Vocabulary(robots)) for each in made])


def verdict(judge: Judge, *given: tuple[float, str, Any], end: float = 3) -> tuple[str, float | None, float | None]:
    for second, topic, message in given:
        judge.message(round(second * SECOND), "", topic, message)
    (found,) = judge.finish(round(end * SECOND), complete=False)
    return found.verdict, found.slack, found.time


@pytest.mark.parametrize("type", [POSE, COVARIANCE, ODOMETRY])
def test_a_distance_is_that_of_the_last_positions(judge: Judge, type: str) -> None:
    apart = [(n / 2, f"/{topic}", pose(type, x)) for n in range(6) for topic, x in (("A/pose", n), ("B/odom", 7))]
    assert verdict(judge, *apart) == ("holds", 1.0, None)


def test_robots_that_come_too_close_violate_it(judge: Judge) -> None:
    apart = [(0, "/A/pose", pose(POSE, 0)), (0.1, "/B/odom", pose(ODOMETRY, 3)), (1, "/B/odom", pose(ODOMETRY, 0.5))]
    assert verdict(judge, *apart) == ("violated", -0.5, 1.0)


@pytest.mark.parametrize(
    "message", [pose(POSE, 0, "odom"), pose(POSE, float("nan")), messages.create("std_msgs/msg/Empty")]
)
def test_positions_in_two_frames_and_what_is_no_position_are_not_known(judge: Judge, message: Any) -> None:
    assert verdict(judge, (0, "/A/pose", message), (0, "/B/odom", pose(ODOMETRY, 9)), end=0.5)[0] == "not known"


@pytest.mark.parametrize(("end", "word"), [(1.0, "holds"), (1.1, "not known")])
def test_a_position_that_is_older_than_a_second_is_not_known(judge: Judge, end: float, word: str) -> None:
    given = (0, "/A/pose", pose(POSE, 0)), (0, "/B/odom", pose(ODOMETRY, 9))
    assert verdict(judge, *given, (0.9, "/B/odom", pose(ODOMETRY, 9)), end=end)[0] == word


def test_too_close_is_violated_also_after_a_gap(judge: Judge) -> None:
    given = [(t, topic, pose(POSE, x)) for t, x in ((0, 9), (2, 0.5)) for topic, x in (("/A/pose", 0), ("/B/odom", x))]
    assert verdict(judge, *given) == ("violated", -0.5, 2.0)


# ---- teams -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def judged(tmp_path: Path, made: tuple[Property, ...]) -> Iterator[Judged]:
    found = Judged(tmp_path / "run.mcap", list(made), team(TEAM))
    yield found
    found.close()


@pytest.mark.parametrize(
    ("closest", "frame", "word"), [(2, "map", "holds"), (0.5, "map", "violated"), (2, "odom", "not known")]
)
def test_a_running_team_is_judged_by_its_topics_and_its_recording_says_the_same(
    judged: Judged, closest: float, frame: str, word: str
) -> None:
    node = judged.field.middleware.node("driver", "A")
    first, second = node.publisher("/A/pose", POSE), node.publisher("/B/odom", ODOMETRY)
    judged.deploy("A", "B")
    for x in (5.0, 4.0, 3.0, closest, 4.0):
        judged.field.run(0.5)
        first.publish(pose(POSE, 0.0, frame))
        second.publish(pose(ODOMETRY, x))
    assert judged.verdicts() == {"apart": word}  # the recording has the topics, though they are no signals


# ---- scenarios -------------------------------------------------------------------------------------------------------

SCENARIO = """model: {model}
world:
  bounds: [-1, -1, 7, 5]
  robots:
    REX: {{type: car, at: [0, 1]}}
    DINGO: {{type: car, at: [0, 3]}}
duration: 2
properties:
  apart: always distance(REX, DINGO) > 0.4
poses:
  {poses}
"""
MODEL = Path(__file__).parent.parent / "models" / "ground_vehicles.bpmn"


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    return tmp_path / "mission.yaml"


def test_a_run_uses_the_topics_that_its_scenario_names(scenario: Path) -> None:
    scenario.write_text(SCENARIO.format(model=MODEL, poses="{REX: ~/odom, DINGO: /DINGO/odom}"))
    (found,) = Scenario.load(scenario).run().judgements
    assert (found.verdict, found.slack) == ("holds", pytest.approx(1.6, abs=0.05))
    assert found.slack != pytest.approx(1.6, abs=1e-6)  # as odometry has it


@pytest.mark.parametrize(
    ("poses", "text"),
    [
        ("DINGGO: ~/odom", "poses.DINGGO: unknown robot or pool 'DINGGO'; did you mean 'DINGO'?"),
        ("REX: ~/odon", "poses.REX: no robot uses topic /REX/odon; did you mean '/REX/odom'?"),
        ("REX: ~/range", "poses.REX: sensor_msgs/msg/Range has no field pose"),
        (
            "REX: /map pose",
            "poses.REX: expected a topic, as in /map_pose, or ~/odom for the robot's own, got '/map pose'",
        ),
        ("REX: odom", "poses.REX: expected a topic, as in /map_pose, or ~/odom for the robot's own, got 'odom'"),
        ("REX: 5", "poses.REX: expected a text, got 5"),
    ],
)
def test_a_wrong_topic_is_an_error_with_its_line(
    scenario: Path, poses: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario.write_text(SCENARIO.format(model=MODEL, poses=poses))
    assert main(["check", "--no-project", str(scenario)]) == 1
    assert f"{scenario}:11: error: {text}" in capsys.readouterr().out
