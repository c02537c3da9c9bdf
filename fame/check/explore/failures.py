"""With which error codes scripts, services and behaviours fail, and which of these failures nothing catches.

An exploration tries each code by itself, so only codes that make a difference are tried by name: those that an error
event of the team catches, or a property names. One further code stands for all others. Where an error event of any code
is at the activity or around it, a failure is an ordinary outcome. Otherwise it is *unhandled*: reported, but explored
only with single faults, and to judge properties.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set

from fame.bpmn import model
from fame.bpmn.library import Library
from fame.check.explore.error_codes import (
    boundary_codes,
    computes_code,
    service_codes,
    step_codes,
    thrown_by,
)
from fame.check.explore.slicing import may_fail
from fame.check.explore.team_facts import TeamFacts
from fame.check.explore.values import MARK
from fame.dataclasses import dataclass, field
from fame.scripting.effects import script_effects


@dataclass(frozen=True, slots=True)
class Guarded:
    """A body, and what is around it.

    inside  an error event is around it: at a sub-process, in one, or perhaps at a call; of which code, is not asked
    hosts   its activities with an error event of their own
    """

    body: model.Body
    inside: bool
    hosts: frozenset[str]

    def __contains__(self, node: model.FlowNode) -> bool:
        """Return whether an error event is at an element, or around it."""
        return self.inside or node.id in self.hosts


@dataclass(frozen=True, slots=True)
class Failures:
    """The codes of failures.

    unhandled  (element, code) of those so far that nothing catches
    supposed   calls that fail with `script` only because a script inside may raise something
    """

    library: Library
    facts: TeamFacts
    unhandled: set[tuple[str, str]] = field(default_factory=set)
    supposed: set[str] = field(default_factory=set)

    def any_is_caught(self, node: model.Activity, guarded: Guarded) -> bool:
        """Return whether an error event of any code is at an element, or around it."""
        return "" in self.facts.catches and (guarded.inside or None in boundary_codes(node, guarded.body))

    def exceptions_are_caught(self, task: model.Activity, guarded: Guarded) -> bool:
        """Return whether an error event may catch what a script raises otherwise than with a code."""
        return self.any_is_caught(task, guarded) or ("script" in self.facts.catches and task in guarded)

    def of_script(self, task: model.Task, guarded: Guarded) -> set[str]:
        """Return the codes with which the actions and services of a script fail, as those of a service task do."""
        asked = {*script_effects(task).asked}
        codes = asked & self.facts.catches
        named = (asked & self.facts.named) - codes
        if asked and self.any_is_caught(task, guarded):
            return codes | named | {min(asked)}
        return codes | self._unhandled(task, asked - codes - {"canceled"}, named)

    def of_service(self, task: model.Task, guarded: Guarded) -> set[str]:
        """Return the codes with which a service or action may fail."""
        at_boundary = {code for code in boundary_codes(task, guarded.body) if code and code != "script"}
        codes = at_boundary | service_codes(task, self.facts.catches)
        named = service_codes(task, self.facts.named) - codes
        if self.any_is_caught(task, guarded):
            return codes | named | {"service" if task.service is not None else "script"}
        return codes | self._unhandled(task, service_codes(task, None) - codes, named)

    def of_call(
        self, call: model.CallActivity, called: tuple[model.Definitions, model.Process],
        processes: Sequence[model.Process], guarded: Guarded, mismatch: str,
    ) -> tuple[str, ...]:  # fmt: skip
        """Return the codes with which a behaviour may fail: its own, and those of services and work inside.

        processes  the called process and all that it calls
        mismatch   a text of its mapping that may fail by itself, or an empty text
        """
        thrown = thrown_by(self.library, *called, self.facts.catches)
        codes = step_codes(call, thrown, guarded.body)
        # None: perhaps any code
        for_properties = self.facts.named if thrown is None else thrown_by(self.library, *called, self.facts.named)
        named = (for_properties or frozenset()) - codes
        inside = [node for process in processes for node in process.body.walk()]
        at_work, supposed = _codes_at_work(inside), set[str]()
        if "script" not in codes | at_work:
            risky = bool(mismatch) or any(node.script is not None and may_fail(node.script) for node in inside)
            supposed = {"script"} if risky else set()
            self.supposed.update(call.id for _ in supposed)
        if self.any_is_caught(call, guarded):
            return in_order((codes or at_work) | supposed) + in_order(named)
        computed = thrown is None and any(map(computes_code, inside))  # then MARK: a code of which nothing is known
        every = at_work
        if "service" in at_work:
            every = step_codes(call, thrown_by(self.library, *called, None), guarded.body)
        others = every - codes or ({MARK} if computed else at_work - codes)
        return in_order(codes | supposed) + in_order(self._unhandled(call, others, named))

    def _unhandled(self, node: model.Activity, codes: Set[str], named: Set[str]) -> set[str]:
        """Note one of the codes that nothing catches, which stands for all of them, and those that properties name."""
        example = sorted(codes, key=lambda code: (code != "service", code))[:1]
        self.unhandled.update((node.id, code) for code in (*example, *named))
        return {*example, *named}


def _codes_at_work(nodes: Sequence[model.FlowNode]) -> set[str]:
    """The code that stands for failures of services and actions; without such for those of functions and workers."""
    if any(node.service is not None or script_effects(node).asked for node in nodes):
        return {"service"}
    return {"script"} if any(node.operation for node in nodes) else set()


def in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Return names in an order that is the same in each run."""
    return tuple(sorted(names))
