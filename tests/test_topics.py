"""The topic table: who throws, who catches, and the one type of each topic."""

import re
from pathlib import Path

import pytest
from bpmn_text import document, process, properties

from fame.bpmn import read, read_text, topic_table
from fame.bpmn.model import Definitions
from fame.bpmn.topics import TopicEnd
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


# ---- names that people write -----------------------------------------------------------------------------------------

NAMES = {
    "weed_found": "/weed_found", "a/b": "/a/b", "_x": "/_x", "a__b": "/a__b", "/done": "/done", "~/odom": "~/odom",
    "Order received": "/Order_received", "has arrived!": "/has_arrived", "Fl\u00e4che 2": "/Flache_2",
    "3 done": "/n3_done", "a - b/c": "/a_b_c", "(Test&#10;Message)": "/Test_Message", "a_ _b": "/a_b",
}  # fmt: skip


@pytest.mark.parametrize(("name", "topic"), NAMES.items())
def test_a_name_that_ros_2_allows_stays_and_another_becomes_one(name: str, topic: str) -> None:
    signal = '<signalEventDefinition signalRef="O"/>'
    named = f'{throw("t", definition=signal)}</process><signal id="O" name="{name}"/>'
    labelled = f'<endEvent id="e" name="{name}"><signalEventDefinition/></endEvent></process>'
    for content in (named, labelled):
        assert list(topic_table(read_text(document(f'<process id="A">{content}')))) == [topic]


def test_in_what_is_shipped_each_topic_is_written_letter_by_letter() -> None:
    root = Path(__file__).parent.parent
    for path in sorted(file for folder in ("models", "examples") for file in (root / folder).rglob("*.bpmn")):
        written = re.findall(r'(?:name|id)="([^"]+)"', path.read_text())
        topics = {end.topic.name for end in _uses(read(path))}
        assert topics <= {*written}, path


def _uses(definitions: Definitions) -> list[TopicEnd]:
    return [end for use in topic_table(definitions).values() for end in (*use.throws, *use.catches)]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("/has arrived!", "/has arrived! is not a valid ROS 2 topic name: expected ASCII letters"),
        ("//a", "//a is not a valid ROS 2 topic name: expected ASCII letters"),
        ("~//a", "~//a is not a valid ROS 2 topic name: expected ASCII letters"),
        ("~/a b", "~/a b is not a valid ROS 2 topic name: expected ASCII letters"),
        ("\u5230\u8fbe 1", "'\u5230\u8fbe 1' has no Latin letter to make a topic of: write a topic as its name"),
    ],
)
def test_a_name_that_makes_no_topic_is_not_loaded(name: str, text: str) -> None:
    wrong = document(f'<process id="A"><startEvent id="s"/>{throw("t")}</process>{ROOTS}').replace("weed_found", name)
    with pytest.raises(ModelError, match=f"t: {text}"):
        Simulation(read_text(wrong, file="m.bpmn"))


def test_scripts_and_what_is_outside_use_the_name_and_the_variable_is_named_like_the_topic() -> None:
    signal = '<signal id="O" name="Order received"/>'
    listens = (
        f'<startEvent id="s">{properties(type="std_msgs/msg/Int32")}<signalEventDefinition signalRef="O"/></startEvent>'
    )
    asks = '<scriptTask id="k"><script>if 2 > Order_received: signal("Order received", 2)</script></scriptTask>'
    flow = '<sequenceFlow id="f" sourceRef="s" targetRef="k"/>'
    run = Simulation(read_text(process(listens + asks + flow, signal), file="m.bpmn"))
    run.run().signal("Order received", 1)
    assert [one.variables["Order_received"] for one in run.instances] == [1, 2]


def test_two_names_of_one_topic_are_an_error_in_called_processes_too() -> None:
    other = throw("c", definition='<signalEventDefinition signalRef="N"/>')
    caller = f'<process id="A"><startEvent id="s"/><callActivity id="k" calledElement="B"/>{throw("t")}</process>'
    text = f'{caller}<process id="B"><startEvent id="r"/>{other}</process>{ROOTS}<signal id="N" name="weed found"/>'
    with pytest.raises(ModelError) as caught:
        Simulation(read_text(document(text), file="m.bpmn"), process="A")
    assert str(caught.value).endswith(
        "c: the name 'weed found' and that of t, 'weed_found', are the same topic /weed_found: "
        "expected names that differ in letters and digits, or one name"
    )


def test_a_topic_that_is_written_literally_may_also_have_a_name() -> None:
    other = throw("c", definition='<signalEventDefinition signalRef="N"/>')
    text = f'<process id="A">{throw("t")}{other}</process>{ROOTS}<signal id="N" name="/weed_found"/>'
    assert list(topic_table(read_text(document(text)))) == ["/weed_found"]


def test_private_topics_of_two_robots_may_have_two_names() -> None:
    private, other = properties(scope="robot"), '<signalEventDefinition signalRef="N"/>'
    two = [f'<process id="{id}">{one}</process>' for id, one in
           (("A", throw("t", private)), ("B", throw("c", private, other)))]  # fmt: skip
    text = document("".join(two) + ROOTS + '<signal id="N" name="weed found"/>')
    assert list(topic_table(read_text(text))) == ["~/weed_found"]


def test_the_name_of_a_message_is_told_as_such() -> None:
    said = '<messageEventDefinition messageRef="M"/>'
    event = f'<endEvent id="t" name="Send it">{properties(type="std_msgs/msg/Bool")}{said}</endEvent>'
    assert [note.text for note in mission(event).notes] == [
        "the topic is 'order', the name of the message, not the label 'Send it'"
    ]
