"""Scripts and conditions in Python that ask an unknown value where Python itself would not.

``x is None`` compares objects, and a text that an unknown value was put into is a text: neither asks the value. In the
texts that an exploration computes these are calls, of `same` and `text_of`, whose results are unknown.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

from fame.bpmn.model import Expression
from fame.check.explore.values import MARK, Values, is_unknown
from fame.scripting.python import accepted

_SAME, _TEXT = "__same__", "__text__"
_ATOMS = (bool, int, float, str, bytes, type(None))


def functions(values: Values) -> dict[str, Callable[..., Any]]:
    """Return the functions that the texts call, and those that make texts of values."""

    def same(first: Any, other: Any) -> Any:
        """Whether two values are one object: unknown if one of them is unknown, or may have other names too."""
        if (not isinstance(first, _ATOMS) and not isinstance(other, _ATOMS)) or is_unknown(first) or is_unknown(other):
            return values.unknown
        return first.__class__ is other.__class__ and first == other

    def text_of(text: Any) -> Any:
        """A text, unknown if something unknown was put into it."""
        return values.unknown if isinstance(text, str) and MARK in text else text

    def texts_by(make: Callable[..., str]) -> Callable[..., Any]:
        return lambda *arguments: text_of(make(*arguments))

    return {_SAME: same, _TEXT: text_of, "str": texts_by(str), "repr": texts_by(repr)}


@lru_cache(maxsize=1024)
def asking(expression: Expression, mode: Literal["exec", "eval"] = "exec") -> Expression:
    """Return the text with these calls; its lines keep their numbers."""
    parsed = accepted(expression, mode)
    nodes = [node for node in ast.walk(parsed[1]) if isinstance(node, ast.expr) and _hides(node)] if parsed else []
    if parsed is None or not nodes:
        return expression
    lines = [line.encode() for line in parsed[0].split("\n")]
    for node in sorted(_outermost(nodes), key=lambda node: (-node.lineno, -node.col_offset)):
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        first, last = node.lineno - 1, node.end_lineno - 1
        before, after = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
        call = b"(" + ast.unparse(_Calls().visit(node)).encode() + b"\n" * (last - first) + b")"
        lines[first : last + 1] = (before + call + after).split(b"\n")
    return replace(expression, text=b"\n".join(lines).decode())


def _hides(node: ast.AST) -> bool:
    """Whether an expression does not ask an unknown value that it is given."""
    match node:
        case ast.Compare(ops=[ast.Is() | ast.IsNot()]) | ast.JoinedStr():
            return True
        case ast.BinOp(left=ast.Constant(value=str()), op=ast.Mod()) | ast.Call(func=ast.Attribute(attr="format")):
            return True
    return False


def _outermost(nodes: list[ast.expr]) -> list[ast.expr]:
    inside = {id(inner) for node in nodes for inner in ast.walk(node) if inner is not node}
    return [node for node in nodes if id(node) not in inside]


class _Calls(ast.NodeTransformer):
    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, ast.FormattedValue):  # how it is formatted is a text of its own
            node.value = self.visit(node.value)
            return node
        hides = _hides(node)
        node = self.generic_visit(node)
        match node:
            case ast.Compare(left, [ast.Is() | ast.IsNot() as how], [right]):
                call = _call(_SAME, left, right)
                return call if isinstance(how, ast.Is) else _call(_SAME, call, ast.Constant(False))
        return _call(_TEXT, node) if hides and isinstance(node, ast.expr) else node


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), [*arguments], [])
