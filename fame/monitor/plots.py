"""Plots of monitoring, and the drawing of a pipeline.

`plot_loss` and `plot_series` show numbers over time; `joint_space`, `deviations` and `matrices` show what was learned
of a task and how well. They write PNG files and raise UnavailableError without matplotlib. `draw` writes an SVG file:
the nodes of some configurations and the topics between them, from left to right. All raise ConfigError for a file that
cannot be written.

Joint space is shown as in the figures 10 and 13 of the published anomaly detection module (docs/anomaly.md): the points
of all joints on their first three principal components.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import numpy as np

from fame.dataclasses import dataclass
from fame.imports import require
from fame.middleware.interface import resolve
from fame.monitor.anomaly.benign_changes import PointScores
from fame.monitor.anomaly.classifiers import ConfusionMatrix
from fame.monitor.anomaly.paths import PathDetector
from fame.monitor.anomaly.recording import ANOMALOUS, Recording
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.configuration import Configuration, Port
from fame.monitor.pipeline.processor import Samples
from fame.text import write_file, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fame.monitor.pipeline.topic_tools import Series


_COLOURS = (
    "#1f77b4", "#d95f02", "#1b9e77", "#e7298a", "#66a61e", "#7570b3", "#a6761d", "#e6ab02", "#17becf", "#444444",
)  # fmt: skip


def line_style(number: int) -> tuple[str, str]:
    """Return colour and dashes of the line of a channel: ten colours, then the same ones dashed, then dotted ..."""
    return _COLOURS[number % len(_COLOURS)], ("-", "--", ":", "-.")[number // len(_COLOURS) % 4]


def plot_loss(loss: Samples, file: str | Path, *, thresholds: Sequence[float] = (), title: str = "") -> None:
    """Plot loss over time, a line per channel, each with its threshold in its colour (one for all in black).

    Writes a PNG. Raises UnavailableError without matplotlib.
    """
    figure, axes = _over_time(title)
    values = loss.channels()
    names = loss.names or tuple(map(str, range(values.shape[1])))
    begin = float(loss.stamps[0]) if len(loss) else 0.0
    for channel, name in enumerate(names):
        colour, style = line_style(channel)
        label = name.rpartition(".")[2]
        (line,) = axes.plot(loss.stamps - begin, values[:, channel], style, color=colour, linewidth=1, label=label)
        if len(thresholds) == len(names) > 1:
            axes.axhline(thresholds[channel], color=line.get_color(), linestyle="--", linewidth=0.8)
    if len(thresholds) == 1 or (len(names) == 1 and thresholds):
        axes.axhline(thresholds[0], color="black", linestyle="--", linewidth=0.8, label="threshold")
    axes.set(xlabel="time in s", ylabel="loss")
    _save_with_legend(figure, axes, file)


def plot_series(series: Sequence[Series], file: str | Path, *, thresholds: Sequence[float] = ()) -> None:
    """Numbers of topics over time. Writes a PNG. Raises UnavailableError without matplotlib."""
    figure, axes = _over_time()
    begin = min(each.stamps[0] for each in series if each.stamps)
    for each in series:
        if not each.stamps:
            continue
        alike = [np.shape(value) == np.shape(each.values[-1]) for value in each.values]  # the others had other channels
        values = np.array(list(compress(each.values, alike)), dtype=float).reshape(sum(alike), -1)
        stamps = np.array(list(compress(each.stamps, alike))) - begin
        for channel in range(values.shape[1]):
            name = each.names[channel] if len(each.names) == values.shape[1] > 1 else str(channel)
            label = each.label if values.shape[1] == 1 else f"{each.label} {name}"
            axes.plot(stamps, values[:, channel], linewidth=1, label=label)
    for threshold in thresholds:
        axes.axhline(threshold, color="black", linestyle="--", linewidth=0.8)
    axes.set(xlabel="time in s")
    _save_with_legend(figure, axes, file)


BENIGN_COLOUR, ANOMALOUS_COLOUR, MISSED_COLOUR, QUIET = "#2b6ca3", "#c2371f", "#e0a21b", "#8a8f98"
_INCHES, _DPI = (7.0, 5.6), 120


def joint_space(path: Path, recording: Recording, predicted: Any = None, *, title: str = "Joint space") -> None:
    """Plot all points on three principal components. `predicted` (points,) are labels that a classifier gave them."""
    figure = _figure(_INCHES)
    axes: Any = figure.add_subplot(projection="3d")
    points = _components(recording.values)
    for name, colour, chosen in _groups(recording.labels, predicted):
        x, y, z = points[chosen].T
        axes.scatter(x, y, z, s=4 if colour == BENIGN_COLOUR else 9, color=colour, label=f"{name} ({chosen.sum()})")
    axes.set(xlabel="component 1 (rad)", ylabel="component 2 (rad)", zlabel="component 3 (rad)", title=title)
    axes.legend(loc="upper left", fontsize=8)
    _save(figure, path)


def deviations(path: Path, detector: PathDetector, runs: Iterable[tuple[str, Recording]]) -> None:
    """Plot how far runs, each with a name, are off the benign paths and how late along them, with the limits."""
    figure = _figure((8.0, 6.0))
    above, below = figure.subplots(2, 1, sharex=True)
    for name, run in runs:
        readings = detector.follow(run)
        phase = [reading.phase for reading in readings]
        line = above.plot(phase, [1000 * reading.deviation for reading in readings], linewidth=0.9, label=name)[0]
        below.plot(phase, [reading.lateness for reading in readings], linewidth=0.9, color=line.get_color())
        _mark(above, below, readings)
    edges = detector.parameters.bin * np.arange(len(detector.limits) + 1)
    above.stairs(1000 * detector.limits[:, 0], edges, color=QUIET, label="limit")
    for sign in (1, -1):
        below.stairs(sign * detector.limits[:, 2], edges, color=QUIET)
    above.set(ylabel="off the benign paths (mm)", title="Deviation along the path (dots: anomalous points)")
    below.set(ylabel="late (samples)", xlabel="place along the path (samples of a benign run)")
    above.legend(fontsize=8)
    _save(figure, path)


def matrices(path: Path, titled: Sequence[tuple[str, ConfusionMatrix]]) -> None:
    """Plot confusion matrices, each with its title."""
    columns = min(3, max(1, len(titled)))
    rows = -(-len(titled) // columns) or 1
    figure = _figure((2.6 * columns + 0.4, 2.5 * rows + 0.4))
    for number, (title, matrix) in enumerate(titled):
        axes = figure.add_subplot(rows, columns, number + 1)
        counts = np.array([[matrix.tp, matrix.fn], [matrix.fp, matrix.tn]])
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1.6)
        for (row, column), count in np.ndenumerate(counts):
            axes.text(column, row, str(count), ha="center", va="center", fontsize=12)
        axes.set(xticks=(0, 1), yticks=(0, 1), xticklabels=("anomalous", "benign"), yticklabels=("anom.", "benign"))
        axes.set_title(title, fontsize=9)
        axes.tick_params(labelsize=8)
        axes.set_xlabel("predicted", fontsize=8)
        axes.set_ylabel("true (runs)", fontsize=8)
    _save(figure, path)


def _over_time(title: str = "") -> tuple[Figure, Any]:
    figure = _figure((10, 4.5))
    axes: Any = figure.subplots()
    axes.set_title(title)
    axes.grid(alpha=0.3)
    return figure, axes


def _save_with_legend(figure: Figure, axes: Any, file: str | Path) -> None:
    axes.legend(loc="upper right", fontsize="small", ncols=2)
    _save(figure, Path(file))


def _mark(above: Any, below: Any, readings: Sequence[PointScores]) -> None:
    """Draw dots where a point is anomalous."""
    bad = [reading for reading in readings if reading.anomalous]
    phase = [reading.phase for reading in bad]
    above.plot(phase, [1000 * reading.deviation for reading in bad], ".", color=ANOMALOUS_COLOUR, markersize=4)
    below.plot(phase, [reading.lateness for reading in bad], ".", color=ANOMALOUS_COLOUR, markersize=4)


def _groups(labels: Any, predicted: Any) -> list[tuple[str, str, Any]]:
    """Name, colour and mask of each group of points that is not empty."""
    true = np.asarray(labels) == ANOMALOUS
    if predicted is None:
        groups = [("benign", BENIGN_COLOUR, ~true), ("anomalous", ANOMALOUS_COLOUR, true)]
    else:
        found = np.asarray(predicted) == ANOMALOUS
        groups = [
            ("predicted anomalous", ANOMALOUS_COLOUR, found),
            ("predicted benign", BENIGN_COLOUR, ~found & ~true),
            ("predicted benign, but anomalous", MISSED_COLOUR, ~found & true),
        ]
    return [group for group in groups if group[2].any()]


def _components(values: Floats) -> Floats:
    """Return the points (points, joints) on their first three principal components (points, 3)."""
    centred = values - values.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    found: Floats = centred @ directions[:3].T
    return np.pad(found, ((0, 0), (0, 3 - found.shape[1])))


def _figure(inches: tuple[float, float]) -> Figure:
    require("matplotlib")
    from matplotlib.figure import Figure

    return Figure(figsize=inches, dpi=_DPI, layout="constrained")


def _save(figure: Figure, path: Path) -> None:
    with writing(path) as part:
        figure.savefig(part, format="png")


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
    path = Path(file)
    write_file(path, _svg(boxes, edges))


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
    """Place boxes in columns by the longest way from the left, each filled from the top. A loop goes back."""
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
