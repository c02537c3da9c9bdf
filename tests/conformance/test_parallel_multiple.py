"""Parallel multiple events wait for all of their triggers (standard 10.5.3, 13.5.3)."""

from conftest import Play
from engine_models import (
    boundary,
    catch,
    condition,
    correlation,
    end,
    handler,
    message,
    model,
    path,
    process,
    properties,
    signal,
    start,
    timer,
    user,
)

ALL = {"parallelMultiple": "true"}


def all_of(id: str, *content: str) -> str:
    return catch(id, *content, **ALL)


def test_a_catching_event_waits_for_all_of_its_triggers(play: Play) -> None:
    run = play(start() + all_of("c", signal("A"), signal("B"), timer("PT5S")) + end() + path("s c e")).run(1)
    run.signal("B").signal("B")
    assert run.waiting == ["c"]
    run.signal("A")
    assert run.waiting == ["c"]
    assert run.run(6).log == "s c e =completed"
    assert not run.left_behind()


def test_one_delivery_may_be_several_of_them(play: Play) -> None:
    assert play(start() + all_of("c", signal("A"), condition("A == 1")) + path("s c"), {"A": 0}).run().waiting == ["c"]


def test_a_boundary_event_fires_when_all_have_come(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", signal("A"), signal("B"), **ALL) + path("s u")
    run = play(content).run().signal("A")
    assert run.waiting == ["u"]
    assert run.signal("B").log == "s (u b -u =completed"
    assert not run.left_behind()


def test_one_that_does_not_interrupt_waits_for_all_again(play: Play) -> None:
    content = (
        start() + user("u") + boundary("b", "u", signal("A"), signal("B"), interrupting=False, **ALL) + path("s u")
    )
    run = play(content).run()
    for _ in range(3):
        run.signal("A").signal("A").signal("B")
    assert run.visits["b"] == 3
    assert run.complete("u").left_behind() == {}


def test_an_event_sub_process_begins_when_all_have_come(play: Play) -> None:
    begin = start("t", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')
    run = play(start() + user("u") + path("s u") + handler("h", begin)).run().signal("B")
    assert run.log == "s (u"
    assert run.signal("A").log == "s (u -u (h t h) =completed"


def test_what_came_before_a_suspension_counts_after_it(play: Play) -> None:
    pause = handler("h", start("t", signal("P")) + user("w") + path("t w"), resume=True)
    content = start() + all_of("c", signal("A"), signal("B")) + path("s c") + pause
    run = play(content).run().signal("A").signal("P").signal("B").complete("w")
    assert run.waiting == ["c"]
    assert run.signal("B").status == "completed"


def test_one_that_suspends_waits_for_all_again_afterwards(play: Play) -> None:
    begin = start("t", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')
    content = start() + user("u") + path("s u") + handler("h", begin + user("w") + path("t w"), resume=True)
    run = play(content).run().signal("A").signal("B").signal("A").complete("w").signal("B")
    assert run.waiting == ["u"]
    assert run.signal("A").waiting == ["u", "w"]


TOGETHER = start("s", signal("A"), signal("B")).replace("isInterrupting", 'parallelMultiple="true" isInterrupting')


def test_a_process_starts_when_all_have_come(play: Play) -> None:
    run = play(TOGETHER + user("u") + path("s u")).run().signal("B").signal("B")
    assert run.simulation.instances == []
    assert run.signal("A").log == "s (u"
    assert not run.node.engine.gathered
    run.signal("A")
    assert len(run.simulation.instances) == 1
    assert len(run.signal("B").simulation.instances) == 2


def test_each_brings_its_message_and_of_two_the_first_counts(play: Play) -> None:
    begin = TOGETHER.replace("</startEvent>", properties(type="std_msgs/msg/Int32") + "</startEvent>")
    run = play(begin + user("u") + path("s u")).run().signal("A", 1).signal("A", 2).signal("B", 3)
    assert run.variables == {"A": 1, "B": 3}


def test_a_timer_may_be_one_of_them(play: Play) -> None:
    begin = TOGETHER.replace(signal("B"), timer("PT5S"))
    run = play(begin + user("u") + path("s u")).run(1).signal("A").run(4)
    assert run.simulation.instances == []
    assert run.run(6).waiting == ["u"]


def test_messages_of_one_key_belong_together(play: Play) -> None:
    root = correlation('msg["key"]', "A", "B")
    begin = TOGETHER.replace(signal("A"), message("A")).replace(signal("B"), message("B"))
    run = (
        play(model(process(begin + user("u") + path("s u")), root=root))
        .run()
        .message("A", {"key": 1})
        .message("B", {"key": 2})
    )
    assert run.simulation.instances == []
    run.message("B", {"key": 1}).message("A", {"key": 2})
    assert [instance.variables["key"] for instance in run.simulation.instances] == [1, 2]
    assert not run.node.engine.gathered


def test_the_bound_of_instances_holds_for_it(play: Play) -> None:
    run = play(model(process(TOGETHER + user("u") + path("s u"), instances=1))).run()
    for name in "ABAB":
        run.signal(name)
    assert len(run.simulation.instances) == 1
    assert "trigger dropped" in run.reports[0]


QUEUED = TOGETHER.replace("</startEvent>", properties(type="std_msgs/msg/Int32", queue=2) + "</startEvent>")


def test_with_a_queue_those_that_come_again_begin_the_next_instance(play: Play) -> None:
    run = play(QUEUED + user("u") + path("s u")).run()
    for number in (1, 2, 3):
        run.signal("A", number)
    assert [instance.variables for instance in run.signal("B", 4).signal("B", 5).simulation.instances] == [
        {"A": 2, "B": 4},
        {"A": 3, "B": 5},
    ]
    assert not run.node.engine.gathered


def test_a_queue_keeps_all_parts_while_no_further_instance_may_run(play: Play) -> None:
    run = play(model(process(QUEUED + user("u") + path("s u"), instances=1))).run().signal("A", 1).signal("B", 2)
    for name, number in (("A", 3), ("A", 4), ("B", 5), ("B", 6)):
        run.signal(name, number)
    run.complete("u").complete("u").complete("u")
    assert [instance.variables for instance in run.simulation.instances] == [
        {"A": 1, "B": 2},
        {"A": 3, "B": 5},
        {"A": 4, "B": 6},
    ]
    assert not run.reports
    assert not run.node.engine.gathered


def test_a_queue_keeps_what_a_timer_would_complete(play: Play) -> None:
    begin = start("q", signal("Q")) + QUEUED.replace(signal("B"), timer("PT5S"))
    content = begin + user("u") + path("s u") + path("q u")
    run = play(model(process(content, instances=1))).run(1).signal("A", 1).signal("Q").run(6)
    assert not run.reports
    assert run.complete("u").simulation.instances[1].variables == {"A": 1}
