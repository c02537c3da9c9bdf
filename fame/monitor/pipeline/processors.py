"""The processors that come with FAME, by the name that a configuration gives as `Class`.

Processors made from a configuration: classes by name, parameters checked, outputs given to who computes them."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.errors import ConfigError, FameError
from fame.monitor.pipeline.configuration import Configuration, Port, Stage
from fame.monitor.pipeline.estimators import Autoencoder, Estimator
from fame.monitor.pipeline.filters import LowPass, Resample, Scale
from fame.monitor.pipeline.polled_source import Machine
from fame.monitor.pipeline.processor import computed, declared
from fame.monitor.pipeline.threshold import Expression, Threshold
from fame.monitor.pipeline.user_code import find_object
from fame.monitor.pipeline.windows import RMS, MovingStatistics, Spectrum, Window

PROCESSORS: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        LowPass, Resample, Scale, Window, RMS, MovingStatistics, Spectrum,
        Estimator, Autoencoder, Threshold, Expression, Machine,
    )
}  # fmt: skip

__all__ = [
    "PROCESSORS",
    "RMS",
    "Autoencoder",
    "Estimator",
    "Expression",
    "LowPass",
    "Machine",
    "MovingStatistics",
    "Resample",
    "Scale",
    "Spectrum",
    "Threshold",
    "Window",
]


def make_processors(configuration: Configuration) -> list[Any]:
    """The processors of a configuration. Raises ConfigError with the path of the key."""
    made = []
    for number, stage in enumerate(configuration.stages):
        key = "Processor" if len(configuration.stages) == 1 else f"Processor[{number}]"
        made.append(_made(stage, configuration, key))
    if not made:
        raise ConfigError("names no Processor, and none was given", file=str(configuration.file), element="Processor")
    _refuse_stale(made, configuration)
    return made


def find_class(name: str, folder: Path) -> type:
    """A class: one that comes with FAME, ``module:Class``, or ``file.py:Class`` relative to a folder.

    Raises ConfigError.
    """
    if name in PROCESSORS:
        return PROCESSORS[name]
    if not name.replace(":", ".").rpartition(".")[0]:
        raise ConfigError(f"no processor {name!r}; there are {', '.join(PROCESSORS)}, or module:Class, file.py:Class")
    found = find_object(name, folder)
    if not isinstance(found, type) or not callable(getattr(found, "execute", None)):
        raise ConfigError(f"{name} is no processor: a class with a method execute(inputs) would be right")
    return found


def assign(processors: Sequence[Any], configuration: Configuration) -> dict[str, str] | None:
    """Which name that the last processor computes goes to which output; None if it does not say what it computes.

    Names count without capitals; a single one of each belongs together, and so do inputs and outputs of equal number
    in their order. Raises ConfigError for an output that nobody computes.
    """
    names: tuple[str, ...] | None = tuple(port.name for port in configuration.inputs)
    for processor in processors:
        names = computed(processor, names)
    if names is None:
        return None
    in_order = not getattr(processors[-1], "outputs", ())
    return pair(names, configuration.outputs, type(processors[-1]).__name__, str(configuration.file), in_order)


def pair(names: Sequence[str], outputs: Sequence[Port], who: str, file: str, in_order: bool = False) -> dict[str, str]:
    """Computed name -> output. Raises ConfigError for an output that nobody computes."""
    spelled = {name.lower(): name for name in names}
    if all(port.name.lower() in spelled for port in outputs):
        return {spelled[port.name.lower()]: port.name for port in outputs}
    if len(names) == len(outputs) and (in_order or len(names) == 1):
        return {name: port.name for name, port in zip(names, outputs, strict=True)}
    missing = next(port.name for port in outputs if port.name.lower() not in spelled)
    text = f"nobody computes it; {who} computes {', '.join(names) or 'nothing'}"
    raise ConfigError(text, file=file, element=f"Outputs.{missing}")


def _refuse_stale(processors: Sequence[Any], configuration: Configuration) -> None:
    """Where the data that a model was trained on are at hand, they must be those. Raises ConfigError."""
    from fame.monitor.pipeline.train import training_of
    from fame.monitor.tables import hash_files

    models = [(each.model, each.trained) for each in processors if getattr(each, "trained", None) is not None]
    if not models or configuration.training is None:
        return
    try:
        training = training_of(configuration.training, configuration.folder)
    except ConfigError:
        return  # no data here: the model was trained elsewhere
    present = training.files and all(Path(file).is_file() for file in training.files)
    for path, model in models:
        if present and Path(path).resolve() == Path(training.model).resolve():
            model.require(path, data=hash_files(training.files))


def _made(stage: Stage, configuration: Configuration, key: str) -> Any:
    file = str(configuration.file)
    try:
        kind = find_class(stage.cls, configuration.folder)
    except ConfigError as error:
        raise ConfigError(error.text, file=file, element=f"{key}.Class") from None
    try:
        arguments = _arguments(kind, stage.parameters, configuration.folder)
        if "folder" in inspect.signature(kind).parameters:  # who looks for files itself
            arguments.setdefault("folder", configuration.folder)
        return kind(**arguments)
    except ConfigError as error:
        element = f"{key}.Parameters" + (f".{error.element}" if error.element and not error.file else "")
        at = f"{error.file}: " if error.file else ""
        raise ConfigError(f"{at}{error.text}", file=file, element=element) from None
    except FameError:
        raise
    except Exception as error:
        text = f"{stage.cls} cannot be made: {type(error).__name__}: {error}"
        raise ConfigError(text, file=file, element=f"{key}.Parameters") from error


def _arguments(kind: type, given: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Parameters as they are handed to a class: known ones, files found from the folder. Raises ConfigError."""
    types = {parameter.name: parameter.type for parameter in declared(kind)}
    taken = inspect.signature(kind).parameters.values()
    names = {each.name for each in taken if each.kind is not inspect.Parameter.VAR_KEYWORD} | types.keys()
    for name in given:
        if name not in names:
            raise ConfigError(
                f"there is no such parameter; there are {', '.join(sorted(names)) or 'none'}", element=name
            )
    files = {name: str(folder / value) for name, value in given.items() if types.get(name) == "file" and value}
    return {**given, **files}
