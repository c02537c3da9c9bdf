"""Values of variables as plain data, for a journal: messages, arrays, modules, and what modules offer.

A module, or a function, class or member of an enumeration that a module offers, is stored as its name, and imported
again: what FAME gives to scripts, and what modules offer that scripts of the mission import. What a script has defined
itself cannot be stored: `refuse_unstorable` names it when a model is loaded. A value of another class that is derived
of a plain one, such as a subclass of `int`, becomes one of that.
"""

from __future__ import annotations

import math
import re
import sys
from base64 import b64decode, b64encode
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import date, datetime, timedelta
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from functools import cache
from importlib import import_module
from pathlib import Path, PosixPath
from types import ModuleType
from typing import Any

import orjson

from fame.bpmn.model import Expression
from fame.engine.data import Temporal
from fame.engine.encoding import only_plain, unstorable
from fame.errors import MissionError, ModelError
from fame.middleware import messages, typesystem
from fame.robot.mission import Mission, expressions_of
from fame.scripting import interface
from fame.scripting.effects import effects_of
from fame.scripting.python_effects import syntax_tree

_SIMPLE: dict[type, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    complex: (lambda value: [value.real, value.imag], lambda data: complex(*data)),
    bytearray: (lambda value: value.hex(), bytearray.fromhex),
    datetime: (datetime.isoformat, datetime.fromisoformat),
    date: (date.isoformat, date.fromisoformat),
    timedelta: (lambda value: [value.days, value.seconds, value.microseconds], lambda data: timedelta(*data)),
    Decimal: (str, Decimal),
    Fraction: (
        lambda value: [value.numerator, value.denominator],
        lambda data: Fraction(data) if isinstance(data, str) else Fraction(*data),  # FAME 0.2 wrote texts
    ),
    range: (lambda value: [value.start, value.stop, value.step], lambda data: range(*data)),
    deque: (lambda value: [value.maxlen, list(value)], lambda data: deque(data[1], data[0])),
    Counter: (dict, Counter),
    OrderedDict: (lambda value: list(value.items()), OrderedDict),
    defaultdict: (lambda value: [value.default_factory, dict(value)], lambda data: defaultdict(*data)),
    PosixPath: (str, Path),
    Temporal: (str, Temporal),
}
"""Types of the standard library, and of FEEL: to plain data, which may hold further values, and back."""
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


def dump(value: Any, name_of: Callable[[Any], tuple[str, str] | None] | None = None) -> Any:
    """Return plain data of a value that JSON lacks. `name_of` gives the module and name of what is stored by its
    name, None of what cannot be (by default, what any module offers can be).

    Raises MissionError for a value that cannot be stored, also if its own code fails.
    """
    try:
        return _dump(value, name_of or _offered)
    except (MissionError, MemoryError, RecursionError):
        raise
    except Exception as error:  # of the code of a library
        raise unstorable(value, f"{type(error).__name__}: {error}") from error


def _dump(value: Any, name_of: Callable[[Any], tuple[str, str] | None]) -> Any:
    if hasattr(type(value), "__msgtype__"):
        return {"message": value.__msgtype__, "value": messages.to_mapping(value)}
    simple = _SIMPLE.get(type(value))
    if simple is not None:
        return {"type": type(value).__name__, "value": simple[0](value)}
    if (isinstance(value, ModuleType | Enum) or callable(value)) and (name := name_of(value)) is not None:
        return {"module": name[0], "name": name[1]}
    if type(value).__module__ == "numpy" and (array := _array(value)):
        return array
    if isinstance(value, Mapping) and not isinstance(value, dict):
        return {"mapping": dict(value)}
    return only_plain(value)


def _array(value: Any) -> dict[str, Any] | None:
    """Data of an array or number of numpy; None for other classes, and for fields or bytes without a meaning."""
    import numpy

    single = isinstance(value, numpy.generic)
    if not (single or type(value) is numpy.ndarray) or value.dtype.kind == "V":
        return None
    plain = value.dtype.kind in "biufc"  # numbers: their bytes
    data = b64encode(value.tobytes()).decode() if plain else [value.tolist()] if single else value.tolist()
    if value.dtype.kind == "O" and numpy.array(data, dtype=object).shape != value.shape:
        return None  # lists in it would become dimensions
    shape = None if single else list(value.shape)
    return {"array": data, "type": value.dtype.str if plain else str(value.dtype), "shape": shape}


def _own_name(value: Any) -> tuple[str, str]:
    """The module of a function, class or member of an enumeration, and its name there, as it says itself; of a module
    no name."""
    if isinstance(value, ModuleType):
        return value.__name__, ""
    if isinstance(value, Enum):
        return type(value).__module__, f"{type(value).__qualname__}.{value.name}"
    return getattr(value, "__module__", None) or "", getattr(value, "__qualname__", None) or "<>"


def _offered(value: Any) -> tuple[str, str] | None:
    """The name of a module, or of what a module offers under its own name."""
    module, name = _own_name(value)
    return (module, name) if _attribute(sys.modules.get(module), name) is value else None


def _attribute(value: Any, name: str) -> Any:
    """The value at a dotted path of attributes, or None."""
    for part in name.split(".") if name else ():
        value = None if part.startswith("__") else getattr(value, part, None)
    return value


_GIVEN = {
    name: value
    for name, value in interface.ALWAYS.items()
    if (callable(value) or isinstance(value, ModuleType))
    and not name.startswith("_")
    and name not in {"compile", "eval", "exec", "open"}
}
"""What scripts find without an import and can keep. What runs a text or opens a file is not taken from a file."""
_BUILTINS = "builtins"
"""The module under which these are stored."""


class StoredValues:
    """Values of one mission as plain data, and again. Only modules that its scripts import are imported.

    lost  called with the reason why a value of a state is missing from now on
    """

    def __init__(self, mission: Mission, lost: Callable[[str], object] = lambda reason: None) -> None:
        imported = {name for script in mission.scripts() for name in effects_of(script, script=True).imports.values()}
        self._imported = sorted(imported - {"*"})
        self._packages = {name.partition(".")[0] for name in imported} | {math.__name__}
        self._lost = lost

    def dump(self, value: Any) -> Any:
        """Return plain data of a value that JSON lacks. Raises MissionError for one that cannot be stored."""
        return dump(value, self._name)

    def load(self, data: Any) -> Any:
        """Return a value of what `dump` made of it. Raises MissionError."""
        try:
            return self._load(data)
        except (MissionError, MemoryError):
            raise
        except Exception as error:  # of the code of a library
            raise MissionError(f"a value of the state cannot be read: {type(error).__name__}: {error}") from error

    def _load(self, data: Any) -> Any:
        if "mapping" in data:
            return data["mapping"]
        if "value" in data and "type" in data:
            return _BY_NAME[data["type"]](data["value"])
        if "message" in data:
            return messages.create(data["message"], data["value"])
        if "lost" in data:
            return None
        if "array" in data:
            import numpy

            kind, content, shape = data["type"], data["array"], data["shape"]
            if isinstance(content, str):
                array = numpy.frombuffer(b64decode(content), dtype=kind).copy()
            else:
                array = numpy.array(content, dtype=kind)
            return array.reshape(())[()] if shape is None else array.reshape(shape)
        if "module" not in data:  # another mapping, as FAME 0.2 wrote it
            return data
        return self._load_named(data["module"], data.get("name", ""))

    def _load_named(self, module: str, name: str) -> Any:
        """A value that is stored by its name; None, reported as lost, for one that no script can have had."""
        if not self._may_have(module, name):
            what = f"{module} {name}".rstrip()
            self._lost(f"a value of the state is lost: {what} is of no module that a script of the model imports")
            return None
        try:
            return self._resolve(module, name)
        except (ImportError, AttributeError) as error:
            raise MissionError(f"{module} {name}: cannot be imported again: {error}") from error

    def _may_have(self, module: str, name: str) -> bool:
        return module.partition(".")[0] in self._packages or (module == _BUILTINS and name in _GIVEN)

    def _resolve(self, module: str, name: str) -> Any:
        """The value that has a name. Raises ImportError or AttributeError."""
        if module == _BUILTINS and name in _GIVEN:
            return _GIVEN[name]
        found = _attribute(import_module(module), name)
        if found is None:
            raise AttributeError(f"module {module} has no {name}")
        return found

    def _name(self, value: Any) -> tuple[str, str] | None:
        """The module and name under which `_resolve` finds a value, or None.

        Many modules offer what another one has: heappush says that it is of `_heapq`, os.path is `posixpath`.
        """
        for module, name in self._names(value):
            if self._may_have(module, name):
                with suppress(Exception):  # of code of a library that makes its attributes
                    if self._resolve(module, name) is value:
                        return module, name
        return None

    def _names(self, value: Any) -> Iterator[tuple[str, str]]:
        """Names that a value may have, the likely ones first."""
        yield _own_name(value)
        own = getattr(value, "__name__", "")
        yield from ((_BUILTINS, name) for name in _GIVEN if _GIVEN[name] is value)
        for imported in self._imported:
            module, _, name = imported.rpartition(".")
            yield from ((module, name), (module, ""), (imported, own)) if name != "*" else ((module, own),)


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
