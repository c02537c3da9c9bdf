"""Events that throw several things, and gateways that start a process (standard 10.5.3, 13.4.6)."""

import pytest
from conftest import Play
from engine_models import (
    TERMINATE,
    Run,
    boundary,
    catch,
    condition,
    correlation,
    element,
    end,
    error,
    gateway,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    user,
)

from fame.errors import ModelError


def test_a_multiple_throwing_event_throws_all_in_document_order(play: Play) -> None:
    content = start() + gateway("parallel", "g") + catch("b", signal("B")) + catch("a", signal("A"))
    content += throw("t", signal("A"), signal("B")) + end() + path("s g b") + path("g a") + path("g t e")
    run = play(content).run()
    assert run.log == "s g (b (a t a) b) e =completed"
    assert run.visits["t"] == 1


def test_a_multiple_end_event_may_end_with_an_error(play: Play) -> None:
    inner = start("t") + end("x", signal("A"), error("E")) + path("t x")
    content = start() + catch("c", signal("A")) + sub("p", inner) + boundary("b", "p", error("E")) + path("s c")
    assert play(content + path("s p")).run().log == "s (c (p t x c) x!E b -p =completed"


def test_nothing_can_follow_what_ends_the_token() -> None:
    with pytest.raises(ModelError, match="put it last"):
        Run(start() + end("x", TERMINATE, signal("A")) + path("s x"))
    link = '<linkEventDefinition name="L"/>'
    with pytest.raises(ModelError, match="put it last"):  # the signal was not thrown
        Run(start() + throw("x", link, signal("A")) + catch("c", link) + end() + path("s x") + path("c e"))


BEGINNING = gateway("eventBased", "g", instantiate="true") + catch("a", signal("A")) + catch("b", signal("B"))
BEGINNING += script("k") + user("u") + path("g a k u") + path("g b u")


def test_an_event_based_gateway_may_start_a_process(play: Play) -> None:
    run = play(BEGINNING).run()
    assert run.simulation.instances == []
    assert run.signal("B").log == "g b (u"


def test_each_of_its_events_starts_an_instance_of_its_own(play: Play) -> None:
    run = play(BEGINNING).run().signal("A").signal("B").signal("A")
    assert run.log == "g a k (u g b (u g a k (u"
    assert len(run.simulation.instances) == 3


ALL = BEGINNING.replace('instantiate="true"', 'instantiate="true" eventGatewayType="Parallel"')


def test_a_parallel_one_starts_it_with_the_first_and_waits_for_the_others(play: Play) -> None:
    run = play(ALL).run().signal("B")
    assert run.log == "g b (u (a"
    run.signal("B").signal("A")
    assert run.log == "g b (u (a g b (u a a) k (u k (u"
    assert len(run.simulation.instances) == 2


def test_what_one_instance_waits_for_starts_no_other(play: Play) -> None:
    run = play(ALL).run().signal("A").signal("B")
    assert run.log == "g a k (u b (u"
    assert len(run.simulation.instances) == 1
    run.complete("u").complete("u")
    assert run.instance.status == "completed"
    assert not run.left_behind()


def test_its_messages_correlate(play: Play) -> None:
    content = ALL.replace(signal("A"), message("A")).replace(signal("B"), message("B"))
    run = play(model(process(content), root=correlation('msg["key"]', "A", "B"))).run()
    run.message("A", {"key": 1}).message("B", {"key": 2}).message("B", {"key": 1})
    assert [sorted(instance.waiting) for instance in run.simulation.instances] == [["u", "u"], ["a", "u"]]


def test_a_receive_task_may_start_a_process(play: Play) -> None:
    receive = element("receiveTask", "r", properties(type="std_msgs/msg/Int32"), messageRef="message_M",
                      instantiate="true")  # fmt: skip
    run = play(receive + user("u") + path("r u")).run()
    assert run.simulation.instances == []
    run.message("M", 4).message("M", 5)
    assert run.log == "r (u r (u"
    assert [instance.variables["M"] for instance in run.simulation.instances] == [4, 5]


def test_it_does_not_repeat_then() -> None:
    loop = '<standardLoopCharacteristics loopMaximum="2"/>'
    with pytest.raises(ModelError, match=r"test.bpmn:1: r: a receive task that starts a process must not repeat"):
        Run(element("receiveTask", "r", loop, messageRef="message_M", instantiate="true"))


def test_with_an_incoming_flow_it_waits_like_any_other(play: Play) -> None:
    receive = element("receiveTask", "r", messageRef="message_M", instantiate="true")
    assert play(start() + receive + path("s r")).run().waiting == ["r"]


def test_a_condition_cannot_start_a_process() -> None:
    with pytest.raises(ModelError, match=r"test.bpmn:1: s: conditional events cannot start a process: it has no"):
        Run(start("s", condition("x > 0")) + user("u") + path("s u"))
