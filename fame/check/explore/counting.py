"""Lists of which only the length is read: what they contain decides nothing, and is left out."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import lru_cache

from fame.bpmn.model import Expression, Process
from fame.check.explore.element_variables import used_besides_texts
from fame.check.expressions import expressions_in
from fame.scripting.effects import effects_of
from fame.scripting.python_effects import own_syntax_tree, syntax_tree


def counted_lists(processes: Iterable[Process]) -> frozenset[str]:
    """Return the variables with lists of which only the length is read, in all processes."""
    counted, others = set[str](), set[str]()
    for body in (body for process in processes for body in process.body.bodies()):
        for use in expressions_in(body):
            if use.expression.language == "python":
                of_text, besides = list_uses(use.expression, script=use.use == "script")
                counted |= of_text
                others |= besides
            else:
                others |= use.reads | use.effects.sets
        others |= {name for node in body.nodes for name in used_besides_texts(node, body)}
    return frozenset(counted - others)


@lru_cache(maxsize=1024)
def list_uses(text: Expression, *, script: bool) -> tuple[frozenset[str], frozenset[str]]:
    """(counted, others): the variables of which a text uses only the length as a list, and the others that it uses.

    Using only the length is ``len(x)``, ``x.append(...)`` as a statement, and ``x = [...]``.
    """
    effects = effects_of(text, script=script)
    tree = syntax_tree(text, script=script)
    if tree is None:
        return frozenset(), effects.reads | effects.sets
    fine = {id(name) for node in ast.walk(tree) for name in _only_counted(node)}
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    others = {node.id for node in names if id(node) not in fine} | {
        name for node in ast.walk(tree) if isinstance(node, ast.Global | ast.Nonlocal) for name in node.names
    }
    return frozenset({node.id for node in names} - others), frozenset(others)


def _only_counted(node: ast.AST) -> Iterator[ast.Name]:
    """The names in a node that stand for a list of which only the length matters there."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "len":
        yield node.func
        yield from (argument for argument in node.args if isinstance(argument, ast.Name))
    elif isinstance(node, ast.Assign) and isinstance(node.value, ast.List) and len(node.targets) == 1:
        yield from (target for target in node.targets if isinstance(target, ast.Name))
    elif (name := _appended_to(node)) is not None:
        yield name


def _appended_to(node: ast.AST) -> ast.Name | None:
    """The list of a statement ``x.append(item)``."""
    match node:
        case ast.Expr(ast.Call(ast.Attribute(ast.Name() as name, "append"), [item], [])):
            return None if isinstance(item, ast.Starred) else name
    return None


def without_items(script: Expression, counted: frozenset[str], *, may_fail: bool) -> Expression:
    """Return the script with ``x.append(None)`` for lists of which only the length is read.

    Of one that `may_fail`, because an error event would catch it, items are computed: ``x.append((item, None)[1])``.
    """
    tree = own_syntax_tree(script) if "append" in script.text else None
    if tree is None:
        return script
    changed = False
    for node in ast.walk(tree):
        name = _appended_to(node)
        if name is not None and name.id in counted:
            assert isinstance(node, ast.Expr)
            assert isinstance(node.value, ast.Call)
            items = node.value.args
            if not any(isinstance(part, _EFFECTS) for part in ast.walk(items[0])):
                nothing = ast.Constant(None)
                items[0] = ast.Subscript(ast.Tuple([items[0], nothing]), ast.Constant(1)) if may_fail else nothing
                changed = True
    return Expression(ast.unparse(tree), "python", script.line) if changed else script


_EFFECTS = (ast.Call, ast.Await, ast.NamedExpr, ast.Yield, ast.YieldFrom)
