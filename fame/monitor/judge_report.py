"""The report of `fame monitor judge`: one static page with tables and plots, and no script."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fame.clock import SECOND
from fame.imports import require
from fame.monitor.arrays import Floats
from fame.monitor.judge import RESAMPLINGS, TELLING, Event, JudgedRun, JudgedRuns, shown
from fame.monitor.plots import ANOMALOUS_COLOUR, BENIGN_COLOUR, MISSED_COLOUR, QUIET, line_style
from fame.text import percent, write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLOTTED = 12
"""Runs with a plot of their own, at most: those with an alarm first, then those that came nearest to one."""
_POINTS = 1500
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:960px;margin:2em auto;padding:0 1em}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em;border-bottom:1px solid #ddd}
table{border-collapse:collapse;width:100%;font-size:14px}
th,td{text-align:left;padding:.25em .6em;border-bottom:1px solid #eee}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}.bad{color:#b3261e;font-weight:600}.good{color:#256029}
svg{width:100%;height:auto;margin-top:1em}
.row{display:flex;flex-wrap:wrap;gap:1em}.row>div{flex:1 1 400px}.quiet{color:#666}
"""


def write_report(judgement: JudgedRuns, card: dict[str, Any], path: str | Path) -> None:
    """Write the page. Raises UnavailableError without matplotlib, ConfigError for a file that cannot be written."""
    parts = [
        f"<h1>{escape(Path(judgement.model).name)}</h1>",
        f'<p class="quiet">{escape(card["Model"]["detector"])}. {escape(_promise(card))}</p>',
        "<h2>Figures</h2>", _figures(judgement),
        _overview(judgement),
        "<h2>Runs</h2>", _runs(judgement.runs),
        _events(judgement.runs),
        _run_plots(judgement.runs),
        "<h2>Model card</h2>", _card(card),
    ]  # fmt: skip
    _write_page(f"{Path(judgement.model).name}: judged runs", parts, path)


def write_refused(runs: Sequence[JudgedRun], reasons: Sequence[str], path: str | Path) -> None:
    """Write a page of runs that a training refused, with reasons, in the band of the others; raises as above."""
    parts = ["<h1>Runs that the training refused</h1>"]
    for run, reason in zip(runs, reasons, strict=True):
        shown = run.farthest(TELLING)
        plot = _svg(9, 0.5 + 1.5 * len(shown), _draw_channels, run, shown, rows=len(shown))
        parts.append(f"<h2>{escape(reason)}</h2>{plot}")
    _write_page("Runs that the training refused", parts, path)


def _draw_channels(axes: Any, run: JudgedRun, channels: Sequence[int]) -> None:
    every = np.atleast_1d(axes)
    for each, channel in zip(every, channels, strict=True):
        _draw_in_band(each, run, channel)
    every[-1].set_xlabel("time in s")


def _write_page(title: str, parts: Sequence[str], path: str | Path) -> None:
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )
    write_file(path, text)


def _promise(card: dict[str, Any]) -> str:
    promise = card.get("False alarms", {}).get("promise", "")
    return f"False alarms: {promise}." if promise else ""


def on_page(judgement: JudgedRuns) -> dict[str, Any]:
    """Return the alarms, and what is drawn of the runs, as plain data for the page of a recording: times in ns of its
    clock, numbers that are not known as None."""
    drawn = [run for run in judgement.runs if run.samples is not None and run.band is not None and run.ratios.size]
    return {
        "model": Path(judgement.model).name,
        "verdicts": [run.verdict for run in judgement.runs],
        "alarms": [
            {"run": run.number, "from": _ns(run.begin + event.start), "until": _ns(run.begin + event.end),
             "text": [each.text for each in event.explanations] or list(event.shares)}
            for run in judgement.runs
            for event in run.events
        ] + [
            {"run": run.number, "from": _ns(run.begin), "until": _ns(run.begin + run.seconds), "text": list(run.order)}
            for run in judgement.runs if run.order
        ],
        "channels": [_curve(run, channel) for run in drawn for channel in run.telling],
    }  # fmt: skip


def _curve(run: JudgedRun, channel: int) -> dict[str, Any]:
    """Return a channel of a run and its band, at most `_POINTS` points."""
    assert run.samples is not None
    assert run.band is not None
    rows = np.unique(np.linspace(0, len(run.samples) - 1, _POINTS).astype(int))
    low, _, high = (part[:, channel] for part in run.band.at(run.times[rows]))
    return {
        "name": run.samples.names[channel],
        "times": [_ns(run.begin + stamp) for stamp in run.samples.stamps[rows].tolist()],
        "values": run.samples.values[rows, channel].tolist(),
        "low": [None if np.isnan(each) else each for each in low.tolist()],
        "high": [None if np.isnan(each) else each for each in high.tolist()],
    }


def _ns(seconds: float) -> int:
    return round(seconds * SECOND)


# ---- tables ----------------------------------------------------------------------------------------------------------


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    numbers = [cell.startswith('<td class="n"') for cell in rows[0]] if rows and heads else []
    kinds = [' class="n"' if number else "" for number in numbers] or [""] * len(heads)
    head = "".join(f"<th{kind}>{escape(text)}</th>" for text, kind in zip(heads, kinds, strict=True))
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>" if heads else f"<table>{body}</table>"


def _cell(text: object, kind: str = "") -> str:
    return f'<td class="{kind}">{escape(str(text))}</td>' if kind else f"<td>{escape(str(text))}</td>"


def _figures(judgement: JudgedRuns) -> str:
    rows = [[_cell(name), _cell(shown(value), "n")] for name, value in judgement.figures.items()]
    judged = "none" if judgement.drift.size else "not judged"
    drift = f"drifting, learn again: {', '.join(judgement.drifting)}" if judgement.drifting else judged
    rows.append([_cell("drift"), _cell(drift, "bad" if judgement.drifting else "n")])
    return _table((), rows) + "".join(f'<p class="quiet">{escape(note)}</p>' for note in judgement.notes)


def _runs(runs: Sequence[JudgedRun]) -> str:
    labelled = any(run.label is not None for run in runs)
    heads = ("run", "file", "verdict", *(("label", "latency") if labelled else ()), "score", "judged", "length", "")
    rows = []
    for run in runs:
        right = (run.label == -1) == run.anomalous  # an alarm of a run without a label counts as wrong
        verdict = _cell(run.verdict, "good" if right and run.verdict != "not judged" else "bad")
        label = {None: "", 1: "benign", -1: "anomalous"}[run.label]
        latency = "" if run.latency is None else f"{run.latency:.3g} s"
        more = (_cell(label), _cell(latency, "n")) if labelled else ()
        rows.append([
            _cell(run.number, "n"), _cell(Path(run.file).name), verdict, *more,
            _cell(f"{run.score:.3g}" if run.ratios.size else "-", "n"), _cell(f"{percent(run.share)} %", "n"),
            _cell(f"{run.seconds:.1f} s", "n"), _cell("; ".join(run.notes)),
        ])  # fmt: skip
    return '<p class="quiet">The score is the largest loss divided by its threshold: above 1 there is an alarm.</p>' + (
        _table(heads, rows)
    )


def _events(runs: Sequence[JudgedRun]) -> str:
    rows = [
        [
            _cell(run.number, "n"), _cell(event.kind), _cell(f"{event.start:.3f} s", "n"),
            _cell(f"{event.end:.3f} s", "n"), _cell(f"{event.peak:.3g}", "n"),
            _cell("; ".join(_channel_texts(event))),
        ]
        for run in runs for event in run.events
    ]  # fmt: skip
    if not rows:
        return ""
    return "<h2>Events</h2>" + _table(("run", "kind", "start", "end", "peak", "channels"), rows)


def _channel_texts(event: Event) -> list[str]:
    """Return each channel of an alarm with its share, and what it did instead of what was expected."""
    explained = {found.channel: found.text.removeprefix(found.channel) for found in event.explanations}
    return [f"{name} {100 * share:.0f} %{explained.get(name, '')}" for name, share in event.shares.items()]


def _card(card: dict[str, Any]) -> str:
    rows = []
    for title, section in card.items():
        items = section.items() if isinstance(section, dict) else [("", sentence) for sentence in section]
        rows += [[_cell(title if n == 0 else ""), _cell(key), _cell(value)] for n, (key, value) in enumerate(items)]
    return _table((), rows)


# ---- plots -----------------------------------------------------------------------------------------------------------


def _svg(width: float, height: float, draw: Callable[..., object], *shown: Any, rows: int = 1) -> str:
    """Return a plot of what is shown as SVG; of several `rows`, `draw` gets an array of axes over one time.

    Raises UnavailableError without matplotlib.
    """
    require("matplotlib")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, sharex=True)
    for each in figure.axes:
        each.spines[["top", "right"]].set_visible(False)
    draw(axes, *shown)
    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "fame", "svg.fonttype": "none"}):  # the same data give the same page
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return re.sub(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"|(<svg [^>]*?)height="[^"]*" width="[^"]*"', r"\1\2",
                  text[text.index("<svg") :], count=1)  # fmt: skip


def _overview(judgement: JudgedRuns) -> str:
    runs = judgement.runs
    plots = [_svg(9, 2.8, _draw_scores, runs)]
    if judgement.drift.size:
        plots.append(_svg(9, 2.8, _draw_drift, judgement))
    labelled = [run for run in runs if run.label is not None and not run.known]
    labels = np.array([run.label == -1 for run in labelled])
    pair = ""
    if 0 < labels.sum() < len(labels):
        scores = np.array([run.score for run in labelled])
        drawn = [_svg(4.4, 3.6, draw, labels, scores) for draw in (_draw_roc, _draw_precision)]
        pair = f'<div class="row">{"".join(f"<div>{plot}</div>" for plot in drawn)}</div>'
    return "".join(plots) + pair


def _draw_scores(axes: Axes, runs: Sequence[JudgedRun]) -> None:
    groups = (
        ("benign", BENIGN_COLOUR, [run for run in runs if not run.anomalous]),
        ("alarm", ANOMALOUS_COLOUR, [run for run in runs if run.anomalous]),
        ("labelled anomalous, no alarm", MISSED_COLOUR, [r for r in runs if r.label == -1 and not r.anomalous]),
    )
    for name, colour, chosen in groups:
        if chosen:
            numbers, scores = [run.number for run in chosen], [max(run.score, 1e-3) for run in chosen]
            axes.scatter(numbers, scores, s=16, color=colour, label=name, zorder=3)
    axes.axhline(1, color="black", linewidth=0.8, linestyle="--", label="threshold")
    axes.locator_params(axis="x", integer=True)
    axes.set(xlabel="run", ylabel="largest loss / threshold", yscale="log", title="Score of each run")
    axes.legend(fontsize=8, frameon=False)


def _draw_drift(axes: Axes, judgement: JudgedRuns) -> None:
    from fame.monitor.drift import LIMIT

    channels = judgement.runs[0].channels
    order = np.argsort(-judgement.drift[-1])[:8]
    for place, channel in enumerate(order):
        colour, style = line_style(place)
        axes.plot(judgement.drift[:, channel], style, color=colour, linewidth=1.2, label=channels[channel])
    axes.axhline(LIMIT, color="black", linewidth=0.8, linestyle="--", label="limit")
    axes.locator_params(axis="x", integer=True)
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.5 * (top - bottom))  # for the legend, which is on no line
    axes.set(xlabel="run, without those labelled anomalous", ylabel="cumulative sum")
    axes.set(title="Drift (channels with the largest sums)")
    axes.legend(fontsize=7, frameon=False, ncols=3, loc="upper left")


def _band(axes: Axes, labels: Any, scores: Any, curve: Callable[[Any, Any], tuple[Floats, Floats]]) -> None:
    """Shade where 95 % of the curves (x growing, y) of resampled runs are."""
    random, grid = np.random.default_rng(0), np.linspace(0, 1, 101)
    drawn = []
    for _ in range(RESAMPLINGS):
        rows = random.integers(0, len(labels), len(labels))
        if 0 < labels[rows].sum() < len(rows):
            x, y = curve(labels[rows], scores[rows])
            drawn.append(np.interp(grid, x, y))
    if drawn:
        low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
        axes.fill_between(grid, low, high, color=BENIGN_COLOUR, alpha=0.15, linewidth=0, label="95 % of resampled runs")


def _draw_roc(axes: Axes, labels: Any, scores: Any) -> None:
    from sklearn.metrics import roc_curve

    _band(axes, labels, scores, lambda truth, drawn: roc_curve(truth, drawn)[:2])
    false, true, _ = roc_curve(labels, scores)
    axes.plot(false, true, drawstyle="steps-post", color=BENIGN_COLOUR, linewidth=1.5)
    axes.plot((0, 1), (0, 1), color=QUIET, linewidth=0.8, linestyle=":")
    point = [(scores[labels == kind] > 1).mean() for kind in (False, True)]
    axes.plot(*point, "o", color=ANOMALOUS_COLOUR, label="at the thresholds")
    axes.set(xlabel="false alarms per benign run", ylabel="found per anomalous run", title="ROC")
    axes.legend(fontsize=8, frameon=False, loc="lower right")


def _draw_precision(axes: Axes, labels: Any, scores: Any) -> None:
    from sklearn.metrics import precision_recall_curve

    def reversed_curve(truth: Any, drawn: Any) -> tuple[Floats, Floats]:
        precision, recall, _ = precision_recall_curve(truth, drawn)
        return recall[::-1], precision[::-1]

    _band(axes, labels, scores, reversed_curve)
    precision, recall, _ = precision_recall_curve(labels, scores)
    axes.plot(recall, precision, drawstyle="steps-post", color=BENIGN_COLOUR, linewidth=1.5)
    axes.set(xlabel="recall", ylabel="precision", ylim=(0, 1.05), xlim=(0, 1.02), title="Precision and recall")
    axes.legend(fontsize=8, frameon=False, loc="lower left")


def _run_plots(runs: Sequence[JudgedRun]) -> str:
    shown = sorted((run for run in runs if run.ratios.size), key=lambda run: (not run.anomalous, -run.score))[:PLOTTED]
    plots = [_run_plot(run) for run in shown]
    if not plots:
        return ""
    rest = f"{len(shown)} of {len(runs)} runs: those with an alarm first, then the next ones."
    if any(run.band is not None for run in shown):
        rest += (
            " Below: the channels of the alarms, otherwise that which deviates most, in the band of the training runs."
        )
    return f'<h2>Losses over time</h2><p class="quiet">{rest}</p>{"".join(plots)}'


def _run_plot(run: JudgedRun) -> str:
    """Plot the losses of a run; below, in the band of the training, the channels that its alarms name, or the one with
    the largest loss."""
    if run.band is None or run.samples is None:
        return _svg(9, 2.6, _draw_run, run)
    channels = run.telling
    return _svg(9, 2.4 + 1.5 * len(channels), _draw_with_bands, run, channels, rows=1 + len(channels))


def _draw_with_bands(axes: Sequence[Axes], run: JudgedRun, channels: Sequence[int]) -> None:
    _draw_run(axes[0], run)
    axes[0].set_xlabel("")
    for below, channel in zip(axes[1:], channels, strict=True):
        _draw_in_band(below, run, channel)
    axes[-1].set_xlabel("time in s")


def _draw_in_band(axes: Axes, run: JudgedRun, channel: int) -> None:
    samples, band = run.samples, run.band
    assert samples is not None
    assert band is not None
    rows = np.unique(np.linspace(0, len(samples) - 1, _POINTS).astype(int))
    stamps = samples.stamps[rows]
    low, middle, high = (part[:, channel] for part in band.at(run.times[rows]))
    axes.fill_between(stamps, low, high, color=BENIGN_COLOUR, alpha=0.2, linewidth=0, label="training runs")
    axes.plot(stamps, middle, color=BENIGN_COLOUR, linewidth=0.8, label="their median")
    axes.plot(stamps, samples.values[rows, channel], color="black", linewidth=0.8, label="this run")
    _mark_events(axes, run)
    axes.set_ylabel(samples.names[channel].rpartition(".")[2])
    axes.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))


def _mark_events(axes: Axes, run: JudgedRun) -> None:
    """Shade the alarms, and draw a line at the onset."""
    for event in run.events:
        axes.axvspan(event.start, max(event.end, event.start + 0.002 * run.seconds), color=ANOMALOUS_COLOUR, alpha=0.15)
    if run.onset is not None:
        axes.axvline(run.onset, color=MISSED_COLOUR, linewidth=1.5, label="onset (label)")


def _draw_run(axes: Axes, run: JudgedRun) -> None:
    """Draw the channels with the largest losses; of long streams the largest value of equal parts."""
    part = max(1, len(run.stamps) // _POINTS)
    bounds = np.arange(0, len(run.stamps), part)
    ratios, stamps = np.maximum.reduceat(run.ratios, bounds, axis=0), run.stamps[bounds]
    for place, channel in enumerate(np.argsort(-ratios.max(axis=0))[:6]):
        colour, style = line_style(place)
        label = run.channels[channel].rpartition(".")[2]
        axes.plot(stamps, np.maximum(ratios[:, channel], 1e-3), style, color=colour, linewidth=1, label=label)
    axes.axhline(1, color="black", linewidth=0.8, linestyle="--")
    _mark_events(axes, run)
    axes.set(
        xlabel="time in s", ylabel="loss / threshold", yscale="log", title=f"Run {run.number}, {Path(run.file).name}"
    )
    axes.legend(fontsize=7, frameon=False, ncols=2, loc="upper left", bbox_to_anchor=(1, 1))
