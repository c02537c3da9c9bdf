"""The topics that a script names literally: found before it runs, so that their endpoints are made at load."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from fame.bpmn.model import Expression
from fame.scripting.python import called_name, parse_python

Direction = Literal["publish", "subscribe", "call", "act"]

_CALLS: dict[str, Direction] = {
    "receive": "subscribe",
    "robot.subscribe": "subscribe",
    "robot.latest": "subscribe",
    "robot.publish": "publish",
    "robot.call": "call",
    "robot.act": "act",
    "signal": "publish",
}
_MAKES: dict[str, Direction] = {"Publisher": "publish", "Subscription": "subscribe", "Client": "call"}
_MADE = re.compile(
    r"""\bcreate(?P<kind>Publisher|Subscription|Client)\s*\(
    \s*(?P<q>["'`])(?P<type>[\w/]+)(?P=q)\s*,\s*(?P<r>["'`])(?P<name>[\w/~]+)(?P=r)""",
    re.VERBOSE,
)


_NAMES = ("receive", "robot", "signal")
"""One of these stands in every text that names a topic."""


@dataclass(frozen=True, slots=True)
class ScriptTopic:
    """A topic as a script names it (relative to its robot), or a service or an action.

    `type` is None where the script does not say.
    """

    name: str
    direction: Direction
    type: str | None = None
    line: int = 0


@lru_cache(maxsize=1024)
def script_topics(expression: Expression) -> tuple[ScriptTopic, ...]:
    """All of them in the order of the text, each once. A signal's topic is everyone's: ``signal("done")`` is ``/done``.

    A text in Python that names none is not looked at further. Raises ModelError if one that does is wrong.
    """
    if expression.language == "javascript":
        return tuple(dict.fromkeys(_endpoints(expression)))
    if expression.language != "python" or not any(name in expression.text for name in _NAMES):
        return ()
    calls = [node for node in ast.walk(parse_python(expression)) if isinstance(node, ast.Call)]
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    found: dict[tuple[str, Direction, str | None], ScriptTopic] = {}
    for call in calls:
        topic = _topic(call)
        if topic is not None:
            found.setdefault((topic.name, topic.direction, topic.type), topic)
    return tuple(found.values())


def _endpoints(expression: Expression) -> Iterator[ScriptTopic]:
    """What a script in JavaScript makes with two literal texts: type and topic."""
    for found in _MADE.finditer(expression.text):
        kind, type, name = found["kind"], found["type"], found["name"]
        yield ScriptTopic(name, _MAKES[kind], type, expression.line + expression.text.count("\n", 0, found.start()))


def _topic(call: ast.Call) -> ScriptTopic | None:
    called = called_name(call)
    direction = _CALLS.get(called)
    name = _argument(call, 0, "name" if called == "signal" else "topic")
    if direction is None or name is None:
        return None
    if called == "signal":
        return ScriptTopic(name if name.startswith(("/", "~/")) else f"/{name}", direction, None, call.lineno)
    return ScriptTopic(name, direction, _argument(call, 1, "type"), call.lineno)


def _argument(call: ast.Call, place: int, name: str) -> str | None:
    """The literal text of an argument, if it is one."""
    given = call.args[place] if place < len(call.args) else None
    for keyword in call.keywords:
        if keyword.arg == name:
            given = keyword.value
    return given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None
