"""Scripts and expressions in Python: compiled once, run without a Python frame in between.

The code of a text is a `functools.partial(eval, code)`: called with the variables, it runs with them as its globals. A
script that has to wait (top-level ``await``) returns a coroutine, else None. The code carries the name and the lines of
the .bpmn file, so that tracebacks point into the file.
"""

from __future__ import annotations

import ast
import dis
import re
import textwrap
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache, partial
from types import CodeType, CoroutineType, FrameType
from typing import Any, Literal

from fame.bpmn.model import Expression
from fame.engine.data import Variables
from fame.errors import ModelError
from fame.scripting.budget import count_steps

Code = Callable[[dict[str, Any]], Any]

REQUESTS = ("sleep", "receive", "until", "robot.call", "robot.act")
"""What does nothing unless it is awaited."""
_LOOKED_INTO = re.compile(r"\b(for|while|def|lambda)\b|sleep|receive|until|call|act")
"""A text without these words has no loops and no requests, so its tree is not examined."""
_LIKE_JAVASCRIPT = re.compile(
    r"\b(?:var|let|const)\s+\w|\bfunction\b\s*\w*\s*\(|=>|[=!]==|\bnew\s+\w|\bthis\.|\btypeof\b|\)\s*\{|\}\s*else\b"
)
"""Syntax of JavaScript that is not valid in Python."""
_PAST_METHODS = frozenset((dis.opmap["STORE_GLOBAL"], dis.opmap["DELETE_GLOBAL"]))


def compile_python(expression: Expression, mode: Literal["exec", "eval"], file: str = "", element: str = "") -> Code:
    """Compile to a function of the variables. Raises ModelError with the line of the file."""
    code = _code(expression, mode, file, element)
    run: Code = partial(eval, code)
    return partial(_run_and_settle, run) if _writes_past_methods(code) else run


@lru_cache(maxsize=1024)
def _code(expression: Expression, mode: Literal["exec", "eval"], file: str, element: str) -> CodeType:
    """The code of a text: each robot of a fleet compiles the same ones, and so does each of many runs."""
    flags = ast.PyCF_ALLOW_TOP_LEVEL_AWAIT if mode == "exec" else 0
    if _LOOKED_INTO.search(expression.text):
        tree = _compiled(expression, mode, file, element, ast.PyCF_ONLY_AST)
        code: CodeType = _compile_tree(tree, expression, mode, file, element, flags)
    else:
        code = _compiled(expression, mode, file, element, flags)
    return _moved(code, max(0, expression.line - 1))


def parse_python(expression: Expression, mode: Literal["exec", "eval"] = "exec") -> ast.AST:
    """Return the syntax tree of a text, with the lines of the file. Raises ModelError."""
    tree: ast.AST = _compiled(expression, mode, "", "", ast.PyCF_ONLY_AST)
    return ast.increment_lineno(tree, max(0, expression.line - 1))


def _compiled(expression: Expression, mode: Literal["exec", "eval"], file: str, element: str, flags: int) -> Any:
    """The result of `compile`, with lines counted from the first of the text."""
    make = _parsed if flags & ast.PyCF_ONLY_AST else _known
    with _located(expression, mode, file, element):
        *others, last = _readings(expression, mode)
        for each in others:
            with suppress(IndentationError):
                return make(_source(each, mode), source_name(file), mode, flags)
        return make(_source(last, mode), source_name(file), mode, flags)


def _parsed(source: str, name: str, mode: str, flags: int) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return compile(source, name, mode, flags, dont_inherit=True)


_known = lru_cache(maxsize=1024)(_parsed)
"""The same for code: a text that occurs in many places is compiled once."""


def _moved(code: CodeType, lines: int) -> CodeType:
    """The same code, moved down by a number of lines."""
    if not lines:
        return code
    consts = tuple(_moved(one, lines) if isinstance(one, CodeType) else one for one in code.co_consts)
    return code.replace(co_firstlineno=code.co_firstlineno + lines, co_consts=consts)


def _compile_tree(
    tree: ast.AST, expression: Expression, mode: Literal["exec", "eval"], file: str, element: str, flags: int
) -> CodeType:
    """The code of a text that may have loops to count or requests that are not awaited."""
    dropped = _dropped_request(tree)
    if dropped is not None:
        what, line = dropped[0], dropped[1] + max(0, expression.line - 1)
        text = f"{what}(...) does nothing unless it is awaited: await {what}(...)"
        raise ModelError(text, file=file, line=line, element=element)
    with _located(expression, mode, file, element), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        counted: Any = count_steps(tree)
        code: CodeType = compile(counted, source_name(file), mode, flags, dont_inherit=True)
    return code


def source_name(file: str) -> str:
    """Return the file name that compiled code carries."""
    return file or "<script>"


def error_line(error: BaseException, file: str = "") -> int:
    """Return the line of the .bpmn file where a script raised `error`; 0 if no script was involved."""
    line, trace = 0, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == source_name(file):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line


def error_text(error: BaseException) -> str:
    """Return the error of a script as text: ``ZeroDivisionError: division by zero``."""
    text = " ".join(str(error).split())
    name = type(error).__name__
    return f"{name}: {text}" if text else name


def _source(expression: Expression, mode: str) -> str:
    """The text as Python accepts it: dedented, expressions in parentheses."""
    text = textwrap.dedent(expression.text)
    if mode == "eval":
        before = text[: len(text) - len(text.lstrip())].count("\n")
        text = text.strip()
        text = "\n" * before + (f"({text}\n)" if "\n" in text else text)
    return text


def accepted(expression: Expression, mode: Literal["exec", "eval"]) -> tuple[str, ast.AST] | None:
    """Return the text as Python accepts it, line by line the same, and its tree; None of an invalid one."""
    for each in _readings(expression, mode):
        try:
            return (source := _source(each, mode)), _parsed(source, "", mode, ast.PyCF_ONLY_AST)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            continue
    return None


def _readings(expression: Expression, mode: str) -> Iterator[Expression]:
    """The text; if its indentation is wrong, with tabs of 8 columns, and with a first line that follows its tag."""
    yield expression
    if mode == "exec":
        text = re.sub(r"(?m)^[ \t]+", lambda indent: indent[0].expandtabs(), expression.text)
        yield Expression(text, expression.language, expression.line)
        first, _, rest = text.partition("\n")
        if first.strip() and rest.strip():
            yield Expression(f"{first.strip()}\n{textwrap.dedent(rest)}", expression.language, expression.line)


class _located:
    """Turn errors of Python into a ModelError with the line of the file."""

    def __init__(self, expression: Expression, mode: str, file: str, element: str) -> None:
        self.expression, self.condition, self.file, self.element = expression, mode == "eval", file, element

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, SyntaxError):
            first = max(1, self.expression.line)
            line = first + max(error.lineno or 1, 1) - 1
            lines = self.expression.text.split("\n")
            found = lines[min(line - first, len(lines) - 1)].strip()
            hint = _hint(self.expression.text, found, self.condition)
            text = f"{error.msg}: `{found}`{hint}" if found else error.msg
            raise ModelError(f"not valid Python: {text}", file=self.file, line=line, element=self.element) from None
        if isinstance(error, (ValueError, RecursionError, MemoryError, OverflowError)):
            raise ModelError(f"not valid Python: {error_text(error)}", file=self.file, line=self.expression.line,
                             element=self.element) from None  # fmt: skip


def _hint(text: str, line: str, condition: bool) -> str:
    """A hint for the author of a text in another language. `line` is the invalid one."""
    if _LIKE_JAVASCRIPT.search(text):
        attribute = "language" if condition else "scriptFormat"
        return f'; for JavaScript, set {attribute}="javascript"'
    if not condition:
        return ""
    if "&&" in line or "||" in line:
        return "; in Python, use `and`, `or`, `not`"
    return "; use `==` to compare" if re.search(r"[^=!<>:]=[^=]", line) else ""


def called_name(call: ast.Call) -> str:
    """Return the name of the called function or method: ``receive``, ``robot.call``; else empty."""
    return name_of(call.func)


def name_of(node: ast.AST) -> str:
    """Return a name, or one with an attribute, as it is written; of any other node an empty text."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def bound_names(tree: ast.AST) -> set[str]:
    """Return the names that a text itself defines."""
    nodes = list(ast.walk(tree))
    names = {node.id for node in nodes if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load)}
    names |= {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    names |= {node.arg for node in nodes if isinstance(node, ast.arg)}
    return names | {alias.asname or alias.name for node in nodes
                    if isinstance(node, ast.Import | ast.ImportFrom) for alias in node.names}  # fmt: skip


def _dropped_request(tree: ast.AST) -> tuple[str, int] | None:
    """The first request that is not awaited: (called name, line)."""
    bound = bound_names(tree)
    for statement in ast.walk(tree):
        for call in _results(statement.value) if isinstance(statement, ast.Expr) else ():
            called = called_name(call)
            if called in REQUESTS and called.partition(".")[0] not in bound:
                return called, call.lineno
    return None


def _results(value: ast.expr) -> Iterator[ast.Call]:
    """The calls of which an expression may give the results, as they are."""
    if isinstance(value, ast.Call):
        yield value
    parts: list[ast.expr] = [value.body, value.orelse] if isinstance(value, ast.IfExp) else []
    parts += value.values if isinstance(value, ast.BoolOp) else ()
    for part in (*parts, *(value.elts if isinstance(value, ast.Tuple | ast.List) else ())):
        yield from _results(part)


def _writes_past_methods(code: CodeType) -> bool:
    """Whether it, or a function in it, stores by STORE_GLOBAL (see `fame.engine.data.Variables`)."""
    return not _PAST_METHODS.isdisjoint(code.co_code[::2]) or any(
        _writes_past_methods(inner) for inner in code.co_consts if isinstance(inner, CodeType)
    )


def _run_and_settle(run: Code, variables: dict[str, Any]) -> Any:
    if not isinstance(variables, Variables):
        return run(variables)
    try:
        result = run(variables)
    finally:
        variables.settle()
    return _Settling(result, variables) if isinstance(result, CoroutineType) else result


class _Settling:
    """A suspended script whose variables are settled after each step."""

    __slots__ = ("_script", "_variables")

    def __init__(self, script: CoroutineType[Any, Any, Any], variables: Variables) -> None:
        self._script, self._variables = script, variables

    @property
    def cr_frame(self) -> FrameType | None:
        return self._script.cr_frame

    def send(self, value: Any) -> Any:
        return self._then_settle(self._script.send, value)

    def throw(self, error: BaseException) -> Any:
        return self._then_settle(self._script.throw, error)

    def close(self) -> None:
        self._script.close()

    def _then_settle(self, step: Callable[[Any], Any], value: Any) -> Any:
        try:
            return step(value)
        finally:
            self._variables.settle()
