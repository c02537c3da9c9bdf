"""Robots of one pool that do not start alike: mission parameters may give each of them values of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fame.bpmn.pools import Pool


def kinds_of(cast: Mapping[str, Pool], variables: Mapping[str, Mapping[str, Any]]) -> dict[str, Pool]:
    """Robot -> its pool; those with another process, or other variables to start with, have one by another name.

    `variables` are what the process of a robot starts with, by robot.
    """
    kinds: dict[str, list[tuple[Pool, str]]] = {}
    found: dict[str, Pool] = {}
    for robot, pool in cast.items():
        known, values = kinds.setdefault(pool.name, []), repr(sorted(variables.get(robot, {}).items()))
        same = (one for one, others in known if values == others and _has(one, pool))
        kind = next(same, None)
        if kind is None:
            kind = replace(pool, name=f"{pool.name}#{len(known)}") if known else pool  # no name of a robot has a "#"
            known.append((kind, values))
        found[robot] = kind
    return found


def _has(kind: Pool, pool: Pool) -> bool:
    return kind.process is pool.process or kind.process == pool.process
