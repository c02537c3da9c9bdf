"""Topics and services within one process."""

from typing import Any

import pytest
from hypothesis import given, strategies as st

from fame.clock import SECOND, Kind, Scheduler
from fame.errors import MessageError
from fame.middleware.interface import LATCHED, SENSOR_DATA, Middleware, QoS
from fame.middleware.local import LocalMiddleware
from fame.middleware.messages import create

INT, TEXT = "std_msgs/msg/Int64", "std_msgs/msg/String"


@pytest.fixture
def scheduler() -> Scheduler:
    return Scheduler()


@pytest.fixture
def middleware(scheduler: Scheduler) -> LocalMiddleware:
    return LocalMiddleware(scheduler)


def test_a_message_reaches_the_other_nodes_as_the_same_object(scheduler: Scheduler, middleware: Middleware) -> None:
    seen: list[Any] = []
    middleware.node("engine", "DINGO").subscription("/target_found", TEXT, seen.append)
    publisher = middleware.node("engine", "REX").publisher("/target_found", TEXT)
    message = create(TEXT, "here")
    publisher.publish(message)
    assert seen == []
    scheduler.run()
    assert len(seen) == 1
    assert seen[0] is message
    assert scheduler.now == 0


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 1)), max_size=20))
def test_messages_arrive_in_order_of_publication_then_of_subscription(sends: list[tuple[int, int]]) -> None:
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    topics = ("/a", "/b")
    seen: list[tuple[int, str, int]] = []
    for number in range(3):
        for topic in topics:
            middleware.node(f"reader{number}").subscription(
                topic, INT, lambda message, topic=topic, number=number: seen.append((message.data, topic, number))
            )
    writers = [middleware.node(f"writer{number}") for number in range(3)]
    publishers = [[writer.publisher(topic, INT) for topic in topics] for writer in writers]
    for count, (writer, topic) in enumerate(sends):
        publishers[writer][topic].publish(create(INT, count))
    scheduler.run()
    assert seen == [(count, topics[topic], number) for count, (_, topic) in enumerate(sends) for number in range(3)]


def test_callbacks_are_messages_of_the_scheduler_before_timers_of_the_same_instant(
    scheduler: Scheduler, middleware: Middleware
) -> None:
    seen: list[str] = []
    middleware.node("b").subscription("/x", INT, lambda message: seen.append("message"))
    publisher = middleware.node("a").publisher("/x", INT)
    scheduler.at(5, lambda: publisher.publish(create(INT)), Kind.MESSAGE)
    scheduler.at(5, lambda: seen.append("timer"), Kind.TIMER)
    scheduler.run()
    assert seen == ["message", "timer"]


def test_what_a_callback_publishes_arrives_after_what_was_published_before(
    scheduler: Scheduler, middleware: Middleware
) -> None:
    seen: list[int] = []
    echo = middleware.node("echo")
    back = echo.publisher("/back", INT)
    echo.subscription("/out", INT, lambda message: back.publish(create(INT, -message.data)))
    asker = middleware.node("asker")
    asker.subscription("/back", INT, lambda message: seen.append(message.data))
    out = asker.publisher("/out", INT)
    middleware.node("witness").subscription("/out", INT, lambda message: seen.append(message.data))
    for number in (1, 2):
        out.publish(create(INT, number))
    scheduler.run()
    assert seen == [1, 2, -1, -2]


# ---- types -----------------------------------------------------------------------------------------------------------


def test_a_topic_has_one_type(middleware: Middleware) -> None:
    first = middleware.node("engine", "REX").publisher("/done", "std_msgs/Bool")
    other = middleware.node("engine", "DINGO")
    with pytest.raises(MessageError, match="/done is in use with std_msgs/msg/Bool, by /REX/engine"):
        other.subscription("/done", TEXT, print)
    first.close()
    assert other.publisher("/done", TEXT).type == TEXT


def test_a_name_that_ros_2_refuses_is_refused(middleware: LocalMiddleware) -> None:
    with pytest.raises(MessageError, match="/weed found: ROS 2 refuses this name"):
        middleware.node("engine").publisher("/weed found", TEXT)
    assert middleware.graph() == []


# ---- quality of service ----------------------------------------------------------------------------------------------


def test_ends_that_do_not_match_hear_nothing_and_a_warning_says_why(scheduler: Scheduler) -> None:
    told: list[Any] = []
    middleware = LocalMiddleware(scheduler, on_warning=told.append)
    seen: list[Any] = []
    middleware.node("controller", "REX").subscription("odom", INT, seen.append, QoS(reliability="reliable"))
    middleware.node("world").publisher("/REX/odom", INT, SENSOR_DATA).publish(create(INT))
    scheduler.run()
    assert seen == []
    assert told == middleware.warnings
    assert list(map(str, told)) == [
        "/REX/odom: /REX/controller receives nothing from /world: reliability: offered best_effort, requested reliable"
    ]


def test_a_message_that_was_pushed_out_does_not_move_the_others_forward(
    scheduler: Scheduler, middleware: Middleware
) -> None:
    seen: list[tuple[str, int]] = []
    reader = middleware.node("b")
    reader.subscription("/narrow", INT, lambda message: seen.append(("narrow", message.data)), QoS(depth=1))
    reader.subscription("/wide", INT, lambda message: seen.append(("wide", message.data)))
    writer = middleware.node("a")
    narrow, wide = writer.publisher("/narrow", INT), writer.publisher("/wide", INT)
    narrow.publish(create(INT, 1))
    wide.publish(create(INT, 2))
    narrow.publish(create(INT, 3))
    scheduler.run()
    assert seen == [("wide", 2), ("narrow", 3)]


def test_a_kept_message_whose_lifespan_is_over_is_not_repeated(scheduler: Scheduler, middleware: Middleware) -> None:
    seen: list[int] = []
    publisher = middleware.node("a").publisher("/map", INT, QoS(durability="transient_local", lifespan=1.0))
    publisher.publish(create(INT, 1))
    scheduler.run(until=SECOND)
    publisher.publish(create(INT, 2))
    scheduler.run(until=SECOND + 1)
    middleware.node("b").subscription("/map", INT, lambda message: seen.append(message.data), LATCHED)
    scheduler.run()
    assert seen == [2]


# ---- coming and going ------------------------------------------------------------------------------------------------


def test_closing_the_middleware_closes_everything(middleware: LocalMiddleware) -> None:
    node = middleware.node("a", "A")
    node.publisher("/x", INT)
    node.service("/reset", "std_srvs/Trigger", lambda request: None)
    middleware.close()
    assert (middleware.graph(), middleware.namespaces(), middleware.services) == ([], [], {})


def test_a_tap_that_is_removed_while_it_gets_a_message_gets_no_more(middleware: LocalMiddleware) -> None:
    seen: dict[str, list[Any]] = {"once": [], "always": []}

    def once(message: Any) -> None:
        seen["once"].append(message.data)
        publisher.remove_tap(once)

    publisher: Any = middleware.node("engine", "REX").publisher("/n", INT)
    middleware.tap(lambda publisher: once)
    middleware.tap(lambda publisher: lambda message: seen["always"].append(message.data))
    for number in (1, 2):
        publisher.publish(create(INT, number))
    assert seen == {"once": [1], "always": [1, 2]}
