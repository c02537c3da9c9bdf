"""What `fame edit` offers behind what is typed: names that the checks and the robots of a scenario know."""

from __future__ import annotations

from pathlib import Path

import pytest

from fame.bpmn.library import Library
from fame.bpmn.reader import read
from fame.edit.completion import Completer, robot_topics
from fame.middleware.interface import TopicInfo

MODELS = Path(__file__).parent.parent / "models"
ODOMETRY = "nav_msgs/msg/Odometry"
WORLD = robot_topics(
    [TopicInfo(name, (ODOMETRY,), (), ()) for name in ("/Drone/camera", "/REX/camera", "/tf")], ["Drone"]
)
REPORT, GOES, THROWN, CAUGHT = (
    "Activity_Report",
    "Activity_GoTo",
    "Event_TractorPositionThrown",
    "Event_WeedPositionCaught",
)  # of the Tractor
FLIES = "Activity_Explore"  # of the Drone


@pytest.fixture(scope="module")
def completer() -> Completer:
    given = {"Process_Tractor": ["blade"]}
    return Completer(read(MODELS / "agriculture.bpmn"), Library(), lambda: WORLD, given)


@pytest.mark.parametrize(
    ("element", "field", "before", "first"),
    [
        (REPORT, "script", "a = robot.pub", "publish"),
        (REPORT, "script", "robot.publish('/weed_f", "/weed_found"),
        (REPORT, "script", 'robot.publish("/weed_found", "', "geometry_msgs/msg/Vector3"),
        (REPORT, "script", 'robot.publish("odom", "nav_msgs/msg/Odometry", po', "pose"),
        (REPORT, "script", "odom.pose.pose.", "position"),
        (REPORT, "script", "x = x_tr", "x_tractor"),
        (REPORT, "condition", "x_tr", "x_tractor"),
        (REPORT, "script", "slee", "sleep"),
        (REPORT, "script", "msg = bla", "blade"),
        (FLIES, "script", "robot.latest('cam", "camera"),
        (FLIES, "script", "robot.latest('/t", "/tf"),
        (THROWN, "signal", "weed_f", "weed_found"),
        (THROWN, "payload", "{", "header"),
        (THROWN, "payload", "{x: ${x_t", "x_tractor"),
        (THROWN, "type", "std_msgs/msg/Str", "std_msgs/msg/String"),
        (CAUGHT, "x_weed", "${msg.", "x"),
        (GOES, "called", "Go", "GoTo"),
    ],
)
def test_what_fits_is_offered(completer: Completer, element: str, field: str, before: str, first: str) -> None:
    found = completer.complete(element, field, before)
    assert found.words[0][0] == first
    assert before.endswith(first[: found.length])


@pytest.mark.parametrize(
    ("element", "field", "before", "first"),
    [
        ("Flow_5", "feel", "not(dist", "distance"),
        ("Flow_5", "condition", "=dist", "distance"),
        ("Wait", "feel", "msg.", "x"),
        ("Sum", "feel", "if x_weed < 0 and str", "string"),
        ("Tell", "payload", "={y: y_w", "y_weed"),
        ("Measure_It", "called", "Mea", "Measure"),
    ],
)
def test_what_fits_is_offered_in_feel(element: str, field: str, before: str, first: str) -> None:
    completer = Completer(read(Path(__file__).parent / "models/dialects/camunda8.bpmn"), Library())
    found = completer.complete(element, field, before)
    assert found.words[0][0] == first
    assert not {"robot", "sleep"} & {word for word, _ in completer.complete(element, field, "=").words}


@pytest.mark.parametrize(
    ("element", "field", "before"),
    [
        (REPORT, "script", "robot.publish"),  # all of it is there
        (REPORT, "script", "robot.latest('cam"),  # of another robot
        (REPORT, "script", "nothing_of_this_name."),
        (REPORT, "script", "odom.pose.pose.position.x."),
        (REPORT, "documentation", "x_tr"),
        (THROWN, "payload", "{x: ${a} x_t"),
        ("nowhere", "called", "Zzz"),
    ],
)
def test_what_does_not_fit_is_not(completer: Completer, element: str, field: str, before: str) -> None:
    assert completer.complete(element, field, before).words == []


def test_an_empty_model_has_the_names_of_scripts(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text('<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"/>')
    completer = Completer(read(tmp_path / "m.bpmn"), Library())
    assert completer.complete("", "script", "rob").words == [("robot", "script interface")]
