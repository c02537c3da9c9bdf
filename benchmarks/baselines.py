"""Usual detectors, for comparison: each learns from undisturbed runs and scores every window of a run.

`golden run`: squares of the deviation from mean and standard deviation by time since the start, averaged over a window
(the deviation is at least a twentieth of that of the channel: an arm that rests has none);
`T2`: Hotelling's statistic of windows with Ledoit-Wolf's covariance; `kNN`: distance to the 5th nearest window;
`IsolationForest`; `PCA-Q`: squared error of the reconstruction by components with 95 % of the variance.

All get their threshold by the rule that FAME's detectors follow: the one of the scores of left-out folds that promises
the rate asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fame.monitor.arrays import Floats
from fame.monitor.calibration import calibrate_runs
from fame.monitor.pipeline.filters import Windower
from fame.monitor.pipeline.processor import Samples

FOLDS = 5

Score = Callable[[Samples], Floats]
"""Gives the score of each window of a run (windows,)."""
Learn = Callable[[Sequence[Samples], int, int], Score]
"""Learns from runs; window and stride in samples."""


def _scaled(runs: Sequence[Samples], window: int, stride: int) -> tuple[Floats, Score]:
    every = np.concatenate([run.values for run in runs])
    mean, scale = every.mean(axis=0), every.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)

    def scaled(run: Samples) -> Floats:
        cut = Windower().feed(run.replace((run.values - mean) / scale), window, stride).values
        return np.asarray(cut.reshape(len(cut), window * every.shape[1]))

    return np.concatenate([scaled(run) for run in runs]), scaled


def golden(runs: Sequence[Samples], window: int, stride: int) -> Score:
    count = min(map(len, runs))
    every = np.stack([run.values[:count] for run in runs])
    mean, deviation = every.mean(axis=0), every.std(axis=0, ddof=1)
    deviation = np.maximum(deviation, np.maximum(0.05 * deviation.mean(axis=0), 1e-9))

    def score(run: Samples) -> Floats:
        rows = min(count, len(run))
        squares = ((run.values[:rows] - mean[:rows]) / deviation[:rows]) ** 2
        cut = Windower().feed(Samples(squares, run.stamps[:rows]), window, stride).values
        return np.asarray(cut.mean(axis=1).max(axis=1))

    return score


def hotelling(runs: Sequence[Samples], window: int, stride: int) -> Score:
    from sklearn.covariance import LedoitWolf

    every, scaled = _scaled(runs, window, stride)
    found = LedoitWolf().fit(every)
    return lambda run: np.asarray(found.mahalanobis(scaled(run)))


def neighbours(runs: Sequence[Samples], window: int, stride: int) -> Score:
    from scipy.spatial import cKDTree
    from sklearn.decomposition import PCA

    every, scaled = _scaled(runs, window, stride)
    axes = PCA(min(10, *every.shape)).fit(every)
    tree = cKDTree(axes.transform(every))
    return lambda run: np.asarray(tree.query(axes.transform(scaled(run)), k=5)[0][:, -1])


def forest(runs: Sequence[Samples], window: int, stride: int) -> Score:
    from sklearn.ensemble import IsolationForest

    every, scaled = _scaled(runs, window, stride)
    found = IsolationForest(random_state=0).fit(every)
    return lambda run: np.asarray(-found.score_samples(scaled(run)))


def residual(runs: Sequence[Samples], window: int, stride: int) -> Score:
    from sklearn.decomposition import PCA

    every, scaled = _scaled(runs, window, stride)
    axes = PCA(0.95).fit(every)

    def score(run: Samples) -> Floats:
        given = scaled(run)
        return np.asarray(((given - axes.inverse_transform(axes.transform(given))) ** 2).sum(axis=1))

    return score


USUAL: dict[str, Learn] = {
    "golden run": golden, "T2 Ledoit-Wolf": hotelling, "kNN": neighbours, "IsolationForest": forest, "PCA-Q": residual,
}  # fmt: skip


def with_threshold(
    learn: Learn, runs: Sequence[Samples], window: int, stride: int, rate: float, *, whole_runs: bool
) -> tuple[Score, float]:
    """Give the scores by all runs, and the threshold for a rate of false alarms: per run, or per window."""
    order, scores = np.random.default_rng(0).permutation(len(runs)), list[Floats]()
    for held in np.array_split(order, min(FOLDS, len(runs))):
        score = learn([run for number, run in enumerate(runs) if number not in held], window, stride)
        scores += [score(runs[number]) for number in held]
    counted = np.array([each.max() for each in scores]) if whole_runs else np.concatenate(scores)
    return learn(runs, window, stride), calibrate_runs(counted, rate).thresholds[0]
