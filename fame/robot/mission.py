"""What a robot is to do: its process, with all that is found for it before it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.topics import TopicUse, topic_table

Service = Callable[[dict[str, Any]], Any]
"""What a service task calls: a function of the variables; gives a result, or a coroutine of awaitable requests."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """What a robot is to do: a process, its file, and where called processes and topic types are found."""

    definitions: Definitions
    process: Process
    library: Library
    types: Mapping[str, TopicUse]
    services: Mapping[str, Service]


def mission(
    definitions: Definitions,
    process: Process,
    *,
    library: Library | None = None,
    shared: Mapping[str, TopicUse] | None = None,
    services: Mapping[str, Service] | None = None,
) -> Mission:
    """The mission of one process. `shared` are the topics of the whole collaboration.

    Raises ModelError for calls that lead nowhere and topics without one type.
    """
    library = library or Library()
    closure = library.closure(definitions, process)
    files = list({file.file: file for file, _ in closure}.values())
    elsewhere = {name: use.declared for name, use in (shared or {}).items() if use.declared and name[0] == "/"}
    types = topic_table(files, [called.id for _, called in closure], types=elsewhere)
    return Mission(definitions=definitions, process=process, library=library, types=types, services=services or {})
