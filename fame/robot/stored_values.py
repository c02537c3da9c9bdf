"""Values of variables as plain data, for a journal: messages, arrays, modules, and what modules offer.

A module, or a function or class that a module offers, is stored as its name, and imported again. What a script has
defined itself cannot be stored: `unstorable` names it when a model is loaded.
"""

from __future__ import annotations

import re
import sys
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from functools import cache
from importlib import import_module
from pathlib import Path, PosixPath
from types import ModuleType
from typing import Any

import orjson

from fame.bpmn.model import Expression
from fame.engine.encoding import no_data
from fame.errors import MissionError, ModelError
from fame.middleware import messages, typesystem
from fame.robot.mission import Mission, expressions_of
from fame.scripting.effects import effects_of
from fame.scripting.python_effects import syntax_tree

_SIMPLE: dict[type, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    complex: (lambda value: [value.real, value.imag], lambda data: complex(*data)),
    bytearray: (lambda value: value.hex(), bytearray.fromhex),
    datetime: (datetime.isoformat, datetime.fromisoformat),
    date: (date.isoformat, date.fromisoformat),
    timedelta: (lambda value: [value.days, value.seconds, value.microseconds], lambda data: timedelta(*data)),
    Decimal: (str, Decimal),
    Fraction: (str, Fraction),
    range: (lambda value: [value.start, value.stop, value.step], lambda data: range(*data)),
    deque: (lambda value: [value.maxlen, list(value)], lambda data: deque(data[1], data[0])),
    PosixPath: (str, Path),
}
"""Types of the standard library: to plain data, which may hold further values, and back."""
_BY_NAME = {kind.__name__: back for kind, (_, back) in _SIMPLE.items()}


def message_json(type: str, value: Any) -> bytes | None:
    """Return the JSON of a message, or of a list of messages of a type: fast; None where only `dump` can make it."""
    if not _is_encoded_directly(type):
        return None
    try:
        text = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)
    except TypeError:  # what was put into a field does not fit
        return None
    return text if b"null" not in text else None  # NaN and infinities


def plain_messages(type: str, sent: Sequence[Any]) -> Any:
    """Messages of a type as data for a record: as JSON that is encoded already, where that is possible."""
    if not messages.fields(type):
        return [None] * len(sent)
    text = message_json(type, sent)
    return orjson.Fragment(text) if text is not None else [messages.to_mapping(message) for message in sent]


@cache
def _is_encoded_directly(type: str) -> bool:
    """Whether the attributes of messages of a type have the names of its fields, so that JSON can be made of them."""
    fields = typesystem.definition(type).fields
    return bool(fields) and all(
        field.name == field.attribute
        and field.name[0] != "_"
        and (not field.is_message or _is_encoded_directly(field.base))
        for field in fields
    )


def dump(value: Any) -> Any:
    """Plain data of a value that JSON lacks. Raises MissionError for one that cannot be stored."""
    if hasattr(value, "__msgtype__"):
        return {"message": value.__msgtype__, "value": messages.to_mapping(value)}
    simple = _SIMPLE.get(type(value))
    if simple is not None:
        return {"type": type(value).__name__, "value": simple[0](value)}
    if isinstance(value, ModuleType):
        return {"module": value.__name__}
    if callable(value) and _is_offered(value):
        return {"module": value.__module__, "name": value.__qualname__}
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        plain = value.dtype.kind in "biufc"  # numbers: their bytes
        data = b64encode(value.tobytes()).decode() if plain else value.tolist()
        return {"array": data, "type": value.dtype.str if plain else str(value.dtype), "shape": list(value.shape)}
    if isinstance(value, Mapping):
        return dict(value)
    return no_data(value)


def _is_offered(value: Any) -> bool:
    """Whether a module offers a function or class under its name."""
    offered: Any = sys.modules.get(getattr(value, "__module__", None) or "")
    for name in getattr(value, "__qualname__", "<>").split("."):
        offered = getattr(offered, name, None)
    return offered is value


class Loader:
    """Restores the values. Only modules that the scripts of the mission import are imported."""

    def __init__(self, mission: Mission) -> None:
        imported = (name for script in mission.scripts() for name in effects_of(script, script=True).imports.values())
        self._packages = {name.partition(".")[0] for name in imported}

    def __call__(self, data: Any) -> Any:
        """A value of what `dump` made of it. Raises MissionError."""
        if "value" in data and "type" in data:
            return _BY_NAME[data["type"]](data["value"])
        if "message" in data:
            return messages.create(data["message"], data["value"])
        if "lost" in data:
            return None
        if "array" in data:
            import numpy

            kind, content = data["type"], data["array"]
            if isinstance(content, str):
                return numpy.frombuffer(b64decode(content), dtype=kind).reshape(data["shape"]).copy()
            return numpy.array(content, dtype=kind).reshape(data["shape"])
        return self._import(data["module"], data.get("name", ""))

    def _import(self, module: str, name: str) -> Any:
        if module.partition(".")[0] not in self._packages:
            raise MissionError(f"the state refers to module {module}, which no script of the model imports")
        try:
            imported: Any = import_module(module)
            for part in name.split(".") if name else ():
                imported = getattr(imported, part)
        except (ImportError, AttributeError) as error:
            raise MissionError(f"{module} {name}: cannot be imported again: {error}") from error
        return imported


def refuse_unstorable(mission: Mission) -> None:
    """Raise ModelError for a script that leaves behind what cannot be stored, and what later steps use."""
    texts = [(file.file, text) for file, process in mission.processes() for text in expressions_of(process)]
    for home, task in mission.flow_nodes():
        if task.script is not None:
            others = [text for _, text in texts if text is not task.script]
            for reason in _left_behind(task.script, others):
                raise ModelError.at(task, f"{reason}, which an engine with --state cannot store", file=home.file)


def _left_behind(script: Expression, others: Sequence[Expression]) -> Iterator[str]:
    effects = effects_of(script, script=True)
    if effects.calls is not None:
        if effects.calls.subscribes and not effects.calls.destroys:
            yield "creates a subscription that is still there when the script is over"
        if not effects.calls.next and re.search(r"\bsetTimeout\s*\(", script.text):
            yield "sets a timer whose callback runs when the script is over"
        functions = effects.sets & _functions_in_javascript(script.text)
    else:
        functions = effects.code - effects.imports.keys() - {"*"}
    for name in sorted(functions):
        if any(_uses(other, name) for other in others):
            yield f"defines {name!r}, a function or class that later steps use"


_FUNCTION = r"(?:async\s+)?(?:function\b|class\b|\([^()]*\)\s*=>|[\w$]+\s*=>)"
_DECLARED = re.compile(rf"\b(?:function|class)\s+([\w$]+)|\b(?:const|let|var)\s+([\w$]+)\s*=\s*{_FUNCTION}")


def _functions_in_javascript(text: str) -> frozenset[str]:
    """The properties to which a text assigns a function or class."""
    local = "|".join(re.escape(one or other) for one, other in _DECLARED.findall(text))
    value = rf"(?:{_FUNCTION}" + (rf"|(?:{local})\s*(?:[;,\n}}]|$))" if local else ")")
    return frozenset(re.findall(rf"\.\s*([\w$]+)\s*=\s*{value}", text))


def _uses(expression: Expression, name: str) -> bool:
    if syntax_tree(expression) is not None:  # None of an expression with ${...}
        return name in effects_of(expression, script=True).reads
    return re.search(rf"(?<![\w$]){re.escape(name)}(?![\w$])", expression.text) is not None
