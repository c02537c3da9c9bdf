"""What a condition in ``${...}`` or ``=...`` comes to.

True, false, numbers (zero is false) and null (false) count as they are, a text if it says "true" or "false" (Jakarta
EL, section 1.23); nothing else is a condition.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.scripting.data import Evaluate, is_number

_SAID = {"true": True, "false": False, "": False}
_SHOWN = 60


def judged(evaluate: Evaluate) -> Evaluate:
    """The same as a condition: it gives true or false, or raises TypeError that shows the value."""

    def judge(variables: Mapping[str, Any]) -> bool:
        value = evaluate(variables)
        return value if value is True or value is False else _verdict(value)

    return judge


def _verdict(value: Any) -> bool:
    if isinstance(value, str):
        said = _SAID.get(value.strip().lower())
        if said is not None:
            return said
    elif value is None or is_number(value) or type(value).__name__ in ("bool", "bool_"):  # numpy's
        return bool(value)
    shown = repr(value)
    shown = shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
    raise TypeError(f"the condition gives {shown}: expected true or false")
