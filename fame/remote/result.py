"""What a run in many processes says of itself: how it stands while it lasts, and how it went."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from fame.deployment import Report


@dataclass(slots=True)
class TeamResult:
    """How a run in many processes went. `reports` are the last words of the robots, `world` those of the world."""

    status: str
    reports: dict[str, Report] = field(default_factory=dict)
    world: Mapping[str, Any] | None = None
    seconds: float = 0.0
    messages: list[str] = field(default_factory=list)

    @property
    def exit_code(self) -> int:
        """That of the command."""
        return {"completed": 0, "interrupted": 130}.get(self.status, 1)

    def to_json(self) -> dict[str, Any]:
        """Fit for JSON."""
        return {
            "status": self.status,
            "seconds": round(self.seconds, 3),
            "robots": {name: asdict(report) for name, report in self.reports.items()},
            "world": self.world,
            "messages": self.messages,
        }


@dataclass(frozen=True, slots=True)
class Sight:
    """How things stand: s of the mission, what robots said last, and the number of each process."""

    time: float
    reports: Mapping[str, Report]
    pids: Mapping[str, int]
