"""What a judge says of a property of a team."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from fame.dataclasses import dataclass
from fame.errors import NOT_KNOWN
from fame.properties.parts import VerdictWord

HEADS = ("property", "verdict", "slack", "why")
"""Columns of a table of judgements (`Judgement.row`)."""
ABSENT = "no robot that it names takes part"
SEVERAL = "several started before one ended, and nobody knows which of them did"


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict about a property. `slack` is in s, or in the unit of its condition; `time` in s as in `Verdict`.

    `text` says why; `robots` are those of its pools that it is about, `began` (s) when what was violated or is pending
    began; `elements` are (robot, id) of the events that broke it.
    """

    name: str
    sentence: str
    verdict: VerdictWord
    slack: float | None = None
    time: float | None = None
    text: str = ""
    robots: tuple[str, ...] = ()
    began: float | None = None
    elements: tuple[tuple[str, str], ...] = ()

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Its cells in a table with the columns `HEADS`."""
        return self.name, self.verdict, "" if self.slack is None else f"{self.slack:.3g}", self.text

    def __str__(self) -> str:
        verb = "" if self.verdict == "holds" else "is "
        return f"property {self.name} {verb}{self.verdict}: {self.text or self.sentence}"

    def to_json(self) -> dict[str, Any]:
        return {
            "property": self.name,
            "sentence": self.sentence,
            "verdict": self.verdict,
            "slack": None if self.slack is None or math.isinf(self.slack) else self.slack,  # JSON has no infinity
            "time": self.time,
            "text": self.text,
            "robots": list(self.robots),
            "began": self.began,
            "elements": [list(each) for each in self.elements],
        }


def exit_code(judgements: Iterable[Judgement]) -> int:
    """Return the exit code of a command: 1 if a property is violated, 3 if one is pending or not known, else 0."""
    words = {each.verdict for each in judgements}
    return 1 if "violated" in words else NOT_KNOWN if words & {"pending", "not known"} else 0
