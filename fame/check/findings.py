"""Findings: the results of checks, sorted by file and line, and their summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from fame.errors import ConfigError, ModelError, display_name

Level = Literal["error", "warning", "note"]
"""error: it cannot run; warning: it runs, but probably not as intended; note: something to know."""

LEVELS: tuple[Level, ...] = ("error", "warning", "note")


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem or note.

    `line` is 1-based, 0 if unknown; `element` is the id of an element, empty for the file; `name` is its label.
    """

    level: Level
    text: str
    file: str = ""
    line: int = 0
    element: str = ""
    name: str = ""

    def __str__(self) -> str:
        """One line: ``mission.bpmn:12: warning: "Sure?" (Gateway_1): ...``."""
        line = str(self.line) if self.line else ""
        place = ":".join(part for part in (self.file, line) if part)
        return ": ".join(part for part in (place, self.level, display_name(self.element, self.name), self.text) if part)


def of_error(error: ModelError | ConfigError) -> Finding:
    """The finding that reports an error."""
    return Finding("error", error.text, error.file, error.line, error.element, error.name)


def arranged(findings: Iterable[Finding], files: Iterable[str]) -> list[Finding]:
    """Sort by file (in the order of `files`), line and level; remove duplicates."""
    order = {file: place for place, file in enumerate(dict.fromkeys(files))}
    return sorted(
        dict.fromkeys(findings), key=lambda one: (order.get(one.file, len(order)), one.line, LEVELS.index(one.level))
    )


def summary(findings: Iterable[Finding]) -> str:
    """Count the findings of each level.

    >>> summary([Finding("error", "a"), Finding("note", "b"), Finding("note", "c")]), summary([])
    ('1 error, 2 notes', 'No problems found.')
    """
    counts = Counter(finding.level for finding in findings)
    parts = [f"{counts[level]} {level}{'s' if counts[level] > 1 else ''}" for level in LEVELS if counts[level]]
    return ", ".join(parts) or "No problems found."
