"""The pages on semantics are true: rules have tests that exist, tables say what the engine executes and refuses.

After a change of the engine, change the pages: a test that fails here names the row or the message.
"""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import fame
from fame.bpmn import read_text
from fame.check import check
from fame.errors import ModelError

ROOT = Path(__file__).parent.parent
RULES, ACTIVITY_RULES, SIGNAL_RULES, EVENT_RULES, TABLES, TESTS = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in (
        "semantics",
        "semantics_activities",
        "signals",
        "semantics_events",
        "semantics_tables",
        "semantics_tests",
    )
)
CONFORMANCE = sorted((ROOT / "tests" / "conformance").glob("test_*.py"))
LINKS = re.findall(r"\]\(\.\./(tests/[^)#]+)#(\w+)\)", TESTS + TABLES)

# ---- links -----------------------------------------------------------------------------------------------------------


def names_in(path: Path) -> list[str]:
    return re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)


def test_every_test_that_it_links_exists() -> None:
    assert len(LINKS) > 200
    files = {ROOT / path for path, _ in LINKS}
    known = {(str(path.relative_to(ROOT)), test) for path in files if path.exists() for test in names_in(path)}
    assert [link for link in LINKS if link not in known] == []


def test_every_conformance_test_is_linked() -> None:
    linked = {Path(path).name for path, _ in LINKS}
    assert [path.name for path in CONFORMANCE if path.name not in linked] == []
    tests = {test for _, test in LINKS}
    assert [test for path in CONFORMANCE for test in names_in(path) if test not in tests] == []


def test_every_rule_is_linked() -> None:
    """A rule is an item of a list with a bold name; docs/semantics_tests.md lists its tests under the same name."""
    rules = [
        re.findall(r"^- \*\*(.+?)\.\*\*", page, re.MULTILINE)
        for page in (RULES, ACTIVITY_RULES, SIGNAL_RULES, EVENT_RULES)
    ]
    assert sum(map(len, rules)) > 110
    for section, named in zip(TESTS.split("\n## ")[1:], rules, strict=True):
        tests = re.findall(r"^- ([^*:]+): (.*)", section, re.MULTILINE)
        assert [name for name, _ in tests] == named
        assert [name for name, links in tests if "](../tests/" not in links and name != "Stimulus"] == []


# ---- models ----------------------------------------------------------------------------------------------------------

NEVER = "\N{EN DASH}"
"""What the tables say where the standard allows nothing."""
HEAD = (
    '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="http://fame"'
    ' xmlns:camunda="http://camunda.org/schema/1.0/bpmn">'
)
ROOTS = (
    '<signal id="S" name="found"/><message id="M" name="order"/><error id="E" errorCode="lost"/>'
    '<escalation id="X" escalationCode="late"/>'
)
START, TASK = '<startEvent id="s"/>', '<task id="t"/>'
DEFINITIONS = {
    "none": "",
    "message": '<messageEventDefinition messageRef="M"/>',
    "signal": '<signalEventDefinition signalRef="S"/>',
    "timer": "<timerEventDefinition><timeDuration>PT1S</timeDuration></timerEventDefinition>",
    "conditional": "<conditionalEventDefinition><condition>False</condition></conditionalEventDefinition>",
    "error": '<errorEventDefinition errorRef="E"/>',
    "escalation": '<escalationEventDefinition escalationRef="X"/>',
    "compensation": "<compensateEventDefinition/>",
    "cancel": "<cancelEventDefinition/>",
    "link": '<linkEventDefinition name="l"/>',
    "terminate": "<terminateEventDefinition/>",
    "multiple": '<messageEventDefinition messageRef="M"/><signalEventDefinition signalRef="S"/>',
}
DEFINITIONS["parallel multiple"] = DEFINITIONS["multiple"]
HANDLED = '<task id="undo" isForCompensation="true"/><association id="as" sourceRef="x" targetRef="undo"/>'


def flow(*ids: str) -> str:
    return "".join(f'<sequenceFlow id="{a}-{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


def event(trigger: str, place: str) -> str:
    """A process with one event ``x`` at that place."""
    inside, tag = DEFINITIONS[trigger], place.partition(",")[0]
    said = f' isInterrupting="{str("not" not in place).lower()}"' if "event sub" in place else ""
    said += ' parallelMultiple="true"' if trigger.startswith("parallel") else ""
    if tag == "process start":
        return f'<startEvent id="x"{said}>{inside}</startEvent>{TASK}{flow("x", "t")}'
    if tag == "event sub-process":
        handler = f'<startEvent id="x"{said}>{inside}</startEvent><task id="h"/>{flow("x", "h")}'
        return f'{START}{TASK}{flow("s", "t")}<subProcess id="p" triggeredByEvent="true">{handler}</subProcess>'
    if tag == "boundary":
        cancels = str("not" not in place).lower()
        attached = f'<boundaryEvent id="x" attachedToRef="p" cancelActivity="{cancels}"{said}>{inside}</boundaryEvent>'
        after = HANDLED if trigger == "compensation" else TASK + flow("x", "t")
        return f'{START}<transaction id="p"><userTask id="u"/></transaction>{attached}{flow("s", "p")}{after}'
    tag = {"catch": "intermediateCatchEvent", "throw": "intermediateThrowEvent", "end": "endEvent"}[tag]
    other = (
        f'<intermediateCatchEvent id="l">{DEFINITIONS["link"]}</intermediateCatchEvent>' if trigger == "link" else ""
    )
    written = f'{START}<{tag} id="x"{said}>{inside}</{tag}>{flow("s", "x")}{other if place == "throw" else ""}'
    return f'<transaction id="p">{written}</transaction>' if trigger == "cancel" else written


ACTIVITIES = {
    "task": "task",
    "user task": "userTask",
    "manual task": "manualTask",
    "script task": "scriptTask",
    "service task": 'serviceTask implementation="wave"',
    "send task": 'sendTask messageRef="M"',
    "receive task": 'receiveTask messageRef="M"',
    "business rule task": "businessRuleTask",
    "call activity": 'callActivity calledElement="Q"',
    "sub-process": "subProcess",
    "transaction": "transaction",
    "ad-hoc sub-process": "adHocSubProcess",
}
LOOPS = {
    "loop": '<standardLoopCharacteristics loopMaximum="2"/>',
    "multi-instance": "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality>"
    "</multiInstanceLoopCharacteristics>",
}


def activity(kind: str, how: str) -> str:
    """A process with one activity ``x`` of that kind."""
    tag, inside = ACTIVITIES[kind], LOOPS.get(how, "")
    inside += {"scriptTask": "<script>pass</script>"}.get(tag, '<task id="i"/>' if "ransaction" in tag else "")
    inside += '<task id="i"/>' if tag.lower().endswith("subprocess") else ""
    said = ' isForCompensation="true"' if how == "as a compensation handler" else ""
    written = f'<{tag} id="x"{said}>{inside}</{tag.partition(" ")[0]}>'
    if not said:
        return f"{START}{written}{flow('s', 'x')}"
    on = f'<boundaryEvent id="b" attachedToRef="t">{DEFINITIONS["compensation"]}</boundaryEvent>'
    return f'{START}{TASK}{on}{written}{flow("s", "t")}<association id="as" sourceRef="b" targetRef="x"/>'


def gateway(kind: str, how: str) -> str:
    """A process with one gateway ``x`` of that kind."""
    tag, both = {"event-based": "eventBasedGateway"}.get(kind, f"{kind}Gateway"), "ab"
    written = f'<{tag} id="x"/>'
    if how == "joins":
        ways = "".join(f'<task id="{id}"/>{flow("s", id, "x")}' for id in both)
        condition = "<activationCondition>activationCount == 1</activationCondition>" if kind == "complex" else ""
        return f'{START}{ways}<{tag} id="x">{condition}</{tag}>'
    tags = dict.fromkeys(both, "intermediateCatchEvent" if kind == "event-based" else "task")
    signal = DEFINITIONS["signal"] if kind == "event-based" else ""
    ways = "".join(f'<{tags[id]} id="{id}">{signal}</{tags[id]}>{flow("x", id)}' for id in both)
    if how == "starts a process":
        return f'<{tag} id="x" instantiate="true"/>{ways}'
    return f"{START}{written}{ways}{flow('s', 'x')}"


# ---- tables ----------------------------------------------------------------------------------------------------------


def table(corner: str) -> Iterator[tuple[str, str, str]]:
    """(row, column, what the cell says) of the table whose first column has that title."""
    lines = iter(TABLES.partition(f"\n| {corner} |")[2].splitlines())
    columns = [cell.strip() for cell in next(lines, "").strip(" |").split("|")]
    next(lines, "")
    for line in lines:
        if not line.startswith("|"):
            return
        row, *cells = (cell.strip() for cell in line.strip(" |").split("|"))
        for column, cell in zip(columns, cells, strict=True):
            yield row, column, cell.partition(" ")[0]


def document(content: str) -> str:
    return f'{HEAD}<process id="P">\n{content}</process><process id="Q"><task id="q"/></process>{ROOTS}</definitions>'


def refusal(content: str) -> str:
    """Why a process is not executed; empty if it is."""
    try:
        definitions = read_text(document(content), file="m.bpmn")
        fame.Simulation(definitions, "P", services={"wave": lambda variables: None})
    except ModelError as error:
        return error.text
    return ""


MESSAGES = dict(re.findall(r"^\| ([a-z]) \| [^|]+ \| (.+) \|$", TABLES, re.MULTILINE))
"""What is said of the cells with a letter."""


@pytest.mark.parametrize(("row", "column", "said"), list(table("trigger or result")))
def test_the_table_of_events_is_that_of_the_engine(row: str, column: str, said: str) -> None:
    found = refusal(event(row, column))
    if said == NEVER:
        name = {"compensation": "compensate"}.get(row, row)
        assert found.startswith(f"{name} events cannot be ")
    else:
        expected = MESSAGES.get(said, "").replace("error", {"compensation": "compensate"}.get(row, row), said == "c")
        assert found == expected


@pytest.mark.parametrize(("row", "column", "said"), list(table("activity")))
def test_the_table_of_activities_is_that_of_the_engine(row: str, column: str, said: str) -> None:
    assert refusal(activity(row, column)) == MESSAGES.get(said, "")


@pytest.mark.parametrize(("row", "column", "said"), list(table("gateway")))
def test_the_table_of_gateways_is_that_of_the_engine(row: str, column: str, said: str) -> None:
    if said == "yes":
        assert refusal(gateway(row, column)) == ""


def test_the_tables_have_every_element() -> None:
    assert {row for row, _, _ in table("trigger or result")} == set(DEFINITIONS)
    assert {row for row, _, _ in table("activity")} == set(ACTIVITIES)
    assert {row for row, _, _ in table("gateway")} == {"exclusive", "inclusive", "parallel", "complex", "event-based"}


RESOURCE = "conditionExpression camunda:resource='c.groovy'"
COMPENSATING = (
    '<subProcess id="h{0}" triggeredByEvent="true"><startEvent id="t{0}"><compensateEventDefinition/></startEvent>'
    "</subProcess>"
)
REFUSED = {
    "an event sub-process needs a start event with a trigger": event("none", "event sub-process, interrupting"),
    "a boundary event needs a trigger": event("none", "boundary, interrupting"),
    "error events cannot start a process": event("error", "process start"),
    "business rules are not executed: decide with a gateway or a script task": activity("business rule task", "once"),
    "conditional events cannot start a process: it has no variables before it starts":
        event("conditional", "process start"),
    "a receive task that starts a process must not repeat or have variables of its own":
        f"<receiveTask id='x' messageRef='M' instantiate='true'>{LOOPS['loop']}</receiveTask>",
    "timer events cannot be end events: they can be start, catch, boundary": event("timer", "end"),
    "a parallel multiple event cannot wait for an error":
        event("parallel multiple", "boundary").replace(DEFINITIONS["signal"], DEFINITIONS["error"]),
    "nothing can be thrown after what ends or moves the token: put it last":
        event("multiple", "end").replace(DEFINITIONS["message"], DEFINITIONS["error"]),
    "a compensation event needs one handler; it has 0":
        event("compensation", "boundary").replace("<association", "<association associationDirection='None'")
        .replace('sourceRef="x"', 'sourceRef="s"'),
    "its activity has another compensation handler: expected one, which may be a sub-process":
        event("compensation", "boundary") + f'<boundaryEvent id="y" attachedToRef="p">{DEFINITIONS["compensation"]}'
        "</boundaryEvent>",
    "its scope has another event sub-process for compensation: expected one": START
        + f'<subProcess id="w">{"".join(map(COMPENSATING.format, "ab"))}</subProcess>' + flow("s", "w"),
    "its activityRef is 'A': expected an activity of its scope; did you mean 'a'?":
        START + '<task id="a"/><endEvent id="x"><compensateEventDefinition activityRef="A"/></endEvent>'
        + flow("s", "a", "x"),
    "link 'l' has 0 catching events in this scope; it needs one":
        START + f'<intermediateThrowEvent id="x">{DEFINITIONS["link"]}</intermediateThrowEvent>' + flow("s", "x"),
    "leads to t: expected a catching event or a receive task": f'{START}<eventBasedGateway id="x"/>{TASK}'
        + flow("s", "x", "t"),
    "a receive task after an event-based gateway must not repeat": f'{START}<eventBasedGateway id="x"/>'
        f'<receiveTask id="t" messageRef="M"><standardLoopCharacteristics loopMaximum="2"/></receiveTask>'
        + flow("s", "x", "t"),
    "has no event to wait for": f'{START}<eventBasedGateway id="x"/>{flow("s", "x")}',
    "a complex gateway that joins needs an activation condition":
        gateway("complex", "joins").replace("activationCondition>activationCount == 1<", "documentation>a<")
        .replace("</activationCondition", "</documentation"),
    "a loop needs a condition or a maximum": START + "<task id='x'><standardLoopCharacteristics/></task>"
        + flow("s", "x"),
    "the multi-instance activity has neither a collection nor a cardinality":
        START + "<task id='x'><multiInstanceLoopCharacteristics/></task>" + flow("s", "x"),
    "a send task needs a message": START + "<sendTask id='x'/>" + flow("s", "x"),
    "a receive task needs a message": START + "<receiveTask id='x'/>" + flow("s", "x"),
    "a service task needs the name of a service": START + "<serviceTask id='x'/>" + flow("s", "x"),
    "unknown service 'grip'; known are: wave": START + "<serviceTask id='x' implementation='grip'/>"
        + flow("s", "x"),
    "it runs the Java class org.example.Grip; FAME does not run Java: use a script task, or name a registered "
    "operation": START + "<serviceTask id='x' camunda:class='org.example.Grip'/>" + flow("s", "x"),
    "language 'groovy': expected python (the default), javascript, ${...} or =...":
        START + "<scriptTask id='x' scriptFormat='groovy'><script>1</script></scriptTask>" + flow("s", "x"),
    "has no called element: give it the id of a process or the name of a library file": START + "<callActivity id='x'/>"
        + flow("s", "x"),
    "the called element is computed at run time; give the id of a process":
        START + "<callActivity id='x' calledElement='${q}'/>" + flow("s", "x"),
    "the name '=topic' is computed: give a fixed name, since topics are created before the process runs":
        START + "<endEvent id='x' name='=topic'><signalEventDefinition/></endEvent>" + flow("s", "x"),
    "its condition is the resource c.groovy; put its text into the condition":
        START + TASK + flow("s", "t").replace("/>", f"><{RESOURCE}/></sequenceFlow>"),
    "P has 2 none start events; expected at most one": START + "<startEvent id='x'/>",
    "has no none start event, so it cannot be called or entered":
        START + f"<subProcess id='x'><startEvent id='i'>{DEFINITIONS['signal']}</startEvent></subProcess>"
        + flow("s", "x"),
    "an ad-hoc sub-process has no start event: elements without incoming flow start":
        activity("ad-hoc sub-process", "once").replace('<task id="i"/>', '<startEvent id="i"/>'),
    "has no element to start with: add a start event":
        START + f"<subProcess id='x'><task id='a'/><task id='b'/>{flow('a', 'b')}{flow('b', 'a')}</subProcess>"
        + flow("s", "x"),
    "a cancel end event is allowed in a transaction only":
        START + f"<endEvent id='x'>{DEFINITIONS['cancel']}</endEvent>" + flow("s", "x"),
    "expected a transaction for the cancel event, got t":
        START + TASK + f"<boundaryEvent id='x' attachedToRef='t'>{DEFINITIONS['cancel']}</boundaryEvent>"
        + flow("s", "t"),
}  # fmt: skip
"""A process that is refused so."""


@pytest.mark.parametrize(("message", "content"), REFUSED.items(), ids=REFUSED.keys())
def test_what_it_says_is_refused_is_refused(message: str, content: str) -> None:
    assert refusal(content) == message


def test_it_tells_every_refusal() -> None:
    assert set(MESSAGES.values()) < set(REFUSED)  # docs/reference.py writes the others


@pytest.mark.parametrize(("message", "content"), REFUSED.items(), ids=REFUSED.keys())
def test_fame_check_knows_it(message: str, content: str) -> None:
    if message.startswith("unknown service"):  # known where it runs
        assert "needs the service 'grip' where it runs: Simulation(services=...)" in findings(content, "note")
    else:
        assert message in findings(content, "error")


def findings(content: str, level: str) -> list[str]:
    """What the check says of a process; that it cannot be read is a finding too."""
    try:
        return [one.text for one in check(read_text(document(content), file="m.bpmn")) if one.level == level]
    except ModelError as error:
        return [error.text]
