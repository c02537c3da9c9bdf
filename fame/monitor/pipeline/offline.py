"""Recorded arrays through a pipeline, without nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fame.monitor.pipeline.processor import Samples, SupportsExecute


def run(
    processors: Sequence[SupportsExecute], inputs: Mapping[str, Samples], frequency: float = 0.0
) -> dict[str, Samples]:
    """What a chain of processors computes: the outputs of each are the inputs of the next.

    `frequency` (Hz) is that of the calls, as a node would make them; 0: one call with everything. A processor that
    computes the same however its samples are cut gives the same for each. Raises what a processor raises.
    """
    collected: dict[str, list[Samples]] = {}
    for part in _parts(inputs, frequency):
        for name, samples in step(processors, part).items():
            collected.setdefault(name, []).append(samples)
    return {name: _joined(parts) for name, parts in collected.items()}


def step(processors: Sequence[SupportsExecute], inputs: Mapping[str, Samples]) -> dict[str, Samples]:
    """One call of a chain. Bare values get the stamp of the latest sample that was given."""
    current = dict(inputs)
    for processor in processors:
        latest = max((float(item.stamps[-1]) for item in current.values() if len(item)), default=0.0)
        result = processor.execute(current) or {}
        current = {name: as_samples(value, latest) for name, value in result.items()}
        if not current:
            break
    return current


def as_samples(value: Any, stamp: float) -> Samples:
    """A result as samples: one of that stamp if it is a bare value. Raises ValueError for stamps that do not fit."""
    if not isinstance(value, Samples):
        return Samples(np.asarray(value)[None], np.array([stamp]))
    values, stamps = np.asarray(value.values), np.asarray(value.stamps, dtype=np.float64)
    if stamps.ndim != 1 or not values.ndim or len(values) != len(stamps):
        raise ValueError(f"it gives values of shape {values.shape} with stamps of shape {stamps.shape}")
    return Samples(values, stamps, value.names)


def _parts(inputs: Mapping[str, Samples], frequency: float) -> list[dict[str, Samples]]:
    if not frequency:
        return [dict(inputs)]
    stamps = [item.stamps for item in inputs.values() if len(item)]
    if not stamps:
        return []
    begin, end = min(float(item[0]) for item in stamps), max(float(item[-1]) for item in stamps)
    cuts = begin + (np.arange(np.floor((end - begin) * frequency) + 2) + 0.5) / frequency
    places = {name: np.searchsorted(item.stamps, cuts) for name, item in inputs.items()}
    parts = []
    for call in range(len(cuts)):
        rows = {name: slice(int(at[call - 1]) if call else 0, int(at[call])) for name, at in places.items()}
        part = {
            name: item.replace(values=item.values[rows[name]], stamps=item.stamps[rows[name]])
            for name, item in inputs.items()
        }
        if any(len(item) for item in part.values()):
            parts.append(part)
    return parts


def _joined(parts: Sequence[Samples]) -> Samples:
    first = parts[0]
    values, stamps = ([getattr(part, field) for part in parts] for field in ("values", "stamps"))
    return Samples(np.concatenate(values), np.concatenate(stamps), first.names)
