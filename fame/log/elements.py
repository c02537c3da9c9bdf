"""Names and kinds of the elements that a log mentions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fame.bpmn.model import Activity, Definitions, Element, Event as BpmnEvent, Gateway, SubProcess, Task


class ElementInfo(NamedTuple):
    """The name of an element (on one line), its BPMN tag, and whether it is an activity."""

    name: str
    tag: str
    activity: bool


UNKNOWN: ElementInfo = ElementInfo("", "", False)


def element_info(files: Iterable[Definitions]) -> dict[str, ElementInfo]:
    """All processes, flow nodes and sequence flows by id. The first of several elements with one id counts."""
    found: dict[str, ElementInfo] = {}
    for process in (process for file in files for process in file.processes):
        inner = (node.body for node in process.body.walk() if isinstance(node, SubProcess))
        parts = [part for body in (process.body, *inner) for part in (*body.nodes, *body.flows)]
        for element in (process, *parts):
            found.setdefault(
                element.id, ElementInfo(" ".join(element.name.split()), tag_of(element), isinstance(element, Activity))
            )
    return found


def tag_of(element: Element) -> str:
    """The BPMN tag of an element: ``callActivity``, ``startEvent`` ..."""
    match element:
        case Task(kind=which):
            return {"plain": "task", "business_rule": "businessRuleTask"}.get(which, f"{which}Task")
        case BpmnEvent(place="catch" | "throw" as place):
            return f"intermediate{place.title()}Event"
        case BpmnEvent(place=place):
            return f"{place}Event"
        case Gateway(kind=which):
            return {"event": "eventBasedGateway"}.get(which, f"{which}Gateway")
        case SubProcess(kind=which):
            return {"transaction": "transaction", "adhoc": "adHocSubProcess"}.get(which, "subProcess")
    tag = type(element).__name__
    return tag[0].lower() + tag[1:]
