"""`fame monitor train`: a detector from recorded runs, with thresholds that promise a rate of false alarms.

Runs are never divided. Each channel is shifted and scaled by what the training runs hold. Of more windows than
`samples` a random choice is used. For the thresholds, runs are put into folds; each fold is scored by a detector that
learned from the others, as the pipeline scores it, smoothing included. `fame.monitor.calibration` turns these scores,
one per run and channel, into thresholds. The detector that is stored learned from all runs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from glob import glob
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fame.config.values import ConfigValue
from fame.dataclasses import asdict, dataclass, field, replace
from fame.errors import ConfigError
from fame.monitor.arrays import Floats
from fame.monitor.calibration import FEWEST, calibrate, false_alarm_rate, independent, read_false_alarms
from fame.monitor.copies import RUN_HASHES, copies, run_hash
from fame.monitor.data_files import (
    ELEMENT,
    TIME_UNITS,
    LabelledRun,
    Special,
    hash_files,
    rate_of,
    read_labelled_runs,
    run_names,
)
from fame.monitor.labels import with_labels
from fame.monitor.pipeline import processors
from fame.monitor.pipeline.band import Band
from fame.monitor.pipeline.cycles import WITHIN, found_of, phases_of
from fame.monitor.pipeline.detectors import (
    ACTIVATIONS,
    RULES,
    ChannelAutoencoders,
    detector_names,
    draw_lot,
    fit_detector,
    is_class,
)
from fame.monitor.pipeline.elements import Axis, axis_of, run_times
from fame.monitor.pipeline.estimators import Autoencoder
from fame.monitor.pipeline.faults import Tried
from fame.monitor.pipeline.filters import LowPass, Windower
from fame.monitor.pipeline.join import Join
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
from fame.monitor.storage import versions
from fame.monitor.tables import RUN, STAMP
from fame.text import suggestion


@dataclass(frozen=True)
class Training:
    """Settings of a training: the keys of the section `Training` of a configuration.

    files         CSV files of undisturbed runs
    model         where the model is stored
    columns       of the files; default all but stamp, run and label
    run_column    of the files, which divides them into runs; `time_column` has stamps in s, or dates, `element_column`
                  the element of the mission that is active
    exclude       columns that are not read, such as texts; and runs, as training names them (``run 7``), or by file
    rate          Hz, of rows that have no times, or other ones
    start         s since the first row of each file, from which on it is read; `end`: until where
    anomaly_column  column that is 0 in undisturbed rows; these train, it is no channel
    benign        of a file of blocks, each behind a line with its class: the class that is undisturbed
    keep          train also if runs are unlike the others, and leave out copies of runs
    join          of topics with rates of their own: the section `Join` of the configuration
    time_unit     s, ms, us or ns, of numbers in `time_column`; default s, where that is not doubtful
    detector      one of `fame.monitor.pipeline.detectors`: ``pca``, ``any of autoencoder, knn`` ...; default the best
                  of some (`fame.monitor.pipeline.compare.best`). Or the class of an estimator of scikit-learn, with its
                  `parameters`: ``sklearn.ensemble.IsolationForest``
    estimator     of scikit-learn or PyOD, in memory, which is the detector
    window        samples per window
    stride        samples from one window to the next, of those that train and of those that are scored
    before        Hz, low-pass on the data; 0: none
    cutoff        Hz, low-pass on the loss; 0: none
    start_within  s, how late or early a whole run may be under `phase`
    false_alarms  rate that is asked for: ``0.01 per run`` or ``0.5 per hour``
    margin        factor on the thresholds; default 1 with a promise, 1.5 without
    folds         of the runs, for the scores that set the thresholds
    held_back     instead of folds: the part of the runs in each fold
    samples       windows that train, at most
    hidden        neurons of the layers of autoencoders between input and output
    activation    of these: relu, tanh, logistic, identity
    epochs        passes over these windows, at most
    components    part of the variance that principal components explain
    neighbours    windows that `knn` keeps, at most
    usual         set by training: of several detectors, the losses that count as 1 for each, per channel (`weighed`)
    parts         set by training: the left-out scores of each of them (runs, channels), if any raises the alarm
    share         set by a comparison: how many detectors it could choose
    """

    files: tuple[str, ...] = ()
    model: str = "model.skops"
    columns: tuple[str, ...] = ()
    run_column: str = RUN
    time_column: str = STAMP
    element_column: str = ELEMENT
    time_unit: str | None = None
    exclude: tuple[str, ...] = ()
    rate: float = 0.0
    start: float = 0.0
    end: float | None = None
    anomaly_column: str | None = None
    benign: str | None = None
    keep: bool = False
    join: Join | None = None
    detector: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    estimator: Any = None
    window: int = 50
    stride: int = 5
    before: float = 0.0
    cutoff: float = 0.0
    start_within: float = WITHIN
    false_alarms: str = "0.01 per run"
    margin: float | None = None
    folds: int = 5
    held_back: float | None = None
    samples: int = 20_000
    hidden: tuple[int, ...] = (16, 4, 16)
    activation: str = "tanh"
    epochs: int = 60
    components: float = 0.99
    neighbours: int = 4000
    seed: int = 0
    usual: tuple[tuple[float, ...], ...] = ()
    parts: tuple[Floats, ...] = ()
    share: int = 1

    @property
    def special(self) -> Special:
        """The columns that are no channels."""
        names = self.time_column, self.run_column, self.element_column
        end = math.inf if self.end is None else self.end
        unit, anomaly, benign = self.time_unit or "", self.anomaly_column or "", self.benign or ""
        return Special(*names, unit, self.join, self.exclude, self.rate, self.start, end, anomaly, benign)


ReportProgress = Callable[[str], object]
Complete = Callable[[Sequence[LabelledRun], Sequence[str]], Sequence[LabelledRun]]
FINE = 0.05
"""Longest time between two phases, s; where rows are farther apart, as they are."""
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
    used = [number for number in _chosen(read, config) if number not in anomalous]
    numbers = [number for number in used if len(read[number].samples)]
    runs = [read[number].samples for number in numbers]
    cut, runs = len(runs) == 1, parts(runs[0], config.window) if len(runs) == 1 else runs
    model = fit(
        runs, config, hash_files(config.files), report, keep=keep or config.keep, faults=True, detectors=detectors
    )
    told = f"one recording, cut into {len(runs)} parts of {float(np.ptp(runs[0].stamps)):.3g} s: a run is such a part"
    places = list(range(len(runs))) if cut else numbers
    more = {
        "cut": [told] if cut else [], "benign": benign, "numbers": [places[at] for at in model.conditions["numbers"]],
        "jumps": [(places[at], *jump) for at, *jump in model.conditions["jumps"]],
        "files": [Path(path).name for path in config.files], "anomalous": anomalous, "lost_labels": lost,
        "missing": missing(complete(read, model.columns), used),
    }  # fmt: skip
    return replace(model, conditions={**model.conditions, **more})


def _chosen(read: Sequence[LabelledRun], config: Training) -> list[int]:
    """Return the numbers of the runs that are not excluded. Raises ConfigError for an unknown run."""
    names = [run_names(number, run) for number, run in enumerate(read)]
    if unknown := [name for name in config.exclude if re.fullmatch(r"run \d+", name) and {name} - set().union(*names)]:
        raise ConfigError(f"there is no {unknown[0]}; there are {len(read)}, from run 0 on", element="Training.exclude")
    return [at for at in range(len(read)) if not names[at] & set(config.exclude)]


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
    scores = np.full((len(runs), len(model.columns)), np.nan)
    lone = np.zeros(scores.shape, dtype=bool)
    tried = Tried(runs) if faults else None
    for index, fold in left_out(filtered, config, rate, report):
        loss = losses(fold, filtered[index], config.stride).values
        scores[index] = loss.max(axis=0, initial=-np.inf)
        lone[index] = lone_peaks(loss, config.window / config.stride)
        if tried is not None:
            tried.put(index, partial(_loss_of_raw, fold, config))
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
        **_begins_of(model, filtered, config),
        **order_of([runs[index] for index in whole], asked),
        **(tried.found(calibration.thresholds) if tried is not None else {}),
    }  # fmt: skip
    return replace(
        model, thresholds=calibration.thresholds, metrics=figures, data=data, versions=versions(),
        calibration=calibration, conditions=conditions, band=band_of(runs, model.elements),
    )  # fmt: skip


CUT = 20
"""Parts of a recording that is one run, at most; each is as long as two windows, at least."""


def parts(run: Samples, window: int) -> list[Samples]:
    """Cut one continuous recording into parts of equal length; the run itself if it is too short for two."""
    count = min(CUT, len(run) // (2 * window))
    bounds = np.linspace(0, len(run), max(count, 1) + 1).astype(int)
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
    scale = np.where(scale > 1e-9 * (1 + np.abs(mean)), scale, 1.0)  # a channel that never moves
    if Phases.kind in config.detector:  # runs begin late by less than a stride
        config = replace(config, stride=min(config.stride, max(1, int(FINE * rate))))
    axis = axis_of(runs, config.stride / rate) if Phases.kind in config.detector else {}
    windows, times = _windows(runs, config, rate, axis)
    windows = (windows - mean) / scale
    detector = fit_detector(config.detector, windows, config, times)
    columns = runs[0].names or tuple(str(index) for index in range(windows.shape[2]))
    nothing = tuple(1.0 for _ in columns)
    return TrainedModel(
        columns, config.window, rate, mean, scale, detector, nothing, config.cutoff, config.before, elements=axis,
        conditions={"settings": {"start_within": config.start_within}},
    )  # fmt: skip


def weighed(runs: Sequence[Samples], config: Training, rate: float) -> Training:
    """Return settings in which each of several detectors counts in units of the thresholds that it has alone, by the
    left-out scores of filtered runs; others as they are. Raises ConfigError."""
    if config.usual or is_class(config.detector) or config.estimator is not None:
        return config
    rule, names = detector_names(config.detector)
    parts = []
    for name in names if rule else ():
        single = replace(config, detector=name)
        found = {at: losses(model, runs[at], config.stride).values for at, model in left_out(runs, single, rate)}
        parts.append(np.array([found[at].max(axis=0, initial=-np.inf) for at in range(len(runs))]))
    scores = [part[_whole(part, config)] for part in parts]
    among = _among(scores, config) if rule == RULES[0] else 0.0
    usual = tuple(calibrate(part, _asked(runs, config), 1.0, among).thresholds for part in scores)
    return replace(config, usual=usual, parts=tuple(parts) if among else ())


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
    return [float(each) for each in np.where(least > 1e-9 * (1 + np.abs(model.mean)), least, 0.0)]


def _begins_of(model: TrainedModel, runs: Sequence[Samples], config: Training) -> dict[str, Any]:
    """Return as conditions of a model how the begin of a run is found, if only the time since it tells its phase."""
    if model.elements:
        return {}
    cut = (Windower().feed(run.replace(run.channels()), model.window, config.stride, model.rate) for run in runs)
    scaled = [(part.values - model.mean) / model.scale for part in cut if len(part)]
    return found_of(phases_of(model.detector), scaled, config.stride / model.rate)


def _moves(runs: Sequence[Samples]) -> Any:
    every = np.concatenate([run.channels() for run in runs])
    return np.ptp(every, axis=0) > 0


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


def training_of(section: ConfigValue, folder: Path) -> Training:
    """Read the section `Training`: keys in any case, file names and patterns relative to `folder`.

    Raises ConfigError.
    """
    given: dict[str, Any] = {}
    for name, value in _settings(section).items():
        if name not in _READERS:
            raise value.error(f"unknown key; {suggestion(name, _READERS)}")
        given[name] = _READERS[name](value)
        if name == "files":
            given[name] = tuple(str(path) for item in _items(value) for path in _found(folder, item))
    if _OF_AUTOENCODERS & given.keys():  # keys that say which detector is meant
        given.setdefault("detector", ChannelAutoencoders.kind)
    return Training(**{**given, "model": str(folder / given.get("model", Training.model))})


def data_and_model(section: ConfigValue, folder: Path) -> tuple[tuple[str, ...], str]:
    """Read from the section `Training` the files and the model alone; no files if a pattern matches none.

    Raises ConfigError.
    """
    settings = _settings(section)
    names = _items(settings["files"]) if "files" in settings else []
    found = [_matching(folder, item) for item in names]
    model = settings["model"].text() if "model" in settings else Training.model
    return tuple(str(path) for paths in found if all(found) for path in paths), str(folder / model)


def _settings(section: ConfigValue) -> dict[str, ConfigValue]:
    """Return the values of a section by the names of `Training`."""
    return {
        re.sub(r"(?<=[a-z])(?=[A-Z])", "_", key).lower().replace(" ", "_"): value
        for key, value in section.mapping().items()
    }


def _items(value: ConfigValue) -> list[ConfigValue]:
    """Return the values of a list; a single value is taken as a list of one."""
    return value.items() if isinstance(value.data, list | tuple) else [value]


def _texts(value: ConfigValue) -> tuple[str, ...]:
    return tuple(item.text() for item in _items(value))


def _detector(value: ConfigValue) -> str:
    """Read ``pca``, ``any of pca, knn`` or ``{any of: [pca, knn]}``."""
    if isinstance(value.data, dict):
        ((rule, names),) = value.mapping(RULES).items() or [("", value)]
        text = f"{rule} {', '.join(item.text() for item in names.items())}"
    else:
        text = value.text()
    try:
        detector_names(text)
    except ConfigError as error:
        raise value.error(error.text) from None
    return text


def _parameters(value: ConfigValue) -> dict[str, Any]:
    return {name: item.data for name, item in value.mapping().items()}


_READERS: Mapping[str, Callable[[ConfigValue], Any]] = {
    "files": _texts,
    "model": ConfigValue.text,
    "columns": _texts,
    "run_column": ConfigValue.text,
    "time_column": ConfigValue.text,
    "element_column": ConfigValue.text,
    "time_unit": partial(ConfigValue.choice, known=tuple(TIME_UNITS), what="a unit"),
    "window": partial(ConfigValue.integer, minimum=2),
    "hidden": lambda value: tuple(item.integer(minimum=1) for item in _items(value)),
    "activation": partial(ConfigValue.choice, known=ACTIVATIONS, what="an activation"),
    "stride": partial(ConfigValue.integer, minimum=1),
    "before": partial(ConfigValue.number, minimum=0),
    "cutoff": partial(ConfigValue.number, minimum=0),
    "start_within": partial(ConfigValue.number, minimum=0),
    "held_back": partial(ConfigValue.number, above=0, maximum=math.nextafter(1, 0)),
    "samples": partial(ConfigValue.integer, minimum=10),
    "epochs": partial(ConfigValue.integer, minimum=1),
    "margin": partial(ConfigValue.number, above=0),
    "exclude": _texts,
    "rate": partial(ConfigValue.number, minimum=0, maximum=1e6),
    "start": partial(ConfigValue.number, minimum=0),
    "end": partial(ConfigValue.number, above=0),
    "anomaly_column": ConfigValue.text,
    "benign": ConfigValue.text,
    "keep": ConfigValue.boolean,
    "detector": _detector,
    "parameters": _parameters,
    "false_alarms": read_false_alarms,
    "folds": partial(ConfigValue.integer, minimum=2),
    "components": partial(ConfigValue.number, above=0, maximum=1),
    "neighbours": partial(ConfigValue.integer, minimum=10),
    "seed": partial(ConfigValue.integer, minimum=0, maximum=2**32 - 1),
}


_OF_AUTOENCODERS = {"hidden", "activation", "epochs"}


def _matching(folder: Path, value: ConfigValue) -> list[Path]:
    """Return the file of a name, or those of a pattern, which may be none."""
    pattern = value.text()
    if not any(sign in pattern for sign in "*?["):
        return [folder / pattern]
    return sorted(folder / path for path in glob(pattern, root_dir=folder, recursive=True))


def _found(folder: Path, value: ConfigValue) -> list[Path]:
    """Return them too. Raises ConfigError if a pattern matches none."""
    if not (found := _matching(folder, value)):
        raise value.error(f"no file matches {value.text()!r} in {folder}")
    return found


def _check(config: Training, runs: Sequence[Samples]) -> None:
    for name, read in _READERS.items():
        if getattr(config, name) is not None and (name != "detector" or config.detector):
            read(ConfigValue(getattr(config, name), f"Training.{name}"))
    if is_class(config.detector):
        estimator_of(config.detector, config.parameters)
    elif config.parameters:
        raise ConfigError("are those of a Detector that is a class of scikit-learn", element="Training.parameters")
    if not config.hidden:
        raise ConfigError("expected at least one layer, got none", element="Training.hidden")
    _check_count(runs)
    if not _moves(runs).any():
        raise ConfigError("no channel ever moves: nothing to learn", element="Training.files")


def _check_count(runs: Sequence[Samples]) -> None:
    if len(runs) < 2:
        text = f"has {len(runs)} run; at least 2 are needed, since runs that did not train set the thresholds"
        raise ConfigError(text, element="Training")


def cut(
    runs: Sequence[Samples], config: Training, rate: float, axis: Axis, kept: Callable[[Floats], Floats] = np.asarray
) -> tuple[Floats, Floats]:
    """Return the windows of filtered runs, what is `kept` of them (n, window, channels), and the times of their ends
    (n,), s on the axis of phases. Raises ConfigError if there are none."""
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
