"""Names and kinds of the elements that a log mentions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fame.bpmn.model import Activity, Definitions


class ElementInfo(NamedTuple):
    """The name of an element (on one line), its BPMN tag, and whether it is an activity."""

    name: str
    tag: str
    activity: bool


UNKNOWN: ElementInfo = ElementInfo("", "", False)


def element_info(files: Iterable[Definitions]) -> dict[str, ElementInfo]:
    """Return all processes, flow nodes and sequence flows by id. The first of several elements with one id counts."""
    found: dict[str, ElementInfo] = {}
    for process in (process for file in files for process in file.processes):
        parts = [part for body in process.body.bodies() for part in (*body.nodes, *body.flows)]
        for element in (process, *parts):
            name = " ".join(element.name.split())
            found.setdefault(element.id, ElementInfo(name, element.tag, isinstance(element, Activity)))
    return found
