"""Errors climb (standard 13.5.2; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    catch,
    condition,
    end,
    error,
    flow,
    gateway,
    handler,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    timer,
    user,
)

from fame.errors import MissionError

THROW = "raise BpmnError('E')"


def caught_by(*boundaries: str) -> str:
    """A failing script with error boundary events of these codes, each leading to ``on_<code>``."""
    content = start() + script("a", THROW) + end() + path("s a e")
    for code in boundaries:
        content += boundary(f"b{code}", "a", error(code)) + script(f"on_{code}") + path(f"b{code} on_{code}")
    return content


def test_a_boundary_event_of_its_code_catches_it(play: Play) -> None:
    assert play(caught_by("E")).run().log == "s (a a!E bE on_E =completed"


def test_a_boundary_event_without_code_catches_all(play: Play) -> None:
    assert play(caught_by("")).run().log == "s (a a!E b on_ =completed"


@pytest.mark.parametrize(
    "inside", [boundary("b", "a", error("")), handler("h", start("hs", error("")))], ids=["boundary", "handler"]
)
def test_a_mistake_of_a_script_that_is_caught_as_any_error_is_reported(play: Play, inside: str) -> None:
    run = play(start() + script("a", "x = 1 / 0") + end() + path("s a e") + inside).run()
    assert run.instance.status == "completed"
    (caught,) = run.reports
    assert caught.endswith(", which catches every error: ZeroDivisionError: division by zero")
    assert not play(caught_by("")).run().reports  # a code that was thrown is none


def test_an_exact_code_beats_catch_all_at_one_level(play: Play) -> None:
    assert play(caught_by("", "E")).run().log == "s (a a!E bE on_E =completed"


def test_other_codes_do_not_catch_it(play: Play) -> None:
    run = play(caught_by("F")).run()
    assert run.log == "s (a a!E =failed"
    assert isinstance(run.instance.error, MissionError)


def test_an_uncaught_error_names_cause_element_and_line(play: Play) -> None:
    run = play(start() + script("a", "x = 1\ny = x / 0") + path("s a")).run()
    error = run.instance.error
    assert error is not None
    assert (error.element, error.code, error.robot) == ("a", "script", "robot")
    assert "division by zero" in str(error)
    assert isinstance(error.__cause__, ZeroDivisionError)
    assert error.line > 0


def test_any_other_exception_of_a_script_has_code_script(play: Play) -> None:
    content = start() + script("a", "1 / 0") + boundary("b", "a", error("script")) + path("s a")
    assert play(content).run().log == "s (a a!script b =completed"


def test_a_waiting_script_may_fail_too(play: Play) -> None:
    content = caught_by("E").replace(THROW, f"await sleep(1)\n{THROW}")
    assert play(content).run().log == "s (a a!E bE on_E =completed"


def test_an_exact_code_further_out_does_not_beat_catch_all_further_in(play: Play) -> None:
    inner = sub("p", script("a", THROW) + boundary("b", "a", error()))
    assert play(inner + boundary("c", "p", error("E"))).run().log == "(p (a a!E b p) =completed"


def test_it_climbs_through_sub_processes(play: Play) -> None:
    content = sub("p", sub("q", script("a", THROW) + user("u"))) + boundary("b", "p", error("E")) + script("x")
    assert play(content + path("b x")).run().log == "(p (q (a a!E b -p -q x =completed"


def test_it_climbs_through_calls(play: Play) -> None:
    called = process(start("t") + script("a", THROW) + path("t a"), id="Q")
    content = model(start() + call("c", "Q") + boundary("b", "c", error("E")) + path("s c"), called)
    assert play(content).run().log == "s (c t (a a!E b -c =completed"


def test_an_error_end_event_throws(play: Play) -> None:
    content = sub("p", start("t") + end("x", error("E")) + path("t x")) + boundary("b", "p", error("E"))
    assert play(content).run().log == "(p t x x!E b -p =completed"


def test_what_else_goes_on_in_the_failed_scope_is_cancelled(play: Play) -> None:
    content = sub("p", user("u") + catch("c", timer("PT5S")) + script("a", THROW)) + boundary("b", "p", error())
    run = play(content).run()
    assert run.log == "(p (u (c (a a!E b -p -u -c =completed"
    assert not run.left_behind()


def test_a_token_beside_the_failed_activity_goes_on(play: Play) -> None:
    content = start() + gateway("parallel", "g") + user("u") + script("a", THROW) + boundary("b", "a", error())
    assert play(content + path("s g u") + path("g a")).run().log == "s g (u (a a!E b"


def test_boundary_events_come_before_the_event_sub_process_of_the_scope(play: Play) -> None:
    content = caught_by("") + handler("h", start("t", error("E")))
    assert play(content).run().log == "s (a a!E b on_ =completed"


def test_an_error_event_sub_process_takes_the_place_of_its_scope(play: Play) -> None:
    content = sub(
        "p", user("u") + script("a", THROW) + handler("h", start("t", error("E")) + script("x") + path("t x"))
    )
    content = start() + content + end() + path("s p e")
    assert play(content).run().log == "s (p (u (a a!E -u (h t x h) p) e =completed"


def test_it_comes_before_the_boundary_events_of_the_scope(play: Play) -> None:
    content = sub("p", script("a", THROW) + handler("h", start("t", error()))) + boundary("b", "p", error("E"))
    assert play(content).run().log == "(p (a a!E (h t h) p) =completed"


def test_an_exact_code_beats_catch_all_among_event_sub_processes(play: Play) -> None:
    content = script("a", THROW) + handler("h", start("t", error())) + handler("i", start("v", error("E")))
    assert play(content).run().log == "(a a!E (i v i) =completed"


@pytest.mark.parametrize("interrupting", [True, False])
def test_the_error_of_a_handler_starts_outside_the_scope_that_it_handles(play: Play, interrupting: bool) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=interrupting) + script("x", THROW) + path("t x"))
    content = sub("p", user("u") + handling + handler("i", start("v", error("E")))) + boundary("b", "p", error("E"))
    run = play(content).run().signal("A")
    assert run.log.endswith("(x x!E b -p -h =completed" if interrupting else "(x x!E b -p -u -h =completed")
    assert "i" not in run.visits


def test_the_error_of_an_error_handler_does_so_too(play: Play) -> None:
    handling = handler("h", start("t", error("E")) + script("x", THROW) + path("t x"))
    content = sub("p", script("a", THROW) + handling) + boundary("b", "p", error("E"))
    assert play(content).run().log == "(p (a a!E (h t (x x!E b -p -h =completed"


def test_an_error_event_sub_process_inside_a_handler_catches_the_errors_of_that_handler(play: Play) -> None:
    nested = handler("i", start("v", error()))
    handling = handler("h", start("t", signal("A")) + script("x", THROW) + path("t x") + nested)
    assert play(user("u") + handling).run().signal("A").log == "(u -u (h t (x x!E (i v i) h) =completed"


def test_an_error_event_sub_process_of_the_caller_catches_what_leaves_a_call(play: Play) -> None:
    called = process(start("t") + script("a", THROW) + path("t a"), id="Q")
    content = start() + call("c", "Q") + path("s c") + handler("h", start("v", error("E")))
    assert play(model(content, called)).run().log == "s (c t (a a!E -c (h v h) =completed"


def test_the_catching_event_sets_the_variables_that_take_code_and_text(play: Play) -> None:
    said = '<errorEventDefinition xmlns:camunda="http://camunda.org/schema/1.0/bpmn" camunda:errorCodeVariable="code"'
    content = script("a", "raise BpmnError('E', 'no way')") + boundary(
        "b", "a", said + ' camunda:errorMessageVariable="text"/>'
    )
    assert play(content).run().variables == {"code": "E", "text": "no way"}


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ("no way to x=${x_goal}: ${why}", "no way to x=40: a wall"),
        ("=&quot;to &quot; + string(x_goal)", "to 40"),
        ("closed", "closed"),
        ("no way to ${nothing}", "(its message: Undefined: `nothing` is not set)"),
    ],
    ids=["filled in", "FEEL", "fixed", "not computable"],
)
def test_an_error_end_event_throws_the_message_of_its_error(play: Play, message: str, text: str) -> None:
    root = f'<error id="E1" errorCode="lost" camunda:errorMessage="{message}"/>'
    inner = start("t") + end("z", '<errorEventDefinition errorRef="E1"/>') + path("t z")
    values = {"x_goal": 40, "why": "a wall"}
    caught = boundary("b", "p", '<errorEventDefinition camunda:errorMessageVariable="said"/>')
    run = play(model(process(start() + sub("p", inner) + caught + path("s p")), root=root), values).run()
    assert run.variables["said"] == text
    run = play(model(process(start() + sub("p", inner) + path("s p")), root=root), values).run()
    assert str(run.simulation.instances[0].error).endswith(f": error lost was not caught: {text}")


def test_a_failed_instance_leaves_nothing_behind(play: Play) -> None:
    content = user("u") + boundary("b", "u", timer("PT5S")) + catch("c", signal("A")) + catch("d", condition("False"))
    run = play(content + script("a", THROW) + handler("h", start("t", signal("A")))).run()
    assert run.status == "failed"
    assert not run.left_behind()


def test_other_instances_go_on_when_one_fails(play: Play) -> None:
    begin = start("s", properties(type="std_msgs/msg/Int32"), signal("go"))
    run = play(begin + script("a", "1 / go") + user("u") + path("s a u")).run().signal("go", 1).signal("go", 0)
    assert [instance.status for instance in run.simulation.instances] == ["running", "failed"]


def test_an_error_of_a_condition_is_an_error_of_its_gateway(play: Play) -> None:
    inner = start("t") + gateway("exclusive", "g") + script("a") + path("t g") + flow("g", "a", "nothing > 1")
    assert play(sub("p", inner) + boundary("b", "p", error("script"))).run().log == "(p t (g g!script b -p =completed"


@pytest.mark.parametrize("raised", ["KeyboardInterrupt", "SystemExit(1)", "GeneratorExit", "BaseException"])
@pytest.mark.parametrize("before", ["", "await sleep(1)\n"], ids=["at once", "after waiting"])
def test_whatever_a_script_raises_is_its_error_alone(play: Play, raised: str, before: str) -> None:
    content = start() + script("a", f"{before}raise {raised}") + boundary("b", "a", error()) + script("k")
    run = play(content + path("s a") + path("b k")).run()
    assert run.log == "s (a a!script b k =completed"


def test_so_is_whatever_an_expression_raises(play: Play) -> None:
    leave = script("d", "def leave(): raise SystemExit")
    content = start() + leave + script("a") + gateway("exclusive", "g") + script("k") + path("s d a g")
    run = play(content + flow("g", "k", "leave()")).run()
    assert (run.status, run.instance.error.element) == ("failed", "g")


def test_the_interrupt_of_a_person_is_no_error_of_the_script(play: Play) -> None:
    run = play(start() + script("a", "import signal\nsignal.raise_signal(signal.SIGINT)\nx = 1") + path("s a"))
    with pytest.raises(KeyboardInterrupt):
        run.run()


def test_out_of_memory_is_told_in_words(play: Play) -> None:
    run = play(start() + script("a", "x = [0] * (1 << 60)") + path("s a")).run()
    assert run.status == "failed"
    assert "MemoryError: the script needs more memory than there is" in str(run.instance.error)


def test_an_error_in_a_handler_of_a_handler_starts_outside_all_that_they_handle(play: Play) -> None:
    inner = handler("n", start("nt", signal("B"), interrupting=False) + end("ne", error("E")) + path("nt ne"))
    outer = handler("h", start("ht", signal("A"), interrupting=False) + user("v") + path("ht v") + inner)
    wrong = handler("x", start("xt", error("E")) + script("y") + path("xt y"))
    content = start() + sub("p", user("u") + outer + wrong) + boundary("b", "p", error("E")) + path("s p")
    assert play(content).run().signal("A").signal("B").log.endswith("ne!E b -p -u -h -v -n =completed")
