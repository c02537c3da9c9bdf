"""The variables that a text reads and writes, as far as the text tells."""

from __future__ import annotations

import ast
import symtable
from collections.abc import Iterator
from functools import lru_cache

from fame.bpmn.model import Expression
from fame.scripting.interface import interface
from fame.scripting.javascript.identifiers import words_of
from fame.scripting.languages import parse_expression
from fame.scripting.python import parse_python


@lru_cache(maxsize=1024)
def script_names(expression: Expression, *, script: bool = False) -> tuple[frozenset[str], frozenset[str]]:
    """(reads, writes): the names that it takes from the variables, and those that it sets there.

    `script`: it is statements, not an expression. Functions, classes and imports of a script are not variables, nor are
    names of the interface and builtins that it does not set (in ``${...}`` and FEEL: ``robot``). Raises ModelError if
    the text is wrong.
    """
    if expression.language == "javascript":
        words = words_of(expression.text)
        return words.reads, words.writes
    if expression.language != "python":
        return frozenset(parse_expression(expression)[1]) - {"robot"}, frozenset()
    tree = parse_python(expression, "exec" if script else "eval")
    top = symtable.symtable(ast.unparse(tree), "<script>", "exec")
    inner = _comprehended(tree)  # CPython 3.12 counts them among the names around the comprehension
    code = _code(top)
    reads, writes = set[str](), set[str]()
    for table in _tables(top):
        for symbol in table.get_symbols():
            if table is top or symbol.is_global():
                reads |= {symbol.get_name()} if symbol.is_referenced() else set()
                writes |= {symbol.get_name()} if symbol.is_assigned() else set()
    reads |= {name for name in writes if name in _augmented(tree)}
    reads, writes = reads - inner, writes - inner
    provided = interface(robot=None, signal=print, log=lambda level, text: None).keys() - writes
    return frozenset(reads - code - provided), frozenset(writes - code)


@lru_cache(maxsize=1024)
def code_names(script: Expression) -> frozenset[str]:
    """The functions, classes and modules that a script leaves for the scripts after it; ``*`` for all of a module.

    Raises ModelError if the text is wrong.
    """
    if script.language != "python":
        return frozenset()
    tree = parse_python(script)
    everything = any(isinstance(node, ast.ImportFrom) and node.names[0].name == "*" for node in ast.walk(tree))
    return _code(symtable.symtable(ast.unparse(tree), "<script>", "exec")) | ({"*"} if everything else set())


def _code(table: symtable.SymbolTable) -> frozenset[str]:
    symbols = table.get_symbols()
    return frozenset(symbol.get_name() for symbol in symbols if symbol.is_imported() or symbol.is_namespace())


def _augmented(tree: ast.AST) -> set[str]:
    """What ``x += 1`` is done to; symbol tables do not count it as read."""
    targets = (node.target for node in ast.walk(tree) if isinstance(node, ast.AugAssign))
    return {target.id for target in targets if isinstance(target, ast.Name)}


def _comprehended(tree: ast.AST) -> set[str]:
    """The names that only comprehensions bind."""
    nodes = list(ast.walk(tree))
    inner = {id(name) for node in nodes if isinstance(node, ast.comprehension) for name in ast.walk(node.target)}
    stored = [node for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return {node.id for node in stored if id(node) in inner} - {node.id for node in stored if id(node) not in inner}


def _tables(table: symtable.SymbolTable) -> Iterator[symtable.SymbolTable]:
    yield table
    for child in table.get_children():
        yield from _tables(child)
