"""Copies processes of a file, with everything that they need, and writes extensions in the current form.

A fragment has the processes, their root elements (signals, messages, errors ...) and diagrams, and the pool if wanted.
Events without a type get that of their topic.

The current form is that of Camunda 7: properties, mappings and attributes. Writing it is the counterpart of the
adapters in `fame.bpmn.reader.dialects`. Extensions that an element already has in this form are kept and take
precedence, as when the file is read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import deepcopy

from lxml import etree

from fame.bpmn.library import identity
from fame.bpmn.linked_forms import linked_form
from fame.bpmn.model import Assignment, Bounds, Definitions, Expression, Participant, Process, Task
from fame.bpmn.namespaces import expand_types
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.data import shared_stores
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.document import read_tree
from fame.bpmn.reader.preparation import prepare
from fame.bpmn.reader.xml import BPMN, BPMNDI, CAMUNDA, ZEEBE, Node, is_reference, local_name, parse, resolve, text_of
from fame.dataclasses import dataclass, field

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
    """Return the text that the reader recognises as that expression by its form."""
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


_PROCESS, _COLLABORATION, _DIAGRAM = f"{_B}process", f"{_B}collaboration", f"{{{BPMNDI}}}BPMNDiagram"
_PLANE = f"{{{BPMNDI}}}BPMNPlane"
_OF_THE_FILE = {_PROCESS, _COLLABORATION, _DIAGRAM, EXTENSION_ELEMENTS, f"{_B}documentation", f"{_B}import"}
_OF_OTHER_POOLS = {
    f"{_B}{name}"
    for name in ("participant", "messageFlow", "messageFlowAssociation", "conversation", "conversationLink")
}
_BEFORE_FLOWS = {
    f"{_B}{name}"
    for name in ("documentation", "extensionElements", "auditing", "monitoring", "ioSpecification", "ioBinding",
                 "supportedInterfaceRef", "property", "laneSet")
}  # fmt: skip
_ASSOCIATION, _ENDS = f"{_B}association", ("sourceRef", "targetRef")
_ARTIFACTS = {f"{_B}{name}" for name in ("textAnnotation", "group", "association")}


@dataclass(slots=True)
class Fragment:
    """The copied parts of one source file. `ids`: those of processes and renamed elements -> in the new file."""

    definitions: Definitions
    root: Node
    ids: dict[str, str]
    collaboration: Node | None = None
    processes: list[Node] = field(default_factory=list)
    shared: list[Node] = field(default_factory=list)
    diagrams: list[Node] = field(default_factory=list)

    def elements(self) -> Iterator[Node]:
        """Yield all its elements, without those of the diagrams."""
        if self.collaboration is not None:
            yield from self.collaboration.iter("*")
        for one in (*self.processes, *self.shared):
            yield from one.iter("*")

    def everything(self) -> Iterator[Node]:
        """Yield all its elements, with those of the diagrams."""
        yield from self.elements()
        for one in self.diagrams:
            yield from one.iter("*")


def copy_fragment(
    definitions: Definitions,
    processes: Iterable[Process],
    pool: Participant | None,
    types: Mapping[str, str],
    acknowledged: Collection[str] = (),
    trees: dict[str | bytes, Node] | None = None,
) -> Fragment:
    """Return a copy of processes and of all that they need of their file.

    Events get the `types` of their topics; those of `acknowledged` topics say so. `trees` keeps what `full_tree` gives,
    by the identity of the definitions.
    """
    trees, key = {} if trees is None else trees, identity(definitions)
    if key not in trees:
        trees[key] = full_tree(definitions)
    root = deepcopy(trees[key])
    fragment = Fragment(definitions, root, {process.id: process.id for process in processes})
    by_id = {one.get("id"): one for one in root.iterchildren(_PROCESS)}
    for process in processes:
        fragment.processes.append(deepcopy(by_id[process.id]))
        _write_topics(fragment.processes[-1], process, types, acknowledged)
        _embed_forms(fragment.processes[-1], process, definitions)
    for process_copy in fragment.processes:
        _copy_shared_stores(process_copy, fragment, root)
    if pool is not None:
        fragment.collaboration = _collaboration(definitions, root, pool, fragment.processes)
    fragment.shared = [deepcopy(one) for one in _referenced_roots(root, fragment)]
    kept = {id for one in fragment.elements() if (id := one.get("id"))}
    for diagram in root.iterchildren(_DIAGRAM):
        copy = _diagram(diagram, kept, fragment.processes[0].get("id", ""), root)
        if copy is not None:
            fragment.diagrams.append(copy)
    return fragment


def _embed_forms(copy: Node, process: Process, definitions: Definitions) -> None:
    """Write the forms that are beside the model into a process, as Camunda Modeler embeds them."""
    for id in sorted({node.human.linked for node in process.body.walk() if isinstance(node, Task)}):
        if text := linked_form(definitions, id):
            form = etree.SubElement(_extensions(copy), f"{{{ZEEBE}}}userTaskForm", {"id": id}, nsmap={"zeebe": ZEEBE})
            form.text = text


def _copy_shared_stores(copy: Node, fragment: Fragment, root: Node) -> None:
    """Copy data stores into a process that it shares with a process that is not copied."""
    context, here = Context(fragment.definitions.file), {one.get("id") for one in fragment.elements()}
    original = next(one for one in root.iterchildren(_PROCESS) if one.get("id") == copy.get("id"))
    for store in shared_stores(context, original):
        around = store.getparent()
        if store.get("id") not in here and around is not None and around is not root:
            copy.insert(copy.index(next(_flow_elements(copy))), deepcopy(store))


def _flow_elements(process: Node) -> Iterator[Node]:
    """Its children from the first flow node, flow or data object on."""
    return (one for one in process.iterchildren(f"{_B}*") if one.tag not in _BEFORE_FLOWS)


def _collaboration(definitions: Definitions, root: Node, pool: Participant, processes: list[Node]) -> Node | None:
    associated = {one.get(end, "") for own in processes for one in own.iter(_ASSOCIATION) for end in _ENDS}
    for original in root.iterchildren(_COLLABORATION):
        if any(one.get("id") == pool.id for one in original.iterchildren("*")):
            copy = deepcopy(original)
            inside = _artifacts_inside(definitions, pool.id) | associated | {pool.id}
            for one in list(copy.iterchildren("*")):
                of_another = one.tag in _OF_OTHER_POOLS or one.tag in _ARTIFACTS
                if of_another and one.get("id") not in inside and not _is_within_pool(one, definitions, pool, inside):
                    copy.remove(one)
            return copy
    return None


def _is_within_pool(association: Node, definitions: Definitions, pool: Participant, inside: set[str]) -> bool:
    """Whether both ends of an association belong to the pool."""
    if association.tag != _ASSOCIATION:
        return False
    process = definitions.process(pool.process)
    own = {node.id for node in process.body.walk()} if process is not None else set()
    return all(association.get(end, "") in own | inside for end in _ENDS)


def _artifacts_inside(definitions: Definitions, pool: str) -> set[str]:
    """The ids of the artifacts drawn inside a pool."""
    frame = next((shape.bounds for shape in definitions.shapes if shape.element == pool), None)
    artifacts = {one.id for one in definitions.artifacts}
    shapes = [shape for shape in definitions.shapes if shape.element in artifacts]
    return {shape.element for shape in shapes if frame is not None and _holds(frame, shape.bounds)}


def _holds(frame: Bounds, bounds: Bounds) -> bool:
    x, y = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2
    return frame.x <= x <= frame.x + frame.width and frame.y <= y <= frame.y + frame.height


def _referenced_roots(root: Node, fragment: Fragment) -> list[Node]:
    """The root elements that the fragment refers to, directly or indirectly, in document order."""
    roots = [one for one in root.iterchildren("*") if one.tag not in _OF_THE_FILE]
    homes = {id: one for one in roots for inner in one.iter("*") if (id := inner.get("id"))}
    homes.update({one.get("id", ""): one for one in roots})
    found: dict[Node, None] = {}
    waiting = list(fragment.elements())
    for element in waiting:
        for reference in _references(element):
            home = resolve(homes, reference)
            if home is not None and home not in found:
                found[home] = None
                waiting.extend(home.iter("*"))
    for one in root.iterchildren(f"{_B}correlationProperty"):
        if any(
            resolve({shared.get("id", ""): 1 for shared in found}, inner.get("messageRef")) for inner in one.iter("*")
        ):
            found[one] = None
    return [one for one in root.iterchildren("*") if one in found]


def _diagram(diagram: Node, kept: set[str], process: str, root: Node) -> Node | None:
    """The part of a diagram that shows copied elements. The plane of a missing collaboration shows the process."""
    copy = deepcopy(diagram)
    plane = copy.find(_PLANE)
    if plane is None:
        return None
    for one in list(plane.iterchildren("*")):
        if one.get("bpmnElement") is not None and resolve(dict.fromkeys(kept, True), one.get("bpmnElement")) is None:
            plane.remove(one)
    shown = plane.get("bpmnElement", "")
    if shown not in kept:
        if not any(one.get("id") == shown for one in root.iterchildren(_COLLABORATION)) or not len(plane):
            return None
        plane.set("bpmnElement", process)
    return copy


def full_tree(definitions: Definitions) -> Node:
    """Return the complete XML tree of a file, with the ids that the reader generates for elements without one.

    Types are as `fame.bpmn.namespaces.expand_types` writes them.
    """
    root = parse(definitions.source, definitions.file, keep_all=True)
    expand_types(root)
    context = Context(definitions.file)
    prepare(context, root)
    as_read = parse(definitions.source, definitions.file)
    read_tree(as_read, definitions.source, definitions.file)
    for element, other in zip(root.iter("*"), as_read.iter("*"), strict=True):
        id = other.get("id", "")
        if id and not element.get("id"):
            element.set("id", id)
    return root


def _references(element: Node) -> Iterator[str]:
    for name, value in element.items():
        if is_reference(str(name)) or name == "calledElement":  # a global task stands at the root
            yield str(value)
    if element.tag.endswith(("Ref", "Refs")):
        yield text_of(element)


# ---- types -----------------------------------------------------------------------------------------------------------


def _write_topics(element: Node, process: Process, types: Mapping[str, str], acknowledged: Collection[str]) -> None:
    by_id = {one.get("id"): one for one in element.iter("*") if one.tag.startswith(_B)}
    for node in process.body.walk():
        topics = [topic for topic, _ in node.topics()]
        typeless = [topic.type is None and topic.qualified in types for topic in topics]
        unsaid = [not topic.ttl and topic.qualified in acknowledged for topic in topics]
        if not any(typeless) and not any(unsaid):
            continue
        holders = _holders(by_id[node.id], len(topics))
        for topic, holder, needs_type, needs_delivery in zip(topics, holders, typeless, unsaid, strict=True):
            if needs_type:
                add_property(holder, "type", types[topic.qualified])
            if needs_delivery:
                add_property(holder, "delivery", "acknowledged")


def _holders(element: Node, count: int) -> list[Node]:
    """The elements to write the types of a node's topics to: the node, or its definitions if it has several topics."""
    if count == 1:
        return [element]
    tags = (f"{_B}signalEventDefinition", f"{_B}messageEventDefinition")
    return [one for one in element.iterchildren("*") if one.tag in tags]


def has_property(element: Node, name: str) -> bool:
    extensions = element.find(EXTENSION_ELEMENTS)
    return extensions is not None and any(one.get("name") == name for one in extensions.iter("*"))
