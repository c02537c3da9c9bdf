"""Scripts without the statements that decide nothing.

Two things are left out of the scripts of a team before it is explored:

- operations on what is certainly unknown: if `odom` comes from a sensor, ``odom.x - shelf[0]`` is unknown whatever
  `shelf` is, so ``odom.x`` takes its place;
- statements that only set variables on which no decision depends. What they might raise is not found, but of those
  that read no variable: these are kept, since they fail in each run or in none, which costs no states.

Neither is left out where an error event may catch what a script raises. A script that defines functions, waits, or
hands variables to unknown functions is taken as a whole.
"""

from __future__ import annotations

import ast
import builtins
from collections import defaultdict
from collections.abc import Iterable, Iterator, Set
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from fame.bpmn.model import Expression, Process
from fame.check.explore.element_variables import used_besides_texts
from fame.check.explore.purity import is_computable
from fame.engine.data import variable_name
from fame.scripting.effects import effects_of
from fame.scripting.python import called_name
from fame.scripting.python_effects import (
    CHANGING_METHODS,
    COMPUTING,
    READING_METHODS,
    catches_all,
    changes_parts,
    own_syntax_tree,
    syntax_tree,
)

Dependency = tuple[frozenset[str], frozenset[str]]
"""(reads, writes): what is written depends on what is read."""

_UNDIVIDED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom, ast.Global, ast.Nonlocal,
              ast.Await, ast.AsyncFor, ast.AsyncWith, ast.NamedExpr, ast.Delete)  # fmt: skip
_HARMLESS = (ast.Module, ast.Assign, ast.Expr, ast.Pass, ast.Constant, ast.Name, ast.List, ast.Tuple, ast.expr_context)
"""What raises nothing: giving a name a constant, the value of another one, or a list of these."""

SURE = (ast.Module, ast.Assign, ast.Expr, ast.If, ast.While, ast.Break, ast.Continue, ast.Pass, ast.Raise, ast.Assert,
         ast.BoolOp, ast.IfExp, ast.NamedExpr, ast.Constant, ast.Name, ast.JoinedStr, ast.keyword, ast.Try, ast.TryStar,
         ast.expr_context, ast.boolop, ast.operator, ast.unaryop, ast.cmpop)  # fmt: skip
"""What raises nothing on values of any kind; whether it says ``raise`` or ``assert`` is looked at elsewhere."""
_OF_A_KIND = (ast.Attribute, ast.BinOp, ast.AugAssign, ast.UnaryOp, ast.Compare, ast.For, ast.comprehension,
              ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Set, ast.Dict, ast.Starred, ast.Slice,
              ast.Lambda, ast.arguments, ast.arg, ast.FormattedValue, ast.Await, ast.AnnAssign,
              ast.ExceptHandler)  # fmt: skip
"""What raises nothing on values of the kind that it expects, but for what `_may_fail` names."""
OF_ROBOT = frozenset(("name", "namespace", "now", "date"))
SURE_CALLS = frozenset(("bool", "print", "repr", "str", "type"))
"""Functions that raise nothing on one value of any kind."""
OF_INTERFACE = frozenset(("BpmnError", "log", "receive", "robot", "signal", "sleep"))
"""What raises nothing on constants: those that are wrong are errors of the model."""
_TIMED = {"receive": 2, "until": 1}
"""What raises an exception when the time is over that it is given -> the place of this time among its arguments."""
_SURE_OF_A_KIND = (COMPUTING - {"divmod", "float", "int", "max", "min", "round"}).union(
    ("BpmnError", "hasattr", "isinstance", "log", "receive", "signal", "sleep", "type", "until")
)
SURE_METHODS = (
    (READING_METHODS | CHANGING_METHODS)
    .difference(("index", "pop", "popitem", "popleft", "remove"))
    .union(("atan", "atan2", "copysign", "degrees", "dist", "fabs", "hypot", "isfinite", "isinf", "isnan", "radians"))
)
"""Functions and methods that raise nothing on values of the expected kind."""


class _Statement(NamedTuple):
    """A statement. `loud`: whether it does more than set variables; `alone`: whether it fails by itself, or never."""

    tree: ast.stmt
    loud: bool
    alone: bool
    link: Dependency

    def decides(self, needed: Set[str]) -> bool:
        return self.loud or self.alone or bool(self.link[1] & needed)


@lru_cache(maxsize=1024)
def links(script: Expression) -> tuple[Dependency, ...]:
    """Return what depends on what in a script: one link for each statement, or one for all if it
    is taken as a whole."""
    statements = _statements(script)
    if statements is None:
        effects = effects_of(script, script=True)
        return ((effects.reads, effects.writes | effects.reaches),)
    return tuple(statement.link for statement in statements)


def sliced(script: Expression, needed: Set[str]) -> Expression:
    """Return the script without the statements that set no variable that is needed."""
    statements = _statements(script)
    if statements is None or all(statement.decides(needed) for statement in statements):
        return script
    left = [statement.tree for statement in statements if statement.decides(needed)]
    return replace(script, text="\n".join(map(ast.unparse, left)) or "pass")


def skipped(script: Expression, needed: Set[str]) -> str:
    """Return the first statement that `sliced` leaves out although it may raise, or an empty text."""
    left_out = (one.tree for one in _statements(script) or () if not one.decides(needed))
    return next((ast.unparse(tree) for tree in left_out if _may_raise(tree)), "")


def fails_alone(script: Expression) -> bool:
    """Return whether constants alone may make a script fail."""
    return any(statement.alone for statement in _statements(script) or ())


def _may_raise(tree: ast.AST) -> bool:
    """Whether a statement does more than give names constants or values of others."""
    return not all(
        isinstance(node, _HARMLESS) and not (isinstance(node, ast.Tuple | ast.List) and isinstance(node.ctx, ast.Store))
        for node in ast.walk(tree)
    )


@lru_cache(maxsize=1024)
def may_fail(script: Expression) -> bool:
    """Return whether a script in Python may raise something on values that are of the kind that it expects.

    What stands in a ``try`` with handlers of all exceptions does not.
    """
    tree = _tree(script)
    return tree is not None and any(map(_may_fail, walk(tree)))


def _may_fail(node: ast.AST) -> bool:
    match node:
        case ast.Subscript():
            return not isinstance(node.slice, ast.Slice)
        case ast.BinOp() | ast.AugAssign():
            return isinstance(node.op, ast.Div | ast.FloorDiv | ast.Mod | ast.Pow | ast.LShift | ast.RShift)
        case ast.Tuple() | ast.List():
            return isinstance(node.ctx, ast.Store)
        case ast.Call(func=ast.Name(name)):
            return name not in _SURE_OF_A_KIND or may_time_out(node)
        case ast.Call(func=ast.Attribute(ast.Name("log" | "robot"))):
            return False  # but for actions and services, whose failures `Failures` has
        case ast.Call(func=ast.Attribute(attr=name)):
            return name not in SURE_METHODS
    return not isinstance(node, (*SURE, *_OF_A_KIND))


@lru_cache(maxsize=1024)
def may_mismatch(script: Expression) -> bool:
    """Return whether a script may raise something on values of any kind, but that a variable is not set."""
    tree = _tree(script)
    return tree is None or any(map(_may_mismatch, walk(tree)))


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Walk what may raise in a tree: not what handlers catch, nor the functions that calls name."""
    pending = [node]
    while pending:
        yield (node := pending.pop())
        inside = {*ast.iter_child_nodes(node)}
        match node:
            case ast.Try(body, handlers) if any(map(catches_all, handlers)):
                inside -= {*body}
            case ast.Call(ast.Attribute(ast.Name()) as function):
                inside -= {function}
        pending += inside


def _may_mismatch(node: ast.AST) -> bool:
    match node:
        case ast.Attribute(ast.Name("robot"), name, ast.Load()):
            return name not in OF_ROBOT
        case ast.Call(ast.Name(name), [_], []) if name in SURE_CALLS:
            return False
        case ast.Call(ast.Name("log") | ast.Attribute(ast.Name("log")), _, []):
            return False
        case ast.Call(ast.Name(name) | ast.Attribute(ast.Name(name)), arguments, named):
            given = [*arguments, *(one.value for one in named)]
            constant = all(isinstance(one, ast.Constant) for one in given)
            return name not in OF_INTERFACE or not constant or may_time_out(node)
        case ast.UnaryOp(op):
            return not isinstance(op, ast.Not)
        case ast.Compare(ops=operators):
            return not all(isinstance(one, ast.Eq | ast.NotEq | ast.Is | ast.IsNot) for one in operators)
        case ast.Tuple() | ast.List():
            return not isinstance(node.ctx, ast.Load)
        case ast.Dict(keys=keys):
            return not all(isinstance(one, ast.Constant) for one in keys)
        case ast.FormattedValue(format_spec=spec):
            return spec is not None
        case ast.ExceptHandler():
            return not all(is_exception(one) for one in ast.walk(node.type or ast.Load()))
        case ast.Await(value):
            return not isinstance(value, ast.Call)  # of what gives something else, the call is not sure
    return not isinstance(node, SURE)


def may_time_out(call: ast.Call) -> bool:
    """Return whether a call is one that waits for a time that it is given."""
    place = _TIMED.get(called_name(call))
    return place is not None and (len(call.args) > place or any(one.arg != "type" for one in call.keywords))


def is_exception(node: ast.AST) -> bool:
    """Return whether a part of what an ``except`` names is surely of exceptions."""
    kind = getattr(builtins, node.id, None) if isinstance(node, ast.Name) else Exception
    known = kind if isinstance(kind, type) else object
    return isinstance(node, ast.Name | ast.Tuple | ast.expr_context) and issubclass(known, BaseException)


@lru_cache(maxsize=1024)
def _statements(script: Expression) -> list[_Statement] | None:
    """The statements; None if a script is taken as a whole."""
    tree = _tree(script)
    if tree is None or any(isinstance(node, _UNDIVIDED) for node in ast.walk(tree)) or changes_parts(tree):
        return None
    if effects_of(script, script=True).may_change:
        return None
    statements = []
    for statement in tree.body:
        text = replace(script, text=ast.unparse(statement))
        effects = effects_of(text, script=True)
        nodes = list(ast.walk(statement))
        loud = any(isinstance(node, ast.Raise | ast.Assert) for node in nodes) or not all(
            _has_no_effect(node) for node in nodes if isinstance(node, ast.Call)
        )
        names = {node.id for node in nodes if isinstance(node, ast.Name)} - effects.sets
        closed = not effects.reads and names <= COMPUTING | {"math"} and is_computable(text, frozenset())
        alone = closed and _may_raise(statement)
        statements.append(_Statement(statement, loud, alone, (effects.reads, effects.writes)))
    return statements


def _tree(script: Expression) -> ast.Module | None:
    tree = syntax_tree(script)
    return tree if isinstance(tree, ast.Module) else None


def _has_no_effect(call: ast.Call) -> bool:
    function = call.func
    if isinstance(function, ast.Attribute):
        return function.attr in READING_METHODS or function.attr in CHANGING_METHODS or _is_of_numbers(function)
    return isinstance(function, ast.Name) and (function.id in COMPUTING or function.id == "log")


# ---- what is certainly unknown ---------------------------------------------------------------------------------------


def unknown_variables(processes: Iterable[Process], sensed: Set[str], parameters: Set[str]) -> frozenset[str]:
    """Return the variables that only hold what comes from outside of the team, or what is computed from it.

    `sensed`: topics on which only something outside of the team sends. `parameters`: variables that have values at the
    start. A variable that may hold anything else is not unknown, so that nothing that may be known is lost.
    """
    values = defaultdict[str, list[ast.expr | None]](list)  # None: a value that may be known
    values |= {name: [None] for name in parameters}
    sources = set[str]()
    for body in (body for process in processes for body in process.body.bodies()):
        for item in body.data_objects:
            for name, value in item.values:
                values[name] += [] if value.text in ("", f"${{{name}}}") else [None]
        for node in body.nodes:
            for name, assigned in assignments(node.script) if node.script is not None else ():
                values[name].append(assigned)
            of_sensors = {variable_name(topic.name) for topic, throws in node.topics()
                          if not throws and topic.qualified in sensed and not topic.takes}  # fmt: skip
            sources |= of_sensors
            for name in used_besides_texts(node, body):
                values[name] += [] if name in of_sensors else [None]
    unknown = {name for name in sources if not values[name]}
    while grown := {
        name for name, all_values in values.items() if all_values and name not in unknown
        and all(value is not None and unknown_part(value, unknown) is not None for value in all_values)
    }:  # fmt: skip
        unknown |= grown
    return frozenset(unknown)


def assignments(script: Expression) -> Iterator[tuple[str, ast.expr | None]]:
    """(variable, value) of what a script sets; None for a value that is not one expression."""
    tree, effects = _tree(script), effects_of(script, script=True)
    plain = [node for node in ast.walk(tree) if _is_plain(node)] if tree is not None else []
    targets = {id(node.targets[0]) for node in plain if isinstance(node, ast.Assign)}
    for node in plain:
        assert isinstance(node, ast.Assign)
        assert isinstance(node.targets[0], ast.Name)
        yield node.targets[0].id, node.value
    set_otherwise = {
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name)
        and not isinstance(node.ctx, ast.Load) and id(node) not in targets
    } if tree is not None else effects.writes  # fmt: skip
    in_place = (effects.writes | effects.may_change) - effects.sets
    yield from ((name, None) for name in (*set_otherwise, *in_place))


def _is_plain(node: ast.AST) -> bool:
    return isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name)


def unknown_part(value: ast.expr, unknown: Set[str]) -> ast.expr | None:
    """Return a part of an expression that is certainly unknown, which makes the whole so; None if there is no such.

    A variable with a message from outside is a message of which nothing is known; its fields are unknown.
    """
    if isinstance(value, ast.Name):
        return value if value.id in unknown else None
    if isinstance(value, ast.Attribute | ast.Subscript):
        return value if unknown_part(value.value, unknown) is not None else None
    if isinstance(value, ast.BinOp):
        return unknown_part(value.left, unknown) or unknown_part(value.right, unknown)
    if isinstance(value, ast.UnaryOp) and not isinstance(value.op, ast.Not):
        return unknown_part(value.operand, unknown)
    if isinstance(value, ast.Call) and not value.keywords and _is_of_numbers(value.func):
        return next((part for one in value.args if (part := unknown_part(one, unknown)) is not None), None)
    return None


def _is_of_numbers(function: ast.expr) -> bool:
    if isinstance(function, ast.Attribute):
        return isinstance(function.value, ast.Name) and function.value.id == "math"
    return isinstance(function, ast.Name) and function.id in ("abs", "float", "round")


def without_operations(script: Expression, unknown: Set[str]) -> Expression:
    """Return the script with a variable that is certainly unknown in the place of each expression that it makes so."""
    tree = own_syntax_tree(script) if unknown else None
    changed = False
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.Assign):
            part = unknown_part(node.value, unknown)
            if part is not None and part is not node.value:
                node.value, changed = part, True
    return replace(script, text=ast.unparse(tree)) if tree is not None and changed else script
