"""Several inputs as one, for processors that look at all channels together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fame.monitor.pipeline.processor import Samples


def stacked(inputs: Mapping[str, Samples]) -> Samples:
    """All channels of all inputs, in their order: values (n, channels).

    Inputs of one topic have the same stamps. Raises ValueError for inputs that do not.
    """
    items = list(inputs.values())
    if len(items) == 1:
        return items[0]
    first = items[0]
    for name, item in inputs.items():
        if len(item) != len(first) or not np.array_equal(item.stamps, first.stamps):
            there = next(iter(inputs))
            raise ValueError(f"{name} has not the stamps of {there}: resample both, or take them from one topic")
    names = tuple(name for key, item in inputs.items() for name in (item.names or _made_up(key, item)))
    return Samples(np.hstack([item.channels() for item in items]), first.stamps, names)


def _made_up(key: str, item: Samples) -> tuple[str, ...]:
    width = item.channels().shape[1] if len(item) else 1
    return (key,) if width == 1 else tuple(f"{key}.{index}" for index in range(width))
