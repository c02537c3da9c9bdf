"""The topic table: who throws, who catches, and the one type of each topic."""

import pytest
from bpmn_text import document, properties

from fame.bpmn import read_text, topic_table
from fame.bpmn.model import Definitions
from fame.errors import ModelError
from fame.simulation import Simulation

ROOTS = '<signal id="S" name="weed_found"/><message id="M" name="order"/>'


def throw(id: str, said: str = "", definition: str = '<signalEventDefinition signalRef="S"/>') -> str:
    """An end event."""
    return f'<endEvent id="{id}">{said}{definition}</endEvent>'


def catch(id: str, said: str = "", definition: str = '<signalEventDefinition signalRef="S"/>') -> str:
    """A start event."""
    return f'<startEvent id="{id}">{said}{definition}</startEvent>'


def mission(one: str, other: str = "") -> Definitions:
    """Two processes."""
    return read_text(
        document(f'<process id="A">{one}</process>\n<process id="B">{other}</process>{ROOTS}'), file="m.bpmn"
    )


def test_a_type_on_one_event_holds_for_all_events_of_the_topic() -> None:
    table = topic_table(mission(throw("t"), catch("c", properties(type="geometry_msgs/msg/Vector3"))))
    assert list(table) == ["/weed_found"]
    use = table["/weed_found"]
    assert (use.type, use.declared) == ("geometry_msgs/msg/Vector3", "geometry_msgs/msg/Vector3")
    assert [(end.process, end.node.id) for end in use.throws] == [("A", "t")]
    assert [(end.process, end.node.id) for end in use.catches] == [("B", "c")]


def test_a_topic_that_nobody_says_anything_of_carries_empty() -> None:
    use = topic_table(mission(throw("t"), catch("c")))["/weed_found"]
    assert (use.type, use.declared) == ("std_msgs/msg/Empty", None)


def test_two_types_of_one_topic_are_an_error_that_names_both_events() -> None:
    one, other = properties(type="std_msgs/msg/Bool"), properties(type="std_msgs/msg/String")
    with pytest.raises(ModelError) as caught:
        topic_table(mission(throw("t", one), catch("c", other)))
    assert str(caught.value) == (
        "m.bpmn:3: c: topic /weed_found has type std_msgs/msg/String here, "
        "but t says std_msgs/msg/Bool: a topic has one type"
    )


def test_a_payload_without_a_type_is_an_error_that_says_so() -> None:
    with pytest.raises(ModelError, match="t: topic /weed_found has a payload and no type"):
        topic_table(mission(throw("t", properties(payload="{x: 1}")), catch("c")))


def test_a_private_topic_is_another_one() -> None:
    private = properties(scope="robot", type="std_msgs/msg/Bool")
    table = topic_table(mission(throw("t", private), catch("c", properties(type="std_msgs/msg/String"))))
    assert {name: use.type for name, use in table.items()} == {
        "~/weed_found": "std_msgs/msg/Bool",
        "/weed_found": "std_msgs/msg/String",
    }


def test_two_robots_may_have_private_topics_of_one_name_and_two_types() -> None:
    definitions = mission(
        throw("t", properties(scope="robot", type="std_msgs/msg/Bool")),
        catch("c", properties(scope="robot", type="std_msgs/msg/String")),
    )
    assert topic_table(definitions, ["B"])["~/weed_found"].type == "std_msgs/msg/String"
    assert topic_table(definitions)["~/weed_found"].type == "std_msgs/msg/Bool"


def test_policies_are_merged_and_the_throw_wins() -> None:
    use = topic_table(
        mission(
            catch("c", properties(qos_reliability="reliable", qos_depth="7")),
            throw("t", properties(qos_reliability="best_effort")),
        )
    )["/weed_found"]
    assert dict(use.qos) == {"reliability": "best_effort", "depth": "7"}


def test_messages_and_their_tasks_are_topics_and_services_are_not() -> None:
    definitions = mission(
        '<sendTask id="s" messageRef="M"/><subProcess id="sub"><receiveTask id="r" messageRef="M"/></subProcess>'
        f'<serviceTask id="v">{properties(service="land", type="std_srvs/srv/Empty")}</serviceTask>',
        catch("c", definition='<messageEventDefinition messageRef="M"/>'),
    )
    use = topic_table(definitions)["/order"]
    assert [end.node.id for end in use.throws] == ["s"]
    assert [end.node.id for end in use.catches] == ["r", "c"]
    assert list(topic_table(definitions)) == ["/order"]


def test_some_processes_of_some_files_may_be_asked_for() -> None:
    definitions = mission(throw("t"), catch("c"))
    assert topic_table(definitions, ["A"])["/weed_found"].catches == ()
    both = topic_table([definitions, mission(throw("u", properties(type="std_msgs/msg/Bool")))])
    assert [end.node.id for end in both["/weed_found"].throws] == ["t", "u"]
    assert both["/weed_found"].type == "std_msgs/msg/Bool"


@pytest.mark.parametrize(
    ("label", "topic"), [("has arrived!", "/has_arrived"), ("Fl\u00e4che 2", "/Flache_2"), ("done", "/done")]
)
def test_a_label_becomes_a_name_that_ros_2_allows(label: str, topic: str) -> None:
    model = read_text(
        document(f'<process id="A"><endEvent id="e" name="{label}"><signalEventDefinition/></endEvent></process>')
    )
    assert list(topic_table(model)) == [topic]
    text = f"the topic is {topic[1:]!r}: ROS 2 allows no name like the label {label!r}"
    assert (text in [note.text for note in model.notes]) is (topic[1:] != label)


def test_a_signal_with_a_name_that_ros_2_does_not_allow_is_not_loaded() -> None:
    wrong = document(f'<process id="A"><startEvent id="s"/>{throw("t")}</process>{ROOTS}').replace(
        "weed_found", "has arrived!"
    )
    with pytest.raises(ModelError, match="t: /has arrived! is not a valid ROS 2 topic name: expected letters"):
        Simulation(read_text(wrong, file="m.bpmn"))


def test_the_name_of_a_message_is_told_as_such() -> None:
    said = '<messageEventDefinition messageRef="M"/>'
    event = f'<endEvent id="t" name="Send it">{properties(type="std_msgs/msg/Bool")}{said}</endEvent>'
    assert [note.text for note in mission(event).notes] == [
        "the topic is 'order', the name of the message, not the label 'Send it'"
    ]
