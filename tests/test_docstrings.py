"""Docstrings: their examples give what they show, and those of functions are in the imperative."""

import ast
import doctest
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from fame.errors import UnavailableError

ROOT = Path(__file__).parent.parent
MODULES = [path for folder in ("fame", "robots", "sim2d") for path in sorted((ROOT / folder).rglob("*.py"))]
SHOWN = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in MODULES
    if ">>>" in path.read_text(encoding="utf-8")
]
NOUNS = {
    "The",
    "A",
    "An",
    "All",
    "Its",
    "One",
    "Those",
    "Each",
    "Every",
    "What",
    "Whether",
    "How",
    "Why",
    "Who",
    "Gives",
}
"""First words of a docstring that names what is returned, without a verb."""


@pytest.mark.parametrize("name", SHOWN)
def test_examples_hold(name: str) -> None:
    try:
        module = import_module(name)
    except (UnavailableError, ImportError) as error:
        pytest.skip(str(error))
    result = doctest.testmod(module)
    assert (result.failed, result.attempted > 0) == (0, True)


def functions(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """The public functions and methods of a module or class, without properties."""
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.ClassDef):
            yield from functions(each)
        elif isinstance(each, ast.FunctionDef) and not each.name.startswith("_"):
            made = [ast.unparse(one) for one in each.decorator_list]
            if not any("property" in one or "contextmanager" in one or one.endswith(".setter") for one in made):
                yield each


def returns_something(function: ast.FunctionDef) -> bool:
    """Whether a function is annotated with more than None."""
    return function.returns is not None and ast.unparse(function.returns) != "None"


def test_functions_say_what_they_return_in_the_imperative() -> None:
    others = [
        f"{path.relative_to(ROOT)}:{each.lineno} {each.name}"
        for path in MODULES
        for each in functions(ast.parse(path.read_text(encoding="utf-8")))
        if returns_something(each) and (ast.get_docstring(each) or "").split(" ")[0] in NOUNS
    ]
    assert others == []
