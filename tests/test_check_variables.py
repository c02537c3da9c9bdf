"""Variables that nothing sets: what `fame check` knows of those of a process, its callers and its messages."""

import pytest
from bpmn_text import extensions, process, properties
from check_drawing import (
    BOOL,
    ROOT,
    VECTOR,
    alone,
    call,
    catch,
    checked,
    data,
    reading,
    row,
    script,
    team,
    throw,
    told,
)

from fame.bpmn.library import Library

CALLEE = (
    f'<process id="Q">{data("goal", x_goal="${x_goal}")}{row(reading("q", "goal", "y = x_goal"), mark="2")}</process>'
)


def calling(inside: str = "", before: str = "ready = True") -> str:
    """A pool whose process calls Q, which needs x_goal."""
    return team(row(script(before), call("c", "Q", inside))).replace("<signal", f"{CALLEE}<signal", 1)


def test_a_called_process_gets_the_variables_of_its_caller() -> None:
    assert told(calling()) == ["c: Q reads `x_goal`, which nothing sets"]
    assert told(calling(before="x_goal = 1")) == []


def test_a_behaviour_called_by_a_process_that_declares_nothing_lacks_its_inputs() -> None:
    found = checked(process(row(call("c", "GoTo"))), library=Library([ROOT / "models" / "library"]))
    assert [str(one.text) for one in found] == [
        f'"Go To" (GoTo) reads `{name}`, which nothing sets' for name in ("x_goal", "y_goal")
    ]


MONITORED = {
    "joint_monitor": ['"Joint Monitor" (joint_monitor) reads `model`, which nothing sets'],
    "adm_operate": ['"Operate" (adm_operate) needs `model`, which nothing sets'],
    "Record": ["Record needs `configuration`, which nothing sets", "Record needs `output`, which nothing sets"],
}


@pytest.mark.parametrize("called", MONITORED)
def test_a_monitoring_unit_that_is_called_lacks_what_it_cannot_do_without(called: str) -> None:
    assert told(team(row(call("c", called)))) == [f"c: {text}" for text in MONITORED[called]]
    assert told(team(row(script("model = configuration = output = 'x'"), call("c", called)))) == []


def test_what_a_monitoring_unit_gives_is_set() -> None:
    learnt = row(script("config = 'l.yaml'"), call("c", "adm_learn"), script("x = classifier", "u"))
    assert told(team(learnt)) == []
    assert told(team(learnt.replace("x = classifier", "x = score"))) == ["u: reads `score`, which nothing sets"]


def test_a_called_process_with_a_mapping_gets_what_that_names() -> None:
    given = extensions('<camunda:in source="x" target="x_goal"/>')
    other = extensions('<camunda:in source="x" target="y_goal"/>')
    everything = extensions('<camunda:in variables="all"/>')
    assert told(calling(given, "x = 1")) == []
    assert told(calling(given)) == ["c: reads `x`, which nothing sets"]
    assert told(calling(everything, "x_goal = 1")) == []
    assert told(calling(everything)) == ["c: Q reads `x_goal`, which nothing sets: add it to the mapping"]
    assert told(calling(other, "x = x_goal = 1")) == [
        "c: Q reads `x_goal`, which nothing sets; did you mean `y_goal`?",
    ]


def test_each_call_with_a_mapping_is_looked_at_also_beside_one_where_people_set_variables() -> None:
    given = extensions('<camunda:in source="x" target="x_gaol"/>')
    twice = row(script("x = 1"), call("c", "Q", given), call("d", "Q", given))
    text = "Q reads `x_goal`, which nothing sets; did you mean `x_gaol`?"
    assert told(team(twice).replace("<signal", f"{CALLEE}<signal", 1)) == [f"c: {text}", f"d: {text}"]
    everything = extensions('<camunda:in variables="all"/>')
    inner = "".join(
        f'<process id="{name}">{row(before, call(f"in{name}", "Q", everything), mark=name)}</process>'
        for name, before in (("M", '<userTask id="u"/>'), ("N", ""))
    )
    both = team(row(script("x = 1"), call("c", "M", everything), call("d", "N", everything)))
    assert told(both.replace("<signal", f"{CALLEE}{inner}<signal", 1)) == [
        "inN: Q reads `x_goal`, which nothing sets: add it to the mapping"
    ]


def test_a_process_without_a_pool_is_given_what_its_data_objects_declare() -> None:
    text = data("goal", x_goal="${x_goal}") + row(reading("t", "goal", "y = x_goal"))
    assert told(alone(text)) == []
    assert told(team(text)) == ["t: reads `x_goal`, which nothing sets"]
    assert told(alone(row(script("y = x_goal")))) == ["t: reads `x_goal`, which nothing sets"]


def test_a_data_object_sets_its_values_where_it_is_connected() -> None:
    text = data("area", x_min="0.5", x_max="${x_min + 1}") + row(reading("t", "area", "y = x_max - x_min"))
    assert told(team(text)) == []


def test_the_computed_code_of_an_error_reads_variables() -> None:
    end = '<endEvent id="e"><errorEventDefinition errorRef="E"/></endEvent>'
    text = process(f'<startEvent id="s"/>{end}<sequenceFlow id="f" sourceRef="s" targetRef="e"/>')
    found = checked(text.replace("<process", '<error id="E" errorCode="${kind}"/><process', 1))
    assert [one.text for one in found] == ["reads `kind`, which nothing sets"]


def test_a_caught_message_sets_what_it_fills() -> None:
    plain = row(catch("a", type=BOOL), script("y = done"))
    filled = data("d", x_weed="${x_weed}") + row(catch("a", type=VECTOR, into="d"), script("y = x_weed"))
    assert told(team(plain)) == []
    assert told(team(filled)) == []
    assert told(team(filled.replace("y = x_weed", "y = done"))) == ["t: reads `done`, which nothing sets"]


def test_where_people_set_variables_nothing_is_said_of_them() -> None:
    assert told(team(row('<userTask id="u"/>', script("y = answer")))) == []


def test_strict_makes_what_a_payload_lacks_an_error() -> None:
    text = alone(row(throw("a", type=VECTOR, payload="{x: ${speed}}"), script("y = pace")))
    assert told(text, "error") == []
    assert told(text, "error", strict=True) == ["a: reads `speed`, which nothing sets"]


ASKING = extensions('<camunda:formData><camunda:formField id="approved" type="boolean"/></camunda:formData>')


@pytest.mark.parametrize(
    ("form", "findings"),
    [
        (ASKING, ["t: reads `aproved`, which nothing sets; did you mean `approved`?"]),
        ("", []),  # a person may give any value
        (extensions('<camunda:formData><camunda:formField type="boolean"/></camunda:formData>'), []),
    ],
)
def test_a_form_sets_what_it_asks_for_and_nothing_else(form: str, findings: list[str]) -> None:
    asks = f'<userTask id="u">{form}</userTask>'
    assert told(team(row(asks, script("x = aproved")))) == findings
    assert told(team(row(asks, script("x = approved")))) == []


@pytest.mark.parametrize(
    ("key", "findings"),
    [
        ("jb.x = x", ["r: needs `jb`, which nothing sets; did you mean `job`?"]),
        ("job.x = x", []),
        ("jb = x", []),  # its first message sets it
    ],
)
def test_a_message_correlates_with_a_part_of_what_something_sets(key: str, findings: list[str]) -> None:
    receive = (
        f'<intermediateCatchEvent id="r">{properties(type=VECTOR, correlate=key)}'
        '<messageEventDefinition messageRef="M"/></intermediateCatchEvent>'
    )
    model = team(row(script("job = {'x': 1.0}"), receive))
    assert [
        one for one in told(model.replace("<signal", '<message id="M" name="m"/><signal', 1)) if "set" in one
    ] == findings
