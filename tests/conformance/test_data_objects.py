"""Data objects hold variables (docs/semantics.md)."""

import pytest
from conftest import Play
from engine_models import (
    boundary,
    call,
    catch,
    element,
    end,
    error,
    flow,
    gateway,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
)

from fame.engine.data import match, own_copy
from fame.middleware import messages

READS = "<dataInputAssociation id='i{0}'><sourceRef>{1}</sourceRef></dataInputAssociation>"
WRITES = "<dataOutputAssociation id='o{0}'><targetRef>{1}</targetRef></dataOutputAssociation>"


def data(id: str = "d", **values: str) -> str:
    return element("dataObjectReference", id, properties(**values))


def task(id: str, *content: str) -> str:
    return element("task", id, *content)


def test_an_input_association_assigns_when_the_activity_starts(play: Play) -> None:
    content = (
        data(x="1", y="${x + 1}", z="true", name="weed") + start() + task("a", READS.format("", "d")) + path("s a")
    )
    run = play(content).run()
    assert run.log == "s a =completed"
    assert run.variables == {"x": 1, "y": 2, "z": True, "name": "weed"}


def test_names_that_are_not_defined_are_left_unset(play: Play) -> None:
    content = data(x="${nowhere}", y="2") + start() + task("a", READS.format("", "d")) + path("s a")
    assert play(content).run().variables == {"y": 2}


def test_an_output_association_assigns_when_the_activity_ends(play: Play) -> None:
    content = data(x="${n}") + start() + element("userTask", "u", WRITES.format("", "d")) + path("s u")
    run = play(content, {"n": 1}).run()
    assert run.variables == {"n": 1}
    assert run.complete("u", {"n": 5}).variables == {"n": 5, "x": 5}


def test_a_throwing_event_reads_its_data_first(play: Play) -> None:
    said = "<dataInputAssociation id='i'><sourceRef>d</sourceRef></dataInputAssociation>"
    event = throw("t", properties(type="std_msgs/msg/Int32", payload="${x}"), said, signal("A"))
    content = data(x="7") + start() + catch("c", signal("A")) + event + path("s c") + path("s t")
    assert play(content).run().variables["A"] == 7


def test_data_of_an_outer_scope_is_read_inside_a_sub_process(play: Play) -> None:
    content = data(x="1") + start() + sub("p", task("a", READS.format("", "d"))) + path("s p")
    assert play(content).run().variables == {"x": 1}


def test_an_assignment_that_fails_is_an_error_of_the_activity(play: Play) -> None:
    content = (
        data(x="${1 / n}") + start() + task("a", READS.format("", "d")) + boundary("b", "a", error()) + path("s a")
    )
    assert play(content, {"n": 0}).run().log == "s a!script b =completed"


def test_a_call_with_shared_variables_assigns_its_input_data_there(play: Play) -> None:
    called = process(start("t") + script("k", "y = x") + path("t k"), id="Q")
    content = data(x="4") + start() + call("c", "Q", READS.format("", "d")) + path("s c")
    assert play(model(content, called)).run().variables == {"x": 4, "y": 4}


OUTPUT = (
    '<ioSpecification><dataOutput id="o" name="y"/><dataOutput id="p" name="z"/><inputSet/><outputSet>'
    "<dataOutputRefs>o</dataOutputRefs><dataOutputRefs>p</dataOutputRefs><optionalOutputRefs>p</optionalOutputRefs>"
    "</outputSet></ioSpecification>"
)


@pytest.mark.parametrize(("content", "inside"), [("", OUTPUT), (data(y=""), WRITES.format("", "d"))])
def test_an_output_that_nothing_has_set_is_reported_once(play: Play, content: str, inside: str) -> None:
    activity = content + start() + script("a", "n = n + 1", inside) + gateway("exclusive", "g", default="g_a") + end()
    flows = path("s a g a") + flow("g", "e", "n > 2")
    run = play(activity + flows, {"n": 0}).run()
    assert run.status == "completed"
    assert run.reports == ["has ended, and nothing has set its output y"]
    assert play(activity + flows, {"n": 0, "y": 1}).run().reports == []


def test_with_strict_it_is_an_error_of_the_activity(play: Play) -> None:
    content = start() + script("a", "n = 1", OUTPUT) + boundary("b", "a", error()) + path("s a")
    assert play(content, strict=True).run().log == "s a a!script b =completed"
    assert play(content.replace("n = 1", "y = 1"), strict=True).run().log == "s a =completed"


def test_the_value_of_a_wrapper_goes_to_one_variable() -> None:
    value = messages.create("std_msgs/msg/Int32", {"data": 3})
    assert match(("data", "data_raw"), "count", value) == {"data": ("data",)}


def test_a_copy_of_a_value_shares_nothing_that_can_change() -> None:
    value = (1, [2], {"a": [3]})
    copied = own_copy(value)
    value[1].append(4)
    value[2]["a"].append(5)
    assert copied == (1, [2], {"a": [3]})
