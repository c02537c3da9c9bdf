"""The settings of a training, and the section `Training` of a configuration that has them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from functools import partial
from glob import glob
from pathlib import Path
from typing import Any

from fame.config.values import ConfigValue
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.calibration import read_false_alarms
from fame.monitor.data_files import ELEMENT, TIME_UNITS, Special
from fame.monitor.pipeline.configuration import Configuration
from fame.monitor.pipeline.cycles import WITHIN
from fame.monitor.pipeline.detectors import ACTIVATIONS, RULES, ChannelAutoencoders, detector_names
from fame.monitor.pipeline.join import Join
from fame.monitor.pipeline.run_trigger import RunTrigger
from fame.monitor.tables import RUN, STAMP
from fame.text import suggestion


@dataclass(frozen=True)
class Training:
    """Settings of a training: the keys of the section `Training` of a configuration.

    files         CSV files of undisturbed runs
    model         where the model is stored
    columns       of the files; default all but stamp, run and label
    run_column    of the files, which divides them into runs; `time_column` has stamps in s, or dates, `element_column`
                  the element of the mission that is active
    exclude       columns that are not read, such as texts; and runs, as training names them (``run 7``), or by file
    rate          Hz, of rows that have no times, or other ones
    start         s since the first row of each file, from which on it is read; `end`: until where
    anomaly_column  column that is 0 in undisturbed rows; these train, it is no channel
    benign        of a file of blocks, each behind a line with its class: the class that is undisturbed
    keep          train also if runs are unlike the others, and leave out copies of runs
    join          of topics with rates of their own: the section `Join` of the configuration
    run           the trigger of runs: the section `Run` of the configuration
    time_unit     s, ms, us or ns, of numbers in `time_column`; default s, where that is not doubtful
    detector      one of `fame.monitor.pipeline.detectors`: ``pca``, ``any of autoencoder, knn`` ...; default the best
                  of some (`fame.monitor.pipeline.compare.best`). Or the class of an estimator of scikit-learn, with its
                  `parameters`: ``sklearn.ensemble.IsolationForest``
    estimator     of scikit-learn or PyOD, in memory, which is the detector
    window        samples per window
    stride        samples from one window to the next, of those that train and of those that are scored
    before        Hz, low-pass on the data; 0: none
    cutoff        Hz, low-pass on the loss; 0: none
    start_within  s, how late or early a whole run may be under `phase`
    false_alarms  rate that is asked for: ``0.01 per run`` or ``0.5 per hour``
    margin        factor on the thresholds; default 1 with a promise, 1.5 without
    folds         of the runs, for the scores that set the thresholds
    held_back     instead of folds: the part of the runs in each fold
    samples       windows that train, at most
    hidden        neurons of the layers of autoencoders between input and output
    activation    of these: relu, tanh, logistic, identity
    epochs        passes over these windows, at most
    components    part of the variance that principal components explain
    neighbours    windows that `knn` keeps, at most
    usual         set by training: of several detectors, the losses that count as 1 for each, per channel (`weighed`)
    parts         set by training: the left-out scores of each of them (runs, channels), if any raises the alarm
    share         set by a comparison: how many detectors it could choose
    """

    files: tuple[str, ...] = ()
    model: str = "model.skops"
    columns: tuple[str, ...] = ()
    run_column: str = RUN
    time_column: str = STAMP
    element_column: str = ELEMENT
    time_unit: str | None = None
    exclude: tuple[str, ...] = ()
    rate: float = 0.0
    start: float = 0.0
    end: float | None = None
    anomaly_column: str | None = None
    benign: str | None = None
    keep: bool = False
    join: Join | None = None
    run: RunTrigger | None = None
    detector: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    estimator: Any = None
    window: int = 50
    stride: int = 5
    before: float = 0.0
    cutoff: float = 0.0
    start_within: float = WITHIN
    false_alarms: str = "0.01 per run"
    margin: float | None = None
    folds: int = 5
    held_back: float | None = None
    samples: int = 20_000
    hidden: tuple[int, ...] = (16, 4, 16)
    activation: str = "tanh"
    epochs: int = 60
    components: float = 0.99
    neighbours: int = 4000
    seed: int = 0
    usual: tuple[tuple[float, ...], ...] = ()
    parts: tuple[Floats, ...] = ()
    share: int = 1

    @property
    def special(self) -> Special:
        """The columns that are no channels."""
        names = self.time_column, self.run_column, self.element_column
        end = math.inf if self.end is None else self.end
        unit, anomaly, benign = self.time_unit or "", self.anomaly_column or "", self.benign or ""
        special = Special(*names, unit, self.join, self.exclude, self.rate, self.start, end, anomaly, benign)
        return special._replace(trigger=self.run)


def section_of(configuration: Configuration) -> ConfigValue:
    """Return the section `Training` of a configuration. Raises ConfigError if it has none."""
    if configuration.training is None:
        text = "has no section Training; expected Training: {Files: [runs.csv], Model: model.skops}"
        raise ConfigError(text, file=str(configuration.file))
    return configuration.training


def training_of(section: ConfigValue, folder: Path) -> Training:
    """Read the section `Training`: keys in any case, file names and patterns relative to `folder`.

    Raises ConfigError.
    """
    given = read_settings(section)
    if "files" in given:
        items = _items(_settings(section)["files"])
        given["files"] = tuple(str(path) for item in items for path in _found(folder, item))
    if _OF_AUTOENCODERS & given.keys():  # keys that say which detector is meant
        given.setdefault("detector", ChannelAutoencoders.kind)
    return Training(**{**given, "model": str(folder / given.get("model", Training.model))})


def read_settings(section: ConfigValue) -> dict[str, Any]:
    """Return the settings of the section `Training`, and names of files as they are written. Raises ConfigError."""
    given: dict[str, Any] = {}
    for name, value in _settings(section).items():
        if name not in _READERS:
            raise value.error(f"unknown key; {suggestion(name, _READERS)}")
        given[name] = _READERS[name](value)
    return given


def data_and_model(section: ConfigValue, folder: Path) -> tuple[tuple[str, ...], str]:
    """Read from the section `Training` the files and the model alone; no files if a pattern matches none.

    Raises ConfigError.
    """
    settings = _settings(section)
    names = _items(settings["files"]) if "files" in settings else []
    found = [_matching(folder, item) for item in names]
    model = settings["model"].text() if "model" in settings else Training.model
    return tuple(str(path) for paths in found if all(found) for path in paths), str(folder / model)


def _settings(section: ConfigValue) -> dict[str, ConfigValue]:
    """Return the values of a section by the names of `Training`."""
    return {
        re.sub(r"(?<=[a-z])(?=[A-Z])", "_", key).lower().replace(" ", "_"): value
        for key, value in section.mapping().items()
    }


def _items(value: ConfigValue) -> list[ConfigValue]:
    """Return the values of a list; a single value is taken as a list of one."""
    return value.items() if isinstance(value.data, list | tuple) else [value]


def _texts(value: ConfigValue) -> tuple[str, ...]:
    return tuple(item.text() for item in _items(value))


def _detector(value: ConfigValue) -> str:
    """Read ``pca``, ``any of pca, knn`` or ``{any of: [pca, knn]}``."""
    if isinstance(value.data, dict):
        ((rule, names),) = value.mapping(RULES).items() or [("", value)]
        text = f"{rule} {', '.join(item.text() for item in names.items())}"
    else:
        text = value.text()
    try:
        detector_names(text)
    except ConfigError as error:
        raise value.error(error.text) from None
    return text


def _parameters(value: ConfigValue) -> dict[str, Any]:
    return {name: item.data for name, item in value.mapping().items()}


_READERS: Mapping[str, Callable[[ConfigValue], Any]] = {
    "files": _texts,
    "model": ConfigValue.text,
    "columns": _texts,
    "run_column": ConfigValue.text,
    "time_column": ConfigValue.text,
    "element_column": ConfigValue.text,
    "time_unit": partial(ConfigValue.choice, known=tuple(TIME_UNITS), what="a unit"),
    "window": partial(ConfigValue.integer, minimum=2),
    "hidden": lambda value: tuple(item.integer(minimum=1) for item in _items(value)),
    "activation": partial(ConfigValue.choice, known=ACTIVATIONS, what="an activation"),
    "stride": partial(ConfigValue.integer, minimum=1),
    "before": partial(ConfigValue.number, minimum=0),
    "cutoff": partial(ConfigValue.number, minimum=0),
    "start_within": partial(ConfigValue.number, minimum=0),
    "held_back": partial(ConfigValue.number, above=0, maximum=math.nextafter(1, 0)),
    "samples": partial(ConfigValue.integer, minimum=10),
    "epochs": partial(ConfigValue.integer, minimum=1),
    "margin": partial(ConfigValue.number, above=0),
    "exclude": _texts,
    "rate": partial(ConfigValue.number, minimum=0, maximum=1e6),
    "start": partial(ConfigValue.number, minimum=0),
    "end": partial(ConfigValue.number, above=0),
    "anomaly_column": ConfigValue.text,
    "benign": ConfigValue.text,
    "keep": ConfigValue.boolean,
    "detector": _detector,
    "parameters": _parameters,
    "false_alarms": read_false_alarms,
    "folds": partial(ConfigValue.integer, minimum=2),
    "components": partial(ConfigValue.number, above=0, maximum=1),
    "neighbours": partial(ConfigValue.integer, minimum=10),
    "seed": partial(ConfigValue.integer, minimum=0, maximum=2**32 - 1),
}


_OF_AUTOENCODERS = {"hidden", "activation", "epochs"}


def _matching(folder: Path, value: ConfigValue) -> list[Path]:
    """Return the file of a name, or those of a pattern, which may be none."""
    pattern = value.text()
    if not any(sign in pattern for sign in "*?["):
        return [folder / pattern]
    return sorted(folder / path for path in glob(pattern, root_dir=folder, recursive=True))


def _found(folder: Path, value: ConfigValue) -> list[Path]:
    """Return them too. Raises ConfigError if a pattern matches none."""
    if not (found := _matching(folder, value)):
        raise value.error(f"no file matches {value.text()!r} in {folder}")
    return found


def check_settings(config: Training) -> None:
    """Raise ConfigError for a value that the section would not take."""
    for name, read in _READERS.items():
        if getattr(config, name) is not None and (name != "detector" or config.detector):
            read(ConfigValue(getattr(config, name), f"Training.{name}"))
