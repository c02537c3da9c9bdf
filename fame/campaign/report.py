"""The result of a campaign: probability of success, distributions, failures by cause, influence of parameters."""

from __future__ import annotations

import csv
import json
import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.campaign.properties import (
    CampaignRow,
    counts,
    lines as lines_of_properties,
    slacks,
    statistics as statistics_of_properties,
)
from fame.campaign.variation import is_number
from fame.imports import require
from fame.intervals import nearest_rank, wilson
from fame.text import percent, write_file, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTED = ("completed", "failed", "timeout")
"""The statuses of runs that took place: impossible worlds and crashed processes are counted apart."""
CRASHED = "crashed"
"""The status of a run whose process died each time: how it ends is not known."""


def counted(rows: Iterable[CampaignRow]) -> list[CampaignRow]:
    """Return the runs that took place: without those of impossible worlds and those that crashed."""
    return [row for row in rows if row["status"] in COUNTED]


def interval(rows: Sequence[CampaignRow], *, property: str | None = None) -> tuple[float, float]:
    """Return Wilson's 95 % interval of the probability of completion, or of that `property` is violated; (0, 1) if no
    run says so."""
    if property is not None:
        return wilson(*counts(rows, property))
    runs = counted(rows)
    return wilson(sum(row["status"] == "completed" for row in runs), len(runs))


def summary(rows: Sequence[CampaignRow]) -> dict[str, Any]:
    """Return the result of a campaign as data."""
    runs = counted(rows)
    done = [row for row in runs if row["status"] == "completed"]
    low, high = interval(rows)
    statuses: defaultdict[str, int] = defaultdict(int)
    for row in rows:
        statuses[row["status"]] += 1
    measures = sorted({name for row in rows for name in row if name.startswith("measure.")})
    return {
        "runs": len(rows),
        "statuses": dict(statuses),
        "probability": round(len(done) / len(runs), 6) if runs else None,
        "interval": [round(low, 6), round(high, 6)],
        "not_known": _not_known(rows),
        "distributions": {
            name.removeprefix("measure."): spread
            for name in ("duration", "distance", "collisions", "lost", *measures)
            if (spread := _spread([row.get(name) for row in done]))
        },
        "unmeasured": {
            name.removeprefix("measure."): missing
            for name in measures
            if (missing := sum(row.get(name) is None for row in done))
        },
        "properties": statistics_of_properties(rows, wilson, _spread),
        "causes": causes(rows),
        "parameters": importance(rows),
    }


def _not_known(rows: Sequence[CampaignRow]) -> str:
    """What runs that crashed leave open; empty without any."""
    done, crashed = (sum(row["status"] == status for row in rows) for status in ("completed", CRASHED))
    least = done / (len(counted(rows)) + crashed) if crashed else 0.0
    text = f"how {crashed} of {len(rows)} runs end, since they crashed; with them as failures it is {least:.3f}"
    return text if crashed else ""


def _unmeasured(figures: Mapping[str, Any]) -> Iterator[str]:
    """A line for each measure that could not be computed in completed runs: its distribution leaves them out."""
    for name, missing in figures["unmeasured"].items():
        yield f"measure {name}: no value in {missing} of {figures['statuses']['completed']} completed runs"


def _spread(values: Sequence[Any]) -> dict[str, float]:
    """Mean and quantiles, by nearest rank, of the numbers among some values; of booleans the share that is true."""
    numbers = [float(value) for value in values if isinstance(value, bool) or is_number(value)]
    if not numbers:
        return {}
    cut = {name: nearest_rank(numbers, share) for name, share in _QUANTILES.items()}
    return {"mean": round(statistics.fmean(numbers), 6), **{name: round(value, 6) for name, value in cut.items()}}


_QUANTILES = {"min": 0.0, "p5": 0.05, "median": 0.5, "p95": 0.95, "max": 1.0}


def causes(rows: Sequence[CampaignRow]) -> list[dict[str, Any]]:
    """Return the runs that did not complete by status and cause, the most frequent first; each with its shortest run.

    Those of impossible worlds and those that crashed are among them.
    """
    groups: defaultdict[tuple[str, str], list[CampaignRow]] = defaultdict(list)
    for row in rows:
        if row["status"] != "completed":
            groups[row["status"], row["cause"]].append(row)
    table = []
    for (status, cause), members in sorted(groups.items(), key=lambda item: -len(item[1])):
        shortest = min(members, key=lambda row: (row.get("duration", 0.0), row["run"]))
        table.append(
            {
                "status": status,
                "cause": cause,
                "count": len(members),
                "seed": shortest["seed"],
                "run": shortest["run"],
                "command": shortest["command"],
            }
        )
    return table


# ---- which parameter matters -----------------------------------------------------------------------------------------


def importance(rows: Sequence[CampaignRow]) -> list[dict[str, Any]]:
    """Return the correlation of each varied value with success, and with the duration of completed
    runs, strongest first.

    Strengths are from 0 (none) to 1: Spearman's rank correlation for numbers, the correlation ratio for choices.
    Places (x, y) count by the stronger coordinate. None is not known: fewer than three runs, the same outcome or value
    in all, or a choice of its own in each.
    """
    runs = counted(rows)
    paths = list(dict.fromkeys(path for row in runs for path in row["changes"]))
    strengths = []
    for path in paths:
        done = [row for row in runs if row["status"] == "completed"]
        success = _strength(
            [row["changes"].get(path) for row in runs], [float(row["status"] == "completed") for row in runs]
        )
        duration = _strength([row["changes"].get(path) for row in done], [float(row["duration"]) for row in done])
        strengths.append({"path": path, "success": success, "duration": duration})
    return sorted(strengths, key=lambda strength: (-(strength["success"] or 0.0), -(strength["duration"] or 0.0)))


def _strength(values: Sequence[Any], outcomes: Sequence[float]) -> float | None:
    texts = [json.dumps(value) for value in values]
    if len(values) < 3 or len(set(outcomes)) < 2 or len(set(texts)) < 2:
        return None
    if all(is_number(value) for value in values):
        return round(_rank_correlation([float(value) for value in values], outcomes), 4)
    if all(isinstance(value, list) and len(value) == 2 and all(map(is_number, value)) for value in values):
        return round(max(_rank_correlation([float(value[axis]) for value in values], outcomes) for axis in (0, 1)), 4)
    if len(set(texts)) == len(texts):
        return None
    return round(_correlation_ratio(texts, outcomes), 4)


def _rank_correlation(values: Sequence[float], outcomes: Sequence[float]) -> float:
    """The size of Spearman's coefficient; 0 if the values are all the same."""
    if len(set(values)) < 2:
        return 0.0
    require("scipy")
    from scipy.stats import spearmanr

    return abs(float(spearmanr(values, outcomes).statistic))


def _correlation_ratio(values: Sequence[str], outcomes: Sequence[float]) -> float:
    """The share of variance between groups, as its root (Pearson's eta)."""
    mean = statistics.fmean(outcomes)
    groups: defaultdict[str, list[float]] = defaultdict(list)
    for value, outcome in zip(values, outcomes, strict=True):
        groups[value].append(outcome)
    total = sum((outcome - mean) ** 2 for outcome in outcomes)
    between = sum(len(group) * (statistics.fmean(group) - mean) ** 2 for group in groups.values())
    return float((between / total) ** 0.5) if total else 0.0


# ---- text, tables, page ----------------------------------------------------------------------------------------------


def text_report(rows: Sequence[CampaignRow]) -> Iterator[str]:
    """Yield the result as lines of text."""
    figures = summary(rows)
    statuses = ", ".join(f"{count} {status}" for status, count in figures["statuses"].items())
    yield f"{figures['runs']} runs: {statuses}"
    if figures["probability"] is not None:
        low, high = figures["interval"]
        yield f"probability of completion: {figures['probability']:.3f} (95 % interval {low:.3f} to {high:.3f}, Wilson)"
    else:
        yield "probability of completion: not known, since no run has ended"
    if figures["not_known"]:
        yield f"not known: {figures['not_known']}"
    for name, spread in figures["distributions"].items():
        values = "  ".join(f"{key} {value:g}" for key, value in spread.items())
        yield f"{name} of completed runs: {values}"
    yield from _unmeasured(figures)
    yield from lines_of_properties(figures["properties"])
    for cause in figures["causes"]:
        yield f"{cause['count']} x {cause['status']}: {cause['cause']}"
        yield f"    {cause['command']}"
    for parameter in figures["parameters"]:
        strengths = (
            f"{'not known' if parameter[name] is None else f'{parameter[name]:.2f}'} on {name}"
            for name in ("success", "duration")
        )
        yield f"{parameter['path']}: strength {', '.join(strengths)}"


def write_reports(
    rows: Sequence[CampaignRow],
    folder: Path,
    scenario: str,
    *,
    parquet: bool = False,
    pages: Mapping[int, str] | None = None,
) -> list[Path]:
    """Write ``runs.csv`` (or ``runs.parquet``), ``summary.json``, ``index.html`` and its plots. Returns their paths.

    `pages`: addresses of pages that show runs, by their number.
    """
    rows = sorted(rows, key=lambda row: row["run"])
    flat = [_flat(row) for row in rows]
    columns = list(dict.fromkeys(name for row in flat for name in row))
    table = folder / ("runs.parquet" if parquet else "runs.csv")
    if parquet:
        require("pandas", "pyarrow")
        import pandas

        values = {name: _column([row.get(name) for row in flat]) for name in columns}
        with writing(table) as part:
            pandas.DataFrame(values).to_parquet(part)
    else:
        with writing(table) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(flat)
    figures = summary(rows)
    files = {
        "summary.json": json.dumps(figures, indent=2) + "\n",
        "index.html": html_report(rows, scenario, pages),
        **{f"{name}.svg": plot for name, plot in _plots(figures, rows).items()},
    }
    for name, text in files.items():
        write_file(folder / name, text)
    return [table, *(folder / name for name in files)]


def _column(values: Sequence[Any]) -> Sequence[Any]:
    """The values of a column, which have one type: numbers of 64 bits, or text if any of them is something else."""
    kinds = {type(value) for value in values} - {type(None)}
    if kinds <= {int, float} and all(-(2**63) <= value < 2**63 for value in values if isinstance(value, int)):
        return values
    return [None if value is None else str(value) for value in values]


def _flat(row: CampaignRow) -> dict[str, Any]:
    """A row without nesting: a column for each varied value."""
    changes = {
        path: value if is_number(value) or isinstance(value, str) else json.dumps(value)
        for path, value in row["changes"].items()
    }
    return {
        **{name: value for name, value in row.items() if name not in ("changes", "command")},
        **changes,
        "command": row["command"],
    }


def html_report(rows: Sequence[CampaignRow], scenario: str, pages: Mapping[int, str] | None = None) -> str:
    """Return one page: the result, the distribution of durations, failures with the commands that
    repeat them and links to those of `pages` (by number of the run), parameters."""
    figures = summary(rows)
    plots = _plots(figures, rows)
    low, high = figures["interval"]
    share, within = "no run has ended", ""
    if figures["probability"] is not None:
        share = f"{percent(figures['probability'], 1)}% completed"
        within = f"; 95&nbsp;% interval {percent(low, 1)}% to {percent(high, 1)}% (Wilson)"
    body = [
        f"<h1>{escape(Path(scenario).name)}: {share}</h1>",
        f"<p>{figures['runs']} runs{within}.</p>",
        f"<p>Not known: {figures['not_known']}.</p>" if figures["not_known"] else "",
        plots["success"],
        _table(("status", "runs"), figures["statuses"].items()),
    ]
    if "duration" in plots:
        body += ["<h2>Duration of completed runs (simulated s)</h2>", plots["duration"]]
    if figures["distributions"]:
        heads = ("", "mean", *_QUANTILES)
        body.append(_table(heads, ((name, *spread.values()) for name, spread in figures["distributions"].items())))
    body += [f"<p>{escape(line)}</p>" for line in _unmeasured(figures)]
    for name, judged in figures["properties"].items():
        share = "not judged" if judged["violation"] is None else f"P(violation) {percent(judged['violation'], 1)}%"
        low, high = judged["interval"]
        body.append(
            f"<h2>{escape(name)}: {share}</h2><p>95&nbsp;% interval {percent(low, 1)}% to {percent(high, 1)}%</p>"
        )
        body.append(_table(("verdict", "runs"), judged["verdicts"].items()))
        if judged["slack"]:
            body += ["<p>Slack of runs in which it holds</p>", _histogram(slacks(rows, name))]
            body.append(_table(("run", "slack", "command"), (tuple(each.values()) for each in judged["nearest"])))
    if figures["causes"]:
        body.append("<h2>Failures by cause</h2>")
        lines = (
            (c["count"], c["status"], c["cause"], _linked(c["seed"], (pages or {}).get(c["run"])), c["command"])
            for c in figures["causes"]
        )
        body.append(_table(("runs", "status", "cause", "seed of the shortest", "command"), lines))
    if figures["parameters"]:
        body += ["<h2>Influence of parameters</h2>", plots["parameters"]]
    head = f'<meta charset="utf-8"><title>{escape(Path(scenario).name)}</title><style>{_STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(body)}</body></html>\n"


_STYLE = """body{font-family:Arial,Helvetica,sans-serif;margin:2em auto;max-width:70em;color:#1f2328}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #d0d7de;padding:.25em .7em;text-align:left}
td:last-child{word-break:break-word}svg{display:block;margin:1em 0}"""
_GREEN, _BLUE = "#1a7f37", "#0969da"


class _Link(str):
    """A cell that is markup."""


def _linked(cell: Any, address: str | None) -> Any:
    return cell if address is None else _Link(f'{cell} <a href="{escape(address)}">watch</a>')


def _table(heads: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    cells = "".join(f"<th>{escape(head)}</th>" for head in heads)
    texts = ((cell if isinstance(cell, _Link) else escape(str(cell)) for cell in line) for line in lines)
    rows = "".join("<tr>" + "".join(f"<td>{text}</td>" for text in line) + "</tr>" for line in texts)
    return f"<table><tr>{cells}</tr>{rows}</table>"


def _plots(figures: Mapping[str, Any], rows: Sequence[CampaignRow]) -> dict[str, str]:
    """The plots of a campaign by name, as SVG; those for which there are values."""
    require("matplotlib")
    from matplotlib.figure import Figure

    low, high = figures["interval"]
    figure = Figure(figsize=(6, 0.8), layout="constrained")
    axes = figure.add_subplot(xlim=(0, 100), yticks=[], xlabel="completed (%)")
    axes.axvspan(100 * low, 100 * high, color=_GREEN, alpha=0.35)
    if figures["probability"] is not None:
        axes.plot(100 * figures["probability"], 0, "o", color=_GREEN)
    plots = {"success": _svg(figure)}
    done = [float(row["duration"]) for row in rows if row["status"] == "completed"]
    if done:
        plots["duration"] = _histogram(done)
    if figures["parameters"]:
        lines = figures["parameters"][::-1]
        figure = Figure(figsize=(7, 0.8 + 0.3 * len(lines)), layout="constrained")
        axes = figure.add_subplot(xlim=(0, 1), xlabel="strength")
        for offset, name, colour in ((0.2, "success", _GREEN), (-0.2, "duration", _BLUE)):
            places = [number + offset for number in range(len(lines))]
            axes.barh(places, [one[name] or 0.0 for one in lines], 0.4, color=colour, label=f"on {name}")
        axes.set_yticks(range(len(lines)), [one["path"] for one in lines])
        axes.legend()
        plots["parameters"] = _svg(figure)
    return plots


def _histogram(values: Sequence[float]) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 1.8), layout="constrained")
    figure.add_subplot(ylabel="runs").hist(values, bins=30, color=_BLUE)
    return _svg(figure)


def _svg(figure: Figure) -> str:
    """A figure as an element of a page or a file of its own."""
    from matplotlib import rc_context

    text = StringIO()
    with rc_context({"svg.hashsalt": "fame"}):  # the same rows give the same page
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]
