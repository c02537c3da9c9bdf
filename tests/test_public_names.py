"""Pages and examples to copy show public names only: those in ``__all__`` of the packages in docs/python.md."""

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import sim2d.record

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md")])
EXAMPLES = sorted([ROOT / "examples" / "courier.py", *ROOT.glob("examples/**/tests/*.py")])
"""What users copy; the other programs in `examples` repeat tables of papers."""
PACKAGES = [
    name
    for row in re.findall(r"^\| `.*?` \|", PAGE.split("What calls")[0], re.MULTILINE)
    for name in re.findall(r"`([\w.]+)`", row)
]
"""The packages of the first table."""
RESULTS = re.findall(r"^\| `fame\.(\w+)` \|", PAGE.split("What calls")[1], re.M)


def blocks(page: Path) -> Iterator[ast.Module]:
    """The Python blocks of a page."""
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        yield ast.parse(block)


def imported(block: ast.Module) -> Iterator[tuple[str, str]]:
    """The names that a block takes from our packages: (package, name)."""
    for node in ast.walk(block):
        if isinstance(node, ast.ImportFrom):
            yield from ((str(node.module), alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in PACKAGES:
            yield ast.unparse(node.value), node.attr


@pytest.mark.parametrize("name", PACKAGES)
def test_a_public_package_lists_its_names(name: str) -> None:
    package = import_module(name)
    assert package.__all__
    for each in package.__all__:
        assert getattr(package, each) is not None


def not_public(block: ast.Module) -> list[str]:
    """The names of FAME that a block takes although they are not public."""
    return [
        f"{package}.{name}"
        for package, name in imported(block)
        if package.split(".")[0] in ("fame", "robots", "sim2d") and not is_public(package, name)
    ]


def is_public(package: str, name: str) -> bool:
    """Whether a package, or a name in it, is public."""
    if package not in PACKAGES:
        return False
    return not name or name in import_module(package).__all__ or f"{package}.{name}" in PACKAGES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_shows_public_names(page: Path) -> None:
    assert [name for block in blocks(page) for name in not_public(block)] == []


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_to_copy_uses_public_names(path: Path) -> None:
    assert not_public(ast.parse(path.read_text(encoding="utf-8"))) == []


def test_there_is_something_to_look_at() -> None:
    assert len(PACKAGES) > 10
    assert len(RESULTS) > 5
    assert sum(len([*blocks(page)]) for page in PAGES) > 5
    assert len(EXAMPLES) > 20


@pytest.mark.parametrize("name", RESULTS)
def test_what_calls_give_back_is_public_and_described(name: str) -> None:
    import fame

    assert name in fame.__all__
    assert getattr(fame, name).__doc__


def test_a_name_of_before_warns_and_works() -> None:
    with pytest.warns(DeprecationWarning, match="sim2d.WorldRecorder"):
        old = sim2d.record.Recorder
    assert old is sim2d.record.WorldRecorder
