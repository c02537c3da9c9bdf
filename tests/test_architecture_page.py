"""What docs/architecture.md and CONTRIBUTING.md say of the code is true: layers, names, files."""

import re
from importlib import import_module
from pathlib import Path

import pytest
from test_layers import LAYERS, MODULES

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PAGES = (PAGE, (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
NAMES = sorted({name for page in PAGES for name in re.findall(r"`((?:fame|robots|sim2d)(?:\.\w+)+)`", page)})
FILES = sorted({name for page in PAGES for name in re.findall(r"`((?:fame|robots|sim2d|tests)/[\w./]+)`", page)})


def test_the_drawing_has_the_layers_of_the_rules() -> None:
    drawn = {}
    for number, content in re.findall(r"subgraph layer(\d)(.*?)\n  end", PAGE, re.DOTALL):
        drawn[int(number)] = {name for label in re.findall(r'\w+\["([^"·]+)"\]', content) for name in label.split(", ")}
    assert drawn == {number: set(packages) for number, packages in enumerate(LAYERS)}


@pytest.mark.parametrize("name", NAMES)
def test_each_name_is_one_of_the_code(name: str) -> None:
    if name in MODULES:
        return  # also one whose packages are not here
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            found = getattr(found, part)
        return
    pytest.fail(f"no module {parts[0]}")


@pytest.mark.parametrize("name", FILES)
def test_each_file_is_there(name: str) -> None:
    assert (ROOT / name).exists()
