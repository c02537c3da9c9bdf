"""Throwing and catching signals: order, delivery, types (docs/semantics.md; standard 13.5.3)."""

from conftest import Play
from engine_models import boundary, catch, end, error, gateway, path, properties, script, signal, start, sub, throw

FORK = start() + gateway("parallel", "g")


def test_a_signal_that_nobody_waits_for_is_lost(play: Play) -> None:
    run = play(start() + throw("t", signal("A")) + catch("c", signal("A")) + end() + path("s t c e")).run()
    assert run.log == "s t (c"
    assert run.signal("A").log == "s t c e =completed"


def test_a_throw_reaches_catchers_of_its_own_robot(play: Play) -> None:
    run = play(FORK + catch("c", signal("A")) + throw("t", signal("A")) + path("s g c") + path("g t")).run()
    assert run.log == "s g (c t c) =completed"


def test_tokens_ahead_come_to_rest_before_the_message_is_delivered(play: Play) -> None:
    """The thrower stands first in line; those behind it have armed their catchers when its message goes out."""
    content = FORK + throw("t", signal("A")) + script("a") + script("b") + catch("c", signal("A"))
    assert play(content + path("s g t") + path("g a b c")).run().log == "s g t a b c =completed"


def test_the_thrower_goes_on_after_its_message_was_delivered(play: Play) -> None:
    content = FORK + throw("t", signal("A")) + script("x") + catch("c", signal("A")) + script("y")
    assert play(content + path("s g t x") + path("g c y")).run().log == "s g t c x y =completed"


def test_two_throws_in_a_row_are_two_deliveries(play: Play) -> None:
    content = FORK + throw("t", signal("A")) + throw("u", signal("A")) + catch("c", signal("A"))
    content += catch("d", signal("A")) + path("s g t u") + path("g c d")
    assert play(content).run().log == "s g t c u d =completed"


def test_a_signal_of_a_script_is_delivered_before_its_token_goes_on(play: Play) -> None:
    content = start() + script("a", "signal('A')") + catch("c", signal("A")) + path("s a c")
    assert play(content).run().log == "s a (c"


def test_a_signal_of_a_script_reaches_catchers_ahead_of_it(play: Play) -> None:
    content = FORK + script("a", "signal('A')") + script("b") + catch("c", signal("A")) + path("s g a b") + path("g c")
    assert play(content).run().log == "s g a c b =completed"


def test_what_a_waiting_script_publishes_is_delivered(play: Play) -> None:
    content = FORK + catch("c", signal("A")) + script("a", "await sleep(1)\nsignal('A')\nawait sleep(1)")
    run = play(content + path("s g c") + path("g a"))
    assert run.run(1.5).log == "s g (c (a c)"
    assert run.run().log == "s g (c (a c) a) =completed"


def test_an_end_event_throws_and_ends_its_token(play: Play) -> None:
    content = FORK + catch("c", signal("A")) + end("t", signal("A")) + path("s g c") + path("g t")
    assert play(content).run().log == "s g (c t c) =completed"


def test_one_delivery_reaches_every_armed_catcher_once_in_the_order_of_arming(play: Play) -> None:
    content = FORK + "".join(catch(id, signal("A")) for id in "cab") + path("s g c") + path("g a") + path("g b")
    assert play(content).run().signal("A").log == "s g (c (a (b c) a) b) =completed"


def test_a_catcher_armed_during_a_delivery_does_not_get_it(play: Play) -> None:
    content = FORK + catch("c", signal("A")) + catch("d", signal("A")) + path("s g c d")
    assert play(content).run().signal("A").waiting == ["d"]


def test_a_catcher_that_an_earlier_one_of_the_same_delivery_cancelled_gets_nothing(play: Play) -> None:
    content = start() + sub("p", catch("c", signal("A"))) + boundary("b", "p", signal("A")) + path("s p")
    run = play(content).run().signal("A")
    assert run.log == "s (p (c b -p -c =completed"  # the boundary event was armed first
    assert "c" not in run.visits


def test_a_multiple_event_gets_one_delivery_once(play: Play) -> None:
    content = start() + catch("c", signal("A"), signal("B")) + catch("d", signal("A")) + path("s c d")
    run = play(content).run().signal("A")
    assert run.log == "s c (d"
    assert run.signal("A").status == "completed"


def test_signals_of_other_names_wake_nobody(play: Play) -> None:
    content = start() + catch("c", signal("A")) + catch("d", signal("B")) + catch("e", signal("AA"))
    run = play(content + path("s c d e")).run().signal("B").signal("AA")
    assert run.waiting == ["c"]


def test_a_signal_reaches_every_instance(play: Play) -> None:
    content = start("s", signal("go")) + catch("c", signal("A")) + path("s c")
    run = play(content).run().signal("go").signal("go").signal("A")
    assert [instance.status for instance in run.simulation.instances] == ["completed", "completed"]


def test_without_a_signal_the_label_names_the_topic(play: Play) -> None:
    labelled = '<intermediateCatchEvent id="c" name="weed_found"><signalEventDefinition/></intermediateCatchEvent>'
    assert play(start() + labelled + path("s c")).run().signal("weed_found").status == "completed"


def test_a_typed_payload_is_built_and_taken(play: Play) -> None:
    said = properties(type="geometry_msgs/msg/Vector3", payload="{x: ${a}, y: ${a * 2}}")
    content = FORK + catch("c", signal("A")) + throw("t", said, signal("A")) + path("s g c") + path("g t")
    found = play(content, {"a": 1.5}).run().variables["A"]
    assert (found.x, found.y, found.z) == (1.5, 3.0, 0.0)


def test_a_payload_that_does_not_fit_its_type_is_an_error_of_the_event(play: Play) -> None:
    said = properties(type="std_msgs/msg/Int32", payload="${a}")
    content = start() + sub("p", throw("t", said, signal("A"))) + boundary("b", "p", error()) + path("s p")
    assert play(content, {"a": "many"}).run().log == "s (p (t t!script b -p =completed"
