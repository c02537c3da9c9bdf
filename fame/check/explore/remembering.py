"""Unknown conditions whose outcome is remembered: asked again with unchanged variables, they have the same one.

An outcome is kept among the variables of the innermost scope that has one that the condition reads, as the decisions
that led to it. It is forgotten as soon as one of them is set, or may be changed in place: by a script, a message, a
person, a result. While a script with `await` or a behaviour is under way it may set its variables at any time. Not
remembered are conditions with functions that are not known to give the same again, or that read what changes by itself
(`robot.now`).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

from fame.bpmn import model
from fame.check.expressions import condition_tree, expressions_in, names_of, syntax_tree
from fame.engine.data import Variables
from fame.scripting.analysis import identifiers_of
from fame.scripting.interface import NAMES

_BEHIND_ITS_BACK = re.compile(
    r"\b(global|nonlocal|exec|eval|globals|locals|vars|setattr|class|del)\b|__|:=|\bimport\s*\*"
)
"""How a text may set variables unseen, or change what a comparison means."""
_BEHIND_IN_JAVASCRIPT = re.compile(
    r"""\b(Function|with|Proxy|Reflect|Symbol|prototype|defineProperty|defineProperties)\b|\b[gs]et\s+[\w$[\"']"""
    r"""|\b(valueOf|toString|toJSON)\s*([:=](?!=)|\([^()]*\)\s*\{)"""
)
"""How a text in JavaScript may do so."""
_PURE = frozenset(
    ("abs", "all", "any", "bool", "float", "int", "isinstance", "len", "max", "min", "round", "sorted", "str", "sum")
)

_JAVASCRIPT_NAMES = ("Infinity", "NaN", "environment", "this", "undefined")
_JAVASCRIPT_WORDS = {"Infinity", "NaN", "undefined", "true", "false", "null", "typeof"}
_STRING_IN_JAVASCRIPT = re.compile(r"""'[^'\\]*'|"[^"\\]*\"""")
_VARIABLE_IN_JAVASCRIPT = re.compile(r"\bthis\.environment\.variables(\??\.(?!ros_node\b|node\b)[\w$]+)+")
_EFFECT_IN_JAVASCRIPT = re.compile(r"[\w$\])]\s*(\?\.)?\(|[`/]|\+\+|--|=>|>>=|<<=|(?<![=!<>])=(?!=)")
"""A call, an assignment, or what hides one."""
_IMPURE = {
    "feel": re.compile(r"\b(random number|uuid|now|today)\s*\("),
    "juel": re.compile(r"(?<!\bnot)(?<!\bempty)(?<!\band)(?<!\bor)\b\s*\("),
}
"""Functions of other languages that may give something else each time."""


class Memory:
    """What is remembered of the conditions of a pool, in all variables of an engine.

    readers   variable -> the conditions that read it, see `key_of`
    scopes    all variables in which outcomes may be kept
    """

    def __init__(self, remembered: Mapping[str, Set[str]]) -> None:
        names = {name for reads in remembered.values() for name in reads}
        self.readers: Mapping[str, Sequence[str]] = {
            name: tuple(key for key, reads in remembered.items() if name in reads) for name in names
        }
        self.scopes: list[Outcomes | InnerOutcomes] = []

    def set(self, name: str, owner: dict[str, Any]) -> None:
        """Forget the outcomes that depend on a variable of some scope."""
        for key in self.readers.get(name, ()):
            for scope in self.scopes:
                if owner_of(scope, name) is owner:
                    scope.forget(key)

    def change(self, names: Iterable[str]) -> None:
        """Forget the outcomes that depend on what variables hold, which those of any scope may hold too."""
        for key in {key for name in names for key in self.readers.get(name, ())}:
            for scope in self.scopes:
                scope.forget(key)


def owner_of(variables: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the variables, of a scope or of one around it, that have a name."""
    while isinstance(variables, Variables) and not dict.__contains__(variables, name):
        variables = variables.outer
    return variables


class InnerOutcomes(Variables):
    """The variables of a scope with variables of its own, with outcomes of the conditions that read one of them."""

    __slots__ = ("memory",)
    inner: type[InnerOutcomes]

    def __init__(self, outer: dict[str, Any], own: Mapping[str, Any] | None = None) -> None:
        super().__init__(outer, own)
        self.memory: Memory = outer.memory  # type: ignore[attr-defined]  # of variables whose `inner` is this class
        self.memory.scopes.append(self)

    def define(self, name: str, value: Any) -> None:
        if not _is_key(name):
            super().define(name, value)
            self.memory.set(name, self)

    def recall(self, key: str) -> tuple[int, ...]:
        """Return the decisions that led to the outcome of a condition; none if it is not known."""
        found: tuple[int, ...] = dict.get(self, key, ())
        return found

    def remember(self, key: str, decisions: tuple[int, ...]) -> None:
        """Keep the decisions that led to the outcome of a condition."""
        super().define(key, decisions)

    def forget(self, key: str) -> None:
        """Let a condition have another outcome."""
        if dict.__contains__(self, key):
            del self[key]


InnerOutcomes.inner = InnerOutcomes


class Outcomes(dict[str, Any]):
    """The variables of an instance, or of a call with variables of its own, with outcomes of conditions."""

    __slots__ = ("memory",)
    inner: type[InnerOutcomes] = InnerOutcomes

    def __init__(self, values: Mapping[str, Any], memory: Memory) -> None:
        super().__init__(values)
        self.memory: Memory = memory
        memory.scopes.append(self)

    def __setitem__(self, name: str, value: Any) -> None:
        if not _is_key(name):
            super().__setitem__(name, value)
            self.memory.set(name, self)

    def update(self, *values: Any, **named: Any) -> None:
        """Take variables of another scope, without its outcomes."""
        super().update({name: value for name, value in dict(*values, **named).items() if not _is_key(name)})

    def recall(self, key: str) -> tuple[int, ...]:
        """Return the decisions that led to the outcome of a condition; none if it is not known."""
        found: tuple[int, ...] = self.get(key, ())
        return found

    def remember(self, key: str, decisions: tuple[int, ...]) -> None:
        """Keep the decisions that led to the outcome of a condition."""
        super().__setitem__(key, decisions)

    def forget(self, key: str) -> None:
        """Let a condition have another outcome."""
        if key in self:
            del self[key]


def memory_of(variables: dict[str, Any], reads: Set[str]) -> Outcomes | InnerOutcomes | None:
    """Where the outcome of a condition is kept: in the innermost variables that have one that it reads."""
    while isinstance(variables, Variables) and not any(dict.__contains__(variables, name) for name in reads):
        variables = variables.outer
    return variables if isinstance(variables, Outcomes | InnerOutcomes) else None


def remembered(bodies: Iterable[model.Body]) -> dict[str, frozenset[str]]:
    """Condition -> the variables that it reads, of the conditions of a pool that are remembered; see `key_of`."""
    found, others = dict[str, frozenset[str]](), set[str]()
    for body in bodies:
        others |= {node.loop.output_collection for node in body.nodes if isinstance(node.loop, model.MultiInstance)}
        for use in expressions_in(body):
            if _BEHIND_ITS_BACK.search(use.expression.text):
                return {}
            if use.expression.language == "javascript":
                names = identifiers_of(use.expression.text)
                if names.open or _BEHIND_IN_JAVASCRIPT.search(use.expression.text):
                    return {}
                if names.functions or use.use != "script":  # which may set them at another time
                    others |= names.writes | (names.reads if names.functions else frozenset())
            others |= use.code
            if use.use == "condition" and (reads := _read(use.expression)):
                found[key_of(use.expression)] = reads
    return {key: reads for key, reads in found.items() if not reads & others}


def _is_key(name: str) -> bool:
    return name[:1] == "?"


def key_of(condition: model.Expression) -> str:
    """Return the name under which the outcome of a condition is kept among the variables: no other one is called so."""
    return f"?{condition.language} {' '.join(condition.text.split())}"


def _read(condition: model.Expression) -> frozenset[str]:
    """The variables that a condition reads; none if something else may change its outcome."""
    if condition.language == "python":
        tree = syntax_tree(condition, script=False)
        pure = tree is not None and all(map(_is_pure, ast.walk(tree)))
    elif condition.language == "javascript":
        tree = condition_tree(condition)
        if tree is not None:
            pure = all(map(_is_pure_in_javascript, ast.walk(tree)))
        else:  # a form that Python does not have
            left = _VARIABLE_IN_JAVASCRIPT.sub("0", _STRING_IN_JAVASCRIPT.sub("0", condition.text))
            pure = (
                not _EFFECT_IN_JAVASCRIPT.search(left) and {*re.findall(r"[A-Za-z_$][\w$]*", left)} <= _JAVASCRIPT_WORDS
            )
    else:
        impure = _IMPURE.get(condition.language)
        pure = impure is not None and not impure.search(condition.text)
    return names_of(condition)[0] - _PURE if pure else frozenset()


def _is_pure_in_javascript(node: ast.AST) -> bool:
    """Whether a part of a condition, read as Python, only reads variables, by ``environment.variables``."""
    if isinstance(node, ast.Attribute):
        of_this = isinstance(node.value, ast.Name) and node.value.id == "this"
        return node.attr == "environment" if of_this else node.attr not in ("node", "ros_node")
    return not isinstance(node, ast.Call | ast.NamedExpr | ast.Lambda | ast.Await) and (
        not isinstance(node, ast.Name) or node.id in _JAVASCRIPT_NAMES
    )


def _is_pure(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id in _PURE
    if isinstance(node, ast.Name):
        return node.id not in NAMES  # what is there changes by itself
    return not isinstance(node, ast.NamedExpr | ast.Lambda | ast.Await)
