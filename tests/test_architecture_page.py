"""What docs/architecture.md and CONTRIBUTING.md say of the code is true: layers, names, files."""

import re
from collections import Counter
from importlib import import_module
from pathlib import Path

import pytest
from test_layers import LAYERS, MODULES, imports

from fame.rooms import ROOMS, room_of

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


DRAWING = PAGE.split("flowchart LR")[1].split("```")[0]


def test_the_drawing_of_rooms_has_those_of_the_table_and_what_they_import() -> None:
    pairs = {(room_of(item.source), room_of(item.target)) for item in imports() if room_of(item.target)}
    arrows = re.findall(r"^  (\w+)\[.*?\] --> (.*)$", DRAWING, re.MULTILINE)
    assert {(room, other) for room, others in arrows for other in others.split(" & ")} == {
        pair for pair in pairs if pair[0] != pair[1]
    }
    (all_of_them,) = re.findall(r"^  (.*) ==> core$", DRAWING, re.MULTILINE)
    assert all_of_them.split(" & ") == list(ROOMS)
    rows = re.findall(r"^\| (\w+) \| (`fame.*?`) \| (.*?) \| (.*?) \|$", PAGE, re.MULTILINE)
    extras = {name: f"`{room.extra}`" if room.extra else "" for name, room in ROOMS.items()}
    assert {name: (tuple(modules[1:-1].split("`, `")), about, extra) for name, modules, about, extra in rows} == {
        name: (room.modules, room.about, extras[name]) for name, room in ROOMS.items()
    }


def test_the_drawing_of_rooms_has_their_lines_to_a_tenth() -> None:
    lines = Counter[str]()
    for module, path in MODULES.items():
        lines[room_of(module) or "core"] += path.read_text("utf-8").count("\n")
    drawn = {name: int(number.replace(",", "")) for name, number in re.findall(r"(\w+)\[.* · ([\d,]+)", DRAWING)}
    assert drawn.keys() == lines.keys()
    wrong = {name: lines[name] for name, number in drawn.items() if not 0.9 < number / lines[name] < 1.1}
    assert wrong == {}, "so many lines are there"


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
