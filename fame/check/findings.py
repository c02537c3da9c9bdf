"""What a check has to say: findings, in the order of the file, and how many there are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from fame.errors import ConfigError, ModelError

Level = Literal["error", "warning", "note"]
"""error: it cannot run; warning: it can, but hardly as it is meant; note: something to know."""

LEVELS: tuple[Level, ...] = ("error", "warning", "note")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong or doubtful. `line` is 1-based, 0 unknown; `element` is an id, empty for the file."""

    level: Level
    text: str
    file: str = ""
    line: int = 0
    element: str = ""

    def __str__(self) -> str:
        """One line: ``mission.bpmn:12: warning: Gateway_1: ...``."""
        line = str(self.line) if self.line else ""
        place = ":".join(part for part in (self.file, line) if part)
        return ": ".join(part for part in (place, self.level, self.element, self.text) if part)


def of_error(error: ModelError | ConfigError) -> Finding:
    """The finding that an error in a file is."""
    return Finding("error", error.text, error.file, error.line, error.element)


def arranged(findings: Iterable[Finding], files: Iterable[str]) -> list[Finding]:
    """Each once, by file (in the order of `files`), line and level."""
    order = {file: place for place, file in enumerate(dict.fromkeys(files))}
    return sorted(
        dict.fromkeys(findings), key=lambda one: (order.get(one.file, len(order)), one.line, LEVELS.index(one.level))
    )


def summary(findings: Iterable[Finding]) -> str:
    """How many there are of each level.

    >>> summary([Finding("error", "a"), Finding("note", "b"), Finding("note", "c")]), summary([])
    ('1 error, 2 notes', 'nothing found')
    """
    counts = Counter(finding.level for finding in findings)
    parts = [f"{counts[level]} {level}{'s' if counts[level] > 1 else ''}" for level in LEVELS if counts[level]]
    return ", ".join(parts) or "nothing found"
