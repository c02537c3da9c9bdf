"""Dialects: what vendors' extension elements mean, told in one neutral vocabulary (`extensions.Extensions`).

One adapter each: a function of (context, extension element, extensions so far) that writes what the element says into
the extensions, and one of (context, element, attribute, value, extensions) where the dialect has attributes. An adapter
is found by the namespace of what it reads, so a file may mix dialects. What no adapter knows stays in the file and
means nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from lxml.etree import XPath

from fame.bpmn.context import Context
from fame.bpmn.dialects import camunda7, camunda8, fame_g0, fame_g2
from fame.bpmn.dialects.extensions import Extensions
from fame.bpmn.xml import ACTIVITI, BPMN, CAMUNDA, FLOWABLE, ZEEBE, Node, attributes

ElementAdapter = Callable[[Context, Node, Extensions], None]
AttributeAdapter = Callable[[Context, Node, str, str, Extensions], None]

ELEMENTS: Mapping[str, ElementAdapter] = {
    **dict.fromkeys((CAMUNDA, FLOWABLE, ACTIVITI), camunda7.element),
    ZEEBE: camunda8.element,
    fame_g2.ROS: fame_g2.element,
    fame_g2.DATA: fame_g2.element,
    fame_g2.QOS: fame_g2.element,
    fame_g2.CALL: fame_g2.element,
}
ATTRIBUTES: Mapping[str, AttributeAdapter] = {
    **dict.fromkeys((CAMUNDA, FLOWABLE, ACTIVITI), camunda7.attribute),
    ZEEBE: camunda8.attribute,
}

_OURS = {fame_g2.ROS, fame_g2.DATA, fame_g2.QOS, fame_g2.CALL}
_JAVASCRIPT = ("javascript", "js")
_LANGUAGES = XPath("//@scriptFormat | //*[not(@scriptFormat)]/@language", smart_strings=False)
_EXTENSION_ELEMENTS = f"{{{BPMN}}}extensionElements"


def extensions_of(context: Context, element: Node) -> Extensions:
    """All that the extension elements and attributes of a BPMN element say."""
    found = Extensions()
    for key in attributes(element):
        if key[0] == "{":
            namespace, _, name = key[1:].partition("}")
            read_attribute = ATTRIBUTES.get(namespace)
            if read_attribute is not None:
                read_attribute(context, element, name, element.get(key, ""), found)
    for holder in element.iterchildren(_EXTENSION_ELEMENTS):
        for extension in holder:
            read_element = ELEMENTS.get(extension.tag[1:].partition("}")[0])
            if read_element is not None:
                read_element(context, extension, found)
    return found


def looks_original(root: Node) -> bool:
    """Whether a file looks like one of the original FaMe's: by elements of its web modeler, lists, or JavaScript."""
    if next(root.iter(*(f"{{{namespace}}}*" for namespace in _OURS)), None) is not None:
        return True
    languages = {said.lower().strip(" ()") for said in cast("list[str]", _LANGUAGES(root))}
    return not languages.isdisjoint(_JAVASCRIPT) or any(map(fame_g0.is_message, root.iter(fame_g0.LIST)))


_FORMS: Mapping[str, str] = {
    fame_g0.LIST: "lists of type and payload (FaMe G0)",
    CAMUNDA: "Camunda 7 (FaMe G1, FAME)",
    **dict.fromkeys((fame_g2.ROS, fame_g2.DATA, fame_g2.QOS, fame_g2.CALL), "FaMe's web modeler (G2)"),
    ZEEBE: "Camunda 8",
    FLOWABLE: "Flowable",
    ACTIVITI: "Activiti",
}


def forms_of(root: Node) -> tuple[str, ...]:
    """Whose extension elements and attributes a file has, in words; in the order of generations."""
    seen = set[str]()
    for one in root.iter("*"):
        seen.add(one.tag[1:].partition("}")[0])
        seen.update(key[1:].partition("}")[0] for key in attributes(one) if key[0] == "{")
        if fame_g0.is_message(one):
            seen.add(fame_g0.LIST)
    return tuple(dict.fromkeys(text for form, text in _FORMS.items() if form in seen))
