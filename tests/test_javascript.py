"""Scripts and conditions in JavaScript: their variables, their interface, their lines."""

import math
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy
import pytest
from hypothesis import given, settings, strategies as st
from javascript_models import chain, definitions, error_of, flows, run, simulate, task

import fame
from fame.bpmn.model import Expression
from fame.engine.data import Variables
from fame.errors import ModelError, UnavailableError
from fame.middleware import messages, typesystem
from fame.scripting import compile_expression, compile_script


def script(text: str, **variables: Any) -> dict[str, Any]:
    """Run one script without a robot; gives the variables without the interface."""
    assert compile_script(Expression(text, "javascript"))(variables) is None
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def value(text: str, **variables: Any) -> Any:
    return compile_expression(Expression(text, "javascript"))(variables)


# ---- variables -------------------------------------------------------------------------------------------------------


def test_a_script_reads_and_writes_the_variables_of_its_process() -> None:
    assert run("this.environment.variables.x = this.environment.variables.x + 1; next()", x=41) == {"x": 42}


DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(min_size=1), inner, max_size=4),
    max_leaves=12,
)


def alike(one: Any, other: Any) -> bool:
    """Equal as JavaScript sees it: there is one kind of number, and not-a-number is itself."""
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, float) and math.isnan(one):
        return isinstance(other, float) and math.isnan(other)
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, dict):
        return isinstance(other, dict) and [*one] == [*other] and all(map(alike, one.values(), other.values()))
    if isinstance(one, (int, float)):
        return isinstance(other, (int, float)) and float(one) == float(other)
    return type(one) is type(other) and one == other


@pytest.mark.long
@settings(max_examples=60)
@given(DATA)
def test_every_value_comes_back_as_it_went(x: Any) -> None:
    written = script("const v = this.environment.variables; v.y = [v.x]; next()", x=x)
    assert alike(integers_first(x), integers_first(written["y"][0]))


def integers_first(value: Any) -> Any:
    """The same with the keys of mappings in the order of JavaScript: those that are array indices come first."""
    if isinstance(value, list):
        return [integers_first(item) for item in value]
    if isinstance(value, dict):
        return {key: integers_first(value[key]) for key in sorted(value)}
    return value


@pytest.mark.parametrize(
    ("given", "seen"),
    [
        ((1, 2), [1, 2]),
        ({3, 1}, [1, 3]),
        (numpy.array([1.5, 2.5]), [1.5, 2.5]),
        (numpy.float64(0.5), 0.5),
        (SimpleNamespace(a=1, b=[2]), {"a": 1, "b": [2]}),
        (2**40, 2**40),
        ({1: "one"}, {"1": "one"}),
        (messages.create("geometry_msgs/msg/Vector3", {"x": 2.5}), {"x": 2.5, "y": 0, "z": 0}),
        ([messages.create("std_msgs/msg/String", "a")], [{"data": "a"}]),
    ],
)
def test_values_of_python_are_seen_as_plain_data(given: Any, seen: Any) -> None:
    written = script("const v = this.environment.variables; v.y = {is: v.x}; next()", x=given)
    assert written["y"]["is"] == seen


def test_code_of_python_is_not_seen() -> None:
    text = "const v = this.environment.variables; v.y = [v.f, v.m, v.o, v.__builtins__].map((x) => typeof x); next()"
    assert script(text, f=len, m=math, o=object)["y"] == ["undefined"] * 4


def test_numbers_without_fraction_are_integers_in_python() -> None:
    y = script("this.environment.variables.y = [0.5 + 0.5, 1e3, 2.5]; next()")["y"]
    assert [type(number) for number in y] == [int, int, float]


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("10n ** 3n", 1000),
        ("new Float32Array([1, 2.5])", [1, 2.5]),
        ("new Date(86400000)", "1970-01-02T00:00:00.000Z"),
        ("{a: undefined, b: () => 1, c: 1}", {"c": 1}),
        ("[undefined, null]", [None, None]),
        ("[NaN, -Infinity]", pytest.approx([math.nan, -math.inf], nan_ok=True)),
    ],
)
def test_values_of_javascript_become_plain_data(text: str, seen: Any) -> None:
    assert script(f"this.environment.variables.y = {text}; next()")["y"] == seen


def test_what_is_changed_inside_a_collection_is_changed() -> None:
    text = "const v = this.environment.variables; v.path.push({x: 3}); v.path[0].x = 1; next()"
    assert script(text, path=[{"x": 0}])["path"] == [{"x": 1}, {"x": 3}]


@pytest.mark.parametrize("size", [10, 300, 5000, 100_000])
def test_values_of_any_size_come_back(size: int) -> None:
    text = "const v = this.environment.variables; v.y = v.x.concat([v.s + v.s]); v.t = v.s + v.s; v.x[0] = -1; next()"
    written = script(text, x=list(range(size)), s="s" * size)
    assert written["y"] == [*range(size), "s" * 2 * size]
    assert written["t"] == "s" * 2 * size
    assert written["x"] == [-1, *range(1, size)]


def test_a_collection_that_is_only_read_stays_the_same_object() -> None:
    path = [{"x": 0.0}]
    assert script("const n = this.environment.variables.path.length; next()", path=path)["path"] is path


def test_what_python_changes_between_steps_is_seen() -> None:
    add = compile_script(
        Expression("const v = this.environment.variables; v.n = v.path.length + v.k; next()", "javascript")
    )
    variables: dict[str, Any] = {"path": [1], "k": 0}
    for change in (lambda: variables["path"].append(2), lambda: variables.update(k=10), lambda: variables.pop("n")):
        add(variables)
        change()
    add(variables)
    assert variables["n"] == 12
    del variables["path"]
    with pytest.raises(Exception, match="cannot read property 'length' of undefined"):
        add(variables)


SEEN = "const v = this.environment.variables; v.seen = 'x' in v ? {is: v.x} : 'nothing'; next()"


@pytest.mark.parametrize(
    ("given", "change", "seen"),
    [
        ({1, 2}, lambda v: v["x"].add(3), {"is": [1, 2, 3]}),
        (([1],), lambda v: v["x"][0].append(2), {"is": [[1, 2]]}),
        (Counter("a"), lambda v: v["x"].update("b"), {"is": {"a": 1, "b": 1}}),
        (bytearray(b"a"), lambda v: v["x"].append(1), {"is": [97, 1]}),
        (numpy.array([1, 2]), lambda v: v["x"].fill(3), {"is": [3, 3]}),
        (SimpleNamespace(a=1), lambda v: setattr(v["x"], "a", 2), {"is": {"a": 2}}),
        (messages.create("std_msgs/msg/String", "a"), lambda v: setattr(v["x"], "data", "b"), {"is": {"data": "b"}}),
        ([1], lambda v: v["x"].append(len), "nothing"),
        ([1], lambda v: v["x"].append(v["x"]), "nothing"),
        ([1], lambda v: v.update(x=math), "nothing"),
        (5, lambda v: v.update(x=lambda: 1), "nothing"),
        (5, lambda v: v.update(x=object()), "nothing"),
        ([len], lambda v: v["x"].clear(), {"is": []}),
    ],
)
def test_what_python_changes_in_place_is_seen_or_gone(given: Any, change: Callable[[Any], None], seen: Any) -> None:
    look, variables = compile_script(Expression(SEEN, "javascript")), {"x": given}
    look(variables)
    change(variables)
    kept = variables["x"]
    look(variables)
    assert variables["seen"] == seen
    assert variables["x"] is kept


def test_what_cannot_be_sent_is_gone_for_a_script_that_names_it_later() -> None:
    variables: dict[str, Any] = {"x": 5}
    for unnamed in (5, len):
        variables["x"] = unnamed
        compile_script(Expression("next()", "javascript"))(variables)
    compile_script(Expression(SEEN, "javascript"))(variables)
    assert (variables["seen"], variables["x"]) == ("nothing", len)


@pytest.mark.parametrize("before", [5, [1]])
def test_a_function_of_another_process_is_gone_here(before: Any) -> None:
    other: dict[str, Any] = {}
    compile_script(Expression("this.environment.variables.f = () => 1; next()", "javascript"))(other)
    look, variables = compile_script(Expression(SEEN, "javascript")), {"x": before}
    look(variables)
    variables["x"] = other["f"]
    look(variables)
    assert (variables["seen"], variables["x"]) == ("nothing", other["f"])


def test_a_variable_that_was_never_set_is_null_to_a_loose_comparison() -> None:
    assert script("this.environment.variables.y = this.environment.variables.x == null; next()")["y"] is True


def test_a_deleted_variable_and_one_made_undefined_are_gone() -> None:
    assert script("const v = this.environment.variables; delete v.a; v.b = undefined; next()", a=1, b=2, c=3) == {
        "c": 3
    }


def test_the_variables_are_an_object_like_any_other() -> None:
    text = """
        const variables = this.environment.variables, {a, ...rest} = variables;
        Object.assign(variables, {names: Object.keys(variables), has: ['a' in variables, 'z' in variables,
            variables.hasOwnProperty('l')], a, rest, text: JSON.stringify(variables)});
        for (const name in {b: 1}) variables['got_' + name] = variables[name];
        next()"""
    seen = script(text, a=1, b=2, l=[3])
    assert seen["names"] == ["a", "b", "l"]
    assert seen["has"] == [True, False, True]
    assert seen["rest"] == {"b": 2, "l": [3]}
    assert seen["text"] == '{"a":1,"b":2,"l":[3]}'
    assert seen["got_b"] == 2


def test_collections_that_no_script_names_are_not_converted() -> None:
    class Costly(dict[str, Any]):
        def items(self) -> Any:
            raise AssertionError("converted")

    assert script("this.environment.variables.y = 1; next()", big=Costly(a=1))["y"] == 1


def test_scripts_hand_functions_and_handles_to_each_other_through_variables() -> None:
    texts = ("const v = this.environment.variables; v.twice = (n) => 2 * n; next()",
             "const v = this.environment.variables; v.y = v.twice(21); next()")  # fmt: skip
    assert run(*texts) == {"y": 42}


def test_a_script_in_an_inner_scope_writes_where_the_variable_is() -> None:
    outer: dict[str, Any] = {"total": 1, "path": [1]}
    inner = Variables(outer, {"item": 5})
    text = "const v = this.environment.variables; v.total += v.item; v.path.push(v.item); v.fresh = 7; next()"
    compile_script(Expression(text, "javascript"))(inner)
    assert (outer["total"], outer["path"]) == (6, [1, 5])
    assert inner["fresh"] == 7
    assert "fresh" not in outer


# ---- next() and conditions -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["next()", "next(null)", "next(undefined, 3)", "this.next()", "return next();"])
def test_next_completes_a_script(text: str) -> None:
    run(text)


def test_what_next_is_told_is_the_output_of_the_element() -> None:
    texts = ("next(null, {found: 3})", "this.environment.output.more = this.environment.output.t1.found + 1; next()",
             "this.environment.variables.out = this.environment.output; next()")  # fmt: skip
    assert run(*texts)["out"] == {"t1": {"found": 3}, "more": 4}


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("next(null, this.environment.variables.x > 3)", True),
        ("next(null, environment.variables.x > 30);", False),
        ("this.environment.variables.x > 3", True),
        ("this.environment.variables.x > 3; // enough", True),
        ("\n  this.environment.variables.x\n    + 1;\n", 6),
        ("const x = this.environment.variables.x; next(null, x * 2)", 10),
        ("const x = this.environment.variables.x; return x * 2", 10),
        ("this.environment.variables.never", None),
        ("({x: [1]})", {"x": [1]}),
        ("'text'", "text"),
        ("Promise.resolve(3).then((n) => next(null, n === 3))", True),
    ],
)
def test_a_condition_is_an_expression_or_a_script_that_answers(text: str, result: Any) -> None:
    assert value(text, x=5) == result


@pytest.mark.parametrize("text", ["const x = 1;", "if (false) next(null, true)", "const t = () => next(null, 1);"])
def test_a_condition_that_gives_no_value_is_an_error(text: str) -> None:
    with pytest.raises(Exception, match="gives no value"):
        value(text)


def test_a_condition_may_fail() -> None:
    with pytest.raises(Exception, match="no idea"):
        value("next(new Error('no idea'))")


def test_flows_are_chosen_by_conditions_in_javascript() -> None:
    condition = '<conditionExpression xsi:type="tFormalExpression" language="JavaScript">{}</conditionExpression>'
    content = (
        '<startEvent id="s"/><exclusiveGateway id="g" default="g_b"/><endEvent id="a"/><endEvent id="b"/>'
        f'{flows("s", "g")}<sequenceFlow id="g_b" sourceRef="g" targetRef="b"/>'
        '<sequenceFlow id="g_a" sourceRef="g" targetRef="a">'
        + condition.format(
            "next(null, this.environment.variables.who === this.environment.variables.ros_node.namespace())"
        )
        + "</sequenceFlow>"
    )
    for who, end in (("/REX", "a"), ("/DINGO", "b")):
        simulation = fame.Simulation(definitions(content), variables={"who": who}, robot="REX").run()
        assert simulation.instances[0].visits[end] == 1


# ---- what stands in scope --------------------------------------------------------------------------------------------


def test_a_script_knows_its_element() -> None:
    text = "this.environment.variables.y = [this.id, this.type, id, this.content.id, typeof this.fields]; next()"
    assert run(text)["y"] == ["t1", "bpmn:ScriptTask", "t1", "t1", "object"]


def test_a_function_without_an_object_has_the_scope_for_this() -> None:
    text = (
        "function set() { this.environment.variables.y = this.id; }\n set(); [1].forEach(function () { this.next(); });"
    )
    assert run(text)["y"] == "t1"


@pytest.mark.parametrize("name", ["environment", "next", "id", "console", "logger", "setTimeout", "node"])
def test_a_script_may_use_the_names_of_the_interface_for_itself(name: str) -> None:
    other = "this.next" if name == "next" else "next"
    assert run(f"const {name} = 5; this.environment.variables.y = {name}; {other}()")["y"] == 5


def test_variables_of_one_script_are_not_those_of_another() -> None:
    assert run("var a = 1; let b = 2; next()", "this.environment.variables.y = [typeof a, typeof b]; next()")["y"] == [
        "undefined",
        "undefined",
    ]


def test_a_variable_named_node_hides_the_robot() -> None:
    text = "const v = this.environment.variables; v.y = [v.node, typeof v.ros_node.createPublisher]; next()"
    assert run(text, node="hidden")["y"] == ["hidden", "function"]


def test_console_and_logger_write_to_the_log() -> None:
    simulation = simulate(
        "console.log('at', 1, {a: [2]}, null); this.logger.warn('low'); console.error(new Error('no')); next()"
    )
    simulation.run()
    assert [event.detail for event in simulation.reports] == ['at 1 {"a":[2]} null', "warning: low", "error: Error: no"]


def test_the_time_is_that_of_the_engine() -> None:
    text = """const v = this.environment.variables, began = Date.now();
        setTimeout(() => { v.y = [began, Date.now(), new Date().toISOString(), performance.now(), new Date(5).getTime(),
                                  new Date() instanceof Date]; next() }, 61000)"""
    assert run(text)["y"] == [0, 61000, "1970-01-01T00:01:01.000Z", 61000, 5, True]


def test_chance_is_the_same_in_each_run_and_differs_between_robots() -> None:
    text = "this.environment.variables.y = [Math.random(), Math.random()]; next()"
    first, again = run(text)["y"], run(text)["y"]
    other = fame.Simulation(chain(text), robot="DINGO").run().instances[0].variables["y"]
    assert first == again != other
    assert all(0 <= number < 1 for number in (*first, *other))
    assert len({*first, *other}) == 4


# ---- errors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("next();\nx = = 2", 11, "unexpected token in expression: '=': `x = = 2`"),
        ("if (x {\nnext() }", 10, "`if (x {`"),
        ("const a = 1;\n\nconst a = 2;", 12, "`const a = 2;`"),
        ("} next(); {", 10, "not valid JavaScript"),
        ("})(); (function () {", 10, "not valid JavaScript"),
        ("import x from 'y'", 10, "not valid JavaScript"),
        ("await 1", 10, "not valid JavaScript"),
    ],
)
def test_a_syntax_error_names_file_line_and_element(text: str, line: int, complaint: str) -> None:
    with pytest.raises(ModelError) as caught:
        compile_script(Expression(text, "javascript", 10), file="m.bpmn", element="Task_1")
    assert (caught.value.file, caught.value.line, caught.value.element) == ("m.bpmn", line, "Task_1")
    assert complaint in str(caught.value)


def test_a_syntax_error_is_found_before_anything_moves() -> None:
    with pytest.raises(ModelError, match=r"m.bpmn:5: t2: not valid JavaScript"):
        simulate("next()", "foo bar")


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("\nnull.x; next()", 5, "TypeError: cannot read property 'x' of null"),
        ("const f = () => {\n  missing();\n};\nf(); next()", 5, "ReferenceError: missing is not defined"),
        ("\n\n[1].map(() => { throw new Error('inside') }); next()", 6, "Error: inside"),
        ("\nnext(new Error('no way'))", 5, "Error: no way"),
        ("next('no way')", 4, "no way"),
        ("throw {reason: 3}; next()", 4, '{"reason":3}'),
        ("throw null; next()", 4, "null"),
        ("\n\nthis.environment.variables.ros_node.createPublisher('std_msgs/msg/Bool'); next()", 6, "is not a name"),
        ("\nsetTimeout(5); next()", 5, "setTimeout: expected a function to call back"),
        ("\nthis.environment.variables.__proto__ = {}; next()", 5, "__proto__ cannot be the name of a variable"),
    ],
)
def test_an_error_of_a_script_names_the_line_of_the_file(text: str, line: int, complaint: str) -> None:
    error = error_of(text)
    assert (error.robot, error.element, error.code, error.line) == ("REX", "t1", "script", line)
    assert complaint in error.text


def test_what_a_script_wrote_before_its_error_counts() -> None:
    simulation = simulate("this.environment.variables.x = 2; throw new Error('late'); next()", x=1).run()
    assert simulation.instances[0].variables == {"x": 2}


def guarded(text: str, code: str = "") -> fame.Simulation:
    """A script with a boundary event for errors, to `caught`."""
    definition = '<errorEventDefinition errorRef="Low"/>' if code else "<errorEventDefinition/>"
    content = (
        f'{task("t", text)}<startEvent id="s"/><endEvent id="e"/><endEvent id="caught"/>{flows("s", "t", "e")}'
        f'<boundaryEvent id="b" attachedToRef="t">{definition}</boundaryEvent>{flows("b", "caught")}'
    )
    return fame.Simulation(definitions(content), robot="REX").run()


@pytest.mark.parametrize(
    "text",
    [
        "throw new Error('any'); next()",
        "next('any')",
        "next(); next();",
        "1 + 1;",
        "const robot = this.environment.variables.ros_node;\n"
        "robot.createPublisher('std_msgs/msg/Bool', 'led').publish({on: true}); next()",
        "this.environment.variables.ros_node.createSubscription('x/msg/Y', 'odom', () => {}); next()",
        "setTimeout(() => { throw new Error('later') }, 1000); setTimeout(next, 2000)",
        "(function f() { f() })(); next()",
    ],
)
def test_events_of_the_model_catch_errors_of_scripts(text: str) -> None:
    (instance,) = guarded(text).instances
    assert instance.status == "completed"
    assert instance.visits["caught"] == 1


def test_an_error_with_a_code_is_caught_by_the_event_of_that_code() -> None:
    low = "const error = new Error('battery'); error.code = 'low'; next(error)"
    assert guarded(low, code="low").instances[0].visits["caught"] == 1
    assert guarded("throw {code: 'low'}; next()", code="low").instances[0].visits["caught"] == 1
    failed = guarded("next(new Error('other'))", code="low").instances[0]
    assert failed.status == "failed"
    assert error_of(low).code == "low"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("next(); next();", "next() was called twice"),
        ("const x = 1;", "never calls next()"),
        ("setTimeout(() => {}, 1000);", "never calls next()"),
        ("if (false) next();", "returned without calling next(), and left nothing that could call it"),
        ("setTimeout(() => { if (false) next() }, 1000);", "returned without calling next()"),
        ("Promise.reject(new Error('x')).then(next)", "a promise was rejected: Error: x"),
    ],
)
def test_next_twice_or_never_is_an_error(text: str, complaint: str) -> None:
    assert complaint in error_of(text).text


def test_next_once_more_in_a_later_step_comes_too_late_and_is_reported() -> None:
    simulation = simulate(
        "setTimeout(next, 1000); setTimeout(next, 2000); setTimeout(next, 2500)", "setTimeout(next, 5000)"
    )
    assert simulation.run().instances[0].status == "completed"
    assert [(event.element, event.detail) for event in simulation.reports] == [
        ("t1", "next() was called again, after the script was over")
    ]


def test_without_its_engine_it_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "quickjs", None)
    with pytest.raises(UnavailableError, match=r"pip install 'fame-robots\[js\]'"):
        compile_script(Expression("next()", "javascript"))


def test_without_a_robot_a_script_has_its_variables_alone() -> None:
    with pytest.raises(UnavailableError, match="there is no robot here"):
        script("setTimeout(next, 5)")


def test_its_engine_is_loaded_when_a_script_is_compiled_and_not_before() -> None:
    code = "import sys, fame.scripting, fame.robot; print('quickjs' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


# ---- as in Node.js ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        (r"({'\0': '5'})", {"\0": "5"}),
        (r"[{'\0': 'weed'}, {'\0': 5}, NaN]", [{"\0": "weed"}, {"\0": 5}, math.nan]),
        ("new Map([['a', new Set([1, 2])]])", {"a": [1, 2]}),
    ],
)
def test_maps_and_strange_keys_are_what_they_are(text: str, seen: Any) -> None:
    assert alike(script(f"this.environment.variables.y = {text}; next()")["y"], seen)


def test_variables_are_in_the_next_script_what_they_are_for_all_others() -> None:
    first = f"{V}v.zero = -0; v.gone = undefined; next()"
    then = f"{V}v.y = [Object.is(v.zero, -0), 'gone' in v, Object.keys(v).length]; next()"
    assert run(first, then) == {"zero": 0, "y": [False, False, 1]}


def test_large_integers_keep_their_digits() -> None:
    given = script("this.environment.variables.y = [9007199254740993n, -(2n ** 70n), 5n]; next()")["y"]
    assert given == [9007199254740993, -(2**70), 5]
    assert [*map(type, given)] == [int, int, int]


V = "const v = this.environment.variables; "


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("v.k = 1", {"x": 2**60, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 0}, "k": 1}),
        ("v.z.n = 1", {"x": 2**60, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 1}}),
        ("v.y.push(2)", {"x": 2**60, "y": [2**60 + 1, 2], "z": {"stamp": -(2**70), "n": 0}}),
        ("v.x = v.x", {"x": 2**60, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 0}}),
        ("v.a = v.z.stamp", {"x": 2**60, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 0}, "a": -(2**70)}),
        ("v.a = 2n ** 60n", {"x": 2**60, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 0}, "a": 2**60}),
        ("v.x = v.x / 2", {"x": 2**59, "y": [2**60 + 1], "z": {"stamp": -(2**70), "n": 0}}),
    ],
)
def test_a_large_integer_that_a_script_leaves_alone_keeps_its_digits(text: str, seen: dict[str, Any]) -> None:
    given = script(f"{V}{text}; next()", x=2**60, y=[2**60 + 1], z={"stamp": -(2**70), "n": 0})
    if "/" in text:  # computed: as near as a number of JavaScript comes
        assert float(given.pop("x")) == float(seen.pop("x"))
    assert given == seen


def test_a_value_in_javascript_is_the_integer_that_it_was() -> None:
    assert value("this.environment.variables.x", x=2**60 + 1) == 2**60 + 1


def test_a_strange_key_of_python_stays_a_key() -> None:
    assert (
        script("const v = this.environment.variables; v.y = typeof v.x['\\0']; next()", x={"\0": "5"})["y"] == "string"
    )


@pytest.mark.parametrize("none", ["''", "0", "false", "null", "undefined", "NaN"])
def test_an_error_that_is_none_completes(none: str) -> None:
    assert run(f"next({none})") == {}


def test_a_thousand_calls_within_calls_are_no_endless_recursion() -> None:
    assert (
        script("const sum = (n) => n && n + sum(n - 1); this.environment.variables.y = sum(1000); next()")["y"]
        == 500500
    )


def test_what_is_no_timer_is_not_cleared() -> None:
    assert run("for (const one of [{}, '1', NaN, 1n, null, undefined, Symbol('x')]) clearTimeout(one); next()") == {}


def test_a_timer_is_cleared_by_its_number_as_text_too() -> None:
    text = "const v = this.environment.variables; const t = setTimeout(() => { v.y = 1 }, 1); clearTimeout(`${t}`);"
    assert run(f"{text} setTimeout(next, 5)") == {}


def test_a_large_collection_may_be_changed_in_a_callback_that_does_not_look_at_it() -> None:
    text = "const xs = this.environment.variables.xs; setTimeout(() => { xs[0] = 'changed'; next() }, 1)"
    assert run(text, xs=[*range(6000)])["xs"][0] == "changed"


def test_an_async_function_that_throws_is_thought_of_when_nothing_is_left() -> None:
    error = error_of("(async () => { await null; JSON.parse('{'); next() })()")
    assert "an async function may have thrown" in str(error)


def test_a_field_has_the_name_of_its_msg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typesystem, "_definitions", dict(typesystem._table()))
    (type,) = messages.register("string class", "keyword_msgs/msg/Named")
    det = messages.create(type, {"class": "person"})
    assert value("environment.variables.det.class == 'person'", det=det) is True
