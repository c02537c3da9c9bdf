"""What every middleware promises, whichever it is."""

import math
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from middleware_contract import BACKENDS, WallWorld, World, middlewares, world

from fame.errors import MessageError
from fame.middleware.interface import LATCHED, SENSOR_DATA, DeferredResponse, QoS
from fame.middleware.messages import create, message_type, to_mapping

INT, TEXT, FLAG = "std_msgs/msg/Int64", "std_msgs/msg/String", "std_msgs/msg/Bool"
SET_BOOL, TRIGGER = "std_srvs/srv/SetBool", "std_srvs/srv/Trigger"


@pytest.fixture(params=BACKENDS)
def here(request: pytest.FixtureRequest) -> Iterator[World]:
    """A world of each backend."""
    made = world(request.param)
    yield made
    made.close()


# ---- topics ----------------------------------------------------------------------------------------------------------


def test_a_message_reaches_the_other_nodes_and_never_inside_publish(here: World) -> None:
    seen: list[Any] = []
    here.node("engine", "DINGO").subscription("/target_found", TEXT, seen.append)
    publisher = here.node("engine", "REX").publisher("/target_found", TEXT)
    here.connect("/target_found")
    message = create(TEXT, "here")
    publisher.publish(message)
    assert seen == []
    here.until(lambda: seen)
    assert seen == [message]


MESSAGES = {
    "std_msgs/msg/Empty": None,
    "geometry_msgs/msg/PoseStamped": {"header": {"frame_id": "map", "stamp": 1.5}, "pose": {"position": {"x": -1.5}}},
    "sensor_msgs/msg/JointState": {"name": ["shoulder", "Ellenbogen ß"], "position": [0.1, -2.5], "effort": []},
    "sensor_msgs/msg/Image": {"height": 240, "width": 320, "encoding": "rgb8", "data": bytes(range(256)) * 900},
    "nav_msgs/msg/Path": {"poses": [{"pose": {"position": {"x": number}}} for number in range(20)]},
    "sensor_msgs/msg/NavSatFix": {"position_covariance": list(range(9)), "status": {"status": -1}},
}


@pytest.mark.long_but("local*", "dds*")
@pytest.mark.parametrize("type", MESSAGES)
def test_a_message_arrives_as_it_was(here: World, type: str) -> None:
    seen: list[Any] = []
    here.node("a").subscription("/x", type, seen.append)
    publisher = here.node("b").publisher("/x", type)
    here.connect("/x")
    message = create(type, MESSAGES[type])
    publisher.publish(message)
    here.until(lambda: seen)
    assert seen == [message]


CARRIED: dict[str, tuple[Any, Any]] = {  # of std_msgs: what `data` is given, and what arrives
    "Bool": (1, True),
    "Byte": (255, 255),
    "Char": (65, 65),
    "Float32": (0.2, 0.20000000298023224),
    "Float64": (1, 1.0),
    "Int8": (-128.0, -128),
    "Int16": (-(2**15), -(2**15)),
    "Int32": (2**31 - 1, 2**31 - 1),
    "Int64": (-(2**63), -(2**63)),
    "UInt8": (True + 1, 2),
    "UInt16": (2**16 - 1, 2**16 - 1),
    "UInt32": (2**32 - 1, 2**32 - 1),
    "UInt64": (2**64 - 1, 2**64 - 1),
    "String": (5, "5"),
    "Float32MultiArray": ([0.2, 1, math.inf], [0.20000000298023224, 1.0, math.inf]),
    "Float64MultiArray": ([0.2, 1], [0.2, 1.0]),
    "ByteMultiArray": ([255, 0], [255, 0]),
    "Int64MultiArray": ((-(2**63), 1.0), [-(2**63), 1]),
    "UInt64MultiArray": ([2**64 - 1], [2**64 - 1]),
}
REFUSED = {
    "std_msgs/msg/Bool": {"data": "maybe"},
    "std_msgs/msg/Float32": {"data": 1e39},
    "std_msgs/msg/Float64": {"data": "far"},
    "std_msgs/msg/UInt8": {"data": 256},
    "std_msgs/msg/Int64": {"data": 0.5},
    "std_msgs/msg/String": {"data": "a\0b"},
    "std_msgs/msg/UInt8MultiArray": {"data": [-1]},
    "rcl_interfaces/msg/ParameterDescriptor": {"integer_range": [{}, {}]},  # of at most one
    "unique_identifier_msgs/msg/UUID": {"uuid": [0] * 15},
    "sensor_msgs/msg/JointState": {"name": [None]},
    "geometry_msgs/msg/PoseStamped": {"header": None},
}


def test_values_arrive_as_a_wire_carries_them_also_where_there_is_none(here: World) -> None:
    seen: dict[str, Any] = {}
    subscriber, node = here.node("a"), here.node("b")
    publishers = {}
    for name in CARRIED:
        subscriber.subscription(f"/{name}", f"std_msgs/msg/{name}", partial(seen.__setitem__, name))
        publishers[name] = node.publisher(f"/{name}", f"std_msgs/msg/{name}")
    here.connect(*(f"/{name}" for name in CARRIED))
    for name, (given, _) in CARRIED.items():
        publishers[name].publish(message_type(f"std_msgs/msg/{name}")(data=given))  # type: ignore[call-arg]
    here.until(lambda: len(seen) == len(CARRIED))
    arrived = {name: to_mapping(seen[name])["data"] for name in CARRIED}
    assert repr(arrived) == repr({name: expected for name, (_, expected) in CARRIED.items()})


@pytest.mark.parametrize("type", REFUSED)
def test_a_message_with_a_value_that_no_wire_carries_is_refused(here: World, type: str) -> None:
    here.node("a").subscription("/x", type, print)
    publisher = here.node("b").publisher("/x", type)
    here.connect("/x")
    with pytest.raises(MessageError, match=next(iter(REFUSED[type]))):
        publisher.publish(message_type(type)(**REFUSED[type]))


def test_a_node_never_hears_itself_but_another_node_of_the_same_name_does(here: World) -> None:
    own: list[Any] = []
    other: list[Any] = []
    node = here.node("engine", "REX")
    node.subscription("done", INT, own.append)
    publisher = node.publisher("done", INT)
    node.subscription("done", INT, own.append)
    here.node("engine", "REX").subscription("done", INT, other.append)
    publisher.publish(create(INT))
    here.until(lambda: other or publisher.publish(create(INT)))
    publisher.publish(create(INT))
    publisher.close()
    here.settle()
    assert own == []


def test_names_are_resolved_in_the_namespace_of_the_node(here: World) -> None:
    seen: list[str] = []
    world, rex = here.node("world"), here.node("engine", "/REX/")
    for topic in ("odom", "~/odom", "/REX/odom"):
        rex.subscription(topic, TEXT, lambda message, topic=topic: seen.append(topic))
    rex.subscription("/odom", TEXT, lambda message: seen.append("global"))
    publisher = world.publisher("REX/odom", TEXT)
    here.connect("/REX/odom")
    publisher.publish(create(TEXT))
    here.until(lambda: len(seen) == 3)
    here.settle()
    assert publisher.topic == "/REX/odom"
    assert sorted(seen) == ["/REX/odom", "odom", "~/odom"]
    assert (rex.namespace, rex.full_name, world.full_name) == ("REX", "/REX/engine", "/world")


def test_messages_of_a_publisher_arrive_in_order(here: World) -> None:
    seen: list[Any] = []
    here.node("b").subscription("/x", INT, lambda message: seen.append(message.data))
    publisher = here.node("a").publisher("/x", INT)
    here.connect("/x")
    for number in range(50):
        publisher.publish(create(INT, number))
    here.until(lambda: len(seen) == 50)
    assert seen == [*range(50)]


def test_a_publisher_that_all_hear_who_can_is_connected(here: World) -> None:
    node = here.node("a")
    for topic, qos in (("/x", QoS()), ("/nobody", QoS()), ("/weak", SENSOR_DATA)):
        node.publisher(topic, INT, qos)
    middleware = next(iter(middlewares(here)))
    assert middleware.connecting(node) == []
    here.node("b").subscription("/x", INT, print)
    here.node("c").subscription("/weak", INT, print)  # which does not match
    here.connect("/x")
    here.settle()
    assert middleware.connecting(node) == []


@pytest.mark.long_but("local*", "dds*")
@pytest.mark.parametrize(("qos", "count"), [(QoS(), 100), (QoS(depth=5), 5), (SENSOR_DATA, 50), (QoS(depth=1), 9)])
def test_what_a_queue_holds_is_not_lost_nor_what_nobody_asked_to_have_in_full(
    here: World, qos: QoS, count: int
) -> None:
    seen, begin = overrun(here, qos, count)
    begin()
    here.until(lambda: len(seen) > 1)
    assert losses(here) == []


@pytest.mark.parametrize("depth", [5, 100])
def test_messages_that_come_faster_than_they_are_taken_are_counted_as_lost(here: World, depth: int) -> None:
    _, begin = overrun(here, QoS(depth=depth), 20 * depth)
    begin()
    here.until(lambda: losses(here) or begin())  # what a slow machine never sent is lost without a trace
    (text,) = losses(here)
    assert re.fullmatch(
        r"/x: /b lost (at least )?[1-9]\d* messages, which came faster than it takes them or not at all", text
    )


def test_the_messages_that_a_slow_subscription_loses_are_counted_by_their_numbers(here: World) -> None:
    seen, begin = overrun(here, QoS(depth=5), 500)
    begin()
    here.until(lambda: 499 in seen)
    assert_counted(here, 501 - len(seen))


@pytest.mark.parametrize("sends", [False, True], ids=["listens", "sends"])
def test_messages_that_are_lost_before_the_first_one_is_taken_are_counted(here: World, sends: bool) -> None:
    """Also if the robot sends on the topic itself, and its own messages push out others."""
    seen: list[int] = []
    robot, qos = here.node("b"), QoS(depth=20)
    robot.subscription("/x", INT, lambda message: seen.append(message.data), qos)
    publisher = here.node("a").publisher("/x", INT, qos)
    here.connect("/x")
    own = robot.publisher("/x", INT, qos)
    for number in range(1000):
        publisher.publish(create(INT, number))
        for _ in range(4 * sends):
            own.publish(create(INT, -1))
    here.arrive()
    publisher.publish(create(INT, 1000))
    here.until(lambda: 1000 in seen)
    assert_counted(here, 1001 - len(seen))


def assert_counted(here: World, lost: int) -> None:
    """Assert what is said about the messages that /b has lost. ROS gives them no numbers: there may be more."""
    (text,) = losses(here)
    if isinstance(here, WallWorld) and type(here.middlewares[0]).__name__.startswith("Ros"):
        found = re.search(r"lost at least (\d+) messages", text)
        assert found is not None
        assert 1 <= int(found[1]) <= lost
    else:
        assert f"/b lost {lost} messages, " in text


def overrun(here: World, qos: QoS, count: int) -> tuple[list[int], Callable[[], None]]:
    """What a subscription gets, and what begins it: so many messages come while it works on the first one."""
    seen: list[int] = []

    def work(message: Any) -> None:
        seen.append(message.data)
        for number in range(count if message.data < 0 else 0):
            publisher.publish(create(INT, number))

    here.node("b").subscription("/x", INT, work, qos)
    publisher = here.node("a").publisher("/x", INT, qos)
    here.connect("/x")
    return seen, lambda: publisher.publish(create(INT, -1))


def losses(here: World) -> list[str]:
    return [text for middleware in middlewares(here) for text in middleware.losses()]


# ---- types -----------------------------------------------------------------------------------------------------------


def test_a_topic_has_one_type(here: World) -> None:
    node = here.node("engine", "REX")
    first = node.publisher("/done", "std_msgs/Bool")
    with pytest.raises(MessageError, match="/done is in use with std_msgs/msg/Bool, by /REX/engine"):
        node.subscription("/done", TEXT, print)
    first.close()
    assert node.publisher("/done", TEXT).type == TEXT


def test_an_unknown_type_is_refused(here: World) -> None:
    node = here.node("engine")
    with pytest.raises(MessageError, match="did you mean std_msgs/msg/Bool"):
        node.publisher("/done", "std_msg/Bool")
    with pytest.raises(MessageError, match="did you mean std_msgs/msg/Bool"):
        node.subscription("/done", "std_msg/Bool", print)


@pytest.mark.long_but("local*", "dds*")
@pytest.mark.parametrize("thing", [True, {"data": True}, None, create(INT)])
def test_only_messages_of_the_type_can_be_published(here: World, thing: object) -> None:
    publisher = here.node("engine").publisher("/done", "std_msgs/Bool")
    with pytest.raises(MessageError, match=r"std_msgs/msg/Bool: /done: expected a message, got .*"):
        publisher.publish(thing)


# ---- quality of service ----------------------------------------------------------------------------------------------


@pytest.mark.long_but("local*", "dds-*")
@pytest.mark.parametrize(
    ("offered", "requested", "reason"),
    [
        (SENSOR_DATA, QoS(), "reliability: offered best_effort, requested reliable"),
        (QoS(), LATCHED, "durability: offered volatile, requested transient_local"),
        (QoS(deadline=2.0), QoS(deadline=1.0), "deadline: offered 2 s, requested 1 s"),
        (QoS(), QoS(lease_duration=0.5), "lease_duration: offered infinite, requested 0.5 s"),
        (QoS(), QoS(liveliness="manual_by_topic"), "liveliness: offered automatic, requested manual_by_topic"),
    ],
)
def test_ends_that_do_not_match_hear_nothing_and_a_warning_says_why(
    here: World, offered: QoS, requested: QoS, reason: str
) -> None:
    seen: list[Any] = []
    here.node("controller", "REX").subscription("odom", INT, seen.append, requested)
    publisher = here.node("world").publisher("/REX/odom", INT, offered)
    publisher.publish(create(INT))
    expected = f"/REX/odom: /REX/controller receives nothing from /world: {reason}"
    here.until(lambda: here.warnings == [expected])
    publisher.publish(create(INT))
    here.settle()
    assert seen == []


@pytest.mark.parametrize("here", [each for each in BACKENDS if "apart" in str(each)], indirect=True)
def test_another_type_on_the_topic_elsewhere_is_a_mismatch_told_on_both_sides(here: World) -> None:
    seen: list[Any] = []
    here.node("a").subscription("/x", TEXT, seen.append)
    here.node("b").publisher("/x", INT).publish(create(INT, 1))
    text = f"/x: /a receives nothing from /b: type: offered {INT}, requested {TEXT}"
    here.until(lambda: [list(map(str, each.warnings)) for each in middlewares(here)] == [[text], [text]])
    assert next(info for info in middlewares(here)[0].graph() if info.name == "/x").types == (INT, TEXT)
    here.node("c").publisher("/x", INT)
    later = text.replace("/b", "/c")
    here.until(lambda: list(map(str, middlewares(here)[0].warnings)) == [text, later])
    assert seen == []


@pytest.mark.long_but("local*", "dds*")
@pytest.mark.parametrize(
    ("qos", "expected"),
    [
        (QoS(depth=2), [3, 4]),
        (QoS(depth=1), [4]),
        (QoS(depth=10), [0, 1, 2, 3, 4]),
        (QoS(history="keep_all", depth=1), [0, 1, 2, 3, 4]),
    ],
)
def test_keep_last_bounds_what_waits(here: World, qos: QoS, expected: list[int]) -> None:
    seen: list[int] = []
    here.node("b").subscription("/x", INT, lambda message: seen.append(message.data), qos)
    publisher = here.node("a").publisher("/x", INT)
    here.connect("/x")
    for number in range(5):
        publisher.publish(create(INT, number))
    here.arrive()
    here.until(lambda: seen[-1:] == [4])
    assert seen == expected
    publisher.publish(create(INT, 9))
    here.until(lambda: seen[-1:] == [9])
    assert seen == [*expected, 9]


def test_who_comes_late_gets_the_last_messages_of_a_transient_local_publisher_if_he_asks(here: World) -> None:
    late: list[int] = []
    volatile: list[int] = []
    publisher = here.node("a").publisher("/map", INT, QoS(durability="transient_local", depth=2))
    for number in range(4):
        publisher.publish(create(INT, number))
    wants_all = QoS(durability="transient_local")
    here.node("b").subscription("/map", INT, lambda message: late.append(message.data), wants_all)
    here.node("c").subscription("/map", INT, lambda message: volatile.append(message.data))
    here.connect("/map")
    here.until(lambda: late == [2, 3])
    publisher.publish(create(INT, 9))
    here.until(lambda: volatile == [9] and late == [2, 3, 9])


def test_a_publisher_that_left_leaves_nothing_for_late_joiners(here: World) -> None:
    seen: list[Any] = []
    publisher = here.node("a").publisher("/map", INT, LATCHED)
    publisher.publish(create(INT))
    publisher.close()
    here.node("b").subscription("/map", INT, seen.append, LATCHED)
    here.settle()
    assert seen == []


# ---- coming and going ------------------------------------------------------------------------------------------------


def test_the_graph_shows_every_topic_with_an_end(here: World) -> None:
    rex, dingo = here.node("engine", "REX"), here.node("engine", "DINGO")
    rex.publisher("/done", "std_msgs/Bool")
    dingo.publisher("/done", "std_msgs/Bool")
    end = dingo.subscription("/done", "std_msgs/Bool", print)
    rex.subscription("odom", "nav_msgs/Odometry", print)
    done = ("/done", (FLAG,), ("/DINGO/engine", "/REX/engine"), ("/DINGO/engine",))
    odom = ("/REX/odom", ("nav_msgs/msg/Odometry",), (), ("/REX/engine",))
    for middleware in middlewares(here):
        here.until(lambda middleware=middleware: _graph(middleware) == [odom, done])
        assert middleware.namespaces() == ["DINGO", "REX"]
    end.close()
    for middleware in middlewares(here):
        here.until(lambda middleware=middleware: _graph(middleware)[1][3] == ())
    dingo.close()
    for middleware in middlewares(here):
        here.until(lambda middleware=middleware: middleware.namespaces() == ["REX"])
    rex.close()
    rex.close()
    for middleware in middlewares(here):
        here.until(lambda middleware=middleware: (_graph(middleware), middleware.namespaces()) == ([], []))


def _graph(middleware: Any) -> list[tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]]:
    return [
        (info.name, info.types, tuple(sorted(info.publishers)), tuple(sorted(info.subscribers)))
        for info in middleware.graph()
    ]


def test_a_closed_subscription_gets_nothing_not_even_what_waited_for_it(here: World) -> None:
    seen: list[Any] = []
    node = here.node("b")
    subscription = node.subscription("/x", INT, seen.append)
    publisher = here.node("a").publisher("/x", INT)
    here.connect("/x")
    for number in range(3):
        publisher.publish(create(INT, number))
    here.until(lambda: seen)
    publisher.publish(create(INT, 3))
    subscription.close()
    subscription.close()
    heard = len(seen)
    publisher.publish(create(INT, 4))
    here.settle()
    assert len(seen) == heard
    assert 4 not in [message.data for message in seen]


def test_a_callback_may_close_its_own_subscription(here: World) -> None:
    seen: list[int] = []

    def once(message: Any) -> None:
        seen.append(message.data)
        subscription.close()

    subscription = here.node("b").subscription("/x", INT, once)
    publisher = here.node("a").publisher("/x", INT)
    here.connect("/x")
    publisher.publish(create(INT, 1))
    publisher.publish(create(INT, 2))
    here.until(lambda: seen)
    here.settle()
    assert seen == [1]


def test_what_was_published_arrives_even_if_the_publisher_left(here: World) -> None:
    seen: list[Any] = []
    here.node("b").subscription("/x", INT, seen.append)
    node = here.node("a")
    publisher = node.publisher("/x", INT)
    here.connect("/x")
    publisher.publish(create(INT))
    node.close()
    here.until(lambda: len(seen) == 1)
    with pytest.raises(MessageError, match="the publisher on /x is closed"):
        publisher.publish(create(INT))


def test_a_closed_middleware_is_closed_again_without_harm(here: World) -> None:
    node = here.node("a", "A")
    node.publisher("/x", INT)
    node.subscription("/x", INT, print)
    node.service("/reset", TRIGGER, lambda request: None)
    here.close()
    here.close()


# ---- services --------------------------------------------------------------------------------------------------------


def test_a_service_answers_in_the_order_of_the_calls_and_never_inside_call(here: World) -> None:
    seen: list[tuple[int, bool, str]] = []
    here.node("gripper", "ARM").service(
        "grip", "std_srvs/SetBool", lambda request: {"success": request.data, "message": "done"}
    )
    client = here.node("engine", "ARM").client("grip", SET_BOOL)
    here.until(lambda: client.available)
    for number, value in enumerate((True, False) * 3):
        client.call({"data": value}, lambda response, n=number: seen.append((n, response.success, response.message)))
    assert seen == []
    here.until(lambda: len(seen) == 6)
    assert seen == [(number, value, "done") for number, value in enumerate((True, False) * 3)]


def test_each_client_gets_its_own_responses(here: World) -> None:
    here.node("gripper").service("/grip", SET_BOOL, lambda request: {"success": request.data})
    seen: dict[bool, list[bool]] = {True: [], False: []}
    clients = {value: here.node(f"client_{value}").client("/grip", SET_BOOL) for value in seen}
    here.until(lambda: all(client.available for client in clients.values()))
    for _ in range(3):
        for value, client in clients.items():
            client.call(value, lambda response, heard=seen[value]: heard.append(response.success))
    here.until(lambda: seen == {True: [True] * 3, False: [False] * 3})


def test_a_burst_of_requests_is_answered_whole(here: World) -> None:
    """More come before anybody takes one than ROS keeps of a service, as over a link that has lost the first."""
    here.node("gripper").service("/grip", SET_BOOL, lambda request: {"success": request.data})
    clients, answered = [here.node(f"client_{number}").client("/grip", SET_BOOL) for number in range(2)], list[int]()
    here.until(lambda: all(client.available for client in clients))
    for _ in range(60):
        for number, client in enumerate(clients):
            client.call(True, lambda response, number=number: answered.append(number))
    here.until(lambda: len(answered) == 120)
    assert answered.count(0) == 60


def test_a_service_takes_and_gives_defaults_for_none_within_a_node_too(here: World) -> None:
    seen: list[Any] = []
    node = here.node("a")
    node.service("/reset", "std_srvs/Trigger", lambda request: None)
    client = node.client("/reset", "std_srvs/Trigger")
    here.until(lambda: client.available)
    client.call(None, seen.append)
    here.until(lambda: seen)
    assert seen == [create("std_srvs/srv/Trigger_Response")]


def test_calls_that_cannot_succeed_are_refused_at_once(here: World) -> None:
    node = here.node("a")
    client = node.client("/grip", SET_BOOL)
    assert not client.available
    with pytest.raises(MessageError, match="no node offers the service /grip"):
        client.call(None, print)
    service = node.service("/grip", SET_BOOL, lambda request: None)
    here.until(lambda: client.available)
    with pytest.raises(MessageError, match="data: expected true or false, got 'open'"):
        client.call({"data": "open"}, print)
    with pytest.raises(MessageError, match="the service /grip is offered by /a already"):
        node.service("/grip", SET_BOOL, lambda request: None)
    with pytest.raises(MessageError, match="the service /grip is of type std_srvs/srv/SetBool"):
        node.client("/grip", TRIGGER).call(None, print)
    service.close()
    here.until(lambda: not client.available)


def test_a_response_that_does_not_fit_is_the_fault_of_the_service(here: World) -> None:
    node = here.node("a")
    node.service("/grip", SET_BOOL, lambda request: {"ok": True})
    client = node.client("/grip", SET_BOOL)
    here.until(lambda: client.available)
    client.call(None, print)
    with pytest.raises(MessageError, match="std_srvs/srv/SetBool_Response: ok: there is no such field"):
        here.until(lambda: False)


def test_a_response_may_come_later(here: World) -> None:
    seen: list[str] = []
    later: list[DeferredResponse] = []
    node = here.node("a")

    def asked(request: Any) -> DeferredResponse:
        later.append(DeferredResponse())
        if request.data:
            later[-1].respond({"message": "known already"})
        return later[-1]

    node.service("/grip", SET_BOOL, asked)
    client = node.client("/grip", SET_BOOL)
    here.until(lambda: client.available)
    client.call(False, lambda response: seen.append(response.message))
    here.until(lambda: later)
    client.call(True, lambda response: seen.append(response.message))
    here.until(lambda: seen == ["known already"])
    later[0].respond({"message": "now"})
    here.until(lambda: seen == ["known already", "now"])


def test_a_service_or_client_that_leaves_meanwhile_drops_the_call(here: World) -> None:
    seen: list[Any] = []
    service = here.node("a").service("/reset", TRIGGER, lambda request: None)
    staying, leaving = (here.node(name).client("/reset", TRIGGER) for name in ("b", "c"))
    here.until(lambda: staying.available and leaving.available)
    leaving.call(None, seen.append)
    leaving.close()
    here.settle()
    staying.call(None, seen.append)
    service.close()
    here.until(lambda: here.warnings == ["/reset: the service was closed before it answered /b"])
    assert seen == []
