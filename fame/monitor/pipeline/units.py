"""Units of a pipeline as parts of a mission: ``process``, ``record``, ``train``.

Each is made from variables, which the data object of its call activity names (models/monitoring):

configuration  a file, relative to the folder of the mission's model, or to ``models/monitoring``
parameters     of its processors, by name, as a mapping or its text (process)
namespace      that topics are relative to; the robot's, if it is not set
output         where to record, one place or several (record)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from fame.bpmn.library import BUILT_IN
from fame.config.loader import parse_document
from fame.errors import ConfigError
from fame.monitor.pipeline.configuration import Configuration, Stage, load
from fame.monitor.pipeline.loading import find_class
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.processor import declared
from fame.monitor.pipeline.recording import RecordingNode
from fame.robot.services import Around, Command, Unit, setting


def processing_unit(around: Around, variables: Mapping[str, Any]) -> Unit:
    """A processing node, until its scope ends. Raises ConfigError and MessageError."""
    configuration = load(_file(around, variables))
    configuration = _with_parameters(configuration, _parameters(variables), around.folder)
    node = ProcessingNode(
        around.middleware, around.scheduler, configuration,
        namespace=_namespace(around, variables), report=around.report,
    )  # fmt: skip
    return _Endless(node)


def record_unit(around: Around, variables: Mapping[str, Any]) -> Unit:
    """A recording node, until its scope ends; a CSV file that is there is gone on with, as its next run.

    Raises ConfigError and MessageError.
    """
    output = variables.get("output")
    outputs = output if isinstance(output, list) else [setting(variables, "output", type=str)]
    node = RecordingNode(
        around.middleware, around.scheduler, load(_file(around, variables)),
        [place if "://" in str(place) else around.folder / str(place) for place in outputs],
        namespace=_namespace(around, variables), append=True, report=around.report,
    )  # fmt: skip
    return _Endless(node)


def train_unit(around: Around, variables: Mapping[str, Any]) -> Unit:
    """``fame train`` in a process of its own: `model` is the file it made, `thresholds` one per channel."""

    def results(told: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"model": str(Path(told["model"]).resolve()), "thresholds": told["thresholds"]}

    return Command(around, ["train", str(_file(around, variables))], results)


class _Closes(Protocol):
    def close(self) -> None: ...


class _Endless:
    """A node that never ends by itself."""

    def __init__(self, node: _Closes) -> None:
        self._node = node

    def results(self) -> None:
        """It runs."""

    def close(self) -> None:
        """Leave."""
        self._node.close()


def _file(around: Around, variables: Mapping[str, Any]) -> Path:
    """The configuration. Raises ConfigError."""
    name = setting(variables, "configuration", type=str)
    places = (around.folder, *BUILT_IN)
    found = next((folder / name for folder in places if (folder / name).is_file()), None)
    if found is None:
        raise ConfigError(f"there is no configuration {name} in {', '.join(map(str, places))}")
    return found


def _parameters(variables: Mapping[str, Any]) -> Mapping[str, Any]:
    given = variables.get("parameters") or {}
    given = parse_document(given, "parameters").data if isinstance(given, str) else given
    if not isinstance(given, Mapping):
        raise ConfigError(f"found {given!r}; a mapping such as {{cutoff: 5}} would be right", element="parameters")
    return given


def _with_parameters(configuration: Configuration, given: Mapping[str, Any], folder: Path) -> Configuration:
    """Each parameter goes to the stages that have it; files are relative to `folder`. Raises ConfigError."""
    stages: list[Stage] = []
    taken: set[str] = set()
    for stage in configuration.stages:
        types = {parameter.name: parameter.type for parameter in declared(find_class(stage.cls, configuration.folder))}
        own = {
            name: str((folder / str(value)).resolve()) if types[name] == "file" else value
            for name, value in given.items()
            if name in types
        }
        taken |= own.keys()
        stages.append(replace(stage, parameters={**stage.parameters, **own}))
    left = [name for name in given if name not in taken]
    if left:
        raise ConfigError("no processor has this parameter", file=str(configuration.file), element=left[0])
    return replace(configuration, stages=tuple(stages))


def _namespace(around: Around, variables: Mapping[str, Any]) -> str:
    given = variables.get("namespace")
    return around.namespace if given is None else str(given).strip("/")
