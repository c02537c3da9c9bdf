"""Two models judge the same recordings: where their verdicts differ, and which of them the labels bear out."""

from __future__ import annotations

from typing import Any

from fame.dataclasses import dataclass, replace
from fame.errors import NOT_KNOWN, ConfigError
from fame.monitor.judge import JudgedRun, JudgedRuns, mark_known


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """What an old and a new model say of each run. Raises ConfigError if they have read other runs.

    Runs that one of them has learned from are left out.
    """

    old: JudgedRuns
    new: JudgedRuns

    def __post_init__(self) -> None:
        if len(self.old.runs) != len(self.new.runs):
            counts = f"{len(self.old.runs)} runs in the data, {self.new.model} reads {len(self.new.runs)}"
            raise ConfigError(f"reads {counts}: they cannot be compared", file=self.old.model)

    @property
    def pairs(self) -> tuple[tuple[JudgedRun, JudgedRun], ...]:
        """Each run as both have judged it."""
        return tuple(zip(self.old.runs, self.new.runs, strict=True))

    @property
    def tested(self) -> tuple[tuple[JudgedRun, JudgedRun], ...]:
        """The pairs of runs that neither model has learned from."""
        return tuple((old, new) for old, new in self.pairs if not (old.known or new.known))

    @property
    def differing(self) -> tuple[tuple[JudgedRun, JudgedRun], ...]:
        """The runs with another verdict, or of which only one model finds the anomaly that the labels name."""
        return tuple((old, new) for old, new in self.tested if (old.verdict, right(old)) != (new.verdict, right(new)))

    @property
    def better(self) -> int:
        """Labelled runs that only the new model judges rightly."""
        return sum(bool(right(new)) and not right(old) for old, new in self.tested)

    @property
    def worse(self) -> int:
        """Labelled runs that only the old model judges rightly."""
        return sum(bool(right(old)) and not right(new) for old, new in self.tested)

    @property
    def exit_code(self) -> int:
        """1 if the new model judges more runs wrongly; 3 if that is not known, as labels or verdicts are missing."""
        if self.worse > self.better:
            return 1
        unknown = any(right(old) is None for old, _ in self.differing)
        unjudged = any("not judged" in (old.verdict, new.verdict) for old, new in self.tested)
        return NOT_KNOWN if unknown or unjudged or not self.tested else 0

    @property
    def text(self) -> str:
        """The result in a sentence."""
        left_out = len(self.pairs) - len(self.tested)
        more = f"; {left_out} more, that a model has learned from, are left out" if left_out else ""
        if not self.tested:
            return f"not known: no runs but {left_out} that a model has learned from" if left_out else "no runs"
        if not self.differing:
            return f"same verdicts on every run{more}"
        found = f"other verdicts on {len(self.differing)} of {len(self.tested)} runs"
        if any(right(old) is None for old, _ in self.differing):
            return f"{found}: without labels, which model is right is not known{more}"
        return f"{found}: {self.better} right only by the new model, {self.worse} only by the old one{more}"

    def to_plain(self) -> dict[str, Any]:
        """Return figures of both and the runs that differ as plain data."""
        return {
            "text": self.text, "better": self.better, "worse": self.worse,
            "old": {"model": self.old.model, "figures": self.old.figures},
            "new": {"model": self.new.model, "figures": self.new.figures},
            "differing": [
                {"run": old.number, "file": old.file, "label": old.label, "old": old.verdict, "new": new.verdict}
                for old, new in self.differing
            ],
        }  # fmt: skip


def compared(old: JudgedRuns, new: JudgedRuns) -> ModelComparison:
    """Compare what two models say of the same runs; the figures of both leave out what one of them has learned from.

    Raises ConfigError if they have read other runs.
    """
    known = [run.number for judged in (old, new) for run in judged.runs if run.known]
    return ModelComparison(*(replace(each, runs=mark_known(each.runs, known)) for each in (old, new)))


def right(run: JudgedRun) -> bool | None:
    """Return whether the verdict is that of the labels; None without labels."""
    if run.label is None:
        return None
    return run.latency is not None if run.label == -1 else run.verdict == "benign"
