"""An unknown condition that is asked again with unchanged variables has the same outcome."""

import re
from pathlib import Path

import pytest
from bpmn_text import properties
from collaborations import Step, Steps, team, text_of
from compare_explorations import replayed

import fame
from fame.check.explore import Exploration
from fame.check.explore.remembering import remembered
from fame.scenario.explore.exploration import explore

ASKED = ("if", "x > 3", ["throw go"], ["work"])
AGAIN = ("if", "x > 3", ["work"], ["throw go"])
UNKNOWN = "run x = robot.now"
TYPED = ('data-number="{}" name="x "><extensionElements><camunda:properties><camunda:property name="type" '
         'value="std_msgs/msg/Bool"/></camunda:properties></extensionElements>')  # fmt: skip


def stuck(steps: Steps, **robots: Steps) -> bool:
    """Whether B may wait for ever for what A throws at the one gateway or at the other."""
    found = result_of({"A": steps, "B": ["catch go"], **robots})
    assert found.exhaustive
    return any(one.kind in ("deadlock", "lost") for one in found.findings)


def result_of(robots: dict[str, Steps]) -> Exploration:
    return explore(team(robots), delivery="run")


def edited(steps: Steps, *changes: tuple[str, str], heard: int = 1, **called: Steps) -> bool:
    """Whether B may wait for ever in a model whose text is changed; `called` are processes that A calls."""
    found = explored(steps, *changes, heard=heard, **called)
    return any(place.element.startswith("B_catch_go") for one in found.findings for place in one.places)


def explored(
    steps: Steps, *changes: tuple[str, str], heard: int = 1, faults: bool = False, **called: Steps
) -> Exploration:
    text = text_of({"A": steps, "B": ["queue go"] * heard, **called}, calls=(*called,))
    for pattern, new in changes:
        text, count = re.subn(pattern, new, text)
        assert count
    found = explore(fame.read(text.encode()), delivery="run", faults=faults)
    assert found.exhaustive
    return found


@pytest.mark.parametrize("asked", ["=count(a[item > x]) = 3", "=a[x] = null", '=now() > @"1970-01-01T00:00:00.5Z"'])
def test_what_feel_filters_by_something_unknown_is_unknown_and_so_is_the_time(asked: str) -> None:
    read = ("if", "x > 3", ["work"], ["work"])
    assert stuck([UNKNOWN, "run a = [1, 2, 3]", ("if", asked, [read], ["throw go", read])])


@pytest.mark.parametrize(
    "between",
    [[], ["work"], ["run y = robot.now"], [("and", ["work"], ["timer PT5S"])], ["fail c"], ["send m"]],
)
def test_a_condition_has_one_outcome_while_its_variable_is_unchanged(between: Steps) -> None:
    assert not stuck([UNKNOWN, ASKED, *between, AGAIN], **({"M": ["receive m"]} if "send m" in between else {}))


@pytest.mark.parametrize(
    "between",
    [
        [UNKNOWN],
        ["person"],
        ["run x += 1"],
        ["run (x, y) = (robot.now, 2)"],
        ["run if robot.now == 7: x = 3"],
        [("and", [UNKNOWN], ["work"])],
        [("or", [UNKNOWN], ["work"])],
        [("guard", ["work"], "timer PT5S", [UNKNOWN])],
        [("scope", ["work"], "timer PT5S", [UNKNOWN])],
        [("watch", ["work"], "timer PT5S", [UNKNOWN])],
        [("beside", ["work"], "timer PT5S", [UNKNOWN])],
        [("each", 2, [UNKNOWN])],
        [("turns", 2, [UNKNOWN])],
        ["run match robot.now:\n  case x: pass"],
        ["run for x in [robot.now]: pass"],
        ["run import math as x"],
    ],
)
def test_a_variable_that_is_set_in_between_makes_another_outcome_possible(between: Steps) -> None:
    assert stuck([UNKNOWN, ASKED, *between, AGAIN])


CONDITIONS = [
    "x",
    "not x",
    "x > 3 and y &lt; 2",
    "x > y",
    "x in (3, y)",
    "len(x) > 3",
    "x[0] > 3",
    "x.data",
    "3 &lt; x > 1",
    "any(one > 3 for one in x)",
    "${x > 3 and y > 2}",
    "${x.data}",
    "=x > 3 or y = 2",
    '=contains(x, "a") and count(y) > 2',
    "${not (x > 3) or (y > 2)}",
]


@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_condition_that_only_reads_variables_has_one_outcome(condition: str) -> None:
    begun, asked, again = (UNKNOWN, "run y = robot.now"), ("if", condition, *ASKED[2:]), ("if", condition, *AGAIN[2:])
    assert not stuck([*begun, asked, "work", "run z = x", again])
    assert not stuck([*begun, ("each", 1, [asked, "work", again])])
    assert stuck([*begun, asked, UNKNOWN, again])
    assert stuck([*begun, asked, "person", again])


@pytest.mark.parametrize("changed", ["z.append(3)", "z[0] = 3", "z += [3]", "f(z)", "z.data = True", "y = 3"])
@pytest.mark.parametrize("condition", ["len(x) > y", "x and y", "x[0] > y"])
def test_what_a_script_may_change_in_place_may_have_another_outcome(condition: str, changed: str) -> None:
    begun = (UNKNOWN, "run y = robot.now", "run z = x", "run w = z if x else y")  # `z` decides something
    asked, again = ("if", condition, *ASKED[2:]), ("if", condition, *AGAIN[2:])
    assert stuck([*begun, asked, f"run {changed}", again, ("if", "z", ["work"], ["timer PT1S"])])


@pytest.mark.parametrize(
    "condition",
    ["robot.random.random() > x", "x.pop()", "x.take() > 3", "x()", "${abs(x) > 3}", "=now() > x"],
)
def test_what_may_change_without_a_write_is_never_remembered(condition: str) -> None:
    assert stuck([UNKNOWN, ("if", condition, *ASKED[2:]), "work", ("if", condition, *AGAIN[2:])])


def test_a_script_that_waits_may_set_its_variables_at_any_time_until_it_ends() -> None:
    sets, asks = "run await sleep(1); x = robot.now", [ASKED, "work", AGAIN]
    assert not stuck([sets, *asks])
    assert not stuck([UNKNOWN, ("and", ["run await sleep(1); y = robot.now"], asks)])
    assert stuck([UNKNOWN, ("and", [sets], asks)])
    assert stuck([UNKNOWN, ASKED, sets, AGAIN])


def test_a_message_that_comes_again_makes_another_outcome_possible() -> None:
    asked, again = ("if", "x.data", *ASKED[2:]), ("if", "x.data", *AGAIN[2:])

    def heard(*steps: object) -> bool:
        text = text_of({"A": ["catch x", *steps], "B": ["catch go"]})
        for number in range(text.count('name="x"')):
            text = text.replace('name="x">', TYPED.format(number), 1)
        found = explore(fame.read(text.encode()), delivery="run")
        assert found.exhaustive
        return any(place.element.startswith("B_catch_go") for one in found.findings for place in one.places)

    assert not heard(asked, "work", again)
    assert heard(asked, "catch x", again)


def test_what_may_be_set_in_ways_that_are_not_seen_is_never_remembered() -> None:
    def of(*steps: object) -> list[str]:
        (process,) = team({"A": [UNKNOWN, ASKED, *steps]}).processes
        return [*remembered([process.body])]

    assert of("work", "catch x", "person") == ["?python x > 3"]
    assert not of("run global x")
    assert not of("run class C: pass")
    assert not of("run import x")


def test_a_loop_asks_its_condition_again_only_if_something_sets_its_variable() -> None:
    loop = [("if", "x > 3", [("while", ["work", ("if", "x > 3", ["work"], ["stop"])])], [])]
    assert any(one.kind == "never" for one in result_of({"A": [UNKNOWN, *loop]}).findings)
    changed = [("if", "x > 3", [("while", [UNKNOWN, "work", ("if", "x > 3", ["work"], ["stop"])])], [])]
    assert not any(one.kind == "never" for one in result_of({"A": [UNKNOWN, *changed]}).findings)


def test_outcomes_that_nothing_asks_for_again_make_no_states() -> None:
    once = result_of({"A": [UNKNOWN, ("if", "x > 3", ["run z = 1"], ["run z = 1"]), "work", "timer PT1S"]})
    none = result_of({"A": [UNKNOWN, "work", "timer PT1S"]})
    assert once.states == none.states


def test_the_run_of_a_deadlock_behind_a_remembered_condition_can_be_replayed(tmp_path: Path) -> None:
    robots: dict[str, Steps] = {"A": [UNKNOWN, ASKED, "work", ("if", "x > 3", ["work"], ["catch go"])], "B": ["work"]}
    text = text_of(robots)
    found = [
        one for one in explore(fame.read(text.encode()), delivery="run").findings if one.kind in ("deadlock", "lost")
    ]
    assert found
    for one in found:
        assert not list(replayed(text, one, tmp_path))


# ---- variables that a scope has of its own ---------------------------------------------------------------------------

MAPPED = '<camunda:inputOutput><camunda:inputParameter name="x">${y}</camunda:inputParameter></camunda:inputOutput>'
GIVEN = '<camunda:in source="y" target="x"/>'
ITEMS = 'camunda:collection="items" camunda:elementVariable="x">'


def in_scope(kind: str, inside: Steps) -> bool:
    """Whether B may wait for ever for what a scope throws in which `x` is a variable of its own."""
    begun = ("run y = robot.now", "run items = [y, y]")
    match kind:
        case "call":
            given = (r"(<callActivity [^>]*>)", rf"\1<extensionElements>{GIVEN}</extensionElements>")
            return edited([*begun, ("call", "H")], given, H=inside)
        case "mapping":
            given = (r'(<subProcess id="A_scope_[^>]*>)', rf"\1<extensionElements>{MAPPED}</extensionElements>")
            return edited([*begun, ("guard", ["work", *inside], "timer PT9S", ["throw go"])], given)
        case "item":
            given = (r'(isSequential="false")><loopCardinality>2</loopCardinality>', rf"\1 {ITEMS}")
            return edited([*begun, ("each", 2, inside)], given, heard=2)
        case _:
            return edited([*begun, ("each", 2, ["run x = y", *inside])], heard=2)


@pytest.mark.long_but("call", "item")
@pytest.mark.parametrize("kind", ["call", "mapping", "item", "instance"])
def test_a_variable_that_a_scope_has_of_its_own_has_one_outcome_until_it_is_set(kind: str) -> None:
    for between in ([], ["work"], ["run y = robot.now"], ["run z = robot.now"]):
        assert not in_scope(kind, [ASKED, *between, AGAIN]), between
    for between in (
        [UNKNOWN],
        ["person"],
        ["run await sleep(1); x = robot.now"],
        ["run import lib; lib.f(x)"],
        ["run x.append(3)"],
    ):
        assert in_scope(kind, [ASKED, *between, AGAIN]), between


def test_a_variable_of_a_scope_and_one_outside_have_one_outcome_until_one_of_them_is_set() -> None:
    asked, again = (("if", "x > y", *one[2:]) for one in (ASKED, AGAIN))
    assert not in_scope("item", [asked, "work", again])
    assert in_scope("item", [asked, UNKNOWN, again])
    assert in_scope("item", [asked, "run y = robot.now", again])


def test_what_a_call_is_given_instead_has_an_outcome_of_its_own() -> None:
    all_but_x = '<camunda:in variables="all"/><camunda:in source="y" target="x"/>'
    given = (r"(<callActivity [^>]*>)", rf"\1<extensionElements>{all_but_x}</extensionElements>")
    assert edited([UNKNOWN, "run y = robot.now", ASKED, ("call", "H")], given, H=[AGAIN])


# ---- JavaScript ------------------------------------------------------------------------------------------------------

V = "this.environment.variables."
JAVASCRIPT = (
    (r'scriptFormat="python"><script>/\*js\*/', 'scriptFormat="javascript"><script>'),
    ("<conditionExpression>(?=[^<]*this)", '<conditionExpression language="JavaScript">'),
)


SETS_IN_JAVASCRIPT = [
    "$x = 3; next()",
    "$x++; next()",
    "$x.push(1); next()",
    "$z.push(1); next()",
    "$z[0] = 1; next()",
    "const t = $x; t.a = 1; next()",
    "const t = $x; t.pop(); next()",
    "f($x); next()",
    "delete $x.a; next()",
    "await 1; $x = 2; next()",
    "setTimeout(() => { $x = 2; }, 5); next()",
    "eval('1'); next()",
    "this.environment.variables['x'] = 3; next()",
    "[$x, $z] = [3, 4]; next()",
    "($x) = 3; next()",
    "($x)++; next()",
    "const t = $x; --(t.a); next()",
]
"""Scripts after which a variable may have another value."""


def js(text: str) -> str:
    """A script in JavaScript, in which ``$x`` is the variable `x`."""
    return f"run /*js*/{text.replace('$', V)}"


def stuck_in_javascript(condition: str, *between: object) -> bool:
    """Whether B may wait for ever for what A throws at one gateway or at another with the same condition."""
    condition = condition.replace("$", V).replace("&", "&amp;").replace("<", "&lt;")
    begun = (
        js("$x = Math.random(); $y = Math.random(); next();"),
        js("const z = $x; $z = z; next()"),
        js("$w = 3; next()"),
    )
    asked, again = ("if", condition, *ASKED[2:]), ("if", condition, *AGAIN[2:])
    return edited([*begun, asked, *between, again], *JAVASCRIPT)


@pytest.mark.long_but("next*")
@pytest.mark.parametrize(
    "condition",
    ["$x > 3", "next(null, $x > 3);", "$x === 3 && !($y < 2)", "$x.length > 3 || $y.data", "!$x", "$x[0] !== $y",
     "$x ? $y > 1 : false", "typeof $x === 'number' && $x > 3"],
)  # fmt: skip
def test_a_condition_in_javascript_has_one_outcome_until_its_variables_are_set(condition: str) -> None:
    same = ["work", "run v = robot.now", js("$v = $x + 1; next()"), js("if ($x > 3) { $v = Math.abs($w); }; next()")]
    for between in ([], same, [js("const t = $x; console.log(t); next()")], [js("$w.push(1); next()")]):
        assert not stuck_in_javascript(condition, *between), between
    for text in SETS_IN_JAVASCRIPT:
        assert stuck_in_javascript(condition, js(text)), text
    assert stuck_in_javascript(condition, UNKNOWN)
    assert stuck_in_javascript(condition, "person")


@pytest.mark.parametrize(
    "condition",
    ["$x > Math.random()", "$x.next() > 3", "this.content.x > $x", "$ros_node.a > $x",
     "$x ? $x.next() : 0", "$x ? ($y = 2) : 0", "$x ? $y >>= 1 : 0", "$x ? this.content : 0", "$x ? $ros_node.a : 0"],
)  # fmt: skip
def test_what_may_change_without_a_write_is_never_remembered_in_javascript(condition: str) -> None:
    assert stuck_in_javascript(condition, "work")


# ---- what takes time and does not complete ---------------------------------------------------------------------------

SLOW = "run x = 1; await sleep(1)\nif odd: raise BpmnError('c')"
SAID = "run await sleep(1); signal('go')\nif odd: raise BpmnError('c')"
BEGUN = "run x = 0"
LEFT = ("if", "x == 0", ["throw go"], ["work"])


@pytest.mark.parametrize(
    "steps",
    [
        [("guard", [SLOW, "throw go"], "error c", [LEFT])],
        [("guard", [("call", "H"), "throw go"], "error c", [LEFT])],
        [("guard", [SLOW, "throw go"], "timer PT5S", [LEFT])],
        [("scope", [SLOW, "throw go"], "timer PT5S", [LEFT])],
        [("and", [SLOW, "throw done"], [LEFT])],
        [("guard", [SAID, "throw done"], "error c", ["throw stop"])],
    ],
)
def test_what_did_not_complete_may_have_set_variables_and_sent_signals(steps: Steps) -> None:
    first = ("race", ["catch go", "catch done"], ["catch stop"])
    heard = [first if "stop" in repr(steps) else ("race", ["catch done", "catch go"], ["catch go"])]
    called = {"H": ["run x = 1", "work", ("or", ["work"], ["error c"])]} if "'H'" in repr(steps) else {}
    text = text_of({"A": [BEGUN, *steps], "B": heard, **called}, calls=(*called,))
    found = explore(fame.read(text.encode()), delivery="run")
    assert found.exhaustive
    stuck = {place.element for one in found.findings if one.kind in ("deadlock", "lost") for place in one.places}
    assert stuck, [str(one) for one in found.findings]


SERVICE = {"service": "blade", "type": "std_srvs/srv/SetBool"}
ACTION = {"action": "drive", "type": "nav2_msgs/action/Spin"}


def served(steps: Steps, code: str, said: dict[str, str]) -> tuple[tuple[tuple[str, str], ...], dict[str, Steps]]:
    """What makes the work of A a service task, and the code of error `c` that one; a process that it calls."""
    task = f"<serviceTask id='served'>{properties(**said)}</serviceTask>"
    changes = (
        (r'<scriptTask id="[AH]_work_\d+"(.*?)</scriptTask>', task),
        (r'"[AH]_work_\d+"', '"served"'),
        ('errorCode="c"', f'errorCode="{code}"') if code else (r' errorRef="Error_c"|\Z', ""),
    )
    return changes, ({"H": ["work"]} if "'H'" in repr(steps) else {})


def with_a_service(steps: Steps, code: str = "c", **said: str) -> bool:
    """Whether B may wait for ever where the work of A is a service task."""
    changes, called = served(steps, code, said)
    return edited(steps, *changes, **called)


@pytest.mark.parametrize("inner", ["work", ("call", "H")])
@pytest.mark.parametrize(("code", "said", "told"), [
    ("lost", SERVICE, "service"), ("service", ACTION, "aborted"), ("service", SERVICE | {"retry": "never"}, "lost"),
    ("aborted", ACTION | {"errors": "{service: 'off'}"}, "off"),
])  # fmt: skip
def test_a_failure_that_no_error_event_catches_is_told_and_leaves_robots_waiting_as_a_single_fault(
    inner: Step, code: str, said: dict[str, str], told: str
) -> None:
    steps: Steps = ["run x = 0", ("guard", [inner], "error c", ["end"]), "throw go"]
    changes, called = served(steps, code, said)
    found = explored(steps, *changes, faults=True, **called)
    (one,) = (one for one in found.findings if "may fail" in one.text)
    assert (one.kind, one.level) == ("error", "warning")
    assert one.text.endswith(f"may fail: error {told} would not be caught")
    assert any(f"fails: {told}: B waits" in one.text for one in found.findings if one.kind == "fault")
    for caught in ("", "script"):  # by an event of any code
        changes, called = served(steps, caught, said)
        found = explored(steps, *changes, **called)
        assert any("may fail" in one.text for one in found.findings) == bool(caught)


@pytest.mark.parametrize(("said", "code"), [
    *[(SERVICE | {"retry": "never"}, code) for code in ("service", "lost", "")],
    *[(ACTION | {"retry": "ask"}, code) for code in ("service", "lost", "aborted", "canceled", "rejected")],
    (ACTION | {"errors": "{aborted: stuck, 208: no_path}"}, "no_path"),
    ({"service": "learn"}, "anything"),
])  # fmt: skip
def test_a_service_or_action_may_fail_with_what_is_caught(said: dict[str, str], code: str) -> None:
    failed = ("if", "x == 0", ["throw go"], ["run y = 1"])
    assert with_a_service(["run x = 0", ("guard", ["work"], "error c", ["run x = 2"]), failed], code, **said)
    for inner in ("work", ("call", "H")) if code != "anything" else ():
        inside = ("guard", ["run y = 1", inner], "error c", ["run x = 2"])
        assert with_a_service(["run x = 0", inside, failed], code, **said), inner
    assert not with_a_service(["run x = 0", "work", failed], code, **said)


def test_what_a_service_answers_and_an_action_tells_meanwhile_is_unknown() -> None:
    answered = ("if", "blade.success", ["throw go"], ["run y = 1"])
    assert with_a_service(["run blade = 0", "work", answered], **SERVICE)
    told = [("and", ["work"], [("if", "angle == 0", ["throw go"], ["run y = 1"])])]
    assert with_a_service(["run angle = 0", *told], **ACTION, feedback="angle")
