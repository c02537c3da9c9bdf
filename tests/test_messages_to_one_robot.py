"""A message that is thrown may be for one robot of a pool: property ``to``."""

from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.bpmn import read_text
from fame.check import check
from fame.clock import SECOND, Scheduler
from fame.errors import ModelError
from fame.middleware.interface import SIGNAL
from fame.middleware.local import LocalMiddleware
from fame.robot.endpoints import DirectMessages, direct_topic
from fame.scenario import Result, Scenario

ORDER = '<messageEventDefinition messageRef="Order"/>'


def chain(*ids: str) -> str:
    pairs = pairwise(ids)
    return "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairs)


def throw(id: str, to: str = "", payload: str = "1", tag: str = "intermediateThrowEvent") -> str:
    said = properties(type="std_msgs/msg/Int64", payload=payload, **({"to": to} if to else {}))
    if tag == "sendTask":
        return f'<sendTask id="{id}" messageRef="Order">{said}</sendTask>'
    return f'<{tag} id="{id}">{said}{ORDER}</{tag}>'


def team(boss: str, worker: str = "", workers: int = 3) -> str:
    """A boss, and workers each of which starts with every order."""
    taking = worker or f'<startEvent id="w">{properties(type="std_msgs/msg/Int64")}{ORDER}</startEvent>'
    return document(
        '<message id="Order" name="order"/><collaboration id="C">'
        '<participant id="B" name="Boss" processRef="boss"/><participant id="W" name="Worker" processRef="worker">'
        f'<participantMultiplicity minimum="{workers}"/></participant></collaboration>'
        f'<process id="boss" isExecutable="true"><startEvent id="s"/>{boss}</process>'
        f'<process id="worker" isExecutable="true">{taking}<scriptTask id="t"><script>log(order)</script></scriptTask>'
        f"{chain('w', 't')}</process>"
    )


def run(folder: Path, text: str, duration: float = 5) -> Result:
    path = folder / "team.bpmn"
    path.write_text(text)
    return Scenario.load(path, duration=duration).run()


def taken(result: Result) -> dict[str, list[str]]:
    """What each robot has logged."""
    return {robot.name: [event.detail for event in result.reports if event.robot == robot.name]
            for robot in result.robots}  # fmt: skip


@pytest.mark.parametrize("tag", ["intermediateThrowEvent", "sendTask"])
def test_each_message_reaches_the_robot_that_it_is_for(tmp_path: Path, tag: str) -> None:
    script = '<scriptTask id="a"><script>chosen = "Worker_3"</script></scriptTask>'
    boss = script + throw("m1", "${chosen}", "7", tag) + throw("m2", "Worker_1", "8", tag) + chain("s", "a", "m1", "m2")
    result = run(tmp_path, team(boss))
    assert taken(result) == {"Boss": [], "Worker_1": ["8"], "Worker_2": [], "Worker_3": ["7"]}
    assert result.status == "completed"


def test_an_end_event_too_and_a_name_that_is_put_together(tmp_path: Path) -> None:
    script = '<scriptTask id="a"><script>n = 2</script></scriptTask>'
    result = run(tmp_path, team(script + throw("m", "Worker_${n}", tag="endEvent") + chain("s", "a", "m")))
    assert taken(result)["Worker_2"] == ["1"]
    assert sum(robot.instances for robot in result.robots) == 2


def test_without_it_a_message_reaches_all(tmp_path: Path) -> None:
    result = run(tmp_path, team(throw("m") + chain("s", "m")))
    assert [robot.instances for robot in result.robots] == [1, 1, 1, 1]


@pytest.mark.parametrize("to", ["Worker_9", "Boss", "${3}"])
def test_a_name_that_nobody_has_fails_the_element(tmp_path: Path, to: str) -> None:
    result = run(tmp_path, team(throw("m", to) + chain("s", "m")))
    (error,) = result.robots[0].errors
    assert (result.status, error.code, error.element) == ("failed", "unreachable", "m")
    assert error.text.endswith("takes message /order; robots that do: Worker_1, Worker_2, Worker_3")


def test_two_messages_that_are_the_same_for_one_robot_are_refused(tmp_path: Path) -> None:
    """Each was caught as the other, too."""
    starts = "".join(
        f'<startEvent id="{id}">{properties(type="std_msgs/msg/Int64")}<messageEventDefinition messageRef="{name}"/>'
        "</startEvent>"
        for id, name in (("w", "Order"), ("v", "Own"))
    )
    text = team(throw("m", "Worker_1") + chain("s", "m"), starts)
    with pytest.raises(ModelError, match="messages /order and ~/order are the same if they are for one robot"):
        run(tmp_path, text.replace("<collaboration", '<message id="Own" name="~/order"/><collaboration', 1))


def test_which_a_boundary_event_of_the_task_may_catch(tmp_path: Path) -> None:
    caught = (
        '<boundaryEvent id="b" attachedToRef="m"><errorEventDefinition errorRef="E"/></boundaryEvent>'
        '<scriptTask id="x"><script>log("nobody there")</script></scriptTask>'
    )
    boss = throw("m", "Worker_9", tag="sendTask") + caught + chain("s", "m") + chain("b", "x")
    text = team(boss).replace("<collaboration", '<error id="E" errorCode="unreachable"/><collaboration', 1)
    assert taken(run(tmp_path, text))["Boss"] == ["nobody there"]


def test_a_running_instance_catches_it_before_another_starts(tmp_path: Path) -> None:
    catch = f'<intermediateCatchEvent id="w">{properties(type="std_msgs/msg/Int64")}{ORDER}</intermediateCatchEvent>'
    worker = f'<startEvent id="w0"/>{catch}{chain("w0", "w")}'
    boss = throw("m1", "Worker_2", "5") + throw("m2", "Worker_1", "6") + chain("s", "m1", "m2")
    result = run(tmp_path, team(boss, worker, workers=2))
    assert (result.status, taken(result)) == ("completed", {"Boss": [], "Worker_1": ["6"], "Worker_2": ["5"]})


def test_a_signal_is_for_nobody_alone() -> None:
    text = document(
        '<signal id="S" name="go"/><process id="P"><startEvent id="s"/>'
        f'<endEvent id="e">{properties(to="Worker_1")}<signalEventDefinition signalRef="S"/></endEvent></process>'
    )
    (note,) = read_text(text).notes
    assert (note.level, note.text[:35]) == ("warning", "its property 'to' has no effect: on")


class Slow(LocalMiddleware):
    """One whose ends take a while to connect."""

    busy: tuple[str, ...] = ()

    def connecting(self, node):  # type: ignore[no-untyped-def]
        return list(self.busy)


def test_what_is_sent_before_it_is_connected_waits_in_order() -> None:
    scheduler = Scheduler()
    middleware = Slow(scheduler)
    came: list[int] = []
    worker, boss = middleware.node("engine", "Worker_1"), middleware.node("engine", "Boss")
    worker.subscription(
        direct_topic("/order", "Worker_1"), "std_msgs/msg/Int64", lambda message: came.append(message.data)
    )
    ends: dict[str, object] = {}

    def advertise(topic, type, qos):  # type: ignore[no-untyped-def]
        return ends.setdefault(topic, boss.publisher(topic, type, qos) if topic not in ends else None)

    sender = DirectMessages(boss, middleware, scheduler, advertise)
    sender.add("/order", "std_msgs/msg/Int64", SIGNAL)
    sender.connect()
    assert list(ends) == ["/Worker_1/bpmn_message/order"]
    middleware.busy = tuple(ends)
    for number in (1, 2):
        sender.send("/order", number, "Worker_1")
    scheduler.run(SECOND)
    assert came == []
    middleware.busy = ()
    sender.send("/order", 3, "Worker_1")
    scheduler.run(2 * SECOND)
    assert came == [1, 2, 3]


def test_what_may_not_arrive_is_reported() -> None:
    scheduler = Scheduler()
    middleware = Slow(scheduler)
    worker, boss = middleware.node("engine", "Worker_1"), middleware.node("engine", "Boss")
    taken = worker.subscription(direct_topic("/order", "Worker_1"), "std_msgs/msg/Int64", lambda message: None)
    publisher = boss.publisher(direct_topic("/order", "Worker_1"), "std_msgs/msg/Int64")
    said: list[str] = []
    sender = DirectMessages(boss, middleware, scheduler, lambda topic, type, qos: publisher, said.append)
    sender.add("/order", "std_msgs/msg/Int64", SIGNAL)
    sender.send("/order", 1, "Worker_1")
    assert said == []
    middleware.busy = (publisher.topic,)  # never connected
    sender.send("/order", 2, "Worker_1")
    scheduler.run(4 * SECOND)
    assert said == []
    scheduler.run(6 * SECOND)
    lost = "a message on /Worker_1/bpmn_message/order may be lost: its robot is not connected"
    assert said == [lost]
    sender.send("/order", 3, "Worker_1")
    middleware.busy = ()
    taken.close()  # it leaves while the message waits
    scheduler.run(7 * SECOND)
    assert said == [lost, lost]


def test_what_waits_when_a_robot_ends_is_reported() -> None:
    scheduler = Scheduler()
    middleware = Slow(scheduler)
    middleware.node("engine", "Worker_1").subscription(
        direct_topic("/order", "Worker_1"), "std_msgs/msg/Int64", lambda message: None
    )
    boss, said = middleware.node("engine", "Boss"), list[str]()
    publisher = boss.publisher(direct_topic("/order", "Worker_1"), "std_msgs/msg/Int64")
    middleware.busy = (publisher.topic,)
    sender = DirectMessages(boss, middleware, scheduler, lambda topic, type, qos: publisher, said.append)
    sender.add("/order", "std_msgs/msg/Int64", SIGNAL)
    sender.send("/order", 1, "Worker_1")
    sender.close()
    assert said == ["a message on /Worker_1/bpmn_message/order is not sent: its robot is not connected"]


def test_check_warns_of_a_message_to_a_pool_of_many_without_it() -> None:
    def warnings(text: str) -> list[str]:
        return [finding.text for finding in check(read_text(text)) if "goes to every robot" in finding.text]

    assert warnings(team(throw("m") + chain("s", "m"))) == [
        "its message /order goes to every robot of the pool Worker: property to selects one"
    ]
    assert warnings(team(throw("m", "Worker_1") + chain("s", "m"))) == []
