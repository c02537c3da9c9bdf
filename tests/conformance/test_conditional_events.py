"""Conditional events (standard 13.5.3; docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    catch,
    condition,
    element,
    end,
    error,
    escalation,
    extensions,
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
    user,
)

WAIT = start() + gateway("parallel", "g") + catch("c", condition("x > 2")) + path("s g c")


def test_one_fires_at_once_if_its_condition_is_true_when_it_is_armed(play: Play) -> None:
    assert play(start() + catch("c", condition("x > 2")) + path("s c"), {"x": 3}).run().log == "s c =completed"


def test_it_is_evaluated_after_every_script_step(play: Play) -> None:
    run = play(WAIT + script("a", "x = 1") + script("b", "x = 3") + script("d") + path("g a b d"), {"x": 0}).run()
    assert run.log == "s g (c a b c) d =completed"


def test_after_every_step_of_a_waiting_script(play: Play) -> None:
    run = play(WAIT + script("a", "await sleep(1)\nx = 3\nawait sleep(1)") + path("g a"), {"x": 0})
    assert run.run(1.5).log == "s g (c (a c)"


def test_after_an_assignment_of_a_data_object(play: Play) -> None:
    object = element("dataObjectReference", "d", properties(x="3"))
    task = "<task id='a'><dataInputAssociation id='i'><sourceRef>d</sourceRef></dataInputAssociation></task>"
    assert play(WAIT + object + task + path("g a"), {"x": 0}).run().log == "s g c a =completed"


def test_after_the_mapping_of_a_message(play: Play) -> None:
    run = play(WAIT + catch("m", properties(type="std_msgs/msg/Int32"), signal("x")) + path("g m"), {"x": 0}).run()
    assert run.signal("x", 3).log == "s g (c m c) =completed"


def test_after_somebody_completed_a_task(play: Play) -> None:
    assert play(WAIT + user("u") + path("g u"), {"x": 0}).run().complete("u", {"x": 3}).log == "s g (c u c) =completed"


def test_after_the_mapping_of_a_call(play: Play) -> None:
    said = extensions('<camunda:out source="y" target="x"/>')
    called = process(start("t") + script("k", "y = 3") + path("t k"), id="Q")
    run = play(model(WAIT + call("q", "Q", said) + path("g q"), called), {"x": 0}).run()
    assert run.log == "s g (c (q t k q) c) =completed"


def test_it_fires_when_its_condition_becomes_true_not_while_it_stays_so(play: Play) -> None:
    content = start() + user("u") + boundary("b", "u", condition("x > 2"), interrupting=False) + path("s u")
    content += (
        script("a", "x = 3") + script("k", "x = 4") + script("d", "x = 0") + script("f", "x = 9") + path("s a k d f")
    )
    assert play(content, {"x": 0}).run().visits["b"] == 2


def test_several_are_evaluated_in_the_order_of_arming(play: Play) -> None:
    content = start() + "".join(catch(id, condition("x > 2")) + path(f"s {id}") for id in "cab") + script("k", "x = 3")
    assert play(content + path("s k"), {"x": 0}).run().log == "s (c (a (b k c) a) b) =completed"


def test_one_that_an_earlier_one_cancelled_does_not_fire(play: Play) -> None:
    content = start() + sub("p", catch("c", condition("x > 2"))) + boundary("b", "p", condition("x > 2"))
    run = play(content + script("k", "x = 3") + path("s p") + path("s k"), {"x": 0}).run()
    assert run.log == "s (p k b -p =completed"


def test_a_name_that_is_not_set_yet_is_not_true(play: Play) -> None:
    run = play(start() + catch("c", condition("y > 2")) + script("k", "y = 3") + path("s c") + path("s k")).run()
    assert run.log == "s (c k c) =completed"


def test_a_condition_that_fails_otherwise_is_reported_and_not_true(play: Play) -> None:
    run = play(start() + catch("c", condition("1 / x > 0")) + path("s c"), {"x": 0}).run()
    assert run.waiting == ["c"]
    assert "division by zero" in run.reports[0]


def test_the_script_that_made_it_true_has_completed_before_its_scope_is_interrupted(play: Play) -> None:
    content = (
        start() + script("a", "x = 3") + script("b") + path("s a b") + handler("h", start("t", condition("x > 2")))
    )
    run = play(content, {"x": 0}).run()
    assert run.log == "s a (h t h) =completed"
    assert run.visits["a"] == 1


def test_one_on_the_activity_that_is_true_already_cancels_it_at_once(play: Play) -> None:
    for activity in (user("u"), sub("u", user("v")), script("u", "await sleep(9)")):
        content = start() + activity + boundary("b", "u", condition("x > 2")) + path("s u")
        run = play(content, {"x": 3}).run()
        assert run.log == "s (u b -u =completed"
        assert not run.left_behind()


def test_an_event_sub_process_that_is_true_already_takes_the_place_of_its_scope_at_once(play: Play) -> None:
    handlers = handler("h", start("t", condition("x > 2"))) + handler("i", start("v", signal("A")))
    run = play(start() + sub("p", user("u") + handlers) + path("s p"), {"x": 3}).run()
    assert run.log == "s (p (h t h) p) =completed"
    assert not run.left_behind()


def test_one_that_suspends_at_once_holds_the_first_token(play: Play) -> None:
    handlers = handler("h", start("t", condition("x > 2")) + script("k", "x = 0") + path("t k"), resume=True)
    run = play(start() + sub("p", user("u") + handlers) + path("s p"), {"x": 3}).run()
    assert run.log == "s (p (h t k h) (u"
    assert run.complete("u").left_behind() == {}


def noticing(text: str) -> str:
    return handler("h", start("t", condition(text), interrupting=False) + script("z") + path("t z"))


def test_after_the_output_collection_of_a_multi_instance_activity(play: Play) -> None:
    out = extensions('<zeebe:loopCharacteristics outputCollection="found" outputElement="=loopCounter"/>')
    twice = element("multiInstanceLoopCharacteristics", "m", out, "<loopCardinality>2</loopCardinality>")
    content = start() + script("a", "pass", twice) + user("k") + path("s a k") + noticing("len(found) == 2")
    assert play(content).run().visits["z"] == 1


def test_after_the_code_of_an_error_or_escalation_is_caught(play: Play) -> None:
    for kind in ("error", "escalation"):
        thrown = {"error": error, "escalation": escalation}[kind]("E")
        taken = f'<{kind}EventDefinition {kind}Ref="{kind}_E" camunda:{kind}CodeVariable="code"/>'
        content = start() + sub("p", start("q") + end("f", thrown) + path("q f")) + boundary("b", "p", taken)
        content += user("k") + path("s p") + path("b k") + noticing("code == 'E'")
        assert play(content).run().visits["z"] == 1


@pytest.mark.parametrize("text", ["(_ for _ in ()).throw(SystemExit(3))", "(_ for _ in ()).throw(BaseException())"])
def test_whatever_a_condition_raises_is_reported_and_not_true(play: Play, text: str) -> None:
    run = play(start() + user("u") + boundary("b", "u", condition(text)) + path("s u")).run()
    assert run.waiting == ["u"]
    assert "condition failed" in run.reports[0]
