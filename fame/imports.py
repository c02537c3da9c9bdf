"""Imports on first use (the convention of ``lazy_loader``, SPEC 1; PEP 562), and packages of extras."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fame.errors import FameError, UnavailableError
from fame.rooms import install, load, missing

_PAGE = "the page needs starlette, uvicorn and websockets"
_ZENOH = "Zenoh needs eclipse-zenoh and xxhash (--middleware dds does without them)"
EXTRAS = {
    "PIL": ("pictures and animations need Pillow", "sim"),
    "cryptography": ("signing needs cryptography", "dds"),
    "cyclonedds": ("DDS needs Eclipse Cyclone DDS (--middleware ros uses that of ROS 2)", "dds"),
    "distributed": ("--backend dask needs distributed", "dask"),
    "foxglove": ("--foxglove needs foxglove-sdk", "foxglove"),
    "hypothesis": ("strategies for tests need hypothesis", "test"),
    "joblib": ("campaigns and learning need joblib", "campaign"),
    "matplotlib": ("pictures and plots need matplotlib", "sim"),
    "onnx": ("ONNX files need the package onnx", "onnx"),
    "onnxruntime": ("ONNX files need the package onnxruntime", "onnx"),
    "pandas": ("tables of events need pandas", "pandas"),
    "prometheus_client": ("--metrics needs prometheus-client", "metrics"),
    "pyarrow": ("Parquet files need pyarrow", "parquet"),
    "pymunk": ("the 2D world needs pymunk", "sim"),
    "pytest": ("tests of missions need pytest", "test"),
    "quickjs": ("JavaScript needs the engine quickjs-ng", "js"),
    "ray": ("--backend ray needs ray", "ray"),
    "resvg_py": ("films with a diagram need resvg-py (--show world does without it)", "sim"),
    "scipy": ("arms, paths and intervals need scipy", "sim"),
    "sklearn": ("learning needs scikit-learn", "ml"),
    "skops": ("learned models need skops", "ml"),
    "starlette": (_PAGE, "view"),
    "uvicorn": (_PAGE, "view"),
    "websockets": (_PAGE, "view"),
    "xxhash": (_ZENOH, "zenoh"),
    "zenoh": (_ZENOH, "zenoh"),
}
"""By package outside of the base installation: what needs it, and the extra that installs it."""
PURPOSES = {
    "sim": "worlds, robots, pictures and films: fame run, draw",
    "test": "tests of missions: fame test",
    "view": "the page: fame view",
    "foxglove": "a team live in Foxglove: fame view --foxglove",
    "dds": "teams over DDS, the wire of ROS 2; keys: fame engine, deploy, keys",
    "zenoh": "teams over Zenoh, also beyond one network: --middleware zenoh",
    "js": "scripts and conditions in JavaScript",
    "ml": "learned monitors: fame monitor train, judge, adm",
    "onnx": "monitors as ONNX files",
    "campaign": "many runs, with statistics: fame campaign",
    "dask": "campaigns on a cluster of Dask",
    "ray": "campaigns on a cluster of Ray",
    "metrics": "numbers of an engine for Prometheus: --metrics",
    "pandas": "events as a table in Python",
    "parquet": "Parquet files of campaigns and monitors",
}
"""What each extra is for; README has the same table."""
BASE = {**{name: name for name in ("lxml", "mcap", "numpy", "orjson", "rosbags")}, "yaml": "pyyaml"}
"""The packages of the base installation, by module: a workspace of ROS that colcon built alone may lack some."""


def require(*packages: str) -> None:
    """Raise UnavailableError, with the command that installs it, for a package that is missing. Nothing is imported."""
    for package in packages:
        if find_spec(package) is None:
            raise _unavailable(package)


def _unavailable(package: str) -> UnavailableError:
    text, extra = EXTRAS.get(package, (f"FAME needs {package}", ""))
    return UnavailableError(f"{text}: {install(extra) if extra else f'pip install {BASE[package]}'}")


def explained(error: BaseException | None) -> FameError | None:
    """Return what to say of an import that failed, also as the cause of another error: that a room or a package of an
    extra is missing, or that a folder of the user hides a package of FAME. None for any other error."""
    while error is not None and not isinstance(error, ImportError):
        error = error.__cause__
    if error is not None and (reason := missing(error)) is not None:
        return reason
    top = str(getattr(error, "name", None) or "").partition(".")[0]
    if top in (*EXTRAS, *BASE):
        broken = UnavailableError(f"{top} is installed, but cannot be imported ({error}): install it again")
        return _unavailable(top) if find_spec(top) is None else broken
    return FameError(text) if (text := _hidden(top)) else None


def _hidden(top: str) -> str:
    """Say which folder of the user hides a package of FAME; else nothing."""
    home = Path(__file__).parent.parent
    if not top or not (home / top / "__init__.py").is_file():
        return ""
    spec = find_spec(top)
    places = [Path(place) for place in (spec.submodule_search_locations or ())] if spec is not None else []
    other = next((place for place in places if place.resolve() != (home / top).resolve()), None)
    return f"the folder {other} hides FAME's package {top!r}: rename it" if other is not None else ""


_IMPORT = re.compile(r"^ *from (\S+) import (\([^()]*\)|[^()\n]*)$", re.MULTILINE)
_PUBLIC = re.compile(r"\b(\w+) as \1\b")


def attach(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of `package`, as ``lazy_loader.attach_stub`` does.

    Public are the names that the package imports under ``if TYPE_CHECKING``, as ``from module import name as name``,
    or in the stub file beside it: so names of rooms, which no statement of the core imports.
    """
    module: Any = sys.modules[package]
    try:
        source = module.__loader__.get_data(f"{module.__file__}i")
    except OSError:
        source = module.__loader__.get_data(module.__file__)
    imports = _IMPORT.findall(source.decode())  # `ast` takes 3 ms to load, which fame --help does without
    modules = {name: home for home, names in imports for name in _PUBLIC.findall(names)}
    public = sorted(modules)

    def getattr_(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return load(f"{modules[name]}:{name}")

    return getattr_, public.copy, public
