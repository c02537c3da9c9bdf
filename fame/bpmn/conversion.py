"""Converts a file of any dialect to the current form, with the same behaviour.

It works on the XML, so that unknown content is kept. The adapters read extension elements of other dialects, and
`fame.bpmn.extension_writing` writes them in the current form. Every topic gets a signal or message with its name.
Embedded processes become processes of the file. Scripts keep their language. A file in the current form does not
change.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Literal

from lxml import etree

from fame.bpmn.extension_writing import EXTENSION_ELEMENTS, add_property, write_extensions
from fame.bpmn.fragments import full_tree
from fame.bpmn.model import TASKS, Definitions, Process
from fame.bpmn.namespaces import add_prefixes, contract_types, repair_prefixes
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.dialects import ELEMENT_ADAPTERS, is_original_fame, original_fame
from fame.bpmn.reader.dialects.camunda7 import SHARED_ATTRIBUTES, SHARED_ELEMENTS
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.xml import (
    ACTIVITI,
    BPMN,
    BPMNDI,
    CAMUNDA,
    FLOWABLE,
    ZEEBE,
    Node,
    attributes,
    ids_in,
    invented_id,
    local_name,
    text_of,
)

Semantics = Literal["standard", "original"]

_B, _C = f"{{{BPMN}}}", f"{{{CAMUNDA}}}"
_DIAGRAM = f"{{{BPMNDI}}}BPMNDiagram"
_PLATFORM = "{http://camunda.org/schema/modeler/1.0}executionPlatform"
_CAMUNDA8 = {
    "properties", "taskHeaders", "ioMapping", "taskDefinition", "calledElement", "loopCharacteristics", "script",
    "subscription",
}  # fmt: skip
"""Camunda 8 elements that have a current form."""
_KINDS = {f"{_B}signalEventDefinition": "signal", f"{_B}messageEventDefinition": "message"}


def convert(definitions: Definitions, *, semantics: Semantics | None = None) -> bytes:
    """Return the file in the current form, UTF-8. `semantics` sets that of its processes.

    Raises ModelError if an embedded process cannot be read.
    """
    root = full_tree(definitions)
    before, context = etree.tostring(root), Context(definitions.file)
    _rename_vendors(root)
    for element in list(root.iter(f"{_B}*")):
        _rewrite(context, root, element)
    by_id = {element.get("id", ""): element for element in root.iter(f"{_B}*")}
    for process in definitions.processes:
        _name_signals(root, process, by_id)
        _write_rules(root, process, by_id[process.id], semantics)
    return definitions.source if etree.tostring(root) == before else _written(root)


# ---- extension elements ----------------------------------------------------------------------------------------------


def _rewrite(context: Context, root: Node, element: Node) -> None:
    for name in ("scriptFormat", "language"):
        if (element.get(name) or "").strip().lower() in ("js", "javascript()", "javascript"):
            element.set(name, "javascript")
    holders = element.findall(EXTENSION_ELEMENTS)
    if not holders:
        return
    holder = holders[0]
    for another in holders[1:]:  # the standard allows one
        holder.extend(another)
        element.remove(another)
    foreign = [extension for extension in holder if _is_foreign(extension)]
    extensions = Extensions()
    for extension in foreign:
        ELEMENT_ADAPTERS[extension.tag[1:].partition("}")[0]](context, _without_comments(extension), extensions)
    mappings = (*extensions.inputs, *extensions.outputs)
    in_order = any(mapping.in_order for mapping in mappings)  # which no other form says
    says_all = not extensions.own_scope or mappings or extensions.all_in or extensions.all_out
    if not extensions.refused and not in_order and says_all:
        for extension in foreign:
            holder.remove(extension)
        write_extensions(element, extensions)
    if extensions.key is not None:
        _correlate(root, element, extensions.key.text)
    if any(child.tag in _KINDS for child in element):
        _rewrite_message_lists(element, holder)
    if not len(holder):
        element.remove(holder)


def _without_comments(element: Node) -> Node:
    """A copy without comments and processing instructions, as the reader gets it."""
    copy = deepcopy(element)
    etree.strip_tags(copy, etree.Comment, etree.PI)
    return copy


def _is_foreign(element: Node) -> bool:
    if not isinstance(element.tag, str):
        return False
    namespace = element.tag[1:].partition("}")[0]
    return namespace in original_fame.NAMESPACES or (namespace == ZEEBE and local_name(element) in _CAMUNDA8)


def _rewrite_message_lists(event: Node, holder: Node) -> None:
    """Rewrite the lists of type and payload of the oldest FaMe models as properties."""
    for mapping in holder.findall(f"{_C}inputOutput"):
        for parameter in mapping.findall(f"{_C}inputParameter"):
            first = next(parameter.iterchildren("*"), None)
            values = list(first.iterchildren("*")) if first is not None and original_fame.is_message_list(first) else []
            if 0 < len(values) <= 2:
                for name, value in zip(("type", "payload"), values, strict=False):
                    add_property(event, name, text_of(value).strip())
                mapping.remove(parameter)
        if not len(mapping):
            holder.remove(mapping)


def _correlate(root: Node, message: Node, key: str) -> None:
    """Write the key of a message as a correlation property (BPMN 2.0, chapter 8.3.2)."""
    correlation = etree.Element(f"{_B}correlationProperty", {"id": f"{message.get('id')}_Key", "name": key})
    correlation.append(
        etree.Element(f"{_B}correlationPropertyRetrievalExpression", {"messageRef": message.get("id", "")})
    )
    etree.SubElement(correlation[0], f"{_B}messagePath").text = f"${{msg.{key.rpartition('.')[2]}}}"
    _add_to_root(root, correlation)


def _rename_vendors(root: Node) -> None:
    """Move the elements and attributes of Flowable and Activiti to the namespace of Camunda 7."""
    for element in root.iter("*"):
        for key in attributes(element):
            namespace, _, name = key[1:].partition("}")
            if namespace in (FLOWABLE, ACTIVITI) and name in SHARED_ATTRIBUTES:
                element.set(f"{_C}{name}", element.attrib.pop(key))
        if element.tag[1:].partition("}")[0] in (FLOWABLE, ACTIVITI) and local_name(element) in SHARED_ELEMENTS:
            element.tag = f"{_C}{local_name(element)}"


# ---- topics ----------------------------------------------------------------------------------------------------------


def _name_signals(root: Node, process: Process, by_id: Mapping[str, Node]) -> None:
    """Make every event and task refer to a signal or message with the name of its topic."""
    for node in process.body.walk():
        topics = [topic for topic, _ in node.topics()]
        drawn = [child for child in by_id[node.id] if child.tag in _KINDS]
        if node.tag in TASKS and by_id[node.id].get("messageRef"):
            drawn = [by_id[node.id]]
        for topic, element in zip(topics, drawn, strict=False):
            kind = _KINDS.get(element.tag, "message")
            referred = by_id.get(element.get(f"{kind}Ref", "").rpartition(":")[2])
            name = topic.label or topic.name
            if (referred is None or referred.get("name", "").strip() != name) and name != node.id:
                element.set(f"{kind}Ref", _named(root, kind, name))


def _named(root: Node, kind: str, name: str) -> str:
    """The id of the signal or message of that name, which is created if it is missing."""
    for known in root.iterchildren(f"{_B}{kind}"):
        if known.get("name", "").strip() == name and known.get("id"):
            return known.get("id", "")
    stem = f"{kind.capitalize()}_{''.join(letter if letter.isalnum() else '_' for letter in name)}"
    id = invented_id(stem, ids_in(root))
    _add_to_root(root, etree.Element(f"{_B}{kind}", {"id": id, "name": name}))
    return id


def _add_to_root(root: Node, element: Node) -> None:
    """Insert a root element before the diagrams, as the schema requires."""
    diagram = root.find(_DIAGRAM)
    root.insert(len(root) if diagram is None else root.index(diagram), element)


# ---- rules of the process --------------------------------------------------------------------------------------------


def _write_rules(root: Node, process: Process, element: Node, semantics: Semantics | None) -> None:
    """Write the rules that the reader inferred from the dialect as properties of the process."""
    if semantics not in (None, process.semantics) and any(node.triggered_by_event for node in process.body.walk()):
        _drop_property(element, "semantics")
        add_property(element, "semantics", str(semantics))
    _drop_property(element, "topics")
    if process.by_prefix and not is_original_fame(root) and any(True for _ in element.iter(f"{_B}dataObjectReference")):
        add_property(element, "fields", "prefix")


def _drop_property(element: Node, name: str) -> None:
    holder = element.find(EXTENSION_ELEMENTS)
    for properties in holder.findall(f"{_C}properties") if holder is not None else ():
        for known in properties.findall(f"{_C}property"):
            if known.get("name") == name:
                properties.remove(known)


# ---- the file --------------------------------------------------------------------------------------------------------


def _written(root: Node) -> bytes:
    for process in root.findall(f"{_B}process"):
        before = process.itersiblings(preceding=True)
        if any(sibling.tag == _DIAGRAM for sibling in before):  # it was inside a call activity
            _add_to_root(root, process)
    if root.get(_PLATFORM) == "Camunda Cloud":
        root.set(_PLATFORM, "Camunda Platform")
        root.set(f"{_PLATFORM}Version", "7.23.0")
    gone = {*original_fame.NAMESPACES, ZEEBE, FLOWABLE, ACTIVITI}
    declared = dict[str | None, str]({"camunda": CAMUNDA, **root.nsmap})
    add_prefixes(declared, [root])
    kept = {prefix: uri for prefix, uri in declared.items() if prefix and uri not in gone}
    top = {prefix: uri for prefix, uri in kept.items() if uri not in root.nsmap.values()}
    etree.cleanup_namespaces(root, top_nsmap=top or None, keep_ns_prefixes=list(kept))
    etree.indent(root, "  ")
    repair_prefixes(root)
    contract_types(root)
    return etree.tostring(root.getroottree(), xml_declaration=True, encoding="UTF-8") + b"\n"
