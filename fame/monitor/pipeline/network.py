"""Perceptrons of several channels, evaluated at once: one matrix product per layer for all of them.

scikit-learn evaluates one network at a time and checks its input each time; for the few windows of one call that takes
many times as long as the arithmetic. Results are equal to 1e-5 and better; a test says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fame.monitor.pipeline.processor import Floats

ACTIVATIONS = ("relu", "tanh", "logistic", "identity")


@dataclass(frozen=True, slots=True)
class Network:
    """Networks of the same shape, one per channel.

    weights     per layer (channels, in, out)
    biases      per layer (channels, 1, out)
    activation  of the hidden layers; the last is linear
    """

    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]
    activation: str

    @property
    def channels(self) -> int:
        return int(self.weights[0].shape[0])

    @property
    def layers(self) -> tuple[int, ...]:
        """Neurons per layer, from input to output."""
        return (int(self.weights[0].shape[1]), *(int(weight.shape[2]) for weight in self.weights))

    def __call__(self, inputs: Floats) -> Floats:
        """(channels, n, in) to (channels, n, out)."""
        last = len(self.weights) - 1
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            inputs = np.matmul(inputs, weight)
            inputs += bias
            if number < last:
                _activate(self.activation, inputs)
        return inputs

    @classmethod
    def of(cls, estimators: Sequence[Any]) -> Network:
        """That of scikit-learn's MLPRegressors, one per channel."""
        layers = range(len(estimators[0].coefs_))
        weights = tuple(np.stack([item.coefs_[layer] for item in estimators]) for layer in layers)
        biases = tuple(np.stack([item.intercepts_[layer] for item in estimators])[:, None] for layer in layers)
        return cls(weights, biases, str(estimators[0].activation))


def _activate(name: str, values: Floats) -> None:
    """In place."""
    if name == "relu":
        np.maximum(values, 0, out=values)
    elif name == "tanh":
        np.tanh(values, out=values)
    elif name == "logistic":
        np.negative(values, out=values)
        np.exp(values, out=values)
        values += 1
        np.reciprocal(values, out=values)
