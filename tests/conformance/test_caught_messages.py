"""What a caught message does to the variables (docs/signals.md)."""

from conftest import Play
from engine_models import (
    boundary,
    catch,
    element,
    error,
    extensions,
    handler,
    path,
    properties,
    signal,
    start,
    sub,
    user,
)

POINT = {"x": 1.0, "y": 2.0}


def mapped(name: str, text: str) -> str:
    output = f'<camunda:outputParameter name="{name}">{text}</camunda:outputParameter>'
    return f"<camunda:inputOutput>{output}</camunda:inputOutput>"


def caught(*inside: str, type: str = "geometry_msgs/msg/Vector3") -> str:
    said = f'<camunda:properties><camunda:property name="type" value="{type}"/></camunda:properties>'
    return (
        start() + catch("c", extensions(said + inside[0] if inside else said), *inside[1:], signal("A")) + path("s c")
    )


def test_without_a_mapping_one_variable_named_like_the_signal_takes_the_message(play: Play) -> None:
    found = play(caught()).run().signal("A", POINT).variables
    assert list(found) == ["A"]
    assert (found["A"].x, found["A"].y) == (1.0, 2.0)


def test_of_a_wrapper_it_takes_the_bare_value(play: Play) -> None:
    assert play(caught(type="std_msgs/msg/String")).run().signal("A", "weed").variables == {"A": "weed"}


def test_an_explicit_mapping_decides_alone(play: Play) -> None:
    mapping = mapped("far", "${msg.x}")
    assert play(caught(mapping)).run().signal("A", POINT).variables == {"far": 1.0}


def test_a_data_object_at_the_event_takes_fields_by_name(play: Play) -> None:
    written = "<dataOutputAssociation id='o'><targetRef>d</targetRef></dataOutputAssociation>"
    object = element("dataObjectReference", "d", properties(x="", y=""))
    run = play(caught("", written) + object).run().signal("A", POINT)
    assert run.variables == {"x": 1.0, "y": 2.0}


def test_a_mapping_that_fails_is_an_error_of_the_event(play: Play) -> None:
    mapping = mapped("far", "${1 / msg.x}")
    inner = caught(mapping).replace('id="s"', 'id="t"').replace('"s"', '"t"')
    content = start() + sub("p", inner) + boundary("b", "p", error()) + path("s p")
    run = play(content).run().signal("A", {"x": 0.0})
    assert run.log == "s (p t (c c!script b -p =completed"
    assert not run.left_behind()


def test_a_boundary_event_and_an_event_sub_process_take_messages_too(play: Play) -> None:
    typed = properties(type="std_msgs/msg/Int32")
    content = start() + user("u") + boundary("b", "u", typed, signal("A"), interrupting=False) + path("s u")
    content += handler("h", start("t", signal("B"), interrupting=False).replace("<signal", typed + "<signal"))
    run = play(content).run().signal("A", 4).signal("B", 5)
    assert (run.variables["A"], run.variables["B"]) == (4, 5)


def test_in_a_model_of_the_original_declared_variables_take_the_fields_that_they_begin_like(play: Play) -> None:
    said = properties(fields="prefix") + element("dataObject", "o") + element("dataObject", "p")
    goal = element("dataObjectReference", "d", properties(x_goal="${x_goal}", zoom="1"), dataObjectRef="o")
    limits = element("dataObjectReference", "l", properties(y_min="0.0"), dataObjectRef="p")
    found = play(said + goal + limits + caught()).run().signal("A", POINT).variables
    assert sorted(found) == ["A", "x_goal"]
    assert found["x_goal"] == 1.0
    plain = play(goal + element("dataObject", "o") + caught()).run().signal("A", POINT).variables
    assert list(plain) == ["A"]


def test_of_those_none_that_an_arrow_fills_elsewhere(play: Play) -> None:
    said = properties(fields="prefix") + element("dataObject", "o")
    goal = element("dataObjectReference", "d", properties(x_goal="${x_goal}"), dataObjectRef="o")
    arrow = element("dataOutputAssociation", "a", "<targetRef>d</targetRef>")
    model = said + goal + caught() + element("task", "t", arrow) + path("c t")
    assert list(play(model).run().signal("A", POINT).variables) == ["A"]


def test_inside_an_instance_it_sets_the_variables_outside_that_have_these_names(play: Play) -> None:
    """Also of a topic without a type, whose messages are mappings."""
    once = "<multiInstanceLoopCharacteristics><loopCardinality>1</loopCardinality></multiInstanceLoopCharacteristics>"
    taken = "<dataOutputAssociation id='o'><targetRef>d</targetRef></dataOutputAssociation>"
    data = element("dataObjectReference", "d", properties(x="${x}"))
    content = start() + data + sub("p", once, catch("c", taken, signal("A"))) + path("s p")
    assert play(content, {"x": 0}).run().signal("A", {"x": 5}).variables == {"x": 5}
