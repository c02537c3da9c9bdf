"""SciPy, imported where it is used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from fame.errors import UnavailableError


def scipy(part: str) -> Any:
    """``scipy.spatial``, ``scipy.interpolate`` ... Raises UnavailableError if it is not installed."""
    try:
        return import_module(f"scipy.{part}")
    except ImportError:
        text = "paths and runs of arms need scipy, which comes with scikit-learn: pip install 'fame-robots[ml]'"
        raise UnavailableError(text) from None
