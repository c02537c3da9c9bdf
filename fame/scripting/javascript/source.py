"""Scripts as they stand in the file, checked when they are compiled."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from fame.bpmn.model import Expression
from fame.errors import ModelError
from fame.scripting.javascript.limits import failure, new_context

Mode = Literal["script", "expression", "statements"]

_NAMES = re.compile(r"[^\W\d][\w$]*|\$[\w$]*")
_END = re.compile(r";\s*(//[^\n]*\s*)?$")
_COMPUTED = re.compile(r"\b(?:variables(?!\s*\??\.\s*[^\W\d])|environment(?!\s*\??\.\s*[^\W\d])|eval|Function|with)\b")


@dataclass(frozen=True, slots=True, eq=False)
class Script:
    """A text. `mode` says how it answers: a script by next(), an expression by its value, statements by either.

    `line` is that of its first line in the file, 0 if it is in none. `names` are the words in it; `computed` says that
    it may name variables by other means.
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
        """A function of what scripts find by name; it gives the script as a function.

        Before it stand as many empty lines as before the script in its file.
        """
        return f"{self.before}(function(next,environment,id,type){{return function(){self.body}}})"

    @property
    def body(self) -> str:
        """The body of a function."""
        return f"{{return ({self.text}\n)}}" if self.mode == "expression" else f"{{{self.text}\n}}"

    @property
    def before(self) -> str:
        """As many empty lines as stand before it in its file."""
        return "\n" * (self.line - 1)

    @property
    def last(self) -> int:
        """Its last line."""
        return self.line + self.text.count("\n")


def read_script(expression: Expression, *, script: bool, file: str = "", element: str = "") -> Script:
    """A script, or a condition or value. Raises ModelError if it is not JavaScript, UnavailableError without engine."""
    complaint = ""
    for mode in _modes(script):
        text = _END.sub(r"\1", expression.text) if mode == "expression" else expression.text
        names = frozenset(_NAMES.findall(text))
        found = Script(text, mode, file, max(1, expression.line), element, names, bool(_COMPUTED.search(text)))
        complaint = _complaint(found)
        if not complaint:
            return found
    text, _, stack = complaint.partition("\n")
    place = re.search(r"<input>:(\d+)", stack)
    line = min(int(place[1]), found.last) if place else found.line
    lines = found.text.split("\n")
    quoted = lines[line - found.line].strip() if 0 <= line - found.line < len(lines) else ""
    shown = f": `{quoted}`" if quoted else ""
    raise ModelError(f"not JavaScript: {text}{shown}", file=file, line=line if expression.line else 0, element=element)


def _modes(script: bool) -> Iterator[Mode]:
    if script:
        yield "script"
    else:
        yield "expression"
        yield "statements"


def _complaint(script: Script) -> str:
    """What is wrong with its syntax; empty if nothing is. The second look refuses a text that closes the function."""
    context = new_context()
    try:
        context.eval(script.code)
        context.eval(f"{script.before}({{m(){script.body}}})")
    except (failure(), ValueError) as error:
        return str(error) or type(error).__name__
    return ""
