"""Terminate end events (standard 13.5.6; docs/semantics.md)."""

from conftest import Play
from engine_models import (
    TERMINATE,
    boundary,
    call,
    catch,
    end,
    gateway,
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

ENDING = start("t") + gateway("parallel", "f") + user("u") + end("x", TERMINATE) + path("t f u") + path("f x")


def test_it_ends_the_process_with_all_that_goes_on_in_it(play: Play) -> None:
    run = play(ENDING).run()
    assert run.log == "t f (u x -u =completed"
    assert not run.left_behind()


def test_in_a_sub_process_it_ends_that_and_the_flow_goes_on(play: Play) -> None:
    content = start() + gateway("parallel", "g") + sub("p", ENDING) + script("y") + user("w")
    assert play(content + path("s g p y") + path("g w")).run().log == "s g (p (w t f (u x -u p) y"


def test_in_a_called_process_it_ends_that(play: Play) -> None:
    content = model(start() + call("c", "Q") + script("y") + path("s c y"), process(ENDING, id="Q"))
    assert play(content).run().log == "s (c t f (u x -u c) y =completed"


def test_it_reaches_into_all_depths(play: Play) -> None:
    inner = sub("p", sub("q", user("u") + handler("h", start("v", signal("A"))))) + catch("c", signal("B"))
    run = play(inner + end("x", TERMINATE) + path("c x")).run().signal("B")
    assert run.log == "(p (c (q (u c) x -p -q -u =completed"
    assert not run.left_behind()


def test_in_a_nested_sub_process_it_ends_the_innermost_one(play: Play) -> None:
    content = sub("p", sub("q", ENDING) + user("w")) + script("y") + path("p y")
    assert play(content).run().log == "(p (q (w t f (u x -u q)"


def test_in_a_non_interrupting_handler_it_ends_that_handler(play: Play) -> None:
    handling = handler(
        "h", ENDING.replace('id="t" isInterrupting="true">', 'id="t" isInterrupting="false">' + signal("A"))
    )
    run = play(user("w") + handling).run().signal("A")
    assert run.log == "(w (h t f (u x -u h)"
    assert run.complete("w").status == "completed"


def test_in_an_interrupting_handler_it_ends_the_scope_whose_place_that_took(play: Play) -> None:
    handling = handler(
        "h", ENDING.replace('id="t" isInterrupting="true">', 'id="t" isInterrupting="true">' + signal("A"))
    )
    content = start() + sub("p", user("w") + handling) + script("y") + path("s p y")
    assert play(content).run().signal("A").log == "s (p (w -w (h t f (u x -u h) p) y =completed"


def test_boundary_events_of_a_terminated_sub_process_are_disarmed(play: Play) -> None:
    content = sub("p", ENDING) + boundary("b", "p", signal("A"), interrupting=False) + user("w") + path("p w")
    run = play(content).run().signal("A")
    assert run.log == "(p t f (u x -u p) (w"


def test_what_follows_waits_for_scripts_that_leave(play: Play) -> None:
    inner = script("a", "try:\n    await sleep(9)\nfinally:\n    await sleep(1)") + catch("c", signal("A"))
    content = sub("p", inner + end("x", TERMINATE) + path("c x")) + script("y") + path("p y")
    run = play(content).run(1).signal("A")
    assert run.log == "(p (a c x -a"
    assert run.run(2.5).log == "(p (a c x -a p) y =completed"


def test_in_the_original_semantics_it_ends_all_of_its_participant_from_a_non_interrupting_handler(play: Play) -> None:
    handling = handler("h", start("t", signal("A"), interrupting=False) + end("x", TERMINATE) + path("t x"))
    nested = start("go", signal("GO")) + sub("p", user("w") + handling) + script("y") + path("go p y")
    run = play(model(process(nested, semantics="original"))).run().signal("GO").signal("GO").signal("A")
    assert run.log == "go (p (w go (p (w (h t (h t x -p -w -h -p -w -h =completed =completed"
    assert not run.left_behind()
