"""The examples in docstrings give what they show."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

from fame.errors import UnavailableError

ROOT = Path(__file__).parent.parent
SHOWN = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for folder in ("fame", "robots", "sim2d")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if ">>>" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("name", SHOWN)
def test_examples_hold(name: str) -> None:
    try:
        module = import_module(name)
    except (UnavailableError, ImportError) as error:
        pytest.skip(str(error))
    result = doctest.testmod(module)
    assert (result.failed, result.attempted > 0) == (0, True)
