"""The mission of a robot: its process, with everything that it refers to resolved before it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any, Literal

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Expression, FlowNode, Process
from fame.bpmn.reader.expressions import has_placeholders
from fame.bpmn.topics import TopicUse, topics_of_processes
from fame.dataclasses import dataclass, fields, is_dataclass
from fame.errors import ModelError
from fame.randomness import RANDOM_MODULES
from fame.robot.timers import Missed
from fame.scripting import ScriptTopic, effects_of
from fame.text import wrong_topic

Retry = Literal["safe", "never", "ask"]
RETRIES: tuple[Retry, ...] = ("safe", "never", "ask")
"""Policy of a task for a request whose fate is unknown: repeat it, fail with code ``lost``, or wait for a person."""
MISSED: tuple[Missed, ...] = ("fire", "skip", "fail")

ServiceFunction = Callable[[dict[str, Any]], Any]
"""The Python function of a service task: takes the variables; gives a result, or a coroutine of awaitable requests."""


_IMPORTERS = (b"import", b"exec", b"eval")
"""Every text that imports a module contains one of these."""
_WITHOUT_RANDOM = frozenset((
    "bisect", "cmath", "collections", "copy", "dataclasses", "datetime", "decimal", "enum", "fractions", "functools",
    "heapq", "itertools", "json", "math", "operator", "re", "string", "time", "typing",
))  # fmt: skip
"""Modules of Python that draw no random numbers."""


@dataclass(frozen=True, kw_only=True)
class Mission:
    """The mission of a robot.

    definitions  the file of its process
    process      the process
    library      where called processes are found
    types        qualified name of a topic -> how the model uses it
    services     Python functions for service tasks, by name
    """

    definitions: Definitions
    process: Process
    library: Library
    types: Mapping[str, TopicUse]
    services: Mapping[str, ServiceFunction]

    def processes(self) -> list[tuple[Definitions, Process]]:
        """Return the process and all that it calls, directly or not, each with its file."""
        return list(self.library.closure(self.definitions, self.process))

    def hash(self) -> str:
        """Return the hash of the texts of all these processes, whatever a version of FAME makes of them."""
        from hashlib import sha256

        found = sha256(self.process.id.encode())
        for source in dict.fromkeys(home.source for home, _ in self.processes()):
            found.update(sha256(source).digest())
        return found.hexdigest()

    @cached_property
    def files(self) -> Mapping[str, Definitions]:
        """The models of these processes by path, that of the mission first: events name them by their number."""
        return {home.file: home for home, _ in self.processes()}

    def flow_nodes(self) -> Iterator[tuple[Definitions, FlowNode]]:
        """Return the flow nodes of all these processes, each with its file."""
        return ((home, node) for home, process in self.processes() for node in process.body.walk())

    def retries(self) -> Mapping[str, Retry]:
        """Return the property ``retry`` of each element that has it: what becomes of a request
        whose fate is unknown."""
        texts = {node.id: node.properties.get("retry") for _, node in self.flow_nodes()}
        return {element: retry for element, retry in texts.items() if retry in RETRIES}

    def missed(self) -> Mapping[str, Missed]:
        """Return the property ``missed`` of each element that has it: what becomes of a timer missed by its engine."""
        texts = {node.id: node.properties.get("missed") for _, node in self.flow_nodes()}
        return {element: missed for element, missed in texts.items() if missed in MISSED}

    def scripts(self) -> Iterator[Expression]:
        """Return the texts of all its script tasks."""
        return (node.script for _, node in self.flow_nodes() if node.script is not None)

    @cached_property
    def random_modules(self) -> frozenset[str]:
        """Which of the modules `random` and `numpy` its Python code may draw from: its services, and what it imports.

        A module that FAME does not know may draw from both.
        """
        if any(node.operation for _, node in self.flow_nodes()):
            return RANDOM_MODULES
        imported = set[str]()
        for home, process in self.processes():
            source = home.source.replace(b"\0", b"")  # of UTF-16
            if any(word in source for word in _IMPORTERS):
                texts = expressions_of(process)
                imported |= {name for text in texts for name in effects_of(text, script=True).imports.values()}
        packages = frozenset(name.partition(".")[0] for name in imported) - _WITHOUT_RANDOM
        return packages if packages <= {"random"} else RANDOM_MODULES

    @cached_property
    def script_topics(self) -> tuple[tuple[Expression, ScriptTopic], ...]:
        """What its scripts name, each with its script."""
        return tuple((script, topic) for script in self.scripts() for topic in effects_of(script, script=True).topics)


def expressions_of(part: Any) -> Iterator[Expression]:
    """Yield the scripts and expressions in a part of a model."""
    if isinstance(part, Expression):
        yield part
    elif is_dataclass(part):
        for field in fields(part):
            yield from expressions_of(getattr(part, field.name))
    elif isinstance(part, Mapping):
        for item in part.values():
            yield from expressions_of(item)
    elif isinstance(part, list | tuple):
        for item in part:
            yield from expressions_of(item)


def make_mission(
    definitions: Definitions,
    process: Process,
    *,
    library: Library | None = None,
    shared: Mapping[str, TopicUse] | None = None,
    services: Mapping[str, ServiceFunction] | None = None,
) -> Mission:
    """Return the mission of one process. `shared` are the topics of the whole collaboration.

    Raises ModelError for calls of unknown processes, and for topics without exactly one type or with a wrong name.
    """
    library = library or Library()
    closure = library.closure(definitions, process)
    elsewhere = {name: use.declared for name, use in (shared or {}).items() if use.declared and name[0] == "/"}
    acknowledged = [name for name, use in (shared or {}).items() if use.ttl]
    types = topics_of_processes(closure, types=elsewhere, acknowledged=acknowledged)
    for name, use in types.items():
        computed = has_placeholders(name) or name.lstrip("~/").startswith("=")  # told when its event is compiled
        end = (*use.throws, *use.catches)[0]
        text = "" if computed else wrong_topic(name, end.topic.label)
        if text:
            raise ModelError.at(end.node, text, file=end.file)
    return Mission(definitions=definitions, process=process, library=library, types=types, services=services or {})
