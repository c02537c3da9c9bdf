"""The learning file: the published keys, and five optional ones.

::

    Files:
      fit_file:            {name: benign.csv, input_col: [0, 1, 2, 3, 4, 5], output_col: [6]}
      unsupervised_train:  {...}
      supervised_train:    {...}          name Null: no such training
      testing:             [{...}, ...]
    Operations:
      reduction: 3                        principal components; 0: none
      scaling: minmax                     or standard, none
    Classifiers:                          scikit-learn's classes by name, and PathDetector
      - {name: rbfsvm, class: SVC, parameters: {gamma: 20000, C: 1000}, reduction: 3, threshold: 0.01}
      - {name: both, class: 'any of path, rbfsvm'}      classifiers of this file by name; or all of
    Grid:
      reduction: [0, 5, 4, 3, 2]          tried for every classifier that Grid or its candidate does not fix
      rbfsvm: {gamma: [5000, 20000], C: [100, 1000]}
    Split: {folds: 5}                     validation: contiguous runs held out; 0: none
    Threshold: 0.01                       or auto
    FalseAlarms: 0.01 per run             or 0.5 per hour: thresholds that promise it, from held-out benign runs

Without Classifiers those of the paper are tried whose data are named, with reductions of their own (one-class SVM none,
RBF-SVM 3) unless another than 0 is asked for. Columns count from 0. Names of files are relative to the folder of the
learning file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os.path import exists
from pathlib import Path
from typing import Any, Literal

from fame.config.loader import read_document
from fame.config.values import ConfigValue, entries, join
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.calibration import read_false_alarms
from fame.monitor.pipeline.detectors import split_rule

KEYS = {
    "Files": "files, with the keys below; each is `{name: FILE.csv, input_col: [0, 1], output_col: [6]}`",
    "Operations": "`{reduction: 3, scaling: minmax}`: principal components (0: none); `minmax`, `standard`, `none`",
    "Classifiers": "what is tried: `{name: rbfsvm, class: SVC, parameters: {C: 1000}, threshold: 0.01}`",
    "Grid": "values that are tried: `{reduction: [0, 3], rbfsvm: {C: [100, 1000]}}`",
    "Split": "`{folds: 5}`: contiguous runs that are held out for validation; 0: none",
    "Threshold": "of anomalous points in a task: a number from 0 to 1, or `auto`",
    "FalseAlarms": "`0.01 per run` or `0.5 per hour`: thresholds that promise it, from benign runs that are held out",
}
"""Of a learning file, with their meanings."""
FILE_KEYS = {
    "fit_file": "rows that scaling and reduction are fitted to",
    "unsupervised_train": "benign rows, for detectors without labels",
    "supervised_train": "labelled rows, for classifiers",
    "testing": "a list of labelled files to judge",
}
"""Of its section Files."""
SCALINGS = ("minmax", "standard", "none")
FOLDS = 5

Threshold = float | Literal["auto"]


@dataclass(frozen=True, slots=True)
class DataFile:
    """A CSV file, its input columns and its label column, None without labels."""

    path: Path
    inputs: tuple[int, ...]
    output: int | None


@dataclass(frozen=True, slots=True)
class CandidateClassifier:
    """A classifier to try. None for `reduction`, `scaling` or `threshold`: as for all. `place`: its entry."""

    name: str
    cls: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    reduction: int | None = None
    scaling: str | None = None
    threshold: Threshold | None = None
    unique: bool = False
    place: ConfigValue = field(default_factory=lambda: ConfigValue(None), repr=False, compare=False)

    def error(self, key: str, text: str) -> ConfigError:
        """Return an error about one of its keys, or about a default classifier."""
        if not self.place.path:
            return ConfigError(text, element=self.name)
        return self.place.source.error(join(self.place.path, key), text)

    @property
    def combined(self) -> tuple[str, tuple[str, ...]] | None:
        """The rule and the names of the classifiers that it combines; None of a classifier of its own."""
        rule, names = split_rule(self.cls)
        return (rule, names) if rule else None


DEFAULTS = (
    CandidateClassifier("ocsvm", "OneClassSVM", {"nu": 0.05, "gamma": 1000}, reduction=0, threshold=0.22, unique=True),
    CandidateClassifier(
        "rbfsvm", "SVC", {"gamma": 20000, "C": 1000, "tol": 0.01, "cache_size": 400}, reduction=3, threshold=0.01
    ),
)
"""What is tried if the file names none. Gamma is per squared unit of columns scaled to 0 ... 1."""


@dataclass(frozen=True, slots=True)
class Learning:
    file: Path
    fit: DataFile | None
    unsupervised: DataFile | None
    supervised: DataFile | None
    testing: tuple[DataFile, ...]
    reduction: int = 0
    scaling: str = "minmax"
    classifiers: tuple[CandidateClassifier, ...] = ()
    grid: Mapping[str, Any] = field(default_factory=dict)
    folds: int = FOLDS
    threshold: Threshold = "auto"
    false_alarms: str = ""


def load(path: str | Path) -> Learning:
    """Read a learning file. Raises ConfigError with file, line and key path."""
    path = Path(path)
    document = read_document(path, "learning")
    sections = document.mapping(KEYS)
    files = document.required("Files", "{unsupervised_train: {name: benign.csv, ...}}").mapping(FILE_KEYS)
    classifiers = tuple(_candidate(item) for item in _items(sections, "Classifiers"))
    fit, unsupervised, supervised = (
        _data_file(path, files[key]) if key in files else None for key in list(FILE_KEYS)[:3]
    )
    if unsupervised is None and supervised is None:
        raise sections["Files"].error("expected unsupervised_train or supervised_train with a name to learn from")
    _check_combined(sections, classifiers)
    testing = (_data_file(path, item) for item in _items(files, "testing"))
    settings = {
        **_read(entries(sections, "Operations", _OPERATIONS), _OPERATIONS),
        **_read(entries(sections, "Split", _SPLIT), _SPLIT),
    }
    settings.pop("by", None)
    if "Grid" in sections:
        settings["grid"] = _grid(sections["Grid"], [each.name for each in classifiers or DEFAULTS])
    if "Threshold" in sections:
        settings["threshold"] = _threshold(sections["Threshold"])
    if "FalseAlarms" in sections:
        settings["false_alarms"] = read_false_alarms(sections["FalseAlarms"])
    used = tuple(item for item in testing if item is not None)
    return Learning(path, fit, unsupervised, supervised, used, classifiers=classifiers, **settings)


def _check_combined(sections: Mapping[str, ConfigValue], classifiers: Sequence[CandidateClassifier]) -> None:
    """Raise ConfigError for a combination of classifiers that the file does not have."""
    own = [each.name for each in classifiers if each.combined is None]
    for value, each in zip(_items(sections, "Classifiers"), classifiers, strict=True):
        _, names = each.combined or ("", ())
        wrong = [name for name in names if name not in own]
        if wrong or len(names) == 1:
            known = ", ".join(own) or "none"
            text = f"two or more classifiers of this file ({known}), as in 'any of path, rbfsvm'"
            raise value.required("class", "SVC").expected(text)


def _read(parts: Mapping[str, ConfigValue], readers: Mapping[str, Callable[[ConfigValue], Any]]) -> dict[str, Any]:
    """Read the values of the keys that are there."""
    return {key: readers[key](value) for key, value in parts.items()}


def _by(value: ConfigValue) -> None:
    if value.data != "run":
        raise value.expected("run (runs are never split)")


def _items(sections: Mapping[str, ConfigValue], key: str) -> list[ConfigValue]:
    """Return the values of a list that may be missing or empty."""
    return sections[key].items() if key in sections and sections[key].data is not None else []


def _data_file(file: Path, value: ConfigValue) -> DataFile | None:
    """Read a candidate of Files; None for one without a name (``Null``)."""
    if value.data is None:
        return None
    parts = value.mapping(("name", "input_col", "output_col"))
    if "name" not in parts or parts["name"].data is None:
        return None
    inputs = _columns(value.required("input_col", "[0, 1, 2]"))
    output = _columns(parts["output_col"]) if "output_col" in parts and parts["output_col"].data is not None else ()
    if len(output) > 1:
        raise parts["output_col"].expected("one column")
    if set(output) & set(inputs):
        raise parts["input_col"].expected(f"columns without the label (output_col {output[0]})")
    name = Path(str(parts["name"].data))
    path = file.parent / name
    return DataFile(path if exists(path) or not exists(name) else name, inputs, output[0] if output else None)


def _columns(value: ConfigValue) -> tuple[int, ...]:
    columns = value.data
    if not isinstance(columns, list) or not all(type(item) is int and item >= 0 for item in columns):
        raise value.expected("a list of columns such as [0, 1, 2]")
    if len(set(columns)) < len(columns):
        raise value.expected("each column once")
    return tuple(columns)


def _candidate(value: ConfigValue) -> CandidateClassifier:
    parts = value.mapping(_CANDIDATE)
    value.required("name", "rbfsvm"), value.required("class", "SVC")
    given = _read({key: part for key, part in parts.items() if part.data is not None}, _CANDIDATE)
    return CandidateClassifier(cls=given.pop("class"), place=value, **given)


def _grid(value: ConfigValue, names: Sequence[str]) -> Mapping[str, Any]:
    """Read the reductions to try, and per classifier the values of its parameters to try."""
    if value.data is None:
        return {}
    grid = value.mapping(("reduction", *names))
    for name, tried in grid.items():
        for parameter, values in ({name: tried} if name == "reduction" else tried.mapping()).items():
            if not isinstance(values.data, list) or not values.data:
                example = " such as [0, 5, 4, 3, 2]" if parameter == "reduction" else ""
                raise values.expected(f"a list of values to try{example}")
            if parameter == "reduction":
                for item in values.items():
                    _reduction(item)
    return {name: tried.data for name, tried in grid.items()}


def _folds(value: ConfigValue) -> int:
    if value.integer(minimum=0) == 1:
        raise value.expected("0 (no validation) or at least 2")
    return value.integer(minimum=0)


def _threshold(value: ConfigValue) -> Threshold:
    if value.data == "auto":
        return "auto"
    if isinstance(value.data, str):
        raise value.expected("auto or a number from 0 to 1")
    return value.number(minimum=0, maximum=math.nextafter(1, 0))


_reduction = partial(ConfigValue.integer, minimum=0)
_OPERATIONS: Mapping[str, Any] = {
    "reduction": _reduction,
    "scaling": partial(ConfigValue.choice, known=SCALINGS, what="a scaling"),
}
_SPLIT: Mapping[str, Any] = {"folds": _folds, "by": _by}
_CANDIDATE: Mapping[str, Any] = {
    **_OPERATIONS,
    "name": lambda value: value.text() if isinstance(value.data, str) else str(value.data),
    "class": ConfigValue.text,
    "threshold": _threshold,
    "parameters": lambda value: {key: part.data for key, part in value.mapping().items()},
    "unique": ConfigValue.boolean,
}
