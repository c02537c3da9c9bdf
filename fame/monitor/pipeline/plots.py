"""Pictures of what a pipeline saw: a number over time, with thresholds and alarms."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fame.extras import require
from fame.monitor.pipeline.processor import Samples


class Line(Protocol):
    """What is drawn: a label, stamps (s), values, names of the channels."""

    label: str
    stamps: list[float]
    values: list[Any]
    names: tuple[str, ...]


def plot_loss(
    loss: Samples, file: str | Path, *, thresholds: Sequence[float] = (), alarms: Sequence[float] = (), title: str = ""
) -> None:
    """Loss over time, a line per channel, each with its threshold in its colour (one for all in black), and alarms (s).

    Writes a PNG. Raises UnavailableError without matplotlib.
    """
    figure, axes = _figure(title)
    values = loss.channels()
    names = loss.names or tuple(map(str, range(values.shape[1])))
    begin = float(loss.stamps[0]) if len(loss) else 0.0
    for channel, name in enumerate(names):
        (line,) = axes.plot(loss.stamps - begin, values[:, channel], linewidth=1, label=name.rpartition(".")[2])
        if len(thresholds) == len(names) > 1:
            axes.axhline(thresholds[channel], color=line.get_color(), linestyle="--", linewidth=0.8)
    if len(thresholds) == 1 or (len(names) == 1 and thresholds):
        axes.axhline(thresholds[0], color="black", linestyle="--", linewidth=0.8, label="threshold")
    for number, alarm in enumerate(alarms):
        axes.axvline(alarm - begin, color="red", linewidth=1, label="" if number else "alarm")
    axes.set(xlabel="time in s", ylabel="loss")
    _save(figure, axes, file)


def plot_series(series: Sequence[Line], file: str | Path, *, thresholds: Sequence[float] = ()) -> None:
    """Numbers of topics over time. Writes a PNG. Raises UnavailableError without matplotlib."""
    figure, axes = _figure("")
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
    _save(figure, axes, file)


def _figure(title: str) -> tuple[Any, Any]:
    require("matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.set_title(title)
    axes.grid(alpha=0.3)
    return figure, axes


def _save(figure: Any, axes: Any, file: str | Path) -> None:
    axes.legend(loc="upper right", fontsize="small", ncols=2)
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
