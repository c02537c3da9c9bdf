"""Copies processes of a file, with everything that they need.

A fragment has the processes, their root elements (signals, messages, errors ...) and diagrams, and the pool if wanted.
Events without a type get that of their topic.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import deepcopy

from lxml import etree

from fame.bpmn.extension_writing import EXTENSION_ELEMENTS, add_property, extension_elements
from fame.bpmn.library import identity
from fame.bpmn.linked_forms import linked_form
from fame.bpmn.model import Bounds, Definitions, Participant, Process, Task
from fame.bpmn.namespaces import expand_types
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.data import shared_stores
from fame.bpmn.reader.document import read_tree
from fame.bpmn.reader.preparation import prepare
from fame.bpmn.reader.xml import BPMN, BPMNDI, ZEEBE, Node, is_reference, parse, resolve, text_of
from fame.dataclasses import dataclass, field

_B = f"{{{BPMN}}}"


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
        for part in (*self.processes, *self.shared):
            yield from part.iter("*")

    def everything(self) -> Iterator[Node]:
        """Yield all its elements, with those of the diagrams."""
        yield from self.elements()
        for diagram in self.diagrams:
            yield from diagram.iter("*")


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
    by_id = {original.get("id"): original for original in root.iterchildren(_PROCESS)}
    for process in processes:
        fragment.processes.append(deepcopy(by_id[process.id]))
        _write_topics(fragment.processes[-1], process, types, acknowledged)
        _embed_forms(fragment.processes[-1], process, definitions)
    for process_copy in fragment.processes:
        _copy_shared_stores(process_copy, fragment, root)
    if pool is not None:
        fragment.collaboration = _collaboration(definitions, root, pool, fragment.processes)
    fragment.shared = [deepcopy(element) for element in _referenced_roots(root, fragment)]
    kept = {id for element in fragment.elements() if (id := element.get("id"))}
    for diagram in root.iterchildren(_DIAGRAM):
        copy = _diagram(diagram, kept, fragment.processes[0].get("id", ""), root)
        if copy is not None:
            fragment.diagrams.append(copy)
    return fragment


def _embed_forms(copy: Node, process: Process, definitions: Definitions) -> None:
    """Write the forms that are beside the model into a process, as Camunda Modeler embeds them."""
    for id in sorted({node.human.linked for node in process.body.walk() if isinstance(node, Task)}):
        if text := linked_form(definitions, id):
            form = etree.SubElement(
                extension_elements(copy), f"{{{ZEEBE}}}userTaskForm", {"id": id}, nsmap={"zeebe": ZEEBE}
            )
            form.text = text


def _copy_shared_stores(copy: Node, fragment: Fragment, root: Node) -> None:
    """Copy data stores into a process that it shares with a process that is not copied."""
    context, here = Context(fragment.definitions.file), {element.get("id") for element in fragment.elements()}
    original = next(process for process in root.iterchildren(_PROCESS) if process.get("id") == copy.get("id"))
    for store in shared_stores(context, original):
        parent = store.getparent()
        if store.get("id") not in here and parent is not None and parent is not root:
            copy.insert(copy.index(next(_flow_elements(copy))), deepcopy(store))


def _flow_elements(process: Node) -> Iterator[Node]:
    """Its children from the first flow node, flow or data object on."""
    return (child for child in process.iterchildren(f"{_B}*") if child.tag not in _BEFORE_FLOWS)


def _collaboration(definitions: Definitions, root: Node, pool: Participant, processes: list[Node]) -> Node | None:
    """A copy of the collaboration of a pool, without other pools and what belongs to them."""
    associations = [association for process in processes for association in process.iter(_ASSOCIATION)]
    associated = {association.get(end, "") for association in associations for end in _ENDS}
    for original in root.iterchildren(_COLLABORATION):
        if any(part.get("id") == pool.id for part in original.iterchildren("*")):
            copy = deepcopy(original)
            inside = _artifacts_inside(definitions, pool.id) | associated | {pool.id}
            for part in list(copy.iterchildren("*")):
                of_another = part.tag in _OF_OTHER_POOLS or part.tag in _ARTIFACTS
                if of_another and part.get("id") not in inside and not _is_within_pool(part, definitions, pool, inside):
                    copy.remove(part)
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
    artifacts = {artifact.id for artifact in definitions.artifacts}
    shapes = [shape for shape in definitions.shapes if shape.element in artifacts]
    return {shape.element for shape in shapes if frame is not None and _holds(frame, shape.bounds)}


def _holds(frame: Bounds, bounds: Bounds) -> bool:
    x, y = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2
    return frame.x <= x <= frame.x + frame.width and frame.y <= y <= frame.y + frame.height


def _referenced_roots(root: Node, fragment: Fragment) -> list[Node]:
    """The root elements that the fragment refers to, directly or indirectly, in document order."""
    roots = [child for child in root.iterchildren("*") if child.tag not in _OF_THE_FILE]
    homes = {id: child for child in roots for inner in child.iter("*") if (id := inner.get("id"))}
    homes.update({child.get("id", ""): child for child in roots})
    referenced: dict[Node, None] = {}
    waiting = list(fragment.elements())
    for element in waiting:
        for reference in _references(element):
            home = resolve(homes, reference)
            if home is not None and home not in referenced:
                referenced[home] = None
                waiting.extend(home.iter("*"))
    # A correlation property refers to its messages, not they to it.
    messages = {element.get("id", ""): element for element in referenced}
    for correlation in root.iterchildren(f"{_B}correlationProperty"):
        if any(resolve(messages, inner.get("messageRef")) is not None for inner in correlation.iter("*")):
            referenced[correlation] = None
    return [child for child in root.iterchildren("*") if child in referenced]


def _diagram(diagram: Node, kept: set[str], process: str, root: Node) -> Node | None:
    """The part of a diagram that shows copied elements. The plane of a missing collaboration shows the process."""
    copy = deepcopy(diagram)
    plane = copy.find(_PLANE)
    if plane is None:
        return None
    for part in list(plane.iterchildren("*")):
        if part.get("bpmnElement") is not None and resolve(dict.fromkeys(kept, True), part.get("bpmnElement")) is None:
            plane.remove(part)
    shown = plane.get("bpmnElement", "")
    if shown not in kept:
        of_collaboration = any(part.get("id") == shown for part in root.iterchildren(_COLLABORATION))
        if not of_collaboration or not len(plane):
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


# ---- topics ----------------------------------------------------------------------------------------------------------


def _write_topics(element: Node, process: Process, types: Mapping[str, str], acknowledged: Collection[str]) -> None:
    by_id = {part.get("id"): part for part in element.iter("*") if part.tag.startswith(_B)}
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
    return [child for child in element.iterchildren("*") if child.tag in tags]
