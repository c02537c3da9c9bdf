"""People with an address of their own: each may complete the tasks that are theirs; some may take robots over, too."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Mapping
from typing import Any

from fame.bpmn.model import Human
from fame.dataclasses import dataclass, field
from fame.errors import FameError

TAKE_OVER = ("take_over", "steer", "suspend", "continue", "restart", "skip", "fail")
"""What somebody may do who takes robots over."""


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody with a role, what they may do besides completing tasks, and the secret of their address."""

    user: str
    role: str
    acts: tuple[str, ...] = ()
    token: str = field(default_factory=lambda: secrets.token_urlsafe(18), repr=False)

    def __str__(self) -> str:
        return f"{self.user} ({self.role})"

    def to_json(self) -> dict[str, str]:
        """Return what the page knows."""
        return {"user": self.user, "role": self.role}

    def may_complete(self, task: Human) -> bool:
        """Return whether a task is theirs: it names them or their role, or nobody."""
        return not (task.users or task.groups) or self.user in task.users or self.role in task.groups

    def check(self, command: Mapping[str, Any], tasks: Iterable[Human]) -> None:
        """Raise FameError for a command that they may not give. `tasks`: all that have the id of its element."""
        if command.get("do") in self.acts:
            return
        if command.get("do") != "complete":
            raise FameError(f"{self} may only complete tasks{' and take robots over' if self.acts else ''}")
        for task in tasks:
            if not self.may_complete(task):
                theirs = ", ".join((*task.users, *task.groups))
                raise FameError(f"{command.get('element')} is a task of {theirs}, not of {self}")
