"""Asserts that the part of a pool reads as its processes do in their files.

A robot must run what was drawn, and what is lost on the way would be lost in silence. What splitting writes on purpose
is expected: new ids where several files use one, the types and deliveries of topics, the ids of called processes,
linked forms, and which process is executable.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

from fame.bpmn.difference import Comparison, elements_of
from fame.bpmn.linked_forms import form_of, linked_form
from fame.bpmn.model import CallActivity, Definitions, Human, Process, Topic
from fame.bpmn.topics import TTL
from fame.errors import ModelError


@dataclass(frozen=True, slots=True)
class Original:
    """Processes of a file that became part of another. `ids`: old id -> new id. `calls`: called element -> new id."""

    file: Definitions
    processes: Collection[Process]
    ids: Mapping[str, str]
    calls: Mapping[str, str]


def assert_same_reading(part: Definitions, original: Original, types: Mapping[str, str], ttl: Collection[str]) -> None:
    """Raise ModelError for the first element that reads differently in a part.

    `types` maps the qualified topics of the collaboration to types; those of `ttl` are acknowledged.
    """
    comparison = Comparison(original.ids, _Expected(original.file, original.calls, types, ttl), ("executable",))
    for process in original.processes:
        copy = part.process(original.ids.get(process.id, process.id))
        pairs = zip_longest(elements_of(process), elements_of(copy) if copy is not None else ())
        for before, now in pairs:
            if before is None:
                raise _fault(original.file, now[1], "it is not there in the whole model")
            problems = ["it is missing"] if now is None else _problems(before, now, comparison)
            for problem in problems:
                raise _fault(original.file, before[1], problem)
        if copy is not None and len(process.faults) != len(copy.faults):
            raise _fault(original.file, process, "its faults differ")


def _problems(before: tuple[str, Any], now: tuple[str, Any], comparison: Comparison) -> Iterator[str]:
    (inner, old), (there, new) = before, now
    ids = comparison.ids
    if type(old) is not type(new) or new.id not in (old.id, ids.get(old.id)) or there not in (inner, ids.get(inner)):
        yield f"{new.display_name} is in its place"
    for name in comparison.fields(old, new):
        if name != "name" or old.id == new.id:  # one that is told apart by its id keeps that as its name
            yield f"{name.replace('_', ' ')} would differ"


def _fault(file: Definitions, element: Any, problem: str) -> ModelError:
    text = f"its part cannot be split off, {problem}: please report this file, it is a fault of FAME"
    return ModelError.at(element, text, file=file.file)


@dataclass(frozen=True, slots=True)
class _Expected:
    """What splitting makes of a value."""

    file: Definitions
    calls: Mapping[str, str]
    types: Mapping[str, str]
    acknowledged: Collection[str]

    def __call__(self, value: Any) -> Any:
        match value:
            case Topic():
                ttl = TTL if value.qualified in self.acknowledged and not value.ttl else value.ttl
                return replace(value, type=value.type or self.types.get(value.qualified), ttl=ttl)
            case CallActivity():
                return replace(value, called=self.calls.get(value.called, value.called))
            case Human() if linked_form(self.file, value.linked):
                return replace(value, form=form_of(self.file, value), linked="")
            case _:
                return value
