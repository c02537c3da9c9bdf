"""Calls at the same time that share variables: `fame check` names those of which one changes what the other needs."""

import pytest
from bpmn_text import document
from check_drawing import call, choice, data, ends, flow, flows, parallel, reading, row, script, timer, told

PAUSE = timer("intermediateCatchEvent", "timeDuration", "PT1S")
Q = row(PAUSE, script("print(x_goal)"), mark="q")
GOALS = data("left", x_goal="5.0") + data("right", x_goal="1.0")


def going(id: str, goal: str = "", inside: str = "") -> str:
    """A call of Q with a data object."""
    association = reading(id, goal).partition(">")[2].partition("<script")[0] if goal else ""
    return call(id, "Q", association + inside)


def found(content: str, callee: str = Q) -> list[str]:
    """The warnings of this check in a process that may call Q."""
    text = document(f'<process id="P">{content}</process><process id="Q">{callee}</process>')
    return [one for one in told(text, "warning") if "same time" in one]


def forked(one: str, other: str, second: str = "b") -> str:
    """Two elements at once: ``a``, and one of that id."""
    drawn = f'<startEvent id="s"/>{parallel("g")}{one}{other}{ends("e", "f")}'
    return drawn + flows("s g a e", f"g {second} f")


AT_ONCE = "b: may be in progress at the same time as a, and both set `x_goal`: give the calls mappings"
ITEMS = "<multiInstanceLoopCharacteristics{0}><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
HANDLER = (
    '<subProcess id="h" triggeredByEvent="true"><startEvent id="hs" isInterrupting="{0}"><timerEventDefinition>'
    "<timeDuration>PT1S</timeDuration></timerEventDefinition></startEvent>{1}" + flows("hs b") + "</subProcess>"
)
BOUNDARY = (
    '<boundaryEvent id="o" attachedToRef="a" cancelActivity="{0}"><timerEventDefinition><timeDuration>PT1S'
    "</timeDuration></timerEventDefinition></boundaryEvent>{1}" + flows("o b")
)
OWN = row(script("y = 3", "i"), PAUSE.replace('"w"', '"v"'), script("print(y)", "k"), mark="p")
LEFT, RIGHT = going("a", "left"), going("b", "right")
WARNINGS = {
    "two calls at once that share variables": (GOALS + forked(LEFT, RIGHT), AT_ONCE),
    "one in a sub-process": (GOALS + forked(LEFT, f'<subProcess id="p">{RIGHT}</subProcess>', "p"), AT_ONCE),
    "one beside the other's boundary event": (GOALS + row(LEFT) + BOUNDARY.format("false", RIGHT), AT_ONCE),
    "one in a handler": (GOALS + row(LEFT) + HANDLER.format("false", RIGHT), AT_ONCE),
    "instances of a call, at once": (
        row(script("x_goal = 0", "before"), going("a", inside=ITEMS.format(""))),
        "a: its instances run at the same time and all set `x_goal`, which is set before: give it a mapping",
    ),
    "instances of a sub-process, at once": (
        row(script("y = 0", "before"), f'<subProcess id="a">{ITEMS.format("")}{OWN}</subProcess>'),
        "a: its instances run at the same time and all set `y`, which is set before: give it a mapping",
    ),
    "instances of what a data object gives": (
        data("one", y="5.0") + row(going("a", "one", ITEMS.format(""))),
        "a: its instances run at the same time and all set `y`, which is set before: give it a mapping",
    ),
}  # fmt: skip


FORM = '<camunda:formData><camunda:formField id="y" type="long"/></camunda:formData>'
OUTPUT = '<camunda:inputOutput><camunda:outputParameter name="y">${z}</camunda:outputParameter></camunda:inputOutput>'
CALLED_AT_ONCE = forked(going("a"), going("b"))


@pytest.mark.parametrize(
    "step",
    [
        script("for y in range(3): pass"),
        f'<userTask id="i"><extensionElements>{FORM}</extensionElements></userTask>',
        f'<userTask id="i"><extensionElements>{OUTPUT}</extensionElements></userTask>',
        '<scriptTask id="i" scriptFormat="juel" camunda:resultVariable="y"><script>${z}</script></scriptTask>',
    ],
)
def test_whatever_sets_a_variable_of_two_calls_at_once_counts(step: str) -> None:
    callee = row(step.replace('"t"', '"i"'), PAUSE, script("print(y)", "k"), mark="q")
    assert found(CALLED_AT_ONCE, callee) == [AT_ONCE.replace("x_goal", "y")]


@pytest.mark.parametrize(
    ("content", "warns"),
    [
        (CALLED_AT_ONCE.replace("parallelGateway", "inclusiveGateway"), True),
        (going("a") + going("b"), True),  # without a start event
        (row(f'<adHocSubProcess id="h">{going("a")}{going("b")}</adHocSubProcess>'), True),
        (row(f'<adHocSubProcess id="h" ordering="Sequential">{going("a")}{going("b")}</adHocSubProcess>'), False),
    ],
)
def test_all_ways_to_be_in_progress_at_the_same_time_count(content: str, warns: bool) -> None:
    assert found(content, SETS) == [AT_ONCE] * warns


SETS = Q.replace("print(x_goal)", "x_goal = 1\nawait sleep(1)\nprint(x_goal)")


@pytest.mark.parametrize("name", WARNINGS)
def test_calls_that_change_what_another_one_needs_at_the_same_time_are_a_warning(name: str) -> None:
    content, expected = WARNINGS[name]
    callee = {"instances of a call, at once": SETS, "instances of what a data object gives": OWN}.get(name, Q)
    assert found(content, callee) == [expected]


COUNTS = row(script("n = n + 1\nawait sleep(1)\nprint(n)"), mark="q")
LOCAL = row(script("x_goal = 1\nprint(x_goal)"), mark="q")
MAPPED = '<extensionElements><camunda:in source="{0}" target="x_goal"/></extensionElements>'


@pytest.mark.parametrize(
    ("content", "callee"),
    [
        (GOALS + row(LEFT, RIGHT), Q),
        (GOALS + row(choice("g"), LEFT) + RIGHT + ends("f") + flow("g", "b", "x") + flows("b f"), Q),
        (GOALS + row(LEFT) + BOUNDARY.format("true", RIGHT), Q),
        (GOALS + row(LEFT) + HANDLER.format("true", RIGHT), Q),
        (GOALS + forked(going("a", "left"), going("b", "left")), Q),  # of one value
        (GOALS + forked(LEFT, RIGHT), row(script("pass"), mark="q")),  # that nothing reads
        (forked(going("a"), going("b")), LOCAL),
        (forked(going("a"), going("b")), COUNTS),
        (forked(going("a", inside=MAPPED.format("x")), going("b", inside=MAPPED.format("y"))), SETS),
        (row(script("x_goal = 0", "before"), going("a", inside=ITEMS.format(' isSequential="true"'))), SETS),
        (row(going("a", inside=ITEMS.format(""))), SETS),  # each instance has its own
        (row(f'<subProcess id="a">{ITEMS.format("")}{OWN}</subProcess>'), Q),
        (data("one", x_goal="5.0") + row(going("a", "one", ITEMS.format(""))), Q),  # it is set once for all
    ],
)
def test_calls_that_do_not_disturb_each_other_are_none(content: str, callee: str) -> None:
    assert found(content, callee) == []
    if callee is SETS and "multi" not in content:
        assert found(content.replace("camunda:in", "camunda:other"), callee) != []


def test_what_follows_a_join_is_not_at_the_same_time() -> None:
    joined = parallel("j") + flows("s g a j b f", "g c j")
    inside = f'<startEvent id="s"/>{parallel("g")}{LEFT}{RIGHT}{script("pass", "c")}{ends("f")}'
    assert found(GOALS + inside + joined) == []


def test_two_that_both_keep_something_in_a_variable_are_a_warning() -> None:
    assert found(forked(going("a"), going("b")), SETS) == [AT_ONCE]
