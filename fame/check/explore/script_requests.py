"""How scripts fail that ask somebody: the actions and services that they wait for, and codes that they compute."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from fame.bpmn import model
from fame.check.explore.purity import waits
from fame.check.expressions import syntax_tree
from fame.scripting.requests import STILL_RUNNING

_BROAD = {"Exception", "BaseException"}
_CAUGHT_BY = {"robot.act": {"BpmnError", *_BROAD}, "robot.call": _BROAD, "wait_cancelled": {"BpmnError", *_BROAD}}
_CODES = {"robot.act": {"aborted", "canceled", "rejected"}, "robot.call": {"script"}, "wait_cancelled": {STILL_RUNNING}}


def outcomes(script: model.Expression | None) -> set[str]:
    """Return the codes with which the actions and services fail that a script waits for, and that
    it does not catch itself."""
    if script is None or script.language != "python" or not waits(script):
        return set()
    tree = syntax_tree(script)
    return set() if tree is None else set[str]().union(*(_CODES[name] for name in _asked(tree)))


def _asked(tree: ast.AST) -> Iterator[str]:
    """The keys of `_CODES` of each request whose failure leaves the script."""
    tries = [node for node in ast.walk(tree) if isinstance(node, ast.Try)]
    for name, broad in _CAUGHT_BY.items():
        inside = {id(inner) for one in tries if any(_catches(handler, broad) for handler in one.handlers)
                  for line in one.body for inner in ast.walk(line)}  # fmt: skip
        outside = (node for node in ast.walk(tree) if id(node) not in inside)
        yield from (name for node in outside if _name(node) == name)


def _name(node: ast.AST) -> str | None:
    return node.arg if isinstance(node, ast.keyword) else ast.unparse(node) if isinstance(node, ast.Attribute) else ""


def _catches(handler: ast.ExceptHandler, broad: set[str]) -> bool:
    named = {node.id for node in ast.walk(handler.type) if isinstance(node, ast.Name)} if handler.type else broad
    return bool(named & broad)


def own_codes(script: model.Expression) -> set[str] | None:
    """Return the codes that a script raises by itself; None if they are unknown."""
    if script.language != "python" or "BpmnError" not in script.text:
        return None if script.language == "javascript" else set()
    tree = syntax_tree(script)
    if tree is None:
        return None
    handlers = [one.type for one in ast.walk(tree) if isinstance(one, ast.ExceptHandler) and one.type]
    caught = {id(inner) for one in handlers for inner in ast.walk(one)}
    nodes = [one for one in ast.walk(tree) if id(one) not in caught]
    named = [one for one in nodes if isinstance(one, ast.Name) and one.id == "BpmnError"]
    calls = [one for one in nodes if isinstance(one, ast.Call) and one.func in named and one.args]
    codes = {str(one.args[0].value) for one in calls if isinstance(one.args[0], ast.Constant)}
    known = sum(isinstance(one.args[0], ast.Constant) for one in calls)
    return codes if known == len(named) else None


def computes_codes(script: model.Expression | None) -> bool:
    """Return whether a script in Python raises an error with a code that it computes."""
    return script is not None and script.language == "python" and own_codes(script) is None
