"""Payloads that do not fit their type whatever the variables are: unknown fields, constants of another type."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from fame.bpmn.model import Expression, FlowNode, Task
from fame.check.findings import Finding, Level
from fame.check.scope import CheckedProcess
from fame.errors import MessageError, ModelError
from fame.middleware import messages
from fame.scripting import UNDEFINED
from fame.scripting.lexer import ExpressionError
from fame.scripting.python import called_name, parse_python
from fame.scripting.substitution import is_text, payload


def payload_findings(process: CheckedProcess, node: FlowNode, expression: Expression, type: str) -> Iterator[Finding]:
    """Check the payload of an event or task, unless its type is unknown."""
    if expression.text.lstrip().startswith("="):  # FEEL is computed, all of it
        return
    computed: list[str] = []
    try:
        value = payload(expression.text, lambda path, error: computed.append(path))[0]({})
    except ExpressionError:  # the compiler reports it
        return
    except Exception:  # a ${...} of constants that cannot be evaluated: no telling
        value = UNDEFINED
    if value is UNDEFINED and is_text(expression.text) and _has_fields(type):
        value = expression.text
    errors = [misfit(type, value)] if value is not UNDEFINED else []
    for error in (*(_unknown_field(type, path) for path in computed), *errors):
        if error is not None:
            yield process.finding("error", f"the payload does not fit: {error}", node, expression.line)


def publish_findings(process: CheckedProcess) -> Iterator[Finding]:
    """Check fields and literals of ``robot.publish("led", "std_msgs/msg/ColorRGBA", r=1.0)`` in scripts."""
    for node in process.bpmn.body.walk():
        if isinstance(node, Task) and node.script is not None and _publishes(node.script):
            try:
                tree = parse_python(node.script)
            except ModelError:  # the compiler reports it
                continue
            caught = {id(one) for tried in ast.walk(tree) if isinstance(tried, ast.Try) for one in _inside(tried)}
            for call in ast.walk(tree):
                if isinstance(call, ast.Call) and called_name(call) == "robot.publish" and len(call.args) == 2:
                    yield from _publish(process, node, call, "warning" if id(call) in caught else "error")


def _inside(tried: ast.Try) -> Iterator[ast.AST]:
    """The nodes whose errors a ``try`` statement may catch."""
    return (one for statement in tried.body if tried.handlers for one in ast.walk(statement))


def _publishes(script: Expression) -> bool:
    return script.language == "python" and "publish" in script.text


def _publish(process: CheckedProcess, node: FlowNode, call: ast.Call, level: Level) -> Iterator[Finding]:
    type = call.args[1]
    if not isinstance(type, ast.Constant) or not isinstance(type.value, str):
        return
    for keyword in call.keywords:
        try:
            error = misfit(type.value, {str(keyword.arg): ast.literal_eval(keyword.value)})
        except ValueError:  # not a literal
            error = _unknown_field(type.value, keyword.arg or "")
        if error is not None:
            yield process.finding(level, f"what is published does not fit: {error}", node, keyword.value.lineno)


def _has_fields(type: str) -> bool:
    """Whether only a mapping can fill it; a message with one field may be filled by a number."""
    try:
        return len(messages.fields(type)) > 1
    except MessageError:
        return False


def misfit(type: str, value: object) -> MessageError | None:
    """The error of creating a message from the value; None if it fits or the type is unknown."""
    try:
        messages.fields(type)
    except MessageError:
        return None
    try:
        messages.create(type, value)
    except MessageError as error:
        return error
    return None


def _unknown_field(type: str, path: str) -> MessageError | None:
    """The error of an unknown field (``pose.position.x``, ``points[0].x``); None if the type has it."""
    within = type
    for name in filter(None, re.sub(r"\[\d+\]", "", path).split(".")):
        try:
            known = messages.fields(within) if "/" in within else {}
        except MessageError:
            return None
        if name not in known:
            text = f"there is no such field; those of {within} are {', '.join(known) or 'none'}"
            return MessageError(text, type=type, field=path)
        within = known[name].partition("[")[0]
    return None
