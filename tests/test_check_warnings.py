"""What `fame check` warns of, what it only notes, and what it does not blame."""

from pathlib import Path

import pytest
from bpmn_text import extensions, properties
from check_drawing import (
    BOOL,
    ROOT,
    START,
    VECTOR,
    alone,
    call,
    catch,
    caught_at,
    choice,
    data,
    ends,
    event,
    filling,
    flow,
    flows,
    given,
    parallel,
    reading,
    row,
    script,
    service,
    team,
    throw,
    timer,
    told,
)

from fame.cli import main
from fame.errors import UnavailableError

BRANCHES = ends("a", "b")
DOCK, TRIGGER = "nav2_msgs/action/DockRobot", "std_srvs/srv/Trigger"


def resuming(resume: str) -> str:
    """An event sub-process ``h``, which suspends its scope or ends it."""
    inside = f"{event('startEvent', 'hs', 'found')}{ends('he')}{flow('hs', 'he')}"
    return f'<subProcess id="h" triggeredByEvent="true">{properties(resume=resume)}{inside}</subProcess>'


def transaction(name: str, end: str) -> str:
    """A transaction around a sub-process that ends it with the event `end`."""
    definition = f"<{end}EventDefinition/>" if end else ""
    inside = f'<startEvent id="begin"/><endEvent id="stop">{definition}</endEvent>{flows("begin stop")}'
    sub_process = f'<startEvent id="rs"/><subProcess id="p">{inside}</subProcess>{flows("rs p")}'
    return f'<transaction id="{name}">{sub_process}</transaction>'


def boundary_of_cancel(activity: str) -> str:
    """A boundary event that catches the cancel of a transaction."""
    definition = "<cancelEventDefinition/>"
    return f'<boundaryEvent id="b" attachedToRef="{activity}">{definition}</boundaryEvent>{ends("be")}{flows("b be")}'


TWICE = '<camunda:property name="type" value="std_msgs/msg/Int32"/>'
INPUTS = '<camunda:inputOutput>' + '<camunda:inputParameter name="v">1</camunda:inputParameter>' * 2 + (
    '</camunda:inputOutput>'
)  # fmt: skip
WARNINGS = {
    "a script that is ready for a message that does not fit": (
        row(script('try:\n    robot.publish("led", "std_msgs/msg/ColorRGBA", red=1.0)\nexcept Exception:\n    pass')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: red: there is no such field; "
        "those of std_msgs/msg/ColorRGBA are r, g, b, a",
    ),
    "compensation of a task without a handler": (
        row(script("x = 1"))
        + '<endEvent id="undo"><compensateEventDefinition activityRef="t"/></endEvent>'
        + flows("t undo"),
        "undo: compensates t, which has no compensation handler: nothing is undone",
    ),
    "a cancel that nothing catches": (
        row(transaction("r", "cancel")),
        "stop: cancels r, which has no cancel boundary event: that is an error, and undoes nothing",
    ),
    "a cancel that nothing throws": (
        row(transaction("r", "")) + boundary_of_cancel("r"),
        "b: catches the cancel of r, in which no end event cancels",
    ),
    "an element that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "lost"),
        "lost: is never reached: no flow leads here from a start",
    ),
    "a part that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "lost") + ends("after") + flows("lost after"),
        "lost: is never reached, nor what follows it (1): no flow leads here from a start",
    ),
    "a circle that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "c1") + script("y = 1", "c2") + flows("c1 c2 c1"),
        "c1: is never reached, nor what follows it (1): no flow leads here from a start",
    ),
    "an element that nothing follows": (
        START + parallel("g") + script("x = 1") + ends("e") + flows("s g t", "g e"),
        "t: has no outgoing flow, although other paths lead to an end event",
    ),
    "a gateway that nothing follows": (
        START + choice("g") + flows("s g"),
        "g: has no outgoing flow: the token ends here",
    ),
    "a choice without a default": (
        row(script("x = 1")) + choice("g") + BRANCHES + flows("s g") + flow("g", "a", "x") + flow("g", "b", "x == 0.5"),
        "g: has no way out if none of its conditions is true: mark one of its flows as the default",
    ),
    "a choice with a flow that has no condition": (
        row(script("x = 1")) + choice("g") + BRANCHES + flows("s g", "g a") + flow("g", "b", "x"),
        "g-a: has no condition, so g always takes it: give it one, or mark it as the default",
    ),
    "a choice with a default and a flow that has no condition": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g a", "g b"),
        "g-a: has no condition, so g always takes it: give it one, or mark it as the default",
    ),
    "a condition in quotes": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b")
        + flow("g", "a", "'x > 3'"),
        "g-a: its condition is a text in quotes, always true: expected x > 3",
    ),
    "a property that is spelt with a capital": (
        row(throw("a", "done", Type=BOOL)),
        "a: its property 'Type' has no effect: did you mean 'type'?",
    ),
    "a property of another element": (
        row(throw("a", "done", missed="skip")),
        "a: its property 'missed' has no effect here: it is for timer events",
    ),
    "a queue of an event that throws": (
        row(throw("a", "done", queue="1")),
        "a: its property 'queue' has no effect here: only an element that catches has one",
    ),
    "a property that is there twice": (
        row(throw("a", "done", type=BOOL).replace("</camunda:properties>", f"{TWICE}</camunda:properties>")),
        "a: has two properties 'type': only the last one counts",
    ),
    "an input that is there twice": (
        row(script("x = v").replace("><script>", f">{extensions(INPUTS)}<script>")),
        "t: sets 'v' twice: only the last one counts",
    ),
    "an error that does not interrupt": (
        row(script("x = 1")) + '<boundaryEvent id="b" attachedToRef="t" cancelActivity="false"><errorEventDefinition/>'
        f"</boundaryEvent>{ends('f')}{flows('b f')}",
        "b: is drawn as non-interrupting, but its activity has ended with the error",
    ),
    "a default flow with a condition": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g") + flow("g", "a", "x")
        + flow("g", "b", "x"),
        "g-b: is the default flow: its condition is never evaluated",
    ),
    "a condition that leaves a parallel gateway": (
        row(script("x = 1")) + parallel("g") + BRANCHES + flows("s g", "g a") + flow("g", "b", "x"),
        "g-b: its condition is never evaluated: g takes no conditions",
    ),
    "a parallel join of an exclusive choice": (
        START + script("x = 1", "a") + script("x = 2", "b") + choice("g", 'default="g-b"') + parallel("j") + ends("e")
        + flows("s g b j e", "a j") + flow("g", "a", "1 > 0"),
        "j: waits for 2 flows from g, which takes only one: it may wait forever",
    ),
    "an exclusive merge of parallel flows": (
        START + script("x = 1", "a") + script("x = 2", "b") + parallel("g") + choice("m") + ends("e")
        + flows("s g a m e", "g b m"),
        "m: is reached 2 times from g, so what follows it runs 2 times: use a parallel gateway to join the flows",
    ),
    "a cycle that fires once": (
        row(timer("intermediateCatchEvent", "timeCycle", "R/PT1S")),
        "w: fires only once, so only the first time of its cycle counts: use a duration",
    ),
    "a cycle on an interrupting boundary event": (
        row(script("x = 1")) + timer("boundaryEvent", "timeCycle", "R/PT1S", 'attachedToRef="t"') + flows("w e"),
        "w: fires only once, so only the first time of its cycle counts: use a duration",
    ),
    "a form field of a type that Camunda does not have": (
        row('<userTask id="ask"><extensionElements><camunda:formData><camunda:formField id="bags" type="integer"/>'
            '<camunda:formField id="why" type="string"/></camunda:formData></extensionElements></userTask>'),
        "ask: its form field bags is of type 'integer': any answer is accepted; did you mean 'long'?",
    ),
    "a form that is not found": (
        row('<userTask id="ask" camunda:formKey="Form_none"/>'),
        "ask: any answer is accepted: its form Form_none is in no .form file beside the model, and not embedded",
    ),
    "an answer that a constant replaces": (
        data("d", bags="4")
        + row('<userTask id="ask"><extensionElements><camunda:formData><camunda:formField id="bags" type="long"/>'
              '</camunda:formData></extensionElements><dataOutputAssociation id="o"><targetRef>d</targetRef>'
              "</dataOutputAssociation></userTask>"),
        "d: its value 4 of bags replaces the answer of ask: leave it empty",
    ),
    "months that may be meant as minutes": (
        row(timer("intermediateCatchEvent", "timeDuration", "P5M")),
        "w: P5M is 5 months: PT5M is as many minutes",
    ),
    "a topic of the robot without a type": (
        row(catch("a", "odom", scope="robot")),
        "a: no event declares the type of the robot's topic ~/odom: set property type",
    ),
    "a data object filled by a topic without a type": (
        data("d", x="${x}", y="${y}") + row(catch("a", into="d")),
        "a: no event declares the type of topic /done, so it is std_msgs/msg/Empty, which has no field for x, y: "
        "set property type",
    ),
    "a data object with names that the message does not have": (
        data("d", width="${width}") + row(catch("a", into="d", type=VECTOR)),
        f"a: {VECTOR} has no field for width: expected names like its fields (x, y, z) or <field>_...",
    ),
    "a data object that nothing is connected to": (
        data("d", speed="0.5") + row(script("x = 1")),
        "d: is connected to no element, so nothing ever sets speed",
    ),
    "a variable that nothing sets": (
        row(script("target_x = 1"), script("y = target_z", "t2")),
        "t2: reads `target_z`, which nothing sets; did you mean `target_x`?",
    ),
    "a payload of what nothing sets": (
        row(throw("a", type=VECTOR, payload="{x: ${speed}}")),
        "a: reads `speed`, which nothing sets",
    ),
    "a condition on what nothing sets": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b") + flow("g", "a", "low"),
        "g-a: reads `low`, which nothing sets",
    ),
    "a constant of Python where it is written small": (
        START + script("x = 1") + choice("g", 'default="g-b"') + BRANCHES + flows("s t g b")
        + flow("g", "a", "${x == True}"),
        "g-a: reads `True`, which nothing sets; in this language it is true",
    ),
    "a constant of other languages in Python": (
        row(script("x = true")),
        "t: reads `true`, which nothing sets; in Python it is True",
    ),
    "a function of the robot without its robot": (
        row(script("publish('/x', 'std_msgs/msg/Bool', data=True)")),
        "t: reads `publish`, which nothing sets; did you mean robot.publish?",
    ),
    "a name that only Python has": (
        row(throw("a", type="std_msgs/msg/Float64", payload="${math.pi}")),
        "a: reads `math`, which nothing sets; math is a name of Python: write Python, without ${ }",
    ),
    "JavaScript in Python": (
        row(script("console.log(1)")),
        "t: reads `console`, which nothing sets; for JavaScript, set the script format javascript",
    ),
    "an arrow to a data object that should come from it": (
        data("d", x="4") + row(filling("t", "d", "y = x")),
        "d: sets x after t has ended, but t reads it: draw the arrow from the data object to t",
    ),
    "a decimal comma": (
        data("d", x="4,5") + row(reading("t", "d", "y = x")),
        "d: x: expected the number 4.5, got the text '4,5'",
    ),
    "a sleep that blocks": (
        row(script("import time\ntime.sleep(1)")),
        "t: time.sleep() blocks the whole robot: use await sleep(...)",
    ),
    "an error that is misspelt where it is caught": (
        row(script("x_goal, y_goal = 1, 1"), call("GoTo", "GoTo")) + caught_at("GoTo", "unreachabel"),
        "b: catches error 'unreachabel', which nothing in GoTo throws; did you mean 'unreachable'?",
    ),
    "an error with a name and no code where it is caught": (
        row(script("raise BpmnError('spilt')")) + caught_at("t", "named"),
        "b: catches every error: 'spilt' is only the name of its error, which has no code",
    ),
    "an error that another activity throws": (
        row(script("raise BpmnError('spilt')")) + caught_at("t", "lost"),
        "b: catches error 'lost', which nothing in t throws; it throws spilt",
    ),
    "an error that an action does not have": (
        row(service(action="drive", type=DOCK)) + caught_at("t", "abort"),
        "b: catches error 'abort', which nothing in t throws; did you mean 'aborted'?",
    ),
    "an error that only retry = never brings": (
        row(service(action="drive", type=DOCK)) + caught_at("t", "lost"),
        "b: catches error 'lost', but a request of unknown fate is made again: for the error, set retry = never",
    ),
    "a call that the mission itself suspends": (
        row(service(service="pour", type=TRIGGER)) + resuming("true"),
        "t: after h it calls again, even if the first call has been done: set retry = never, ask or safe",
    ),
    "a timer of what nothing sets": (
        row(timer("intermediateCatchEvent", "timeDuration", "PT${pause}S")),
        "w: reads `pause`, which nothing sets",
    ),
    "a variable that hides the interface of scripts": (
        row(script("robot = 3")),
        "t: sets a variable `robot`, which hides robot of the script interface: rename the variable",
    ),
    "a topic whose variable hides the interface of scripts": (
        row(catch("a", "log")),
        "a: sets a variable `log`, which hides log of the script interface: rename the variable",
    ),
    "a script in JavaScript that never says next": (
        row(script("this.environment.variables.x = 1;", format="javascript")),
        "t: never calls next(), so it fails after it has run: next() completes a script",
    ),
    "a message that fills variables by their names": (
        row(script("next();", format="javascript"), catch("a", "found", type="geometry_msgs/msg/Vector3"))
        + data("goal", x_goal="${x_goal}"),
        "a: fills `x_goal` with field x because the names are alike: connect the event with the data object",
    ),
    "a process that calls itself without end, in time": (
        row(timer("intermediateCatchEvent", "timeDuration", "PT1S"), call("again", "P")),
        "again: P calls itself endlessly: every path through it leads to such a call",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(content: str, expected: str) -> None:
    assert expected in told(alone(content), "warning")


def test_a_property_whose_letters_are_swapped_and_a_payload_that_is_caught_are_warnings() -> None:
    assert "a: its property 'tpye' has no effect: did you mean 'type'?" in told(alone(row(throw("a", tpye=BOOL))))
    caught = told(alone(row(catch("a", payload="true"))))
    assert "a: its property 'payload' has no effect here: only an element that throws has one" in caught


def test_a_signal_that_nobody_catches_is_a_warning_where_the_file_has_all_robots() -> None:
    one, other = row(throw("a")), row(catch("b", "found"), mark="2")
    assert told(team(one, other)) == [
        "a: throws /done, but nothing in bad.bpmn catches it",
        "b: waits for /found, but nothing in bad.bpmn throws it",
    ]
    assert told(team(one, row(catch("b"), mark="2"))) == []


UNIT = """
Inputs:
  In: {Topic: joint_states, Field: [effort], MessageType: sensor_msgs/msg/JointState}
Outputs:
  Alarm: {Topic: /alarm, Field: [data], MessageType: std_msgs/msg/Bool}
Processor: {Class: Threshold, Parameters: {threshold: 1}}
"""


@pytest.mark.parametrize(
    ("unit", "signal", "said"),
    [
        (UNIT, "alarm", []),
        (UNIT, "alram", ["catch: waits for /alram, but nothing in bad.bpmn throws it; did you mean /alarm?"]),
        (UNIT.replace("/alarm", "alarm"), "alarm", ["catch: waits for /alarm, but nothing in bad.bpmn throws it"]),
        (UNIT.replace("Bool", "String"), "alarm", ["catch: topic /alarm has type std_msgs/msg/Bool here, but call says"
         " std_msgs/msg/String: a topic has one type"]),
        (UNIT.replace("effort", "efort"), "alarm", ["call: does not start: unit.yaml:3: Inputs.In.Field: sensor_msgs/ms"
         "g/JointState: there is no field efort; it has header, name, position, velocity, effort"]),
        (UNIT.replace("Alarm:", "Alram:"), "alarm", ["call: does not start: unit.yaml:5: Outputs.Alram: no processor "
         "computes it; Threshold computes alarm, channel, name, loss, excess, active"]),
        (UNIT.replace(": 1", ": abc"), "alarm", ["call: does not start: unit.yaml:6: Processor.Parameters.threshold: "
         "expected a number"]),
        (UNIT.replace(": 1", ": 1, model: later.npz, hysteresis: 2"), "alarm", ["call: does not start: unit.yaml:6: "
         "Processor.Parameters.hysteresis: expected a number from 0 to 1"]),
        (UNIT.replace(": 1", ": 1, model: later.npz"), "alarm", []),
        (UNIT.replace("Threshold, Parameters: {threshold: 1}", "own.Alarms"), "alarm",
         ["call: does not start: unit.yaml:6: Processor.Class: Python does not find the module own here: install it"]),
        (UNIT.replace("Threshold", "Treshold"), "alarm", ["call: does not start: unit.yaml:6: Processor.Class: "
         "expected a processor, module:Class or file.py:Class, got 'Treshold'; did you mean 'Threshold'?"]),
        (UNIT.replace("{Class", "[{Class: Expression, Parameters: {formula: 2 * Inn}}, {Class") + "]", "alarm",
         ["call: does not start: unit.yaml:6: Processor[0].Parameters: unknown input Inn; did you mean 'In'?"]),
        ("", "alarm", ["call: does not start: there is no configuration unit.yaml in "]),
    ],
)  # fmt: skip
def test_the_topics_of_a_pipeline_are_those_of_its_configuration(
    unit: str, signal: str, said: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if unit:
        Path("unit.yaml").write_text(unit)
    watch = data("it", configuration="unit.yaml") + row(call("call", "ProcessingUnit", given("call", "it")))
    signals = "".join(f'<signal id="S_{name}" name="{name}"/>' for name in ("alarm", "alram"))
    waits = row(catch("catch", signal, type=BOOL), mark="2")
    found = told(team(watch, waits).replace("</definitions>", f"{signals}</definitions>"))
    assert [line[: len(each)] for line, each in zip(found, said, strict=True)] == said


def test_a_signal_that_is_spelt_in_two_ways_is_told_with_the_other_spelling() -> None:
    spelt = '<signal id="S_Done" name="Done"/></definitions>'
    text = team(row(throw("a", "Done")), row(catch("b"), mark="2")).replace("</definitions>", spelt)
    assert told(text) == [
        "a: throws /Done, but nothing in bad.bpmn catches it; did you mean /done?",
        "b: waits for /done, but nothing in bad.bpmn throws it; did you mean /Done?",
    ]


def test_it_is_a_warning_that_the_process_of_a_pool_is_compensated_by_nobody() -> None:
    content, expected = NOTES["a compensation event sub-process of a process that nothing calls"]
    assert expected in told(team(content), "warning")


def test_it_is_a_note_where_others_may_be_at_the_other_end() -> None:
    expected = ["a: throws /done, but nothing in bad.bpmn catches it"]
    for text in (alone(row(throw("a"))), team(row(throw("a")), pools='<participant id="X" name="crowd"/>')):
        assert told(text) == []
        assert [line for line in told(text, "note") if line.startswith("a")] == expected


def test_a_script_in_javascript_may_try_a_type_that_nobody_knows() -> None:
    makes = 'node.createPublisher("geometry_msgs/msg/Vektor3", "v")'
    said = "t: type geometry_msgs/msg/Vektor3: there is no such message type; did you mean geometry_msgs/msg/Vector3"
    for text, level in ((makes, "error"), (f"try {{ {makes} }} catch (e) {{}}", "warning")):
        (found,) = told(alone(row(script(f"{text}; next()", format="js"))), level)
        assert found.startswith(said)


def test_scripts_are_at_the_ends_of_topics_too() -> None:
    sends = row(script('signal("done")'), script('await receive("/found")', "t2"))
    assert told(team(sends, row(catch("a"), throw("b", "found"), mark="2"))) == []


def test_the_topics_of_a_robot_are_its_drivers_affair() -> None:
    own = row(throw("a", "odom", scope="robot", type=BOOL, payload="true"))
    assert told(team(own, row(mark="2"))) == []


def test_what_the_reader_notes_is_passed_on() -> None:
    label = '<intermediateThrowEvent id="a" name="other">' + extensions(f'<ros:message type="{BOOL}"/>')
    text = alone(row(label + '<signalEventDefinition signalRef="S_done"/></intermediateThrowEvent>'))
    assert told(text) == ["a: the topic is 'done', the name of the signal, not the label 'other'"]


def test_an_interrupting_handler_of_the_originals_models_is_a_warning() -> None:
    start = event("startEvent", "hs", "done")
    handler = f'<subProcess id="h" triggeredByEvent="true">{start}{ends("he")}{flows("hs he")}</subProcess>'
    text = alone(row(script("next()", format="javascript")) + handler)
    expected = (
        "h: ends its scope; the original FaMe resumed the scope afterwards: "
        "for that, set property semantics=original on the process"
    )
    assert expected in told(text)
    original = text.replace('isExecutable="true" >\n', f'isExecutable="true">\n{properties(semantics="original")}')
    assert original != text
    assert expected not in told(original)
    assert expected not in told(alone(row(script("x = 1")) + handler))


def test_a_language_that_is_not_installed_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_script(*arguments: object, **named: object) -> object:
        raise UnavailableError("t: JavaScript is not installed: pip install it")

    monkeypatch.setattr("fame.check.gate.compile_script", compile_script)
    expected = "t: cannot be checked: JavaScript is not installed: pip install it"
    assert told(alone(row(script("next()", format="javascript")))) == [expected]


HEAR = script("node.createSubscription('std_msgs/msg/Bool', 'go', () => {}); next()", format="javascript")
ROUND = choice("g") + flow("g", "s1", "more") + flow("g", "e") + flows("s s1 t g")
AGAIN = "t: creates a subscription in each iteration: end the previous one with node.destroySubscription(...)"

NOTES = {
    "a compensation event sub-process of a process that nothing calls": (
        row(script("x = 1")) + '<subProcess id="undo" triggeredByEvent="true"><startEvent id="back">'
        "<compensateEventDefinition/></startEvent></subProcess>",
        "undo: runs only where a call activity calls this process: it undoes a completed activity",
    ),
    "a name that becomes a topic": (
        row(script('signal("Order received")')), "t: the name 'Order received' becomes the topic /Order_received"
    ),
    "a subscription that is made in a loop": (
        START + script("more = False", "s1") + HEAR + ends("e") + ROUND, AGAIN
    ),
    "a subscription that is made in a task that repeats": (
        row(HEAR.replace("</scriptTask>", "<standardLoopCharacteristics/></scriptTask>")), AGAIN
    ),
    "a subscription that is made in a sub-process that repeats": (
        row(f'<subProcess id="p">{row(HEAR, mark="2")}<standardLoopCharacteristics/></subProcess>'), AGAIN
    ),
    "a subscription in a handler that does not interrupt": (
        row(script("x = 1", "s1")) + '<subProcess id="h" triggeredByEvent="true">'
        '<startEvent id="b" isInterrupting="false"><timerEventDefinition><timeCycle>R3/PT1S</timeCycle>'
        f'</timerEventDefinition></startEvent>{HEAR}{flows("b t")}</subProcess>', AGAIN
    ),
    "a subscription behind an event that does not interrupt": (
        row(script("await sleep(9)", "s1")) + HEAR + flows("w t")
        + timer("boundaryEvent", "timeCycle", "R3/PT1S", 'attachedToRef="s1" cancelActivity="false"'), AGAIN
    ),
    "a script task without a script": (row('<scriptTask id="t"/>'), "t: has no script: it completes at once"),
    "a plain task": (row('<task id="t"/>'), "t: a plain task does nothing: it completes at once"),
    "a service task": (
        row('<serviceTask id="t" implementation="grip"/>'),
        "t: needs the service 'grip' where it runs: Simulation(services=...)",
    ),
}  # fmt: skip
GUIDELINES = {
    "a user task": (
        row('<userTask id="t"/>'),
        "t: a user task is not among the elements that the guidelines recommend (G2)",
    ),
    "an embedded sub-process": (
        row(f'<subProcess id="t">{row(mark="2")}</subProcess>'),
        "t: an embedded sub-process is not among the elements that the guidelines recommend (G2)",
    ),
    "an inclusive gateway": (
        row('<inclusiveGateway id="t"/>'),
        "t: an inclusive gateway is not among the elements that the guidelines recommend (G2)",
    ),
    "a message event": (
        row('<intermediateThrowEvent id="t" name="m"><messageEventDefinition/></intermediateThrowEvent>'),
        "t: a message event is not among the elements that the guidelines recommend (G2)",
    ),
    "a condition on what no data object declares": (
        row(script("low = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b") + flow("g", "a", "low"),
        "g-a: decides by `low`, which no data object declares (G4)",
    ),
    "a payload of what no data object declares": (
        row(script("v = 1"), throw("a", type=VECTOR, payload="{x: ${v}}")),
        "a: sends `v`, which no data object declares (G4)",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), NOTES.values(), ids=NOTES.keys())
def test_it_is_a_note(content: str, expected: str) -> None:
    assert expected in told(alone(content), "note")


@pytest.mark.parametrize(("content", "expected"), GUIDELINES.values(), ids=GUIDELINES.keys())
def test_a_deviation_from_the_guidelines_is_a_note_on_request(content: str, expected: str) -> None:
    assert expected in told(alone(content), "note", guidelines=True)
    assert expected not in told(alone(content), "note")


def test_sound_models_are_told_nothing_of_guidelines_unless_asked(capsys: pytest.CaptureFixture[str]) -> None:
    model = str(ROOT / "models" / "warehouse.bpmn")
    for words, noted in ([], False), (["--guidelines"], True):
        assert main(["check", model, *words]) == 0
        assert ("(G2)" in capsys.readouterr().out) is noted
    for option in ("--guidelines", "--explain", "--against-graph"):
        assert main(["check", model, "--explore", option]) == 2
        assert f"{option} does not go with --explore" in capsys.readouterr().err
    page = (ROOT / "docs" / "checks.md").read_text()
    assert all(f"| G{number} |" in page for number in range(1, 5))


def test_message_flows_and_black_boxes_are_notes() -> None:
    pools = '<participant id="X" name="crowd"/><messageFlow id="M" sourceRef="Pool1" targetRef="X"/>'
    assert told(team(row(), pools=pools), "note") == [
        "X: is a black box: no robot plays it, and its signals come from outside",
        "M: has no effect: a message flow joins an element that sends a message with one that receives it",
    ]


def test_two_pools_that_do_the_same_are_a_note() -> None:
    one = data("d", x="1") + row(reading("a", "d", "y = x"))
    other = one.replace('id="', 'id="o_').replace('Ref="', 'Ref="o_').replace("Ref>", "Ref>o_").replace("o_</", "</")
    expected = "Pool2: does the same as pool REX: use one multi-instance pool for such robots (G1)"
    assert expected in told(team(one, other), "note", guidelines=True)
    assert expected not in told(team(one, other.replace("y = x", "y = -x")), "note", guidelines=True)
    field = '{"type": "select", "key": "k", "defaultValue": ["a"], "values": [{"label": "A", "value": ["a"]}]}'
    form = f'<zeebe:userTaskForm id="f">{{"components": [{field}]}}</zeebe:userTaskForm>'
    asked = '<zeebe:formDefinition formKey="camunda-forms:bpmn:f"/>'
    asks = f'{extensions(form)}{row(f"""<userTask id="u">{extensions(asked)}</userTask>""")}'
    assert expected in told(
        team(asks, asks.replace('id="', 'id="o_').replace('Ref="', 'Ref="o_')), "note", guidelines=True
    )


GUARD = '<boundaryEvent id="w" attachedToRef="{}"><errorEventDefinition/></boundaryEvent>'
FINE = {
    "a recursion with a way out": (
        START + choice("g", 'default="g-e"') + call("again", "P") + script("n = 1") + ends("e")
        + flows("s t g e", "again e") + flow("g", "again", "n > 0")
    ),
    "a recursion that a script ends": row(script('raise BpmnError("enough")'), call("again", "P")),
    "a recursion with a way past by a boundary event": (
        row(script("x = 1"), call("again", "P")) + GUARD.format("t") + flows("w e")
    ),
    "a recursion that ends where no condition is true": (
        START + script("n = 1") + call("again", "P") + ends("e") + flows("s t", "again e") + flow("t", "again", "n > 0")
    ),
    "a parallel join of parallel flows": (
        START + parallel("g") + script("x = 1", "a") + script("x = 2", "b") + parallel("j") + ends("e")
        + flows("s g a j e", "g b j")
    ),
    "an exclusive merge of a choice": (
        START + choice("g", 'default="g-b"') + script("x = 1", "a") + script("x = 2", "b") + choice("m") + ends("e")
        + flows("s g b m e", "a m") + flow("g", "a", "1 > 0")
    ),
    "a loop": (
        START + choice("m") + script("x = 1") + choice("g", 'default="g-m"') + ends("e")
        + flows("s m t g m") + flow("g", "e", "x")
    ),
    "links": (
        START + '<intermediateThrowEvent id="a"><linkEventDefinition name="l"/></intermediateThrowEvent>'
        '<intermediateCatchEvent id="b"><linkEventDefinition name="l"/></intermediateCatchEvent>' + ends("e")
        + flows("s a", "b e")
    ),
    "a cycle that goes on beside its activity": (
        row('<userTask id="t"/>') + ends("x")
        + timer("boundaryEvent", "timeCycle", "R/PT1S", 'attachedToRef="t" cancelActivity="false"') + flows("w x")
    ),
    "a flow that starts without a start event": script("x = 1") + script("y = x", "t2") + flows("t t2"),
    "an event sub-process": (
        row(catch("a")) + '<subProcess id="h" triggeredByEvent="true">'
        + event("startEvent", "hs", "found") + ends("he") + flows("hs he") + "</subProcess>"
    ),
    "a payload of computed values": row(
        script("v = [1, 2]"), throw("a", type="geometry_msgs/msg/Pose", payload="{position: {x: ${v[0]}}}")
    ),
    "results of a script in a data object": data("d", x="${x}") + row(filling("t", "d", "x = 1")),
    "an error that a script throws": row(script("raise BpmnError('lost')")) + caught_at("t", "lost"),
    "an error of whatever code": row(script("raise BpmnError(codes[0])\ncodes = []")) + caught_at("t", "lost"),
    "an exception": row(script("x = 1 / 0")) + caught_at("t", "script"),
    "an error of a service": row(service(service="a", type=TRIGGER, retry="never")) + caught_at("t", "lost"),
    "an error of a call in a script": (
        row('<scriptTask id="t">' + properties(retry="never")
            + f'<script>await robot.call("a", "{TRIGGER}")</script></scriptTask>') + caught_at("t", "lost")
    ),
    "an error with a code of its own": (
        row(service(service="a", type=TRIGGER, retry="never", errors="{lost: abort}")) + caught_at("t", "abort")
    ),
    "a suspended call that may be made again": row(service(service="a", type=TRIGGER, retry="safe")) + resuming("true"),
    "a suspended goal, which is canceled": row(service(action="a", type=DOCK)) + resuming("true"),
    "a call that is cancelled": row(service(service="a", type=TRIGGER)) + resuming("false"),
    "an error inside": (
        row('<subProcess id="p">' + row(script("raise BpmnError('lost')"), mark="2") + "</subProcess>")
        + caught_at("p", "lost")
    ),
    "an activity that a boundary event leads on from": (
        START + script("await until(lambda: False)") + ends("e") + flows("s t", "w e")
        + timer("boundaryEvent", "timeDuration", "PT1S", 'attachedToRef="t"')
    ),
    "a number made of two": row(script("v = 1"), throw("a", type="std_msgs/msg/Int32", payload="${v}${v}")),
    "a wrapper's payload": row(script("v = 1"), throw("a", type="std_msgs/msg/Float64", payload="${v}")),
    "a computed list": row(
        script("v = 1"),
        throw("a", type="std_msgs/msg/Float64MultiArray", payload="{data: [1, ${v}], layout: {dim: [{size: ${v}}]}}"),
    ),
    "a computed time": row(script("v = 1"), timer("intermediateCatchEvent", "timeDuration", "PT${v}S")),
    "a time that is an expression": row(script("v = 'PT1S'"), timer("intermediateCatchEvent", "timeDuration", "${v}")),
    "a type on one event alone": row(throw("a", payload="true"), catch("b", type=BOOL)),
    "a script that takes a topic as it is": row(script('x = robot.latest("odom")')),
    "a subscription that is made once": row(HEAR),
    "a subscription that another script destroys": (
        START + script("node.destroySubscription(s); next()", "s1", "javascript") + HEAR + ends("e")
        + choice("g", 'default="g-e"') + flow("g", "s1", "True") + flows("s s1 t g", "g e")
    ),
    "a script that hides a builtin": row(catch("a", "found"), script("range = 3")),
}  # fmt: skip


@pytest.mark.parametrize("content", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(content: str) -> None:
    assert told(alone(content)) == []


def test_the_topic_of_a_name_is_noted_once() -> None:
    text = alone(row(throw("a"), throw("b"), script('signal("all done")'))).replace('name="done"', 'name="all done"')
    notes = [one for one in told(text, "note") if "becomes" in one]
    assert notes == ["a: the name 'all done' becomes the topic /all_done"]


SAFE = "but a request of unknown fate is made again: for the error, set retry = never"
NEVER, RENAMED = {"retry": "never"}, {"errors": "{lost: abort}"}


@pytest.mark.parametrize(
    ("said", "code", "expected"),
    [
        (NEVER | RENAMED, "lost", "catches error 'lost', which nothing in t throws; did you mean 'abort'?"),
        ({"retry": "ask"} | RENAMED, "lost", "catches error 'lost', which nothing in t throws; did you mean 'abort'?"),
        (NEVER | RENAMED, "abort", ""),
        (RENAMED, "abort", f"catches error 'abort', {SAFE}"),
        (RENAMED, "lost", f"catches error 'lost', {SAFE} and catch 'abort'"),
        ({"errors": "{lost: abort, service: abort}"}, "abort", ""),
        (
            {"errors": "{rejected: abort}"},
            "abort",
            "catches error 'abort', which nothing in t throws; it throws service",
        ),
        ({"errors": "{208: abort}"}, "abort", "catches error 'abort', which nothing in t throws; it throws service"),
    ],
)
def test_an_error_is_caught_by_the_code_that_the_task_gives_it(said: dict[str, str], code: str, expected: str) -> None:
    task = row(service(service="a", type=TRIGGER, **said))
    assert told(alone(task + caught_at("t", code))) == ([f"b: {expected}"] if expected else [])


def test_a_request_that_a_called_process_makes_again_is_told() -> None:
    inside = f"</process><process id='Q'>{row(service(service='a', type=TRIGGER), mark='2')}"
    assert told(alone(row(call("c", "Q")) + caught_at("c", "lost") + inside)) == [f"b: catches error 'lost', {SAFE}"]


CODES = "".join(f'<error id="E_{code}" errorCode="{code}"/>' for code in ("taken_over", "missed", "unreachable"))
SENDS = (
    f'<intermediateThrowEvent id="m">{properties(to="DINGO")}<messageEventDefinition messageRef="M"/>'
    "</intermediateThrowEvent>"
)


def away(tag: str, missed: str = "fail", attributes: str = "") -> str:
    """A timer event ``w`` that may come due while the engine is away."""
    event = timer(tag, "timeDuration", "PT5S", attributes)
    return event.replace("<timerEventDefinition>", properties(missed=missed) + "<timerEventDefinition>")


def inside(element: str) -> str:
    """A sub-process ``p`` with an element."""
    return f'<subProcess id="p">{row(element, mark="2")}</subProcess>'


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (row(script("x = 1")) + caught_at("t", "taken_over"), ""),
        (row(inside(SENDS)) + caught_at("p", "unreachable"), ""),
        (row(inside(SENDS.replace(properties(to="DINGO"), ""))) + caught_at("p", "unreachable"), "unreachable"),
        (row(inside(away("intermediateCatchEvent"))) + caught_at("p", "missed"), ""),
        (row(inside(away("intermediateCatchEvent", "fire"))) + caught_at("p", "missed"), "missed"),
        (row(script("x = 1")) + away("boundaryEvent", "fail", 'attachedToRef="t"') + flow("w", "be")
         + caught_at("t", "missed"), ""),
    ],
)  # fmt: skip
def test_errors_of_the_engine_are_thrown_where_it_throws_them(content: str, code: str) -> None:
    text = alone(content).replace("</definitions>", f'{CODES}<message id="M" name="order"/></definitions>')
    assert [one for one in told(text) if "catches error" in one] == (
        [f"b: catches error {code!r}, which nothing in p throws; it throws no errors"] if code else []
    )
