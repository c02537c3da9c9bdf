"""A limit for each step of a script or expression: every loop iteration and function call counts.

`count_steps` rewrites the syntax tree of a script: each loop body, function, lambda and comprehension begins with
``__tick__() or __budget__.spend()``. The tick is an iterator of C that is exhausted after a part of the budget; only
then `Budget.spend` checks whether the same step is still running. So a script without loops and functions costs nothing
extra, nor does the beginning of a step: a step is identified by the outermost frame of its script, which is new for
each call, and by `Budget.refill` for a script that was suspended.

The count is deterministic: the same script is stopped at the same pass on every machine. Once a step has spent its
budget, each further tick of it raises again, so a bare ``except:`` inside a loop cannot go on forever. Loops inside C
(``sum(itertools.count())``) and those of imported Python modules do not count.

There `heartbeat` helps: it interrupts the main thread periodically, and raises `BudgetExceeded` in a script that is
still in the same step. Python handles signals between two bytecode instructions, and in long calls that check for them
(powers of large integers, regular expressions, `time.sleep`). A call that never checks ends with its process only, by
the `last_resort`.
"""

from __future__ import annotations

import ast
import faulthandler
import math
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import repeat
from types import FrameType
from typing import Any

from fame.scripting.data import Evaluate

BUDGET = "__budget__"
"""The name of the budget in a script's builtins."""


class BudgetExceeded(BaseException):
    """A step did not end. Not an Exception: `except Exception` must not swallow it."""


def script_frame(frame: FrameType | None, budget: object = None) -> FrameType | None:
    """Return the outermost frame of a script (of the interface with that budget) that called `frame`, or None."""
    found = None
    while frame is not None:
        owner = frame.f_builtins.get(BUDGET)
        if owner is not None and (budget is None or owner is budget):
            found = frame
        frame = frame.f_back
    return found


@contextmanager
def heartbeat(seconds: float = 5.0, *, last_resort: float = 0.0) -> Iterator[None]:
    """Interrupt a step of a script that is running at three beats in a row, which are `seconds` / 2 apart.

    Works in the main thread only, elsewhere it does nothing. Raises BudgetExceeded inside the script, never in the
    engine. With `last_resort` (s of processor time of all threads, so that a stopped process lives on) a process that
    computes that long while its main thread handles no beat is killed by SIGVTALRM, with a traceback on stderr.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen: tuple[FrameType, int] | None = None
    times = 0
    arm = partial(signal.setitimer, signal.ITIMER_VIRTUAL)

    def beat(_number: int, frame: FrameType | None) -> None:
        nonlocal seen, times
        arm(last_resort)
        script = script_frame(frame)
        now = (script, script.f_builtins[BUDGET].steps) if script is not None else None
        same = now is not None and seen is not None and now[0] is seen[0] and now[1] == seen[1]
        seen, times = now, times + 1 if same else 1
        if times >= 3:
            raise BudgetExceeded(f"one step of the script took more than {seconds:g} s")

    former = signal.signal(signal.SIGALRM, beat)
    if last_resort and sys.__stderr__ is not None:
        faulthandler.register(signal.SIGVTALRM, file=sys.__stderr__, chain=True)
    arm(last_resort)
    signal.setitimer(signal.ITIMER_REAL, seconds / 2, seconds / 2)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        arm(0)
        faulthandler.unregister(signal.SIGVTALRM)
        signal.signal(signal.SIGALRM, former)


# ---- scripts in Python -----------------------------------------------------------------------------------------------


TICK = "__tick__"
DEFAULT = 20_000_000
"""Loop passes and function entries in one step: about 5 s of a loop body of a few statements on a present-day
machine.
"""

_PARTS = 20


class Budget:
    """The budget of one step for the scripts of one interface. `names` is the interface; `limit` counts ticks.

    It keeps no reference to the interface, which is freed with its variables then, without a search for cycles.
    """

    __slots__ = ("_frame", "_part", "_spent", "limit", "steps")

    def __init__(self, names: dict[str, Any], limit: int = DEFAULT) -> None:
        self.limit: int = limit
        self.steps: int = 0
        self._part = -(-limit // _PARTS)
        names[BUDGET] = self
        self.refill(names)

    def refill(self, names: dict[str, Any]) -> None:
        """Start a new step with a full budget."""
        self.steps += 1
        self._frame: FrameType | None = None
        self._spent = 0
        self._grant(names)

    def drain(self, names: dict[str, Any]) -> None:
        """Make every tick raise until `refill`."""
        self._spent = sys.maxsize
        names[TICK] = partial(next, iter(()), False)

    def spend(self) -> bool:
        """Account for a used part of the budget and grant the next. Raises BudgetExceeded after the last."""
        caller = sys._getframe(1)
        frame = script_frame(caller, self)
        if frame is not self._frame and self._spent < sys.maxsize:
            self._frame, self._spent = frame, 0
        if self._spent < sys.maxsize:
            self._spent += self._part
        if self._spent >= self.limit:
            raise BudgetExceeded(f"one step of the script took more than {self.limit} loop passes and function calls")
        self._grant(caller.f_builtins)
        return True

    def _grant(self, names: dict[str, Any]) -> None:
        names[TICK] = partial(next, repeat(True, self._part), False)


def count_steps(tree: ast.AST) -> ast.AST:
    """Insert a tick into each loop, function and comprehension. Line numbers do not change."""
    counted: ast.AST = _Ticks().visit(tree)
    return ast.fix_missing_locations(counted)


class _Ticks(ast.NodeTransformer):
    def _in_body(self, node: Any) -> Any:
        self.generic_visit(node)
        documented = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and ast.get_docstring(node) is not None
        tick = _tick(node)
        node.body.insert(1 if documented else 0, ast.copy_location(ast.Expr(tick), tick))
        return node

    visit_For = visit_AsyncFor = visit_While = visit_FunctionDef = visit_AsyncFunctionDef = _in_body

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        self.generic_visit(node)
        node.body = ast.copy_location(ast.BoolOp(ast.And(), [_tick(node), node.body]), node)
        return node

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        self.generic_visit(node)
        node.ifs.insert(0, _tick(node.target))
        return node


def _tick(place: ast.AST) -> ast.expr:
    tick = ast.parse(f"{TICK}() or {BUDGET}.spend()", mode="eval").body
    for node in ast.walk(tick):
        if isinstance(node, ast.expr):  # all on one line, else tracebacks name the last one of the loop
            ast.copy_location(node, place)
            node.end_lineno, node.end_col_offset = node.lineno, node.col_offset
    return tick


# ---- expressions -----------------------------------------------------------------------------------------------------


PASS = 10
"""The cost of a loop iteration or function call."""

_LETTERS = 4
"""This number of characters costs as much as one element of a list."""


_ATOMS = frozenset({int, float, bool, type(None)})


class _Meter(threading.local):
    left: float = math.inf
    limit: int = 0


_METER = _Meter()


def spend(ticks: float = PASS) -> None:
    """Spend from the budget. Raises BudgetExceeded."""
    left = _METER.left = _METER.left - ticks
    if left < 0:
        raise BudgetExceeded(f"an expression took more than {_METER.limit // PASS} loop passes and function calls")


def weight(value: Any) -> int:
    """Return the cost of reading or making a value."""
    if value.__class__ in _ATOMS:
        return 0
    if isinstance(value, (list, tuple)):
        return len(value)
    return len(value) // _LETTERS if isinstance(value, str) else 0


def metered(evaluate: Evaluate) -> Evaluate:
    """Evaluate within the budget of the script interface of the variables."""

    def run(variables: Mapping[str, Any]) -> Any:
        names = variables.get("__builtins__")
        budget = names.get(BUDGET) if isinstance(names, dict) else None
        _METER.limit = _METER.left = budget.limit if budget is not None else DEFAULT
        try:
            return evaluate(variables)
        finally:
            _METER.left = math.inf

    return run
