"""Keeps the meaning of names whose namespace is declared elsewhere, while elements move between documents.

libxml2 renames a moved element by its namespace, and drops declarations that the new place has too. Two kinds of
names do not survive this: those in values of ``xsi:type``, which it does not know, and those of elements that declare
their namespaces anew (``<q1:script xmlns="" ...>``, as .NET writes), whose new prefix may mean something else there.
Values of ``xsi:type`` are therefore in the form ``{uri}name`` between `expand_types` and `contract_types`.
"""

from __future__ import annotations

from collections.abc import Iterable

from fame.bpmn.reader.xml import BPMN, Node, attributes

XSI = "http://www.w3.org/2001/XMLSchema-instance"
_TYPE = f"{{{XSI}}}type"
_B = f"{{{BPMN}}}"


def expand_types(root: Node) -> None:
    """Replace the prefixes in values of ``xsi:type`` by namespaces. A BPMN element without one means that of BPMN."""
    for element in root.iter("*"):
        value = element.get(_TYPE)
        if value is not None and not value.startswith("{"):
            prefix, _, name = value.strip().rpartition(":")
            uri = element.nsmap.get(prefix or None) or (BPMN if element.tag.startswith(_B) else "")
            if uri:
                element.set(_TYPE, f"{{{uri}}}{name}")


def contract_types(root: Node) -> None:
    """Undo `expand_types`, with the prefixes that hold in the new place."""
    for element in root.iter("*"):
        uri, end, name = element.get(_TYPE, "").partition("}")
        if end:
            prefix = {known: prefix for prefix, known in element.nsmap.items()}.get(uri[1:])
            element.set(_TYPE, f"{prefix}:{name}" if prefix else name)


def add_prefixes(known: dict[str | None, str], parts: Iterable[Node]) -> None:
    """Add prefixes for the namespaces that parts of a document declare or that their types name.

    All are there, since values that FAME does not know may use them; but .NET declares that of BPMN with each element.
    """
    elements = [element for part in parts for element in part.iter("*")]
    for element in elements:
        for prefix, uri in element.nsmap.items():
            if prefix and uri and uri != BPMN:
                known.setdefault(prefix, uri)
    types = {element.get(_TYPE, "").partition("}")[0][1:] for element in elements if _TYPE in element.attrib}
    for number, uri in enumerate(sorted(types - {"", BPMN, *known.values()})):
        known[f"type{number}"] = uri


def repair_prefixes(root: Node) -> None:
    """Give elements and attributes that were moved a prefix which means their namespace where they are now."""
    for element in root.iter("*"):
        namespace = element.tag[1:].partition("}")[0] if element.tag.startswith("{") else ""
        around = element.getparent()
        known = element.nsmap
        if (known.get(element.prefix) or "") != namespace:
            element.tag = element.tag
        if (around is None or known != around.nsmap) and any(name[:1] == "{" for name in attributes(element)):
            values = element.attrib.items()
            element.attrib.clear()
            for name, value in values:
                element.set(name, value)
