"""Findings and verdicts of several searches as those of one exploration: each cause once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence, Set

from fame.check.explore.findings import FAILING, LEVELS, Finding
from fame.check.explore.properties import PROOFS, Judged
from fame.check.explore.trace import Place
from fame.dataclasses import dataclass, field, replace


@dataclass(slots=True)
class MergedFindings:
    """The findings of all searches so far, by their cause: of several the worst, and of equally bad ones the first."""

    _by_cause: dict[tuple[str, str], Finding] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether there is an error that is not accepted."""
        return any(finding.level == "error" for finding in self._by_cause.values())

    def add(self, findings: Iterable[Finding]) -> None:
        """Add the findings of a search."""
        for finding in findings:
            cause = _cause(finding)
            self._by_cause[cause] = min(self._by_cause.get(cause, finding), finding, key=_rank)

    def add_search(self, findings: Iterable[Finding]) -> None:
        """Add the findings of a search with another delivery, which knows what no delivery so far has entered."""
        self._by_cause = {cause: finding for cause, finding in self._by_cause.items() if finding.kind != "unreachable"}
        self.add(findings)

    def add_sampled(self, findings: Iterable[Finding]) -> None:
        """Add what is new among the findings of a sample: in a part of a team robots wait at fewer elements."""
        deadlocks = [
            {*known.places} for known in self._by_cause.values() if known.kind in FAILING and not known.accepted
        ]

        def is_known(places: Set[Place]) -> bool:
            return any(known <= places for known in deadlocks)

        self.add([finding for finding in findings if finding.kind not in FAILING or not is_known({*finding.places})])

    def of_all(self, received: Set[tuple[str, str]], *, partial: bool) -> tuple[Finding, ...]:
        """Return the findings, in the light of what robots of each process have received in any search.

        After a partial search nothing is known to be unreachable.
        """
        unreachable = [finding for finding in self._by_cause.values() if finding.kind == "unreachable"]
        others = (finding for finding in self._by_cause.values() if finding.kind != "unreachable")
        return (*(_in_all(finding, received, partial) for finding in others), *(() if partial else unreachable))


def _in_all(finding: Finding, received: Set[tuple[str, str]], partial: bool) -> Finding:
    """A finding; what is always lost in one delivery is only sometimes lost if another one brings it.

    After a partial search it is not known whether that is always so.
    """
    if finding.kind != "always-lost":
        return finding
    if (finding.processes[0], finding.text.partition(" ")[0]) in received:
        return replace(finding, kind="unneeded", text=finding.text.replace(" is always lost ", " is sometimes lost "))
    partly = " is lost in every explored delivery, in a partial search, "
    return replace(finding, text=finding.text.replace(" is always lost ", partly)) if partial else finding


def _cause(finding: Finding) -> tuple[str, str]:
    """What makes two findings of different deliveries the same one."""
    if finding.kind in FAILING:
        kind = "never" if finding.kind == "never" else "wait"
        return (kind, repr([place.element for place in finding.places] + [finding.accepted]))
    if finding.kind in ("always-lost", "unneeded", "growth", "fault"):
        return (finding.kind, finding.text)
    return (finding.kind, repr([place.element for place in finding.places]))


def _rank(finding: Finding) -> tuple[int, bool]:
    """Of the same findings of several deliveries the worst has the lowest rank, then one that leaves robots waiting."""
    return LEVELS.index(finding.level), not finding.robots


def merged_verdicts(judged: Iterable[Sequence[Judged]]) -> Iterator[Judged]:
    """Yield what is known of each property after searches, of each of which `judged` has its verdicts.

    Refuted if one search refutes it, not known unless all tell; proved, if one has seen something to judge.
    """
    for verdicts in zip(*judged, strict=True):
        worst = min(verdicts, key=lambda verdict: PROOFS.index(verdict.verdict))
        if worst.verdict == "not triggered":
            worst = next((verdict for verdict in verdicts if verdict.verdict == "proved"), worst)
        yield worst
