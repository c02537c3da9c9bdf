"""Writes extensions of an element in the current form, that of Camunda 7: properties, mappings and attributes.

It is the counterpart of the adapters in `fame.bpmn.reader.dialects`. Extensions that an element already has in this
form are kept and take precedence, as when the file is read.
"""

from __future__ import annotations

from lxml import etree

from fame.bpmn.model import Assignment, Expression
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import BPMN, CAMUNDA, Node, local_name

_B, _C = f"{{{BPMN}}}", f"{{{CAMUNDA}}}"
EXTENSION_ELEMENTS = f"{_B}extensionElements"


def write_extensions(element: Node, extensions: Extensions) -> None:
    """Add extensions read from other dialects to a BPMN element."""
    if extensions.service:
        add_property(element, "service", extensions.operation)
    elif extensions.operation:
        _default(element, "type", "external")
        _default(element, "topic", extensions.operation)
    if extensions.type:
        add_property(element, "type", extensions.type)
    if extensions.payload is not None:
        add_property(element, "payload", extensions.payload.value)
    for name, value in extensions.qos.items():
        add_property(element, f"qos.{name}", value)
    for place, (name, text) in enumerate(extensions.values):  # the reader takes them before properties
        add_property(element, name, text.value, place)
    for name, text in extensions.properties.items():
        add_property(element, name, text.value)
    _mappings(element, extensions)
    if extensions.called:
        element.set("calledElement", extensions.called)
    _loop(element, extensions)
    _script(element, extensions)


def add_property(element: Node, name: str, value: str, place: int | None = None) -> None:
    """Add a property, unless the element has one of that name; as the last one, or at index `place`."""
    properties = _inside(element, f"{_C}properties")
    if all(known.get("name") != name for known in properties):
        made = etree.Element(f"{_C}property", {"name": name, "value": value})
        properties.insert(len(properties) if place is None else place, made)


def has_property(element: Node, name: str) -> bool:
    extensions = element.find(EXTENSION_ELEMENTS)
    return extensions is not None and any(inner.get("name") == name for inner in extensions.iter("*"))


def text_of_expression(expression: Expression) -> str:
    """Return the text that the reader recognises as that expression by its form."""
    return f"={expression.text}" if expression.language == "feel" else expression.text


def _inside(element: Node, tag: str) -> Node:
    """The extension element with that tag, which is created if it is missing."""
    holder = extension_elements(element)
    inner = holder.find(tag)
    return inner if inner is not None else etree.SubElement(holder, tag, nsmap={"camunda": CAMUNDA})


def extension_elements(element: Node) -> Node:
    """Return the element that holds extensions, which is created if it is missing."""
    holder = element.find(EXTENSION_ELEMENTS)
    if holder is None:
        holder = etree.Element(EXTENSION_ELEMENTS)
        element.insert(len(element.findall(f"{_B}documentation")), holder)
    return holder


def _default(element: Node, name: str, value: str) -> None:
    if value and element.get(f"{_C}{name}") is None:
        element.set(f"{_C}{name}", value)


def _mappings(element: Node, extensions: Extensions) -> None:
    if local_name(element) == "callActivity":
        _copies(element, "in", extensions.inputs, extensions.all_in)
        _copies(element, "out", extensions.outputs, extensions.all_out)
        return
    for kind, items in (("inputParameter", extensions.inputs), ("outputParameter", extensions.outputs)):
        for item in items:
            holder = _inside(element, f"{_C}inputOutput")
            etree.SubElement(holder, f"{_C}{kind}", {"name": item.target}).text = text_of_expression(item.source)


def _copies(element: Node, kind: str, items: list[Assignment], everything: bool) -> None:
    copies = [{"variables": "all"}] if everything else []
    copies += [
        {"sourceExpression": text_of_expression(item.source) or "=null", "target": item.target} for item in items
    ]
    for attributes in copies:
        etree.SubElement(extension_elements(element), f"{_C}{kind}", attributes, nsmap={"camunda": CAMUNDA})


def _loop(element: Node, extensions: Extensions) -> None:
    if extensions.collection:
        _default(element, "collection", extensions.collection)
        _default(element, "elementVariable", extensions.element_variable)
    if extensions.output_collection:
        add_property(element, "outputCollection", extensions.output_collection)
    if extensions.output_element:
        add_property(element, "outputElement", extensions.output_element)


def _script(element: Node, extensions: Extensions) -> None:
    if extensions.script is not None and local_name(element).endswith("Task") and element.find(f"{_B}script") is None:
        element.set("scriptFormat", extensions.script.language)
        etree.SubElement(element, f"{_B}script").text = text_of_expression(extensions.script)
    _default(element, "resultVariable", extensions.result)
