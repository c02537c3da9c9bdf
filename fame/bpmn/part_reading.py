"""Asserts that the part of a pool reads as its processes do in their files.

A robot must run what was drawn, and what is lost on the way would be lost in silence. What splitting writes on purpose
is expected: new ids where several files use one, the types and deliveries of topics, the ids of called processes,
linked forms, and which process is executable.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import zip_longest
from typing import Any

from fame.bpmn.difference import ElementComparison, elements_of
from fame.bpmn.linked_forms import form_of, linked_form
from fame.bpmn.model import CallActivity, Definitions, Element, Human, Process, Topic
from fame.bpmn.topics import TTL
from fame.dataclasses import dataclass, replace
from fame.errors import ModelError


@dataclass(frozen=True, slots=True)
class Original:
    """Processes of a file that became part of another.

    ids, calls           old id -> new id; called element -> new id of the process
    types, acknowledged  qualified topic -> type; the topics whose signals are acknowledged
    """

    file: Definitions
    processes: Collection[Process]
    ids: Mapping[str, str]
    calls: Mapping[str, str]
    types: Mapping[str, str]
    acknowledged: Collection[str]

    def expected(self, value: Any) -> Any:
        """Return what splitting makes of a value of the model."""
        match value:
            case Topic():
                ttl = value.ttl or TTL * (value.qualified in self.acknowledged)
                return replace(value, type=value.type or self.types.get(value.qualified), ttl=ttl)
            case CallActivity():
                return replace(value, called=self.calls.get(value.called, value.called))
            case Human() if linked_form(self.file, value.linked):
                return replace(value, form=form_of(self.file, value), linked="")
            case _:
                return value


def assert_same_reading(part: Definitions, original: Original) -> None:
    """Raise ModelError for the first element that reads differently in a part."""
    comparison = ElementComparison(original.ids, original.expected, ("executable",))
    for process in original.processes:
        copy = part.process(original.ids[process.id])
        pairs = zip_longest(
            elements_of(process), elements_of(copy) if copy is not None else (), fillvalue=("", process)
        )
        for before, now in pairs:
            for problem in _problems(before, now, comparison):
                text = f"its part cannot be split off, {problem}: please report this file, it is a fault of FAME"
                raise ModelError.at(before[1], text, file=original.file.file)


def _problems(before: tuple[str, Element], now: tuple[str, Element], comparison: ElementComparison) -> Iterator[str]:
    (inner, old), (there, new), ids = before, now, comparison.ids
    if type(old) is not type(new) or new.id not in (old.id, ids.get(old.id)) or there not in (inner, ids.get(inner)):
        yield f"{new.display_name} is in its place"
    for name in comparison.fields(old, new):
        if name != "name" or old.id == new.id:  # one that is told apart by its id keeps that as its name
            yield f"{name.replace('_', ' ')} would differ"
    if isinstance(old, Process) and isinstance(new, Process) and len(old.faults) != len(new.faults):
        yield "its faults would differ"
