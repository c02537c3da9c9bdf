"""The elements of a team's models, and which findings they accept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Element
from fame.bpmn.pools import Pool, all_processes
from fame.check.explore.findings import KINDS
from fame.check.explore.trace import Place
from fame.errors import ModelError


def elements_of(
    definitions: Definitions, pools: Sequence[Pool], library: Library
) -> Iterator[tuple[Definitions, Element]]:
    """Yield (file, element) of all processes that pools run, the process before its elements."""
    for home, process in all_processes(definitions, pools, library):
        yield home, process
        yield from ((home, element) for element in process.body.elements())


def places_of(definitions: Definitions, pools: Sequence[Pool], library: Library) -> dict[str, Place]:
    """Return where each element is, by its id."""
    return {element.id: Place(element.id, home.file, element.line, element.name)
            for home, element in elements_of(definitions, pools, library)}  # fmt: skip


def accepted(definitions: Definitions, pools: Sequence[Pool], library: Library) -> dict[str, dict[str, str]]:
    """Element or process -> the kinds of findings that it accepts, and why. Raises ModelError for an unknown kind."""
    accepts: dict[str, dict[str, str]] = {}
    for home, element in elements_of(definitions, pools, library):
        for line in filter(str.strip, element.properties.get("accept", "").split(";")):
            kind, _, reason = (part.strip() for part in line.partition(":"))
            if kind not in KINDS:
                text = f"accept: expected KIND: REASON, where KIND is one of {', '.join(KINDS)}; got {line.strip()!r}"
                raise ModelError.at(element, text, file=home.file)
            accepts.setdefault(element.id, {})[kind] = reason or "in the model"
    return accepts
