"""`fame.Simulation` drives one process from Python, in simulated time."""

import dataclasses
import gc
import sys
from pathlib import Path

import pytest
from bpmn_text import process

import fame
from fame.bpmn.reader import read_text
from fame.bpmn.topics import EMPTY_TYPE
from fame.log.recorder import Recorder
from fame.log.recording_file import Sink
from fame.middleware import messages
from fame.robot.durable import DurableRecorder
from fame.robot.journal import Journal, StateDirectory

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"
  xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="test">
  <signal id="S" name="weed_found"/><message id="M" name="order"/>
  <process id="main" isExecutable="true">
"""
TYPED = (
    '<extensionElements><camunda:properties><camunda:property name="type" value="geometry_msgs/msg/Vector3"/>'
    "</camunda:properties></extensionElements>"
)


def model(content: str, *flows: tuple[str, str]) -> fame.bpmn.model.Definitions:
    arrows = "".join(
        f'<sequenceFlow id="f{n}" sourceRef="{source}" targetRef="{target}"/>'
        for n, (source, target) in enumerate(flows, 1)
    )
    return read_text(f"{HEAD}{content}{arrows}</process></definitions>", file="test.bpmn")


def script(text: str) -> fame.bpmn.model.Definitions:
    task = f'<startEvent id="s"/><scriptTask id="t"><script>{text}</script></scriptTask><endEvent id="e"/>'
    return model(task, ("s", "t"), ("t", "e"))


WEED = model(
    f'<startEvent id="s"/><intermediateCatchEvent id="c">{TYPED}<signalEventDefinition signalRef="S"/>'
    '</intermediateCatchEvent><endEvent id="e"/>',
    ("s", "c"),
    ("c", "e"),
)


def test_a_process_runs_to_its_end_with_the_variables_given():
    simulation = fame.Simulation(script("x = x + 1"), process="main", variables={"x": 41}).run()
    (instance,) = simulation.instances
    assert instance.status == "completed"
    assert instance.variables == {"x": 42}
    assert instance.visits == {"s": 1, "t": 1, "e": 1}
    assert instance.error is None


def test_a_signal_from_outside_is_taken_as_a_message_of_its_type():
    simulation = fame.Simulation(WEED).run()
    assert simulation.instances[0].waiting == ["c"]
    simulation.signal("weed_found", {"x": 1.0, "y": 2.0})
    weed = simulation.instances[0].variables["weed_found"]
    assert (weed.x, weed.y, weed.z) == (1.0, 2.0, 0.0)
    assert simulation.instances[0].status == "completed"


def test_a_signal_that_does_not_fit_its_type_is_refused_and_nothing_moves():
    simulation = fame.Simulation(WEED).run()
    with pytest.raises(fame.MessageError, match=r"geometry_msgs/msg/Vector3.*w"):
        simulation.signal("weed_found", {"w": 1.0})
    assert simulation.instances[0].waiting == ["c"]


def test_a_user_task_waits_until_somebody_completes_it():
    simulation = fame.Simulation(
        model('<startEvent id="s"/><userTask id="u"/><endEvent id="e"/>', ("s", "u"), ("u", "e"))
    ).run()
    assert simulation.instances[0].waiting == ["u"]
    simulation.complete("u", {"approved": True})
    assert simulation.instances[0].status == "completed"
    assert simulation.instances[0].variables == {"approved": True}


def test_completing_what_does_not_wait_says_what_does():
    simulation = fame.Simulation(WEED).run()
    with pytest.raises(fame.MissionError, match=r"currently waiting: c"):
        simulation.complete("nothing")


TIMER = model(
    '<startEvent id="s"/><intermediateCatchEvent id="wait"><timerEventDefinition><timeDuration>PT90S</timeDuration>'
    '</timerEventDefinition></intermediateCatchEvent><endEvent id="e"/>',
    ("s", "wait"),
    ("wait", "e"),
)


def test_simulated_time_jumps_to_what_is_due_and_stops_where_it_is_told():
    simulation = fame.Simulation(TIMER).run(until=30)
    assert (simulation.now, simulation.instances[0].waiting) == (30.0, ["wait"])
    simulation.run()
    assert (simulation.now, simulation.instances[0].status) == (90.0, "completed")


TIMED = model(
    '<startEvent id="s"/><intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT60S</timeDuration>'
    "</timerEventDefinition></intermediateCatchEvent>"
    '<endEvent id="e"><signalEventDefinition signalRef="S"/></endEvent>',
    ("s", "c"),
    ("c", "e"),
)


def test_a_signal_after_a_bounded_run_does_not_move_time():
    simulation = fame.Simulation(TIMED).run(until=30)
    simulation.signal("weed_found")
    assert simulation.now == 30.0


def test_a_message_reaches_the_receive_task_that_waits_for_it():
    simulation = fame.Simulation(
        model('<startEvent id="s"/><receiveTask id="r" messageRef="M"/><endEvent id="e"/>', ("s", "r"), ("r", "e"))
    ).run()
    simulation.message("order", {"id": 7})
    assert simulation.instances[0].variables == {"order": {"id": 7}}


def test_an_awaiting_script_suspends_on_simulated_time():
    simulation = fame.Simulation(script("await sleep(2.5)\nx = 1")).run()
    assert simulation.now == 2.5
    assert simulation.instances[0].variables == {"x": 1}


def test_an_error_of_a_script_names_robot_file_line_and_element():
    simulation = fame.Simulation(script("x = 1\ny = x / 0")).run()
    (instance,) = simulation.instances
    assert instance.status == "failed"
    assert str(instance.error) == "robot: t (test.bpmn:7): ZeroDivisionError: division by zero"
    assert instance.error.code == "script"


def test_a_script_hears_what_its_own_robot_throws():
    content = f"""<startEvent id="s"/><parallelGateway id="p"/>
      <scriptTask id="t"><script>got = (await receive("/weed_found")).x</script></scriptTask><endEvent id="e"/>
      <intermediateThrowEvent id="throw">{
        TYPED.replace("</camunda:properties>", '<camunda:property name="payload" value="{x: 3}"/></camunda:properties>')
    }<signalEventDefinition signalRef="S"/></intermediateThrowEvent>
      <endEvent id="e2"/>"""
    simulation = fame.Simulation(model(content, ("s", "p"), ("p", "t"), ("p", "throw"), ("t", "e"), ("throw", "e2")))
    assert simulation.run().instances[0].variables == {"got": 3.0}


def test_a_service_task_calls_the_function_it_names():
    content = (
        '<startEvent id="s"/><serviceTask id="t" camunda:type="external" camunda:topic="weigh"/><endEvent id="e"/>'
    )
    definitions = model(content, ("s", "t"), ("t", "e"))
    seen = []
    fame.Simulation(definitions, variables={"x": 5}, services={"weigh": lambda v: seen.append(v["x"])}).run()
    assert seen == [5]
    with pytest.raises(fame.ModelError, match=r"unknown service 'weigh'; known are: "):
        fame.Simulation(definitions)


def test_a_file_with_several_processes_wants_the_name_of_one():
    two = read_text(f'{HEAD}<startEvent id="a"/></process><process id="other" isExecutable="true">'
                    '<startEvent id="b"/></process></definitions>')  # fmt: skip
    with pytest.raises(fame.ModelError, match=r"main, other; fame.Scenario.load\(path\).run\(\) runs all of them"):
        fame.Simulation(two)
    assert fame.Simulation(two, "other").run().instances[0].visits == {"b": 1}


def test_a_process_that_is_named_runs_with_the_types_that_the_others_say():
    payload = TYPED.replace('"type" value="geometry_msgs/msg/Vector3"', '"payload" value="{x: 1}"')
    two = read_text(
        f'{HEAD}<startEvent id="a"/><endEvent id="b">{payload}<signalEventDefinition signalRef="S"/></endEvent>'
        '<sequenceFlow id="f" sourceRef="a" targetRef="b"/></process><process id="other" isExecutable="true">'
        f'<startEvent id="c">{TYPED}<signalEventDefinition signalRef="S"/></startEvent></process></definitions>'
    )
    assert fame.Simulation(two, "main").run().instances[0].status == "completed"
    with pytest.raises(fame.ModelError, match="has a payload and no type"):
        fame.Simulation(read_text(two.source.decode().replace(TYPED, "")), "main")


# ---- topics ----------------------------------------------------------------------------------------------------------

PRIVATE = TYPED.replace("</camunda:properties>", '<camunda:property name="scope" value="robot"/></camunda:properties>')


@pytest.mark.parametrize("name", ["~/weed_found", "/SCOUT/weed_found"])
def test_a_topic_may_be_named_as_error_messages_do(name: str):
    catch = (
        f'<startEvent id="s"/><intermediateCatchEvent id="c">{PRIVATE}<signalEventDefinition signalRef="S"/>'
        '</intermediateCatchEvent><endEvent id="e"/>'
    )
    simulation = fame.Simulation(model(catch, ("s", "c"), ("c", "e")), robot="SCOUT").run()
    assert simulation.signal(name, {"x": 2.0}).instances[0].variables["weed_found"].x == 2.0


def test_a_script_gets_what_is_signalled_too():
    simulation = fame.Simulation(script('m = (await receive("/news", "std_msgs/msg/String")).data')).run()
    assert simulation.signal("news", "rain").instances[0].variables == {"m": "rain"}


@pytest.mark.parametrize("name", ["weed_fonud", "~/weed_found", "/other/weed_found"])
def test_a_topic_that_nothing_of_the_model_names_is_an_error(name: str):
    simulation = fame.Simulation(WEED).run()
    with pytest.raises(fame.MessageError, match=r"no event or script of the model names topic .*: /weed_found"):
        simulation.signal(name, {"x": 1.0})
    assert simulation.instances[0].waiting == ["c"]


def test_that_nobody_listens_at_the_moment_is_none():
    simulation = fame.Simulation(WEED).run().signal("weed_found", {"x": 1.0})
    assert simulation.signal("weed_found", {"x": 2.0}).instances[0].variables["weed_found"].x == 1.0
    late = fame.Simulation(script('await sleep(1)\nm = await receive("/news", "std_msgs/msg/String")')).run(0)
    assert late.signal("/news", "too early").instances[0].status == "running"


def test_what_waits_for_a_condition_names_it_and_its_values():
    text = "<conditionalEventDefinition><condition>full and level &gt; 3</condition></conditionalEventDefinition>"
    catch = f'<startEvent id="s"/><intermediateCatchEvent id="Ca_Full">{text}</intermediateCatchEvent>'
    simulation = fame.Simulation(model(catch, ("s", "Ca_Full")), variables={"level": 2}).run()
    (wait,) = simulation.node.waiting_tokens()
    assert (wait.element, wait.text) == ("Ca_Full", "condition full and level > 3 (full is not set, level = 2)")


def test_a_second_simulation_has_the_program_of_the_first_but_nothing_of_its_run() -> None:
    definitions = script("x = x + 1")
    first, second = (fame.Simulation(definitions, variables={"x": x}) for x in (1, 5))
    watched = fame.Simulation(definitions, observer=print)
    assert first.node.engine.program is second.node.engine.program
    assert first.node.engine.program is not watched.node.engine.program
    assert [each.run().instances[0].variables["x"] for each in (first, second)] == [2, 6]
    assert not dataclasses.replace(definitions).made


def test_a_program_with_services_is_compiled_for_each_simulation() -> None:
    definitions = model('<serviceTask id="t" camunda:type="external" camunda:topic="grip" camunda:resultVariable="x"/>')
    for value in (1, 2):
        run = fame.Simulation(definitions, services={"grip": lambda variables, value=value: value}).run()
        assert run.instances[0].variables["x"] == value


def test_an_ended_instance_leaves_nothing_that_only_the_search_for_cycles_would_free() -> None:
    simulation = fame.Simulation(script("for n in range(3): x = n")).run()
    gc.collect()
    for _ in range(10):
        simulation.start()
    simulation.instances.clear()
    assert gc.collect() == 0


def test_of_the_instances_that_have_ended_the_last_thousand_are_kept_and_all_are_counted() -> None:
    simulation = fame.Simulation(model('<startEvent id="s"/><userTask id="u"/>', ("s", "u"))).run()
    for _ in range(1003):
        simulation.start()
        simulation.complete("u")
    kept = simulation.instances
    assert [one.status for one in kept] == ["completed"] * 1000 + ["running"]
    assert (simulation.node.started, simulation.node.completed) == (1004, 1003)


@pytest.mark.long
@pytest.mark.parametrize("kept", ["nothing", "a journal", "a recording"])
def test_a_year_of_missions_takes_no_more_memory_than_a_day(kept: str, tmp_path: Path) -> None:
    task = '<scriptTask id="t"><script>found = [1, 2]</script></scriptTask><endEvent id="e"/>'
    start = '<startEvent id="s"><signalEventDefinition signalRef="S"/></startEvent>'
    recorder = Recorder(Sink) if kept == "a recording" else None
    simulation = fame.Simulation(model(start + task, ("s", "t"), ("t", "e")), observer=recorder)
    if kept == "a journal":
        DurableRecorder(simulation.node, Journal(StateDirectory(tmp_path), {"robot": "robot"})).begin()
    simulation.run()
    sizes = []
    for _ in range(2):
        for _ in range(1200):  # of which the last thousand are kept
            simulation.signal("/weed_found")
        gc.collect()
        sizes.append(sys.getallocatedblocks())
    assert simulation.node.completed == 2400
    assert sizes[1] - sizes[0] < 500
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 1_000_000


def test_what_a_sensor_sends_before_the_start_pushes_out_no_message_of_another_topic() -> None:
    started = "".join(
        f'<startEvent id="{id}">{typed}<signalEventDefinition signalRef="{ref}"/></startEvent>'
        f'<scriptTask id="t{id}"><script>seen = "{id}"</script></scriptTask>'
        for id, ref, typed in (("w", "S", TYPED), ("o", "O", ""))
    )
    flows = (("w", "tw"), ("o", "to"))
    text = process(started + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in flows),
                   '<signal id="S" name="weed_found"/><signal id="O" name="tick"/>')  # fmt: skip
    seen = list[str]()
    simulation = fame.Simulation(read_text(text, file="test.bpmn"), observer=lambda event: seen.append(event.element))
    other = simulation.middleware.node("other")
    ticks, weeds = other.publisher("/tick", EMPTY_TYPE), other.publisher("/weed_found", "geometry_msgs/msg/Vector3")
    weeds.publish(messages.create(weeds.type, {"x": 1.0}))
    for _ in range(1100):
        ticks.publish(messages.create(ticks.type, None))
        simulation.scheduler.run(simulation.scheduler.now + 1)
    simulation.node.start()
    assert (simulation.node.started, seen.count("tw") > 0, seen.index("tw") < seen.index("to")) == (1001, True, True)
