"""What a token waits for is followed through the team: who could send it, what those wait for, and circles."""

import re
from collections.abc import Iterator

import pytest
from bpmn_text import process

from fame.log.channels import WAITING
from fame.log.live_team import LiveTeam
from fame.log.wait_chain import WaitChain
from fame.log.wait_reasons import files_of
from fame.robot.robot_state import RobotState
from fame.view.blocks import Packer
from fame.view.catalogue import Catalogue
from tests.test_live_team import Field

SIGNALS = '<signal id="Award" name="award"/><signal id="Bid" name="bid"/><signal id="Open" name="open"/>'
NO_WAY_OUT = "nothing that is drawn and no other publisher can end that, unless a message is still on its way"
TIMER = "<timerEventDefinition><timeDuration>PT60S</timeDuration></timerEventDefinition>"


def event(tag: str, id: str, content: str, before: str, more: str = "") -> str:
    flow = f'<sequenceFlow id="to_{id}" sourceRef="{before}" targetRef="{id}"/>' if before else ""
    return f'<{tag} id="{id}" {more}>{content}</{tag}>{flow}'


def signal(name: str) -> str:
    return f'<signalEventDefinition signalRef="{name}"/>'


def trade(awaited: str, sent: str, *more: str) -> str:
    """A process that waits for a signal, and then throws another."""
    content = '<startEvent id="start"/>' + event("intermediateCatchEvent", "wait", signal(awaited), "start")
    return process(content + event("intermediateThrowEvent", "send", signal(sent), "wait") + "".join(more), SIGNALS)


ALARM = (
    '<subProcess id="alarm" triggeredByEvent="true"><startEvent id="late" name="too late">' + TIMER + "</startEvent>"
    '<endEvent id="over"/><sequenceFlow id="f" sourceRef="late" targetRef="over"/></subProcess>'
)
BIDS = process('<startEvent id="start"/>' + event("intermediateThrowEvent", "send", signal("Bid"), "start"), SIGNALS)


@pytest.fixture
def field() -> Iterator[Field]:
    with Field() as found:
        yield found


def chain(field: Field, robot: str, **models: str) -> list[str]:
    """What is told of the token of a robot, in a team that runs these models, without times."""
    for name in models:
        field.engine(name)
    with LiveTeam(field.middleware.node("watcher"), field.middleware, field.scheduler, lambda *told: None) as team:
        field.run(1)
        for name, text in models.items():
            field.deploy(name, text)
            field.run(3)
        field.run(3)
        files = {name: files_of(model) for name, model in team.models.items()}
        publishers = {info.name: info.publishers for info in field.middleware.graph()}
        found = WaitChain(team.state.robots, files, {name: team.last_time(name) for name in team.robots}, publishers)
        (token,) = (each for each in team.state.robots[robot].tokens.values() if each["element"] == "wait")
        return [re.sub(r", for [0-9.]+ s", "", line) for line in found.lines(robot, token)]


def test_the_chain_goes_on_to_its_end(field: Field) -> None:
    told = chain(field, "Carrier", Carrier=trade("Award", "Open"), Dispatcher=trade("Bid", "Award"))
    assert told == ["  Dispatcher waits at wait, for topic /bid"]


def test_a_circle_is_a_deadlock_if_nothing_else_can_end_it(field: Field) -> None:
    told = chain(
        field, "Carrier",
        Carrier=trade("Award", "Open"), Dispatcher=trade("Bid", "Award"), Door=trade("Open", "Bid"),
    )  # fmt: skip
    assert told == [
        "  Dispatcher waits at wait, for topic /bid",
        "    Door waits at wait, for topic /open",
        f"  Carrier, Dispatcher and Door wait for each other; {NO_WAY_OUT}",
    ]


def test_a_timer_that_can_end_a_circle_is_named(field: Field) -> None:
    told = chain(field, "Carrier", Carrier=trade("Award", "Bid"), Dispatcher=trade("Bid", "Award", ALARM))
    assert told == [
        "  Dispatcher waits at wait, for topic /bid",
        '  Carrier and Dispatcher wait for each other; what can end that: Dispatcher, "too late" (late), a timer event',
    ]


def test_a_robot_that_has_ended_sends_nothing_more(field: Field) -> None:
    told = chain(field, "Dispatcher", Carrier=BIDS, Dispatcher=trade("Bid", "Award"))
    assert told == ["  Carrier has ended: its process publishes /bid no more"]


def test_who_is_no_robot_may_publish_at_any_time(field: Field) -> None:
    field.middleware.node("shop").publisher("/award", "std_msgs/msg/Empty")
    told = chain(field, "Carrier", Carrier=trade("Award", "Open"))
    assert told == ["  shop runs no process that is known: it may publish /award at any time"]


def test_a_process_that_a_signal_starts_waits_for_it(field: Field) -> None:
    start = event("startEvent", "called", signal("Open"), "") + event(
        "intermediateThrowEvent", "t", signal("Bid"), "called"
    )
    told = chain(field, "Carrier", Door=process(start, SIGNALS), Carrier=trade("Bid", "Open"))
    assert told == [
        "  Door waits at called, for topic /open",
        f"  Carrier and Door wait for each other; {NO_WAY_OUT}",
    ]


def test_a_boundary_event_of_the_activity_can_end_a_circle(field: Field) -> None:
    limit = event("boundaryEvent", "limit", TIMER, "", 'attachedToRef="wait"')
    receive = '<startEvent id="start"/><receiveTask id="wait" messageRef="Go"/>' + limit
    receive += '<sequenceFlow id="f1" sourceRef="start" targetRef="wait"/>'
    receive += event("intermediateThrowEvent", "send", signal("Bid"), "wait")
    go = event("intermediateThrowEvent", "send", '<messageEventDefinition messageRef="Go"/>', "wait")
    content = '<startEvent id="start"/>' + event("intermediateCatchEvent", "wait", signal("Bid"), "start") + go
    messages = SIGNALS + '<message id="Go" name="go"/>'
    told = chain(field, "Carrier", Carrier=process(receive, messages), Door=process(content, messages))
    assert told[-1] == "  Carrier and Door wait for each other; what can end that: Carrier, limit, a timer event"


def test_what_an_outsider_may_send_can_end_a_circle(field: Field) -> None:
    field.middleware.node("shop").publisher("/open", "std_msgs/msg/Empty")
    start = event("startEvent", "called", signal("Open"), "")
    start += event("intermediateThrowEvent", "t", signal("Bid"), "called")
    told = chain(field, "Carrier", Door=process(start, SIGNALS), Carrier=trade("Bid", "Open"))
    assert told[-1] == "  Carrier and Door wait for each other; what can end that: Door, called, for topic /open"


def test_a_robot_on_hold_is_no_part_of_a_deadlock() -> None:
    states = {}
    for robot, other in (("Carrier", "Door"), ("Door", "Carrier")):
        topic = f"/{robot.lower()}"
        token = {"key": "1", "element": "wait", "since": 0, "kind": "topic", "text": f"topic {topic}"}
        states[robot] = RobotState("p", {1: ("p", "running")})
        states[robot].tokens["1"] = token | {"topics": [topic], "publishers": {topic: [f"/{other}/fame_engine"]}}
    states["Door"].tokens["1"] |= {"suspended": True, "by": "a hold of the robot"}
    told = list(WaitChain(states, {}, {}, {}).lines("Carrier", states["Carrier"].tokens["1"]))
    assert told[0] == "  Door waits at wait, for 0.0 s, for topic /door (suspended by a hold of the robot)"
    assert told[1] == "  Carrier and Door wait for each other; what can end that: Door, wait, for topic /door"


def test_a_robot_that_has_not_started_has_not_ended() -> None:
    token = {"element": "wait", "topics": ["/go"], "publishers": {"/go": ["/Door/fame_engine"]}}
    told = list(WaitChain({"Carrier": RobotState("p"), "Door": RobotState("p")}, {}, {}, {}).lines("Carrier", token))
    assert told == ["  Door has not started its process"]


def test_a_page_gets_a_circle_when_it_closes_and_when_it_opens() -> None:
    packer, seen = Packer(Catalogue([]), ["Carrier", "Door"]), {}
    for time, (robot, other) in enumerate((("Carrier", "Door"), ("Door", "Carrier"))):
        token = {"key": "1", "scope": 0, "element": "wait", "since": 0, "kind": "topic", "text": "topic /go"}
        token |= {"topics": ["/go"], "publishers": {"/go": [f"/{other}/fame_engine"]}}
        packer.put(WAITING, time, {"robot": robot, "tokens": [token], "gone": []})
        seen[time] = packer.key_json()["circles"]
    together = f"Carrier and Door wait for each other; {NO_WAY_OUT}"
    assert seen == {0: [], 1: [[0, together], [1, together]]}
    packer.put(WAITING, 5, {"robot": "Carrier", "tokens": [], "gone": ["1"]})
    assert packer.blocks[-1].lists["circles"] == [[1, 0, together], [1, 1, together], [5, 0, ""], [5, 1, ""]]
    assert packer.key_json()["circles"] == []
