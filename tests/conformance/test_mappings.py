"""Data inputs and outputs (standard 10.4.1), and mappings of events, of Camunda 7 and 8."""

import pytest
from conftest import Play
from engine_models import (
    Run,
    boundary,
    catch,
    correlation,
    element,
    end,
    error,
    escalation,
    extensions,
    handler,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

from fame.errors import ModelError

DATA = '<property id="d" name="d"/><property id="r" name="r"/>'
OWN = (
    '<ioSpecification id="io"><dataInput id="din" name="n"/><dataOutput id="dout" name="y"/>'
    "<inputSet id='is'><dataInputRefs>din</dataInputRefs></inputSet>"
    "<outputSet id='os'><dataOutputRefs>dout</dataOutputRefs></outputSet></ioSpecification>"
)


def into(target: str, how: str = "", source: str = "d") -> str:
    return f'<dataInputAssociation id="i"><sourceRef>{source}</sourceRef><targetRef>{target}</targetRef>{how}' + (
        "</dataInputAssociation>"
    )


def out(source: str, how: str = "", target: str = "r") -> str:
    return f'<dataOutputAssociation id="o"><sourceRef>{source}</sourceRef><targetRef>{target}</targetRef>{how}' + (
        "</dataOutputAssociation>"
    )


def task(*content: str, text: str = "y = n * 2") -> str:
    return start() + element("scriptTask", "a", *content, f"<script>{text}</script>") + path("s a") + DATA


def mapped(*pairs: tuple[str, str], kind: str = "output") -> str:
    """A mapping of Camunda 8."""
    inside = "".join(f'<zeebe:{kind} source="{source}" target="{target}"/>' for source, target in pairs)
    return extensions(f"<zeebe:ioMapping>{inside}</zeebe:ioMapping>")


def test_a_data_input_takes_the_value_of_what_is_associated_with_it(play: Play) -> None:
    run = play(task(OWN, into("din"), out("dout")), {"d": 3}).run()
    assert (run.log, run.variables["r"]) == ("s a =completed", 6)


def test_one_that_has_no_value_yet_is_left_unset(play: Play) -> None:
    run = play(task(OWN, into("din"), out("dout"), text="x = 1")).run()
    assert run.variables == {"x": 1}


def test_a_transformation_is_what_is_moved(play: Play) -> None:
    more = "<transformation>{} + 1</transformation>"
    run = play(task(OWN, into("din", more.format("d")), out("dout", more.format("y"))), {"d": 3}).run()
    assert run.variables["r"] == 9


def test_assignments_say_all_by_themselves(play: Play) -> None:
    said = "<assignment><from>d + 5</from><to>n</to></assignment>"
    run = play(task(OWN, into("din", said), out("dout"), text="r = n"), {"d": 3, "r": 0}).run()
    assert run.variables["r"] == 8


def test_what_is_assigned_to_a_data_input_by_its_id_is_its_variable(play: Play) -> None:
    said = "<assignment><from>d + 1</from><to>din</to></assignment>"
    association = f'<dataInputAssociation id="i"><targetRef>din</targetRef>{said}</dataInputAssociation>'
    assert play(task(OWN, association, text="r = n"), {"d": 1, "r": 0}).run().variables["r"] == 2
    jbpm = association.replace(' id="i"', ' id="i" xmlns:drools="http://www.jboss.org/drools"').replace("d + 1", "Look")
    assert play(task(OWN, jbpm, text="r = n"), {"d": 1, "r": 0}).run().variables["r"] == "Look"


def test_a_data_object_with_one_variable_is_that_variable(play: Play) -> None:
    held = (
        '<dataObject id="ob"/><dataObjectReference id="dr" name="the load" dataObjectRef="ob">{}</dataObjectReference>'
    )
    content = task(OWN, into("din", source="dr"), out("dout")) + held.format(properties(load="${load}"))
    assert play(content, {"load": 4}).run().variables["r"] == 8


def test_a_throwing_event_has_data_inputs_too(play: Play) -> None:
    payload = properties(type="std_msgs/msg/Int32", payload="${n}")
    content = start() + catch("c", signal("A")) + path("s c")
    content += throw("t", payload, '<dataInput id="din" name="n"/>', into("din"), signal("A")) + path("s t") + DATA
    assert play(content, {"d": 7}).run().variables["A"] == 7


@pytest.mark.parametrize("what", ["timer", "error", "escalation", "none"])
def test_what_happens_without_a_message_may_be_mapped_too(play: Play, what: str) -> None:
    said = mapped(("=1 + 1", "n"))
    after = script("k", "x = n") + path("b k")
    content = {
        "timer": user("a") + boundary("b", "a", said, timer("PT1S")),
        "error": script("a", "1 / 0") + boundary("b", "a", said, error()),
        "escalation": sub("a", end("z", escalation("E"))) + boundary("b", "a", said, escalation()),
        "none": script("a") + throw("b", said) + path("a b"),
    }[what]
    assert play(start() + content + after + path("s a")).run(2).variables["x"] == 2


def test_so_may_the_start_of_an_event_sub_process(play: Play) -> None:
    begin = element("startEvent", "t", mapped(("=5", "n")), timer("PT1S"))
    run = play(start() + user("u") + handler("h", begin + script("k", "x = n") + path("t k")) + path("s u")).run(2)
    assert (run.log, run.variables["x"]) == ("s (u -u (h t k h) =completed", 5)


def test_and_the_none_start_event(play: Play) -> None:
    run = play(element("startEvent", "s", mapped(("=5", "n"))) + script("k", "x = n") + path("s k")).run()
    assert run.variables["x"] == 5


def test_a_mapping_of_an_event_that_fails_is_an_error_of_its_scope(play: Play) -> None:
    inner = user("a") + boundary("b", "a", extensions(
        '<camunda:inputOutput><camunda:outputParameter name="n">${1/0}</camunda:outputParameter></camunda:inputOutput>'
    ), timer("PT1S"))  # fmt: skip
    content = start() + sub("p", inner) + boundary("c", "p", error()) + path("s p")
    assert play(content).run(2).log == "s (p (a b -a b!script c -p =completed"


def test_the_inputs_of_a_throwing_event_are_for_its_payload_alone(play: Play) -> None:
    said = (
        "<camunda:inputOutput><camunda:inputParameter name='n'>${d * 2}</camunda:inputParameter></camunda:inputOutput>"
    )
    payload = properties(type="std_msgs/msg/Int32", payload="${n}").replace(
        "<extensionElements>", f"<extensionElements>{said}"
    )
    content = start() + catch("c", signal("A")) + throw("t", payload, signal("A")) + path("s c") + path("s t")
    assert play(content, {"d": 4}).run().variables == {"d": 4, "A": 8}


def test_feel_sees_the_fields_of_a_caught_message_by_their_names(play: Play) -> None:
    begin = element(
        "startEvent", "s", mapped(("=x + 1", "n")), properties(type="geometry_msgs/msg/Vector3"), message("M")
    )
    run = play(begin + user("u") + path("s u")).run().message("M", {"x": 2.0})
    assert run.variables == {"n": 3.0}
    begin = element("startEvent", "s", mapped(("=order.id", "n")), message("M"))
    run = play(begin + user("u") + path("s u")).run().message("M", {"order": {"id": 4}})
    assert run.variables == {"n": 4}


def test_what_a_receive_task_takes_leaves_its_own_variables(play: Play) -> None:
    said = (
        "<camunda:inputOutput><camunda:inputParameter name='n'>5</camunda:inputParameter>"
        "<camunda:outputParameter name='z'>${msg['k'] + n}</camunda:outputParameter></camunda:inputOutput>"
    )
    content = start() + element("receiveTask", "r", extensions(said), messageRef="message_M") + path("s r")
    assert play(content).run().message("M", {"k": 2}).variables == {"z": 7}


def test_a_receive_task_correlates_like_an_event(play: Play) -> None:
    content = start() + element("receiveTask", "r", messageRef="message_M") + path("s r")
    run = play(model(process(content), root=correlation("msg['key']", "M")), {"key": 1}).run().message("M", {"key": 2})
    assert run.waiting == ["r"]
    assert run.message("M", {"key": 1}).status == "completed"


def test_the_code_of_an_error_or_escalation_may_be_computed_where_it_is_thrown(play: Play) -> None:
    for kind in ("error", "escalation"):
        root = f'<{kind} id="E1" {kind}Code="=code"/><{kind} id="E2" {kind}Code="lost"/>'
        inner = start("t") + end("z", f'<{kind}EventDefinition {kind}Ref="E1"/>') + path("t z")
        content = (
            start() + sub("p", inner) + boundary("b", "p", f'<{kind}EventDefinition {kind}Ref="E2"/>') + path("s p")
        )
        run = play(model(process(content), root=root), {"code": "lost"}).run()
        assert run.visits["b"] == 1
        with pytest.raises(
            ModelError, match=r"test.bpmn:1: b: the \w+ code '=code' is computed: a catch event needs a fixed"
        ):
            Run(model(process(content.replace("E2", "E1")), root=root))


def test_a_code_that_cannot_be_computed_is_an_error_of_the_event(play: Play) -> None:
    root = '<error id="E1" errorCode="${1 / 0}"/><escalation id="E2" escalationCode="=nothing"/>'
    for kind, id in (("error", "E1"), ("escalation", "E2")):
        inner = start("t") + end("z", f'<{kind}EventDefinition {kind}Ref="{id}"/>') + path("t z")
        content = start() + sub("p", inner) + boundary("b", "p", error()) + path("s p")
        assert play(model(process(content), root=root)).run().log.endswith("z!script b -p =completed")


def test_the_name_of_a_topic_is_not_computed() -> None:
    for name in ("=topic", "order-${id}"):
        content = process(start() + throw("t", '<signalEventDefinition signalRef="S1"/>') + path("s t"))
        with pytest.raises(ModelError, match=r"test.bpmn:1: t: the name '.*' is computed: give a fixed name"):
            Run(model(content, root=f'<signal id="S1" name="{name}"/>'))


def test_a_send_task_may_call_what_a_service_task_calls(play: Play) -> None:
    said = extensions('<zeebe:taskDefinition type="wave"/>')
    content = start() + element("sendTask", "a", said, **{"camunda:resultVariable": "y"}) + path("s a")
    assert play(content, services={"wave": lambda variables: 5}).run().variables == {"y": 5}


def test_global_tasks_are_refused_by_name() -> None:
    content = process(start() + element("callActivity", "c", calledElement="G") + path("s c"))
    with pytest.raises(ModelError, match=r"test.bpmn:1: c: it calls the <globalUserTask> G: make it a process"):
        Run(model(content, root='<globalUserTask id="G" name="look"/>'))


def test_a_condition_in_another_file_is_refused_by_name() -> None:
    flow = '<sequenceFlow id="f" sourceRef="s" targetRef="e"><conditionExpression camunda:resource="c.groovy"/>'
    with pytest.raises(ModelError, match=r"test.bpmn:1: f: its condition is the resource c.groovy"):
        Run(start() + end() + f"{flow}</sequenceFlow>")


# ---- the order of mappings ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("waiting", [False, True])
def test_those_of_camunda_8_see_the_ones_before_them(play: Play, waiting: bool) -> None:
    inputs = mapped(("=1", "p"), ("=p + 1", "q"), ("=q", "o.x"), ("=p", "r"), ("=o.x + r", "o.y"), kind="input")
    outputs = mapped(("=p + 10", "a"), ("=a + 1", "b"), ("=o.y", "c"))
    mapping = inputs.replace("</extensionElements>", "") + outputs.replace("<extensionElements>", "")
    task = script("t", "await sleep(1)" if waiting else "pass", mapping)
    run = play(start() + task + path("s t"), {"p": 7}).run(2)
    assert run.variables == {"p": 7, "a": 11, "b": 12, "c": 3}


def test_those_of_a_caught_message_too(play: Play) -> None:
    mapping = mapped(("=x + 1", "a"), ("=a + 1", "b"))
    content = start() + catch("c", mapping + signal("A")) + path("s c")
    run = play(content).run().signal("A", {"x": 1})
    assert run.variables == {"a": 2, "b": 3}


def test_those_of_camunda_7_do_not(play: Play) -> None:
    pairs = '<camunda:inputParameter name="p">${q}</camunda:inputParameter>'
    pairs += '<camunda:inputParameter name="q">${p}</camunda:inputParameter>'
    swap = extensions(f"<camunda:inputOutput>{pairs}</camunda:inputOutput>")
    run = play(start() + script("t", "seen.append((p, q))", swap) + path("s t"), {"p": 1, "q": 2, "seen": []}).run()
    assert run.variables["seen"] == [(2, 1)]
