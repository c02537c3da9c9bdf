"""A limit for each step of a script or expression: every loop iteration and function call counts.

`count_steps` rewrites the syntax tree of a script: each loop body, function, lambda and comprehension begins with
``__tick__() or __budget__.spend()``. The tick is an iterator of C that runs dry after a part of the budget; only then
`Budget.spend` looks whether it is still the same step that is at work. So a script without loops and functions pays
nothing at all, and no step pays for its beginning: a step is known by the outermost frame of its script, which is a new
one for each call, and by `Budget.refill` for a script that was suspended.

The count is deterministic: the same script is stopped at the same pass on every machine. Once a step has spent its
budget, each further tick of it raises again, so a bare ``except:`` inside a loop cannot go on forever. What loops
inside C (``sum(itertools.count())``) does not count; nor do the loops of imported Python modules, which
`fame.heartbeat` ends.
"""

from __future__ import annotations

import ast
import math
import sys
import threading
from collections.abc import Mapping
from functools import partial
from itertools import repeat
from types import FrameType
from typing import Any

from fame.engine.data import BUILTINS
from fame.heartbeat import BUDGET, BudgetExceeded, script_frame
from fame.scripting.data import Evaluate

# ---- scripts in Python -----------------------------------------------------------------------------------------------


TICK = "__tick__"
DEFAULT = 20_000_000
"""Loop passes and function entries in one step: about 5 s of a loop body of a few statements on a present-day
machine.
"""

_PARTS = 20


class Budget:
    """The budget of one step for the scripts of one interface. `names` is the interface; `limit` counts ticks."""

    __slots__ = ("_frame", "_names", "_part", "_spent", "limit", "steps")

    limit: int
    steps: int

    def __init__(self, names: dict[str, Any], limit: int = DEFAULT) -> None:
        self._names = names
        self.limit: int = limit
        self.steps: int = 0
        self._part = -(-limit // _PARTS)
        names[BUDGET] = self
        self.refill()

    def refill(self) -> None:
        """Start a new step with a full budget."""
        self.steps += 1
        self._frame: FrameType | None = None
        self._spent = 0
        self._grant()

    def drain(self) -> None:
        """Make every tick raise until `refill`."""
        self._spent = sys.maxsize
        self._names[TICK] = partial(next, iter(()), False)

    def spend(self) -> bool:
        """Account for a used part of the budget and grant the next. Raises BudgetExceeded after the last."""
        frame = script_frame(sys._getframe(1), self)
        if frame is not self._frame and self._spent < sys.maxsize:
            self._frame, self._spent = frame, 0
        if self._spent < sys.maxsize:
            self._spent += self._part
        if self._spent >= self.limit:
            raise BudgetExceeded(f"one step of the script took more than {self.limit} loop passes and function calls")
        self._grant()
        return True

    def _grant(self) -> None:
        self._names[TICK] = partial(next, repeat(True, self._part), False)


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
    """The cost of reading or making a value."""
    if value.__class__ in _ATOMS:
        return 0
    if isinstance(value, (list, tuple)):
        return len(value)
    return len(value) // _LETTERS if isinstance(value, str) else 0


def metered(evaluate: Evaluate) -> Evaluate:
    """Evaluate within the budget of the script interface of the variables."""

    def run(variables: Mapping[str, Any]) -> Any:
        names = variables.get(BUILTINS)
        budget = names.get(BUDGET) if isinstance(names, dict) else None
        _METER.limit = _METER.left = budget.limit if budget is not None else DEFAULT
        try:
            return evaluate(variables)
        finally:
            _METER.left = math.inf

    return run
