"""Steps that do not end."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest

from fame.bpmn.model import Expression
from fame.engine.data import Variables
from fame.scripting import BudgetExceeded, compile_expression, compile_script, error_line, heartbeat
from fame.scripting.interface import interface

ROOT = Path(__file__).parent.parent


def root(budget: int = 10_000, **variables: Any) -> dict[str, Any]:
    return variables | {"__builtins__": interface(robot=None, signal=print, log=print, budget=budget)}


ENDLESS = {
    "while": "while True: pass",
    "for": "import itertools\nfor i in itertools.count(): pass",
    "continue": "while True: continue",
    "nested": "while True:\n  for i in (1, 2): pass",
    "bare except": "while True:\n  try:\n    while True: pass\n  except: continue",
    "finally": "while True:\n  try:\n    while True: pass\n  finally: continue",
    "function": "def f():\n  while True: pass\nf()",
    "recursion": "def f(n):\n  'Says so.'\n  try: f(n + 1)\n  except RecursionError: pass\n  f(n + 1)\nf(0)",
    "lambda": "f = lambda g: g(g)\nwhile f(lambda g: 1): pass",
    "comprehension": "import itertools\n[i for i in itertools.count()]",
    "generator": "import itertools\nlist(i for i in itertools.count() if False)",
    "any": "import itertools\nany(i < 0 for i in itertools.count())",
    "map": "import itertools\nlist(map(lambda i: i, itertools.count()))",
    "sort key": "import itertools\nmax(itertools.count(), key=lambda i: -i)",
    "except after": "try:\n  while True: pass\nexcept: pass\nwhile True: pass",
    "class": "class Loop:\n  while True: pass",
    "operator": "class N:\n  def __add__(self, n): return self + n\nwhile True:\n  try: N() + 1\n  except: pass",
}


@pytest.mark.parametrize("text", ENDLESS.values(), ids=ENDLESS)
def test_a_step_without_end_is_ended(text: str) -> None:
    with pytest.raises(BudgetExceeded, match="more than 10000 loop passes and function calls"):
        compile_script(Expression(text))(root())


@pytest.mark.parametrize("text", ["while True: pass", "[1 for _ in iter(int, 1)]"])
def test_it_is_ended_in_an_inner_scope_too(text: str) -> None:
    with pytest.raises(BudgetExceeded):
        compile_script(Expression(text))(Variables(root(), {"x": 1}))


def test_a_condition_without_end_is_ended() -> None:
    with pytest.raises(BudgetExceeded):
        compile_expression(Expression("all(True for _ in iter(int, 1))"))(root())


def test_the_line_of_the_loop_is_named() -> None:
    script = compile_script(Expression("x = 1\n\nwhile True:\n    pass", line=10), file="m.bpmn")
    with pytest.raises(BudgetExceeded) as caught:
        script(root())
    assert error_line(caught.value, "m.bpmn") == 12


def test_each_step_has_the_whole_budget() -> None:
    variables = root(1000, x=0)
    script = compile_script(Expression("for i in range(900): x += 1"))
    for _ in range(10):
        script(variables)
    assert variables["x"] == 9000


def test_a_function_called_by_many_steps_spends_the_budget_of_each() -> None:
    variables = root(1000, x=0)
    compile_script(Expression("def more(n): return n + 1"))(variables)
    step, condition = compile_script(Expression("x = more(x)")), compile_expression(Expression("more(x) > 0"))
    for _ in range(5000):
        step(variables)
        assert condition(variables)
    assert variables["x"] == 5000


def test_after_an_endless_step_the_next_one_runs() -> None:
    variables = root(1000)
    with pytest.raises(BudgetExceeded):
        compile_script(Expression("while True: pass"))(variables)
    compile_script(Expression("for i in range(900): pass"))(variables)
    assert variables["i"] == 899


def test_the_same_script_is_stopped_at_the_same_pass() -> None:
    def passes() -> int:
        variables = root(12_345, x=0)
        with pytest.raises(BudgetExceeded):
            compile_script(Expression("while True: x += 1"))(variables)
        return int(variables["x"])

    assert passes() == passes()
    assert 12_000 < passes() < 13_000


def test_counting_changes_no_result() -> None:
    variables = root()
    text = """
def documented():
    "What it does."
    return [a + b for a in (1, 2) for b in (10, 20) if b > 10]
r = documented()
doc = documented.__doc__
odd = lambda n: 0 if n == 0 else n % 2
values = [odd(n) for n in range(3)], {n for n in (1, 1)}, {n: -n for n in (1,)}, sum(n for n in (1, 2))
n = 5
while n > 0:
    n -= 1
    if n == 2: break
else:
    n = 100
for n in (): pass
else: ended = True
"""
    compile_script(Expression(text))(variables)
    assert variables["r"] == [21, 22]
    assert variables["doc"] == "What it does."
    assert variables["values"] == ([0, 1, 0], {1}, {1: -1}, 3)
    assert (variables["n"], variables["ended"]) == (2, True)


@pytest.mark.parametrize(
    "text",
    ["import time\ntime.sleep(60)", "while True: pass", "9**9**9", "import re\nre.match('(a|aa)+$', 'a' * 60 + 'b')"],
    ids=["sleep", "loop", "power", "regular expression"],
)
def test_the_heartbeat_ends_what_the_budget_does_not_see(text: str) -> None:
    with pytest.raises(BudgetExceeded, match=r"more than 0\.05 s"), heartbeat(0.05):
        compile_script(Expression(text))(root(10**12))


def test_the_heartbeat_leaves_short_steps_and_other_code_alone() -> None:
    variables, script = root(10**12, x=0), compile_script(Expression("for i in range(100): x += 1"))
    end = time.monotonic() + 0.1
    with heartbeat(0.02):
        while time.monotonic() < end:
            script(variables)
    assert variables["x"] > 0


def process(code: str) -> subprocess.CompletedProcess[str]:
    """A Python process that runs a script between `with heartbeat` and the end."""
    command = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.processes
def test_a_call_that_nothing_interrupts_ends_the_process_and_says_where() -> None:
    done = process("""
        from fame.scripting.budget import heartbeat
        with heartbeat(0.1, last_resort=0.5):
            exec(compile("import itertools\\nsum(itertools.count())", "REX.bpmn", "exec"))
    """)
    assert done.returncode == -signal.SIGVTALRM
    assert 'File "REX.bpmn", line 2' in done.stderr


@pytest.mark.processes
def test_one_that_computes_and_hears_its_beats_lives_on() -> None:
    done = process("""
        import time
        from fame.scripting.budget import heartbeat
        with heartbeat(0.1, last_resort=0.5):
            while time.process_time() < 1: pass
    """)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.processes
def test_a_thread_that_a_script_left_keeps_no_process_from_ending() -> None:
    done = process("""
        import sys, threading
        from fame import __main__, cli
        def command():
            threading.Thread(target=threading.Event().wait, name="of a script").start()
            return 3
        cli.main = command
        sys.exit(__main__.main())
    """)
    assert done.returncode == 3
    assert "of a script" in done.stderr


@pytest.mark.processes
def test_workers_of_a_library_are_ended_by_the_library() -> None:
    pytest.importorskip("joblib")
    done = process("""
        import sys
        from joblib import Parallel, delayed
        from fame import __main__, cli
        def command():
            return sum(Parallel(n_jobs=2)(delayed(abs)(number) for number in (-1, -2)))
        cli.main = command
        sys.exit(__main__.main())
    """)  # workers that live on hold stdout open, so that this does not return
    assert (done.returncode, done.stderr) == (3, "")
