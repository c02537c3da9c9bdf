"""Thresholds with a stated false-alarm rate: conformal calibration over undisturbed runs, with tails beyond them.

Each run gives one score per channel, its largest loss, by a model that was learned without that run. If runs are
exchangeable, the score of one more run is equally likely to fall between any two of the n scores of its channel; so
the k-th smallest, with k = ceil((n + 1) (1 - rate)), is exceeded in at most that `rate` of future runs (split conformal
prediction: Vovk, Gammerman and Shafer 2005; Angelopoulos and Bates 2023, section 1). n runs cannot promise less than
1 / (n + 1).

The promise is for all channels together, and for all detectors among which one is chosen or of which any may raise the
alarm. So each channel of each gets an equal part of the rate (Bonferroni): whatever is chosen, the parts add up to no
more. Scores that belong together share a part: as many independent ones as would have their largest scores in so many
different runs (`independent`). n runs seldom show scores as rare as a part is. Beyond the largest ones the logarithms
of scores are taken to be exponential (Hill 1975; Weissman 1978): log(threshold / X) is t log(k / m), of the score X
that k of the n exceed, the number m of n + 1 that the part allows, and t the mean of log(score / X) over these k,
averaged with that of all channels; somewhat more, as t is an estimate, and never less than the largest score. A run
that is unlike the others in one channel so hardly raises the thresholds of the others.

This promise is marginal: an average over trainings. The rate of one model is Beta(n + 1 - k, k) distributed (Vovk
2012), which gives the conditional bound: what `CONFIDENCE` of the models keep. A lower rate never gives lower ones:
without a promise thresholds are those of the lowest rate that could be promised, and at least `MARGIN` times the
largest score.

The scores are those of cross-validation, while the model in use learned from all runs. So the promise is approximate,
on the safe side as far as more data give smaller losses; beyond the scores it is as good as the assumption on tails.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from fame.config.values import ConfigValue
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.monitor.arrays import Floats

RATE = 0.01
"""Default of the false alarms per run that are asked for."""
MARGIN = 1.5
"""Default factor on the largest scores where the runs are too few for a promise."""
FEWEST = 5
"""Runs below which nothing is promised: mean and deviation of the others mean nothing."""
LEAST = 1e-12
"""Smallest threshold: a channel that never moved in training raises an alarm when it moves."""
CONFIDENCE = 0.9
"""Share of trainings that keep the conditional bound."""
FAR = 3.0
"""A threshold more than this times the largest left-out score of its channel is told."""
_TOP, _LOW = 5, 0.05
"""Scores from which a tail is estimated (a tenth of many runs), and the least score, relative to the largest one."""
_SURE = 40.0
"""Scores of which the estimate of a tail is as good as if it had so many: the fewer, the farther the threshold."""
_PRIOR = 4.0
"""Weight of the deviation over all channels in that of one channel, in runs: few runs estimate it badly."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Thresholds, and what they promise.

    thresholds  one per channel
    asked       false alarms per run that were asked for
    promised    false alarms per run that n runs promise at these thresholds; None: no promise
    runs        n
    margin      factor that was applied to the thresholds
    scores      (runs, channels): the largest loss of each run, by a model that was learned without it
    levels      mean of the logarithms of the scores, per channel; `deviations` of them, to see drift; none of scores of
                whole runs
    least       smallest threshold that was allowed, of scores of whole runs
    parts       (detectors, runs, channels): the scores of each of several detectors of which any raises the alarm
    among       independent scores among which the rate was divided
    """

    thresholds: tuple[float, ...]
    asked: float
    promised: float | None
    runs: int
    margin: float
    scores: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    levels: tuple[float, ...] = ()
    deviations: tuple[float, ...] = ()
    least: float = 0.0
    parts: Floats = field(default_factory=lambda: np.zeros((0, 0, 0)))
    among: float = 1.0

    @property
    def text(self) -> str:
        """What is promised, in one sentence."""
        sure = f"{runs_to_bound(self.asked)} to be {100 * CONFIDENCE:.0f} % sure of it"
        if self.levels and self.margin < 1:
            return (
                f"no promise: a margin of {self.margin:g} lowers thresholds below those that {self.runs} runs promise"
            )
        if self.promised is None:
            best = f"{self.runs} runs promise {1 / (self.runs + 1):.2g} per run at best"
            needed = max(runs_needed(self.asked), FEWEST)
            return (
                f"no promise: {self.asked:g} false alarms per run were asked for, {best}, {needed} are needed, {sure}"
            )
        more = "" if self.bound <= self.asked else f"; {self.asked:g} takes {sure}"
        return (
            f"at most {self.promised:.2g} false alarms per run on average over trainings, "
            f"with {100 * CONFIDENCE:.0f} % confidence at most {self.bound:.2g}, "
            f"by {self.runs} runs (asked for: {self.asked:g}{more})"
        )

    @property
    def bound(self) -> float:
        """The rate that `CONFIDENCE` of the models trained so do not exceed: conditional on the training; 1 without a
        promise."""
        from scipy.stats import beta

        above = round((self.promised or 0.0) * (self.runs + 1))  # scores above the threshold, and one more
        return float(beta.ppf(CONFIDENCE, above, self.runs + 1 - above)) if above else 1.0

    @property
    def stretch(self) -> Floats:
        """The thresholds divided by the largest left-out scores (channels,): how far they lie beyond what was seen."""
        largest = self.scores.max(axis=0) if len(self.scores) else np.array(self.thresholds)
        return np.asarray(self.thresholds / np.maximum(largest, LEAST))


_RATE_TEXT = re.compile(r"\s*([0-9.eE+-]+)\s*(?:per\s+(run|hour))?\s*")


def false_alarm_rate(text: str, seconds: float) -> float:
    """Read ``0.01 per run`` or ``0.5 per hour``, with runs of a mean duration: per run. Raises ConfigError."""
    found = _RATE_TEXT.fullmatch(str(text))
    try:
        value = float(found[1]) if found else math.nan
    except ValueError:
        value = math.nan
    rate = value * seconds / 3600 if found and found[2] == "hour" else value
    if not 0 < rate < 1:
        text = f"expected a rate such as '0.01 per run' or '0.5 per hour', below 1 per run, got {text!r}"
        raise ConfigError(text, element="FalseAlarms")
    return rate


def read_false_alarms(value: ConfigValue) -> str:
    """Read such a rate from a file. Raises ConfigError with its place."""
    try:
        false_alarm_rate(str(value.data), 1.0)
    except ConfigError as error:
        raise value.error(error.text) from None
    return str(value.data)


def runs_needed(rate: float) -> int:
    """Return the number of runs that can promise a rate of false alarms per run."""
    return math.ceil(1 / rate - 1 - 1e-9)


def runs_to_bound(rate: float) -> int:
    """Return the number of runs with which `CONFIDENCE` of the models keep a rate of false alarms per run."""
    return math.ceil(math.log(1 - CONFIDENCE) / math.log1p(-rate) - 1e-9)


def rank(runs: int, rate: float) -> int | None:
    """Return which of the sorted scores of `runs` is the threshold for a rate, from 1; None if they are too few."""
    place = math.ceil((runs + 1) * (1 - rate) - 1e-9)
    return max(1, place) if place <= runs else None


def independent(scores: Floats) -> float:
    """Return how many independent columns of scores (runs, columns) would have their largest ones, or their largest few
    up to `_TOP`, in as many runs: the most of these, as one run alone may have the largest ones of many columns."""
    runs, columns = scores.shape
    order, most = np.argsort(-scores, axis=0, kind="stable"), 1.0
    for depth in range(1, max(2, min(_TOP, runs // 4) + 1)):
        holding = min(len(set(order[:depth].ravel().tolist())), runs - 0.5)
        most = max(most, math.log(1 - holding / runs) / math.log(1 - depth / runs))
    return float(min(columns, most))


def calibrate(
    scores: Floats, rate: float = RATE, margin: float | None = None, among: float = 0.0, parts: Sequence[Floats] = ()
) -> Calibration:
    """Set thresholds from the largest loss of each run and channel (runs, channels); of several detectors (`parts`) in
    units of whose own thresholds the scores are, they are 1.

    The rate is divided `among` independent scores; default those of the channels. `margin` multiplies the thresholds.
    Raises ConfigError for fewer than two runs or a rate that is not between 0 and 1.
    """
    runs = len(scores)
    _, promised, factor = _promise(runs, rate, margin)
    among = among or independent(scores)
    limits = np.ones(scores.shape[1]) if len(parts) else _exceeded(scores, max(promised or 0.0, 1 / (runs + 1)) / among)
    few = promised is None and margin is None
    limits = np.maximum(limits, MARGIN * scores.max(axis=0)) if few else factor * limits
    levels, deviations = _log_scale(scores)
    return Calibration(
        tuple(np.maximum(limits, LEAST).tolist()), rate, None if factor < 1 else promised, runs, factor,
        scores, tuple(levels.tolist()), tuple(deviations.tolist()), parts=np.array(parts), among=among,
    )  # fmt: skip


def _exceeded(scores: Floats, rate: float) -> Floats:
    """Return what further scores of each channel exceed at a rate, by scores (runs, channels)."""
    runs, allowed = len(scores), (len(scores) + 1) * rate
    if place := rank(runs, rate):
        return np.asarray(np.sort(scores, axis=0)[place - 1])
    largest = np.maximum(scores.max(axis=0), LEAST)
    logs = np.log(np.sort(np.maximum(scores, _LOW * largest), axis=0))
    top = max(1, min(_TOP, runs // 2), runs // 10)
    tails = (logs[-top:] - logs[-top - 1]).mean(axis=0)
    tails = (tails + tails[tails > 0].mean()) / 2 if tails.any() else tails
    beyond = _SURE * ((top / allowed) ** (1 / _SURE) - 1)  # the logarithm, if the tail were known
    return np.asarray(np.maximum(largest, np.exp(logs[-top - 1] + beyond * tails)))


def calibrate_runs(scores: Floats, rate: float = RATE, margin: float = MARGIN, least: float = 0.0) -> Calibration:
    """Set the threshold on the score of a whole run from the scores of runs (runs,), which a run must exceed.

    Split conformal prediction as above, without a scale: equal scores, such as many zeros, keep the promise. The
    threshold is `least` or more, and `margin` multiplies the largest score where there is no promise (a margin below 1
    does not lower it: a lower rate never gives a lower threshold). Raises
    ConfigError as `calibrate`.
    """
    runs = len(scores)
    place, promised, factor = _promise(runs, rate, margin)
    factor = factor if place is None else 1.0
    largest = float(scores.max())
    limit = max(largest, factor * largest) if place is None else float(np.sort(scores)[place - 1])
    return Calibration((max(limit, least),), rate, promised, runs, factor, scores[:, None], least=least)


def _promise(runs: int, rate: float, margin: float | None) -> tuple[int | None, float | None, float]:
    """Return the place of the threshold among sorted scores and the rate that it promises, None for too few runs; and
    the factor on it. Raises ConfigError."""
    if runs < 2:
        raise ConfigError(f"has {runs} run; at least 2 are needed to set thresholds")
    if not 0 < rate < 1:
        raise ConfigError(f"expected a rate of false alarms between 0 and 1 per run, got {rate:g}")
    place = rank(runs, rate) if runs >= FEWEST else None
    factor = margin if margin is not None else MARGIN if place is None else 1.0
    return place, None if place is None else 1 - place / (runs + 1), factor


def _log_scale(scores: Floats) -> tuple[Floats, Floats]:
    """Return mean and deviation per channel of the logarithms of scores (runs, channels)."""
    logs, runs = np.log(np.maximum(scores, LEAST)), len(scores)
    variances = logs.var(axis=0, ddof=1)
    shrunk = (variances * (runs - 1) + float(np.median(variances)) * _PRIOR) / (runs - 1 + _PRIOR)
    return logs.mean(axis=0), np.sqrt(np.maximum(shrunk, 1e-6))


def left_out_thresholds(scores: Floats, rate: float, margin: float | None = None, among: float = 0.0) -> Floats:
    """Return the thresholds of each run (runs, channels), set by the others. Raises ConfigError if fewer than three."""
    every = range(len(scores))
    return np.array([calibrate(np.delete(scores, n, axis=0), rate, margin, among).thresholds for n in every])


def measured_alarms(calibration: Calibration) -> int:
    """Count the runs of a calibration that would raise an alarm if the others had set the thresholds."""
    scores, asked, margin = calibration.scores, calibration.asked, calibration.margin
    if calibration.levels:
        parts = calibration.parts if len(calibration.parts) else scores[None]
        above = [each > left_out_thresholds(each, asked, margin, calibration.among) for each in parts]
        return int(np.any(above, axis=(0, 2)).sum())
    every, column = range(len(scores)), scores[:, 0]
    limits = [calibrate_runs(np.delete(column, n), asked, margin, calibration.least).thresholds[0] for n in every]
    return int((column > limits).sum())
