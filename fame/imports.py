"""Imports on first use (the convention of ``lazy_loader``, SPEC 1; PEP 562), and packages of extras."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from linecache import getlines
from pathlib import Path
from typing import Any

from fame.errors import UnavailableError

_EXTRAS = {
    "PIL": ("animations need Pillow", "sim"),
    "resvg_py": ("films with a diagram need resvg-py (--show world does without it)", "sim"),
    "orjson": ("--state needs orjson", "all"),
    "joblib": ("campaigns need joblib", "campaign"),
    "distributed": ("--backend dask needs distributed", "dask"),
    "ray": ("--backend ray needs ray", "ray"),
    "matplotlib": ("pictures and plots need matplotlib", "sim"),
    "pandas": ("tables of events need pandas", "pandas"),
    "prometheus_client": ("--metrics needs prometheus-client", "metrics"),
    "pytest": ("tests of missions need pytest", "test"),
    "pyarrow": ("Parquet files need pyarrow", "parquet"),
    "pymunk": ("the 2D world needs pymunk", "sim"),
    "scipy": ("paths and runs of arms need scipy", "sim"),
    "starlette": ("the page needs starlette, uvicorn and websockets", "view"),
    "uvicorn": ("the page needs starlette, uvicorn and websockets", "view"),
    "websockets": ("the page needs starlette, uvicorn and websockets", "view"),
    "sklearn": ("training needs scikit-learn", "ml"),
    "onnx": ("ONNX files need the package onnx", "onnx"),
    "onnxruntime": ("ONNX files need the package onnxruntime", "onnx"),
}
"""By package: what needs it, and the extra that installs it."""


def require(package: str) -> None:
    """Raise UnavailableError, with the command that installs it, if the package is not there. Nothing is imported."""
    if find_spec(package) is None:
        text, extra = _EXTRAS[package]
        raise UnavailableError(f"{text}: pip install 'fame-robots[{extra}]'")


def hidden(error: BaseException) -> str:
    """Say which folder of the user hides a package of FAME, if that is why an import failed; else nothing."""
    top = str(getattr(error, "name", None) or "").partition(".")[0]
    home = Path(__file__).parent.parent
    if not isinstance(error, ImportError) or not top or not (home / top / "__init__.py").is_file():
        return ""
    spec = find_spec(top)
    places = [Path(place) for place in (spec.submodule_search_locations or ())] if spec is not None else []
    other = next((place for place in places if place.resolve() != (home / top).resolve()), None)
    return f"the folder {other} hides FAME's package {top!r}: rename it" if other is not None else ""


def attach(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of `package`, as ``lazy_loader.attach_stub`` does.

    Public are the names that the package imports under ``if TYPE_CHECKING``, as ``from module import name as name``.
    """
    module = sys.modules[package]
    source = "".join(getlines(str(module.__file__), vars(module)))  # of any loader, as tracebacks show it
    blocks = (node.body for node in ast.parse(source).body if isinstance(node, ast.If))
    imports = (node for block in blocks for node in block if isinstance(node, ast.ImportFrom))
    modules = {alias.name: str(node.module) for node in imports for alias in node.names}
    public = sorted(modules)

    def getattr_(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    return getattr_, public.copy, public
