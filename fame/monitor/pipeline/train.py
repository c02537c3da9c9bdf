"""`fame monitor train`: a detector from recorded runs, with thresholds that promise a rate of false alarms.

Runs are never divided. Each channel is shifted and scaled by what the training runs hold. Of more windows than
`samples` a random choice is used. For the thresholds, runs are put into folds; each fold is scored by a detector that
learned from the others, as the pipeline scores it, smoothing included. `fame.monitor.calibration` turns these scores,
one per run and channel, into thresholds. The detector that is stored learned from all runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fame.dataclasses import asdict, replace
from fame.errors import ConfigError
from fame.monitor.arrays import Floats, moves
from fame.monitor.calibration import FEWEST, calibrate, false_alarm_rate, independent
from fame.monitor.copies import RUN_HASHES, copies, run_hash
from fame.monitor.data_files import LabelledRun, hash_files, is_other_class, rate_of, read_labelled_runs, run_names
from fame.monitor.labels import with_labels
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.cycles import found_of, phases_of, spread_of
from fame.monitor.pipeline.detectors import RULES, Several, detector_names, draw_lot, fit_detector, is_class
from fame.monitor.pipeline.elements import Axis, axis_of, run_times
from fame.monitor.pipeline.estimators import GAP, Autoencoder
from fame.monitor.pipeline.faults import Tried
from fame.monitor.pipeline.filters import LowPass, Windower
from fame.monitor.pipeline.other_estimators import estimator_of
from fame.monitor.pipeline.phases import Phases, reduced
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.sequence import order_of
from fame.monitor.pipeline.trained_model import LEAST_MOVEMENT, TrainedModel
from fame.monitor.pipeline.training_checks import (
    UNLIKE,
    drifts,
    jumps,
    lone_peaks,
    missing,
    unlike_durations,
    unlike_movements,
)
from fame.monitor.pipeline.training_settings import Training as Training, check_settings
from fame.monitor.storage import versions

ReportProgress = Callable[[str], object]
Complete = Callable[[Sequence[LabelledRun], Sequence[str]], Sequence[LabelledRun]]
FINE = 0.05
"""Longest time between two phases, s; where rows are farther apart, as they are."""
LARGEST = 1e100
"""Largest value that is trained on: its square is still finite."""
REPEATING = 0.5
"""Share of the variance of a channel that the time since the start explains in runs that repeat."""


def train(
    config: Training,
    report: ReportProgress = lambda text: None,
    *,
    keep: bool = False,
    complete: Complete = lambda runs, columns: runs,
    detectors: Sequence[str] = (),
) -> TrainedModel:
    """Learn from the files. The model is not stored. `keep`: copies of runs are dropped instead of refused. `complete`
    adds to runs what was left out when bags were read. Of several `detectors` the best one is taken. What is said of
    runs beside the model (`fame.monitor.labels`) counts.

    Raises ConfigError, UnavailableError.
    """
    read = read_labelled_runs(config.files, config.columns, config.special, undisturbed=True)
    columns = read[0].samples.names if read else config.columns
    read, benign, anomalous, lost = with_labels(read, config.model, columns, config.special)
    used = [number for number in _chosen(read, config, benign) if number not in anomalous]
    numbers = [number for number in used if len(read[number].samples)]
    runs = [read[number].samples for number in numbers]
    if anomalous:
        _check_count(runs, len(anomalous))
    cut, runs = len(runs) == 1, parts(runs[0], config.window) if len(runs) == 1 else runs
    lost_rows = missing(complete(read, columns), used)
    try:
        model = fit(
            runs, config, hash_files(config.files), report, keep=keep or config.keep, faults=True, detectors=detectors
        )
    except ConfigError as error:
        if error.element != "Training.window" or not lost_rows:
            raise
        raise ConfigError(f"{error.text}; {lost_rows[0]}", element=error.element) from None
    told = f"one recording, cut into {len(runs)} parts of {float(np.ptp(runs[0].stamps)):.3g} s: a run is such a part"
    places = list(range(len(runs))) if cut else numbers
    more = {
        "cut": [told] if cut else [], "benign": benign, "numbers": [places[at] for at in model.conditions["numbers"]],
        "jumps": [(places[at], *jump) for at, *jump in model.conditions["jumps"]],
        "files": [Path(path).name for path in config.files], "anomalous": anomalous, "lost_labels": lost,
        "missing": lost_rows,
    }  # fmt: skip
    return replace(model, conditions={**model.conditions, **more})


def _chosen(read: Sequence[LabelledRun], config: Training, benign: Collection[int]) -> list[int]:
    """Return the numbers of the runs that are not excluded, and of the benign class or said to be `benign`. Raises
    ConfigError for an unknown run."""
    names = [run_names(number, run) for number, run in enumerate(read)]
    if unknown := [name for name in config.exclude if re.fullmatch(r"run \d+", name) and {name} - set().union(*names)]:
        raise ConfigError(f"there is no {unknown[0]}; there are {len(read)}, from run 0 on", element="Training.exclude")
    others = {at for at, run in enumerate(read) if is_other_class(run, config.special)} - {*benign}
    return [at for at in range(len(read)) if at not in others and not names[at] & set(config.exclude)]


def fit(
    runs: Sequence[Samples],
    config: Training,
    data: str = "",
    report: ReportProgress = lambda text: None,
    *,
    keep: bool = False,
    faults: bool = False,
    detectors: Sequence[str] = (),
) -> TrainedModel:
    """Learn from runs in memory, each with values (n, channels). `data` names their origin, `report` gets progress.
    `faults`: measure which ones would have been found. Of several `detectors` the best one is taken, by a comparison.

    Raises ConfigError, also for copies of runs, which `keep` drops instead.
    """
    _check(config, runs)
    places = distinct(runs, keep=keep)
    copied, runs = len(runs) - len(places), [runs[place] for place in places]
    _check_count(runs)
    if detectors or not (config.detector or config.estimator is not None):
        from fame.monitor.pipeline.compare import best

        model = best(runs, config, detectors, report)
        return replace(model, data=data, conditions={**model.conditions, "copies": copied})
    rate = rate_of(runs)
    filtered = prepared(runs, config)
    config = weighed(filtered, config, rate)
    model = learned(filtered, config, rate)
    tried = Tried(runs) if faults else None
    scores, lone = _left_out_scores(filtered, config, rate, tried, report)
    whole = _whole(scores, config)
    lasted = [float(run.stamps[-1] - run.stamps[0]) for run in runs if len(run)]
    asked = _asked(runs, config)
    parts = [part[whole] for part in config.parts]
    calibration = calibrate(scores[whole], asked, config.margin, _among(parts or [scores[whole]], config), parts)
    figures = _figures(model, filtered, scores[whole], config)
    conditions = {
        "runs": len(runs), "scored": len(whole), "numbers": [places[index] for index in whole],
        "seconds": [min(lasted), max(lasted)],
        "samples": sum(map(len, runs)), "settings": _plain(asdict(config)),
        "constant": [name for name, moves in zip(model.columns, _moves(runs), strict=True) if not moves],
        "movement": unlike_movements([runs[index] for index in whole]), "lone": lone[whole].tolist(),
        "lasted": unlike_durations([runs[index] for index in whole]),
        "jumps": [(places[index], step, at) for index, step, at in jumps(runs)],
        "drifts": drifts([runs[index] for index in whole]), "late_scores": _late_scores(filtered, whole, config, rate),
        LEAST_MOVEMENT: _least_movement(filtered, config, model), "copies": copied,
        RUN_HASHES: [run_hash(run.channels()) for run in runs if len(run)],
        **{name: value for name, value in model.conditions.items() if name == "spread"},
        **_begins_of(model, filtered, config),
        **order_of([runs[index] for index in whole], asked),
        **(tried.found(calibration.thresholds) if tried is not None else {}),
    }  # fmt: skip
    return replace(
        model, thresholds=calibration.thresholds, metrics=figures, data=data, versions=versions(),
        calibration=calibration, conditions=conditions, band=band_of(runs, model.elements),
    )  # fmt: skip


def _left_out_scores(
    runs: Sequence[Samples], config: Training, rate: float, tried: Tried | None, report: ReportProgress
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the largest losses of filtered runs by detectors that learned from the other folds (runs, channels), and
    whether they are lone peaks. Faults are `tried` by these detectors."""
    found = {}
    for index, fold in left_out(runs, config, rate, report):
        loss = losses(fold, runs[index], config.stride).values
        found[index] = loss.max(axis=0, initial=-np.inf), lone_peaks(loss, config.window / config.stride)
        if tried is not None:
            tried.put(index, partial(_loss_of_raw, fold, config))
    scores, lone = zip(*(found[index] for index in range(len(runs))), strict=True)
    return np.array(scores), np.array(lone)


CUT, GAPS = 20, 4
"""Parts of a recording that is one run, at most; each is as long as two windows, at least. So many gaps, after which
runs begin, divide it instead."""


def parts(run: Samples, window: int) -> list[Samples]:
    """Cut one continuous recording at its gaps, or into parts of equal length; the run itself if it is too short."""
    count = min(CUT, len(run) // (2 * window))
    bounds = np.linspace(0, len(run), max(count, 1) + 1).astype(int)
    gaps = np.flatnonzero(np.diff(run.stamps) > GAP) + 1
    bounds = bounds if len(gaps) < GAPS else np.array([0, *gaps, len(run)])
    return [Samples(run.values[a:b], run.stamps[a:b], run.names, run.elements) for a, b in pairwise(bounds)]


def distinct(runs: Sequence[Samples], *, keep: bool = False) -> list[int]:
    """Return the numbers of the runs that are no copy of another one. Raises ConfigError if there are copies, unless
    these are dropped (`keep`)."""
    found = copies(run_hash(run.channels()) if len(run) else f"empty {number}" for number, run in enumerate(runs))
    if found and not keep:
        number, first = next(iter(found.items()))
        more = f", and {len(found) - 1} more runs are copies" if len(found) > 1 else ""
        text = f"run {number} has the same values as run {first}{more}: copies promise nothing about the next run; "
        raise ConfigError(f"{text}leave them out, or train with --keep, which drops them", element="Training.Files")
    return [number for number in range(len(runs)) if number not in found]


def band_of(runs: Sequence[Samples], axis: Axis) -> Band:
    """Return the band of runs, over the axis of phases if they repeat."""
    times = [run_times(run, run.stamps, axis) if len(run) else run.stamps for run in runs]
    return Band.of(runs, times if axis or repeats(runs) else None)


def repeats(runs: Sequence[Samples]) -> bool:
    """Return whether runs are of like lengths, and their channels, in the median, follow the time since the start."""
    shortest, longest = min(map(len, runs)), max(map(len, runs))
    if longest > UNLIKE * shortest or not shortest:
        return False
    every = np.stack([run.channels()[:shortest] for run in runs])
    moving = every.var(axis=(0, 1)) > 0
    residual = (every - np.median(every, axis=0)).var(axis=(0, 1))
    explained = 1 - residual[moving] / every.var(axis=(0, 1))[moving]
    return bool(moving.any() and np.median(explained) > REPEATING)


def prepared(runs: Sequence[Samples], config: Training) -> list[Samples]:
    """Return the runs after the low-pass on the data."""
    if not config.before:
        return list(runs)
    return [
        replace(processors.run([LowPass(cutoff=config.before)], {"x": run})["x"], elements=run.elements)
        if len(run) else run for run in runs
    ]  # fmt: skip


def learned(runs: Sequence[Samples], config: Training, rate: float) -> TrainedModel:
    """Learn a detector from filtered runs, without thresholds (they are 1)."""
    every = np.concatenate([run.channels() for run in runs])
    config = weighed(runs, config, rate)
    mean, scale = every.mean(axis=0), every.std(axis=0)
    scale = np.where(moves(scale, mean), scale, 1.0)
    config = replace(config, stride=_stride(config, rate))
    axis = axis_of(runs, config.stride / rate) if Phases.kind in config.detector else {}
    windows, times = _windows(runs, config, rate, axis)
    windows = (windows - mean) / scale
    detector = fit_detector(config.detector, windows, config, times)
    columns = runs[0].names or tuple(str(index) for index in range(windows.shape[2]))
    nothing = tuple(1.0 for _ in columns)
    phases, within = phases_of(detector), config.start_within
    spread = {"spread": spread_of(phases, windows, times, within)} if phases is not None and not axis else {}
    return TrainedModel(
        columns, config.window, rate, mean, scale, detector, nothing, config.cutoff, config.before, elements=axis,
        conditions={"settings": {"start_within": within}, **spread},
    )  # fmt: skip


def _stride(config: Training, rate: float) -> int:
    """Return the stride of the windows that train: runs begin late by less than one of `phase`."""
    fine = max(1, int(FINE * rate)) if Phases.kind in config.detector else config.stride
    return min(config.stride, fine)


def weighed(runs: Sequence[Samples], config: Training, rate: float) -> Training:
    """Return settings in which each of several detectors counts in units of the thresholds that it has alone, by the
    left-out scores of filtered runs; others as they are. Raises ConfigError.

    With `phase`, others learn windows that lie closer. Their scores are the larger ones of those with these and with
    the windows that each learns by itself: the former alone raised 7 % false alarms instead of 5 % on
    `benchmarks.cells`, whose tails are long, and the latter alone up to 40 instead of 10 %, where windows of later runs
    fall between those that were learned.
    """
    if config.usual or is_class(config.detector) or config.estimator is not None:
        return config
    rule, names = detector_names(config.detector)
    alike = replace(config, usual=((1.0,) * runs[0].channels().shape[1],) * len(names))
    found = [(at, _parts_alone(model, runs[at], config)) for at, model in left_out(runs, alike, rate)] if rule else []
    parts = [np.array(each) for each in zip(*(scores for _, scores in sorted(found, key=itemgetter(0))), strict=True)]
    for place, name in enumerate(names if _stride(config, rate) < config.stride else ()):
        if name != Phases.kind and rule:
            single = replace(config, detector=name)
            by_run = {at: losses(model, runs[at], config.stride).values for at, model in left_out(runs, single, rate)}
            alone = [by_run[at].max(axis=0, initial=-np.inf) for at in range(len(runs))]
            parts[place] = np.maximum(parts[place], alone)
    scores = [part[_whole(part, config)] for part in parts]
    among = _among(scores, config) if rule == RULES[0] else 0.0
    usual = tuple(calibrate(part, _asked(runs, config), 1.0, among).thresholds for part in scores)
    return replace(config, usual=usual, parts=tuple(parts) if among else ())


def _parts_alone(model: TrainedModel, run: Samples, config: Training) -> list[Floats]:
    """Return the largest losses (channels,) of a filtered run by each of several detectors that learned together: by
    itself, each would have learned other windows."""
    assert isinstance(model.detector, Several)
    alone = (replace(model, detector=part) for part in model.detector.parts)
    return [losses(each, run, config.stride).values.max(axis=0, initial=-np.inf) for each in alone]


def _among(parts: Sequence[Floats], config: Training) -> float:
    """Return the number of independent scores of detectors (runs, channels each) and those that could be chosen."""
    return independent(np.hstack(parts)) * max(1.0, config.share / len(parts))


def _asked(runs: Sequence[Samples], config: Training) -> float:
    """Return the rate of false alarms per run that is asked for."""
    lasted = [float(run.stamps[-1] - run.stamps[0]) for run in runs if len(run)]
    return false_alarm_rate(config.false_alarms, float(np.mean(lasted)))


def _whole(scores: Floats, config: Training) -> list[int]:
    """Return the runs that have a score (runs, channels), as they have a whole window. Raises ConfigError if fewer than
    two."""
    whole = np.flatnonzero(np.isfinite(scores).all(axis=1)).tolist()
    if len(whole) < 2:
        found = f"{len(whole)} of {len(scores)} runs have a whole window of {config.window} samples"
        raise ConfigError(f"{found}; at least 2 are needed", element="Training.window")
    return whole


def left_out(
    runs: Sequence[Samples], config: Training, rate: float, report: ReportProgress = lambda text: None
) -> Iterator[tuple[int, TrainedModel]]:
    """Yield each of the filtered runs, by its index, with a detector that learned from the other folds."""
    folds = round(1 / config.held_back) if config.held_back else config.folds
    order = np.random.default_rng(config.seed).permutation(len(runs))
    for number, held in enumerate(np.array_split(order, min(max(folds, 2), len(runs))), start=1):
        report(f"fold {number}: {len(runs) - len(held)} runs train, {len(held)} are scored")
        model = learned([run for index, run in enumerate(runs) if index not in held], config, rate)
        yield from ((int(index), model) for index in sorted(held))


def _late_scores(runs: Sequence[Samples], whole: list[int], config: Training, rate: float) -> list[list[float]]:
    """Return the largest losses of the last third of the runs by a detector of those before, which learned nothing of
    what came later; none of few runs."""
    late = whole[len(whole) - len(whole) // 3 :]
    if len(whole) - len(late) < FEWEST:
        return []
    model = learned(runs[: late[0]], config, rate)
    return [losses(model, runs[index], config.stride).values.max(axis=0).tolist() for index in late]


def _figures(
    model: TrainedModel, runs: Sequence[Samples], scores: Floats, config: Training
) -> dict[str, tuple[float, ...]]:
    """Return largest and mean losses of the training runs, and the largest ones of the folds, per channel."""
    every = np.concatenate([losses(model, run, config.stride).values for run in runs])
    rows = {
        "training_max": every.max(axis=0), "training_mean": every.mean(axis=0),
        "validation_max": scores.max(axis=0), "validation_mean": scores.mean(axis=0),
    }  # fmt: skip
    return {name: tuple(row.tolist()) for name, row in rows.items()}


def _least_movement(runs: Sequence[Samples], config: Training, model: TrainedModel) -> list[float]:
    """Return the least standard deviation of each channel over a window; 0 of one that stands still in one of them."""
    cut = (Windower().feed(run.replace(run.channels()), model.window, config.stride, model.rate) for run in runs)
    least = np.min([part.values.std(axis=1).min(axis=0) for part in cut if len(part)], axis=0)
    return [float(each) for each in np.where(moves(least, model.mean), least, 0.0)]


def _begins_of(model: TrainedModel, runs: Sequence[Samples], config: Training) -> dict[str, Any]:
    """Return as conditions of a model how the begin of a run is found, if only the time since it tells its phase."""
    if model.elements or config.run is not None:
        trigger = f"a trigger: {config.run.text}" if config.run is not None else ""
        return {"begins_text": "the elements of the mission" if model.elements else trigger}
    cut = (Windower().feed(run.replace(run.channels()), model.window, config.stride, model.rate) for run in runs)
    scaled = [(part.values - model.mean) / model.scale for part in cut if len(part)]
    return found_of(phases_of(model.detector), scaled, config.stride / model.rate)


def _moves(runs: Sequence[Samples]) -> Any:
    every = np.concatenate([run.channels() for run in runs])
    return moves(every.std(axis=0), every.mean(axis=0))


_SET = ("usual", "parts", "share")
"""Settings that training sets itself."""


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in settings.items() if name not in ("files", "model", "estimator", *_SET)}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in kept.items()}


def losses(model: TrainedModel, run: Samples, stride: int = 1) -> Samples:
    """Return the smoothed loss of a run whose data have gone through the low-pass before: values (k, channels)."""
    chain: list[Any] = [Autoencoder(model, stride=stride)]
    chain[0].elements, chain[0].cycles = run.elements, False
    if model.cutoff:
        chain.append(LowPass(cutoff=model.cutoff))
    given = {"x": run.replace(run.channels(), names=model.columns)}
    return processors.run(chain, given).get("loss", Samples(np.zeros((0, len(model.columns))), np.zeros(0)))


def _loss_of_raw(model: TrainedModel, config: Training, run: Samples) -> Samples:
    return losses(model, prepared([run], config)[0], config.stride)


def _check(config: Training, runs: Sequence[Samples]) -> None:
    check_settings(config)
    if is_class(config.detector):
        estimator_of(config.detector, config.parameters)
    elif config.parameters:
        raise ConfigError("are those of a Detector that is a class of scikit-learn", element="Training.parameters")
    if not config.hidden:
        raise ConfigError("expected at least one layer, got none", element="Training.hidden")
    _check_count(runs)
    largest = max((float(np.abs(run.values).max()) for run in runs if len(run)), default=0.0)
    if largest > LARGEST:
        text = f"got the value {largest:g}: at most {LARGEST:g} can be learned from"
        raise ConfigError(text, element="Training.files")
    if not _moves(runs).any():
        raise ConfigError("no channel ever moves: nothing to learn", element="Training.files")


def _check_count(runs: Sequence[Samples], anomalous: int = 0) -> None:
    if len(runs) < 2:
        beside = f" beside {anomalous} that are labelled anomalous (fame monitor label)" if anomalous else ""
        text = f"has {len(runs)} run{'s' * (not runs)}{beside}; at least 2 are needed"
        raise ConfigError(f"{text}, since runs that did not train set the thresholds", element="Training")


def cut(
    runs: Sequence[Samples], config: Training, rate: float, axis: Axis, kept: Callable[[Floats], Floats] = np.asarray
) -> tuple[Floats, Floats]:
    """Return the windows of filtered runs, what is `kept` of them (n, window, channels), and the times of their ends
    (n,), s on the axis of phases. Raises ConfigError without a window."""
    cut = [Windower().feed(run.replace(run.channels()), config.window, config.stride, rate) for run in runs]
    pairs = [
        (kept(part.values), run_times(run, part.stamps, axis)) for part, run in zip(cut, runs, strict=True) if len(part)
    ]
    if not pairs:
        raise ConfigError(f"no run has {config.window} samples at {rate:.3g} Hz in a row", element="Training.window")
    windows, times = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return windows, times


def _windows(runs: Sequence[Samples], config: Training, rate: float, axis: Axis) -> tuple[Floats, Floats]:
    """Return the windows that train, and the times of their ends; NaN behind the time that half of the runs last.

    Phases need the windows of all runs, and by themselves only the reduced ones; of others `samples` are drawn.
    """
    windows, times = cut(runs, config, rate, axis, reduced if config.detector == Phases.kind else np.asarray)
    lasted = np.median([run.stamps[-1] - run.stamps[0] for run in runs if len(run)])
    times = times if axis else np.where(times <= lasted, times, np.nan)
    if Phases.kind in config.detector:
        return windows, times
    lot = draw_lot(len(windows), config.samples, config.seed)
    return windows[lot], times[lot]
