"""The result of an exploration: what was searched, and what is known after it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from fame.check.explore.findings import Finding
from fame.check.explore.product import Delivery
from fame.check.explore.properties import Judged
from fame.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Searched:
    """One search.

    cuts      why not all states were found
    left_out  what was not looked into for findings, since the time was over
    bound     a limit of states or time has ended it, or it did not begin
    """

    delivery: Delivery
    states: int
    transitions: int
    seconds: float
    cuts: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    bound: bool = False
    faults: tuple[tuple[str, str, str], ...] = ()
    judged: tuple[Judged, ...] = ()


@dataclass(frozen=True, slots=True)
class Exploration:
    """The result of `explore_team` or `explore_from`.

    file        the model
    robots      robot -> pool
    findings    what was found, the worst first; each once, with the first delivery that shows it
    searches    one for each delivery
    local       robot -> number of its local states
    outside     topics on which anything may come from outside of the team
    shortened   elements that take lists or numbers that are not known, of which few are tried: (robot, element)
    midway      scripts that publish before they end, which is explored when they end: (robot, element)
    widened     variables that have too many values, and so are unknown from some time on: (robot, name)
    seconds     of all searches (wall clock)
    sampled     what was explored besides, because a limit ended a search
    properties  what is known of each property, in all deliveries
    steps       (file, id) of the calls that were taken for one step each
    """

    file: str
    robots: Mapping[str, str]
    findings: tuple[Finding, ...]
    searches: tuple[Searched, ...]
    local: Mapping[str, int]
    outside: tuple[str, ...]
    seconds: float
    shortened: tuple[tuple[str, str], ...] = ()
    midway: tuple[tuple[str, str], ...] = ()
    widened: tuple[tuple[str, str], ...] = ()
    sampled: tuple[str, ...] = ()
    properties: tuple[Judged, ...] = ()
    steps: tuple[tuple[str, str], ...] = ()

    @property
    def exhaustive(self) -> bool:
        """Whether all states were found and looked into, in every delivery that was asked for."""
        return not any(search.cuts or search.left_out for search in self.searches)

    @property
    def cuts(self) -> tuple[str, ...]:
        """Why it is not exhaustive."""
        return tuple(dict.fromkeys(cut for search in self.searches for cut in (*search.cuts, *search.left_out)))

    @property
    def status(self) -> Literal["completed", "partial", "failed"]:
        """``failed`` after an error that is not accepted, or if a property is refuted.

        ``partial``: neither, but not all was explored, or it is not known whether a property holds.
        """
        known = self.exhaustive and all(judged.verdict != "not known" for judged in self.properties)
        return "failed" if self.failed else "completed" if known else "partial"

    @property
    def failed(self) -> bool:
        """Whether an error was found, and not accepted, or a property is refuted."""
        refuted = any(judged.verdict == "refuted" for judged in self.properties)
        return refuted or any(finding.level == "error" for finding in self.findings)

    def partly(self) -> str:
        """Return what is known if no error was found, but not all is known."""
        if self.exhaustive:
            names = [judged.name for judged in self.properties if judged.verdict == "not known"]
            return f"no error found, but it is not known whether {', '.join(names)} may be violated"
        return f"no error found in a partial search ({self.states:,} of unknown)"

    @property
    def states(self) -> int:
        """States of all searches."""
        return sum(search.states for search in self.searches)

    def summary(self) -> str:
        """Return the first line of a report."""
        spent = f"{self.states} states in {self.seconds:.1f} s"
        modes = " and ".join(search.delivery for search in self.searches)
        modes += ", only the order of fame run" if modes == "run" else ""
        if self.exhaustive:
            return f"{self.file}: all states explored ({', '.join(self.robots)}; delivery {modes}): {spent}"
        done = "states explored" if any(search.cuts for search in self.searches) else "findings made"
        return f"{self.file}: NOT all {done} ({', '.join(self.cuts)}; delivery {modes}): {spent}"
