"""``queue=N``: a catching event that keeps messages (docs/semantics.md, section 6)."""

from __future__ import annotations

from conftest import Play
from engine_models import (
    boundary,
    catch,
    element,
    extensions,
    gateway,
    handler,
    path,
    properties,
    script,
    signal,
    start,
    sub,
    user,
)


def kept(id: str, size: int, name: str = "A") -> str:
    return catch(id, properties(queue=size, type="std_msgs/msg/Int32"), signal(name))


def test_a_queue_keeps_messages_from_the_time_its_scope_is_entered(play: Play) -> None:
    run = play(start() + user("u") + kept("c", 1) + path("s u c")).run().signal("A", 7)
    assert run.waiting == ["u"]
    assert run.complete("u").log == "s u c =completed"
    assert run.variables["A"] == 7


def test_without_a_queue_they_are_lost(play: Play) -> None:
    run = play(start() + user("u") + catch("c", signal("A")) + path("s u c")).run().signal("A").complete("u")
    assert run.waiting == ["c"]


def test_a_queue_gives_the_oldest_first(play: Play) -> None:
    content = start() + user("u") + kept("c", 5) + script("n", "found = found + [A]") + path("s u c n c")
    run = play(content, {"found": []}).run().signal("A", 1).signal("A", 2).complete("u")
    assert run.variables["found"] == [1, 2]
    assert run.waiting == ["c"]


def test_a_queue_keeps_the_last_n(play: Play) -> None:
    content = start() + user("u") + kept("c", 2) + script("n", "found = found + [A]") + path("s u c n c")
    run = play(content, {"found": []}).run()
    for value in range(5):
        run.signal("A", value)
    assert run.complete("u").variables["found"] == [3, 4]


def test_a_message_for_a_waiting_token_is_not_kept(play: Play) -> None:
    content = start() + kept("c", 5) + user("u") + path("s c u c")
    run = play(content).run().signal("A", 1).complete("u")
    assert run.waiting == ["c"]


def test_each_event_has_a_queue_of_its_own(play: Play) -> None:
    content = start() + user("u") + kept("c", 1) + kept("d", 1) + path("s u c d")
    assert play(content).run().signal("A", 1).complete("u").status == "completed"


def test_a_queue_ends_with_its_scope(play: Play) -> None:
    content = start() + sub("p", user("u") + kept("c", 3) + path("u c")) + user("w") + path("s p w p")
    run = play(content).run().signal("A", 1).signal("A", 2).complete("u")
    assert run.waiting == ["w"]
    run.signal("A", 3).complete("w").complete("u")
    assert run.waiting == ["c"]


def test_a_receive_task_may_have_a_queue(play: Play) -> None:
    task = (
        '<receiveTask id="r" messageRef="message_M">'
        + properties(queue=1, type="std_msgs/msg/Int32")
        + "</receiveTask>"
    )
    run = play(start() + user("u") + task + path("s u r")).run().message("M", 3).complete("u")
    assert (run.status, run.variables["M"]) == ("completed", 3)


def repeated(sequential: str) -> str:
    each = '<zeebe:loopCharacteristics inputCollection="=[1, 2]" outputCollection="found" outputElement="=M"/>'
    several = element("multiInstanceLoopCharacteristics", "i", extensions(each), isSequential=sequential)
    said = properties(queue=5, type="std_msgs/msg/Int32")
    return start() + user("u") + element("receiveTask", "r", said, several, messageRef="message_M") + path("s u r")


def test_so_may_one_that_repeats(play: Play) -> None:
    run = play(repeated("true")).run().message("M", 1).message("M", 2).complete("u")
    assert (run.status, run.variables["found"]) == ("completed", [1, 2])
    run = play(repeated("true")).run().message("M", 1).complete("u").message("M", 3)
    assert (run.status, run.variables["found"]) == ("completed", [1, 3])


def test_instances_beside_each_other_take_one_message_each(play: Play) -> None:
    run = play(repeated("false")).run().message("M", 1).message("M", 2).complete("u")
    assert (run.status, run.variables["found"]) == ("completed", [1, 2])
    run = play(repeated("false")).run().complete("u").message("M", 1)
    assert run.waiting == ["r"]
    run.message("M", 2)
    assert (run.status, run.variables["found"]) == ("completed", [1, 2])
    assert not run.left_behind()


def test_the_queue_of_a_boundary_event_lives_as_long_as_its_activity(play: Play) -> None:
    """While its activity is suspended it keeps what comes."""
    pause = handler("h", start("t", signal("pause")) + user("w") + path("t w"), resume=True)
    armed = boundary("b", "u", properties(queue=1), signal("A"))
    run = play(start() + user("u") + armed + path("s u") + pause).run().signal("pause").signal("A").complete("w")
    assert run.log == "s (u (h t w h) b -u =completed"


def test_of_queued_messages_the_oldest_arrival_wins_at_an_event_based_gateway(play: Play) -> None:
    content = start() + user("u") + gateway("eventBased", "g") + kept("a", 1, "A") + kept("b", 1, "B")
    content += path("s u g a") + path("g b")
    assert play(content).run().signal("B", 1).signal("A", 2).complete("u").log == "s u g b =completed"
    assert play(content).run().signal("A", 1).signal("B", 2).complete("u").log == "s u g a =completed"
