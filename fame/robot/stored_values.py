"""Values of variables as plain data, for a journal: messages, arrays, modules, and what modules offer.

A module, or a function or class that a module offers, is stored as its name, and imported again. What a script has
defined itself cannot be stored: `unstorable` names it when a model is loaded.
"""

from __future__ import annotations

import ast
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from datetime import date, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from importlib import import_module
from pathlib import Path, PosixPath
from types import ModuleType
from typing import Any

from fame.bpmn.model import Expression, Task
from fame.engine.snapshot import no_data
from fame.errors import MissionError, ModelError
from fame.middleware import messages
from fame.robot.mission import Mission
from fame.scripting.analysis import code_names, identifiers_of, script_names
from fame.scripting.python import parse_python

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


def dump(value: Any) -> Any:
    """Plain data of a value that JSON does not know. Raises MissionError for one that cannot be stored."""
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
        return {"array": value.tolist(), "type": str(value.dtype), "shape": list(value.shape)}
    if isinstance(value, Mapping):
        return dict(value)
    return no_data(value)


def _is_offered(value: Any) -> bool:
    """Whether a module offers a function or class under its name."""
    found: Any = sys.modules.get(getattr(value, "__module__", None) or "")
    for name in getattr(value, "__qualname__", "<>").split("."):
        found = getattr(found, name, None)
    return found is value


class Loader:
    """Makes the values again. Only what the scripts of the mission import is imported."""

    def __init__(self, mission: Mission) -> None:
        self._packages = {name.partition(".")[0] for name in imported(mission)}

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

            return numpy.array(data["array"], dtype=data["type"]).reshape(data["shape"])
        return self._import(data["module"], data.get("name", ""))

    def _import(self, module: str, name: str) -> Any:
        if module.partition(".")[0] not in self._packages:
            raise MissionError(f"the state refers to module {module}, which no script of the model imports")
        try:
            found: Any = import_module(module)
            for part in name.split(".") if name else ():
                found = getattr(found, part)
        except (ImportError, AttributeError) as error:
            raise MissionError(f"{module} {name}: cannot be imported again: {error}") from error
        return found


def imported(mission: Mission) -> Iterator[str]:
    """The modules that the scripts of a mission import."""
    for script in mission.scripts():
        if script.language == "python":
            for node in ast.walk(parse_python(script)):
                if isinstance(node, ast.Import):
                    yield from (alias.name for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module:
                    yield node.module


def refuse_unstorable(mission: Mission) -> None:
    """Raise ModelError for a script that leaves behind what cannot be stored, and what later steps use."""
    tasks = [(home.file, node) for home, node in mission.flow_nodes() if isinstance(node, Task)]
    for file, task in tasks:
        if task.script is None:
            continue
        others = [other.script for _, other in tasks if other.script is not None and other is not task]
        for text in _left_behind(task.script, others):
            raise ModelError.at(task, f"{text}, which an engine with --state cannot store", file=file)


def _left_behind(script: Expression, others: list[Expression]) -> Iterator[str]:
    if script.language == "javascript":
        found = identifiers_of(script.text)
        if found.subscribes and not found.destroys:
            yield "creates a subscription that is still there when the script is over"
        return
    if script.language != "python":
        return
    own = code_names(script) - set(_imported_names(script))
    for name in sorted(own & {name for other in others for name in script_names(other, script=True)[0]}):
        yield f"defines {name!r}, a function or class that another script uses"


def _imported_names(script: Expression) -> Iterator[str]:
    for node in ast.walk(parse_python(script)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from (alias.asname or alias.name.partition(".")[0] for alias in node.names)
    yield "*"
