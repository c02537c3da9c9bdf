"""Ids that fall together when files are put together, and how they are told apart: by a number behind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fame.bpmn.context import find
from fame.bpmn.xml import BPMN, Node, text_of

_B = f"{{{BPMN}}}"


def unique_ids(elements: Iterable[Node], taken: set[str]) -> dict[str, str]:
    """Give ids that are taken a number, wherever the elements use them. Those that they have now are taken too.

    Returns the new ones by the old.
    """
    elements = list(elements)
    renamed: dict[str, str] = {}
    own = {id for one in elements if (id := one.get("id"))}
    for id in sorted(own & taken):
        number = 2
        while f"{id}_{number}" in taken | own:
            number += 1
        renamed[id] = f"{id}_{number}"
    taken |= own | set(renamed.values())
    for element in elements if renamed else ():
        _rename(element, renamed)
    return renamed


def is_reference(name: str) -> bool:
    """Whether an attribute of that name holds an id."""
    return name in ("default", "bpmnElement") or name.endswith("Ref")


def _rename(element: Node, renamed: Mapping[str, str]) -> None:
    for name, value in element.items():
        new = find(renamed, str(value)) if name == "id" or is_reference(str(name)) else None
        if new is not None:
            element.set(name, new)
    if element.tag.endswith(("Ref", "Refs")) or element.tag in (f"{_B}incoming", f"{_B}outgoing"):
        element.text = find(renamed, text_of(element)) or element.text
