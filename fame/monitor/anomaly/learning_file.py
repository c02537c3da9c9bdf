"""The learning file: the published keys, and four optional ones.

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
    Grid:
      reduction: [0, 5, 4, 3, 2]          tried for every classifier that Grid or its entry does not fix
      rbfsvm: {gamma: [5000, 20000], C: [100, 1000]}
    Split: {folds: 5}                     validation: contiguous runs held out; 0: none
    Threshold: 0.01                       or auto

Without Classifiers those of the paper are tried whose data are named, with reductions of their own (one-class SVM none,
RBF-SVM 3) unless another than 0 is asked for. Columns count from 0. Names of files are relative to the folder of the
learning file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from fame.config.loader import read_document
from fame.errors import ConfigError

_SECTIONS = ("Files", "Operations", "Classifiers", "Grid", "Split", "Threshold")
_FILES = ("fit_file", "unsupervised_train", "supervised_train", "testing")
_ENTRY = ("name", "class", "parameters", "reduction", "scaling", "threshold", "unique")
DEFAULTS = ("ocsvm", "rbfsvm")
"""The classifiers that are tried if none are named."""
SCALINGS = ("minmax", "standard", "none")
FOLDS = 5

Threshold = float | Literal["auto"]


@dataclass(frozen=True, slots=True)
class Source:
    """A CSV file and which of its columns count; `output` is None without labels."""

    path: Path
    inputs: tuple[int, ...]
    output: int | None


@dataclass(frozen=True, slots=True)
class Entry:
    """A classifier to try. `reduction`, `scaling`, `threshold` None: as for all."""

    name: str
    cls: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    reduction: int | None = None
    scaling: str | None = None
    threshold: Threshold | None = None
    unique: bool = False


@dataclass(frozen=True, slots=True)
class Learning:
    """A learning file."""

    file: Path
    fit: Source | None
    unsupervised: Source | None
    supervised: Source | None
    testing: tuple[Source, ...]
    reduction: int = 0
    scaling: str = "minmax"
    classifiers: tuple[Entry, ...] = ()
    grid: Mapping[str, Any] = field(default_factory=dict)
    folds: int = FOLDS
    threshold: Threshold = "auto"


def load(path: str | Path) -> Learning:
    """Read a learning file. Raises ConfigError with file, line and key path."""
    path = Path(path)
    document = read_document(path, "learning")
    try:
        return _learning(path, document.data)
    except ConfigError as error:
        if error.file:
            raise
        raise document.source.error(error.element, error.text) from None


def _learning(path: Path, text: Any) -> Learning:
    sections = _mapping(text, "", _SECTIONS)
    files = _mapping(sections.get("Files"), "Files", _FILES)
    operations = _mapping(sections.get("Operations", {}), "Operations", ("reduction", "scaling"))
    split = _mapping(sections.get("Split", {}), "Split", ("folds", "by"))
    if split.get("by", "run") != "run":
        raise ConfigError(f"found {split['by']!r}; run would be right: a run is never taken apart", element="Split.by")
    testing = files.get("testing") or []
    if not isinstance(testing, list):
        raise ConfigError(f"found {testing!r}; a list of files would be right", element="Files.testing")
    entries = sections.get("Classifiers") or []
    if not isinstance(entries, list):
        raise ConfigError(f"found {entries!r}; a list of classifiers would be right", element="Classifiers")
    classifiers = tuple(_entry(item, f"Classifiers[{number}]") for number, item in enumerate(entries))
    grid = _grid(sections.get("Grid") or {}, [entry.name for entry in classifiers] or DEFAULTS)
    folds = _whole(split.get("folds", FOLDS), "Split.folds")
    if folds == 1:
        raise ConfigError("found 1; 0 (no validation) or 2 and more would be right", element="Split.folds")
    found = [_source(path, item, f"Files.testing[{number}]") for number, item in enumerate(testing)]
    fit, unsupervised, supervised = (_source(path, files.get(key), f"Files.{key}") for key in _FILES[:3])
    if unsupervised is None and supervised is None:
        text = "names no data to learn from; unsupervised_train or supervised_train with a name would be right"
        raise ConfigError(text, element="Files")
    return Learning(
        file=path,
        fit=fit,
        unsupervised=unsupervised,
        supervised=supervised,
        testing=tuple(source for source in found if source is not None),
        reduction=_whole(operations.get("reduction", 0), "Operations.reduction"),
        scaling=_scaling(operations.get("scaling", "minmax"), "Operations.scaling"),
        classifiers=classifiers,
        grid=grid,
        folds=folds,
        threshold=_threshold(sections.get("Threshold", "auto"), "Threshold"),
    )


def _source(file: Path, value: Any, key: str) -> Source | None:
    """None for a file without a name (``Null``)."""
    if value is None:
        return None
    parts = _mapping(value, key, ("name", "input_col", "output_col"))
    if parts.get("name") is None:
        return None
    inputs = _columns(parts.get("input_col"), f"{key}.input_col")
    output = _columns(parts.get("output_col") or [], f"{key}.output_col")
    if len(output) > 1:
        raise ConfigError(f"found {list(output)}; one column would be right", element=f"{key}.output_col")
    if set(output) & set(inputs):
        text = f"found {list(inputs)}, of which {output[0]} is the label (output_col), which would give itself away"
        raise ConfigError(text, element=f"{key}.input_col")
    named = Path(str(parts["name"]))
    path = file.parent / named
    return Source(path if path.exists() or not named.exists() else named, inputs, output[0] if output else None)


def _columns(value: Any, key: str) -> tuple[int, ...]:
    if not isinstance(value, list) or not all(type(item) is int and item >= 0 for item in value):
        raise ConfigError(f"found {value!r}; a list of columns such as [0, 1, 2] would be right", element=key)
    if len(set(value)) < len(value):
        raise ConfigError(f"found {value!r}; each column once would be right", element=key)
    return tuple(value)


def _entry(value: Any, key: str) -> Entry:
    parts = _mapping(value, key, _ENTRY)
    if not parts.get("name") or not parts.get("class"):
        raise ConfigError("needs a name and a class, such as {name: rbfsvm, class: SVC}", element=key)
    reduction, threshold, unique = parts.get("reduction"), parts.get("threshold"), parts.get("unique", False)
    if not isinstance(unique, bool):
        raise ConfigError(f"found {unique!r}; true or false would be right", element=f"{key}.unique")
    return Entry(
        name=str(parts["name"]),
        cls=str(parts["class"]),
        parameters=_mapping(parts.get("parameters") or {}, f"{key}.parameters", None),
        reduction=None if reduction is None else _whole(reduction, f"{key}.reduction"),
        scaling=None if parts.get("scaling") is None else _scaling(parts["scaling"], f"{key}.scaling"),
        threshold=None if threshold is None else _threshold(threshold, f"{key}.threshold"),
        unique=unique,
    )


def _mapping(value: Any, key: str, known: Sequence[str] | None) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        right = f"a mapping with {', '.join(known)}" if known else "a mapping"
        raise ConfigError(f"found {value!r}; {right} would be right", element=key)
    unknown = [str(name) for name in value if known is not None and name not in known]
    if unknown:
        raise ConfigError(f"found the key {unknown[0]!r}; known are {', '.join(known or ())}", element=key)
    return value


def _grid(value: Any, names: Sequence[str]) -> Mapping[str, Any]:
    """Reductions to try, and for each classifier its parameters' values to try."""
    grid = _mapping(value, "Grid", ("reduction", *names))
    for name, tried in grid.items():
        if name == "reduction":
            _reductions(tried, "Grid.reduction")
            continue
        for parameter, values in _mapping(tried, f"Grid.{name}", None).items():
            key = f"Grid.{name}.{parameter}"
            if parameter == "reduction":
                _reductions(values, key)
            elif not isinstance(values, list) or not values:
                raise ConfigError(f"found {values!r}; a list of values to try would be right", element=key)
    return grid


def _reductions(value: Any, key: str) -> None:
    if not isinstance(value, list) or not value:
        raise ConfigError(f"found {value!r}; a list such as [0, 5, 4, 3, 2] would be right", element=key)
    for item in value:
        _whole(item, key)


def _scaling(value: Any, key: str) -> str:
    if value not in SCALINGS:
        raise ConfigError(f"found {value!r}; one of {', '.join(SCALINGS)} would be right", element=key)
    return str(value)


def _whole(value: Any, key: str) -> int:
    if type(value) is not int or value < 0:
        raise ConfigError(f"found {value!r}; a whole number from 0 on would be right", element=key)
    return value


def _threshold(value: Any, key: str) -> Threshold:
    if value == "auto":
        return "auto"
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < 1:
        raise ConfigError(f"found {value!r}; auto or a number from 0 to 1 would be right", element=key)
    return float(value)
