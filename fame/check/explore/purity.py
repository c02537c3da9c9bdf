"""Which scripts an exploration may compute: those that static analysis shows to be free of effects.

Everything that a script may do is on a list: statements and operators of Python, some builtins, methods of plain data,
`math`, and the parts of the script interface that the exploration observes (``signal``, ``robot.publish``, ``log``). A
script with anything else, or in another language, is not run: the variables that it sets are unknown afterwards.
"""

from __future__ import annotations

import ast
import math
from functools import lru_cache

from fame.bpmn.model import Expression
from fame.scripting.interface import NAMES
from fame.scripting.python_effects import CHANGING_METHODS, COMPUTING, READING_METHODS, syntax_tree

STEPS = 100_000
"""Loop passes and function entries of a script that is computed."""
_LARGEST = 10_000
"""Numbers in a script above which it might make values too large to compute."""

_BUILTINS = COMPUTING | frozenset(
    ("True", "False", "None", "filter", "map", "ArithmeticError", "AssertionError", "AttributeError", "Exception",
     "IndexError", "KeyError", "LookupError", "RuntimeError", "StopIteration", "TypeError", "ValueError",
     "ZeroDivisionError", "BpmnError", "log", "math", "robot", "signal")
)  # fmt: skip
_METHODS = (
    (READING_METHODS | CHANGING_METHODS)
    - {"appendleft", "extendleft", "popleft", "rotate", "symmetric_difference_update"}
    | {"debug", "error", "info", "name", "namespace", "publish", "warning"}
    | {name for name in dir(math) if not name.startswith("_")}
)
_REFUSED = (
    ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Await, ast.AsyncFor,
    ast.AsyncWith, ast.Yield, ast.YieldFrom, ast.Global, ast.Nonlocal, ast.With, ast.Pow, ast.LShift, ast.GeneratorExp,
    ast.MatchSingleton, ast.MatchSequence, ast.MatchMapping, ast.MatchClass,
)  # fmt: skip


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
    builtins = __builtins__ if isinstance(__builtins__, dict) else vars(__builtins__)
    return name in builtins or name in NAMES
