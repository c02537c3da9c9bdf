"""Threshold with hysteresis: from losses to alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from fame.errors import ConfigError
from fame.monitor.pipeline.processor import ActiveElements, Parameter, Processor, Result, Samples, per_channel, stacked
from fame.monitor.pipeline.sequence import OrderWatch

_Alarm = tuple[float, int, str, float, float]
"""Stamp (s), channel, its name or a sentence, loss and excess."""


class Threshold(Processor):
    """Raises an alarm when any channel exceeds its threshold; again only after all of them have come well below. With a
    model that knows the order of the elements of a mission, also when one is left out, or comes in another order.

    `alarm`, `channel`, `name`, `loss`, `excess` have a sample per alarm: true, the channel that is farthest above its
    threshold, its name (a list of one), its value, and that divided by the threshold. `active` has one per judged
    sample: whether the alarm is set. A sample with a value that is no number is not judged, unless another channel is
    above its threshold: it neither sets nor ends the alarm, and is reported. An alarm for the order has a sentence as
    `name`, -1 as `channel`, 0 as `loss` and `excess`.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("threshold", "floats", (), (1e-300, None), "", "above 0; one for all channels, or one per channel"),
        Parameter(
            "model", "file", "", description="trained model whose thresholds are used if none are given", fixed=True
        ),
        Parameter("hysteresis", "float", 0.1, (0, 1), description="part below the threshold at which the alarm ends"),
        Parameter("names", "strs", (), description="of the channels, if the data do not tell"),
    )
    outputs: tuple[str, ...] = ("alarm", "channel", "name", "loss", "excess", "active")
    model: str
    hysteresis: float
    names: tuple[str, ...]
    elements: ActiveElements = ()
    lost: float = -np.inf

    def __init__(self, **values: object) -> None:
        super().__init__(**values)
        self._active = False
        self._order: OrderWatch | None = None
        if self.model:
            from fame.monitor.pipeline.trained_model import TrainedModel

            trained = TrainedModel.load(self.model)
            if not self.threshold:
                self.threshold, self.names = trained.thresholds, self.names or trained.columns
            if usual := trained.conditions.get("order"):
                self._order = OrderWatch(usual)
        if not self.threshold:
            raise ConfigError("needs a threshold, or a model with thresholds", element="threshold")

    @property
    def needs_elements(self) -> bool:
        """Whether the model knows the order of the elements of a mission."""
        return self._order is not None

    @property
    def threshold(self) -> tuple[float, ...]:
        """One, or one per channel."""
        return self._threshold

    @threshold.setter
    def threshold(self, values: tuple[float, ...]) -> None:
        if not values and getattr(self, "_threshold", None):
            raise ConfigError("expected one value or more, got an empty list", element="threshold")
        self._threshold = values

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        samples = stacked(inputs)
        alarms = self._wrong_order(samples)
        if not len(samples):
            return _alarms(alarms) or None
        names, threshold = self._channels(samples)
        excess = samples.channels() / per_channel(threshold, samples.channels().shape, "threshold")
        unknown = np.isnan(excess)
        for channel in np.flatnonzero(unknown.any(axis=0)):
            self.report(f"{names[channel]} is no number: not judged")
        excess[unknown] = -np.inf
        worst = excess.max(axis=1)
        judged = ~unknown.any(axis=1) | (worst > 1)
        active = self._states(worst, judged)
        rising = np.flatnonzero(active & ~np.concatenate(([self._active], active[:-1])))
        self._active = bool(active[-1])
        for row, top in zip(rising.tolist(), excess[rising].argmax(axis=1).tolist(), strict=True):
            loss = float(samples.channels()[row, top])
            alarms.append((float(samples.stamps[row]), top, names[top], loss, float(worst[row])))
        return {**_alarms(alarms), "active": Samples(active[judged], samples.stamps[judged])}

    def _wrong_order(self, samples: Samples) -> list[_Alarm]:
        if self._order is None:
            return []
        now = float(samples.stamps[-1]) if len(samples) else 0.0
        wrong = self._order.feed(self.elements, now, self.lost)
        for _, text in wrong:
            self.report(text)
        return [(stamp, -1, text, 0.0, 0.0) for stamp, text in wrong]

    def _channels(self, samples: Samples) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """Return names and thresholds of the channels. Data that name theirs are matched to `names`, in any order.

        Raises ValueError if there are not as many names as channels.
        """
        own, data = _short(self.names), _short(samples.names)
        width = samples.channels().shape[1]
        if len(own) > 1 and own != data and sorted(own) == sorted(data):
            several = len(self.threshold) == len(own)
            return data, tuple(self.threshold[own.index(name)] for name in data) if several else self.threshold
        names = own or data or tuple(map(str, range(width)))
        if len(names) != width:
            raise ValueError(f"names has {len(names)} texts, the data {width} channels")
        return names, self.threshold

    def _states(self, worst: Any, judged: Any) -> Any:
        """Return the alarm after each sample: set above 1, cleared below the hysteresis, else as before."""
        states = np.where(worst > 1, 1, np.where(judged & (worst <= 1 - self.hysteresis), 0, -1))
        states = np.concatenate(([int(self._active)], states))
        last = np.maximum.accumulate(np.where(states >= 0, np.arange(len(states)), 0))
        return states[last][1:].astype(bool)


def _short(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names without what is before their last dot, if that does not make two of them equal."""
    last = tuple(name.rpartition(".")[2] for name in names)
    return last if len({*last}) == len(last) else names


def _alarms(alarms: Sequence[_Alarm]) -> dict[str, Samples]:
    """Return the outputs that have a sample per alarm; none without alarms."""
    if not alarms:
        return {}
    stamps, channel, names, loss, excess = (np.array(part) for part in zip(*sorted(alarms), strict=True))
    values = {"channel": channel, "name": names.astype(object).reshape(-1, 1), "loss": loss, "excess": excess}
    return {name: Samples(each, stamps) for name, each in {"alarm": channel >= -1, **values}.items()}
