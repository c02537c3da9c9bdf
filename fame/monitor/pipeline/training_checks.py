"""What is suspicious about a training: runs that are unlike the others, levels that drift, thresholds that lie far off.

`fit` stores what only the runs tell in the conditions of the model; all sentences are made from the model alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fame.monitor.arrays import Floats, moves
from fame.monitor.calibration import FAR, FEWEST, Calibration, calibrate, calibrate_runs
from fame.monitor.data_files import LabelledRun
from fame.monitor.pipeline.detectors import keeps_windows
from fame.monitor.pipeline.phases import Phases
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.trained_model import TrainedModel

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model

OUTLIER = 30.0
"""A run whose left-out loss is this many times those of the others, or of the training, is not one of them."""
LONE = 100.0
"""The same for a loss as a lone sample has it, which heavy-tailed noise brings: it ends with the sample's windows."""
CLOSE = 10.0
"""The same for `phase`, whose losses differ less, where it is also beyond `SPREAD`."""
SPREAD = 8.0
"""Robust deviations (of logarithms) beyond which a run is unlike the others: some healthy tasks vary much."""
MOVING = 2.0
"""A channel that moves, or a run that lasts, this many times more or less than usual may be unlike; the noise of a
channel is less than 1 / this."""
UNLIKE = 1.2
"""Longest run over shortest, above which lengths are told."""
WHOLE = 0.99
"""A run that is known to a smaller share is told."""
JUMP = 10.0
"""A step between two samples this many times the usual one, and more than 1 - `WHOLE` of the run, is a jump."""
CHANCE = 0.01
"""Probability, by chance alone, of what is told about drift."""


def warnings_of(model: TrainedModel) -> list[str]:
    """Return what a user has to know about the thresholds of a model, a line each."""
    if model.calibration is None:
        return [
            "was trained by an earlier version, its rate of false alarms is unknown; fame monitor train makes it anew"
        ]
    notes = [] if model.calibration.promised is not None else [model.calibration.text]
    above = [
        name
        for name, largest, threshold in zip(model.columns, model.metrics["training_max"], model.thresholds, strict=True)
        if largest > threshold
    ]
    if above:
        notes.append(
            f"training runs exceed the thresholds of {', '.join(above)}: these have outliers, look at the runs"
        )
    far = [
        f"{name} ({times:.2g} times)"
        for name, times in zip(model.columns, model.calibration.stretch, strict=True)
        if times > FAR and name not in model.conditions.get("constant", [])
    ]
    if far:
        margin = model.calibration.margin
        cause = "as some runs are unlike" if margin == 1 else f"{margin:g} times by the margin, the rest as runs differ"
        notes.append(f"thresholds lie far above the largest left-out losses, {cause}: {', '.join(far)}")
    constant = model.conditions.get("constant", [])
    if constant:
        notes.append(f"{', '.join(constant)} never moved in training: any movement raises an alarm")
    short = model.conditions.get("runs", 0) - model.conditions.get("scored", 0)
    if short:
        notes.append(f"{short} of {model.conditions['runs']} runs are shorter than a window: they set no threshold")
    if dropped := model.conditions.get("copies", 0):
        notes.append(f"{dropped} runs that are copies of others were left out")
    notes += [f"run {number} is left out: labelled anomalous" for number in model.conditions.get("anomalous", [])]
    notes += [
        f"the label of {name} does not count, since the file no longer has these values: label it again, or --remove"
        for name in model.conditions.get("lost_labels", [])
    ]
    notes += model.conditions.get("cut", []) + model.conditions.get("missing", [])
    notes += drifting(model)
    notes += [text] if (text := memorised(model)) else outliers(model).values()
    shortest, longest = model.conditions.get("seconds", (1.0, 1.0))
    if longest > UNLIKE * shortest:
        notes.append(f"runs last from {shortest:.3g} to {longest:.3g} s: a promise per run is one for runs like these")
    for name, robots in model.conditions.get("failed", {}).items():
        notes.append(f"{name}: the mission of {', '.join(robots)} failed: such a run may not be undisturbed")
    if jumping := model.conditions.get("jumps", []):
        number, step, at = max(jumping, key=lambda each: each[1])
        found = f"stamps jump in {len(jumping)} of {model.conditions['runs']} runs, in run {number} by {step:.3g} s"
        notes.append(f"{found} at {at:.3g} s: a clock that was set, samples that are missing, or several runs in one")
    return notes


def missing(runs: Sequence[LabelledRun], used: Sequence[int]) -> list[str]:
    """Say how much of the runs that are used, by number, is not known, since rows or messages were left out."""
    known = {number: round(runs[number].known, 3) for number in used}
    short = [number for number, share in known.items() if share < WHOLE or runs[number].lacking]
    if not short:
        return []
    worst = min(short, key=lambda number: known[number])
    run = runs[worst]
    empty = f"{run.gaps} of {run.gaps + len(run.samples)} rows have an empty cell"
    why = [*([run.lacking] if run.lacking else []), *run.notes] or [empty]
    share = f"{100 * known[worst]:{'.0f' if known[worst] < WHOLE else '.4g'}} %"
    are = "is" if len(short) == 1 else "are"
    found = f"{len(short)} of {len(used)} runs {are} not known as a whole, run {worst} to {share}"
    return [f"{found}: {'; '.join(why)}"]


def memorised(model: TrainedModel) -> str:
    """Say so if most runs, left out, have losses far above those of the training: the detector knows its own runs."""
    if model.calibration is None:
        return ""
    times = (model.calibration.scores / _in_training(model)).max(axis=1)
    above = times[times > OUTLIER]
    if 2 * len(above) <= len(times):
        return ""
    found = f"in {len(above)} of {len(times)} runs the left-out loss is {np.median(above):.0f} times that in training"
    return f"{found}: the detector has learned its own runs by heart"


def _in_training(model: TrainedModel) -> Floats:
    """Return the largest losses of the training (channels,). They are no evidence, and infinite, of a detector that
    keeps windows: each of these has no distance to itself."""
    largest = _least(np.array(model.metrics["training_max"]))
    return np.full_like(largest, np.inf) if keeps_windows(model.detector) else np.asarray(largest)


def _least(loss: Any) -> Any:
    return np.maximum(loss, 1e-4)  # losses are of scaled channels: less than this is nothing


def outliers(model: TrainedModel) -> dict[int, str]:
    """Name the runs that are unlike the others, by loss, movement or duration: number, and a line."""
    if model.calibration is None:
        return {}
    numbers = model.conditions.get("numbers", range(len(model.calibration.scores)))
    found = _far_losses(model) + [
        (index, f"{model.columns[channel]} moves {times:.2g} times as much as usual")
        for index, channel, times in model.conditions.get("movement", [])
    ]
    lasted = model.conditions.get("lasted", [])
    found += [(index, f"lasts {times:.2g} times as long as usual") for index, times in lasted]
    by_run = groupby(sorted(found, key=lambda pair: pair[0]), key=lambda pair: pair[0])
    return {
        numbers[index]: f"run {numbers[index]}: {', and '.join(text for _, text in texts)}" for index, texts in by_run
    }


def _far_losses(model: TrainedModel) -> list[tuple[int, str]]:
    """Name the runs, by their place among the scored ones, whose left-out loss is far above those of the others, or of
    the training."""
    assert model.calibration is not None
    scores, found = _least(model.calibration.scores), list[tuple[int, str]]()
    lone = model.conditions.get("lone", np.zeros(scores.shape, dtype=bool))
    for index, row in enumerate(scores):
        others = np.delete(scores, index, axis=0)
        usual = np.minimum(np.median(others, axis=0), _in_training(model))
        limit = np.where(lone[index], LONE, OUTLIER)
        if isinstance(model.detector, Phases):
            limit = np.clip(np.exp(SPREAD * _deviation(np.log(others))), CLOSE, OUTLIER)
        worst = int((row / usual / limit).argmax())
        if row[worst] > limit[worst] * usual[worst]:
            times = row[worst] / usual[worst]
            found.append((index, f"its left-out loss of {model.columns[worst]} is {times:.0f} times the usual"))
    return found


def lone_peaks(loss: Floats, windows: float) -> Any:
    """Return for each channel whether the peak of the loss (n, channels) lasts no longer than a sample is in `windows`,
    and less than half of the run."""
    high = (loss > loss.max(axis=0, initial=0.0) / 10).sum(axis=0)
    return (high <= windows + 1) & (2 * high <= len(loss))


def _deviation(values: Floats) -> Floats:
    """Return the robust deviation over the runs (channels,)."""
    return np.asarray(1.4826 * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def unlike_movements(runs: Sequence[Samples]) -> list[tuple[int, int, float]]:
    """Find runs in which a channel moves much more or less than usual, such as one in which the robot stood still.

    Returns number, channel, and how many times as much it moves.

    Not judged are channels that hardly move more than their noise, and those in which more than a quarter of the runs
    are unlike: such a task varies.
    """
    every = [run.channels() for run in runs]
    moved = np.array([values.std(axis=0) for values in every])
    noise = np.median([np.diff(values, axis=0).std(axis=0) for values in every], axis=0) / math.sqrt(2)
    usual = np.median(moved, axis=0)
    judged = (usual > MOVING * noise) & moves(usual, every[0].mean(axis=0))
    times = moved / np.where(judged, usual, 1.0)
    logs = np.where(judged, np.log(np.maximum(times, 1e-9)), 0.0)
    far = _far(logs)
    worst = np.where(far, np.abs(logs), 0.0).argmax(axis=1)
    return [(int(row), int(worst[row]), float(times[row, worst[row]])) for row in np.flatnonzero(far.any(axis=1))]


def unlike_durations(runs: Sequence[Samples]) -> list[tuple[int, float]]:
    """Find runs that last much longer or shorter than usual: number, and how many times as long.

    Not judged, as above, where a quarter of the runs are; and runs with elements of a mission, which may wait.
    """
    if all(run.elements for run in runs):
        return []
    lasted = np.array([[run.stamps[-1] - run.stamps[0]] for run in runs])
    times = lasted / np.median(lasted)
    return [(int(row), float(times[row, 0])) for row in np.flatnonzero(_far(np.log(np.maximum(times, 1e-9)))[:, 0])]


def _far(logs: Floats) -> NDArray[np.bool_]:
    """Return which logarithms of sizes, relative to the usual one (runs, channels), are unlike the others."""
    far = np.abs(logs) > np.maximum(math.log(MOVING), SPREAD * _deviation(logs))
    return np.asarray(far & (far.sum(axis=0) <= max(1, len(logs) // 4)))


def jumps(runs: Sequence[Samples]) -> list[tuple[int, float, float]]:
    """Find the largest step of the stamps of runs that jump, which no window spans: number, step and its begin, s since
    the start of the run."""
    found = []
    for number, run in enumerate(runs):
        steps = np.diff(run.stamps)
        if len(steps) and (step := float(steps.max())) > max(
            JUMP * float(np.median(steps)), (1 - WHOLE) * float(steps.sum())
        ):
            found.append((number, step, float(run.stamps[steps.argmax()] - run.stamps[0])))
    return found


def drifting(model: TrainedModel | Model) -> list[str]:
    """Say what changes from run to run: losses, levels, and alarms of the last runs by a model of those before; without
    a calibration levels alone."""
    notes, calibration = [], model.calibration
    if calibration and _trend(np.log(np.maximum(calibration.scores, 1e-12)).mean(axis=1)) < CHANCE / 5:
        notes.append("losses grow or fall from run to run: the promise needs runs that could come in any order")
    names = model.columns if isinstance(model, TrainedModel) else model.joints
    levels = [
        f"{names[channel]} (from {first:.4g} to {last:.4g})"
        for channel, first, last in model.conditions.get("drifts", [])
    ]
    if levels:
        told = "levels drift from run to run: later runs may raise more alarms"
        notes.append(f"{told}{' than promised' if calibration else ''}: {', '.join(levels)}")
    late, expected, exceed = _split(calibration, model.conditions) if calibration else (0, 0.0, 0)
    if exceed:
        notes.append(f"{exceed} of the last {late} runs exceed thresholds by the runs before; expected: {expected:.2g}")
    return notes


def drifts(runs: Sequence[Samples]) -> list[tuple[int, float, float]]:
    """Find the channels whose mean grows or falls from run to run: channel, and the level of the first and of the last
    third of the runs."""
    levels = np.array([run.channels().mean(axis=0) for run in runs])
    third = max(1, len(runs) // 3)
    found = [channel for channel, level in enumerate(levels.T) if _trend(level) * levels.shape[1] < CHANCE]
    first, last = levels[:third].mean(axis=0), levels[-third:].mean(axis=0)
    return [(channel, float(first[channel]), float(last[channel])) for channel in found]


def _trend(values: Floats) -> float:
    """Return how probable it is by chance that values rank so much with their order; 1 for fewer than six."""
    from scipy.stats import spearmanr

    count = len(values)
    if count < 6 or np.ptp(values) <= 1e-9 * (1 + np.abs(values).max()):
        return 1.0
    return max(float(spearmanr(np.arange(count), values).pvalue), 2 / math.factorial(min(count, 20)))


def _split(calibration: Calibration, conditions: Mapping[str, Any]) -> tuple[int, float, int]:
    """Judge the last runs, a third or those of the last fold, by detector and thresholds of the runs before: their
    number, how many are expected to exceed these, and how many do; 0 if that may be chance."""
    from scipy.stats import binom

    scores = calibration.scores
    late = conditions.get("late", len(scores) // 3)
    if not 0 < late <= len(scores) - FEWEST:
        return late, 0.0, 0
    last = np.array(conditions.get("late_scores", scores[-late:]))
    asked = max(calibration.asked, 1 / (len(scores) - late + 1))
    if calibration.levels:
        before = calibrate(scores[:-late], asked)
    else:
        before = calibrate_runs(scores[:-late, 0], asked, least=calibration.least)
    rate, above = before.promised or 0.0, int((last > before.thresholds).any(axis=1).sum())
    return late, late * rate, above if binom.sf(above - 1, late, rate) < CHANCE else 0
