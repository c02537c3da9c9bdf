"""Judge recorded data by a model, with the code that runs live: a verdict per run, events, and figures over all runs.

Data are runs of CSV files, or one long stream. If they have labels (-1 anomalous), the first anomalous sample of a run
is its onset: latency counts from there, and an alarm that ended before it does not count as found.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from fame.dataclasses import dataclass, field, replace
from fame.errors import NOT_KNOWN, ConfigError
from fame.intervals import interval
from fame.monitor.arrays import Floats, Whole
from fame.monitor.copies import RUN_HASHES, run_hash
from fame.text import writing

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model
    from fame.monitor.anomaly.recording import Recording
    from fame.monitor.data_files import LabelledRun
    from fame.monitor.pipeline.band import Band, Explanation
    from fame.monitor.pipeline.input_node import LeftOut
    from fame.monitor.pipeline.processor import Samples
    from fame.monitor.pipeline.trained_model import TrainedModel

RESAMPLINGS = 500
"""Of the runs, for the intervals of the areas under the curves."""
FREQUENCY = 50.0
"""Of the calls of the processors, Hz, as in a processing node."""
TELLING = 3
"""Channels of a run that are drawn in the band of the training runs, at most."""
CUT = 0.8
"""A run shorter than this part of the shortest training run was cut off, where runs have a length of their own."""
ROWS = ("found", "false alarms", "missed", "quiet")
"""Rows of a run with labels: anomalous ones with an alarm, benign ones with one, anomalous without, benign without."""
WHOLE = 0.99
"""Share of a run that has to be judged to call it benign: a window may end before the last samples."""


@dataclass(frozen=True, slots=True)
class Event:
    """An alarm: from `start` to `end`, s from the start of the run; the share of each channel in what exceeded, and
    what each of these did where the training runs did something else."""

    start: float
    end: float
    peak: float
    shares: dict[str, float]
    kind: str = "anomaly"
    explanations: tuple[Explanation, ...] = ()


@dataclass(frozen=True, slots=True)
class JudgedRun:
    """The verdict on a run.

    stamps, ratios  of the losses: (n,) s from the start, (n, channels) divided by the thresholds
    label           -1 anomalous, 1 benign, None without labels; `onset` and `latency` in s
    share           of the run that has been judged
    samples         what was judged, with stamps in s from the start, by a model whose training runs had a `band`;
                    `times` (n,) are their places in it: s on the axis of phases, or numbers of points
    begin           the stamp of the first sample, s
    cut             its file is incomplete: how it went on is not known
    known           the model has learned from it: its verdict says nothing about other runs
    order           what is wrong with the order of its elements of the mission
    rows            of a run with labels, how many judged rows are of each kind of `ROWS`
    """

    number: int
    file: str
    seconds: float
    events: tuple[Event, ...]
    stamps: Floats
    ratios: Floats
    channels: tuple[str, ...]
    label: int | None = None
    onset: float | None = None
    notes: tuple[str, ...] = ()
    share: float = 1.0
    samples: Samples | None = None
    band: Band | None = None
    times: Floats = field(default_factory=lambda: np.zeros(0))
    begin: float = 0.0
    cut: bool = False
    known: bool = False
    order: tuple[str, ...] = ()
    rows: tuple[int, ...] = (0, 0, 0, 0)

    @property
    def verdict(self) -> str:
        """``anomalous`` after an alarm, ``benign`` if all of the run was judged, otherwise ``not judged``."""
        return "anomalous" if self.anomalous else "benign" if self.share >= WHOLE and not self.cut else "not judged"

    @property
    def score(self) -> float:
        """The largest loss divided by its threshold."""
        return float(self.ratios.max()) if self.ratios.size else 0.0

    @property
    def anomalous(self) -> bool:
        return bool(self.events or self.order)

    @property
    def telling(self) -> list[int]:
        """The channels of the alarms, at most `TELLING`; of a run without one that which deviates most."""
        assert self.samples is not None
        names = self.samples.names
        named = dict.fromkeys(names.index(name) for event in self.events for name in event.shares)
        if named or self.channels != names:
            return list(named)[:TELLING] or self.farthest(1)
        return [int(self.ratios.max(axis=0).argmax())]

    def farthest(self, count: int) -> list[int]:
        """Return the channels that lie farthest outside of the band, relative to its mean width."""
        assert self.samples is not None
        assert self.band is not None
        low, _, high = self.band.at(self.times)
        outside = np.nan_to_num(np.maximum(low - self.samples.values, self.samples.values - high)).max(axis=0)
        order = np.argsort(-outside / np.maximum(np.nan_to_num(high - low).mean(axis=0), 1e-12))
        return [int(channel) for channel in order[:count]]

    @property
    def latency(self) -> float | None:
        """From the onset to the first alarm that was still on then, s; None without a label or alarm."""
        if self.onset is None:
            return None
        found = [max(0.0, event.start - self.onset) for event in self.events if event.end >= self.onset]
        return min(found, default=None)


@dataclass(frozen=True, slots=True)
class JudgedRuns:
    """All runs, and the figures over them."""

    model: str
    runs: tuple[JudgedRun, ...]
    drifting: tuple[str, ...] = ()
    drift: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """1 if a run is anomalous, otherwise 3 if a run is not judged or no runs were given, otherwise 0."""
        verdicts = {run.verdict for run in self.runs}
        return 1 if "anomalous" in verdicts else 0 if verdicts == {"benign"} else NOT_KNOWN

    @property
    def figures(self) -> dict[str, Any]:
        """Counts, rates with 95 % intervals, latencies, and areas under the curves where there are labels.

        False alarms are those of benign runs that have been judged; alarms per hour of all, without any label. What the
        model has learned from counts in no rate.
        """
        labelled, new = any(run.label is not None for run in self.runs), [run for run in self.runs if not run.known]
        benign = [run for run in new if run.label == (1 if labelled else None) and run.verdict != "not judged"]
        hours = sum(run.seconds * run.share for run in benign) / 3600
        seconds = sum(run.seconds for run in self.runs)
        false_alarms = sum(run.anomalous for run in benign)
        events = sum(len(run.events) for run in benign)
        values: dict[str, Any] = {
            "runs": len(self.runs), "with an alarm": sum(run.anomalous for run in self.runs),
            "not judged": sum(run.verdict == "not judged" for run in self.runs), "hours": round(seconds / 3600, 4),
            "share judged": round(sum(run.seconds * run.share for run in self.runs) / seconds, 4) if seconds else None,
        }  # fmt: skip
        if len(new) < len(self.runs):
            values["learned from"] = len(self.runs) - len(new)
        if not labelled:
            return {**values, "alarms per hour": events / hours if hours else None}
        if unknown := sum(run.label is None for run in new):
            values["without label"] = unknown
        values |= {
            "benign runs": len(benign), "false alarms": false_alarms,
            "false alarms per run": _rate(false_alarms, len(benign)),
            "false alarms per hour": events / hours if hours else None,
        }  # fmt: skip
        anomalous = [run for run in new if run.label == -1]
        found = [run.latency for run in anomalous if run.latency is not None]
        values |= {
            "anomalous runs": len(anomalous),
            "found": len(found),
            "found per run": _rate(len(found), len(anomalous)),
        }
        if found:
            values["latency s"] = {"median": float(np.median(found)), "largest": max(found)}
        hit, false, missed, quiet = (sum(run.rows[n] for run in new) for n in range(4))
        if hit + missed and false + quiet:  # where an alarm is on or off, as for a stream; beside what is always on
            values |= {
                "rows with a false alarm": _rate(false, false + quiet), "rows missed": _rate(missed, hit + missed),
                "F1 of rows": _f1(hit, false, missed),
                "F1 if the alarm were always on": _f1(hit + missed, false + quiet, 0),
            }  # fmt: skip
        scored = [run for run in self.scored if run.label is not None and not run.known]
        if len({run.label == -1 for run in scored}) == 2:
            values |= areas(np.array([run.score for run in scored]), np.array([run.label == -1 for run in scored]))
        return values

    @property
    def scored(self) -> tuple[JudgedRun, ...]:
        """The runs that have been judged at least in part."""
        return tuple(run for run in self.runs if run.ratios.size)

    def to_plain(self) -> dict[str, Any]:
        """Return everything but the losses as plain data."""
        return {
            "model": self.model, "figures": self.figures, "drifting": list(self.drifting), "notes": list(self.notes),
            "runs": [
                {
                    "run": run.number, "file": run.file, "verdict": run.verdict, "share judged": run.share,
                    "score": run.score if run.ratios.size else None, "seconds": run.seconds,
                    "label": run.label, "onset": run.onset, "order": list(run.order),
                    "latency": run.latency, "learned from": run.known, "notes": list(run.notes),
                    "rows": dict(zip(ROWS, run.rows, strict=True)),
                    "events": [
                        {"kind": each.kind, "start": each.start, "end": each.end, "peak": each.peak,
                         "shares": each.shares, "explanations": [found.text for found in each.explanations]}
                        for each in run.events
                    ],
                }
                for run in self.runs
            ],
        }  # fmt: skip

    def cut_in(self, files: Iterable[Path]) -> JudgedRuns:
        """Return the runs, the last one of each incomplete file marked as cut."""
        runs, last = list(self.runs), {run.file: number for number, run in enumerate(self.runs)}
        for number in {last[str(file)] for file in files if str(file) in last}:
            note = "the recording is incomplete: how the run went on is not known"
            runs[number] = replace(runs[number], cut=True, notes=(*runs[number].notes, note))
        return replace(self, runs=tuple(runs))


def mark_known(runs: Sequence[JudgedRun], numbers: Iterable[int]) -> tuple[JudgedRun, ...]:
    """Mark the runs of these numbers as those that a model has learned from."""
    note, known = "learned from: counts in no rate", set(numbers)
    return tuple(
        replace(run, known=True, notes=(*run.notes, note)) if run.number in known and not run.known else run
        for run in runs
    )


def _f1(hit: int, false: int, missed: int) -> float:
    return 2 * hit / (2 * hit + false + missed)


def _rate(count: int, total: int) -> dict[str, Any]:
    low, high = interval(count, total)
    return {"rate": count / total if total else None, "interval": [low, high]}


def shown(value: Any) -> str:
    if isinstance(value, dict) and "interval" in value:
        low, high = value["interval"]
        centre = value.get("rate", value.get("value"))
        return f"{shown(centre)} (95 %: {low:.3g} to {high:.3g})"
    if isinstance(value, dict):
        return ", ".join(f"{name} {shown(part)}" for name, part in value.items())
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def write_scores(judgement: JudgedRuns, path: Path) -> None:
    """Write a row per loss: file, run, time (s from the start of the run), and of each channel the loss divided by its
    threshold, above 1 in an alarm. Raises ConfigError for a file that cannot be written."""
    with writing(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(("file", "run", "time", *(judgement.runs[0].channels if judgement.runs else ())))
        for run in judgement.runs:
            for stamp, ratios in zip(run.stamps.tolist(), run.ratios, strict=True):
                rows.writerow((run.file, run.number, f"{stamp:.9g}", *(f"{ratio:.6g}" for ratio in ratios)))


# ---- curves ----------------------------------------------------------------------------------------------------------


def areas(scores: Floats, positive: Any) -> dict[str, Any]:
    """Return the areas under the ROC and the precision-recall curve with 95 % bootstrap intervals over runs."""
    random = np.random.default_rng(0)
    draws = []
    for _ in range(RESAMPLINGS):
        rows = random.integers(0, len(scores), len(scores))
        if 0 < positive[rows].sum() < len(rows):
            draws.append(_areas(scores[rows], positive[rows]))
    low, high = np.quantile(draws, [0.025, 0.975], axis=0) if draws else (np.zeros(2), np.ones(2))
    names = ("area under ROC", "average precision")
    return {
        name: {"value": value, "interval": [float(low[n]), float(high[n])]}
        for n, (name, value) in enumerate(zip(names, _areas(scores, positive), strict=True))
    }


def _areas(scores: Floats, positive: Any) -> tuple[float, float]:
    """Return the area under the ROC curve and the average precision, as scikit-learn does, in 1/100 of its time."""
    levels, places = np.unique(-scores, return_inverse=True)  # equal scores share a threshold
    found = np.bincount(places, positive, len(levels))
    hits, alarms = np.cumsum(found), np.cumsum(np.bincount(places, minlength=len(levels)))
    false = np.diff(alarms - hits, prepend=0)
    roc = ((hits - found / 2) * false).sum() / (hits[-1] * (alarms[-1] - hits[-1]))
    return float(roc), float((found * hits / alarms).sum() / hits[-1])


# ---- runs by either kind of model ------------------------------------------------------------------------------------

AnyModel = TypeVar("AnyModel", "TrainedModel", "Model")


def _judged(
    model: AnyModel, runs: Sequence[LabelledRun], judge: Callable[[AnyModel, LabelledRun, int], JudgedRun]
) -> tuple[JudgedRun, ...]:
    """Judge runs, take their labels and mark those that the model has learned from. Raises ConfigError for labels that
    contradict each other."""
    seen: dict[bytes, tuple[int, Whole]] = {}
    for number, run in enumerate(runs):
        if run.labelled:
            first, labels = seen.setdefault(run.samples.values.tobytes(), (number, run.labels))
            if not np.array_equal(labels, run.labels):
                text = f"runs {first} and {number} are the same points, but their labels differ"
                raise ConfigError(text, file=run.file)
    judged = [_labelled(judge(model, run, number), run) for number, run in enumerate(runs)]
    hashes = set(model.conditions.get(RUN_HASHES, ()))  # none of an earlier version
    values = (run.samples.channels() if len(run.samples) else np.zeros((0, 0)) for run in runs if hashes)
    return mark_known(judged, [number for number, each in enumerate(values) if run_hash(each) in hashes])


def _labelled(judged: JudgedRun, run: LabelledRun) -> JudgedRun:
    if not run.labelled:
        return judged
    wrong = np.flatnonzero(run.labels == -1)
    assert judged.samples is not None
    at = judged.samples.stamps.searchsorted(judged.stamps + 1e-9, side="right") - 1
    anomalous = run.labels[at] == -1
    alarm = np.zeros(len(at), dtype=bool)
    for event in judged.events:
        alarm |= (judged.stamps >= event.start) & (judged.stamps <= event.end)
    pairs = (alarm & anomalous, alarm & ~anomalous, ~alarm & anomalous, ~alarm & ~anomalous)
    onset = float(judged.samples.stamps[wrong[0]]) if len(wrong) else None
    rows = tuple(int(pair.sum()) for pair in pairs)
    return replace(judged, rows=rows, label=-1 if len(wrong) else 1, onset=onset)


def _explained(
    events: Iterable[Event], samples: Samples, times: Floats, band: Band | None, window: float
) -> tuple[Event, ...]:
    """Compare the channels of alarms with the band of the training, if there is one, each from the begin of its first
    window (s) to its end."""
    found = []
    for event in events:
        rows = (samples.stamps > event.start - window) & (samples.stamps <= event.end)
        part = samples.replace(samples.values[rows], samples.stamps[rows])
        channels = [samples.names.index(name) for name in event.shares]
        shares = tuple(event.shares.values())
        told = () if band is None else band.explain(part, times[rows], channels, shares)
        found.append(replace(event, explanations=told))
    return tuple(found)


def _seconds(stamps: Floats) -> float:
    return float(stamps[-1] - stamps[0]) if len(stamps) else 0.0


# ---- models of fame monitor train ------------------------------------------------------------------------------------


def judge_trained(model: TrainedModel, runs: Sequence[LabelledRun], name: str) -> JudgedRuns:
    """Judge runs by a model of ``fame monitor train``. Raises ConfigError for labels that contradict each other."""
    from fame.monitor.drift import DriftMonitor

    judged = _judged(model, runs, _judge_run)
    if model.calibration is None:
        return JudgedRuns(name, judged)
    monitor, sums = DriftMonitor.of(model.columns, model.calibration), []
    for run in judged:
        if run.ratios.size and run.label != -1:
            monitor.add(run.ratios.max(axis=0) * np.array(model.thresholds))
            sums.append(monitor.sums)
    return JudgedRuns(name, judged, monitor.drifting, np.array(sums))


def _judge_run(model: TrainedModel, run: LabelledRun, number: int) -> JudgedRun:
    from fame.monitor.pipeline import processors, sequence
    from fame.monitor.pipeline.elements import run_times
    from fame.monitor.pipeline.estimators import Autoencoder
    from fame.monitor.pipeline.filters import LowPass
    from fame.monitor.pipeline.processor import Samples
    from fame.monitor.pipeline.threshold import Threshold

    notes: list[str] = []
    stride = int(model.conditions.get("settings", {}).get("stride", 5))
    chain: list[Any] = [LowPass(cutoff=model.before)] if model.before else []
    scorer = Autoencoder(model, stride=stride)
    scorer.elements = run.samples.elements
    scorer.cycles = _seconds(run.samples.stamps) > scorer.longest  # a machine that never stops
    chain += [scorer, *([LowPass(cutoff=model.cutoff)] if model.cutoff else [])]
    threshold = Threshold(threshold=model.thresholds, names=model.columns)
    for processor in (*chain, threshold):
        processor.report = lambda text: notes.append(text) if text not in notes else None
    samples = run.samples
    empty = Samples(np.zeros((0, len(model.columns))), np.zeros(0))
    loss = processors.run(chain, {"x": samples}, FREQUENCY).get("loss", empty)
    nothing = Samples(np.zeros(0), np.zeros(0))
    active = processors.run([threshold], {"loss": loss}).get("active", nothing) if len(loss) else nothing
    judged = np.isin(loss.stamps, active.stamps)
    loss = loss.replace(np.nan_to_num(loss.values[judged], nan=0.0), loss.stamps[judged])  # of which others are above
    begin = float(samples.stamps[0]) if len(samples) else 0.0
    stamps, ratios = loss.stamps - begin, loss.values / np.array(model.thresholds)
    events = spans(stamps, active.values, ratios, model.columns)
    elements = tuple((stamp - begin, name) for stamp, name in samples.elements)
    shown = Samples(samples.channels(), samples.stamps - begin, model.columns, elements)
    times = run_times(shown, shown.stamps, model.elements) if len(shown) else shown.stamps
    events = _explained(events, shown, times, model.band, model.window / model.rate)
    said = notes if len(samples) else [*notes, *run.notes]
    if not len(loss) and not any(text.endswith(": not judged") for text in said):
        notes.append(f"no whole window of {model.window} samples at {model.rate:.4g} Hz: not judged")
    if run.lacking:
        notes.append(f"{run.lacking}: left out")
    seconds = _seconds(samples.stamps) if run.seconds < 0 else run.seconds
    share = min(run.seen, _share(stamps, model.window / model.rate, seconds, stride / model.rate, scorer.latest))
    notes += run.notes
    order = sequence.judged(run.samples, model.conditions.get("order", {}))
    notes += order
    shortest = _shortest(model)
    if len(loss) and seconds < CUT * shortest:
        share = min(share, seconds / shortest)
        notes.append(f"cut off before its end: {seconds:.3g} s, training runs last at least {shortest:.3g} s")
    return JudgedRun(
        number, run.file, seconds, events, stamps, ratios, model.columns, notes=tuple(notes), share=share,
        samples=shown, band=model.band, times=times, begin=begin, order=tuple(order),
    )  # fmt: skip


def _shortest(model: TrainedModel) -> float:
    """Return how long (s) the shortest training run lasted, if the runs repeat a task and only time tells how far it
    is; otherwise 0: a part of such a run is judged as well as all of it."""
    from fame.monitor.pipeline.phases import Phases

    settings = model.conditions.get("settings", {})
    repeat = Phases.kind in settings.get("detector", "") or (model.band is not None and len(model.band.times) > 1)
    return float(model.conditions.get("seconds", (0.0,))[0]) if repeat and not model.elements else 0.0


def _share(stamps: Floats, window: float, seconds: float, stride: float, late: float = 0.0) -> float:
    """Return the share of a run that lies in a window, which ends at one of `stamps` (s).

    What is left at the end for lack of a whole `stride` counts as judged, but not what lies between two windows, and
    what came before a run that began up to `late` (s) late is no part of it.
    """
    if not len(stamps):
        return 0.0
    missing = float(np.maximum(np.diff(stamps) - window, 0.0).sum())
    before, after = float(stamps[0]) - window, seconds - float(stamps[-1])
    missing += (before if before >= late + 1.5 * stride else 0.0) + (after if after >= 1.5 * stride else 0.0)
    return max(0.0, 1 - missing / seconds) if missing > 0 else 1.0


def spans(stamps: Floats, active: Any, ratios: Floats, channels: Sequence[str]) -> tuple[Event, ...]:
    """Return the events of a run from whether the alarm was on at each stamp."""
    if not len(active) or not active.any():
        return ()
    edges = np.diff(np.concatenate(([0], active.astype(int), [0])))
    found = []
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        above = np.maximum(ratios[first:last] - 1, 0).sum(axis=0)
        total = float(above.sum()) or 1.0
        order = np.argsort(-above)[:3]
        shares = {channels[n]: round(float(above[n]) / total, 4) for n in order if above[n] > 0}
        found.append(Event(float(stamps[first]), float(stamps[last - 1]), float(ratios[first:last].max()), shares))
    return tuple(found)


# ---- models of fame monitor adm learn --------------------------------------------------------------------------------


def judge_recordings(model: Model, paths: Sequence[Path], name: str, topic: str = "/joint_states") -> JudgedRuns:
    """Judge recordings of joint states by a model of ``fame monitor adm learn``: CSV files, and bags with such a topic.

    Raises ConfigError for other joints, and for labels that contradict each other.
    """
    from fame.monitor.anomaly.recording import in_joint_order, read_csv
    from fame.monitor.data_files import LabelledRun
    from fame.monitor.pipeline.processor import Samples

    runs: list[LabelledRun] = []
    notes: list[str] = []
    for path in paths:
        recording, left_out = (read_csv(path), ()) if path.suffix == ".csv" else _joint_states(model, path, topic)
        recording = in_joint_order(recording, model.joints)
        notes += recording.notes
        seen = min((each.seen for each in left_out), default=1.0)  # nobody knows of which runs they are
        texts = tuple(each.text for each in left_out if each.seen < 1)
        for run in recording:
            stamps = np.full(len(run), np.nan) if run.stamps is None else run.stamps
            samples = Samples(run.values, stamps, model.joints)
            runs.append(LabelledRun(samples, run.labels, str(path), labelled=run.labelled, seen=seen, notes=texts))
    return JudgedRuns(name, _judged(model, runs, _judge_points), notes=tuple(dict.fromkeys(notes)))


def _joint_states(model: Model, path: Path, topic: str) -> tuple[Recording, tuple[LeftOut, ...]]:
    """Read the joint states of a bag, in runs that begin and end at home as in CSV files, and what of it was left out.
    Raises ConfigError."""
    from fame.monitor.anomaly.live import Collector
    from fame.monitor.anomaly.nodes import ArmOptions, RunNode, bag_topics
    from fame.monitor.anomaly.recording import Recording, number_runs
    from fame.monitor.data_files import incomplete
    from fame.monitor.pipeline.recording import play

    collector, notes = Collector(1, "count", cycle=sys.maxsize), list[str]()
    collector.joints = model.joints
    make = partial(RunNode, runs=collector, arm=ArmOptions(topic=topic, report=notes.append))
    node = play(path, make, bag_topics(topic, "count"))
    if not collector.rows:
        raise ConfigError(notes[0] if notes else f"has no messages on {topic}", file=str(path))
    stamps, values = (np.array(part) for part in zip(*collector.rows, strict=True))
    kept, runs = number_runs(values, np.ones(len(values), dtype=np.int64))
    found = Recording(
        model.joints, values[kept], np.ones(len(runs), dtype=np.int64), runs, stamps[kept], str(path),
        (*incomplete(path), *notes), labelled=False,
    )  # fmt: skip
    return found, node.left_out


def _judge_points(model: Model, run: LabelledRun, number: int) -> JudgedRun:
    from fame.monitor.anomaly.live import RunMonitor

    monitor = RunMonitor(model, rule="signal")
    monitor.begin()
    period, values, given = model.period or 1.0, run.samples.values, run.samples.stamps
    timed, numbers = bool(np.isfinite(given).all()), np.arange(len(values), dtype=np.float64)
    stamps = np.asarray(given - given[0] if timed else numbers * period, dtype=np.float64)
    times = stamps.tolist() if timed else [0.0] * len(values)
    steps = (monitor.step(*point) for point in zip(times, values.tolist(), strict=True))
    points = [point for point in steps if point is not None]
    monitor.end()
    (report,) = monitor.ended
    scores = np.array([[point.score / model.threshold if model.threshold else float(point.verdict.anomalous)]
                       for point in points])  # fmt: skip
    found = [point for point in points if point.verdict.anomalous]
    joints = Counter(point.verdict.joint for point in found)
    shares = {name: count / len(found) for name, count in joints.most_common(3)}
    events: tuple[Event, ...] = ()
    if (alarm := report.alarm) is not None:
        kind, last = alarm.verdict.kind or "anomaly", found[-1].index
        events = (Event(float(stamps[alarm.index]), float(stamps[last]), float(scores.max()), shares, kind),)
    shown = run.samples.replace(values, stamps)
    share, notes = run.seen, [*(change.text for change in report.changes), *run.notes]
    if not report.whole:
        share = min(share, report.points / model.nominal)
        notes.insert(0, f"cut off before its end: {report.points} points, the usual is {model.nominal}")
    if report.still:
        share = 0.0
        notes[:0] = [f"{joint} hardly moves: not judged" for joint in report.still]
    return JudgedRun(
        number, run.file, _seconds(stamps), _explained(events, shown, numbers, model.band, period), stamps, scores,
        ("score",), notes=tuple(notes), share=share, samples=shown, band=model.band, times=numbers,
        begin=float(given[0]) if timed else 0.0,
    )  # fmt: skip
