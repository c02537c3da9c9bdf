"""Start events of a process (docs/semantics.md)."""

from conftest import Play
from engine_models import (
    catch,
    handler,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    throw,
    timer,
    user,
)

STARTED = start("s", properties(type="std_msgs/msg/Int32"), signal("go")) + user("u") + path("s u")


def test_a_signal_start_event_starts_an_instance_for_each_message(play: Play) -> None:
    run = play(STARTED).run()
    assert run.simulation.instances == []
    run.signal("go", 1).signal("go", 2)
    assert [instance.variables["go"] for instance in run.simulation.instances] == [1, 2]


def test_also_after_one_has_ended(play: Play) -> None:
    run = play(STARTED).run().signal("go", 1).complete("u").signal("go", 2)
    assert [instance.status for instance in run.simulation.instances] == ["completed", "running"]


def test_instances_bounds_those_not_yet_ended_and_drops_further_triggers(play: Play) -> None:
    run = play(model(process(STARTED, instances=1))).run().signal("go", 1).signal("go", 2).complete("u")
    assert len(run.simulation.instances) == 1
    assert "trigger dropped" in run.reports[0]
    assert len(run.signal("go", 3).simulation.instances) == 2


def test_a_start_event_with_a_queue_keeps_further_triggers(play: Play) -> None:
    queued = STARTED.replace('name="type"', 'name="queue" value="2"/><camunda:property name="type"')
    run = play(model(process(queued, instances=1))).run()
    for number in range(4):
        run.signal("go", number)
    for _ in range(3):
        run.complete("u")
    assert [instance.variables["go"] for instance in run.simulation.instances] == [0, 2, 3]
    assert not run.reports
    assert not run.left_behind()


def test_an_instance_does_not_catch_the_message_that_started_it(play: Play) -> None:
    content = start("s", signal("go")) + catch("c", signal("go")) + path("s c")
    run = play(content).run().signal("go")
    assert run.waiting == ["c"]


def test_nor_does_its_event_sub_process(play: Play) -> None:
    content = start("s", signal("go")) + user("u") + path("s u") + handler("h", start("t", signal("go")))
    assert play(content).run().signal("go").log == "s (u"


def test_start_events_come_last(play: Play) -> None:
    content = start("s", signal("go")) + catch("c", signal("go")) + path("s c")
    run = play(content).run().signal("go").signal("go")
    assert run.log == "s c =completed s (c"
    assert [instance.status for instance in run.simulation.instances] == ["completed", "running"]


def test_a_process_may_start_by_itself_and_by_signals(play: Play) -> None:
    content = start("n") + start("s", signal("go")) + user("u") + path("n u") + path("s u")
    assert len(play(content).run().signal("go").simulation.instances) == 2


def test_a_start_event_with_several_triggers_starts_by_any(play: Play) -> None:
    run = play(start("s", signal("A"), signal("B")) + user("u") + path("s u")).run().signal("B").signal("A")
    assert len(run.simulation.instances) == 2


def test_a_timer_starts_an_instance_each_time(play: Play) -> None:
    run = play(start("s", timer("R3/PT10S", "Cycle")) + script("a") + path("s a"))
    assert len(run.run(25).simulation.instances) == 2
    assert len(run.run().simulation.instances) == 3


def test_a_message_starts_an_instance_if_no_running_one_takes_it(play: Play) -> None:
    content = start("s", message("M")) + catch("c", message("M")) + path("s c")
    run = play(content).run().message("M")
    assert run.waiting == ["c"]
    run.message("M").message("M")
    assert [instance.status for instance in run.simulation.instances] == ["completed", "running"]


def test_a_thrown_signal_starts_an_instance_of_the_same_process(play: Play) -> None:
    content = start("n") + throw("t", signal("go")) + path("n t") + start("s", signal("go")) + user("u") + path("s u")
    run = play(content).run()
    assert [instance.status for instance in run.simulation.instances] == ["completed", "running"]
