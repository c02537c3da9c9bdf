"""Unknown conditions whose outcome is remembered: asked again with unchanged variables, they have the same one.

An outcome is kept among the variables of its instance, as the decisions that led to it, and forgotten as soon as a
variable that the condition reads is set: by a script, a message, a person, a result. What a script may change in place
(a list that another variable holds too) makes all conditions forget that look into a value. Not remembered are
conditions with other functions than Python's pure ones, those that read what changes by itself (`robot.now`), what
scripts with `await` and behaviours set (they may do so at any time), and variables that a scope has of its own.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any

from fame.bpmn import model
from fame.check.explore.abstraction import Step
from fame.check.explore.purity import waits
from fame.check.explore.script_effects import changes_in_place, may_change, script_writes
from fame.check.expressions import expressions_in, names_of, syntax_tree
from fame.engine.data import Variables
from fame.scripting.interface import NAMES

_BEHIND_ITS_BACK = re.compile(
    r"\b(global|nonlocal|exec|eval|globals|locals|vars|setattr|class|del)\b|__|:=|\bimport\s*\*"
)
"""How a text may set variables that are not seen to be set, or compare as it likes."""
_PURE = frozenset(
    ("abs", "all", "any", "bool", "float", "int", "isinstance", "len", "max", "min", "round", "sorted", "str", "sum")
)


@dataclass(frozen=True, slots=True)
class Remembered:
    """A condition whose outcome is remembered: the variables that it reads, and whether it looks into their values."""

    reads: frozenset[str]
    inside: bool

    def forgets(self, script: model.Expression) -> bool:
        """Whether a script may give it another outcome."""
        changed = script_writes(script) | may_change(script)
        return bool(self.reads & changed) or (self.inside and bool(changes_in_place(script)))


class Outcomes(dict[str, Any]):
    """The variables of an instance, which forget outcomes of the conditions that read what is set.

    `readers`: variable -> conditions, see `key_of`.
    """

    __slots__ = ("readers",)

    def __init__(self, values: Mapping[str, Any], readers: Mapping[str, Iterable[str]]) -> None:
        super().__init__(values)
        self.readers: Mapping[str, Iterable[str]] = readers

    def __setitem__(self, name: str, value: Any) -> None:
        self.forget(self.readers.get(name, ()))
        super().__setitem__(name, value)

    def forget(self, keys: Iterable[str]) -> None:
        """Let conditions have another outcome."""
        for key in keys:
            if key in self:
                del self[key]


def readers_of(remembered: Mapping[str, Remembered]) -> dict[str, tuple[str, ...]]:
    """Variable -> the remembered conditions that read it."""
    names = {name for one in remembered.values() for name in one.reads}
    return {name: tuple(key for key, one in remembered.items() if name in one.reads) for name in names}


def memory_of(variables: dict[str, Any], reads: Set[str]) -> Outcomes | None:
    """Where the outcome of a condition is kept; None if it reads variables of an inner scope."""
    while isinstance(variables, Variables):
        if any(dict.__contains__(variables, name) for name in reads):
            return None
        variables = variables.outer
    return variables if isinstance(variables, Outcomes) else None


def remembered(bodies: Iterable[model.Body], steps: Mapping[str, Step]) -> dict[str, Remembered]:
    """Condition -> what it reads, of the conditions of a pool that are remembered; see `key_of`."""
    found = dict[str, Remembered]()
    inside = any(step.changes for step in steps.values())
    others = {name for step in steps.values() for name in (*step.writes, *step.changes)}
    for body in bodies:
        others |= {node.loop.output_collection for node in body.nodes if isinstance(node.loop, model.MultiInstance)}
        for use in expressions_in(body):
            script = use.use == "script"
            if _BEHIND_ITS_BACK.search(use.expression.text) or (script and use.expression.language != "python"):
                return {}
            others |= use.code
            if script and waits(use.expression):  # it sets them at any time
                others |= script_writes(use.expression) | may_change(use.expression)
                inside |= bool(changes_in_place(use.expression))
            elif use.use == "condition" and (one := _read(use.expression)):
                found[key_of(use.expression)] = one
    return {key: one for key, one in found.items() if not one.reads & others and not (inside and one.inside)}


def key_of(condition: model.Expression) -> str:
    """The name under which the outcome of a condition is kept among the variables: no other one is called so."""
    return f"?{condition.language} {' '.join(condition.text.split())}"


def _read(condition: model.Expression) -> Remembered | None:
    """What a condition reads; None if something else than its variables may change its outcome."""
    reads = names_of(condition)[0] - _PURE
    if condition.language == "python":
        tree = syntax_tree(condition, script=False)
        if tree is None or not all(map(_is_pure, ast.walk(tree))):
            return None
        inside = not _compares_with_constant(tree)
    elif condition.language in ("feel", "juel") and "(" not in condition.text:  # no functions
        inside = True
    else:
        return None
    return Remembered(reads, inside) if reads else None


def _is_pure(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id in _PURE
    if isinstance(node, ast.Name):
        return node.id not in NAMES  # what is there changes by itself
    return not isinstance(node, ast.NamedExpr | ast.Lambda | ast.Await)


def _compares_with_constant(tree: ast.AST) -> bool:
    """Whether a condition compares one variable with a constant: no change in place makes that another one."""
    match getattr(tree, "body", tree):
        case ast.Compare(left=ast.Name(), comparators=[ast.Constant()]):
            return True
        case ast.Compare(left=ast.Constant(), comparators=[ast.Name()]):
            return True
    return False
