"""Which scripts an exploration may compute: those that static analysis shows to be free of effects.

Everything that a script may do is on a list: statements and operators of Python, some builtins, methods of plain data,
`math`, and the parts of the script interface that the exploration observes (``signal``, ``robot.publish``, ``log``). A
script with anything else, or in another language, is not run: the variables that it sets are unknown afterwards.
"""

from __future__ import annotations

import ast
import math
import re
from dataclasses import replace
from functools import lru_cache
from typing import Any

from fame.bpmn.model import Expression
from fame.check.expressions import own_syntax_tree, syntax_tree
from fame.scripting.analysis import script_topics
from fame.scripting.python import parse_python

STEPS = 100_000
"""Loop passes and function entries of a script that is computed."""
_LARGEST = 10_000
"""Numbers in a script above which it might make values too large to compute."""

_BUILTINS = frozenset(
    [
        "abs",
        "all",
        "any",
        "bool",
        "dict",
        "divmod",
        "enumerate",
        "filter",
        "float",
        "frozenset",
        "int",
        "len",
        "list",
        "map",
        "max",
        "min",
        "print",
        "range",
        "repr",
        "reversed",
        "round",
        "set",
        "sorted",
        "str",
        "sum",
        "tuple",
        "zip",
        "True",
        "False",
        "None",
        "ArithmeticError",
        "AssertionError",
        "AttributeError",
        "Exception",
        "IndexError",
        "KeyError",
        "LookupError",
        "RuntimeError",
        "StopIteration",
        "TypeError",
        "ValueError",
        "ZeroDivisionError",
        "BpmnError",
        "log",
        "math",
        "robot",
        "signal",
    ]
)
_METHODS = frozenset(
    [
        "add",
        "append",
        "capitalize",
        "clear",
        "copy",
        "count",
        "debug",
        "difference",
        "difference_update",
        "discard",
        "endswith",
        "error",
        "extend",
        "find",
        "get",
        "index",
        "info",
        "insert",
        "intersection",
        "intersection_update",
        "isalpha",
        "isdigit",
        "isnumeric",
        "issubset",
        "issuperset",
        "items",
        "join",
        "keys",
        "lower",
        "lstrip",
        "name",
        "namespace",
        "partition",
        "pop",
        "popitem",
        "publish",
        "remove",
        "removeprefix",
        "removesuffix",
        "replace",
        "reverse",
        "rfind",
        "rpartition",
        "rsplit",
        "rstrip",
        "setdefault",
        "sort",
        "split",
        "splitlines",
        "startswith",
        "strip",
        "title",
        "union",
        "update",
        "upper",
        "values",
        "warning",
    ]
) | frozenset(name for name in dir(math) if not name.startswith("_"))
CHANGING_METHODS = frozenset(
    ("add", "append", "appendleft", "clear", "difference_update", "discard", "extend", "extendleft", "insert",
     "intersection_update", "pop", "popitem", "popleft", "remove", "reverse", "rotate", "setdefault", "sort",
     "symmetric_difference_update", "update")
)  # fmt: skip
"""Methods that change a list, mapping, set or deque."""
READING_METHODS = frozenset(
    ("capitalize", "copy", "count", "difference", "endswith", "find", "get", "index", "intersection", "isalpha",
     "isdigit", "isnumeric", "issubset", "issuperset", "items", "join", "keys", "lower", "lstrip", "partition",
     "removeprefix", "removesuffix", "replace", "rfind", "rpartition", "rsplit", "rstrip", "split", "splitlines",
     "startswith", "strip", "title", "union", "upper", "values")
)  # fmt: skip
"""Methods of plain data that leave it and their arguments as they are."""
_REFUSED = (
    ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Await, ast.AsyncFor,
    ast.AsyncWith, ast.Yield, ast.YieldFrom, ast.Global, ast.Nonlocal, ast.With, ast.Pow, ast.LShift, ast.GeneratorExp,
    ast.MatchSingleton, ast.MatchSequence, ast.MatchMapping, ast.MatchClass,
)  # fmt: skip


_RAISES = re.compile(r"\b(raise|assert|throw)\b(?!\s+(new\s+)?BpmnError\b)")


def may_raise(script: Expression) -> bool:
    """Return whether a script, in any language, says that it fails otherwise than with an error code."""
    return _RAISES.search(script.text) is not None


@lru_cache(maxsize=1024)
def is_computable(script: Expression, fields: frozenset[str], mode: str = "exec") -> bool:
    """Return whether a script or expression in Python may be run. `fields`: names of the fields of messages."""
    tree = syntax_tree(script, script=mode == "exec")
    return tree is not None and all(_is_listed(node, fields) for node in ast.walk(tree))


def _is_listed(node: ast.AST, fields: frozenset[str]) -> bool:
    if isinstance(node, _REFUSED):
        return False
    if isinstance(node, ast.Attribute):
        return node.attr in _METHODS or (node.attr in fields and not node.attr.startswith("_"))
    if isinstance(node, ast.Name):
        return not node.id.startswith("__") and (node.id in _BUILTINS or not _is_builtin(node.id))
    if isinstance(node, ast.Constant):
        return not isinstance(node.value, int | float) or abs(node.value) <= _LARGEST
    return True


def _is_builtin(name: str) -> bool:
    from fame.scripting.interface import NAMES

    builtins = __builtins__ if isinstance(__builtins__, dict) else vars(__builtins__)
    return name in builtins or name in NAMES


@lru_cache(maxsize=1024)
def waits(script: Expression) -> bool:
    """Return whether a script waits: it has an ``await`` (in JavaScript, the word)."""
    if script.language != "python":
        return script.language == "javascript" and "await" in script.text
    tree = syntax_tree(script)
    return tree is not None and any(
        isinstance(node, ast.Await | ast.AsyncFor | ast.AsyncWith) for node in ast.walk(tree)
    )


@lru_cache(maxsize=1024)
def catches(script: Expression) -> bool:
    """Return whether a script in Python catches exceptions, among them those of asking an unknown value too much."""
    return any(isinstance(node, ast.Try | ast.TryStar) for node in ast.walk(parse_python(script)))


@lru_cache(maxsize=1024)
def is_certain(script: Expression, topic: str) -> bool:
    """Return whether a script publishes on a topic (qualified name) each time that it ends without an error.

    It does if a statement outside of blocks, which nothing but an error can leave out, publishes in any case.
    """
    statements = [one for one in getattr(own_syntax_tree(script), "body", ()) if isinstance(one, ast.Expr)]
    always = "\n".join(ast.unparse(_AlwaysEvaluated().visit(one)) for one in statements)
    found = script_topics(replace(script, text=always))
    return any(one.direction == "publish" and one.qualified == topic for one in found)


class _AlwaysEvaluated(ast.NodeTransformer):
    """Reduces a statement to parts that are evaluated each time that it is executed."""

    def visit(self, node: ast.AST) -> Any:
        match node:
            case ast.BoolOp(values=[first, *_]) | ast.IfExp(test=first) | ast.Compare(left=first):
                return self.visit(first)
            case ast.Lambda() | ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                return ast.Constant(None)
        return self.generic_visit(node)
