"""The graph of a pipeline as configured: topics and nodes from left to right, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from fame.middleware.interface import resolve
from fame.monitor.pipeline.configuration import Configuration, Port

_WIDTH, _HEIGHT, _ACROSS, _DOWN, _MARGIN = 190, 46, 70, 18, 20
_LETTER = 6.2  # px, of the usual letter at 11 px
_STYLE = (
    "text{font:11px sans-serif;text-anchor:middle;dominant-baseline:middle;fill:#222}.small{font-size:9px;fill:#666}"
    ".node{fill:#fff;stroke:#222;stroke-width:1.4}.topic{fill:#eef2f7;stroke:#8fa3bf}"
    ".edge{fill:none;stroke:#555;stroke-width:1.1;marker-end:url(#tip)}"
)


@dataclass(slots=True)
class _Box:
    title: str
    below: str
    topic: bool
    column: int = 0
    row: int = 0

    @property
    def left(self) -> float:
        return _MARGIN + self.column * (_WIDTH + _ACROSS)

    @property
    def middle(self) -> float:
        return _MARGIN + self.row * (_HEIGHT + _DOWN) + _HEIGHT / 2


def draw(configurations: Sequence[Configuration], file: str | Path) -> None:
    """Write the graph of some nodes and the topics between them."""
    boxes, edges = _graph(configurations)
    _place(boxes, edges)
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_text(_svg(boxes, edges), encoding="utf-8")


def _graph(configurations: Sequence[Configuration]) -> tuple[dict[str, _Box], list[tuple[str, str]]]:
    boxes: dict[str, _Box] = {}
    edges: list[tuple[str, str]] = []

    def topic(port: Port) -> str:
        name = resolve(port.topic, "")
        boxes.setdefault(name, _Box(name, port.type.rpartition("/")[2], True))
        return name

    for number, configuration in enumerate(configurations):
        key = f"{number} {configuration.name}"
        chain = " → ".join(stage.cls.rpartition(":")[2] for stage in configuration.stages)
        boxes[key] = _Box(configuration.name, chain or "no processor", False)
        edges += [(topic(port), key) for port in configuration.inputs]
        edges += [(key, topic(port)) for port in configuration.outputs]
    return boxes, list(dict.fromkeys(edges))


def _place(boxes: dict[str, _Box], edges: Sequence[tuple[str, str]]) -> None:
    """Columns by the longest way from the left, each filled from the top. A loop goes back."""
    for _ in boxes:
        for source, target in edges:
            if boxes[target].column <= boxes[source].column < len(boxes):
                boxes[target].column = boxes[source].column + 1
    filled: dict[int, int] = {}
    for box in boxes.values():
        box.column = min(box.column, len(boxes))
        box.row = filled.get(box.column, 0)
        filled[box.column] = box.row + 1
    used = {column: place for place, column in enumerate(sorted(filled))}
    for box in boxes.values():
        box.column = used[box.column]


def _svg(boxes: dict[str, _Box], edges: Sequence[tuple[str, str]]) -> str:
    width = max(box.left for box in boxes.values()) + _WIDTH + _MARGIN
    height = max(box.middle for box in boxes.values()) + _HEIGHT / 2 + _MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f"<style>{_STYLE}</style>",
        '<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#555"/></marker>',
        *(_edge(boxes[source], boxes[target]) for source, target in edges),
        *(_box(box) for box in boxes.values()),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _edge(source: _Box, target: _Box) -> str:
    begin, end = source.left + _WIDTH, target.left
    bend = max(_ACROSS / 2, abs(end - begin) / 2)
    path = f"M{begin:g} {source.middle:g}C{begin + bend:g} {source.middle:g} {end - bend:g} {target.middle:g}"
    return f'<path class="edge" d="{path} {end:g} {target.middle:g}"/>'


def _box(box: _Box) -> str:
    kind, radius = ("topic", _HEIGHT / 2) if box.topic else ("node", 6)
    x, y = box.left + _WIDTH / 2, box.middle
    return (
        f'<rect class="{kind}" x="{box.left:g}" y="{y - _HEIGHT / 2:g}" width="{_WIDTH}" height="{_HEIGHT}" '
        f'rx="{radius:g}"/><text x="{x:g}" y="{y - 7:g}">{_cut(box.title)}</text>'
        f'<text class="small" x="{x:g}" y="{y + 9:g}">{_cut(box.below, 1.2)}</text>'
    )


def _cut(text: str, more: float = 1.0) -> str:
    most = int(more * _WIDTH / _LETTER)
    return escape(text if len(text) <= most else f"{text[: most - 1]}…")
