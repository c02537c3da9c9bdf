"""What FAME installs and what its packages offer."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from zipfile import ZipFile

import pytest

import fame
from fame import imports
from fame.cli.fleet import installation

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
    stub = path.with_suffix(".pyi")
    typed = (stub if stub.exists() else path).read_text("utf-8")
    found = [node for node in ast.walk(ast.parse(typed)) if isinstance(node, ast.ImportFrom)]
    seen = {alias.asname: f"{node.module}.{alias.name}" for node in found for alias in node.names if alias.asname}
    assert sorted(seen) == package.__all__ == dir(package)
    for name, source in seen.items():
        module, _, same = source.rpartition(".")
        assert getattr(package, name) is getattr(import_module(module), same)


EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
KINDS = ("README.md", "docs/*.md", "examples/**/*.*", "fame/**/*.py", "robots/**/*.py", "sim2d/*.py")
TEXTS = [path for kind in KINDS for path in ROOT.glob(kind) if path.suffix in (".py", ".md", ".yaml")]


def test_every_extra_that_is_named_anywhere_exists() -> None:
    named = {extra for _, extra in imports.EXTRAS.values()}
    for path in TEXTS:
        for text in re.findall(r"(?:fame-robots|\.)\[([a-z,]+)\]'", path.read_text(encoding="utf-8")):
            named.update(text.split(","))
    assert {"sim", "dds", "ray", "view"} <= named
    assert named - EXTRAS.keys() == set()


def test_readme_and_doctor_say_of_each_extra_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    table = re.findall(r"^\| `(\w+)` \| (.*) \|$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    assert {extra: text.replace("`", "") for extra, text in table} == imports.PURPOSES
    assert EXTRAS.keys() - imports.PURPOSES.keys() == {"all", "bench", "dev", "docs", "mutants"}
    monkeypatch.setattr(installation, "version", {"joblib": "1", "scipy": "2"}.get)
    found = {one.check: one for one in installation.extras()}
    assert found.keys() == imports.PURPOSES.keys()
    assert found["campaign"].verdict == "absent"
    assert found["campaign"].text.endswith(": matplotlib not installed")
    assert found["campaign"].mend == "pip install 'fame-robots[campaign]'"
    monkeypatch.setattr(installation, "version", lambda name: "1")
    assert {one.verdict for one in installation.extras()} == {"ok"}


def test_a_name_that_a_package_does_not_have_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"module 'fame' has no attribute 'raed'"):
        fame.raed  # noqa: B018


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a wheel puts into site-packages."""
    hatchling = pytest.importorskip("hatchling.builders.wheel")
    folder = tmp_path_factory.mktemp("wheel")
    (wheel,) = hatchling.WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    with ZipFile(wheel) as archive:
        archive.extractall(folder / "site-packages")
    return folder / "site-packages"


@pytest.mark.long
def test_a_wheel_holds_fame_robots_and_sim2d_and_nothing_else(installed: Path) -> None:
    about = f"fame_robots-{fame.__version__}.dist-info"
    assert {path.name for path in installed.iterdir()} == {"fame", "robots", "sim2d", about}
    assert all((installed / package / "py.typed").exists() for package in ("fame", "robots", "sim2d"))


@pytest.mark.long
def test_models_and_examples_are_data_of_the_installed_package(installed: Path) -> None:
    def files(folder: Path) -> set[Path]:
        return {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}

    assert files(installed / "fame" / "models") == files(ROOT / "models")
    made = {path for path in files(ROOT / "examples") if "__pycache__" in path.parts}
    assert files(installed / "fame" / "examples") == files(ROOT / "examples") - made  # fame new and fame demo copy them
    code = "from fame.bpmn.library import BUILT_IN; print(*BUILT_IN, sep='\\n')\nimport models"
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, "-S", "-P", "-c", code]  # -S: an editable install would offer the source tree, too
    done = subprocess.run(command, cwd=installed.parent, env=environment, capture_output=True, text=True, check=False)
    folders = ("library", "monitoring", "nav2")
    assert done.stdout.split() == [str(installed / "fame" / "models" / name) for name in folders]
    assert done.stderr.endswith("ModuleNotFoundError: No module named 'models'\n")
