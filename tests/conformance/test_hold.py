"""A host may hold all that runs, and release it: as a suspension of all, whatever is suspended in it already."""

from collections.abc import Callable

import pytest
from engine_models import (
    Run,
    boundary,
    catch,
    condition,
    end,
    handler,
    message,
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

from fame.errors import MissionError


def test_scripts_are_cancelled_and_start_again_with_the_variables_as_they_are() -> None:
    run = Run(start() + script("a", "i = i + 1\nawait sleep(10)") + path("s a"), {"i": 0}).run(3)
    run.node.hold()
    assert run.run(20).variables["i"] == 1
    run.node.release()
    assert run.run(25).variables["i"] == 2
    assert run.run(30.5).log == "s a =completed"


def test_what_it_waits_for_is_lost_if_it_is_a_signal_and_late_if_it_is_a_time() -> None:
    content = start() + catch("c", signal("A")) + end() + path("s c e")
    run = Run(content)
    run.run().node.hold()
    run.signal("A").node.release()
    assert run.waiting == ["c"]
    run = Run(start() + catch("c", timer("PT5S")) + end() + path("s c e")).run(1)
    run.node.hold()
    assert run.run(60).waiting == ["c"]
    run.node.release()
    assert run.run().status == "completed"


def test_a_condition_fires_when_it_becomes_true_and_not_because_it_still_is_when_all_is_released() -> None:
    event = boundary("b", "u", condition("x > 1"), interrupting=False)
    content = start() + user("u") + event + end() + end("f") + path("s u e") + path("b f")
    run = Run(content, {"x": 0}).run()
    for value, fired in ((2, 1), (2, 1), (0, 1), (2, 2)):
        run.node.hold()
        run.node.set_variables({"x": value})
        run.node.release()
        run.run()
        assert run.visits["f"] == fired


def test_what_somebody_completes_meanwhile_goes_on_afterwards() -> None:
    run = Run(start() + user("u") + end() + path("s u e")).run()
    run.node.hold()
    assert run.complete("u").status == "running"
    with pytest.raises(MissionError, match="u: has been completed; it goes on when what suspends it ends"):
        run.complete("u")
    with pytest.raises(MissionError, match="is not waiting; currently waiting: nothing"):
        run.complete("other")
    run.node.release()
    assert run.run().status == "completed"


def test_no_instance_begins_meanwhile() -> None:
    run = Run(start("s", signal("A")) + end() + path("s e"))
    run.run().node.hold()
    run.signal("A").node.release()
    assert run.simulation.instances == []
    assert run.signal("A").run().status == "completed"


def test_a_scope_that_is_suspended_already_stays_so_when_all_is_released() -> None:
    pausing = handler("h", start("t", signal("A")) + user("w") + path("t w"), resume=True)
    run = Run(start() + user("u") + end() + path("s u e") + pausing).run().signal("A")
    run.node.hold()
    run.node.hold()
    run.node.release()
    assert run.complete("u").status == "running"
    assert run.complete("w").status == "completed"


def test_what_is_held_can_be_stopped() -> None:
    run = Run(start() + script("a", "await sleep(10)") + path("s a")).run(3)
    run.node.hold()
    run.node.stop()
    run.node.release()
    assert run.run().status == "cancelled"


def test_a_script_that_leaves_slowly_is_waited_for() -> None:
    text = "i = i + 1\ntry:\n    await sleep(10)\nfinally:\n    await sleep(1)"
    run = Run(start() + script("a", text) + throw("x", signal("B")) + end() + path("s a x e"), {"i": 0}).run(3)
    run.node.hold()
    run.node.release()
    assert run.run(3.5).variables["i"] == 1
    assert run.run(4.5).variables["i"] == 2
    assert run.run().status == "completed"


@pytest.mark.parametrize("after", ["straight", "restored", "recorded"])
@pytest.mark.parametrize(
    ("kind", "text", "times"), [("Duration", "PT5S", 0), ("Cycle", "R3/PT2S", 3), ("Cycle", "R/PT2S", 4)]
)
def test_a_timer_that_starts_instances_starts_one_afterwards_for_all_its_times(
    kind: str, text: str, times: int, after: str
) -> None:
    run = Run(process(start("s", timer(text, kind)) + end() + path("s e")), after=after).run(1)
    run.node.hold()
    assert run.run(9).simulation.instances == []
    assert run.node.pending_starts == "due"
    assert "robot waits at s for the end of its suspension: it has come due" in map(str, run.node.waiting_tokens())
    run.node.release()
    assert [each.status for each in run.simulation.instances] == ["completed"]
    said = [f"came due {times} times while suspended: fires once"] if times and after != "restored" else []
    assert run.reports == said  # a restarted engine counts anew
    assert len(run.run(10.5).simulation.instances) == (2 if text == "R/PT2S" else 1)


@pytest.mark.parametrize("after", ["straight", "restored", "recorded"])
@pytest.mark.parametrize("definition", [signal, message])
def test_a_start_event_with_a_queue_keeps_messages_meanwhile(definition: Callable[[str], str], after: str) -> None:
    content = start("s", properties(queue=2), definition("A")) + user("u") + path("s u")
    run = Run(process(content, instances=1), after=after).run()
    run.node.hold()
    run.signal("A").signal("A").signal("A").node.release()
    assert len(run.run().simulation.instances) == 1
    assert len(run.complete("u").run().simulation.instances) == 2
    assert len(run.complete("u").run().simulation.instances) == 2


def test_a_boundary_timer_fires_once_afterwards_for_all_its_times() -> None:
    event = boundary("b", "u", timer("R5/PT2S", "Cycle"), interrupting=False)
    run = Run(start() + user("u") + event + end("f") + path("s u") + path("b f")).run(1)
    run.node.hold()
    run.run(7).node.release()
    assert run.run(7.5).visits["f"] == 1
    assert run.reports == ["came due 3 times while suspended: fires once"]
    assert run.run(20).visits["f"] == 3
