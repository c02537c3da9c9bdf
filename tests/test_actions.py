"""Actions on every backend: goals that take their time, tell how far they are, and can be cancelled."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from action_server import DRIVE, Server, skip_without_drive
from middleware_contract import BACKENDS, World, needs, world

from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.actions import ActionClient


@pytest.fixture(params=BACKENDS)
def here(request: pytest.FixtureRequest) -> Iterator[World]:
    skip_without_drive(request.param)
    made = world(request.param)
    yield made
    made.close()


class Place:
    """A server, a client that has found it, and what the client heard."""

    def __init__(self, here: World) -> None:
        self.server = Server(here.node("driver", "REX"))
        self.client = ActionClient(here.node("engine", "REX"), "drive", DRIVE)
        self.heard: list[Any] = []
        here.until(lambda: self.client.available)
        here.connect("/REX/drive/_action/feedback")

    def send(self, distance: float) -> Any:
        return self.client.send({"distance": distance}, self.ended, lambda said: self.heard.append(said.remaining))

    def ended(self, outcome: str, result: Any) -> None:
        self.heard.append((outcome, result and result.driven))


@pytest.fixture
def place(here: World) -> Place:
    return Place(here)


def test_a_goal_tells_how_far_it_is_and_its_result(here: World, place: Place) -> None:
    place.send(2)
    here.until(lambda: place.server.goals)
    place.server.step()
    here.until(lambda: place.heard == [1.0])
    place.server.step()  # its result may overtake what was told on the way
    here.until(lambda: place.heard[-1] == ("succeeded", 2.0))
    assert [said for said in place.heard if said != 0.0] == [1.0, ("succeeded", 2.0)]
    assert place.client.goals == {}


@pytest.mark.long_but("local")
def test_a_long_goal_has_its_result_after_many_short_ones(here: World, place: Place) -> None:
    place.send(1000)
    here.until(lambda: len(place.server.goals) == 1)
    (long,) = place.server.goals
    others: list[str] = []
    for number in range(110):
        place.client.send({"distance": 1}, lambda outcome, _: others.append(outcome), lambda said: None)
        here.until(lambda: len(place.server.goals) == 2)
        place.server.step()
        here.until(lambda wanted=number + 1: len(others) == wanted)
    place.server.end(long, 6)
    here.until(lambda: place.heard and place.heard[-1] == ("aborted", 110.0))


def test_goals_are_kept_apart(here: World, place: Place) -> None:
    other: list[Any] = []
    place.send(3)
    here.until(lambda: len(place.server.goals) == 1)
    place.client.send({"distance": 2}, lambda *said: other.append(said[0]), lambda said: other.append(said.remaining))
    here.until(lambda: len(place.server.goals) == 2)
    place.server.step()
    here.until(lambda: (other, place.heard) == ([1.0], [2.0]))
    place.server.step()  # its result may overtake what was told on the way
    here.until(lambda: "succeeded" in other and len(place.heard) == 2)
    assert (set(other) - {0.0}, place.heard) == ({1.0, "succeeded"}, [2.0, 1.0])


def test_a_rejected_goal_has_no_result(here: World, place: Place) -> None:
    place.send(-1)
    here.until(lambda: place.heard)
    assert place.heard == [("rejected", None)]


@pytest.mark.parametrize(("status", "outcome"), [(4, "succeeded"), (5, "canceled"), (6, "aborted")])
def test_the_server_may_end_a_goal_as_it_likes(here: World, place: Place, status: int, outcome: str) -> None:
    place.send(9)
    here.until(lambda: place.server.goals)
    place.server.end(next(iter(place.server.goals)), status)
    here.until(lambda: place.heard)
    assert place.heard == [(outcome, 0.0)]


def test_a_cancelled_goal_ends_at_the_server_and_is_heard_of_no_more(here: World, place: Place) -> None:
    goal = place.send(9)
    here.until(lambda: place.server.goals and goal._accepted)
    goal.cancel()
    goal.cancel()
    here.until(lambda: place.server.cancelled == [goal.id])
    here.settle()
    assert (place.heard, place.server.goals) == ([], {})


def test_a_goal_may_be_cancelled_before_it_was_accepted(here: World, place: Place) -> None:
    goal = place.send(9)
    goal.cancel()
    here.until(lambda: place.server.cancelled == [goal.id])
    assert place.heard == []


def test_a_goal_that_is_over_is_not_cancelled(here: World, place: Place) -> None:
    goal = place.send(1)
    here.until(lambda: place.server.goals)
    place.server.step()
    here.until(lambda: ("succeeded", 1.0) in place.heard)
    goal.cancel()
    here.settle()
    assert place.server.cancelled == []


def test_what_cannot_be_sent_is_refused(here: World, place: Place) -> None:
    with pytest.raises(MessageError, match="distance: expected a number, got 'far'"):
        place.client.send({"distance": "far"}, print)
    nobody = ActionClient(here.node("other"), "/fly", DRIVE)
    assert not nobody.available
    with pytest.raises(MessageError, match="no node offers the service /fly/_action/send_goal"):
        nobody.send(None, print)
    nobody.close()


def test_an_unknown_action_is_refused_with_one_that_is_like_it(here: World) -> None:
    with pytest.raises(MessageError, match="did you mean farm_msgs/action/Drive"):
        ActionClient(here.node("engine"), "drive", "farm_msg/Drive")


# ---- where types come from -------------------------------------------------------------------------------------------


def test_types_of_a_sourced_workspace_are_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {
        "msg/Blade.msg": "float64 speed\nbool on\n",
        "srv/Grind.srv": "Blade blade\n---\nbool sharp\n",
        "action/Mow.action": "Blade blade\n---\nfloat64 area\n---\nfloat64 done\n",
    }
    for name, text in texts.items():
        file = tmp_path / "share" / "mower_msgs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    with pytest.raises(MessageError, match="there is no such message type"):
        messages.create("mower_msgs/msg/Blade")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/no/such/place:{tmp_path}")
    assert messages.action("mower_msgs/Mow") == "mower_msgs/action/Mow"
    assert messages.service("mower_msgs/Grind")[0] == "mower_msgs/srv/Grind_Request"
    goal = messages.create("mower_msgs/action/Mow_Goal", {"blade": {"speed": 3, "on": True}})
    assert (goal.blade.speed, goal.blade.on) == (3.0, True)
    with pytest.raises(MessageError, match="there is no such action type"):
        messages.action("mower_msgs/action/Plough")


def test_a_file_of_a_sourced_workspace_that_is_no_text_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "share" / "torn_msgs" / "msg" / "Torn.msg"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"float64 \xff\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(MessageError, match=r"Torn\.msg cannot be read: 'utf-8' codec can't decode"):
        messages.create("torn_msgs/msg/Torn")


@pytest.mark.parametrize("text", ["float64 x", "float64 x\n---\n", "---\n---\n---"])
def test_an_action_has_three_parts(text: str) -> None:
    with pytest.raises(MessageError, match="a goal, a result and a feedback"):
        messages.register(text, "farm_msgs/action/Odd")


# ---- on the wire -----------------------------------------------------------------------------------------------------

OF_JAZZY = {
    "Goal": "834005bd2bbbb0ec2dbe2754ce54e9d8c4788812c743ba04dd1eadb29694b74d",
    "Result": "cf622af2777e926c87a6cca9464ba4066f5a50d2683f6094c8913ae921623b51",
    "Feedback": "c1b73edc4ddf4f9a6b24fefda63f307fa081a30ba3b6703ddc7bab28b66cdda6",
    "SendGoal_Request": "f2b9a1cdae16d572911129a7206462218eb7ef274473133a5d92a8c10633ba62",
    "SendGoal_Response": "d8af5e3d666fb61ed4635ec25692dd96e9343b1b51c4ed9843011b03adf8fccf",
    "GetResult_Request": "c52bf1a28eeaf18da1fb98ee28d46abd2a42feeb28879fe66433734b73d91662",
    "GetResult_Response": "256035c9d33604dd898e5a50a931ecfdda4f073be7710d881beabd8bfa104e78",
    "FeedbackMessage": "a941cc541674f910f08c54c0d6a8a5a63be0ee7697a74928f342b2583dcfa88a",
}
"""Part of an action -> its type hash, as ROS's own generator gives it for this action."""


@pytest.mark.parametrize("part", OF_JAZZY)
def test_what_travels_has_the_type_hash_that_ros_gives_it(part: str) -> None:
    messages.register("int64 number\n---\nint64[] sequence\n---\nint64 progress", "rob599_msgs/action/Fibonacci")
    assert codec.type_hash(f"rob599_msgs/action/Fibonacci_{part}") == f"RIHS01_{OF_JAZZY[part]}"


@needs("cyclonedds")
def test_topics_and_types_of_actions_have_the_names_of_ros() -> None:
    from fame.middleware import typesystem
    from fame.middleware.dds import wire

    name = "nav2_msgs/action/NavigateToPose_SendGoal_Request"
    assert typesystem.dds_type(name) == "nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_"
    assert typesystem.ros_type(typesystem.dds_type(name)) == name
    asked = wire.dds_topic("/REX/navigate_to_pose/_action/send_goal", wire.REQUEST, "Request")
    assert asked == "rq/REX/navigate_to_pose/_action/send_goalRequest"
