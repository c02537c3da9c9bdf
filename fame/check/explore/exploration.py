"""Explore a team's reachable states, and say what is known after it.

Theory of operation. A `Team` has the abstract processes of its robots, and computes the transitions of each of them by
the engine. Then, within one budget of states and time:

1. For each way of delivery, all states of the team are searched (`deliveries`). Findings are merged by their cause
   (`merging`), since one mistake shows in several searches.
2. Proofs of properties are tried once more with services and scripts that fail where nothing catches it.
3. If a limit has ended a search, some parts are explored besides (`samples`): they may add errors, and prove nothing.

Whatever was not searched whole makes verdicts "not known": no element is unreachable then, no signal is always lost.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.check.explore.abstraction import STEP
from fame.check.explore.deliveries import SearchBudget, after_failures, search
from fame.check.explore.findings import FindingKind
from fame.check.explore.merging import MergedFindings, merged_verdicts
from fame.check.explore.product import Delivery
from fame.check.explore.properties import Judged
from fame.check.explore.request import Request
from fame.check.explore.result import Exploration, Searched
from fame.check.explore.samples import samples
from fame.check.explore.team import Team
from fame.dataclasses import dataclass, field, replace
from fame.engine.encoding import Data

SEARCHING, FINDING = 0.7, 0.85
"""Shares of the time after which a search ends, and the making of its findings, so that some is left for samples."""
OF_WHOLE_MISSIONS: tuple[FindingKind, ...] = ("always-lost", "outside", "unneeded", "unstarted", "unreachable")
"""Kinds of findings that mean nothing if a mission is explored from its middle."""


def explore_team(definitions: Definitions, library: Library, cast: Mapping[str, Pool], request: Request) -> Exploration:
    """Explore the robots of `cast` (robot -> pool).

    Raises ModelError for a model that cannot be compiled, ConfigError for a limit below 1 or no delivery.
    """
    begun = time.perf_counter()
    request.expect_valid()
    return _Searches(Team(definitions, library, cast, request), begun).explore()


def explore_from(
    definitions: Definitions,
    library: Library,
    cast: Mapping[str, Pool],
    snapshots: Mapping[str, Data],
    request: Request,
) -> Exploration:
    """Explore what may follow from the states that robots are in, not from their starts.

    snapshots  robot -> what `fame.engine.snapshot` gave of its engine, in the program of this model (perhaps by
               `fame.engine.migration.migrate`), with values written by `fame.robot.stored_values.dump`. What is held
               goes on, what a migrated state lacks is armed. Robots without one start.

    No message is under way in the beginning, and of pending timers no times are known: they fire in any order. A
    behaviour that is being called may end at any time. Only findings about what happens from there on are given, not
    about signals or elements of the part that is over.

    Raises ModelError for a model that cannot be compiled, MissionError for a snapshot of another model, ConfigError for
    a limit below 1 or no delivery.
    """
    begun = time.perf_counter()
    request.expect_valid()
    explored = _Searches(Team(definitions, library, cast, request, snapshots), begun).explore()
    ahead = tuple(finding for finding in explored.findings if finding.kind not in OF_WHOLE_MISSIONS)
    return replace(explored, findings=ahead)


@dataclass(slots=True)
class _Searches:
    """All searches of a team, which share its budget. `begun`: when its time began, s of `time.perf_counter`."""

    team: Team
    begun: float
    budget: SearchBudget = field(init=False)
    searched: list[Searched] = field(default_factory=list)
    findings: MergedFindings = field(default_factory=MergedFindings)
    sampled: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.budget = SearchBudget(self.team.request.limit, self._over, lambda: self._over(FINDING))

    def explore(self) -> Exploration:
        request = self.team.request
        if request.first and request.samples:
            self._sample(1 - SEARCHING)
        for delivery in request.delivery:
            self._search(delivery)
        # After all deliveries: an element that is only entered after a failure must not count as reached by them.
        self.searched = [after_failures(self.team, searched, self.budget) for searched in self.searched]
        if request.samples and not request.first and any(searched.bound for searched in self.searched):
            self._sample(1.0)
        return self._result()

    def _over(self, share: float = SEARCHING) -> bool:
        """Whether a share of the time is over."""
        seconds = self.team.request.seconds
        return seconds is not None and time.perf_counter() - self.begun > share * seconds

    @property
    def _ended(self) -> bool:
        """Whether a first error has ended it all."""
        return self.team.request.first and self.findings.failed

    def _search(self, delivery: Delivery) -> None:
        if self._ended or self.budget.left <= 0 or self._over():
            why = "ended at the first error" if self._ended else f"no budget is left for delivery {delivery}"
            properties = self.team.request.properties
            unknown = tuple(Judged(spec.name, spec.sentence, "not known", why) for spec in properties)
            self.searched.append(Searched(delivery, 0, 0, 0.0, (why,), bound=True, judged=unknown))
            return
        searched, findings = search(self.team, delivery, self.budget)
        self.searched.append(searched)
        self.findings.add_search(findings)

    def _sample(self, share: float) -> None:
        """Explore samples until a share of the time is over."""
        for name, findings in samples(self.team, lambda: self._over(share)):
            self.findings.add_sampled(findings)
            self.sampled.append(name)
            if self._ended:
                return

    def _result(self) -> Exploration:
        team, local_parts = self.team, tuple(dict.fromkeys(self.team.locals))
        partial = any(searched.cuts for searched in self.searched)
        return Exploration(
            file=team.definitions.file,
            robots={robot: pool.name for robot, pool in team.cast.items()},
            findings=self.findings.of_all(team.received, partial=partial),
            searches=tuple(self.searched),
            local={local.robot: len(local) for local in local_parts},
            outside=tuple(sorted({topic for local in team.locals for topic in local.outside} - team.watched)),
            seconds=time.perf_counter() - self.begun,
            sampled=tuple(self.sampled),
            properties=tuple(merged_verdicts(searched.judged for searched in self.searched)),
            steps=tuple(_call_of(step) for step in sorted(team.model.steps)),
            shortened=tuple((one.robot, name) for one in local_parts for name in sorted(one.host.shortened)),
            midway=tuple((one.robot, name) for one in local_parts for name in sorted(one.host.midway)),
            widened=tuple((local.robot, name) for local in local_parts for name in sorted(local.states.widened)),
        )


def _call_of(step: str) -> tuple[str, str]:
    """The file and the id of the call in the name of a step."""
    file, _, element = step.removeprefix(STEP).rpartition(" ")
    return file, element
