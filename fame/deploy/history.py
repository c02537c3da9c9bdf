"""What a robot ran before: its engine keeps the deployments, and starts one of them again without its file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from fame.deploy.envelope import Envelope, model_hash
from fame.errors import DeploymentError

KEPT = 5
"""How many deployments a robot keeps, besides the one that runs."""


class History:
    """The deployments that a robot has started, the one that runs last.

    before     those of earlier engines, oldest first
    """

    def __init__(self, before: Iterable[Envelope] = ()) -> None:
        self._started: list[Envelope] = list(before)

    def begin(self, envelope: Envelope) -> None:
        """Add what runs from now on."""
        others = [one for one in self._started if one.deployment != envelope.deployment]
        self._started = [*others[-KEPT:], envelope]

    def replaced(self) -> list[Envelope]:
        """Return those that stay when the next one begins, oldest first."""
        return self._started[-KEPT:]

    def previous(self) -> Mapping[str, Any]:
        """Return what a report says of the one before that which runs: its `deployment`, the `team` that ran it, the
        `hash` of its model, and what an `Envelope` has to say as `recalls`; empty for the first deployment."""
        if len(self._started) < 2:
            return {}
        envelope = self._started[-2]
        said = {"deployment": envelope.deployment, "hash": envelope.hash, "recalls": _digest(envelope)}
        return {**said, "team": sorted({envelope.robot, *envelope.team})}

    def recall(self, envelope: Envelope) -> Envelope:
        """Return an envelope with what it `recalls`. Raises DeploymentError if that is not kept."""
        if envelope.model:
            raise DeploymentError("has a model, and recalls another one", cause="recall")
        for one in reversed(self._started):
            if (one.hash, _digest(one)) == (envelope.hash, envelope.recalls):
                return replace(envelope, model=one.model, promises=one.promises, receivers=one.receivers)
        text = f"it does not keep model {envelope.hash[:12]}: the last {KEPT} are kept, with --state also over restarts"
        raise DeploymentError(text, cause="recall")


def is_recalled(envelope: Envelope) -> bool:
    """Return whether an envelope has what it says that it recalls."""
    return not envelope.recalls or _digest(envelope) == envelope.recalls


def _digest(envelope: Envelope) -> str:
    """The hash of what an envelope that recalls another one takes from it."""
    receivers = {topic: list(robots) for topic, robots in envelope.receivers.items()}
    return model_hash(json.dumps([envelope.model, dict(envelope.promises), receivers], sort_keys=True).encode())
