"""The shipped diagrams can be read: no name lies on a flow or a shape, and no boundary event covers a marker."""

import re
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path

import pytest
from lxml import etree

from fame.bpmn import read
from fame.bpmn.draw.diagram import draw
from fame.bpmn.draw.svg import crosses, overlap, text_width
from fame.bpmn.model import Bounds, Definitions, Edge, Shape

ROOT = Path(__file__).parent.parent
SVG = "{http://www.w3.org/2000/svg}"
POOLS, BODIES = ("participant", "lane", "group"), ("subProcess", "transaction", "adHocSubProcess")
NEW = ROOT / "examples" / "project" / "mission.bpmn"
COOKBOOK = sorted((ROOT / "examples" / "cookbook").glob("*/*.bpmn"))
MARKER = 14.0

every_diagram = pytest.mark.parametrize(
    "path",
    [*sorted((ROOT / "models").rglob("*.bpmn")), NEW, *COOKBOOK],
    ids=lambda path: f"{path.parent.name}/{path.stem}",
)


def lettering(root: etree._Element) -> Iterator[tuple[str, Bounds]]:
    """The lines of text and what they fill, without those that are turned."""
    for text in root.iter(f"{SVG}text"):
        if any("rotate" in str(one.get("transform")) for one in text.iterancestors()):
            continue
        size = float(str(text.get("font-size")))
        for line in text.iter(f"{SVG}tspan"):
            words, x, base = str(line.text), float(str(line.get("x"))), float(str(line.get("y")))
            width = text_width(words, size)
            yield words, Bounds(x - width / 2, base - 0.75 * size, width, 0.8 * size)


def markers(root: etree._Element, shape: Shape) -> Iterator[Bounds]:
    """The markers at the bottom of an activity."""
    (group,) = [one for one in root.iter(f"{SVG}g") if one.get("id") == shape.element]
    for moved in group.findall(f"{SVG}g"):
        x, y = (float(number) for number in re.findall(r"-?[\d.]+", str(moved.get("transform")))[:2])
        if y > shape.bounds.y + shape.bounds.height / 2:
            yield Bounds(x, y, MARKER, MARKER)


def solid(shape: Shape) -> Bounds:
    """What a shape fills: of a gateway the square in its diamond."""
    box = shape.bounds
    if not shape.kind.endswith("Gateway"):
        return box
    return Bounds(box.x + box.width / 4, box.y + box.height / 4, box.width / 2, box.height / 2)


def holds(outer: Bounds, inner: Bounds) -> bool:
    """Whether a box lies in another."""
    ends = inner.x + inner.width <= outer.x + outer.width and inner.y + inner.height <= outer.y + outer.height
    return outer.x <= inner.x and outer.y <= inner.y and ends


def on_flow(box: Bounds, edge: Edge) -> bool:
    return any(crosses(box, *line) for line in pairwise(edge.waypoints))


def covered(definitions: Definitions) -> list[str]:
    """What lies on what else on a diagram."""
    root = etree.fromstring(draw(definitions).encode())
    names = list(lettering(root))
    shapes = [one for one in definitions.shapes if one.kind not in POOLS and not (one.expanded and one.kind in BODIES)]
    events = [shape for shape in shapes if shape.kind == "boundaryEvent"]
    found = [f"{name!r} on {edge.element}" for name, box in names for edge in definitions.edges if on_flow(box, edge)]
    found += [f"{one!r} on {other!r}" for (one, a), (other, b) in combinations(names, 2) if overlap(a, b)]
    for shape in shapes:
        fills = solid(shape)
        found += [
            f"{name!r} on {shape.element}" for name, box in names if overlap(box, fills) and not holds(fills, box)
        ]
        marks = list(markers(root, shape)) if shape not in events else []
        hiding = [event for event in events if any(overlap(event.bounds, mark) for mark in marks)]
        found += [f"{event.element} on a marker of {shape.element}" for event in hiding]
    return found


@every_diagram
def test_nothing_on_a_shipped_diagram_covers_anything_else(path: Path) -> None:
    assert covered(read(path)) == []


@every_diagram
def test_a_name_without_a_place_finds_one_below_its_shape_as_modelers_put_it(path: Path) -> None:
    definitions = read(path)
    root = etree.fromstring(draw(definitions).encode())
    for shape in definitions.shapes:
        if shape.label is None and shape.kind.endswith(("Gateway", "Event", "Reference")):
            (group,) = [one for one in root.iter(f"{SVG}g") if one.get("id") == shape.element]
            assert all(box.y > shape.bounds.y + shape.bounds.height for _, box in lettering(group)), shape.element
