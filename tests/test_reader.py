"""The reader: which files are BPMN, what may be odd about them, and what is wrong with them."""

from pathlib import Path

import pytest
from bpmn_text import body_of, document, extensions, node_of, notes_of, process, properties, refused

from fame.bpmn import read, read_bytes, read_text
from fame.bpmn.conversion import convert
from fame.bpmn.model import Assignment, Expression, Task
from fame.bpmn.pools import pools_of
from fame.bpmn.split import split
from fame.errors import MissionError, ModelError

SIGNAL = '<signal id="S" name="weed_found"/>'

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"


def test_a_file_is_read_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "mission.bpmn"
    path.write_text(process('<startEvent id="s"/>'))
    assert read(path) == read(str(path))
    assert read(path).file == str(path)
    assert read(path.read_bytes(), file="here").file == "here"


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"nowhere\.bpmn: cannot be read: No such file"):
        read(tmp_path / "nowhere.bpmn")


def test_what_is_not_xml_is_refused() -> None:
    assert "not well-formed XML" in str(refused("mission: go"))
    assert "not well-formed XML" in str(refused(""))


def test_a_truncated_file_is_refused_with_the_line_where_it_ends() -> None:
    error = refused(process('<startEvent id="s"/>\n')[:-20])
    assert error.line == 4


def test_a_document_type_is_refused_by_name_before_anything_is_expanded() -> None:
    bomb = '<!DOCTYPE a [<!ENTITY x "ha"><!ENTITY y "&x;&x;">]>' + process("&y;")
    assert "document type (<!DOCTYPE ...>)" in str(refused(bomb))
    assert "document type" in str(refused("<?xml version='1.0'?><!-- why --> <!DOCTYPE definitions>" + process("")))
    with pytest.raises(ModelError, match="document type"):
        read_bytes(bomb.encode("utf-16"), file="bad.bpmn")


def test_the_word_doctype_in_a_comment_does_no_harm() -> None:
    assert read_text("<!-- <!DOCTYPE is refused -->" + process("")).processes


def test_a_file_of_200_mb_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.bpmn"
    with path.open("wb") as file:
        file.truncate(200_000_000)
    with pytest.raises(ModelError, match="expected at most 20 MB, got 200 MB"):
        read(path)
    with pytest.raises(ModelError, match="at most 20 MB"):
        read_bytes(b" " * 20_000_001)


def test_a_document_that_is_too_deep_is_refused() -> None:
    assert "depth" in str(refused("<a>" * 300 + "</a>" * 300))


@pytest.mark.parametrize(
    ("root", "said"),
    [
        ("<definitions/>", "<definitions> without a namespace"),
        (
            '<definitions xmlns="http://www.omg.org/spec/DMN/20151101/dmn.xsd"/>',
            "of namespace http://www.omg.org/spec/DMN",
        ),
        (f'<process xmlns="{BPMN}"/>', "the root is <process>"),
    ],
)
def test_the_root_must_be_definitions_of_bpmn(root: str, said: str) -> None:
    assert said in str(refused(root))


@pytest.mark.parametrize("prefix", ["", "bpmn", "bpmn2", "semantic", "ns0"])
def test_any_prefix_will_do(prefix: str) -> None:
    p, declared = (f"{prefix}:", f"xmlns:{prefix}") if prefix else ("", "xmlns")
    text = (
        f'<{p}definitions {declared}="{BPMN}"><{p}process id="P"><{p}task id="t" name="Go"/></{p}process>'
        f"</{p}definitions>"
    )
    assert read_text(text).processes[0].body.nodes[0].name == "Go"


def test_encodings_are_those_that_the_file_declares() -> None:
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>' + process('<task id="t" name="Mähen"/>')
    assert read_bytes(text.encode("latin-1")).processes[0].body.nodes[0].name == "Mähen"
    assert read_text(text).processes[0].body.nodes[0].name == "Mähen"
    assert read_bytes(text.replace("ISO-8859-1", "UTF-16").encode("utf-16")).processes[0].body.nodes[0].name == "Mähen"


@pytest.mark.parametrize("declaration", ["<?xml{}?>", "<?xml{}>", "<?xml version='1.0'{}encoding='latin-1'{}?><a/>"])
def test_a_million_blanks_in_a_declaration_are_read_at_once(declaration: str) -> None:
    blanks = " " * 1_000_000
    refused(declaration.format(blanks, blanks))
    refused((declaration.format("", "") + "<?xml").replace("?>", " encoding='\"" * 100_000))


def test_a_namespace_with_a_blank_in_it_is_a_name_like_any_other() -> None:
    text = process('<task id="t" name="Go"/>').replace(
        "<definitions ", '<definitions xmlns:x="http://Some Tool/1" x:version="1" '
    )
    definitions = read_text(text.replace("<task ", '<task x:y="1" '), file="tool.bpmn")
    assert definitions.processes[0].body.nodes[0].name == "Go"
    assert b'"http://Some Tool/1"' in split(definitions)[0].source
    for source in (split(definitions)[0].source, convert(definitions)):
        assert read_bytes(source).processes[0].body.nodes[0].name == "Go"
    assert "not well-formed" in str(refused(text.replace("</definitions>", "")))


def test_ids_may_be_odd() -> None:
    ids = ["sid-8B2E-4F", "Tätigkeit_ü", "a.b.c", "_1"]
    nodes = body_of("".join(f'<task id="{id}"/>' for id in ids)).nodes
    assert [node.id for node in nodes] == ids


def test_elements_without_an_id_get_one_that_stays_the_same() -> None:
    text = process('<task id="a"/><task id="b"/>\n<sequenceFlow sourceRef="a" targetRef="b"/><task name="x"/><task/>')
    body = read_text(text).processes[0].body
    assert [flow.id for flow in body.flows] == ["sequenceFlow_4"]
    assert [node.id for node in body.nodes] == ["a", "b", "task_4", "task_4_2"]
    assert body.nodes[0].outgoing == body.nodes[1].incoming == ("sequenceFlow_4",)
    assert read_text(text) == read_text(text)


def test_a_file_may_have_several_processes_and_no_collaboration_nor_diagram() -> None:
    definitions = read_text(document('<process id="A"/><process id="B" isExecutable="false"/>'))
    assert [(one.id, one.executable) for one in definitions.processes] == [("A", True), ("B", False)]
    assert (definitions.participants, definitions.shapes, definitions.planes) == ((), (), ())


# ---- expressions -----------------------------------------------------------------------------------------------------


def condition_of(text: str, language: str = "", file: str = "") -> Expression:
    """A condition of a flow."""
    said = f'language="{language}"' if language else ""
    flow = (
        f'<sequenceFlow id="f" sourceRef="t" targetRef="t">'
        f"<conditionExpression {said}>{text}</conditionExpression></sequenceFlow>"
    )
    whole = document(f'<process id="P"><task id="t"/>{flow}</process>', f'expressionLanguage="{file}"' if file else "")
    condition = read_text(whole, file="bad.bpmn").processes[0].body.flows[0].condition
    assert condition is not None
    return condition


@pytest.mark.parametrize(
    ("text", "language", "file", "seen"),
    [
        ("x == 1", "", "", ("x == 1", "python")),
        ("x == 1", "Python", "", ("x == 1", "python")),
        ("${x == 1}", "", "", ("${x == 1}", "juel")),
        ("#{x}", "", "", ("#{x}", "juel")),
        ("${m['}']}", "", "", ("${m['}']}", "juel")),
        ("= x = 1", "", "", ("x = 1", "feel")),
        ("next(null, ${x})", "JavaScript", "", ("next(null, ${x})", "javascript")),
        ("x", "js", "", ("x", "javascript")),
        ("x", "", "javascript", ("x", "javascript")),
        ("x", "python", "javascript", ("x", "python")),
        ("x", "", "http://www.w3.org/1999/XPath", ("x", "python")),
        ("x", "feel", "", ("x", "feel")),
        ("x", "juel", "", ("${x}", "juel")),
    ],
)
def test_the_language_of_a_condition(text: str, language: str, file: str, seen: tuple[str, str]) -> None:
    condition = condition_of(text, language, file)
    assert (condition.text, condition.language) == seen


FEEL = [
    "http://www.omg.org/spec/FEEL/20140401",
    "http://www.omg.org/spec/DMN/20180521/FEEL/",
    *(f"https://www.omg.org/spec/DMN/{version}/FEEL/" for version in (20191111, 20211108, 20230324, 20240513)),
]


@pytest.mark.parametrize("uri", FEEL)
def test_every_version_of_feel_is_known_wherever_a_language_is_named(uri: str) -> None:
    for text, language, file in (("=x > 3", "", uri), ("x > 3", uri, ""), ("=x > 3", uri, "python")):
        assert condition_of(text.replace(">", "&gt;"), language, file) == Expression("x > 3", "feel", 2)
    node = node_of(
        f"""<task id="t"><dataInputAssociation id="d"><sourceRef>A</sourceRef><targetRef>B</targetRef>
            <transformation language="{uri}">a + 1</transformation></dataInputAssociation></task>
            <property id="A" name="a"/><property id="B" name="b"/>"""
    )
    assert node.copies_in == (Assignment("b", Expression("a + 1", "feel", 4)),)


@pytest.mark.parametrize(
    ("id", "name", "variable"),
    [("_12", "Badge Number", "Badge_Number"), ("badge", "Badge Number", "badge"), ("_12", "badge", "badge")],
)
def test_a_data_input_without_a_name_for_expressions_has_that_of_its_id_or_words(
    id: str, name: str, variable: str
) -> None:
    node = node_of(
        f"""<task id="t"><dataInputAssociation id="d"><sourceRef>{id}</sourceRef><targetRef>B</targetRef>
            </dataInputAssociation></task>
            <property id="{id}" name="{name}"/><property id="B" name="b"/>"""
    )
    assert [one.source.text for one in node.copies_in] == [f"${{{variable}}}"]


@pytest.mark.parametrize("format", ["javascript", "js", "JavaScript", "JavaScript()"])
def test_all_names_of_javascript_are_known(format: str) -> None:
    node = node_of(f'<scriptTask id="t" scriptFormat="{format}"><script>next()</script></scriptTask>')
    assert isinstance(node, Task)
    assert node.script == Expression("next()", "javascript", 3)


def test_another_language_is_an_error_that_names_the_accepted_forms() -> None:
    flow = '<sequenceFlow id="f" sourceRef="t" targetRef="t"><conditionExpression language="groovy">x'
    error = refused(process(f'<task id="t"/>{flow}</conditionExpression></sequenceFlow>'))
    assert str(error) == ("bad.bpmn:3: f: language 'groovy': expected python (the default), javascript, ${...} or =...")
    error = refused(process('<scriptTask id="t" scriptFormat="ruby"><script>x</script></scriptTask>'))
    assert (error.element, error.line) == ("t", 3)


@pytest.mark.parametrize("text", [r"${x == 'it\'s'}", r"${x == '\\'}", r"${x == 'a\'}\'b'}"])
def test_a_quote_behind_a_backslash_ends_no_text(text: str) -> None:
    (flow,) = body_of(
        f"""<startEvent id="s"/><endEvent id="e"/><sequenceFlow id="f" sourceRef="s" targetRef="e">
        <conditionExpression>{text}</conditionExpression></sequenceFlow>"""
    ).flows
    assert flow.condition == Expression(text, "juel", 4)


def test_a_condition_that_mixes_text_and_expressions_is_refused() -> None:
    flow = '<sequenceFlow id="f" sourceRef="t" targetRef="t"><conditionExpression>${x} &gt; 1'
    error = refused(process(f'<task id="t"/>{flow}</conditionExpression></sequenceFlow>'))
    assert "put all of it into one" in error.text


# ---- what is wrong ---------------------------------------------------------------------------------------------------


FLOW = '<sequenceFlow id="f" sourceRef="{}" targetRef="{}"/>'
WRONG = {
    "a sequence flow to nowhere": (
        '<task id="t"/>' + FLOW.format("t", "gone"),
        "f",
        "goes to 'gone': there is no such",
    ),
    "a sequence flow from nowhere": (
        '<task id="t"/>' + FLOW.format("gone", "t"),
        "f",
        "goes from 'gone': there is no such",
    ),
    "a sequence flow without an end": ('<task id="t"/><sequenceFlow id="f" sourceRef="t"/>', "f", "has no targetRef"),
    "a sequence flow into a sub-process": (
        '<task id="t"/><subProcess id="s"><task id="u"/></subProcess>' + FLOW.format("t", "u"),
        "f",
        "crosses the boundary of its scope",
    ),
    "a flow to an element of another namespace": (
        '<task id="t"/><x:robotTask xmlns:x="http://acme/bpmn" id="r"/>' + FLOW.format("t", "r"),
        "f",
        "that is a <robotTask> of namespace http://acme/bpmn, which is not a flow node of BPMN 2.0",
    ),
    "a flow to an element without a namespace": (
        '<task id="t"/><robotTask xmlns="" id="r"/>' + FLOW.format("t", "r"),
        "f",
        "that is a <robotTask> without a namespace, which is not a flow node of BPMN 2.0",
    ),
    "a flow to a data object": (
        '<task id="t"/><dataObject id="d"/>' + FLOW.format("t", "d"),
        "f",
        "that is a <dataObject>, not a flow node",
    ),
    "a boundary event on nothing": (
        '<boundaryEvent id="b"><signalEventDefinition signalRef="S"/></boundaryEvent>',
        "b",
        "attached to nothing",
    ),
    "a boundary event on something unknown": ('<boundaryEvent id="b" attachedToRef="gone"/>', "b", "no such activity"),
    "a boundary event on an event": (
        '<boundaryEvent id="b" attachedToRef="e"/><endEvent id="e"/>',
        "b",
        "'e', which is not an activity",
    ),
    "two elements of one id": (
        '<task id="t"/>\n<task id="t"/>',
        "t",
        "two elements have this id, the other in line 3",
    ),
    "an unknown flow element": ('<choreographyTask id="t"/>', "t", "<choreographyTask> is not a flow element"),
    "a default flow of another node": (
        '<exclusiveGateway id="g" default="f"/><task id="t"/>' + FLOW.format("t", "g"),
        "g",
        "default flow 'f' is not one of those that leave it",
    ),
    "a signal that is not there": (
        '<endEvent id="e"><signalEventDefinition signalRef="gone"/></endEvent>',
        "e",
        "signalRef 'gone': the file has no such signal",
    ),
    "a message that is not there": (
        '<endEvent id="e"><messageEventDefinition messageRef="gone"/></endEvent>',
        "e",
        "messageRef 'gone': the file has no such message",
    ),
    "an error that is not there": (
        '<endEvent id="e"><errorEventDefinition errorRef="gone"/></endEvent>',
        "e",
        "errorRef 'gone': the file has no such error",
    ),
    "an escalation that is not there": (
        '<endEvent id="e"><escalationEventDefinition escalationRef="gone"/></endEvent>',
        "e",
        "escalationRef 'gone'",
    ),
    "a signal that is a message": (
        '<endEvent id="e"><signalEventDefinition signalRef="M"/></endEvent>',
        "e",
        "is a message: expected a signal",
    ),
    "a timer without a time": ('<startEvent id="s"><timerEventDefinition/></startEvent>', "s", "the timer has no time"),
    "a conditional without a condition": (
        '<startEvent id="s"><conditionalEventDefinition/></startEvent>',
        "s",
        "has no condition",
    ),
    "a link without a name": (
        '<intermediateThrowEvent id="e"><linkEventDefinition/></intermediateThrowEvent>',
        "e",
        "the link has no name",
    ),
    "a data association to nothing": (
        '<task id="t"><dataOutputAssociation id="o"><targetRef>gone</targetRef></dataOutputAssociation></task>',
        "o",
        "'gone': the process has no such data object",
    ),
    "a truth that is none": ('<startEvent id="s" isInterrupting="maybe"/>', "s", "expected true or false"),
    "a multi-instance of nothing": (
        '<task id="t"><multiInstanceLoopCharacteristics/></task>',
        "t",
        "neither a collection nor a cardinality",
    ),
    "a loop of minus one": (
        '<task id="t"><standardLoopCharacteristics loopMaximum="-1"/></task>',
        "t",
        "expected a whole number, 1 or more",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_told_with_file_line_and_element(case: str) -> None:
    content, element, said = WRONG[case]
    error = refused(process(content, '<message id="M" name="m"/>' + SIGNAL))
    assert said in error.text
    assert error.element == element
    assert error.line >= 3
    assert str(error).startswith(f"bad.bpmn:{error.line}: {element}: ")


def test_a_pool_of_an_unknown_process_has_no_robot() -> None:
    definitions = read_text(
        document('<collaboration id="C"><participant id="p" processRef="gone"/></collaboration>'), file="bad.bpmn"
    )
    with pytest.raises(ModelError, match=r"bad\.bpmn:2: p: the pool's process is 'gone': the file has no such process"):
        pools_of(definitions)


def test_a_message_flow_to_nothing_is_a_warning() -> None:
    flow = '<messageFlow id="m" sourceRef="p" targetRef="gone"/>'
    definitions = read_text(document(f'<collaboration id="C"><participant id="p"/>{flow}</collaboration>'))
    (note,) = definitions.notes
    assert (note.level, note.element) == ("warning", "m")
    assert "goes to 'gone'" in note.text
    assert definitions.message_flows == ()


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({"instances": "-1"}, "instances='-1': expected a whole number, 1 or more"),
        ({"instances": "1_0"}, "instances='1_0': expected a whole number, 1 or more"),
        ({"instances": "many"}, "instances='many': expected a whole number, 1 or more"),
        ({"semantics": "loose"}, "semantics='loose': expected standard or original"),
        ({"topics": "names"}, "topics='names': expected signals or labels"),
    ],
)
def test_process_properties_with_bad_values_are_errors(said: dict[str, str], expected: str) -> None:
    error = refused(process(properties(**said)))
    assert error.text == expected
    assert error.element == "P"


def test_foreign_elements_in_a_process_are_noted_and_passed_over() -> None:
    definitions = read_text(process('<v:shape xmlns:v="http://vendor" id="v"/><task id="t"/>'))
    assert notes_of(definitions) == ["<{http://vendor}shape> is not a BPMN element and has no effect"]
    assert [node.id for node in definitions.processes[0].body.nodes] == ["t"]


def test_extensions_of_other_vendors_are_passed_over_in_silence() -> None:
    vendor = extensions('<v:meta xmlns:v="http://www.signavio.com" metaKey="bgcolor" metaValue="#ffffcc"/>')
    definitions = read_text(process(f'<task id="t">{vendor}</task>'))
    assert definitions.notes == ()
    assert dict(definitions.processes[0].body.nodes[0].properties) == {}


# ---- what leads nowhere ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["signal", "message"])
def test_a_reference_to_nothing_is_warned_of_where_the_label_stands_in(kind: str) -> None:
    content = f'<endEvent id="e" name="weed"><{kind}EventDefinition {kind}Ref="Gone"/></endEvent>'
    (note,) = [note for note in read_text(process(content)).notes if note.level == "warning"]
    assert (note.element, note.text) == ("e", f"the file has no {kind} 'Gone': the topic is the label 'weed'")


@pytest.mark.parametrize("kind", ["error", "escalation"])
def test_a_reference_to_another_kind_of_thing_is_refused(kind: str) -> None:
    content = f'<endEvent id="e"><{kind}EventDefinition {kind}Ref="S"/></endEvent>'
    error = refused(process(content, '<signal id="S" name="weed"/>'))
    assert f"{kind}Ref 'S' is a signal: expected an {kind}" in str(error)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("https://camunda.org/schema/1.0/bpmn", "http://camunda.org/schema/1.0/bpmn"),
        ("http://camunda.org/schema/1.0/bmpn", "http://camunda.org/schema/1.0/bpmn"),
        ("http://camunda.org/schema/zeebe/1.0/", "http://camunda.org/schema/zeebe/1.0"),
        ("http://www.flowable.org/bpmn", "http://flowable.org/bpmn"),
        ("https://ros", "http://ros"),
    ],
)
def test_a_namespace_with_a_slip_in_it_is_told_once(written: str, meant: str) -> None:
    tasks = "".join(
        f'<task id="t{n}"><extensionElements><x:properties xmlns:x="{written}"/></extensionElements></task>'
        for n in "12"
    )
    (note,) = [note for note in read_text(process(tasks)).notes if note.level == "warning"]
    assert note.text == f"elements of namespace {written} are not read; did you mean {meant}?"
    assert note.element == "t1"


@pytest.mark.parametrize(
    "uri",
    [
        "http://camunda.org/schema/modeler/1.0",
        "http://www.omg.org/spec/BPMN/non-normative/color/1.0",
        "http://bpmn.io/schema/bpmn/biocolor/1.0",
        "http://activiti.com/modeler",
    ],
)
def test_namespaces_of_others_are_passed_over(uri: str) -> None:
    task = f'<task id="t"><extensionElements><x:properties xmlns:x="{uri}"/></extensionElements></task>'
    assert not read_text(process(task)).notes


def test_extension_elements_of_other_engines_are_noted_once() -> None:
    rest = '<extensionElements><x:restrictions xmlns:x="https://bpmnos.telematique.eu"/></extensionElements>'
    (note,) = read_text(process(f'<task id="t1">{rest}</task><task id="t2">{rest}</task>')).notes
    assert (note.level, note.element) == ("note", "t1")
    assert note.text == "extension elements of https://bpmnos.telematique.eu are kept, but not executed"


def test_messages_name_elements_by_label_and_id() -> None:
    model = read_text(process('<startEvent id="s"/><task id="Activity_1" name="Go\n To"/>'))
    nodes = {node.id: node for node in model.processes[0].body.nodes}
    assert nodes["Activity_1"].display_name == model.display_name("Activity_1") == '"Go To" (Activity_1)'
    assert nodes["s"].display_name == model.display_name("s") == "s"
    assert model.display_name("not there") == "not there"
    error = ModelError("has no script", file="m.bpmn", line=3, element="Activity_1", name="Go To")
    assert str(error) == 'm.bpmn:3: "Go To" (Activity_1): has no script'
    assert error.element == "Activity_1"
    failure = MissionError("1 / 0", robot="REX", file="m.bpmn", line=3, element="Activity_1", name="Go To")
    assert str(failure) == 'REX: "Go To" (Activity_1, m.bpmn:3): 1 / 0'
    assert str(MissionError("1 / 0", element="Activity_1", name="Go To")) == '"Go To" (Activity_1): 1 / 0'


def test_the_reader_names_a_wrong_element_by_label_and_id() -> None:
    twice = refused(process('<task id="a" name="Go"/><task id="a" name="Stop"/>'))
    assert '"Stop" (a): two elements have this id' in str(twice)
    faults = read_text(process('<task id="a" name="Go" default="x"/>')).processes[0].faults
    assert [fault.display_name for fault in faults] == ['"Go" (a)']
