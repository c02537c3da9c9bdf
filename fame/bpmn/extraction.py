"""Takes one pool out of a collaboration: a file of its own that holds all that the process needs.

It works on the XML, so that what FAME does not know comes along. The new file has the pool and its process, the
processes that it calls, what these declare at the root (signals, messages, errors ...), and their drawings. Files that
were drawn apart use the same ids, so those of a called process that are taken get a number; and every event whose
topic's type is said elsewhere gets it written down, for elsewhere is another robot's file from now on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field

from lxml import etree

from fame.bpmn.context import Context, find
from fame.bpmn.dialects.fame_g2 import CALL, unfold
from fame.bpmn.model import Bounds, CallActivity, Definitions, FlowNode, Participant, Process
from fame.bpmn.reader import read_tree
from fame.bpmn.topics import topics_of
from fame.bpmn.xml import BPMN, BPMNDI, CAMUNDA, ZEEBE, Node, parse, text_of
from fame.errors import ModelError

_B = f"{{{BPMN}}}"
_PROCESS, _COLLABORATION, _DIAGRAM = f"{_B}process", f"{_B}collaboration", f"{{{BPMNDI}}}BPMNDiagram"
_PLANE = f"{{{BPMNDI}}}BPMNPlane"
_EXTENSION_ELEMENTS = f"{_B}extensionElements"
_XSI_TYPE = "{http://www.w3.org/2001/XMLSchema-instance}type"
_OF_THE_FILE = {_PROCESS, _COLLABORATION, _DIAGRAM, _EXTENSION_ELEMENTS, f"{_B}documentation", f"{_B}import"}
_OF_OTHER_POOLS = {
    f"{_B}{name}"
    for name in ("participant", "messageFlow", "messageFlowAssociation", "conversation", "conversationLink")
}
_ARTIFACTS = {f"{_B}{name}" for name in ("textAnnotation", "group", "association")}

Called = Mapping[str, tuple[Definitions, str]]
"""What call activities name -> the file that has it, and the id of the process in it."""


@dataclass(slots=True)
class _Piece:
    """What one file gives to the new one: copies, not yet in it. `ids`: of its processes, there -> in the new file."""

    file: str
    root: Node
    ids: dict[str, str]
    collaboration: Node | None = None
    processes: list[Node] = field(default_factory=list)
    shared: list[Node] = field(default_factory=list)
    diagrams: list[Node] = field(default_factory=list)

    def elements(self) -> Iterator[Node]:
        """Every element of the model in it (not of the drawing)."""
        if self.collaboration is not None:
            yield from self.collaboration.iter("*")
        for one in (*self.processes, *self.shared):
            yield from one.iter("*")

    def everything(self) -> Iterator[Node]:
        """Also those of the drawing."""
        yield from self.elements()
        for one in self.diagrams:
            yield from one.iter("*")


def extract_process(
    definitions: Definitions,
    process_id: str,
    *,
    name: str = "",
    called: Called | None = None,
    topic_types: Mapping[str, str] | None = None,
) -> bytes:
    """One process as an executable file of its own, self-contained, UTF-8.

    `name` picks the pool where several have this process, and is the name of the pool in the new file. `called` says
    which process each call activity means, at any depth; processes of the same file need not be there. `topic_types`
    maps qualified topics to types. Message flows are left out: topics carry messages. Raises ModelError if a file lacks
    a process that it should have.
    """
    process = _process(definitions, process_id)
    reached = _reachable(definitions, process, called or {})
    files = _by_file(definitions, process, reached.values())
    pool = _pool(definitions, process_id, name)
    pieces: list[_Piece] = []
    taken: set[str] = set()
    for file, processes in files:
        piece = _piece(file, processes, pool if file is definitions else None, topic_types or {})
        _make_unique(piece, taken)
        pieces.append(piece)
    ids = {key: piece.ids[id] for key, (file, id) in reached.items() for piece in pieces if piece.file == file.file}
    for piece in pieces:
        _point_calls(piece, ids)
    if pieces[0].collaboration is not None and name:
        next(pieces[0].collaboration.iterchildren(f"{_B}participant")).set("name", name)
    return etree.tostring(_assemble(pieces), xml_declaration=True, encoding="UTF-8") + b"\n"


def _process(definitions: Definitions, id: str) -> Process:
    process = definitions.process(id)
    if process is None:
        has = ", ".join(one.id for one in definitions.processes) or "none"
        raise ModelError(f"the file has no process {id!r}: it has {has}", file=definitions.file)
    return process


def _by_file(
    definitions: Definitions, process: Process, reached: Iterable[tuple[Definitions, str]]
) -> list[tuple[Definitions, list[Process]]]:
    """Files with the processes that are wanted of them; that of the pool first."""
    found = {definitions.file: (definitions, [process])}
    for file, id in reached:
        processes = found.setdefault(file.file, (file, []))[1]
        one = _process(found[file.file][0], id)
        if one not in processes:
            processes.append(one)
    return list(found.values())


def _tree(definitions: Definitions) -> Node:
    """The file with all that is in it, and the ids that the reader makes where there is none."""
    root = parse(definitions.source, definitions.file, keep_all=True)
    unfold(Context(definitions.file), root)
    as_read = parse(definitions.source, definitions.file)
    read_tree(as_read, definitions.source, definitions.file)
    for element, other in zip(root.iter("*"), as_read.iter("*"), strict=True):
        id = other.get("id", "")
        if id and not element.get("id"):
            element.set("id", id)
    return root


def _reachable(definitions: Definitions, process: Process, called: Called) -> dict[str, tuple[Definitions, str]]:
    """What the process calls, and what that calls, in the order of meeting; all of `called` if a call is computed."""
    found: dict[str, tuple[Definitions, str]] = {}
    waiting = [(definitions, process)]
    for file, one in waiting:
        for node in one.body.walk():
            if isinstance(node, CallActivity):
                named = {node.called: called.get(node.called) or (file, node.called)}
                for key, there in (called if node.called_expression is not None else named).items():
                    if key not in found and (key in called or file.process(key) is not None):
                        found[key] = there
                        waiting.append((there[0], _process(*there)))
    return found


def _pool(definitions: Definitions, process_id: str, name: str) -> Participant | None:
    pools = [one for one in definitions.participants if one.process == process_id]
    named = [one for one in pools if one.name == name]
    return next(iter(named or pools), None)


# ---- copying ---------------------------------------------------------------------------------------------------------


def _piece(
    definitions: Definitions, processes: Iterable[Process], pool: Participant | None, types: Mapping[str, str]
) -> _Piece:
    """Copies of what processes of a file are made of, with the types of their topics written down."""
    root = _tree(definitions)
    piece = _Piece(definitions.file, root, {process.id: process.id for process in processes})
    by_id = {one.get("id"): one for one in root.iterchildren(_PROCESS)}
    for process in processes:
        piece.processes.append(deepcopy(by_id[process.id]))
        _write_types(piece.processes[-1], process, types)
    if pool is not None:
        piece.collaboration = _collaboration(definitions, root, pool)
    piece.shared = [deepcopy(one) for one in _needed(root, piece)]
    kept = {id for one in piece.elements() if (id := one.get("id"))}
    for diagram in root.iterchildren(_DIAGRAM):
        copy = _diagram(diagram, kept, piece.processes[0].get("id", ""), root)
        if copy is not None:
            piece.diagrams.append(copy)
    return piece


def _collaboration(definitions: Definitions, root: Node, pool: Participant) -> Node | None:
    for original in root.iterchildren(_COLLABORATION):
        if any(one.get("id") == pool.id for one in original.iterchildren("*")):
            copy = deepcopy(original)
            inside = _inside(definitions, pool.id) | {pool.id}
            for one in list(copy.iterchildren("*")):
                of_another = one.tag in _OF_OTHER_POOLS or one.tag in _ARTIFACTS
                if of_another and one.get("id") not in inside and not _joins(one, definitions, pool, inside):
                    copy.remove(one)
            return copy
    return None


def _joins(association: Node, definitions: Definitions, pool: Participant, inside: set[str]) -> bool:
    """Whether it is an association between things of the pool."""
    if association.tag != f"{_B}association":
        return False
    process = definitions.process(pool.process)
    own = {node.id for node in process.body.walk()} if process is not None else set()
    return all(association.get(end, "") in own | inside for end in ("sourceRef", "targetRef"))


def _inside(definitions: Definitions, pool: str) -> set[str]:
    """Ids of the artifacts that are drawn within a pool."""
    frame = next((shape.bounds for shape in definitions.shapes if shape.element == pool), None)
    artifacts = {one.id for one in definitions.artifacts}
    shapes = [shape for shape in definitions.shapes if shape.element in artifacts]
    return {shape.element for shape in shapes if frame is not None and _holds(frame, shape.bounds)}


def _holds(frame: Bounds, bounds: Bounds) -> bool:
    x, y = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2
    return frame.x <= x <= frame.x + frame.width and frame.y <= y <= frame.y + frame.height


def _needed(root: Node, piece: _Piece) -> list[Node]:
    """What stands at the root and is referred to, directly or through one another; in document order."""
    roots = [one for one in root.iterchildren("*") if one.tag not in _OF_THE_FILE]
    homes = {id: one for one in roots for inner in one.iter("*") if (id := inner.get("id"))}
    homes.update({one.get("id", ""): one for one in roots})
    found: dict[Node, None] = {}
    waiting = list(piece.elements())
    for element in waiting:
        for reference in _references(element):
            home = find(homes, reference)
            if home is not None and home not in found:
                found[home] = None
                waiting.extend(home.iter("*"))
    for one in root.iterchildren(f"{_B}correlationProperty"):
        if any(find({shared.get("id", ""): 1 for shared in found}, inner.get("messageRef")) for inner in one.iter("*")):
            found[one] = None
    return [one for one in root.iterchildren("*") if one in found]


def _diagram(diagram: Node, kept: set[str], process: str, root: Node) -> Node | None:
    """The part of a diagram that shows what is kept. The plane of a lost collaboration becomes the process'."""
    copy = deepcopy(diagram)
    plane = copy.find(_PLANE)
    if plane is None:
        return None
    for one in list(plane.iterchildren("*")):
        if one.get("bpmnElement") is not None and find(dict.fromkeys(kept, True), one.get("bpmnElement")) is None:
            plane.remove(one)
    shown = plane.get("bpmnElement", "")
    if shown not in kept:
        if not any(one.get("id") == shown for one in root.iterchildren(_COLLABORATION)) or not len(plane):
            return None
        plane.set("bpmnElement", process)
    return copy


# ---- types -----------------------------------------------------------------------------------------------------------


def _write_types(element: Node, process: Process, types: Mapping[str, str]) -> None:
    by_id = {one.get("id"): one for one in element.iter("*") if one.tag.startswith(_B)}
    for node in process.body.walk():
        topics = [topic for topic, _ in topics_of(node)]
        if all(topic.type is not None or topic.qualified not in types for topic in topics):
            continue
        holders = _holders(by_id[node.id], node, len(topics))
        for topic, holder in zip(topics, holders, strict=True):
            if topic.type is None and topic.qualified in types:
                _add_property(holder, "type", types[topic.qualified])


def _holders(element: Node, node: FlowNode, count: int) -> list[Node]:
    """Where the type of each topic of a node is written: on the node if it has one, else on each definition."""
    if count == 1:
        return [element]
    tags = (f"{_B}signalEventDefinition", f"{_B}messageEventDefinition")
    return [one for one in element.iterchildren("*") if one.tag in tags]


def _add_property(element: Node, name: str, value: str) -> None:
    """A Camunda property, as Camunda Modeler writes it."""
    extensions = element.find(_EXTENSION_ELEMENTS)
    if extensions is None:
        extensions = etree.Element(_EXTENSION_ELEMENTS)
        element.insert(len(element.findall(f"{_B}documentation")), extensions)
    properties = extensions.find(f"{{{CAMUNDA}}}properties")
    if properties is None:
        properties = etree.SubElement(extensions, f"{{{CAMUNDA}}}properties", nsmap={"camunda": CAMUNDA})
    etree.SubElement(properties, f"{{{CAMUNDA}}}property", {"name": name, "value": value})


# ---- ids -------------------------------------------------------------------------------------------------------------


def _is_reference(name: str) -> bool:
    return name in ("default", "bpmnElement") or name.endswith("Ref")


def _references(element: Node) -> Iterator[str]:
    for name, value in element.items():
        if _is_reference(str(name)):
            yield str(value)
    if element.tag.endswith(("Ref", "Refs")):
        yield text_of(element)


def _make_unique(piece: _Piece, taken: set[str]) -> None:
    """Gives ids that are taken a number, wherever the piece uses them."""
    renamed: dict[str, str] = {}
    own = {id for one in piece.everything() if (id := one.get("id"))}
    for id in sorted(own & taken):
        number = 2
        while f"{id}_{number}" in taken | own:
            number += 1
        renamed[id] = f"{id}_{number}"
    taken |= own | set(renamed.values())
    for element in piece.everything() if renamed else ():
        _rename(element, renamed)
    piece.ids = {id: renamed.get(id, id) for id in piece.ids}


def _rename(element: Node, renamed: Mapping[str, str]) -> None:
    for name, value in element.items():
        new = find(renamed, str(value)) if name == "id" or _is_reference(str(name)) else None
        if new is not None:
            element.set(name, new)
    if element.tag.endswith(("Ref", "Refs")) or element.tag in (f"{_B}incoming", f"{_B}outgoing"):
        element.text = find(renamed, text_of(element)) or element.text


def _point_calls(piece: _Piece, ids: Mapping[str, str]) -> None:
    """Makes every call activity name the process as it is called in the new file."""
    for element in piece.elements():
        for tag, attribute in _CALLS:
            value = element.get(attribute) if element.tag == tag else None
            if value is not None and value.strip() in ids:
                element.set(attribute, ids[value.strip()])


_CALLS = (
    (f"{_B}callActivity", "calledElement"),
    (f"{{{ZEEBE}}}calledElement", "processId"),
    (f"{{{CALL}}}process", "process"),
)


# ---- the new file ----------------------------------------------------------------------------------------------------


def _new_root(home: Node, others: Iterable[Node]) -> Node:
    prefixes: dict[str | None, str] = {"camunda": CAMUNDA}
    for other in (*others, home):
        prefixes.update({prefix: uri for prefix, uri in other.nsmap.items() if prefix or other is home})
    root = etree.Element(home.tag, dict(home.attrib), nsmap=prefixes)  # type: ignore[arg-type, misc]
    for one in home.iterchildren(f"{_B}documentation", _EXTENSION_ELEMENTS):
        root.append(deepcopy(one))
    return root


def _assemble(pieces: list[_Piece]) -> Node:
    root = _new_root(pieces[0].root, [piece.root for piece in pieces[1:]])
    parts = [piece.collaboration for piece in pieces if piece.collaboration is not None]
    parts += [one for piece in pieces for one in piece.processes]
    parts += [one for piece in pieces for one in piece.shared]
    parts += [one for piece in pieces for one in piece.diagrams]
    for part in parts:
        _keep_types_readable(part, root)
        root.append(part)
    etree.indent(root, "  ")
    return root


def _keep_types_readable(part: Node, root: Node) -> None:
    """``xsi:type`` holds a prefix in its value: that of the new file."""
    prefix = next((prefix for prefix, uri in root.nsmap.items() if uri == BPMN), None)
    for element in part.iter("*"):
        value = element.get(_XSI_TYPE)
        if value is not None:
            bare = value.rpartition(":")[2]
            element.set(_XSI_TYPE, f"{prefix}:{bare}" if prefix else bare)
