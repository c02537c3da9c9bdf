"""Dialects: what vendors' extension elements mean, in one dialect-neutral form (`extensions.Extensions`).

Each adapter is a function of (context, extension element, extensions so far) that adds the meaning of the element to
the extensions, and one of (context, element, attribute, value, extensions) where the dialect has attributes. The
namespace of an element selects its adapter, so a file may mix dialects. What no adapter knows stays in the file and has
no effect.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import cast

from lxml.etree import XPath

from fame.bpmn.reader.context import Context
from fame.bpmn.reader.dialects import camunda7, camunda8, original_fame
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import ACTIVITI, BPMN, BPMNDI, CAMUNDA, DC, DI, FLOWABLE, ZEEBE, Node, attributes

ElementAdapter = Callable[[Context, Node, Extensions], None]
AttributeAdapter = Callable[[Context, Node, str, str, Extensions], None]

ELEMENT_ADAPTERS: Mapping[str, ElementAdapter] = {
    **dict.fromkeys((CAMUNDA, FLOWABLE, ACTIVITI), camunda7.element),
    ZEEBE: camunda8.element,
    **dict.fromkeys(original_fame.NAMESPACES, original_fame.element),
}
ATTRIBUTE_ADAPTERS: Mapping[str, AttributeAdapter] = {
    **dict.fromkeys((CAMUNDA, FLOWABLE, ACTIVITI), camunda7.attribute),
    ZEEBE: camunda8.attribute,
}

_JAVASCRIPT = ("javascript", "js")
_LANGUAGES = XPath("//@scriptFormat | //*[not(@scriptFormat)]/@language", smart_strings=False)
_EXTENSION_ELEMENTS = f"{{{BPMN}}}extensionElements"


def read_extensions(context: Context, element: Node) -> Extensions:
    """Return the extensions of a BPMN element: those of its attributes and extension elements."""
    extensions = Extensions()
    for key in attributes(element):
        if key[0] == "{":
            namespace, _, name = key[1:].partition("}")
            read_attribute = ATTRIBUTE_ADAPTERS.get(namespace)
            if read_attribute is not None:
                read_attribute(context, element, name, element.get(key, ""), extensions)
    for holder in element.iterchildren(_EXTENSION_ELEMENTS):
        for extension in holder:
            namespace = extension.tag[1:].partition("}")[0]
            read_element = ELEMENT_ADAPTERS.get(namespace)
            if read_element is not None:
                read_element(context, extension, extensions)
            elif not _DECORATION.search(extension.tag):
                _note_foreign(context, element, namespace)
    return extensions


_DECORATION = re.compile(
    "signavio|bizagi|metaData|style|stencil|aris/|boc-group|visual|modeler|colou?r|bpmn[.]io|trisotech|yaoqiang", re.I
)
"""In the names of extension elements of modelers, which say how an element looks or is filed."""


def _note_foreign(context: Context, element: Node, namespace: str) -> None:
    """Note once that extension elements of another engine, which may say what is done, are not executed."""
    text = f"extension elements of {namespace or 'no namespace'} are kept, but not executed"
    if not any(note.text == text for note in context.notes):
        context.note(element, text)


def is_original_fame(root: Node) -> bool:
    """Return whether a file is one of the original FaMe: it has elements of its web modeler,
    message lists, or JavaScript."""
    if next(root.iter(*(f"{{{namespace}}}*" for namespace in original_fame.NAMESPACES)), None) is not None:
        return True
    languages = {language.lower().strip(" ()") for language in cast("list[str]", _LANGUAGES(root))}
    return not languages.isdisjoint(_JAVASCRIPT) or any(
        map(original_fame.is_message_list, root.iter(original_fame.LIST))
    )


_DIALECT_NAMES: Mapping[str, str] = {
    original_fame.LIST: "lists of type and payload (FaMe G0)",
    CAMUNDA: "Camunda 7 (FaMe G1, FAME)",
    **dict.fromkeys(original_fame.NAMESPACES, "FaMe's web modeler (G2)"),
    ZEEBE: "Camunda 8",
    FLOWABLE: "Flowable",
    ACTIVITI: "Activiti",
}


def dialects_of(root: Node) -> tuple[str, ...]:
    """Return the names of the dialects that a file uses, for messages."""
    seen = set[str]()
    for element in root.iter("*"):
        seen.add(element.tag[1:].partition("}")[0])
        seen.update(key[1:].partition("}")[0] for key in attributes(element) if key[0] == "{")
        if original_fame.is_message_list(element):
            seen.add(original_fame.LIST)
    return tuple(dict.fromkeys(text for form, text in _DIALECT_NAMES.items() if form in seen))


_DECLARED = re.compile(rb"""xmlns(?::[\w.-]+)?\s*=\s*["']([^"']+)["']""")
_SIMILAR = {
    BPMNDI, DC, DI, "http://camunda.org/schema/modeler/1.0", "http://camunda.org/schema/1.0/dmn",
    "http://www.w3.org/2001/XMLSchema", "http://www.w3.org/2001/XMLSchema-instance",
}  # fmt: skip
"""Namespaces similar to known ones, but correct."""
_SIMILARITY = 0.9
"""Minimal similarity of two namespaces (difflib ratio)."""


def note_misspelt_namespaces(context: Context, root: Node, source: bytes) -> None:
    """Add a warning for each namespace that elements use and that resembles a known one."""
    names = {_bare(uri): uri for uri in (*ELEMENT_ADAPTERS, BPMN)}
    declared = {found.decode(errors="replace") for found in _DECLARED.findall(source.replace(b"\0", b""))}
    for uri in sorted(declared - _SIMILAR - set(names.values())):
        near = get_close_matches(_bare(uri), names, n=1, cutoff=_SIMILARITY)
        first = next((one for one in root.iter("*") if near and _is_of(one, uri)), None)
        if first is not None:
            text = f"elements of namespace {uri} are not read; did you mean {names[near[0]]}?"
            context.note(first, text, "warning")


def _bare(uri: str) -> str:
    """A namespace without scheme, www and trailing separators."""
    return re.sub(r"^https?:/*(www\.)?|[/#\s]+$", "", uri.strip().lower())


def _is_of(element: Node, uri: str) -> bool:
    beginning = f"{{{uri}}}"
    return element.tag.startswith(beginning) or any(key.startswith(beginning) for key in attributes(element))
