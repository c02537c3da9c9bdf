"""Link events, escalations, BPMN messages (standard 13.4.5, 13.5.5, 8.3.2)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    catch,
    correlation,
    end,
    escalation,
    handler,
    link,
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


def test_a_link_event_jumps_to_the_catching_one_of_its_name(play: Play) -> None:
    content = start() + throw("l", link("L")) + catch("m", link("L")) + script("a") + path("s l") + path("m a")
    assert play(content).run().log == "s l m a =completed"


def test_several_may_jump_to_one(play: Play) -> None:
    content = start() + throw("l", link("L")) + throw("k", link("L")) + catch("m", link("L")) + script("a")
    assert play(content + path("s l") + path("s k") + path("m a")).run().visits["a"] == 2


def test_a_link_without_target_is_refused(play: Play) -> None:
    with pytest.raises(ModelError, match="0 catching events"):
        play(start() + throw("l", link("L")) + path("s l"))


RAISING = start("t") + throw("x", escalation("E")) + script("y") + path("t x y")


def test_an_interrupting_boundary_event_catches_an_escalation_and_cancels(play: Play) -> None:
    content = (
        start() + sub("p", RAISING) + boundary("b", "p", escalation("E")) + script("z") + path("s p") + path("b z")
    )
    assert play(content).run().log == "s (p t x b -p z =completed"


def test_a_non_interrupting_one_runs_beside(play: Play) -> None:
    content = start() + sub("p", RAISING) + boundary("b", "p", escalation("E"), interrupting=False) + script("z")
    assert play(content + path("s p") + path("b z")).run().log == "s (p t x b y p) z =completed"


def test_an_event_sub_process_catches_it_before_the_boundary(play: Play) -> None:
    inner = RAISING + handler("h", start("v", escalation("E"), interrupting=False))
    content = start() + sub("p", inner) + boundary("b", "p", escalation()) + path("s p")
    assert play(content).run().log == "s (p t x (h v y h) p) =completed"


def test_an_interrupting_event_sub_process_takes_the_place_of_its_scope(play: Play) -> None:
    inner = RAISING + handler("h", start("v", escalation("E")))
    assert play(sub("p", inner)).run().log == "(p t x (h v h) p) =completed"


def test_it_climbs_through_calls_and_an_exact_code_beats_catch_all(play: Play) -> None:
    content = model(
        start() + call("c", "Q") + boundary("a", "c", escalation()) + boundary("b", "c", escalation("E")) + path("s c"),
        process(RAISING, id="Q"),
    )
    assert play(content).run().log == "s (c t x b -c =completed"


def test_an_uncaught_escalation_is_reported_and_the_thrower_goes_on(play: Play) -> None:
    run = play(RAISING).run()
    assert run.log == "t x y =completed"
    assert run.reports == ["escalation E was not caught"]


def test_an_escalation_end_event_ends_its_token(play: Play) -> None:
    inner = start("t") + end("x", escalation("E")) + path("t x")
    content = sub("p", inner) + boundary("b", "p", escalation("E"), interrupting=False)
    assert play(content).run().log == "(p t x b p) =completed"


def test_an_escalation_of_a_handler_starts_outside_the_scope_that_it_handles(play: Play) -> None:
    handling = handler("h", start("v", signal("A"), interrupting=False) + end("x", escalation("E")) + path("v x"))
    inner = user("u") + handling + handler("i", start("w", escalation("E"), interrupting=False))
    content = sub("p", inner) + boundary("b", "p", escalation("E"), interrupting=False)
    assert play(content).run().signal("A").log == "(p (u (h v x b h)"


# ---- messages ----------------------------------------------------------------------------------------------------


def test_a_message_goes_to_the_first_catcher_alone(play: Play) -> None:
    run = play(start() + catch("c", message("M")) + catch("d", message("M")) + path("s c") + path("s d")).run()
    assert run.message("M").log == "s (c (d c)"
    assert run.message("M").status == "completed"


def test_own_catchers_do_not_hear_a_thrown_message(play: Play) -> None:
    content = start() + catch("c", message("M")) + throw("t", message("M")) + path("s c") + path("s t")
    assert play(content).run().log == "s (c t"


CORRELATED = correlation("msg.data", "M", name="number")


def test_a_message_goes_to_the_instance_whose_key_it_has(play: Play) -> None:
    begin = start("s", properties(type="std_msgs/msg/Int32"), signal("number"))
    wait = catch("c", properties(type="std_msgs/msg/Int32"), message("M"))
    run = play(model(begin + wait + path("s c"), root=CORRELATED)).run().signal("number", 1).signal("number", 2)
    run.message("M", 2)
    assert [instance.status for instance in run.simulation.instances] == ["running", "completed"]
    run.message("M", 3)
    assert [instance.status for instance in run.simulation.instances] == ["running", "completed"]


def test_one_from_a_handler_of_a_handler_starts_outside_all_that_they_handle(play: Play) -> None:
    inner = handler("n", start("nt", signal("B"), interrupting=False) + end("ne", escalation("E")) + path("nt ne"))
    outer = handler("h", start("ht", signal("A"), interrupting=False) + user("v") + path("ht v") + inner)
    wrong = handler("x", start("xt", escalation("E")) + script("y") + path("xt y"))
    content = start() + sub("p", user("u") + outer + wrong) + boundary("b", "p", escalation("E")) + path("s p")
    run = play(content).run().signal("A").signal("B")
    assert run.visits["b"] == 1
    assert "x" not in run.visits
