"""Unknown conditions whose outcome is remembered: asked again with unchanged variables, they have the same one.

An outcome is kept among the variables of its instance, as the decisions that led to it, and forgotten as soon as a
variable that the condition reads is set, or may be changed in place: by a script, a message, a person, a result. While
a script with `await` or a behaviour is under way it may set its variables at any time. Not remembered are conditions
in JavaScript, with functions that are not known to give the same again, or that read what changes by itself
(`robot.now`), and those that read variables that a scope has of its own.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Set
from typing import Any

from fame.bpmn import model
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

_IMPURE = {
    "feel": re.compile(r"\b(random number|uuid|now|today)\s*\("),
    "juel": re.compile(r"(?<!\bnot)(?<!\bempty)(?<!\band)(?<!\bor)\b\s*\("),
}
"""Functions of other languages that may give something else each time."""


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


def readers_of(remembered: Mapping[str, Set[str]]) -> dict[str, tuple[str, ...]]:
    """Variable -> the remembered conditions that read it."""
    names = {name for reads in remembered.values() for name in reads}
    return {name: tuple(key for key, reads in remembered.items() if name in reads) for name in names}


def memory_of(variables: dict[str, Any], reads: Set[str]) -> Outcomes | None:
    """Where the outcome of a condition is kept; None if it reads variables of an inner scope."""
    while isinstance(variables, Variables):
        if any(dict.__contains__(variables, name) for name in reads):
            return None
        variables = variables.outer
    return variables if isinstance(variables, Outcomes) else None


def remembered(bodies: Iterable[model.Body]) -> dict[str, frozenset[str]]:
    """Condition -> the variables that it reads, of the conditions of a pool that are remembered; see `key_of`."""
    found, others = dict[str, frozenset[str]](), set[str]()
    for body in bodies:
        others |= {node.loop.output_collection for node in body.nodes if isinstance(node.loop, model.MultiInstance)}
        for use in expressions_in(body):
            script = use.use == "script"
            if _BEHIND_ITS_BACK.search(use.expression.text) or (script and use.expression.language != "python"):
                return {}
            others |= use.code
            if use.use == "condition" and (reads := _read(use.expression)):
                found[key_of(use.expression)] = reads
    return {key: reads for key, reads in found.items() if not reads & others}


def key_of(condition: model.Expression) -> str:
    """The name under which the outcome of a condition is kept among the variables: no other one is called so."""
    return f"?{condition.language} {' '.join(condition.text.split())}"


def _read(condition: model.Expression) -> frozenset[str]:
    """The variables that a condition reads; none if something else may change its outcome."""
    if condition.language == "python":
        tree = syntax_tree(condition, script=False)
        pure = tree is not None and all(map(_is_pure, ast.walk(tree)))
    else:
        impure = _IMPURE.get(condition.language)
        pure = impure is not None and not impure.search(condition.text)
    return names_of(condition)[0] - _PURE if pure else frozenset()


def _is_pure(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id in _PURE
    if isinstance(node, ast.Name):
        return node.id not in NAMES  # what is there changes by itself
    return not isinstance(node, ast.NamedExpr | ast.Lambda | ast.Await)
