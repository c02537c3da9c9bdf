"""Scripts in Python: their scope, their lines, what is refused when they are compiled."""

import io
import subprocess
import sys
from functools import partial
from typing import Any

import pytest

from fame.bpmn.model import Expression
from fame.engine import BpmnError
from fame.errors import ModelError
from fame.scripting import compile_expression, compile_script, effects_of, error_line, error_text
from fame.scripting.interface import interface


def root(**variables: Any) -> dict[str, Any]:
    names = interface(robot=None, signal=lambda name, payload=None: None, log=lambda level, text: None)
    return variables | {"__builtins__": names}


def run(text: str, **variables: Any) -> dict[str, Any]:
    scope = root(**variables)
    assert compile_script(Expression(text))(scope) is None
    return scope


def test_the_variables_are_the_names_of_the_script() -> None:
    assert run("x = x + 1", x=1)["x"] == 2


def test_a_script_is_run_by_c_alone() -> None:
    script = compile_script(Expression("x = x + 1\nfor i in range(3): x += i"))
    assert isinstance(script, partial)
    assert script.func is eval


def test_functions_see_the_variables() -> None:
    assert run("def near(limit): return abs(x) < limit\nfound = [n for n in (1, 2) if near(n)]", x=1.5)["found"] == [2]


def test_an_indented_script_is_taken_as_it_is_drawn() -> None:
    assert run("\n      if x:\n        y = 1\n      z = 2\n   ", x=1)["z"] == 2
    assert run("x = 1\n        y = 2\n        if y:\n          z = 3\n      ")["z"] == 3
    assert run("if True:\n\tx = 1\n")["x"] == 1


def test_the_interface_is_in_scope_and_a_variable_of_its_name_wins() -> None:
    assert run("y = math.floor(2.5)")["y"] == 2
    assert run("y = robot + 1", robot=1)["y"] == 2


def test_builtins_of_one_instance_are_its_own() -> None:
    one, other = root(), root()
    compile_script(Expression("__builtins__['leak'] = 1"))(one)
    with pytest.raises(NameError):
        compile_script(Expression("leak"))(other)


def test_what_a_script_prints_is_logged() -> None:
    lines: list[tuple[str, str]] = []
    names = interface(robot=None, signal=print, log=lambda level, text: lines.append((level, text)))
    text, file = "print('at', x, sep='=', end='!')\nlog('done', 2)\nlog.warning('low')\n", io.StringIO()
    text += "print('a', 'b', sep='-', end='.', file=file)\nprint(3, file=file)\nprint()"
    compile_script(Expression(text))({"x": 1, "file": file, "__builtins__": names})
    assert lines == [("info", "at=1!"), ("info", "done 2"), ("warning", "low"), ("info", "")]
    assert file.getvalue() == "a-b.3\n"


def test_the_builtins_of_a_terminal_are_not_there() -> None:
    with pytest.raises(NameError):
        run("input()")


def test_a_script_throws_a_bpmn_error() -> None:
    with pytest.raises(BpmnError) as caught:
        run("raise BpmnError('unreachable', 'no way')")
    assert (caught.value.code, caught.value.message) == ("unreachable", "no way")


def test_an_error_carries_the_line_of_the_file() -> None:
    script = compile_script(Expression("\nx = 1\ndef f():\n    return 1 / 0\nf()", line=40), file="m.bpmn")
    with pytest.raises(ZeroDivisionError) as caught:
        script(root())
    assert error_line(caught.value, "m.bpmn") == 43
    assert error_text(caught.value) == "ZeroDivisionError: division by zero"
    condition = compile_expression(Expression("x +\n 1 / 0", line=9), file="m.bpmn")
    with pytest.raises(ZeroDivisionError) as caught:
        condition(root(x=1))
    assert error_line(caught.value, "m.bpmn") == 10


def test_an_error_of_another_file_has_no_line_here() -> None:
    with pytest.raises(ZeroDivisionError) as caught:
        compile_script(Expression("1 / 0"), file="other.bpmn")(root())
    assert error_line(caught.value, "m.bpmn") == 0


def test_an_error_inside_a_library_has_the_line_of_the_script() -> None:
    script = compile_script(Expression("import json\n\njson.loads('{')", line=5), file="m.bpmn")
    with pytest.raises(ValueError) as caught:
        script(root())
    assert error_line(caught.value, "m.bpmn") == 7


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [
        ("x = 1\ny = = 2", 11, "not valid Python: invalid syntax: `y = = 2`"),
        ("x = (1", 10, r"'\(' was never closed: `x = \(1`"),
        ("x = 1\nreturn x", 11, "'return' outside function"),
        ("if x:\ny = 1", 11, "expected an indented block"),
        ("x = 1\n\n\nsleep(2)", 13, r"sleep\(...\) does nothing unless it is awaited: await sleep\(...\)"),
        ("if x:\n    receive('odom')", 11, "await receive"),
        ("def f():\n    until(lambda: x)", 11, "await until"),
        ("robot.call('a', 'b')", 10, r"await robot.call"),
        ("robot.act('a', 'b')", 10, r"await robot.act"),
        ("x = 1\nsleep(1) if x else None", 11, "await sleep"),
        ("x and (y, sleep(1))", 10, "await sleep"),
    ],
)
def test_a_wrong_script_is_refused_with_the_line_of_the_file(text: str, line: int, complaint: str) -> None:
    with pytest.raises(ModelError, match=complaint) as caught:
        compile_script(Expression(text, line=10), file="m.bpmn", element="Task_1")
    assert (caught.value.file, caught.value.line, caught.value.element) == ("m.bpmn", line, "Task_1")


def test_a_request_that_is_kept_or_a_function_of_that_name_is_no_mistake() -> None:
    run("later = sleep(2)")
    run("def sleep(seconds): ...\nsleep(2)")
    run("from math import floor as sleep\nsleep(2)")
    run("def f(sleep): sleep(2)\nf(abs)")


def test_a_tab_in_a_text_stays_one_and_in_an_indentation_is_eight_columns() -> None:
    assert run("x = 'a\tb'; y = '''\n\tc'''", x=0)["x"] == "a\tb"
    assert run("if True:\n\tx = 'a\tb'\n        y = 2")["x"] == "a\tb"


@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("sleep('2')", TypeError),
        ("sleep(-1)", ValueError),
        ("sleep()", TypeError),
        ("sleep(float('nan'))", ValueError),
        ("receive(3)", TypeError),
        ("receive('a', timeout=-1)", ValueError),
        ("until(x > 3)", TypeError),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_where_it_is_made(call: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        run(f"r = {call}", x=1)


def test_other_languages_are_refused_by_name() -> None:
    with pytest.raises(ModelError, match="cannot be written in feel; accepted are python and javascript"):
        compile_script(Expression("x", "feel"))


@pytest.mark.parametrize(
    ("text", "reads", "writes"),
    [
        ("x = y + 1", {"y"}, {"x"}),
        ("x += 1", {"x"}, {"x"}),
        ("import os\nz = math.floor(a)\nrobot.publish('t', 'm')", {"a"}, {"z"}),
        ("def f(p):\n  global g\n  q = p\n  g = h\nf(1)", {"h"}, {"g"}),
        ("m = await receive('odom')\ns = [k * i for k in m.xs]", {"m", "i"}, {"m", "s"}),
        ("robot = 1", set(), {"robot"}),
        ("for i in xs: print(i)", {"i", "xs"}, {"i"}),
        ("async for m in receive(t): x = [i async for i in m]", {"t", "m"}, {"m", "x"}),
        ("async with a as b:\n  def f(c=(await b).d): return c", {"a", "b"}, {"b"}),
        ("x: int = 1\nif x: y: float = z", {"x", "z"}, {"x", "y"}),
    ],
)
def test_the_names_that_a_script_reads_and_writes_are_known(text: str, reads: set[str], writes: set[str]) -> None:
    found = effects_of(Expression(text), script=True)
    assert (found.reads, found.sets) == (reads, writes)


def test_a_script_that_parses_and_does_not_compile_is_an_error_of_the_model() -> None:
    with pytest.raises(ModelError, match=r"line 8: .*assigned to before global declaration: `global x`"):
        compile_script(Expression("x = 1\nglobal x", line=7))
    assert not effects_of(Expression("x = 1\nglobal x", line=7), script=True).sets


@pytest.mark.parametrize(
    ("text", "language", "reads"),
    [
        ("x > limit and len(xs)", "python", {"x", "limit", "xs"}),
        ("${x > 3 && y.z}", "juel", {"x", "y"}),
        ("for i in xs return i + k", "feel", {"xs", "k"}),
        ("{x: ${a}, y: 'n ${b.c}'}", "payload", {"a", "b"}),
        ("=a + 1", "value", {"a"}),
        ("PT${n}S", "template", {"n"}),
    ],
)
def test_the_names_that_an_expression_reads_are_known(text: str, language: Any, reads: set[str]) -> None:
    found = effects_of(Expression(text, language))
    assert (found.reads, found.sets) == (reads, set())


def test_importing_it_loads_nothing_heavy() -> None:
    heavy = ("lxml", "numpy", "yaml", "asyncio", "rosbags")
    code = f"import sys, fame.scripting; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_same_script_at_two_places_names_the_line_of_each() -> None:
    """It is compiled once, and raises where it stands."""
    for line in (3, 7, 3):
        run = compile_script(Expression("x = 1\nclass C:\n    y = x / 0", "python", line), file="two.bpmn", element="t")
        with pytest.raises(ZeroDivisionError) as caught:
            run({})
        assert error_line(caught.value, "two.bpmn") == line + 2
