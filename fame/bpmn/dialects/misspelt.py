"""Namespaces that are nearly one that is read: what stands in them would be passed over in silence."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from fame.bpmn.context import Context
from fame.bpmn.xml import BPMN, BPMNDI, DC, DI, Node, attributes

_DECLARED = re.compile(rb"""xmlns(?::[\w.-]+)?\s*=\s*["']([^"']+)["']""")
_OTHERS = {
    BPMNDI, DC, DI, "http://camunda.org/schema/modeler/1.0", "http://camunda.org/schema/1.0/dmn",
    "http://www.w3.org/2001/XMLSchema", "http://www.w3.org/2001/XMLSchema-instance",
}  # fmt: skip
"""Alike, and meant."""
_NEAR = 0.9
"""Part of the letters that two names share; fewer are another name."""


def note_misspelt(context: Context, root: Node, source: bytes, known: Iterable[str]) -> None:
    """One warning for each namespace that something in the file is of, and that looks like a `known` one."""
    names = {_bare(uri): uri for uri in (*known, BPMN)}
    declared = {found.decode(errors="replace") for found in _DECLARED.findall(source.replace(b"\0", b""))}
    for uri in sorted(declared - _OTHERS - set(names.values())):
        near = get_close_matches(_bare(uri), names, n=1, cutoff=_NEAR)
        first = next((one for one in root.iter("*") if near and _is_of(one, uri)), None)
        if first is not None:
            text = f"elements of namespace {uri} are not read; did you mean {names[near[0]]}?"
            context.note(first, text, "warning")


def _bare(uri: str) -> str:
    """Without what is often written in another way."""
    return re.sub(r"^https?:/*(www\.)?|[/#\s]+$", "", uri.strip().lower())


def _is_of(element: Node, uri: str) -> bool:
    beginning = f"{{{uri}}}"
    return element.tag.startswith(beginning) or any(key.startswith(beginning) for key in attributes(element))
