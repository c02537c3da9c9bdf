"""Topics of FAME's services: what pipelines and monitors publish and receive, as their variables and files say.

A service is at work at the call activity that calls its process, or at a service task itself. Its topics are known if
the variables that name them are constant there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from os.path import isfile
from pathlib import Path
from typing import Any

from fame.bpmn.model import FlowNode
from fame.check.expressions import constant
from fame.check.scope import CheckedProcess, CheckScope, Finding, Level
from fame.dataclasses import dataclass
from fame.errors import FameError, UnavailableError
from fame.imports import require
from fame.robot.services import MissingFileError, ServiceTopic
from fame.rooms import CONFIGURED_FILES, SERVICES, BuiltInService, load

_READ_BY = {".skops": ("sklearn", "skops"), ".onnx": ("onnxruntime",)}
"""By the ending of a learned model: the packages that read it."""
_ALIKE = 0.75
"""From which ratio of `difflib` on a name is a misspelt one."""


@dataclass(frozen=True, slots=True)
class ServicePlace:
    """Where a service is at work: a call of its process, or its task. `topics`: None if they are not known."""

    node: FlowNode
    is_call: bool
    topics: Sequence[ServiceTopic] | None
    fault: FameError | None = None
    """Why it does not start."""


def check_services(scope: CheckScope) -> Iterator[Finding]:
    """Find services whose configuration is wrong here, so that they do not start. Files may be on the robot alone."""
    for process in scope.processes:
        for place in service_places(process):
            if place.fault is not None and not scope.remote_types:
                level: Level = "warning" if isinstance(place.fault, MissingFileError) else "error"
                yield process.finding(level, f"does not start: {place.fault}", place.node)
        for node in process.nodes():
            yield from (process.finding("warning", text, node) for text in _misspelt(process, node))
        for node in () if scope.remote_types else process.nodes():
            for lacking in filter(None, map(_lacking, _variables(process, node).values())):
                yield process.finding("warning", f"cannot run here: {lacking}", node)


def _misspelt(process: CheckedProcess, node: FlowNode) -> Iterator[str]:
    """The inputs of a call or task that are almost those of its service, which does not take them."""
    called = process.called_by(node)
    at_work = [SERVICES[task.operation] for task in ((node,) if called is None else called.nodes())
               if task.operation in SERVICES]  # fmt: skip
    given = _variables(process, node) if at_work else {}
    taken = {name for service in at_work for name in service.options} - given.keys()  # required ones are missed
    for name in given:
        if meant := get_close_matches(name, taken, 1, _ALIKE):
            yield f"gives {name!r}, which its service does not take; did you mean {meant[0]!r}?"


def _lacking(value: object) -> UnavailableError | None:
    """What the file of a learned model needs that is not installed."""
    packages = _READ_BY.get(Path(value).suffix, ()) if isinstance(value, str) else ()
    try:
        require(*packages)
    except UnavailableError as error:
        return error
    return None


def service_places(process: CheckedProcess) -> Iterator[ServicePlace]:
    """Return where services of FAME are at work in a process: its calls of their processes, and its service tasks."""
    for node in process.nodes():
        called = process.called_by(node)
        for task in (node,) if called is None else called.nodes():
            service = SERVICES.get(task.operation)
            if service is not None:
                own = _variables(called or process, task)
                given = _variables(process, node) if called is not None else {}
                unset = {name for name, value in own.items() if value is None and not _may_set(process, name)}
                yield _place(
                    process,
                    node,
                    called is not None,
                    service,
                    {**{name: value for name, value in own.items() if name not in unset}, **given},
                )


def all_service_places(root: CheckedProcess) -> list[ServicePlace]:
    """Return where services of FAME are at work in a process and in all that it calls."""
    return [place for process in root.closure() for place in service_places(process)
            if process is root or place.is_call]  # fmt: skip


def served_topics(root: CheckedProcess) -> list[ServiceTopic] | None:
    """Return the topics of the services of a process and of all that it calls; None if some are not known."""
    places = all_service_places(root)
    return (
        None if any(each.topics is None for each in places) else [one for each in places for one in each.topics or ()]
    )


def named_files(root: CheckedProcess, folder: Path) -> list[str]:
    """Return the files in `folder`, or by their way from there, that the inputs of calls and service tasks of a process
    name, in all that it calls too, and those that these name if they configure a monitor."""
    values = (value for process in root.closure() for node in process.nodes()
              if process.called_by(node) is not None or node.operation in SERVICES
              for name, value in _variables(process, node).items() if name != "output")  # fmt: skip
    found = dict.fromkeys(value for value in values if isinstance(value, str) and isfile(folder / value))
    with suppress(UnavailableError):
        for name in list(found):
            found |= dict.fromkeys(load(CONFIGURED_FILES)(folder, name))
    return list(found)


def _variables(process: CheckedProcess, node: FlowNode) -> dict[str, Any]:
    """The variables that data objects and mappings give to an element: their values if constant, else None."""
    objects = (one for body in process.bodies() for one in body.data_objects) if node.data_inputs else ()
    texts = {name: text for one in objects if one.id in node.data_inputs
             for name, text in one.values if text.text.strip()}  # fmt: skip
    texts |= {item.target: item.source for item in (node.io.inputs if node.io is not None else ())}
    return {name: constant(text)[0] for name, text in texts.items()}


def _may_set(process: CheckedProcess, name: str) -> bool:
    """Whether something else than a call may give a variable to what it calls."""
    scripts = (node.script.text for node in process.nodes() if node.script is not None)
    objects = (one for body in process.bodies() for one in body.data_objects)
    return any(name in one.names for one in objects) or any(name in text for text in scripts)


def _place(
    process: CheckedProcess, node: FlowNode, call: bool, service: BuiltInService, given: Mapping[str, Any]
) -> ServicePlace:
    if not service.topics:
        return ServicePlace(node, call, ())
    try:
        return ServicePlace(node, call, load(service.topics)(process.folder, given))
    except UnavailableError:
        return ServicePlace(node, call, None)
    except FameError as error:
        return ServicePlace(node, call, None, error)
