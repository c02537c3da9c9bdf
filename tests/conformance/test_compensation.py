"""Compensation and transactions (standard 13.5.5, 10.3.5)."""

import pytest
from conftest import Play
from engine_models import (
    CANCEL,
    Run,
    boundary,
    call,
    catch,
    element,
    end,
    error,
    extensions,
    flow,
    gateway,
    handler,
    model,
    path,
    process,
    script,
    signal,
    start,
    sub,
    throw,
    user,
)

from fame.errors import ModelError

THROW = "<compensateEventDefinition/>"


def undo(activity: str, text: str = "pass") -> str:
    """A compensation event at an activity (``c_a``) with its handler (``u_a``)."""
    event, handler_id = f"c_{activity}", f"u_{activity}"
    handling = script(handler_id, text).replace("<scriptTask", '<scriptTask isForCompensation="true"')
    link_ = f'<association id="l_{activity}" associationDirection="One" sourceRef="{event}" targetRef="{handler_id}"/>'
    return boundary(event, activity, THROW) + handling + link_


def only(activity: str) -> str:
    return f'<compensateEventDefinition activityRef="{activity}"/>'


ROW = start() + script("a") + undo("a") + script("b") + undo("b")


def test_what_has_completed_is_undone_the_latest_first(play: Play) -> None:
    run = play(ROW + throw("t", THROW) + end() + path("s a b t e")).run()
    assert run.log == "s a b (t c_b u_b c_a u_a t) e =completed"
    assert run.visits["t"] == 1
    assert not run.left_behind()


def test_what_has_not_completed_is_not(play: Play) -> None:
    run = play(ROW + throw("t", THROW) + end() + path("s a t b e")).run()
    assert run.log == "s a (t c_a u_a t) b e =completed"


def test_nothing_to_undo_is_no_obstacle(play: Play) -> None:
    run = play(ROW + throw("t", THROW) + path("s t a b")).run()
    assert run.log == "s t a b =completed"
    assert run.visits["t"] == 1


def test_one_activity_alone_may_be_undone(play: Play) -> None:
    assert play(ROW + throw("t", only("a")) + end() + path("s a b t e")).run().log == "s a b (t c_a u_a t) e =completed"


def test_each_is_undone_once(play: Play) -> None:
    content = ROW + throw("t", only("a")) + throw("v", THROW) + path("s a b t v")
    assert play(content).run().log == "s a b (t c_a u_a t) (v c_b u_b v) =completed"


def test_an_activity_that_completed_twice_is_undone_twice(play: Play) -> None:
    content = start() + gateway("exclusive", "m") + script("a", "n = n + 1") + undo("a", "n = n - 10")
    content += (
        gateway("exclusive", "g", default="g_t") + throw("t", THROW) + path("s m a g t") + flow("g", "m", "n < 3")
    )
    run = play(content, {"n": 0}).run()
    assert run.variables == {"n": -27}


def test_an_end_event_may_throw_it(play: Play) -> None:
    assert play(ROW + end("t", THROW) + path("s a b t")).run().log == "s a b (t c_b u_b c_a u_a t) =completed"


def test_the_thrower_waits_for_the_handlers(play: Play) -> None:
    content = start() + script("a") + undo("a", "await sleep(5)") + throw("t", THROW) + end() + path("s a t e")
    run = play(content).run(4)
    assert run.log == "s a (t c_a (u_a"
    assert run.run(6).log == "s a (t c_a u_a t) e =completed"


def test_a_thrower_that_does_not_wait_goes_on_beside_the_handlers(play: Play) -> None:
    thrown = THROW.replace("/>", ' waitForCompletion="false"/>')
    content = start() + script("a") + undo("a", "await sleep(5)") + throw("t", thrown) + end() + path("s a t e")
    run = play(content).run(4)
    assert run.log == "s a t e c_a (u_a"
    assert run.run(6).log == "s a t e c_a u_a =completed"
    assert not run.left_behind()


def test_an_end_event_that_does_not_wait_ends_its_token(play: Play) -> None:
    thrown = THROW.replace("/>", ' waitForCompletion="false"/>')
    run = play(ROW + end("t", thrown) + path("s a b t")).run()
    assert run.log == "s a b t c_b u_b c_a u_a =completed"


def test_tasks_that_wait_are_undone_too(play: Play) -> None:
    content = start() + user("a") + undo("a") + throw("t", THROW) + path("s a t")
    assert play(content).run().complete("a").log == "s a (t c_a u_a t) =completed"


def test_a_sub_process_without_a_handler_is_undone_by_what_completed_in_it(play: Play) -> None:
    inner = sub("p", script("a") + undo("a") + script("b") + undo("b") + path("a b"))
    content = start() + inner + script("c") + undo("c") + throw("t", THROW) + path("s p c t")
    run = play(content).run()
    assert run.log == "s (p a b p) c (t c_c u_c c_b u_b c_a u_a t) =completed"


def test_a_sub_process_with_a_handler_is_undone_by_that_alone(play: Play) -> None:
    inner = sub("p", script("a") + undo("a")) + undo("p")
    content = start() + inner + throw("t", THROW) + path("s p t")
    assert play(content).run().log == "s (p a p) (t c_p u_p t) =completed"


def test_an_event_sub_process_for_compensation_undoes_its_scope(play: Play) -> None:
    handling = handler("h", start("ht", THROW) + script("k") + throw("w", THROW) + path("ht k w"))
    inner = sub("p", script("a") + undo("a") + handling)
    content = start() + inner + throw("t", only("p")) + end() + path("s p t e")
    run = play(content).run()
    assert run.log == "s (p a p) (t (h ht k (w c_a u_a w) h) t) e =completed"
    assert not run.left_behind()


def test_a_sub_process_still_active_is_not_undone_from_outside(play: Play) -> None:
    inner = sub("p", script("a") + undo("a") + user("x") + path("a x"))
    content = start() + gateway("parallel", "g") + inner + user("y") + throw("t", THROW) + path("s g p") + path("g y t")
    run = play(content).run().complete("y")
    assert run.log == "s g (p (y a (x y) t"


def test_an_event_sub_process_throws_it_for_the_scope_that_it_handles(play: Play) -> None:
    content = start() + script("a") + undo("a") + user("u") + path("s a u")
    for interrupting in (True, False):
        handling = handler("h", start("ht", signal("A"), interrupting=interrupting) + throw("t", THROW) + path("ht t"))
        assert "(t c_a u_a t) h)" in play(content + handling).run().signal("A").log


def test_each_handler_sees_the_variables_that_its_activity_had(play: Play) -> None:
    multi = '<multiInstanceLoopCharacteristics isSequential="true"><loopCardinality>3</loopCardinality>'
    inner = sub(
        "p", multi + "</multiInstanceLoopCharacteristics>", script("a") + undo("a", "found.append(loopCounter)")
    )
    run = play(start() + inner + throw("t", THROW) + path("s p t"), {"found": []}).run()
    assert run.variables["found"] == [3, 2, 1]


def test_called_processes_are_undone_by_what_completed_in_them(play: Play) -> None:
    called = process(start("t") + script("a") + undo("a") + path("t a"), id="Q")
    content = model(start() + call("c", "Q") + throw("v", THROW) + path("s c v"), called)
    assert play(content).run().log == "s (c t a c) (v c_a u_a v) =completed"


def test_a_compensation_event_needs_a_handler() -> None:
    with pytest.raises(ModelError, match="needs one handler"):
        Run(start() + script("a") + boundary("b", "a", THROW) + path("s a"))


def refused(content: str) -> str:
    with pytest.raises(ModelError) as caught:
        Run(content)
    return caught.value.text


def test_a_compensation_event_has_one_trigger() -> None:
    twice = boundary("b", "a", THROW, THROW) + script("u") + '<association id="l" sourceRef="b" targetRef="u"/>'
    assert "a compensation event needs one handler" in refused(start() + script("a") + twice + path("s a"))


def test_an_activity_has_one_compensation_handler() -> None:
    twice = undo("a") + undo("a").replace("c_a", "d_a").replace("u_a", "v_a").replace("l_a", "m_a")
    assert "its activity has another compensation handler" in refused(start() + script("a") + twice + path("s a"))
    inner = handler("h", start("t", THROW))
    assert "its scope has another event sub-process for compensation" in refused(
        start() + sub("p", script("a") + inner + handler("i", start("v", THROW))) + path("s p")
    )
    both = sub("p", script("a") + handler("h", start("t", THROW))) + undo("p")
    assert "its activity has another compensation handler" in refused(start() + both + path("s p"))


@pytest.mark.parametrize("activity", ["A", "s", "u_a", "p", "inside"])
def test_what_is_compensated_is_an_activity_of_the_scope(activity: str) -> None:
    content = start() + sub("q", script("inside")) + script("a") + undo("a") + throw("t", only(activity))
    text = refused(content + path("s q a t"))
    assert text.startswith(f"its activityRef is {activity!r}: expected an activity of its scope; ")


@pytest.mark.parametrize("reference", ["a", " a ", "tns:a"])
def test_the_activity_is_found_as_other_references_are(play: Play, reference: str) -> None:
    assert play(ROW + throw("t", only(reference)) + path("s a b t")).run().log == "s a b (t c_a u_a t) =completed"


def test_a_handler_compensates_an_activity_of_the_scope_that_it_handles(play: Play) -> None:
    handling = handler("h", start("ht", signal("A")) + throw("t", only("a")) + path("ht t"))
    content = start() + script("a") + undo("a") + script("b") + undo("b") + user("u") + path("s a b u") + handling
    assert "(t c_a u_a t) h)" in play(content).run().signal("A").log


# ---- transactions ------------------------------------------------------------------------------------------------


def transaction(*content: str) -> str:
    inner = element("transaction", "p", *content)
    return start() + inner + boundary("x", "p", CANCEL) + script("y") + end() + path("s p e") + path("x y")


def test_a_transaction_that_is_not_cancelled_is_a_sub_process(play: Play) -> None:
    assert play(transaction(script("a") + undo("a"))).run().log == "s (p a p) e =completed"


def test_cancel_ends_what_goes_on_undoes_what_completed_and_leaves_by_the_boundary(play: Play) -> None:
    inner = start("t") + script("a") + undo("a") + script("b") + undo("b") + user("u") + end("c", CANCEL)
    run = play(transaction(inner + path("t u") + path("t a b c"))).run()
    assert run.log == "s (p t (u a b c -u c_b u_b c_a u_a x -p y =completed"
    assert not run.left_behind()


def test_cancel_waits_for_scripts_to_leave_before_it_undoes(play: Play) -> None:
    slow = script("k", "try:\n    await sleep(9)\nfinally:\n    await sleep(1)")
    inner = start("t") + script("a") + undo("a") + slow + catch("d", signal("A")) + end("c", CANCEL)
    run = play(transaction(inner + path("t a d c") + path("t k"))).run(1).signal("A")
    assert "u_a" not in run.visits
    assert run.run(3).log.endswith("c_a u_a x -p y =completed")


def test_an_error_leaves_a_transaction_without_undoing(play: Play) -> None:
    inner = start("t") + script("a") + undo("a") + end("c", error("E")) + path("t a c")
    content = transaction(inner) + boundary("z", "p", error("E"))
    assert play(content).run().log == "s (p t a c c!E z -p =completed"


def test_cancel_without_a_boundary_event_is_an_error(play: Play) -> None:
    inner = start("t") + end("c", CANCEL) + path("t c")
    run = play(start() + element("transaction", "p", inner) + path("s p")).run()
    assert run.status == "failed"
    assert "no cancel boundary event" in str(run.instance.error)


def test_cancel_belongs_to_transactions() -> None:
    with pytest.raises(ModelError, match=r"test.bpmn:1: x: a cancel end event is allowed in a transaction only"):
        Run(start() + sub("p", start("t") + end("x", CANCEL) + path("t x")) + path("s p"))
    with pytest.raises(ModelError, match=r"test.bpmn:1: b: expected a transaction for the cancel event, got p"):
        Run(start() + sub("p", user("u")) + boundary("b", "p", CANCEL) + path("s p"))


def test_it_may_end_one_from_a_sub_process_inside(play: Play) -> None:
    inner = script("a") + undo("a") + sub("p", start("t") + end("x", CANCEL) + path("t x")) + path("a p")
    content = start() + element("transaction", "r", inner) + boundary("b", "r", CANCEL) + path("s r")
    assert play(content).run().log == "s (r a (p t x -p c_a u_a b -r =completed"


def test_cancel_undoes_what_completed_in_what_it_cancels(play: Play) -> None:
    """In a sub-process with the cancel end event, one beside it, a handler, and one of two instances."""
    many = '<multiInstanceLoopCharacteristics isSequential="true"><loopCardinality>2</loopCardinality>'
    many += "</multiInstanceLoopCharacteristics>"
    ends = sub("q", script("b") + undo("b") + end("c", CANCEL) + path("b c"))
    beside = sub("m", many, script("d") + undo("d") + user("u") + path("d u"))
    handling = handler(
        "h", start("ht", signal("A"), interrupting=False) + script("f") + undo("f") + user("w") + path("ht f w")
    )
    inner = start("t") + script("a") + undo("a") + user("v") + ends + beside + handling + path("t a v q") + path("t m")
    run = play(transaction(inner)).run().complete("u").signal("A").complete("v")
    undone = [id for id in run.log.split() if id.startswith("u_")]
    assert sorted(undone) == ["u_a", "u_b", "u_d", "u_d", "u_f"]
    assert undone[-1] == "u_a"  # which completed before the others began
    assert run.log.endswith("x -p y =completed")
    assert not run.left_behind()


def test_an_event_sub_process_for_compensation_undoes_a_scope_however_that_ended(play: Play) -> None:
    undoing = handler("h", start("ht", THROW) + script("k") + path("ht k"))
    interrupted = handler("i", start("it", signal("A")) + script("m") + path("it m"))
    content = start() + sub("p", user("u") + interrupted + undoing) + throw("t", THROW) + path("s p t")
    assert play(content).run().signal("A").log == "s (p (u -u (i it m i) p) (t (h ht k h) t) =completed"


def test_what_fails_in_its_output_mapping_has_not_completed(play: Play) -> None:
    fails = extensions(
        '<camunda:inputOutput><camunda:outputParameter name="y">${1/0}</camunda:outputParameter></camunda:inputOutput>'
    )
    content = start() + sub("p", fails, script("a")) + undo("p") + boundary("b", "p", error()) + throw("t", THROW)
    assert play(content + path("s p") + path("b t")).run().log == "s (p a p!script b t =completed"


@pytest.mark.parametrize("sequential", ["true", "false"])
def test_a_transaction_that_repeats_is_cancelled_and_undone_as_one(play: Play, sequential: str) -> None:
    many = f'<multiInstanceLoopCharacteristics isSequential="{sequential}"><loopCardinality>2</loopCardinality>'
    inner = start("t") + script("a") + undo("a", "found.append(loopCounter)") + user("u") + gateway("exclusive", "g")
    inner += path("t a u g") + flow("g", "c", "stop") + end("c", CANCEL) + flow("g", "d", "not stop") + end("d")
    content = start() + element("transaction", "p", many + "</multiInstanceLoopCharacteristics>", inner)
    run = play(content + boundary("x", "p", CANCEL) + path("s p"), {"found": [], "stop": False}).run()
    assert run.complete("u").complete("u", {"stop": True}).log.endswith("c_a u_a c_a u_a x =completed")
    assert run.variables["found"] == [2, 1]


def test_cancel_ends_the_innermost_transaction_alone(play: Play) -> None:
    inner = element("transaction", "q", start("t") + end("c", CANCEL) + path("t c"))
    content = start() + element("transaction", "p", inner) + boundary("x", "p", CANCEL) + path("s p")
    assert play(content).run().log == "s (p (q t c c!cancel -p -q =failed"


def test_what_completed_in_a_handler_is_undone_with_its_scope(play: Play) -> None:
    beside = handler("h", start("ht", signal("A"), interrupting=False) + script("a") + undo("a") + path("ht a"))
    content = start() + sub("p", user("u") + beside) + throw("t", THROW) + path("s p t")
    assert play(content).run().signal("A").complete("u").log.endswith("(t c_a u_a t) =completed")


def test_a_handler_may_undo_what_completed_in_itself(play: Play) -> None:
    inside = start("ht", signal("A"), interrupting=False) + script("a") + undo("a") + throw("t", only("a"))
    run = play(start() + user("u") + path("s u") + handler("h", inside + path("ht a t"))).run().signal("A")
    assert run.log == "s (u (h ht a (t c_a u_a t) h)"


def test_of_an_activity_that_repeats_each_instance_is_undone(play: Play) -> None:
    for tag, inside in (("multiInstance", "<loopCardinality>3</loopCardinality>"), ("standard", "")):
        how = element(f"{tag}LoopCharacteristics", "m", inside, **({"loopMaximum": "3"} if not inside else {}))
        run = play(start() + script("a", "pass", how) + undo("a") + throw("t", THROW) + path("s a t")).run()
        assert run.log == "s a a a (t c_a u_a c_a u_a c_a u_a t) =completed"
