"""How many scripts and expressions run in a second: one JSON line per case, by the wall clock and by processor time.

The time of the loop around the call is included; the best of several rounds counts, since noise only ever adds. On a
machine that others use, processor time is what tells. `goal` is what a second has to hold. Run as
``python benchmarks/scripting.py``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import repeat
from typing import Any

from fame.bpmn.model import Expression, Language
from fame.clock import Scheduler
from fame.engine.data import Variables
from fame.middleware.local import LocalMiddleware
from fame.scripting import Runner, compile_expression, compile_script
from fame.scripting.interface import interface

ROUNDS = 7
SECONDS = 0.15
JAVASCRIPT_STEPS, EXPRESSIONS = 100_000, 300_000
FOUR = ("python", "juel", "feel", "javascript")
"""The languages of a condition."""

SCRIPTS = {
    "x = x + 1": "x = x + 1",
    "five statements": "a = x + 1\nb = a * 2\nc = [a, b]\nd = c[0]\nx = d - 1",
    "call of a function": "x = more(x)",
    "loop of 100 passes": "for i in range(100): x = i",
}
JAVASCRIPT = {
    "x = x + 1": "this.environment.variables.x = this.environment.variables.x + 1; next();",
    "reads an object": "const v = this.environment.variables; if (v.y.z === 2) v.x = v.x + 1; next();",
    "publishes nothing, says nothing": "next();",
    "loop of 100 passes": "for (let i = 0; i < 100; i++) this.environment.variables.x = i; next();",
}
CONDITIONS: dict[str, tuple[Language, str]] = {
    "python": ("python", "x > 3 and y['z'] == 2"),
    "juel": ("juel", "${x > 3 and y.z == 2}"),
    "feel": ("feel", "x > 3 and y.z = 2"),
    "javascript": ("javascript", "this.environment.variables.x > 3 && this.environment.variables.y.z == 2"),
    "juel name": ("juel", "${x}"),
    "payload": ("payload", "{x: ${x}, y: ${y.z}, z: 0}"),
    "template": ("template", "PT${x}S"),
}


def scope() -> dict[str, Any]:
    """New variables of a process."""
    names = interface(robot=None, signal=print, log=lambda level, text: None)
    variables: dict[str, Any] = {"x": 5, "y": {"z": 2}, "__builtins__": names}
    compile_script(Expression("def more(n): return n + 1"))(variables)
    return variables


def per_second(run: Callable[[dict[str, Any]], Any], variables: dict[str, Any]) -> tuple[float, float]:
    """Calls per second of the wall clock, and of processor time."""
    count = 100
    wall = processor = 0.0
    for _ in range(ROUNDS):
        while True:
            began, cpu = time.perf_counter(), time.process_time()
            for _ in repeat(None, count):
                run(variables)
            took, used = time.perf_counter() - began, time.process_time() - cpu
            if took > SECONDS:
                break
            count *= 2
        wall, processor = max(wall, count / took), max(processor, count / used)
    return wall, processor


def awaits_per_second(count: int = 50_000) -> float:
    """Awaits per second of a script that sleeps again and again, with the scheduler's work."""
    scheduler = Scheduler()
    node = LocalMiddleware(scheduler).node("engine", "REX")
    runner = Runner(scheduler, node, lambda key, error: None)
    runner.start(1, compile_script(Expression(f"for i in range({count}): await sleep(0.001)"))(scope()))
    began = time.perf_counter()
    scheduler.run()
    return count / (time.perf_counter() - began)


def overhead_of_counting() -> float:
    """What the budget costs, in ns per pass of a loop."""
    variables, passes = scope(), 1000
    counted = compile_script(Expression(f"for i in range({passes}): x = i"))
    bare = partial(eval, compile(f"for i in range({passes}): x = i", "bare", "exec"))
    return (1 / per_second(counted, variables)[1] - 1 / per_second(bare, variables)[1]) / passes * 1e9


def case(name: str, run: Callable[..., Any], variables: dict[str, Any], goal: int | None = None) -> dict[str, Any]:
    """One line."""
    wall, processor = per_second(run, variables)
    said = {"case": name, "per_second": wall, "per_cpu_second": processor}
    return said if goal is None else {**said, "goal": goal, "met": processor >= goal}


def lines() -> Iterator[dict[str, Any]]:
    """The results, one at a time."""
    for name, text in SCRIPTS.items():
        yield case(f"script, {name}", compile_script(Expression(text)), scope())
    for name, text in JAVASCRIPT.items():
        goal = JAVASCRIPT_STEPS if "loop" not in name else None
        yield case(f"javascript, {name}", compile_script(Expression(text, "javascript")), scope(), goal)
    inner = Variables(scope(), {"i": 1})
    yield case("script, inner scope", compile_script(Expression("x = x + 1")), inner)
    for name, (language, text) in CONDITIONS.items():
        goal = JAVASCRIPT_STEPS if language == "javascript" else EXPRESSIONS if name in FOUR else None
        yield case(f"expression, {name}", compile_expression(Expression(text, language)), scope(), goal)
    yield {"case": "awaits", "per_second": max(awaits_per_second() for _ in range(3))}
    yield {"case": "budget", "ns_per_pass": overhead_of_counting()}


def main() -> None:
    for line in lines():
        print(json.dumps({key: round(value) if isinstance(value, float) else value for key, value in line.items()}))


if __name__ == "__main__":
    main()
