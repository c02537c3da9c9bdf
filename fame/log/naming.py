"""What logs call the elements of a model."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fame.bpmn.model import Activity, Definitions, Element, Event as BpmnEvent, Gateway, SubProcess, Task


class Named(NamedTuple):
    """What a log says of an element: its name on one line, its BPMN tag, and whether it is an activity."""

    name: str
    kind: str
    activity: bool


UNNAMED = Named("", "", False)


def names(files: Iterable[Definitions]) -> dict[str, Named]:
    """What to call every process, flow node and sequence flow, by id; of equal ids the first counts."""
    found: dict[str, Named] = {}
    for process in (process for file in files for process in file.processes):
        inner = (node.body for node in process.body.walk() if isinstance(node, SubProcess))
        parts = [part for body in (process.body, *inner) for part in (*body.nodes, *body.flows)]
        for element in (process, *parts):
            found.setdefault(
                element.id, Named(" ".join(element.name.split()), kind(element), isinstance(element, Activity))
            )
    return found


def kind(element: Element) -> str:
    """What an element is, by its BPMN tag: ``callActivity``, ``startEvent`` ..."""
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
