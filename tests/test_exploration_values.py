"""What an exploration makes of values that are unknown: whatever is asked of them may have each answer."""

from html import escape
from itertools import pairwise

import pytest
from bpmn_text import extensions, process
from collaborations import Steps, team, text_of

import fame
from fame.bpmn.model import Definitions, Expression
from fame.check.explore.aliases import Aliases
from fame.check.explore.asking import asking
from fame.check.explore.values import Unknown, Values
from fame.errors import MessageError
from fame.scenario.explore.exploration import explore
from fame.scripting import effects_of
from fame.testing import MissionLoader

UNKNOWN = "run x = robot.now"
TEXT, NUMBERS = "std_msgs/msg/String", "std_msgs/msg/Float64MultiArray"


def outcomes(condition: str, *before: str) -> tuple[bool, bool]:
    """Whether a condition may be true, and whether it may be false, after some steps."""

    def deadlocks(first: Steps, second: Steps) -> bool:
        return _deadlocks(team({"A": [*before, ("if", condition, first, second)], "B": ["catch go"]}))

    return deadlocks(["work"], ["throw go"]), deadlocks(["throw go"], ["work"])


def _deadlocks(definitions: Definitions) -> bool:
    found = explore(definitions, delivery="run")
    assert found.exhaustive
    return any(one.kind in ("deadlock", "lost") for one in found.findings)


BOTH = (True, True)
ASKED = [
    "x is None",
    "x is not None",
    "x is True",
    "x is y",
    "x == None",
    "x == x",
    "not x",
    "(x or 3) == 3",
    "x if x else 4",
    "x in [3]",
    "3 in [x]",
    "[x] == [3]",
    "(x, 1) &lt; (3, 2)",
    "max(x, 3) == 3",
    "sum([x, 1]) == 3",
    "str(x) == '3'",
    "f'{x}' == '3'",
    "f'{x:>3}' == '  3'",
    "'%s' % x == '3'",
    "'{}'.format(x) == '3'",
    "repr(x) == '3'",
    "x.y is None",
    "{'a': x}['a'] is None",
    "any([x, False])",
    "round(x) == 3",
    "len(x) == 1",
    "x[0] is not None",
    "'a' in x",
]


@pytest.mark.parametrize("condition", ASKED)
def test_what_is_asked_of_an_unknown_value_has_both_answers(condition: str) -> None:
    assert outcomes(condition, UNKNOWN, "run y = robot.now") == BOTH


@pytest.mark.parametrize(
    ("condition", "known"),
    [
        ("${m.get('k') == 3}", False),
        ("${m.q.contains(3)}", False),
        ("= m.list.k[1] = 3", False),
        ("= some v in m.list.k satisfies v = 3", False),
        ("= m.n.n = 3", True),
        ("${m.n.n == 3}", True),
    ],
)
def test_an_expression_asks_for_what_its_methods_and_lists_hold(condition: str, known: bool) -> None:
    held = "run m = {'k': x, 'q': [x], 'list': [{'k': x}], 'n': {'n': 3}}"
    assert outcomes(condition, UNKNOWN, held) == ((True, False) if known else BOTH)


KEPT = [
    ("x in v", "v = [x]"),
    ("x in v", "v = {x}"),
    ("x in v", "v = set(); v.add(x)"),
    ("x in v", "v = {}; v[x] = 1"),
    ("v == [x]", "v = [x]"),
    ("(x,) == v", "v = (x,)"),
    ("v.count(x) > 0", "v = [x]"),
    ("v.get(x, 0) == 1", "v = {x: 1}"),
    ("len({x, v}) == 1", "v = x"),
    ("=list contains(v, 3)", "v = [x]"),
    ("=v[1] = 3", "v = [x]"),
    ("${v[0] == 3}", "v = [x]"),
    ("=v.a = 3", "v = {'a': x}"),
    ("=v = [3]", "v = [x]"),
]


@pytest.mark.parametrize(("condition", "kept"), KEPT)
def test_two_unknown_values_may_be_equal_or_not(condition: str, kept: str) -> None:
    assert outcomes(condition, UNKNOWN, f"run {kept}", UNKNOWN) == BOTH


@pytest.mark.parametrize(
    "script",
    [
        "w = x is None",
        "w = 1 if x is None else 0",
        "match x:\n  case None: w = 1",
        "match x:\n  case [a]: w = 1",
        "try:\n  w = len(x)\nexcept TypeError: w = 1",
        "try:\n  w = len(x)\nexcept: w = 1",
        "if f'{x}' == 'a': w = 1",
    ],
)
def test_a_script_that_asks_an_unknown_value_goes_both_ways(script: str) -> None:
    assert outcomes("w == 1", UNKNOWN, f"run w = 0\n{script}") == BOTH


@pytest.mark.parametrize(
    ("condition", "type"),
    [
        ("x.data", TEXT),
        ('=x.data = "a"', TEXT),
        ('=contains(x.data, "a")', TEXT),
        ("=x.data = null", TEXT),
        ("=x = null", TEXT),
        ('${x.data == "a"}', TEXT),
        ("${empty x.data}", TEXT),
        ("=list contains(x.data, 3)", NUMBERS),
        ("=count(x.data) > 2", NUMBERS),
        ("=some y in x.data satisfies y > 3", NUMBERS),
    ],
)
def test_a_condition_on_a_message_of_which_nothing_is_known_has_both_answers(condition: str, type: str) -> None:
    def deadlocks(first: Steps, second: Steps) -> bool:
        text = text_of({"A": ["catch x", ("if", condition, first, second)], "B": ["catch go"]})
        typed = f"<camunda:properties><camunda:property name='type' value='{type}'/></camunda:properties>"
        text = text.replace('name="x">', f'name="x"><extensionElements>{typed}</extensionElements>', 1)
        return _deadlocks(fame.read(text.encode()))

    assert (deadlocks(["work"], ["throw go"]), deadlocks(["throw go"], ["work"])) == BOTH


def test_a_value_that_is_nested_too_deep_is_known_as_far_as_possible() -> None:
    deep = "run m = [1]\nfor i in range(3000): m = [m]\nn = len(m)"
    assert outcomes("n == 1", deep) == (True, False)
    assert outcomes("m[0] == [1]", deep) == (False, True)


def test_a_message_from_outside_that_is_sent_on_is_as_unknown() -> None:
    typed = "<extensionElements><camunda:properties><camunda:property name='type' value='geometry_msgs/msg/Point'/>{}"
    sends = "<camunda:property name='payload' value='${x}'/>"

    def deadlocks(first: Steps, second: Steps) -> bool:
        text = text_of(
            {"A": ["catch x", "throw y"], "B": ["catch y", ("if", "y.x > 1", first, second)], "C": ["catch go"]}
        )
        for name, more in (("x", ""), ("y", sends)):
            content = f"{typed.format(more)}</camunda:properties></extensionElements>"
            text = text.replace(f'name="{name}">', f'name="{name}">{content}')
        return _deadlocks(fame.read(text.encode()))

    assert (deadlocks(["work"], ["throw go"]), deadlocks(["throw go"], ["work"])) == BOTH


@pytest.mark.parametrize(
    "payload", [{"z_": Unknown}, {"position": {"w": Unknown}}, {"position": {"x": 1}, "z_": Unknown}]
)
def test_an_unknown_value_of_a_field_that_is_not_there_is_an_error(payload: dict[str, object]) -> None:
    def filled(item: object) -> object:
        return {name: filled(inner) for name, inner in item.items()} if isinstance(item, dict) else Values().unknown

    with pytest.raises(MessageError, match="there is no such field"):
        Values().message("geometry_msgs/msg/Pose", filled(payload))


@pytest.mark.parametrize(
    ("condition", "answer"),
    [
        ("v is None", True),
        ("v is not None", False),
        ("n is True", False),
        ("n == True", True),
        ("t is t", True),
        ("f'{n}' == '1'", True),
        ("f'{n:>3}' == '  1'", True),
        ("'%s' % n == '1'", True),
        ("str(n) == '1'", True),
        ("n in w", True),
        ("w == [1]", True),
        ("=list contains(w, 1)", True),
        ("${w[0] == 1}", True),
    ],
)
def test_what_is_asked_of_a_known_value_has_its_answer(condition: str, answer: bool) -> None:
    assert outcomes(condition, "run v, n, t, w = None, 1, 'a', [1]") == (answer, not answer)


@pytest.mark.parametrize(
    ("text", "calls"),
    [
        ("x is None", "(__same__(x, None))"),
        (
            "y = a.b is not None and f'{x!r:>{w}}' or z",
            "y = (__same__(__same__(a.b, None), False)) and (__text__(f'{x!r:>{w}}')) or z",
        ),
        ("é = 'é' if x is None else 3", "é = 'é' if (__same__(x, None)) else 3"),
        ("y = (x is\n  None)\nz = 1 / 0", "y = ((__same__(x, None)\n))\nz = 1 / 0"),
        ("x == 3", "x == 3"),
        ("x is", "x is"),
    ],
)
def test_the_calls_that_ask_leave_each_line_where_it_is(text: str, calls: str) -> None:
    assert asking(Expression(text, "python", 7)) == Expression(calls, "python", 7)


@pytest.mark.parametrize(
    ("condition", "scripts"),
    [
        ("len(x) == 2", ["x = [1]", "z = x", "z.append(3)"]),
        ("len(x) == 2", ["x = [1]", "z = x", "z += [3]"]),
        ("len(x) == 2", ["x = [1]", "z = {'a': x}", "z['a'].append(3)"]),
        ("len(x) == 2", ["x, y = [1], []", "y.append(x)", "z = y[0]", "z.append(3)"]),
        ("len(x) == 2", ["x = [1]", "z = w = x", "for each in [z]: each.append(3)"]),
        ("x[0][0] == 3", ["x = [[1]]", "z = list(x)", "z[0][0] = 3"]),
        ("len(x) == 2", ["x = [1]\nz = x\nz.append(3)", "y = len(x)"]),
        ("z == [1]", ["x = z = []", "x += [1]"]),
        ("len(x) == 2", ["x = [1]\nt = [x]", "t[0] += [2]"]),
        ("len(x) == 2", ["x = [1]\nt = [x]", "t[0] *= 2"]),
        ("len(x) == 2", ["x = [1]\nt = dict(k=x)", "t['k'] += [2]"]),
        ("len(x) == 2", ["x = [1]\ny = {'k': x}", "match y:\n  case {'k': z}: z += [2]"]),
        ("len(x) == 2", ["x = [1]", "z = map(x.append, [1])", "list(z)"]),
        ("len(x) == 2", ["x = [1]", "z = (each.append(3) for each in [x])", "y, = z"]),
        ("len(x) == 2", ["x = [1]\ny = [x]", "[each.append(3) for each in y]"]),
        ("len(x) == 2", ["x = [1]\ny = []\nz = [y]", "z[0].append(x)", "y[0].append(3)"]),
        ("len(x) == 2", ["x = [1]", "z = sum([], x)", "z.append(3)"]),
    ],
)
def test_what_a_script_changes_in_one_variable_may_have_changed_in_another(condition: str, scripts: list[str]) -> None:
    assert outcomes(condition, *(f"run {script}" for script in scripts))[0]


@pytest.mark.parametrize(
    ("condition", "scripts"),
    [
        ("len(x) == 1", ["x = [1]", "z = list(x)", "z.append(3)"]),
        ("len(x) == 1", ["x, z = [1], [2]", "y = x if z else z", "z.append(3)"]),
        ("x == [1]", ["x = [1]", "n = x[0]", "n += 3"]),
        ("best == 'b'", ["bids = {}", "best = min(sorted(bids), default='b')", "bids['a'] = 3"]),
    ],
)
def test_what_no_variable_shares_stays_known(condition: str, scripts: list[str]) -> None:
    assert outcomes(condition, *(f"run {script}" for script in scripts)) == (True, False)


@pytest.mark.parametrize("filled", [False, True])
def test_what_iterates_over_a_mapping_has_keys_unless_a_task_may_fill_it_with_something_else(filled: bool) -> None:
    data = '<extensionElements><camunda:properties><camunda:property name="bids"/></camunda:properties>'
    output = "<dataOutputAssociation><targetRef>D</targetRef></dataOutputAssociation>" if filled else ""
    text = process(
        '<scriptTask id="T"><script>bids = {}</script></scriptTask>'
        f'<task id="U">{output}</task><dataObject id="O"/>'
        f'<dataObjectReference id="D" dataObjectRef="O">{data}</extensionElements></dataObjectReference>'
        '<scriptTask id="S"><script>for bid in bids: best = bid</script></scriptTask>'
    )
    bodies = [body for one in fame.read(text.encode()).processes for body in one.body.bodies()]
    assert Aliases(bodies).of(("best", False)) == ({"bid", "bids"} if filled else {"bid"})


ASKED_FOR = {
    "its form": '<extensionElements><camunda:formData><camunda:formField id="approved" type="boolean"/>'
    "</camunda:formData></extensionElements>",
    "the data that it writes": "<dataOutputAssociation><targetRef>D</targetRef></dataOutputAssociation>",
}


@pytest.mark.parametrize("asked", ASKED_FOR)
def test_what_a_person_is_asked_for_is_unknown_when_the_task_is_done(
    asked: str, mission: MissionLoader, tmp_path
) -> None:
    data = '<camunda:properties><camunda:property name="approved"/></camunda:properties>'
    text = process(
        '<scriptTask id="T"><script>approved = False</script></scriptTask>'
        f'<userTask id="U">{ASKED_FOR[asked]}</userTask><exclusiveGateway id="G" default="N"/>'
        '<task id="Y"/><task id="Z"/><dataObject id="O"/><dataObjectReference id="D" dataObjectRef="O">'
        f"<extensionElements>{data}</extensionElements></dataObjectReference>"
        '<sequenceFlow id="A" sourceRef="T" targetRef="U"/><sequenceFlow id="B" sourceRef="U" targetRef="G"/>'
        '<sequenceFlow id="C" sourceRef="G" targetRef="Y"><conditionExpression>approved</conditionExpression>'
        '</sequenceFlow><sequenceFlow id="N" sourceRef="G" targetRef="Z"/>'
    )
    assert [one.text for one in explore(fame.read(text.encode())).findings] == []
    (tmp_path / "model.bpmn").write_text(text)
    m = mission.by_hand(tmp_path / "model.bpmn")
    m.decide("P", "G", True).complete("U").expect("P").passed("Y").never_entered("Z")


def test_expressions_and_payloads_know_the_name_of_their_robot() -> None:
    steps: dict[str, Steps] = {"A": [("if", '=robot.name = "A"', ["throw go"], ["work"])], "B": ["catch go"]}
    found = explore(team(steps), delivery="run")
    assert [one.kind for one in found.findings if one.kind in ("deadlock", "lost", "error")] == []


@pytest.mark.parametrize(
    ("mapping", "condition"),
    [('<camunda:out source="r" target="w"/>', "w == 6"), ('<camunda:out variables="all"/>', "r == 6"),
     ('<zeebe:ioMapping><zeebe:output source="=r" target="w"/></zeebe:ioMapping>', "w == 6"),
     ('<camunda:out source="r" target="w"/>', "w == [5]")],
)  # fmt: skip
def test_what_a_call_maps_out_is_what_the_called_process_has_set(mapping: str, condition: str) -> None:
    """Nothing else reads it: it was dropped, and the end behind it called unreachable."""
    value = "[]; r.append(5); n = len(r)" if "[" in condition else "6"
    called = (
        '<process id="Q" isExecutable="true"><startEvent id="S"/><sequenceFlow id="F" sourceRef="S" targetRef="T"/>'
    )
    text = process(
        f'<callActivity id="C" calledElement="Q">{extensions(mapping)}</callActivity>'
        '<exclusiveGateway id="G" default="N"/><task id="Y"/><task id="Z"/>'
        '<sequenceFlow id="A" sourceRef="C" targetRef="G"/><sequenceFlow id="N" sourceRef="G" targetRef="Z"/>'
        f'<sequenceFlow id="B" sourceRef="G" targetRef="Y"><conditionExpression>{condition}</conditionExpression>'
        "</sequenceFlow>",
        f'{called}<scriptTask id="T"><script>r = {value}</script></scriptTask></process>',
    )
    (finding,) = explore(fame.read(text.encode())).findings
    assert (finding.kind, finding.text) == ("unreachable", "P: Z can never be entered")


@pytest.mark.parametrize("task", ["userTask", "manualTask"])
def test_who_completes_a_task_without_a_form_may_set_what_nothing_has_set(task: str) -> None:
    """Or may not: then the condition fails, which no run has to come to."""
    text = process(
        f'<{task} id="U"/><exclusiveGateway id="G" default="N"/><task id="Y"/><task id="Z"/>'
        '<sequenceFlow id="B" sourceRef="U" targetRef="G"/><sequenceFlow id="N" sourceRef="G" targetRef="Z"/>'
        '<sequenceFlow id="C" sourceRef="G" targetRef="Y"><conditionExpression>n == 1</conditionExpression>'
        "</sequenceFlow>"
    )
    (finding,) = explore(fame.read(text.encode())).findings
    assert (finding.level, finding.text) == ("warning", "P: G fails: NameError: name 'n' is not defined")


def _may_be(condition: str, task: str, called: str = "", root: str = "", first: str = "T") -> set[str]:
    """Where a gateway with a condition may lead after some values and a task: to Y if it is true, else to Z."""
    ways = (("S", "I"), ("I", first), ("T", "G"))
    text = process(
        '<startEvent id="S"/><scriptTask id="I"><script>n = 0; text = ""; xs = [1]; d = {}</script></scriptTask>'
        + task
        + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ways)
        + '<exclusiveGateway id="G" default="N"/><task id="Y"/><task id="Z"/>'
        '<sequenceFlow id="N" sourceRef="G" targetRef="Z"/>'
        f'<sequenceFlow id="M" sourceRef="G" targetRef="Y"><conditionExpression>{condition}</conditionExpression>'
        "</sequenceFlow>",
        f'{root}<message id="R" name="~/r"/>' + (f'<process id="Q">{called}</process>' if called else ""),
    )
    found = explore(fame.read(text.encode()), delivery="run").findings
    assert {one.kind for one in found} <= {"unreachable"}
    return {"Y", "Z"}.difference(place.element for one in found for place in one.places)


IN_JAVASCRIPT = [
    'let v = this.environment.variables; v["n"] = 3',
    "const {variables} = this.environment; variables.n = 3",
    "const me = this; me.environment.variables.n = 3",
    'const e = this["environment"]; e["variables"]["n"] = 3',
    "(function(o) { o.n = 3 }).call(null, this.environment.variables)",
    "let {environment: {variables: w}} = this; w.n = 3",
    "Reflect.set(environment.variables, 'n', 3)",
    'globalThis["environment"].variables.n = 3',
    "this.env\\u0069ronment.variables.n = 3",
]


@pytest.mark.parametrize("text", IN_JAVASCRIPT)
def test_javascript_that_is_not_understood_may_set_every_variable(text: str) -> None:
    script = f'scriptFormat="javascript"><script>{text.replace("<", "&lt;")}; next()</script></scriptTask>'
    assert _may_be("n == 3", f'<scriptTask id="T" {script}') == {"Y", "Z"}
    waits = '<sequenceFlow id="UJ" sourceRef="U" targetRef="J"/><receiveTask id="U" messageRef="R"/>'
    called = f'{waits}<scriptTask id="J" {script}'
    assert _may_be("n == 3", '<callActivity id="T" calledElement="Q"/>', called) == {"Y", "Z"}


def test_javascript_that_is_understood_sets_what_it_names() -> None:
    text = "const env = this.environment.variables; env.k = this.content.id; console.log(env.n); next()"
    script = f'<scriptTask id="T" scriptFormat="javascript"><script>{text}</script></scriptTask>'
    assert _may_be("n == 3", script) == {"Z"}


@pytest.mark.parametrize(
    "sets",
    [
        "++(env.n)",
        "((env.n))--",
        "for ((env.n) of [3]) ;",
        "if (env.d) [env.n] = [3]",
        "[3].forEach(v => [env.n] = [v])",
    ],
)
def test_javascript_sets_what_it_names_in_parentheses_or_behind_a_condition(sets: str) -> None:
    text = escape(f"const env = this.environment.variables; {sets}; next()")
    script = f'<scriptTask id="T" scriptFormat="javascript"><script>{text}</script></scriptTask>'
    assert _may_be("n != 0", script) == {"Y", "Z"}


@pytest.mark.parametrize("reads", ["if (env.n) ++m", "while (env.n)\n  --m", "m = [env.n]", "if (env.n) [m] = [1]"])
def test_javascript_does_not_set_what_it_reads_before_something_else_is_set(reads: str) -> None:
    text = f"const env = this.environment.variables; let m = 1; {reads}"
    assert effects_of(Expression(text, "javascript"), script=True).sets == set()


OUTPUT = '<camunda:inputOutput><camunda:outputParameter name="n">3</camunda:outputParameter></camunda:inputOutput>'


@pytest.mark.parametrize(
    "inside",
    ['<userTask id="U"/>', f'<userTask id="U">{ASKED_FOR["its form"].replace("approved", "n")}</userTask>',
     f'<userTask id="U">{extensions(OUTPUT)}</userTask>'],
)  # fmt: skip
def test_what_a_called_process_lets_people_set_and_maps_is_unknown(inside: str) -> None:
    """The call is one step."""
    assert _may_be("n == 3", '<callActivity id="T" calledElement="Q"/>', inside) == {"Y", "Z"}


CAUGHT = '<errorEventDefinition camunda:errorCodeVariable="n" camunda:errorMessageVariable="text"/>'


@pytest.mark.parametrize(
    ("script", "condition"),
    [
        ("raise BpmnError('c' + str(q))", "n == 'c7'"),
        ("raise BpmnError(q)", "n == 'c7'"),
        ("raise BpmnError('c1', q)", "text == 'c7'"),
        ("m = q + 1", "n == 'script'"),
        ("m = q.foo", "n == 'script'"),
        ("m = q.foo", "'foo' in text"),
    ],
)
def test_code_and_text_of_an_error_may_be_what_an_unknown_value_is(script: str, condition: str) -> None:
    form = ASKED_FOR["its form"].replace("approved", "q").replace("boolean", "string")
    task = (
        f'<subProcess id="T"><userTask id="U">{form}</userTask><scriptTask id="E"><script>{script}</script>'
        '</scriptTask><sequenceFlow id="UE" sourceRef="U" targetRef="E"/></subProcess>'
        f'<boundaryEvent id="X" attachedToRef="T">{CAUGHT}</boundaryEvent>'
        '<sequenceFlow id="XG" sourceRef="X" targetRef="G"/>'
    )
    assert "Y" in _may_be(condition, task)


@pytest.mark.parametrize("text", ["low", "${level}"])
def test_the_text_of_an_error_is_not_known(text: str) -> None:
    task = (
        '<subProcess id="T"><startEvent id="B"/><endEvent id="E1"><errorEventDefinition errorRef="E"/></endEvent>'
        '<sequenceFlow id="BE" sourceRef="B" targetRef="E1"/></subProcess>'
        f'<boundaryEvent id="X" attachedToRef="T">{CAUGHT}</boundaryEvent>'
        '<sequenceFlow id="XG" sourceRef="X" targetRef="G"/>'
    )
    error = f'<error id="E" errorCode="c1" camunda:errorMessage="{text}"/>'
    assert _may_be("text == 'low'", task, root=error) == {"Y", "Z"}


@pytest.mark.parametrize("repeats", ["><loopCardinality>${q}</loopCardinality>", ' camunda:collection="${q}">'])
@pytest.mark.parametrize("sequential", ["true", "false"])
def test_an_unknown_number_of_instances_is_small_which_is_told(repeats: str, sequential: str) -> None:
    """It was not known whether an internal error, or a wrong cardinality, is raised."""
    form = ASKED_FOR["its form"].replace("approved", "q").replace("boolean", "long")
    loop = f'<multiInstanceLoopCharacteristics isSequential="{sequential}"{repeats}'
    text = process(
        f'<userTask id="U">{form}</userTask><sequenceFlow id="UM" sourceRef="U" targetRef="M"/>'
        f'<task id="M">{loop}</multiInstanceLoopCharacteristics></task>'
    )
    result = explore(fame.read(text.encode()), delivery="run")
    assert (result.findings, result.shortened) == ((), (("P", "M"),))
    failing = '<sequenceFlow id="MF" sourceRef="M" targetRef="F"/><scriptTask id="F"><script>1/0</script></scriptTask>'
    result = explore(fame.read(text.replace("</process>", f"{failing}</process>").encode()), delivery="run")
    assert any("; M: no items" in step.text for finding in result.findings for step in finding.run)


def _python(*texts: str) -> str:
    """Scripts, each in its task, and a form between them: the last one is T."""
    form, ids = ASKED_FOR["its form"].replace("approved", "q"), [f"T{n}" for n in range(len(texts) - 1)] + ["T"]
    scripts = "".join(
        f'<scriptTask id="{id}"><script>{escape(text)}</script></scriptTask>'
        for id, text in zip(ids, texts, strict=True)
    )
    tasks = "".join(
        f'<userTask id="{a}U">{form}</userTask><sequenceFlow id="{a}a" sourceRef="{a}" targetRef="{a}U"/>'
        f'<sequenceFlow id="{a}b" sourceRef="{a}U" targetRef="{b}"/>'
        for a, b in pairwise(ids)
    )
    return scripts + tasks


IN_PLACE = [
    ["list.append(xs, 9)"],
    ["(lambda v: v.append(9))(xs)"],
    ["sorted([1], key=xs.append)"],
    ["list(map(xs.append, [9]))"],
    ['d.setdefault("a", xs).append(5)'],
    ["(xs if n == 0 else [])[0:0] = [7]"],
    ["y = [xs]; y[0].append(1)"],
    ["match xs:\n  case [*_] as y: y.append(3)"],
    ["import operator; operator.iadd(xs, [3])"],
    ["f = list.append; f(xs, 3)"],
    ["sorted([xs], key=list.clear)\nxs += [1, 2]"],
    ["type(xs).append(xs, 3)"],
    ["import sys; sys._getframe().f_globals['xs'].append(3)"],
    ["globals()['xs'] = [1, 2]"],
    ["vars().update(xs=[1, 2])"],
    ["f = xs.append", "f(9)"],
    ["f = lambda: xs.append(9)", "f()"],
    ["def f():\n  y = xs\n  y.append(9)", "f()"],
    ["d['f'] = [xs.append]", "d['f'][0](9)"],
]


@pytest.mark.parametrize("texts", IN_PLACE)
def test_what_a_script_may_reach_it_may_change(texts: list[str]) -> None:
    """It was taken not to change, and the way behind the condition called unreachable."""
    for scripts in (texts, [*texts, "m = 3"]):
        first = "T0" if len(scripts) > 1 else "T"
        assert "Y" in _may_be("len(xs) == 2", _python(*scripts), first=first)


@pytest.mark.parametrize(
    "function",
    ["() => { env.n = 3 }", "() => { Object.assign(env, {n: 3}) }", "{'m'() { env.n = 3 }}['m']",
     "{m(k = (3)) { env.n = k }}.m"],
)  # fmt: skip
def test_a_function_of_javascript_may_set_a_variable_after_another_script_has_set_it(function: str) -> None:
    text = f"const env = this.environment.variables; setTimeout({function}, 9); next()"
    script = f'<scriptTask id="J" scriptFormat="javascript"><script>{escape(text)}</script></scriptTask>'
    after = '<sequenceFlow id="JT" sourceRef="J" targetRef="T"/><scriptTask id="T"><script>n = 1</script></scriptTask>'
    assert _may_be("n == 3", script + after, first="J") == {"Y", "Z"}
