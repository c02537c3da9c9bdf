"""Variables of inner scopes, as scripts see them."""

import math
from typing import Any

from fame.bpmn.model import Expression
from fame.engine.data import Variables, plain
from fame.scripting import compile_script
from fame.scripting.interface import interface


def root(**variables: Any) -> dict[str, Any]:
    return variables | {"__builtins__": interface(robot=None, signal=print, log=print)}


def run(text: str, variables: dict[str, Any]) -> Any:
    return compile_script(Expression(text))(variables)


def test_an_existing_outer_name_is_written_outside_and_a_new_one_inside() -> None:
    outer = root(x=1)
    inner = Variables(outer)
    run("x = x + 1\ny = x * 10", inner)
    assert plain(outer) == {"x": 2}
    assert plain(inner) == {"x": 2, "y": 20}


def test_several_variables_are_each_set_where_they_belong() -> None:
    outer = root(x=1)
    inner = Variables(outer, {"item": 5})
    inner.update({"x": 2, "item": 6, "new": 7})
    assert (outer["x"], "new" in outer) == (2, False)
    assert {name: inner[name] for name in ("x", "item", "new")} == {"x": 2, "item": 6, "new": 7}


def test_an_own_name_hides_the_outer_one() -> None:
    outer = root(item=1)
    inner = Variables(outer, {"item": 5})
    run("item += 1", inner)
    assert (outer["item"], inner["item"]) == (1, 6)


def test_three_levels_write_where_the_name_is() -> None:
    outer = root(a=1)
    middle = Variables(outer, {"b": 2})
    inner = Variables(middle, {"c": 3})
    run("a = b = c = 9\nd = 9", inner)
    assert (plain(outer), plain(middle)) == ({"a": 9}, {"a": 9, "b": 9})
    assert plain(inner) == {"a": 9, "b": 9, "c": 9, "d": 9}


def test_functions_lambdas_classes_and_comprehensions_see_all_levels() -> None:
    inner = Variables(root(x=1), {"i": 5})
    run(
        """
n = 7
f = lambda: (x, n, i)
a = f()
b = [x + i + k for k in range(2)]
c = {k: n for k in (1, 2)}
def g(): return x + math.floor(1.5)
d = g()
class C:
    seen = n
    def method(self): return x + i
e = (C.seen, C().method())
g2 = list(x for _ in (1,))
""",
        inner,
    )
    expected = {"a": (1, 7, 5), "b": [6, 7], "c": {1: 7, 2: 7}, "d": 2, "e": (7, 6), "g2": [1], "n": 7}
    assert plain(inner) == {"x": 1, "i": 5} | expected


def test_a_global_statement_in_a_function_writes_where_the_name_is() -> None:
    outer = root(x=1)
    inner = Variables(outer)
    run("def f():\n  global x, y\n  x = x + 1\n  y = 5\n  return x\nz = [(w := f()) for _ in (1, 2)]", inner)
    assert plain(outer) == {"x": 3}
    assert plain(inner) == {"x": 3, "y": 5, "z": [2, 3], "w": 3}


def test_a_name_that_appears_outside_later_stays_the_scopes_own() -> None:
    outer = root()
    inner = Variables(outer)
    run("x = 1", inner)
    outer["x"] = 100
    run("def f():\n  global x\n  x = x + 1\nf()", inner)
    assert (outer["x"], inner["x"]) == (100, 2)


def test_deleting_a_name_deletes_it_where_it_is() -> None:
    outer = root(x=1)
    inner = Variables(outer, {"y": 1})
    run("del x, y", inner)
    assert (plain(outer), plain(inner)) == ({}, {})


def test_looking_up_sees_through_and_iterating_does_not() -> None:
    inner = Variables({"x": 1}, {"y": 2})
    assert ("x" in inner, "z" in inner, inner.get("x"), inner.get("z", 0), list(inner)) == (True, False, 1, 0, ["y"])


def test_code_is_never_shown() -> None:
    variables = root(x=1, names=["a"])
    run("import math\nfrom os import path\ndef f(): ...\nclass C: ...\ng = f\nh = lambda: 1\ny: int = 2", variables)
    assert plain(variables) == {"x": 1, "names": ["a"], "y": 2}


def test_code_inside_hides_data_outside() -> None:
    assert plain(Variables({"x": 1, "y": 2}, {"x": math.floor})) == {"y": 2}
