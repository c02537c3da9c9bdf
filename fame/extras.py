"""Packages that come with an extra of FAME's: a command asks for them before it writes anything."""

from __future__ import annotations

from importlib.util import find_spec

from fame.errors import UnavailableError

_EXTRAS = {
    "PIL": ("animations need Pillow", "sim"),
    "matplotlib": ("pictures need matplotlib", "sim"),
    "pandas": ("tables of events need pandas", "pandas"),
    "pymunk": ("the 2D world needs pymunk", "sim"),
    "scipy": ("paths and runs of arms need scipy", "ml"),
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
