"""Multi-instance activities and standard loops (standard 13.3.6, 13.3.7)."""

import pytest
from bpmn_text import properties
from conftest import Play
from engine_models import (
    TERMINATE,
    Run,
    boundary,
    call,
    catch,
    condition,
    end,
    error,
    extensions,
    handler,
    model,
    path,
    process,
    script,
    signal,
    start,
    sub,
    user,
)

from fame.errors import ModelError


def many(inside: str, sequential: bool = False, **attributes: str) -> str:
    said = "".join(f' camunda:{name}="{value}"' for name, value in attributes.items())
    tag = "multiInstanceLoopCharacteristics"
    return f'<{tag} isSequential="{str(sequential).lower()}"{said}>{inside}</{tag}>'


def times(text: object) -> str:
    return f"<loopCardinality>{text}</loopCardinality>"


def until(text: str) -> str:
    return f"<completionCondition>{text}</completionCondition>"


def loop(text: str = "", **attributes: str) -> str:
    said = "".join(f' {name}="{value}"' for name, value in attributes.items())
    inside = f"<loopCondition>{text}</loopCondition>" if text else ""
    return f"<standardLoopCharacteristics{said}>{inside}</standardLoopCharacteristics>"


def around(activity: str, id: str = "a") -> str:
    return start() + activity + end() + path(f"s {id} e")


@pytest.mark.parametrize("sequential", [True, False])
def test_it_runs_as_often_as_its_cardinality_says(play: Play, sequential: bool) -> None:
    run = play(around(script("a", "n = n + loopCounter", many(times("2 + 2"), sequential))), {"n": 0}).run()
    assert run.log == "s a a a a e =completed"
    assert run.variables == {"n": 10}


@pytest.mark.parametrize("text", ["2.5", "None", "-1", "'many'", "True", "1e400", "[3]"])
def test_a_cardinality_that_is_no_number_of_instances_is_an_error(play: Play, text: str) -> None:
    run = play(around(script("a", "pass", many(times(text))))).run()
    assert run.instance.error is not None
    assert (run.log, run.instance.error.element) == ("s =failed", "a")
    shown = text.replace("1e400", "inf")
    assert f"expected a whole number from 0 on as cardinality, got {shown}" in run.instance.error.text


def test_more_results_than_memory_holds_are_an_error(play: Play) -> None:
    said = properties(outputCollection="all", outputElement="${loopCounter}")
    run = play(around(script("a", "pass", said + many(times(10**12), True)))).run()
    assert run.instance.error is not None
    assert "expected a cardinality of at most 200000" in run.instance.error.text


def test_items_of_a_set_are_taken_in_the_same_order_in_each_run(play: Play) -> None:
    words = [f"w{number}" for number in range(50)]
    activity = script("a", "seen = seen + [w]", many("", True, collection="words", elementVariable="w"))
    assert play(around(activity), {"words": set(words), "seen": []}).run().variables["seen"] == sorted(words)


@pytest.mark.parametrize("text", ["2.0", "'2'", "0 + 2"])
def test_one_that_is_a_whole_number_in_another_form_counts(play: Play, text: str) -> None:
    assert play(around(script("a", "pass", many(times(text))))).run().log == "s a a e =completed"


def test_parallel_instances_run_beside_each_other(play: Play) -> None:
    run = play(around(user("a", many(times(3))))).run()
    assert run.waiting == ["a", "a", "a"]
    assert run.complete("a").complete("a").complete("a").status == "completed"


def test_sequential_instances_run_one_after_the_other(play: Play) -> None:
    run = play(around(user("a", many(times(3), True)))).run()
    for _ in range(3):
        assert run.waiting == ["a"]
        run.complete("a")
    assert run.log == "s a a a e =completed"


@pytest.mark.parametrize("sequential", [True, False])
def test_it_runs_once_for_each_item_of_its_collection(play: Play, sequential: bool) -> None:
    said = many("", sequential, collection="items", elementVariable="item")
    run = play(around(script("a", "found = found + [item]", said)), {"items": [5, "x", None], "found": []}).run()
    assert run.variables == {"items": [5, "x", None], "found": [5, "x", None]}


@pytest.mark.parametrize("items", [[], 0])
def test_none_at_all_completes_at_once(play: Play, items: object) -> None:
    said = many(times(0)) if items == 0 else many("", collection="items", elementVariable="item")
    run = play(around(user("a", said) + boundary("b", "a", signal("A"))), {"items": items}).run()
    assert run.log == "s e =completed"
    assert not run.left_behind()


def test_the_collection_is_read_once(play: Play) -> None:
    said = many("", True, collection="items", elementVariable="item")
    run = play(around(script("a", "items.append(item)\nn = n + 1", said)), {"items": [1, 2], "n": 0}).run()
    assert run.variables["n"] == 2


def test_what_is_no_collection_is_an_error_of_the_activity(play: Play) -> None:
    content = around(user("a", many("", collection="items", elementVariable="i")) + boundary("b", "a", error()))
    assert play(content, {"items": 3}).run().log == "s b =completed"


def test_each_instance_has_variables_of_its_own(play: Play) -> None:
    said = many("", collection="items", elementVariable="item")
    run = play(
        around(script("a", "mine = item * 2\nawait sleep(item)\ntotal = total + mine", said)),
        {"items": [3, 1], "total": 0},
    )
    assert run.run().variables == {"items": [3, 1], "total": 8}


def test_they_know_how_many_there_are(play: Play) -> None:
    text = "seen = seen + [(numberOfInstances, numberOfActiveInstances, numberOfCompletedInstances, nrOfInstances)]"
    run = play(around(script("a", text, many(times(3), True))), {"seen": []}).run()
    assert [tuple(item) for item in run.variables["seen"]] == [(3, 1, 0, 3), (3, 1, 1, 3), (3, 1, 2, 3)]


def test_a_completion_condition_ends_it_and_cancels_the_rest(play: Play) -> None:
    run = play(around(user("a", many(times(3) + until("numberOfCompletedInstances >= 2"))))).run().complete("a")
    assert run.waiting == ["a", "a"]
    assert run.complete("a").log == "s (a (a a a) -a e =completed"
    assert not run.left_behind()


def test_a_completion_condition_ends_a_sequential_one(play: Play) -> None:
    run = play(around(script("a", "x = loopCounter", many(times(9) + until("x == 4"), True))), {"x": 0}).run()
    assert run.variables == {"x": 4}


def test_what_follows_waits_for_cancelled_instances_to_leave(play: Play) -> None:
    text = "if loopCounter == 1:\n    await sleep(1)\nelse:\n    try:\n        await sleep(9)\n"
    text += "    finally:\n        await sleep(1)"
    run = play(around(script("a", text, many(times(2) + until("True"))))).run(1.5)
    assert run.log == "s (a a -a"
    assert run.run(2.5).log == "s (a a -a e =completed"


def test_an_output_collection_has_one_element_for_each_instance_in_their_order(play: Play) -> None:
    tag = '<zeebe:loopCharacteristics inputCollection="=items" inputElement="item" '
    tag += 'outputCollection="found" outputElement="=y"/>'
    said = many(extensions(tag))
    content = model(around(script("a", "await sleep(5 - item)\ny = item * 10", said)))
    run = play(content, {"items": [1, 2, 3]}).run()
    assert run.variables["found"] == [10, 20, 30]


def test_the_output_collection_may_be_a_property_of_the_activity(play: Play) -> None:
    said = properties(outputCollection="found", outputElement="${item * 10}") + many(
        "", collection="items", elementVariable="item"
    )
    run = play(model(around(script("a", "pass", said))), {"items": [1, 2, 3]}).run()
    assert run.variables["found"] == [10, 20, 30]


def test_boundary_events_guard_the_whole(play: Play) -> None:
    content = around(user("a", many(times(3))) + boundary("b", "a", signal("A")) + script("x")) + path("b x")
    run = play(content).run().complete("a").signal("A")
    assert run.log == "s (a (a a b -a -a x =completed"
    assert not run.left_behind()


def test_an_error_of_one_instance_ends_the_whole(play: Play) -> None:
    said = many("", collection="items", elementVariable="item")
    content = around(script("a", "await sleep(1)\n1 / item", said) + boundary("b", "a", error()))
    assert play(content, {"items": [1, 0, 1]}).run().log == "s (a (a a a!script b -a =completed"


def test_sub_processes_and_calls_repeat_likewise(play: Play) -> None:
    inner = sub("a", many(times(2)), user("u") + handler("h", start("t", signal("A"))))
    assert play(around(inner)).run().signal("A").log == "s (a (a (u (u -u (h t -u (h t h) a) h) a) e =completed"
    called = process(start("t") + script("k", "x = x + loopCounter") + path("t k"), id="Q")
    assert play(model(around(call("a", "Q", many(times(3)))), called), {"x": 0}).run().variables == {"x": 6}


def test_terminate_ends_one_instance(play: Play) -> None:
    inner = sub("a", many(times(2)), user("u") + catch("c", signal("A")) + end("x", TERMINATE) + path("u x"))
    run = play(around(inner)).run().complete("u")
    assert run.log == "s (a (a (u (u (c (c u) x -c a)"
    assert run.complete("u").status == "completed"


def test_it_is_suspended_and_resumed(play: Play) -> None:
    pause = handler("h", start("t", signal("A")) + user("w") + path("t w"), resume=True)
    run = play(around(script("a", "n = n + 1\nawait sleep(9)", many(times(2), True))) + pause, {"n": 0})
    assert run.run(1).signal("A").complete("w").run(30).variables["n"] == 3


def test_a_thousand_instances(play: Play) -> None:
    run = Run(around(script("a", "n = n + 1", many(times(1000)))), {"n": 0}).run()
    assert run.variables == {"n": 1000}
    assert not run.left_behind()


# ---- standard loops ----------------------------------------------------------------------------------------------


def test_a_loop_repeats_while_its_condition_holds(play: Play) -> None:
    run = play(around(script("a", "x = x + 1", loop("x &lt; 3"))), {"x": 0}).run()
    assert run.log == "s a a a e =completed"
    assert run.variables == {"x": 3}


def test_its_condition_is_tested_after_each_pass(play: Play) -> None:
    assert play(around(script("a", "x = x + 1", loop("False"))), {"x": 0}).run().variables == {"x": 1}


def test_or_before_it(play: Play) -> None:
    run = play(around(script("a", "x = x + 1", loop("x &lt; 0", testBefore="true"))), {"x": 0}).run()
    assert run.log == "s e =completed"


def test_a_maximum_bounds_the_passes(play: Play) -> None:
    assert play(around(script("a", "x = x + 1", loop("True", loopMaximum="4"))), {"x": 0}).run().variables == {"x": 4}
    assert play(around(script("a", "x = x + 1", loop(loopMaximum="4"))), {"x": 0}).run().variables == {"x": 4}


def test_its_condition_knows_how_often_it_ran(play: Play) -> None:
    assert play(around(script("a", "y = 1", loop("loopCounter &lt; 5")))).run().visits["a"] == 5


def test_so_does_its_body_whose_new_variables_remain(play: Play) -> None:
    text = "new = loopCounter; found.append(loopCounter)"
    inner = sub("a", loop(loopMaximum="3"), start("t") + user("u") + script("n", text) + path("t u n"))
    run = play(around(inner), {"found": []}).run().complete("u").complete("u")
    assert run.variables == {"found": [0, 1], "new": 1}
    assert run.complete("u").variables == {"found": [0, 1, 2], "new": 2}


def test_in_a_multi_instance_activity_its_body_sees_its_own_counter(play: Play) -> None:
    inner = script("b", "found.append((place, loopCounter)); last = loopCounter", loop(loopMaximum="2"))
    whole = sub("a", many(times("2"), True), script("p", "place = loopCounter"), inner, path("p b"))
    run = play(around(whole), {"found": []}).run()
    assert run.variables == {"found": [(1, 0), (1, 1), (2, 0), (2, 1)]}


def test_new_variables_of_a_loop_stay(play: Play) -> None:
    assert play(around(script("a", "y = 1", loop("False")))).run().variables == {"y": 1}


def test_a_loop_without_condition_and_maximum_is_refused(play: Play) -> None:
    with pytest.raises(ModelError, match="condition or a maximum"):
        play(around(script("a", "", loop())))


def test_a_loop_without_rest_is_a_livelock(play: Play) -> None:
    run = play(around(script("a", "pass", loop("True"))), moves=1000).run()
    assert "loop over a" in str(run.instance.error)


def test_a_script_that_changes_its_counter_does_not_change_its_place(play: Play) -> None:
    out = extensions('<zeebe:loopCharacteristics outputCollection="out" outputElement="=x"/>')
    run = play(around(script("a", "x = loopCounter\nloopCounter = 1", many(out + times(2))))).run()
    assert run.variables == {"out": [1, 2]}


def test_conditions_inside_see_how_many_have_completed(play: Play) -> None:
    inner = user("u") + boundary("b", "u", condition("nrOfCompletedInstances > 0"))
    run = play(around(sub("a", many(times(3)), inner))).run().complete("u")
    assert run.visits["b"] == 2
    assert run.status == "completed"
