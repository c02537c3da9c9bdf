"""The processors of a configuration made, and chains of them applied to recorded data."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from os.path import exists
from pathlib import Path
from typing import Any

import numpy as np

from fame.config.loader import find_object, registered
from fame.config.values import join
from fame.dataclasses import replace
from fame.errors import ConfigError, FameError
from fame.monitor.pipeline.configuration import Configuration, Port, Stage
from fame.monitor.pipeline.processor import Samples, SupportsExecute, declared_parameters, output_names
from fame.monitor.pipeline.stand_in import look_up, takes_any
from fame.robot.services import MissingFileError
from fame.rooms import PROCESSORS, load
from fame.text import suggestion

FindObject = Callable[[str, Path], Any]
"""What finds the object of a name: `find_object`, or `look_up`, which runs no code of others."""


def make_processors(configuration: Configuration) -> list[Any]:
    """Make the processors of a configuration. Raises ConfigError with file, line and key path."""
    kinds = find_classes(configuration)
    made = [_make(kind, stage, configuration) for kind, stage in zip(kinds, configuration.stages, strict=True)]
    _refuse_unknown_inputs(made, configuration)
    _refuse_stale(made, configuration)
    return made


def close_processors(processors: Sequence[Any]) -> None:
    """Close what processors have opened."""
    for processor in processors:
        close = getattr(processor, "close", None)
        if close is not None:
            close()


def check_processors(configuration: Configuration) -> None:
    """Refuse processors that cannot be made, or that do not fit together, before anything runs.

    Not known are then: what code of others does not say in its text, and what files hold, which the mission itself may
    write. Raises ConfigError.
    """
    made = [_as_known(stage, configuration) for stage in _stages(configuration)]
    _refuse_unknown_inputs(made, configuration)
    assign(made, configuration)


def _as_known(stage: Stage, configuration: Configuration) -> Any:
    """A processor as far as it is known."""
    kind = _class(stage, configuration, look_up)
    if takes_any(kind):
        declared = {parameter.name for parameter in kind.parameters}
        stage = replace(stage, parameters={name: stage.parameters[name] for name in declared & stage.parameters.keys()})
    return _make(kind, stage, configuration, look_up)


def find_classes(configuration: Configuration, find: FindObject = find_object) -> list[type]:
    """Return the classes of its processors, which may need models that are not trained yet. Raises ConfigError."""
    return [_class(stage, configuration, find) for stage in _stages(configuration)]


def _stages(configuration: Configuration) -> Sequence[Stage]:
    if not configuration.stages:
        raise ConfigError("expected a processor, got none", file=str(configuration.file), element="Processor")
    return configuration.stages


def _class(stage: Stage, configuration: Configuration, find: FindObject = find_object) -> type:
    try:
        return find_class(stage.cls, configuration.folder, find)
    except ConfigError as error:
        raise _located(error, stage, "Class") from None


def _located(error: ConfigError, stage: Stage, key: str) -> ConfigError:
    located = stage.error(key, error.text)
    return MissingFileError(str(located)) if isinstance(error, MissingFileError) else located


def find_class(name: str, folder: Path, find: FindObject = find_object) -> type:
    """Find a class: a built-in name, ``module:Class``, or ``file.py:Class`` relative to a folder.

    Raises ConfigError.
    """
    if name in PROCESSORS:
        built_in: type = load(PROCESSORS[name])
        return built_in
    added = registered("fame.processors")
    name = added.get(name, name)
    if not name.replace(":", ".").rpartition(".")[0]:
        hint = suggestion(name, (*PROCESSORS, *added))
        raise ConfigError(f"expected a processor, module:Class or file.py:Class, got {name!r}; {hint}")
    found = find(name, folder)
    if not isinstance(found, type) or not callable(getattr(found, "execute", None)):
        raise ConfigError(f"expected a class with a method execute(inputs), got {name}")
    return found


def assign(processors: Sequence[Any], configuration: Configuration) -> dict[str, str] | None:
    """Map the names that the last processor computes to outputs; None if the processor does not declare them.

    Names are compared without case. A single name belongs to a single output; equal numbers of inputs and outputs are
    matched in order. Raises ConfigError for an output that no processor computes.
    """
    names: tuple[str, ...] | None = tuple(port.name for port in configuration.inputs)
    for processor in processors:
        names = output_names(processor, names)
    if names is None:
        return None
    in_order = not getattr(processors[-1], "outputs", ())
    try:
        return pair(names, configuration.outputs, type(processors[-1]).__name__, in_order)
    except ConfigError as error:
        raise configuration.source.error(error.element, error.text) from None


def pair(names: Sequence[str], outputs: Sequence[Port], who: str, in_order: bool = False) -> dict[str, str]:
    """Map computed names to outputs. Raises ConfigError for an output that no processor computes."""
    spelled = {name.lower(): name for name in names}
    if all(port.name.lower() in spelled for port in outputs):
        return {spelled[port.name.lower()]: port.name for port in outputs}
    if len(names) == len(outputs) and (in_order or len(names) == 1):
        return {name: port.name for name, port in zip(names, outputs, strict=True)}
    missing = next(port.name for port in outputs if port.name.lower() not in spelled)
    text = f"no processor computes it; {who} computes {', '.join(names) or 'nothing'}"
    raise ConfigError(text, element=f"Outputs.{missing}")


def _refuse_unknown_inputs(processors: Sequence[Any], configuration: Configuration) -> None:
    """Refuse a processor that `reads` what neither the inputs nor the processor before it give. Raises ConfigError."""
    names: tuple[str, ...] | None = tuple(port.name for port in configuration.inputs) or None
    for processor, stage in zip(processors, configuration.stages, strict=True):
        unknown = [name for name in getattr(processor, "reads", ()) if names is not None and name not in names]
        if unknown:
            raise stage.error("Parameters", f"unknown input {unknown[0]}; {suggestion(unknown[0], names or ())}")
        names = output_names(processor, names)


def _refuse_stale(processors: Sequence[Any], configuration: Configuration) -> None:
    """Compare models with the data that they were trained on, if these are present. Raises ConfigError, also for a
    section Training that does not tell which data and model these are."""
    from fame.monitor.data_files import hash_files
    from fame.monitor.pipeline.training_settings import data_and_model

    models = [(each.model, each.trained) for each in processors if getattr(each, "trained", None) is not None]
    if not models or configuration.training is None:
        return
    files, trained = data_and_model(configuration.training, configuration.folder)
    present = files and all(map(exists, files))  # a bag is a folder; without data the model was trained elsewhere
    for path, model in models:
        if present and Path(path).resolve() == Path(trained).resolve():
            model.require(path, data=hash_files(files))


def _make(kind: type[Any], stage: Stage, configuration: Configuration, find: FindObject = find_object) -> Any:
    """Make a processor; one that is given a file only if `find` may run code of others."""
    try:
        arguments = _arguments(kind, stage.parameters, configuration.folder)
        if find is look_up and any(
            each.type == "file" and each.name in arguments for each in declared_parameters(kind)
        ):
            return object.__new__(kind)
        if "folder" in inspect.signature(kind).parameters:  # classes that look for files themselves
            arguments.setdefault("folder", configuration.folder)
        return (getattr(kind, "as_known", kind) if find is look_up else kind)(**arguments)
    except ConfigError as error:
        if error.file:
            raise stage.error("Parameters", f"{error.file}: {error.text}") from None
        raise _located(error, stage, join("Parameters", error.element) if error.element else "Parameters") from None
    except FameError:
        raise
    except Exception as error:
        text = f"{stage.cls} cannot be made: {type(error).__name__}: {error}"
        raise stage.error("Parameters", text) from error


def _arguments(kind: type, given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the arguments for a class; files are relative to the folder. Raises ConfigError for an unknown one, and
    for a value that a declared one does not have."""
    declared = {parameter.name: parameter for parameter in declared_parameters(kind)}
    taken = inspect.signature(kind).parameters.values()
    names = {each.name for each in taken if each.kind is not inspect.Parameter.VAR_KEYWORD} | declared.keys()
    for name, value in given.items():
        if name not in names:
            raise ConfigError(f"unknown parameter; known are {', '.join(sorted(names)) or 'none'}", element=name)
        if name in declared:
            declared[name].convert(value)
    files = {name for name, value in given.items() if name in declared and declared[name].type == "file" and value}
    return {**given, **{name: str(folder / given[name]) for name in files}}


def run(
    processors: Sequence[SupportsExecute], inputs: Mapping[str, Samples], frequency: float = 0.0
) -> dict[str, Samples]:
    """Return what a chain of processors computes: the outputs of each are the inputs of the next.

    `frequency` (Hz) is that of the calls, as a node would make them; 0: one call with everything. A processor that
    computes the same however its samples are cut gives the same for each. Raises what a processor raises.
    """
    collected: dict[str, list[Samples]] = {}
    for part in _parts(inputs, frequency):
        for name, samples in step(processors, part).items():
            collected.setdefault(name, []).append(samples)
    return {name: _joined(parts) for name, parts in collected.items()}


def step(processors: Sequence[SupportsExecute], inputs: Mapping[str, Samples]) -> dict[str, Samples]:
    """Call a chain once. Bare values get the stamp of the latest sample that was given."""
    current = dict(inputs)
    for processor in processors:
        latest = max((float(item.stamps[-1]) for item in current.values() if len(item)), default=0.0)
        result = processor.execute(current) or {}
        current = {name: as_samples(value, latest) for name, value in result.items()}
        if not current:
            break
    return current


def as_samples(value: Any, stamp: float) -> Samples:
    """Return a result as samples: a bare value as one of that stamp. Raises ValueError for stamps that do not fit."""
    if not isinstance(value, Samples):
        return Samples(np.asarray(value)[None], np.array([stamp]))
    values, stamps = np.asarray(value.values), np.asarray(value.stamps, dtype=np.float64)
    if stamps.ndim != 1 or not values.ndim or len(values) != len(stamps):
        raise ValueError(f"it gives values of shape {values.shape} with stamps of shape {stamps.shape}")
    return Samples(values, stamps, value.names)


def _parts(inputs: Mapping[str, Samples], frequency: float) -> list[dict[str, Samples]]:
    if not frequency:
        return [dict(inputs)]
    stamps = [item.stamps for item in inputs.values() if len(item)]
    if not stamps:
        return []
    begin, end = min(float(item[0]) for item in stamps), max(float(item[-1]) for item in stamps)
    cuts = begin + (np.arange(np.floor((end - begin) * frequency) + 2) + 0.5) / frequency
    places = {name: np.searchsorted(item.stamps, cuts) for name, item in inputs.items()}
    called = np.any([np.diff(at, prepend=0) > 0 for at in places.values()], axis=0)
    parts = []
    for call in np.flatnonzero(called).tolist():  # slow samples leave most calls empty
        rows = {name: slice(int(at[call - 1]) if call else 0, int(at[call])) for name, at in places.items()}
        part = {name: item.replace(item.values[rows[name]], item.stamps[rows[name]]) for name, item in inputs.items()}
        parts.append(part)
    return parts


def _joined(parts: Sequence[Samples]) -> Samples:
    first = parts[0]
    values, stamps = ([getattr(part, field) for part in parts] for field in ("values", "stamps"))
    return Samples(np.concatenate(values), np.concatenate(stamps), first.names)
