"""``queue=N``: a catching event that keeps messages (docs/signals.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    catch,
    correlation,
    element,
    extensions,
    gateway,
    handler,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    user,
)

CORRELATED = correlation("msg.data", "M")


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


def told(id: str, size: int = 0, name: str = "M") -> str:
    """An event that catches a BPMN message."""
    return catch(id, properties(queue=size, type="std_msgs/msg/Int32"), message(name))


@pytest.mark.parametrize("order", ["mu", "um"])
@pytest.mark.parametrize("receive", [False, True])
def test_an_event_behind_an_event_based_gateway_has_one_queue(play: Play, order: str, receive: bool) -> None:
    said = properties(queue=2, type="std_msgs/msg/Int32")
    event = element("receiveTask", "c", said, messageRef="message_M") if receive else told("c", 2)
    run = play(
        start() + user("u") + gateway("eventBased", "g") + event + kept("d", 2) + path("s u g c") + path("g d")
    ).run()
    for step in order:
        run.complete("u") if step == "u" else run.message("M", 3)
    assert (run.status, run.variables["M"]) == ("completed", 3)


def test_what_an_event_keeps_when_its_token_has_passed_is_for_the_next_that_waits(play: Play) -> None:
    content = start() + user("u") + told("c", 2) + told("d") + path("s u c d")
    run = play(content).run().message("M", 1).message("M", 2).complete("u")
    assert (run.status, run.variables["M"], run.node.engine.untaken["/M"]) == ("completed", 2, 0)
    both = gateway("parallel", "f") + path("s f u c") + path("f d")
    run = play(start() + user("u") + told("c", 2) + told("d") + both).run().message("M", 1)
    assert run.waiting == ["u"]  # d has taken it


def test_so_does_what_an_activity_keeps_that_repeats(play: Play) -> None:
    run = play(repeated("true") + told("d") + path("r d")).run()
    run.message("M", 1).message("M", 2).message("M", 3).complete("u")
    assert (run.status, run.variables["found"], run.variables["M"]) == ("completed", [1, 2], 3)


def test_it_also_goes_to_a_token_that_waits_already(play: Play) -> None:
    fork = start() + gateway("parallel", "f") + path("s f u c") + path("f v d")
    run = play(fork + user("u") + told("c", 2) + user("v") + told("d")).run().message("M", 1).message("M", 2)
    assert run.complete("v").waiting == ["u", "d"]  # what c keeps is for its own token
    assert run.complete("u").status == "completed"


def test_a_full_queue_leaves_a_message_to_the_next(play: Play) -> None:
    run = play(start() + user("u") + told("c", 1) + told("d", 1) + path("s u c d")).run()
    assert run.message("M", 1).message("M", 2).complete("u").status == "completed"


def test_a_waiting_token_comes_before_an_open_queue(play: Play) -> None:
    fork = start() + gateway("parallel", "f") + path("s f u c") + path("f d")
    run = play(fork + user("u") + told("c", 1) + told("d", 1)).run().message("M", 1)
    assert run.waiting == ["u"]
    assert run.complete("u").waiting == ["c"]


def test_after_a_suspension_the_oldest_of_a_gateway_wins_too(play: Play) -> None:
    pause = handler("h", start("t", signal("pause")) + user("w") + path("t w"), resume=True)
    content = start() + gateway("eventBased", "g") + kept("a", 1, "A") + kept("b", 1, "B") + path("s g a") + path("g b")
    assert play(content + pause).run().signal("pause").signal("B", 1).signal("A", 2).complete("w").visits["b"] == 1


@pytest.mark.parametrize("by", ["task", "gateway"])
def test_what_starts_a_process_keeps_messages_for_its_next_instance(play: Play, by: str) -> None:
    said = properties(queue=2, type="std_msgs/msg/Int32")
    if by == "task":
        first = element("receiveTask", "r", said, messageRef="message_M", instantiate="true") + path("r u")
    else:
        first = gateway("eventBased", "g", instantiate="true") + told("r", 2) + path("g r u")
    run = play(model(process(first + user("u"), instances=1))).run().message("M", 1).message("M", 2).complete("u")
    assert [instance.variables["M"] for instance in run.simulation.instances] == [1, 2]


def test_each_instance_takes_its_own_of_what_is_kept(play: Play) -> None:
    each = '<zeebe:loopCharacteristics inputCollection="=[1, 2, 3]" inputElement="key"/>'
    several = element("multiInstanceLoopCharacteristics", "i", extensions(each), isSequential="true")
    task = element("receiveTask", "c", properties(queue=5, type="std_msgs/msg/Int32"), several, messageRef="message_M")
    run = play(model(process(start() + user("u") + task + path("s u c")), root=CORRELATED)).run()
    for value in (3, 2, 1):
        run.message("M", value)
    assert run.complete("u").status == "completed"
