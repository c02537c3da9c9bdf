"""A robot that is ready, and whose sender fell silent: was anybody told to start?

Whoever sends may die between two words. If it had told one robot to start, all that were ready have to; if none, none
may. A robot's report names the deployment that its process came with, and is kept for those who listen later, so the
others can be asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fame.clock import SECOND, Kind, Scheduler
from fame.deployment.envelope import STATUS_QOS, STRING, Report
from fame.middleware.interface import Node

ASKING = 2.0
"""How long the others are listened to (s): discovery, and two of their heartbeats."""


class Inquiry:
    """Listens to the other robots of a deployment; `decided` is called once: whether one of them has started it."""

    def __init__(
        self,
        deployment: str,
        others: Sequence[str],
        node: Node,
        scheduler: Scheduler,
        decided: Callable[[bool], object],
    ) -> None:
        self._deployment, self._decided = deployment, decided
        self._limit = scheduler.after(round(ASKING * SECOND), lambda: self._decide(False), Kind.TIMER)
        self._ends = [node.subscription(f"/{robot}/bpmn_status", STRING, self._heard, STATUS_QOS) for robot in others]

    def _heard(self, message: Any) -> None:
        report = Report.from_json(message.data)
        if report is not None and report.deployed == self._deployment:
            self._decide(True)

    def _decide(self, started: bool) -> None:
        if self._ends or self._limit.action is not None:
            self.close()
            self._decided(started)

    def close(self) -> None:
        """Listen no more."""
        self._limit.cancel()
        for end in self._ends:
            end.close()
        self._ends = []
