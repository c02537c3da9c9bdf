"""Unknown conditions whose outcome is remembered: asked again with unchanged variables, they have the same one.

Only comparisons of one variable with a constant are remembered, which nothing but a change of the variable can change,
and only if scripts that take no time are all that sets it: no message, person, behaviour or data object.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping

from fame.bpmn import model
from fame.check.explore.abstraction import Step, used_besides_texts
from fame.check.explore.purity import waits
from fame.check.explore.script_effects import may_change, script_writes
from fame.check.expressions import expressions_in

_BEHIND_ITS_BACK = re.compile(
    r"\b(global|nonlocal|exec|eval|globals|locals|vars|setattr|class|del)\b|__|:=|\bimport\s*\*"
)
"""How a text may set variables that are not seen to be set, or compare as it likes."""


def remembered(bodies: Iterable[model.Body], steps: Mapping[str, Step]) -> dict[str, str]:
    """Condition -> the variable that it reads, of the conditions of a pool that are remembered; see `key_of`."""
    found, others = dict[str, str](), {name for step in steps.values() for name in (*step.writes, *step.changes)}
    for body in bodies:
        others |= {name for item in body.data_objects for name in item.names}
        for node in body.nodes:
            if node.tag == "userTask":  # a person may set any variable
                return {}
            others |= {*used_besides_texts(node, body)}
        for use in expressions_in(body):
            script = use.use == "script"
            if _BEHIND_ITS_BACK.search(use.expression.text) or (script and use.expression.language != "python"):
                return {}
            if script and waits(use.expression):  # it sets them at any time
                others |= script_writes(use.expression) | may_change(use.expression)
            elif use.use == "condition" and (name := _compared(use.expression)):
                found[key_of(use.expression)] = name
    return {key: name for key, name in found.items() if name not in others}


def key_of(condition: model.Expression) -> str:
    """The name under which the outcome of a condition is kept among the variables: no other one is called so."""
    return f"?{condition.language} {' '.join(condition.text.split())}"


def _compared(condition: model.Expression) -> str:
    """The only variable of a condition that compares it with a constant, which no change in place makes another."""
    try:
        tree = ast.parse(condition.text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError):
        return ""
    match tree:
        case ast.Compare(left=ast.Name(id=name), comparators=[ast.Constant()]):
            return name
        case ast.Compare(left=ast.Constant(), comparators=[ast.Name(id=name)]):
            return name
    return ""
