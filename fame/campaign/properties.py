"""Properties in a campaign: the probability that a run violates one, and how close the others came."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from fame.properties.judgement import Judgement

CampaignRow = Mapping[str, Any]
VERDICT, SLACK = "property.", "slack."
"""Beginnings of the columns of a property."""
NEAREST = 5
"""Number of nearest misses that are shown."""


def columns(judgements: Iterable[Judgement]) -> dict[str, Any]:
    """Return the columns of a run."""
    return {
        key: value
        for judgement in judgements
        for key, value in (
            (f"{VERDICT}{judgement.name}", judgement.verdict),
            (f"{SLACK}{judgement.name}", judgement.slack),
        )
    }


def names(rows: Iterable[CampaignRow]) -> list[str]:
    """Return the properties that runs were judged by."""
    return list(dict.fromkeys(key.removeprefix(VERDICT) for row in rows for key in row if key.startswith(VERDICT)))


def counts(rows: Iterable[CampaignRow], name: str) -> tuple[int, int]:
    """Return how many runs violate a property, of how many that violate it or in which it holds."""
    words = Counter(row.get(VERDICT + name) for row in rows)
    return words["violated"], words["violated"] + words["holds"]


def statistics(
    rows: Sequence[CampaignRow],
    interval: Callable[[int, int], tuple[float, float]],
    spread: Callable[[Sequence[Any]], dict[str, float]],
) -> dict[str, Any]:
    """Return the result about each property, as data.

    The probability is of a violation in a run that could be judged: those in which it was not triggered, pending or not
    known are counted apart. The nearest misses are the runs with the least slack in which it holds.
    """
    figures = {}
    for name in names(rows):
        violated, judged = counts(rows, name)
        low, high = interval(violated, judged)
        words = Counter(row[VERDICT + name] for row in rows if VERDICT + name in row)
        close = [row for row in rows if row.get(VERDICT + name) == "holds" and row[SLACK + name] is not None]
        close.sort(key=lambda row: (row[SLACK + name], row["run"]))
        broken = [row for row in rows if row.get(VERDICT + name) == "violated"]
        figures[name] = {
            "verdicts": dict(words),
            "violation": round(violated / judged, 6) if judged else None,
            "interval": [round(low, 6), round(high, 6)],
            "slack": spread([row[SLACK + name] for row in close]),
            "violated": [_shown(row, name) for row in broken[:1]],
            "nearest": [_shown(row, name) for row in close[:NEAREST]],
        }
    return figures


def slacks(rows: Iterable[CampaignRow], name: str) -> list[float]:
    """Return the slacks of the runs in which a property holds."""
    held = (row[SLACK + name] for row in rows if row.get(VERDICT + name) == "holds")
    return [float(slack) for slack in held if slack is not None]


def _shown(row: CampaignRow, name: str) -> dict[str, Any]:
    return {"run": row["run"], "slack": row[SLACK + name], "command": row["command"]}


def lines(figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield the result about each property as text."""
    for name, judged in figures.items():
        words = ", ".join(f"{count} {word}" for word, count in judged["verdicts"].items())
        low, high = judged["interval"]
        share = (
            "" if judged["violation"] is None else f"; P(violation) {judged['violation']:.3f} ({low:.3f} to {high:.3f})"
        )
        yield f"property {name}: {words}{share}"
        if judged["slack"]:
            yield f"    slack: {'  '.join(f'{key} {value:g}' for key, value in judged['slack'].items())}"
        yield from (f"    violated: {each['command']}" for each in judged["violated"])
        yield from (f"    slack {each['slack']:.3g}: {each['command']}" for each in judged["nearest"])
