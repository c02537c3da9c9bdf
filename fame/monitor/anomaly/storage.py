"""DataPersist, and model files: stored with skops, which holds data and never code.

A model file names its format and the packages that made it. What is refused, each with its reason: a file that is no
model, one that holds anything beyond plain data, numpy and scikit-learn's own classes (it could be code), one of
another format or of another scikit-learn, one whose parts do not fit. What was processed from data is stored under the
hash of that data, and not taken again for any other.
"""

from __future__ import annotations

import hashlib
import io
import re
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np

from fame.errors import ConfigError, UnavailableError
from fame.monitor.anomaly.model import Model
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.process import DataProcess
from fame.monitor.anomaly.recording import Recording

FORMAT = "fame-adm-1"
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


def data_hash(*recordings: Recording) -> str:
    """SHA-256 of the values, labels and runs of recordings."""
    digest = hashlib.sha256()
    for recording in recordings:
        for part in (recording.values, recording.labels, recording.runs):
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Of the packages that a stored model depends on."""
    return {name: version(name) for name in _PACKAGES}


def save_model(model: Model, path: str | Path) -> None:
    """Store a model."""
    estimator = model.estimator
    process = model.process
    content = {
        "format": FORMAT,
        "versions": versions(),
        "name": model.name,
        "joints": list(model.joints),
        "estimator": estimator.to_plain() if isinstance(estimator, PathDetector) else estimator,
        "process": None if process is None else [process.reduction, process.scaling, process.scaler, process.pca],
        "threshold": float(model.threshold),
        "nominal": int(model.nominal),
        "reference": model.reference,
        "data": model.data,
    }
    write_artefact(content, path)


def load_model(path: str | Path) -> Model:
    """Read a stored model. Raises ConfigError, for each of the reasons above."""
    content = read_artefact(Path(path), "fame adm learn")
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise ConfigError(
            f"is no model of fame adm learn: found format {found!r}, {FORMAT!r} would be right", file=str(path)
        )
    stated = content.get("versions")
    made = stated.get("scikit-learn", "unknown") if isinstance(stated, dict) else "unknown"
    ours = version("scikit-learn")
    if made.split(".")[:2] != ours.split(".")[:2]:
        text = f"was made with scikit-learn {made}, here is {ours}: learn it again, or install scikit-learn {made}"
        raise ConfigError(text, file=str(path))
    try:
        model = _model(content)
        model.scorer().step(model.reference[0].tolist())  # its parts fit each other
        return model
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise ConfigError(f"is damaged: {error!r}", file=str(path)) from None


def write_artefact(content: Any, path: str | Path) -> None:
    """Store plain data and estimators of scikit-learn, as a whole file or not at all; the same content gives the same
    file. Raises ConfigError for what `read_artefact` would refuse."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    data = io.BytesIO(_skops().dumps(content))
    if unknown := _unknown(data):
        text = f"is not stored: {', '.join(unknown)} could not be read back as data; another classifier would be right"
        raise ConfigError(text, file=str(path))
    whole = path.with_name(f".{path.name}.part")
    _write_settled(data, whole)
    whole.replace(path)


def _write_settled(data: io.BytesIO, path: Path) -> None:
    """What skops dumped, without what differs from time to time: addresses in memory, by which it names parts and
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
    """The classes in what skops stored that could hold more than data."""
    return [name for name in _skops().get_untrusted_types(**_source(file)) if name not in _HOLD_DATA]


def _source(file: Path | io.BytesIO) -> dict[str, Any]:
    return {"file": file} if isinstance(file, Path) else {"data": file.getvalue()}


def read_artefact(path: Path, maker: str) -> Any:
    """What `write_artefact` stored, by the command `maker`. Raises ConfigError if it is not there, corrupt, or holds
    anything that could run."""
    if not path.is_file():
        raise ConfigError("there is no such file", file=str(path))
    most = _INFLATION * path.stat().st_size + _SLACK
    try:
        total = _unpacked(path, most)
    except (OSError, BadZipFile, NotImplementedError, RuntimeError, ValueError) as error:
        text = f"is corrupt, or no model of {maker} ({type(error).__name__})"
        raise ConfigError(text, file=str(path)) from None
    if total > most:
        text = f"refused: it would unpack to {total / 1e6:.0f} MB; at most {most / 1e6:.0f} MB are taken of its size"
        raise ConfigError(text, file=str(path))
    try:
        unknown = _unknown(path)
    except Exception as error:  # skops raises whatever its parts do on a file that is none of its own
        text = f"is corrupt, or no model of {maker} ({type(error).__name__})"
        raise ConfigError(text, file=str(path)) from None
    if unknown:
        text = f"refused: it contains code or unknown classes ({', '.join(unknown)}); a model holds data only"
        raise ConfigError(text, file=str(path))
    try:
        return _skops().load(path, trusted=list(_HOLD_DATA))
    except Exception as error:
        raise ConfigError(f"is corrupt ({type(error).__name__}: {error})", file=str(path)) from None


def _unpacked(file: Path | IO[bytes], most: int) -> int:
    """How large the content of a zip file is (bytes), as its directory says, beyond which no reader goes.

    What is packed again in it (matrices with few entries) counts as well, and is not looked at where it is over `most`.
    """
    with ZipFile(file) as packed:
        total = sum(member.file_size for member in packed.infolist())
        for name in packed.namelist():
            if total <= most and name.endswith(".npz"):
                with packed.open(name) as inner:
                    total += _unpacked(inner, most - total)
        return total


def _model(content: dict[str, Any]) -> Model:
    estimator, parts = content["estimator"], content["process"]
    if isinstance(estimator, dict):
        estimator = PathDetector.from_plain(estimator)
    elif parts is None:
        raise ValueError("a classifier without its process")
    joints = tuple(map(str, content["joints"]))
    reference = np.asarray(content["reference"], dtype=np.float64)
    if reference.ndim != 2 or reference.shape[1] != len(joints):
        raise ValueError(f"reference of shape {reference.shape} for {len(joints)} joints")
    return Model(
        name=str(content["name"]),
        joints=joints,
        estimator=estimator,
        process=None if parts is None else DataProcess(*parts),
        threshold=float(content["threshold"]),
        nominal=int(content["nominal"]),
        reference=reference,
        data=str(content["data"]),
        versions=dict(content["versions"]),
    )


class DataPersist:
    """The published role: keeps processed data and fitted processing in a folder, each under the hash of its origin."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def save(self, name: str, content: Any, data: str) -> Path:
        """Store something made from the data of that hash."""
        path = self.folder / f"{name}.skops"
        write_artefact({"format": FORMAT, "data": data, "versions": versions(), "content": content}, path)
        return path

    def retrieve(self, name: str, data: str) -> Any:
        """What was stored. Raises ConfigError if it is not there, or was made from other data."""
        path = self.folder / f"{name}.skops"
        stored = read_artefact(path, "fame adm")
        if not isinstance(stored, dict) or stored.get("format") != FORMAT:
            raise ConfigError("was not stored by fame adm", file=str(path))
        if stored["data"] != data:
            text = f"is stale: made from data {stored['data'][:12]}, asked for {data[:12]}; learn again"
            raise ConfigError(text, file=str(path))
        return stored["content"]


def _skops() -> Any:
    try:
        import skops.io
    except ImportError:
        text = "learning and operating need scikit-learn and skops: pip install 'fame-robots[ml]'"
        raise UnavailableError(text) from None
    return skops.io
