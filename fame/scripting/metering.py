"""What an expression may cost: its loops and functions count against the budget of a step (`fame.scripting.budget`).

An expression has no frame of its own that the budget could count by. So whoever evaluates one that has loops or calls
functions fills a meter, and these spend from it: for each pass and call, and for each element and character that a
function reads or makes. Outside of that nothing is counted. A pass costs as much as ten of Python's, since it takes
that much longer. The count is deterministic, as that of scripts is.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from typing import Any

from fame.engine.variables import BUILTINS
from fame.heartbeat import BUDGET, BudgetExceeded
from fame.scripting.budget import DEFAULT
from fame.scripting.data import Evaluate

PASS = 10
"""What a pass of a loop or the call of a function costs."""

_LETTERS = 4
"""So many characters cost as much as one element of a list."""


_ATOMS = frozenset({int, float, bool, type(None)})


class _Meter(threading.local):
    left: float = math.inf
    limit: int = 0


_METER = _Meter()


def spend(ticks: float = PASS) -> None:
    """Count. Raises BudgetExceeded."""
    left = _METER.left = _METER.left - ticks
    if left < 0:
        raise BudgetExceeded(f"an expression took more than {_METER.limit // PASS} loop passes and function calls")


def weight(value: Any) -> int:
    """What it costs to read or make a value."""
    if value.__class__ in _ATOMS:
        return 0
    if isinstance(value, (list, tuple)):
        return len(value)
    return len(value) // _LETTERS if isinstance(value, str) else 0


def metered(evaluate: Evaluate) -> Evaluate:
    """The same within the budget of the variables' interface."""

    def run(variables: Mapping[str, Any]) -> Any:
        names = variables.get(BUILTINS)
        budget = names.get(BUDGET) if isinstance(names, dict) else None
        _METER.limit = _METER.left = budget.limit if budget is not None else DEFAULT
        try:
            return evaluate(variables)
        finally:
            _METER.left = math.inf

    return run
