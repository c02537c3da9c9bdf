"""Thresholds with a stated false-alarm rate: conformal calibration over undisturbed runs.

Each run gives one score per channel, its largest loss, by a model that was learned without that run. The scores of a
channel are put on a common scale: z = (log score - mean) / deviation, both over the *other* runs, so that a run of the
calibration is treated as a future run is. The score of a run is its largest z. If runs are exchangeable, the score of
one more run is equally likely to fall between any two of the n scores; so the k-th smallest, with
k = ceil((n + 1) (1 - rate)), is exceeded in at most that `rate` of future runs (split conformal prediction: Vovk,
Gammerman and Shafer 2005; Angelopoulos and Bates 2023, section 1). n runs cannot promise less than 1 / (n + 1).
This is an average over trainings: the rate of one model is Beta(n + 1 - k, k) distributed, and is often higher. A lower
rate never gives lower thresholds: without a promise they are at least the highest that could be promised.

The promise is for all channels together; each channel keeps a threshold of its own. The scores are those of
cross-validation, while the model in use learned from all runs: this makes the promise approximate, on the safe side as
far as more data give smaller losses.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from fame.config.values import ConfigValue
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
    levels      mean of the logarithms of the scores, per channel; `deviations` of them; none of scores of whole runs
    least       smallest threshold that was allowed, of scores of whole runs
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

    @property
    def text(self) -> str:
        """What is promised, in one sentence."""
        best = f"{self.runs} runs promise {1 / (self.runs + 1):.2g} per run at best"
        if self.promised is None:
            needed = max(runs_needed(self.asked), FEWEST)
            return f"no promise: {self.asked:g} false alarms per run were asked for, {best}, {needed} are needed"
        return (
            f"at most {self.promised:.2g} false alarms per run on average over trainings, by {self.runs} runs "
            f"(asked for: {self.asked:g}); {100 * self.exceeding:.0f} % of models trained so exceed it"
        )

    @property
    def exceeding(self) -> float:
        """The share of trainings whose model has more false alarms than promised: marginal coverage is a mean."""
        from scipy.stats import beta

        above = round((self.promised or 0.0) * (self.runs + 1))  # scores above the threshold, and one more
        return float(beta.sf(above / (self.runs + 1), above, self.runs + 1 - above)) if above else 0.0


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
    """Give the number of runs that can promise a rate of false alarms per run."""
    return math.ceil(1 / rate - 1 - 1e-9)


def rank(runs: int, rate: float) -> int | None:
    """Give which of the sorted scores of `runs` is the threshold for a rate, from 1; None if they are too few."""
    place = math.ceil((runs + 1) * (1 - rate) - 1e-9)
    return max(1, place) if place <= runs else None


def calibrate(scores: Floats, rate: float = RATE, margin: float | None = None) -> Calibration:
    """Set thresholds from the largest loss of each run and channel (runs, channels).

    `margin` multiplies the thresholds; by default only where there is no promise. Raises ConfigError for fewer than two
    runs or a rate that is not between 0 and 1.
    """
    runs = len(scores)
    place, promised, factor = _promise(runs, rate, margin)
    logs = np.log(np.maximum(scores, LEAST))
    levels, deviations = _scale(logs)
    if runs < FEWEST:
        limits = factor * np.exp(levels + ((logs - levels) / deviations).max() * deviations)
    else:
        ordered = np.sort(_run_scores(logs))
        limits = (margin or 1.0) * np.exp(levels + ordered[(place or runs) - 1] * deviations)
        if place is None:  # never below what a higher rate gives
            limits = np.maximum(limits, factor * np.exp(levels + ((logs - levels) / deviations).max() * deviations))
    thresholds = np.maximum(limits, LEAST)
    return Calibration(
        tuple(thresholds.tolist()), rate, promised, runs, factor, scores,
        tuple(levels.tolist()), tuple(deviations.tolist()),
    )  # fmt: skip


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
    """Give the place of the threshold among sorted scores and the rate that it promises, None for too few runs; and
    the factor on it. Raises ConfigError."""
    if runs < 2:
        raise ConfigError(f"has {runs} run; at least 2 are needed to set thresholds")
    if not 0 < rate < 1:
        raise ConfigError(f"expected a rate of false alarms between 0 and 1 per run, got {rate:g}")
    place = rank(runs, rate) if runs >= FEWEST else None
    factor = margin if margin is not None else MARGIN if place is None else 1.0
    return place, None if place is None else 1 - place / (runs + 1), factor


def _scale(logs: Floats) -> tuple[Floats, Floats]:
    """Give mean and deviation per channel of log scores (runs, channels)."""
    runs = len(logs)
    variances = logs.var(axis=0, ddof=1) if runs > 1 else np.zeros(logs.shape[1])
    pooled = float(np.median(variances))
    shrunk = (variances * (runs - 1) + pooled * _PRIOR) / (runs - 1 + _PRIOR)
    return logs.mean(axis=0), np.sqrt(np.maximum(shrunk, 1e-6))


def _run_scores(logs: Floats) -> Floats:
    """Give the largest z of each run, by mean and deviation of the other runs."""
    found = []
    for number, row in enumerate(logs):
        mean, deviation = _scale(np.delete(logs, number, axis=0))
        found.append(float(((row - mean) / deviation).max()))
    return np.array(found)


def left_out_thresholds(scores: Floats, rate: float, margin: float | None = None) -> Floats:
    """Give the thresholds of each run (runs, channels), set by the other runs. Raises ConfigError for fewer than three
    runs."""
    return np.array([calibrate(np.delete(scores, n, axis=0), rate, margin).thresholds for n in range(len(scores))])


def measured_alarms(calibration: Calibration) -> int:
    """Count the runs of a calibration that would raise an alarm if the others had set the thresholds."""
    scores, asked, margin = calibration.scores, calibration.asked, calibration.margin
    if calibration.levels:
        return int((scores > left_out_thresholds(scores, asked, margin)).any(axis=1).sum())
    every, column = range(len(scores)), scores[:, 0]
    limits = [calibrate_runs(np.delete(column, n), asked, margin, calibration.least).thresholds[0] for n in every]
    return int((column > limits).sum())
