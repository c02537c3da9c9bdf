"""Models on disk: stored with skops, which holds data and never code; dataclasses as plain data and back.

A file is a mapping: its format, the versions of the packages that made it, the kind of the model and its fields
(`StoredModel`). Files of earlier formats are read (`fame.monitor.earlier_models`).

What is refused, each with its reason: a file that does not exist or is corrupt, a pickle, one that would unpack to far
more than its size, one that holds anything beyond plain data, numpy and classes of scikit-learn (it could be code), a
model of another kind, one that needs another scikit-learn, and one whose parts do not fit each other.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from types import UnionType
from typing import IO, Any, ClassVar, Self, TypeVar, get_args, get_origin, get_type_hints
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np

from fame.errors import ConfigError
from fame.imports import require
from fame.monitor.arrays import Floats, Whole
from fame.text import similar_file, writing
from fame.version import current as fame_version

_INFLATION, _SLACK = 10, 10_000_000
"""How much more than its own size a file may unpack to: times, and bytes on top. What we store is not compressed."""
_PACKAGES = ("scikit-learn", "numpy", "skops")
_HOLD_DATA = (
    "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
    "sklearn.metrics._dist_metrics.EuclideanDistance64",
    "sklearn.neighbors._ball_tree.BallTree",
    "sklearn.neighbors._kd_tree.KDTree",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.neural_network._stochastic_optimizers.SGDOptimizer",
    "sklearn.tree._tree.Tree",
)
"""Parts of scikit-learn's estimators that skops does not know, but that hold arrays and numbers only."""


def versions() -> dict[str, str]:
    """Return the versions of FAME and of the packages that a stored model depends on."""
    return {"FAME": fame_version()} | {name: version(name) for name in _PACKAGES}


def write_artefact(content: Any, path: str | Path) -> None:
    """Store plain data and estimators of scikit-learn, as a whole file or not at all; the same content gives the same
    file. Raises ConfigError for what `read_artefact` would refuse."""
    data = io.BytesIO(_skops().dumps(content))
    if unknown := _unknown(data):
        text = f"is not stored: {', '.join(unknown)} could not be read back as data; choose another classifier"
        raise ConfigError(text, file=str(path))
    with writing(path) as part:
        _write_settled(data, part)


def _write_settled(data: io.BytesIO, path: Path) -> None:
    """Write what skops dumped, without what differs from time to time: addresses in memory, by which it names parts and
    files, become numbers in their order, and the files have no date."""
    numbers: dict[str, str] = {}

    def number(found: re.Match[str]) -> str:
        return numbers.setdefault(found[0], str(len(numbers) + 1))

    with ZipFile(data) as given, ZipFile(path, "w") as settled:
        schema = re.sub(r'(?<="__id__": )\d+|(?<="file": ")\d+(?=\.)', number, given.read("schema.json").decode())
        files = {re.sub(r"^\d+(?=\.)", number, name): given.read(name) for name in given.namelist()}
        for name, content in sorted((files | {"schema.json": schema.encode()}).items()):
            settled.writestr(ZipInfo(name), content)


def _unknown(file: Any) -> list[str]:
    """List the classes in a skops file that could hold more than data."""
    return [name for name in _skops().get_untrusted_types(**_source(file)) if name not in _HOLD_DATA]


def _source(file: Path | io.BytesIO) -> dict[str, Any]:
    return {"file": file} if isinstance(file, Path) else {"data": file.getvalue()}


def read_artefact(path: Path, maker: str) -> Any:
    """Read what `write_artefact` stored, by the command `maker`. Raises ConfigError if it is not there, corrupt, or
    holds anything that could run."""
    if path.is_dir():
        raise ConfigError(f"expected a file of {maker}, got a folder", file=str(path))
    if not path.is_file():
        raise ConfigError(f"there is no such file{similar_file(path)}", file=str(path))
    if _is_pickle(path):
        text = f"is corrupt, or no model of {maker}: it is a pickle, refused since reading one runs what it holds"
        raise ConfigError(text, file=str(path))
    most = _INFLATION * path.stat().st_size + _SLACK
    try:
        total = _unpacked(path, most)
    except (OSError, BadZipFile, NotImplementedError, RuntimeError, ValueError) as error:
        text = f"is corrupt, or no model of {maker} ({type(error).__name__})"
        raise ConfigError(text, file=str(path)) from None
    if total > most:
        text = f"refused: it would unpack to {total / 1e6:.0f} MB; at most {most / 1e6:.0f} MB are taken of its size"
        raise ConfigError(text, file=str(path))
    _skops()  # where it is missing, that is said, and not that the file is corrupt
    try:
        unknown = _unknown(path)
    except Exception as error:  # on a foreign file, skops raises any exception of its parts
        text = f"is corrupt, or no model of {maker} ({type(error).__name__})"
        raise ConfigError(text, file=str(path)) from None
    if unknown:
        text = f"refused: it contains code or unknown classes ({', '.join(unknown)}); a model holds data only"
        raise ConfigError(text, file=str(path))
    try:
        return _skops().load(path, trusted=list(_HOLD_DATA))
    except Exception as error:
        raise ConfigError(f"is corrupt ({type(error).__name__}: {error})", file=str(path)) from None


def _is_pickle(path: Path) -> bool:
    """Return whether it is a pickle, by its first bytes or by its name: some of joblib and Python 2 have no mark."""
    with suppress(OSError), path.open("rb") as stream:
        mark = stream.read(4)
        named = path.suffix in (".pkl", ".pickle", ".joblib") and mark != b"PK\3\4"  # a skops file may have any name
        return named or (mark[:1] == b"\x80" and mark[1:2] in b"\2\3\4\5")
    return False


FORMAT = "fame-monitor-3"
"""Of stored models."""
_PARTS_DO_NOT_FIT = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


class StoredModel:
    """What every model has: a detector that is stored with it, the versions of the packages that made it.

    maker       the command that makes it
    estimators  whether its detector may be one of scikit-learn's, which another version of it cannot read
    detectors   kinds of detectors that it may have, by name
    """

    __slots__ = ()
    kind: ClassVar[str]
    maker: ClassVar[str]
    estimators: ClassVar[bool] = False
    detectors: ClassVar[Mapping[str, Any]]

    def check(self) -> None:
        """Raise ValueError or another error if its parts do not fit each other."""

    def to_plain(self) -> dict[str, Any]:
        """Return all values as plain data and arrays, as they are stored."""
        plain = to_plain(self)
        return {**plain, "format": FORMAT, "versions": plain["versions"] or versions()}

    def save(self, path: str | Path) -> None:
        """Store it. Raises ConfigError for what could not be read back."""
        write_artefact(self.to_plain(), path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a model. Raises ConfigError for each of the reasons above."""
        return cls.of(read_model(Path(path), cls.maker), str(path))

    @classmethod
    def of(cls, content: Mapping[str, Any], file: str) -> Self:
        """Return the model that `to_plain` described. Raises ConfigError for each of the reasons above."""
        if content.get("kind") != cls.kind:
            text = f"is a model of another command; expected one of {cls.maker}, which makes it anew"
            raise ConfigError(text, file=file)
        try:
            if cls.estimators or "estimator" in content["detector"]:
                _refuse_other_estimators(content.get("versions"), cls.maker, file)
            model = from_plain(cls, {**content, "detector": detector_of(content["detector"], cls.detectors)})
            model.check()
        except _PARTS_DO_NOT_FIT as error:
            raise ConfigError(f"is damaged: {error!r}", file=file) from None
        return model


def _refuse_other_estimators(stated: Any, maker: str, file: str) -> None:
    """Raise ConfigError for estimators of another scikit-learn than the one here."""
    made = stated.get("scikit-learn", "unknown") if isinstance(stated, dict) else "unknown"
    ours = version("scikit-learn")
    if made.split(".")[:2] != ours.split(".")[:2]:
        text = f"was made with scikit-learn {made}, here is {ours}: {maker} makes it anew"
        raise ConfigError(f"{text}, or install scikit-learn {made}", file=file)


def detector_of(plain: Mapping[str, Any], kinds: Mapping[str, Any]) -> Any:
    """Return the detector, or several in one, that `to_plain` described. Raises KeyError, TypeError or ValueError."""
    parts = {"parts": [detector_of(part, kinds) for part in plain["parts"]]} if "parts" in plain else {}
    return from_plain(kinds[plain["kind"]], {**plain, **parts})


def read_model(path: Path, maker: str) -> dict[str, Any]:
    """Read the content of a model of any kind, that of an earlier format as it would be stored now. Raises ConfigError
    for any other file."""
    from fame.monitor.earlier_models import EARLIER

    content = read_artefact(path, maker)
    found = content.get("format") if isinstance(content, dict) else None
    if isinstance(found, str) and found in EARLIER:
        try:
            return EARLIER[found](content)
        except _PARTS_DO_NOT_FIT as error:
            raise ConfigError(f"is damaged: {error!r}", file=str(path)) from None
    if found != FORMAT:
        text = f"is not a model of {maker}: expected format {FORMAT!r}, got {found!r}; {maker} makes it anew"
        raise ConfigError(text, file=str(path))
    return dict(content)


Stored = TypeVar("Stored")


def to_plain(value: Any) -> Any:
    """Return a dataclass as a mapping of its fields, with its `kind` if it has one, sequences as lists, arrays as they
    are."""
    if is_dataclass(value):
        kind = {"kind": value.kind} if hasattr(value, "kind") else {}
        return kind | {item.name: to_plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {name: to_plain(item) for name, item in value.items()}
    if isinstance(value, (tuple, list)):
        return list(map(to_plain, value))
    return value.item() if isinstance(value, np.generic) else value


def from_plain(cls: type[Stored], plain: Mapping[str, Any]) -> Stored:
    """Make the dataclass that `to_plain` described, each value of the type of its field; what has a default may be
    missing. Raises KeyError, TypeError or ValueError for anything else."""
    if getattr(cls, "kind", None) != plain.get("kind"):
        raise ValueError(f"expected the kind {getattr(cls, 'kind', None)!r}, got {plain.get('kind')!r}")
    required = (item.name for item in fields(cls) if item.default is item.default_factory is MISSING)  # type: ignore[arg-type]
    names = {*required, *(item.name for item in fields(cls) if item.name in plain)}  # type: ignore[arg-type]
    return cls(**{name: _as(kind, plain[name]) for name, kind in get_type_hints(cls).items() if name in names})


def _as(kind: Any, value: Any) -> Any:
    """Return a plain value as one of a type; types that are not known here take it as it is."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return None if value is None else _as(parts[0], value)
    if kind in (Floats, Whole):
        numbers = np.asarray(value, dtype=np.float64 if kind == Floats else np.int64)
        if not np.isfinite(numbers).all():
            raise ValueError("values that are not finite")
        return numbers
    if origin is tuple:
        return tuple(_as(parts[0], item) for item in value)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {str(name): _as(parts[1], item) for name, item in value.items()}
    if is_dataclass(kind) and isinstance(value, Mapping):
        return from_plain(kind, value)  # type: ignore[arg-type]
    return kind(value) if kind in (int, float, str) else value


def _unpacked(file: Path | IO[bytes], most: int) -> int:
    """Return the size of the content of a zip file (bytes) by its directory, which bounds what a reader unpacks.

    Nested archives (sparse matrices) count as well; they are not opened once the sum is over `most`.
    """
    with ZipFile(file) as packed:
        total = sum(member.file_size for member in packed.infolist())
        for name in packed.namelist():
            if total <= most and name.endswith(".npz"):
                with packed.open(name) as inner:
                    total += _unpacked(inner, most - total)
        return total


def _skops() -> Any:
    require("sklearn", "skops")
    import skops.io

    return skops.io
