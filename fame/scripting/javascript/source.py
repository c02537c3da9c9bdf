"""Sources of scripts, the JavaScript engine that checks and runs them, and its limits of memory, stack and time.

A script is checked when it is compiled. Errors point to the lines of the .bpmn file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import FunctionType
from typing import Any, Literal

from fame.bpmn.model import Expression
from fame.dataclasses import dataclass
from fame.engine.host import BpmnError
from fame.errors import ModelError
from fame.imports import require
from fame.scripting.python import source_name

MEMORY = 64 * 2**20
"""Bytes that the scripts of one process instance may hold."""

STACK = 2 * 2**20
"""Bytes of stack, over a thousand calls within calls: endless recursion ends in an error of the script."""

SECONDS = 5.0
"""Processor time of one step (s), measured for the whole process; built-in functions count, too."""

REACTIONS = 1_000_000
"""Reactions of promises in one step."""

AT_ONE_INSTANT = 100_000
"""Callbacks of one process instance at one moment."""


def new_context() -> Any:
    """Create a context with these limits, without files, network, modules or Python. Raises UnavailableError."""
    require("quickjs")
    import quickjs

    context = quickjs.Context()
    context.set_memory_limit(MEMORY)
    context.set_max_stack_size(STACK)
    context.set_time_limit(SECONDS)
    return context


@contextmanager
def reporting(context: Any) -> Iterator[None]:
    """Allow a little more memory, but less time: reporting what happened may run the script's ``toJSON``."""
    context.set_memory_limit(MEMORY + 2**20)
    context.set_time_limit(SECONDS / 10)
    try:
        yield
    finally:
        context.set_memory_limit(MEMORY)
        context.set_time_limit(SECONDS)


@cache
def failure() -> type[Exception]:
    """Return the exception that a context raises."""
    import quickjs

    raised: type[Exception] = quickjs.JSException
    return raised


def explain(text: str) -> str:
    """Return the message of the engine, naming the limit that was reached. Without memory for an
    error it throws null."""
    if text == "InternalError: interrupted":
        return f"one step of the script took more than {SECONDS:g} s"
    if text in ("InternalError: out of memory", "[uninitialized]"):
        return f"out of memory: the scripts of one process may hold {MEMORY // 2**20} MB"
    if text == "null":
        return f"null: thrown by the script, or because the {MEMORY // 2**20} MB of its process are used up"
    return text


# ---- scripts ---------------------------------------------------------------------------------------------------------


Mode = Literal["script", "expression", "statements"]

_NAMES = re.compile(r"[^\W\d][\w$]*|\$[\w$]*")
_END = re.compile(r";\s*(//[^\n]*\s*)?$")
_COMPUTED = re.compile(r"\b(?:variables(?!\s*\??\.\s*[^\W\d])|environment(?!\s*\??\.\s*[^\W\d])|eval|Function|with)\b")


@dataclass(frozen=True, slots=True, eq=False)
class SourceText:
    """A text and its place.

    mode      how it returns its result: a script by next(), an expression by its value, statements by either
    line      of the file, 1-based
    names     the identifiers in it
    computed  whether it may name variables by other means
    """

    text: str
    mode: Mode
    file: str
    line: int
    element: str
    names: frozenset[str]
    computed: bool

    @property
    def code(self) -> str:
        """JavaScript that returns the script as a function, at the same lines as in its file."""
        return f"{self.before}(function(next,environment,id,type){{return function(){self.body}}})"

    @property
    def body(self) -> str:
        return f"{{return ({self.text}\n)}}" if self.mode == "expression" else f"{{{self.text}\n}}"

    @property
    def before(self) -> str:
        """Empty lines that move it to its place in the file."""
        return "\n" * (self.line - 1)

    @property
    def last(self) -> int:
        return self.line + self.text.count("\n")


def read_script(expression: Expression, *, script: bool, file: str = "", element: str = "") -> SourceText:
    """Read and check a script, condition or value.

    Raises ModelError if it is not valid JavaScript, UnavailableError if the engine is not installed.
    """
    complaint = ""
    for mode in _modes(script):
        text = _END.sub(r"\1", expression.text) if mode == "expression" else expression.text
        names = frozenset(_NAMES.findall(text))
        found = SourceText(text, mode, file, max(1, expression.line), element, names, bool(_COMPUTED.search(text)))
        complaint = _complaint(found)
        if not complaint:
            return found
    text, _, stack = complaint.partition("\n")
    place = re.search(r"<input>:(\d+)", stack)
    line = min(int(place[1]), found.last) if place else found.line
    lines = found.text.split("\n")
    quoted = lines[line - found.line].strip() if 0 <= line - found.line < len(lines) else ""
    shown = f": `{quoted}`" if quoted else ""
    raise ModelError(
        f"not valid JavaScript: {text}{shown}", file=file, line=line if expression.line else 0, element=element
    )


def _modes(script: bool) -> Iterator[Mode]:
    if script:
        yield "script"
    else:
        yield "expression"
        yield "statements"


def _complaint(script: SourceText) -> str:
    """Return the syntax error, or an empty text. The second test rejects a text that closes the function."""
    context = new_context()
    try:
        context.eval(script.code)
        context.eval(f"{script.before}({{m(){script.body}}})")
    except (failure(), ValueError) as error:
        return str(error) or type(error).__name__
    return ""


# ---- errors ----------------------------------------------------------------------------------------------------------


_PLACE = re.compile(r"<input>:(\d+)")


class JavaScriptError(Exception):
    """A script in JavaScript failed. The text is the message of its engine."""


def thrown(description: dict[str, Any], script: SourceText) -> BaseException:
    """Return the error that a script threw or passed to next(); a BpmnError if it has a code."""
    text, code, stack = explain(str(description["text"])), description.get("code"), str(description.get("stack", ""))
    error = JavaScriptError(text) if code is None else BpmnError(str(code), text)
    return located(error, script, stack)


def _throw(error: BaseException) -> None:
    raise error


def located(error: BaseException, script: SourceText, stack: str = "") -> BaseException:
    """Return the error with a traceback into the file, at the innermost line of the stack that
    belongs to the script."""
    lines = (int(line) for line in _PLACE.findall(stack))
    line = next((line for line in lines if script.line <= line <= script.last), script.line)
    code = _throw.__code__.replace(co_filename=source_name(script.file), co_firstlineno=line - 1, co_name="<module>")
    try:
        FunctionType(code, {})(error)
    except BaseException as raised:
        return raised
    raise AssertionError("what is raised is caught")
