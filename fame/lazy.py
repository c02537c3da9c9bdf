"""Packages that import their names on first use (PEP 562), by the convention of ``lazy_loader.attach`` (SPEC 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def attach(
    package: str, names: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of `package`.

    `names` maps modules, relative to the package, to the public names they define. Type checkers do not see these: the
    package repeats them under ``TYPE_CHECKING`` as ``from module import name as name``.
    """
    modules = {name: f"{package}.{module}" for module, defined in names.items() for name in defined}
    public = sorted(modules)

    def getattr_(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    return getattr_, public.copy, public
