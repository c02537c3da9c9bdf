"""What FAME installs and what its packages offer."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

import fame

ROOT = Path(__file__).parent.parent
LAZY = [path for path in ROOT.glob("fame/**/__init__.py") if "attach(" in path.read_text(encoding="utf-8")]


def name_of(path: Path) -> str:
    return ".".join(path.parent.relative_to(ROOT).parts)


def test_dir_shows_the_api() -> None:
    assert dir(fame) == sorted(fame.__all__)
    assert {"read", "split", "write", "Simulation", "Scenario", "EventLog", "FameError"} <= set(dir(fame))


@pytest.mark.parametrize("path", LAZY, ids=name_of)
def test_type_checkers_see_the_names_that_are_imported_on_first_use(path: Path) -> None:
    package = import_module(name_of(path))
    imports = [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)]
    seen = {alias.asname: f"{node.module}.{alias.name}" for node in imports for alias in node.names if alias.asname}
    assert sorted(seen) == package.__all__ == dir(package)
    for name, source in seen.items():
        module, _, same = source.rpartition(".")
        assert getattr(package, name) is getattr(import_module(module), same)


def test_a_name_that_a_package_does_not_have_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'fame' has no attribute 'raed'"):
        fame.raed  # noqa: B018
