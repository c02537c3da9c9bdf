"""Choose the compiler of a text by its language, which is imported when the first text in it comes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from fame.bpmn.model import Expression
from fame.errors import ModelError
from fame.rooms import LANGUAGES, load
from fame.scripting.data import Undefined, judged
from fame.scripting.python import Code, compile_python

if TYPE_CHECKING:
    from fame.scripting.data import Parsed
    from fame.scripting.substitution import Missing

HOST_API = "__javascript__"
"""The key in ``__builtins__`` of a function that gives the interface of scripts in JavaScript."""


class JavaScriptHost(Protocol):
    """What a robot asks of the interface of its scripts in JavaScript."""

    @property
    def realms(self) -> Sequence[object]: ...
    def sweep(self) -> None: ...
    def close(self) -> None: ...


MISSING = "__missing__"
"""The key in ``__builtins__`` of a function (element, field, error), called when a payload leaves out a field."""


def compile_script(expression: Expression, *, file: str = "", element: str = "") -> Code:
    """Statements. The callable takes the variables, whose ``__builtins__`` is an `interface`, and runs the script.

    It returns None when the script is over, or a suspended script for a `Runner` if it has top-level ``await``. It
    raises what the script raises, BaseExceptions included. Raises ModelError (file, line, element) for an invalid text,
    UnavailableError for a language that is not installed.
    """
    if expression.language == "python":
        return compile_python(expression, "exec", file, element)
    if expression.language == "javascript":
        return _compile_javascript(expression, script=True, file=file, element=element)
    raise ModelError(f"a script cannot be written in {expression.language}; accepted are python and javascript",
                     file=file, line=expression.line, element=element)  # fmt: skip


def compile_expression(expression: Expression, *, file: str = "", element: str = "") -> Code:
    """Return a condition or value. The callable takes the variables and gives the value.

    Of languages ``value`` and ``payload`` it gives UNDEFINED where a name is not set, and leaves fields out; a payload
    calls `MISSING` of the variables for each. Raises ModelError and UnavailableError as `compile_script`.
    """
    if expression.language == "python":
        return compile_python(expression, "eval", file, element)
    if expression.language == "javascript":
        return _compile_javascript(expression, script=False, file=file, element=element)
    return parse_expression(expression, file=file, element=element)[0]


def _compile_javascript(expression: Expression, *, script: bool, file: str, element: str) -> Code:
    compiled: Code = load(LANGUAGES["javascript"])(expression, script=script, file=file, element=element)
    return compiled


def parse_expression(expression: Expression, *, file: str = "", element: str = "") -> Parsed:
    """As `compile_expression`, of any language that is ours; with the names that it reads, in order."""
    from fame.scripting.data import ExpressionError
    from fame.scripting.substitution import feel_payload, inside, payload, template, value

    text = expression.text
    try:
        match expression.language:
            case "template":
                return template(text)
            case "payload" if text.lstrip().startswith("="):
                text = text.lstrip().removeprefix("=")
                return feel_payload(text, _missing(element))
            case "payload":
                return payload(text, _missing(element))
            case "value" if not text.lstrip().startswith("="):
                return value(text, lambda variables, path, error: None)
            case "value" | "feel":
                text = text.lstrip().removeprefix("=")
                found: Parsed = load(LANGUAGES["feel"])(text)
            case "juel":
                text = text.strip() if inside(text.strip()) is None else str(inside(text.strip()))
                found = load(LANGUAGES["juel"])(text)
        return found._replace(evaluate=judged(found.evaluate)) if expression.condition else found
    except ExpressionError as error:
        skipped = expression.text.find(text)
        line = expression.line + expression.text[: max(0, skipped) + error.place].count("\n")
        shown = "" if expression.language == "payload" else f": `{expression.text.strip()}`"
        raise ModelError(f"{error}{shown}", file=file, line=line, element=element) from None


def _missing(element: str) -> Missing:
    def missing(variables: Mapping[str, Any], path: str, error: Undefined) -> None:
        names = variables.get("__builtins__")
        if isinstance(names, dict) and MISSING in names:
            names[MISSING](element, f"payload field {path}" if path else "payload", error)

    return missing
