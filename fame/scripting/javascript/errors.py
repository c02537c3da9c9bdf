"""What goes wrong in a script: the error, with a traceback that points into the .bpmn file as those of Python do."""

from __future__ import annotations

import re
from typing import Any

from fame.engine.host import BpmnError
from fame.scripting.javascript.limits import explain
from fame.scripting.javascript.source import Script
from fame.scripting.python import source_name

_PLACE = re.compile(r"<input>:(\d+)")


class JavaScriptError(Exception):
    """A script in JavaScript failed; the text is what its engine says."""


def thrown(description: dict[str, Any], script: Script) -> BaseException:
    """The error that a script threw or gave to next(). One with a code is a BpmnError."""
    text, code, stack = explain(str(description["text"])), description.get("code"), str(description.get("stack", ""))
    error = JavaScriptError(text) if code is None else BpmnError(str(code), text)
    return located(error, script, stack)


def located(error: BaseException, script: Script, stack: str = "") -> BaseException:
    """The error as if it had been raised in the file, at the innermost place of the stack that is in the script."""
    lines = (int(line) for line in _PLACE.findall(stack))
    line = next((line for line in lines if script.line <= line <= script.last), script.line)
    try:
        exec(compile("\n" * (line - 1) + "raise error", source_name(script.file), "exec"), {"error": error})
    except BaseException as raised:
        return raised
    raise AssertionError("what is raised is caught")
