"""What is checked: the processes of a file and all that they call, and who calls whom."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from fame.bpmn.library import Library
from fame.bpmn.model import Body, CallActivity, Definitions, Element, Process, SubProcess
from fame.check.findings import Finding, Level
from fame.errors import ModelError


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """A process, and the file that it stands in. `calls`: each call activity, and what it calls if that was found."""

    home: Definitions
    process: Process
    calls: list[tuple[CallActivity, Unit | None]] = field(default_factory=list)

    def finding(self, level: Level, text: str, element: Element, line: int = 0) -> Finding:
        """A finding at an element of it; `line` if it is another one than that of the element."""
        return Finding(level, text, self.home.file, line or element.line, element.id)

    def bodies(self) -> Iterator[Body]:
        """Its body, and those of its sub-processes at any depth."""
        yield self.process.body
        yield from (node.body for node in self.process.body.walk() if isinstance(node, SubProcess))

    def closure(self) -> list[Unit]:
        """It, and all that it calls, each once, in the order of meeting."""
        found = {self: None}
        pending = [self]
        for unit in pending:
            new = [callee for _, callee in unit.calls if callee is not None and callee not in found]
            found |= dict.fromkeys(new)
            pending += dict.fromkeys(new)
        return list(found)


@dataclass(frozen=True, slots=True)
class Subject:
    """All units: those of the file first, then what they call.

    pools    the processes that a pool of the file has: they get their variables from nowhere else
    roots    what begins by itself: the processes of pools, and those that nobody in the file calls
    missing  why calls lead nowhere
    """

    definitions: Definitions
    units: tuple[Unit, ...]
    roots: tuple[Unit, ...]
    pools: frozenset[str]
    missing: tuple[ModelError, ...]

    def has_pool(self, unit: Unit) -> bool:
        """Whether a pool of the file has this process."""
        return unit.home is self.definitions and unit.process.id in self.pools

    def called(self) -> set[Unit]:
        """The units that some unit calls."""
        return {callee for unit in self.units for _, callee in unit.calls if callee is not None}


def subject(definitions: Definitions, library: Library) -> Subject:
    """Find all that is to be checked."""
    own = [Unit(definitions, process) for process in definitions.processes]
    units = {_key(unit): unit for unit in own}
    missing: list[ModelError] = []
    pending = list(own)
    for unit in pending:
        for call in unit.process.body.walk():
            if isinstance(call, CallActivity):
                callee = _callee(unit, call, library, units, missing)
                unit.calls.append((call, callee))
                if callee is not None and callee not in pending:
                    pending.append(callee)
    pools = frozenset(pool.process for pool in definitions.participants if pool.process)
    return Subject(definitions, tuple(pending), tuple(_roots(own, pools)), pools, tuple(missing))


def _key(unit: Unit) -> tuple[str, str]:
    return unit.home.file, unit.process.id


def _callee(
    unit: Unit, call: CallActivity, library: Library, units: dict[tuple[str, str], Unit], missing: list[ModelError]
) -> Unit | None:
    try:
        home, process = library.find(unit.home, call)
    except ModelError as error:
        missing.append(error)
        return None
    callee = Unit(home, process)
    return units.setdefault(_key(callee), callee)


def _roots(own: list[Unit], pools: frozenset[str]) -> Iterator[Unit]:
    """The processes of pools; those that no other one calls; of a circle of calls the first."""
    called = {callee for unit in own for _, callee in unit.calls if callee is not unit}
    covered: set[Unit] = set()
    for unit in sorted(own, key=lambda one: (one.process.id not in pools, one in called)):
        if unit.process.id in pools or unit not in covered:
            covered.update(unit.closure())
            yield unit
