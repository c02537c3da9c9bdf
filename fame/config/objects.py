"""Find Python objects that a configuration file names: ``module:Name``, or ``file.py:Name`` beside the file."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

from fame.errors import ConfigError


def find_object(name: str, folder: Path) -> Any:
    """The object that ``module:Name`` or ``file.py:Name`` (relative to `folder`) names. Raises ConfigError."""
    module, colon, attribute = name.rpartition(":")
    if not colon:
        module, _, attribute = name.rpartition(".")
    if not module:
        raise ConfigError(f"expected module:Name or file.py:Name, got {name!r}")
    try:
        return getattr(_module(module, folder), attribute)
    except AttributeError:
        raise ConfigError(f"{module} has no {attribute!r}") from None


def _module(name: str, folder: Path) -> Any:
    """A module by name or from a file. Raises ConfigError."""
    try:
        return _from_file((folder / name).resolve()) if name.endswith(".py") else importlib.import_module(name)
    except ConfigError:
        raise
    except Exception as error:  # whatever the code of a user's module raises
        raise ConfigError(f"{name} cannot be imported: {type(error).__name__}: {error}") from error


def _from_file(path: Path) -> Any:
    known = f"fame_user_{path.stem}_{abs(hash(str(path)))}"
    if known in sys.modules:
        return sys.modules[known]
    specification = importlib.util.spec_from_file_location(known, path)
    if specification is None or specification.loader is None or not path.is_file():
        raise ConfigError(f"there is no file {path}")
    module = sys.modules[known] = importlib.util.module_from_spec(specification)
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[known]
        raise
    return module
