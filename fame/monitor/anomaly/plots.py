"""Pictures of what was learned: joint space, deviation along the path, confusion matrices.

Joint space is shown as the paper's Fig. 10 and 13 show it: the points of all joints on their first three principal
components, benign ones alone or with the verdicts of a classifier. Writes PNG. Raises UnavailableError without
matplotlib, ConfigError for a file that cannot be written.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fame.errors import ConfigError, UnavailableError
from fame.monitor.anomaly.confusion_matrix import Matrix
from fame.monitor.anomaly.paths import BIN, PathDetector, Reading
from fame.monitor.anomaly.recording import ANOMALOUS, Floats, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BENIGN_COLOUR, ANOMALOUS_COLOUR, MISSED_COLOUR, QUIET = "#2b6ca3", "#c2371f", "#e0a21b", "#8a8f98"
_INCHES, _DPI = (7.0, 5.6), 120


def joint_space(path: Path, recording: Recording, predicted: Any = None, *, title: str = "Joint space") -> None:
    """All points on three principal components. `predicted` (points,) are labels that a classifier gave them."""
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
    """How far each run is off the benign paths and how late it is along the path, with the limits. Runs have names."""
    figure = _figure((8.0, 6.0))
    above, below = figure.subplots(2, 1, sharex=True)
    for name, run in runs:
        readings = detector.follow(run)
        phase = [reading.phase for reading in readings]
        line = above.plot(phase, [1000 * reading.deviation for reading in readings], linewidth=0.9, label=name)[0]
        below.plot(phase, [reading.lateness for reading in readings], linewidth=0.9, color=line.get_color())
        _mark(above, below, readings)
    edges = BIN * np.arange(len(detector.limits) + 1)
    above.stairs(1000 * detector.limits[:, 0], edges, color=QUIET, label="limit")
    for sign in (1, -1):
        below.stairs(sign * detector.limits[:, 2], edges, color=QUIET)
    above.set(ylabel="off the benign paths (mm)", title="Deviation along the path (dots: anomalous points)")
    below.set(ylabel="late (samples)", xlabel="place along the path (samples of a benign run)")
    above.legend(fontsize=8)
    _save(figure, path)


def matrices(path: Path, told: Sequence[tuple[str, Matrix]], *, unit: str = "runs") -> None:
    """A confusion matrix for each entry: its title and counts."""
    columns = min(3, max(1, len(told)))
    rows = -(-len(told) // columns) or 1
    figure = _figure((2.6 * columns + 0.4, 2.5 * rows + 0.4))
    for number, (title, matrix) in enumerate(told):
        axes = figure.add_subplot(rows, columns, number + 1)
        counts = np.array([[matrix.tp, matrix.fn], [matrix.fp, matrix.tn]])
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1.6)
        for (row, column), count in np.ndenumerate(counts):
            axes.text(column, row, str(count), ha="center", va="center", fontsize=12)
        axes.set(xticks=(0, 1), yticks=(0, 1), xticklabels=("anomalous", "benign"), yticklabels=("anom.", "benign"))
        axes.set_title(title, fontsize=9)
        axes.tick_params(labelsize=8)
        axes.set_xlabel("judged", fontsize=8)
        axes.set_ylabel(f"true ({unit})", fontsize=8)
    _save(figure, path)


def _mark(above: Any, below: Any, readings: Sequence[Reading]) -> None:
    """Dots where a point is anomalous."""
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
            ("judged anomalous", ANOMALOUS_COLOUR, found),
            ("judged benign", BENIGN_COLOUR, ~found & ~true),
            ("judged benign, but anomalous", MISSED_COLOUR, ~found & true),
        ]
    return [group for group in groups if group[2].any()]


def _components(values: Floats) -> Floats:
    """The points (points, joints) on their first three principal components (points, 3)."""
    centred = values - values.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    found: Floats = centred @ directions[:3].T
    return np.pad(found, ((0, 0), (0, 3 - found.shape[1])))


def _figure(inches: tuple[float, float]) -> Figure:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise UnavailableError("plots need matplotlib: pip install 'fame-robots[sim]'") from None
    figure = Figure(figsize=inches, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, format="png")
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(path)) from None
