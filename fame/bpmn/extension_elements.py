"""Writes extensions in the current form: Camunda 7 properties, mappings and attributes.

The counterpart of the adapters in `fame.bpmn.reader.dialects`. Extensions that an element already has in the current
form are kept and take precedence, as when the file is read.
"""

from __future__ import annotations

from lxml import etree

from fame.bpmn.model import Assignment, Expression
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import BPMN, CAMUNDA, Node, local_name

_B, _C = f"{{{BPMN}}}", f"{{{CAMUNDA}}}"
EXTENSION_ELEMENTS = f"{_B}extensionElements"


def write_extensions(element: Node, found: Extensions) -> None:
    """Add extensions read from other dialects to a BPMN element."""
    if found.service:
        add_property(element, "service", found.operation)
    elif found.operation:
        _default(element, "type", "external")
        _default(element, "topic", found.operation)
    if found.type:
        add_property(element, "type", found.type)
    if found.payload is not None:
        add_property(element, "payload", found.payload.value)
    for name, value in found.qos.items():
        add_property(element, f"qos.{name}", value)
    for place, (name, one) in enumerate(found.values):  # the reader takes them before properties
        add_property(element, name, one.value, place)
    for name, one in found.properties.items():
        add_property(element, name, one.value)
    _mappings(element, found)
    if found.called:
        element.set("calledElement", found.called)
    _loop(element, found)
    _script(element, found)


def add_property(element: Node, name: str, value: str, place: int | None = None) -> None:
    """Add a property, unless the element has one of that name; as the last one, or at index `place`."""
    properties = _inside(element, f"{_C}properties")
    if all(one.get("name") != name for one in properties):
        made = etree.Element(f"{_C}property", {"name": name, "value": value})
        properties.insert(len(properties) if place is None else place, made)


def text_of_expression(expression: Expression) -> str:
    """The text that the reader recognises as that expression by its form."""
    return f"={expression.text}" if expression.language == "feel" else expression.text


def _inside(element: Node, tag: str) -> Node:
    """The extension element with that tag, which is created if it is missing."""
    extensions = _extensions(element)
    found = extensions.find(tag)
    return found if found is not None else etree.SubElement(extensions, tag, nsmap={"camunda": CAMUNDA})


def _extensions(element: Node) -> Node:
    found = element.find(EXTENSION_ELEMENTS)
    if found is None:
        found = etree.Element(EXTENSION_ELEMENTS)
        element.insert(len(element.findall(f"{_B}documentation")), found)
    return found


def _default(element: Node, name: str, value: str) -> None:
    if value and element.get(f"{_C}{name}") is None:
        element.set(f"{_C}{name}", value)


def _mappings(element: Node, found: Extensions) -> None:
    if local_name(element) == "callActivity":
        _copies(element, "in", found.inputs, found.all_in)
        _copies(element, "out", found.outputs, found.all_out)
        return
    for kind, items in (("inputParameter", found.inputs), ("outputParameter", found.outputs)):
        for item in items:
            holder = _inside(element, f"{_C}inputOutput")
            etree.SubElement(holder, f"{_C}{kind}", {"name": item.target}).text = text_of_expression(item.source)


def _copies(element: Node, kind: str, items: list[Assignment], everything: bool) -> None:
    copies = [{"variables": "all"}] if everything else []
    copies += [
        {"sourceExpression": text_of_expression(item.source) or "=null", "target": item.target} for item in items
    ]
    for one in copies:
        etree.SubElement(_extensions(element), f"{_C}{kind}", one, nsmap={"camunda": CAMUNDA})


def _loop(element: Node, found: Extensions) -> None:
    if found.collection:
        _default(element, "collection", found.collection)
        _default(element, "elementVariable", found.element_variable)
    for name, value in (("outputCollection", found.output_collection), ("outputElement", found.output_element)):
        if value:
            add_property(element, name, value)


def _script(element: Node, found: Extensions) -> None:
    if found.script is not None and local_name(element).endswith("Task") and element.find(f"{_B}script") is None:
        element.set("scriptFormat", found.script.language)
        etree.SubElement(element, f"{_B}script").text = text_of_expression(found.script)
    _default(element, "resultVariable", found.result)
