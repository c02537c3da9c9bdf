"""Reads a .bpmn file into the neutral model, and writes it back.

::

    xml            bytes -> a tree, from an untrusted source
    preparation    embedded processes and message flows, resolved in the tree
    document       the file: collaboration, processes, root elements, and the diagram interchange
    scope          the flow elements of a process or sub-process, with checks of their references
    flow_nodes     what all flow nodes have in common
    activities, events, data      the elements of a scope
    expressions    the language of each expression
    dialects       the meaning of extension elements

Elements are found by namespace, whatever the prefix. References are resolved while reading. What prevents a process
from being executed is a fault of that process, so that an incomplete model can be drawn, written and checked. What is
doubtful, or has no effect, is a note of the model. A ModelError (file, line, element) is raised only for a file that is
not BPMN 2.0, or in which two elements have the same id.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Literal

from fame.bpmn.model import Artifact, Bounds, Definitions, Edge, Element, MessageFlow, Note, Participant, Process, Shape
from fame.bpmn.reader.connections import check_single_parts
from fame.bpmn.reader.context import Context, boolean_attribute, boolean_property, whole_number
from fame.bpmn.reader.data import data_elements, data_ids, data_variables, shared_stores
from fame.bpmn.reader.dialects import is_original_fame, note_misspelt_namespaces, read_extensions
from fame.bpmn.reader.flow_nodes import ProcessContext, documentation
from fame.bpmn.reader.preparation import prepare
from fame.bpmn.reader.scope import read_body
from fame.bpmn.reader.xml import (
    BPMN,
    BPMNDI,
    DC,
    DI,
    Node,
    attributes,
    children,
    line_of,
    local_name,
    parse,
    parts_of,
    read_file,
    resolve,
    text_of,
)
from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError, ModelError, expect
from fame.text import as_number, unreadable, write_file

_ROOTS_WITHOUT_EFFECT = ("choreography", "globalChoreographyTask", "conversation")
_ENCODING = re.compile(r"""\sencoding\s*=\s*(["'])[^"']*\1""")
_MULTI_INSTANCE = re.compile("multiplicity|multiinstance|multi_instance", re.IGNORECASE)


def read(source: str | PathLike[str] | bytes | Definitions, *, file: str = "") -> Definitions:
    """Return the model of a file, given by its path or its content (bytes). Errors about content refer to it as `file`.

    A model is returned unchanged. Processes that cannot be executed are read too: see `fame.bpmn.model.Process.faults`.
    Raises ModelError if the file cannot be read or is not BPMN 2.0, ConfigError if `source` has another type.
    """
    if isinstance(source, Definitions):
        return source
    if isinstance(source, bytes):
        return read_bytes(source, file=file)
    a_path = isinstance(source, str | PathLike) and not str(source).lstrip().startswith("<")
    expect(a_path, "source", source, "a path, bytes, or fame.bpmn.read_text(text)")
    path = Path(source)
    try:
        content = read_file(path)
    except OSError as error:
        raise ModelError(unreadable(error), file=str(path)) from None
    return _read_content(content, file or str(path))


@lru_cache(maxsize=32)
def _read_content(content: bytes, file: str) -> Definitions:
    """The model of the content of a file; many runs and tests read the same ones, and models are immutable."""
    return read_bytes(content, file=file)


def read_text(text: str, *, file: str = "", sent: bool = False) -> Definitions:
    """As `read`, for the content as text. An encoding that it declares is ignored.

    `sent`: it came as a message; `file` is a name for people, and called processes are not looked for beside it.
    """
    declaration, end, rest = text.partition("?>")
    if declaration.lstrip("\ufeff").startswith("<?xml"):
        declaration = _ENCODING.sub("", declaration, count=1)
    found = read_bytes((declaration + end + rest).encode(errors="surrogatepass"), file=file)
    return replace(found, sent=True) if sent else found


def read_bytes(source: bytes, *, file: str = "") -> Definitions:
    """As `read`, for the content as bytes."""
    return read_tree(parse(source, file), source, file)


def read_tree(root: Node, source: bytes, file: str) -> Definitions:
    """As `read`, for a parsed file without comments. Elements without an id get one in the tree."""
    context = Context(file)
    prepare(context, root)
    context.roots = {id: one for one in root.iterchildren(f"{{{BPMN}}}*") if (id := one.get("id")) and _is_shared(one)}
    note_misspelt_namespaces(context, root, source)
    context.language = root.get("expressionLanguage", "")
    context.original = is_original_fame(root)
    for one in context.roots.values():
        context.register(one)
    for one in root.iter(f"{{{BPMN}}}association"):
        context.add_association(one)
    processes = tuple(_process(context, one) for one in children(root, "process"))
    return _definitions(context, source, root, processes)


def _is_shared(element: Node) -> bool:
    return local_name(element) not in ("process", "collaboration")


def _definitions(context: Context, source: bytes, root: Node, processes: tuple[Process, ...]) -> Definitions:
    participants, flows, artifacts, ids = [], [], list(_artifacts(context, root)), []
    for collaboration in children(root, "collaboration"):
        ids.append(context.register(collaboration))
        participants += [_participant(context, one, processes) for one in children(collaboration, "participant")]
        read = (_message_flow(context, one) for one in children(collaboration, "messageFlow"))
        flows += [flow for flow in read if flow is not None]
    for one in root.iter(f"{{{BPMN}}}association"):
        context.register(one)
    for name in _ROOTS_WITHOUT_EFFECT:
        for one in children(root, name):
            context.note(one, f"<{name}> has no effect", "warning")
    diagrams = read_diagrams(context, root)
    for fault in context.take_faults():  # outside of processes
        context.notes.append(Note("warning", fault.text, fault.element, fault.line, name=fault.name))
    return Definitions(
        file=context.file,
        source=source,
        processes=processes,
        collaboration=next(iter(ids), ""),
        participants=tuple(participants),
        message_flows=tuple(flows),
        shapes=tuple(diagrams.shapes),
        edges=tuple(diagrams.edges),
        planes=tuple(diagrams.planes),
        artifacts=tuple(artifacts),
        notes=tuple(context.notes),
    )


def _process(context: Context, element: Node) -> Process:
    found, parts, stores = read_extensions(context, element), parts_of(element), list(shared_stores(context, element))
    for store in stores:
        name = " ".join(store.get("name", "").split()) or store.get("id")
        context.note(element, f"the data store {name!r} is shared with another pool: each robot has its own copy")
    parts["dataStoreReference"] = [*parts.get("dataStoreReference", ()), *stores]
    data = data_elements(element, stores)
    topics, instances, semantics, fields = map(found.take, ("topics", "instances", "semantics", "fields"))
    optional = found.take("optional")
    for name, given, choices in (
        ("topics", topics, ("signals", "labels")),
        ("semantics", semantics, ("standard", "original")),
        ("fields", fields, ("associations", "prefix")),
    ):
        if given is not None and given.value.strip() not in choices:
            context.fault(element, f"{name}={given.value!r}: expected {' or '.join(choices)}")
    meaning: Literal["standard", "original"] = "standard"
    if semantics is not None and semantics.value.strip() == "original":
        meaning = "original"
    process = ProcessContext(
        context, data_ids(data), data_variables(data), topics is not None and topics.value.strip() == "labels"
    )
    body = read_body(process, element, parts)
    check_single_parts(context, element)
    executable = boolean_attribute(context, element, "isExecutable", True)
    bound = whole_number(context, element, "instances", instances.value, 1) if instances is not None else None
    is_optional = boolean_property(context, element, "optional", optional.value) if optional is not None else False
    return Process(
        id=context.register(element),
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element),
        body=body,
        executable=executable,
        instances=bound,
        optional=is_optional,
        faults=context.take_faults(),
        semantics=meaning,
        by_prefix=fields.value.strip() == "prefix" if fields is not None else context.original,
        lanes=tuple(_lanes(context, element)),
        properties=found.remaining(),
    )


def _lanes(context: Context, process: Node) -> Iterator[Element]:
    for lane in process.iter(f"{{{BPMN}}}lane"):
        yield Element(
            id=context.register(lane), name=lane.get("name", ""), line=line_of(lane), documentation=documentation(lane)
        )


def _participant(context: Context, element: Node, processes: tuple[Process, ...]) -> Participant:
    reference = element.get("processRef", "").strip()
    process = resolve({one.id: one for one in processes}, reference)
    found = read_extensions(context, element)
    marks = [one for one in element.iterdescendants() if _is_multi_instance_mark(one)]
    marked = bool(marks) or any(_MULTI_INSTANCE.search(name) for name in found.properties)
    return Participant(
        id=context.register(element),
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element),
        process=process.id if process is not None else reference,
        multi_instance=marked,
        minimum=max([1, *_numbers(marks, "minimum")]),
        maximum=min(_numbers(marks, "maximum"), default=None),
        properties=found.remaining(),
    )


def _is_multi_instance_mark(element: Node) -> bool:
    """Whether an element marks a pool as multi-instance. A participantMultiplicity of at most one does not."""
    return _MULTI_INSTANCE.search(local_name(element)) is not None and element.get("maximum", "").strip() not in (
        "0",
        "1",
    )


def _numbers(marks: Sequence[Node], attribute: str) -> list[int]:
    """The numbers in an attribute of the marks; ``unbounded`` and the like are skipped."""
    texts = [one.get(attribute, "").strip() for one in marks]
    return [int(text) for text in texts if re.fullmatch("[0-9]{1,9}", text)]


def _message_flow(context: Context, element: Node) -> MessageFlow | None:
    id, ends = context.register(element), []
    for name, preposition in (("sourceRef", "from"), ("targetRef", "to")):
        reference = element.get(name, "")
        end = resolve(context.elements, reference)
        if end is None:
            context.fault(element, f"the message flow goes {preposition} {reference!r}: there is no such element")
            return None
        ends.append(end.get("id", ""))
    return MessageFlow(
        id=id,
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element),
        source=ends[0],
        target=ends[1],
    )


def _artifacts(context: Context, root: Node) -> Iterator[Artifact]:
    ends = [(one.get("sourceRef", ""), one.get("targetRef", "")) for one in root.iter(f"{{{BPMN}}}association")]
    for one in root.iter(f"{{{BPMN}}}textAnnotation"):
        text, id = "\n".join(text_of(inner) for inner in children(one, "text")), one.get("id", "")
        about = tuple(a if b == id else b for a, b in ends if id and id in (a, b))
        yield Artifact(id=context.register(one), name=text, line=line_of(one), kind="annotation", about=about)
    values = {one.get("id", ""): one for one in root.iter(f"{{{BPMN}}}categoryValue")}
    for one in root.iter(f"{{{BPMN}}}group"):
        value = resolve(values, one.get("categoryValueRef"))
        name = value.get("value", "") if value is not None else one.get("name", "")
        yield Artifact(id=context.register(one), name=name, line=line_of(one), kind="group")


def write(definitions: Definitions, path: str | Path | None = None) -> bytes:
    """Return the XML of a model, byte for byte as it was read. Also write it to `path`, if given.

    A file holds more than the model (comments, unknown extensions), so changes are made in the file. Raises ModelError
    if the model was changed after reading or if `path` cannot be written, ConfigError if `definitions` is not a model.
    """
    expect(isinstance(definitions, Definitions), "definitions", definitions, "a model, as returned by fame.read")
    if not definitions.source or read_bytes(definitions.source, file=definitions.file) != definitions:
        raise ModelError("the model was changed after reading: change the file instead", file=definitions.file)
    if path is not None:
        try:
            Path(path).parent.stat()  # no folder is made
            write_file(path, definitions.source)
        except (OSError, ConfigError) as error:
            text = error.text if isinstance(error, ConfigError) else f"cannot be written: {error.strerror}"
            raise ModelError(text, file=str(path)) from None
    return definitions.source


_SHAPE, _EDGE, _LABEL = f"{{{BPMNDI}}}BPMNShape", f"{{{BPMNDI}}}BPMNEdge", f"{{{BPMNDI}}}BPMNLabel"
_BOUNDS, _WAYPOINT = f"{{{DC}}}Bounds", f"{{{DI}}}waypoint"
_FAR = 1e9
"""Larger coordinates are invalid, as are NaN and infinity."""
_STROKES = (
    "{http://www.omg.org/spec/BPMN/non-normative/color/1.0}border-color",
    "{http://bpmn.io/schema/bpmn/biocolor/1.0}stroke",
)
_FILLS = (
    "{http://www.omg.org/spec/BPMN/non-normative/color/1.0}background-color",
    "{http://bpmn.io/schema/bpmn/biocolor/1.0}fill",
)


@dataclass(slots=True)
class Diagrams:
    """The shapes and edges of all diagrams of a file."""

    planes: list[str] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)


def read_diagrams(context: Context, root: Node) -> Diagrams:
    """Read all diagrams, after all other elements. Invalid shapes and edges get a note."""
    found = Diagrams()
    for plane in root.iterchildren(f"{{{BPMNDI}}}BPMNDiagram"):
        for surface in plane.iterchildren(f"{{{BPMNDI}}}BPMNPlane"):
            number = len(found.planes)
            shown = resolve(context.elements, surface.get("bpmnElement"))
            found.planes.append(shown.get("id", "") if shown is not None else "")
            for one in surface:
                if one.tag == _SHAPE or one.tag == _EDGE:
                    _read(context, one, number, found)
    return found


def _read(context: Context, one: Node, plane: int, found: Diagrams) -> None:
    reference = one.get("bpmnElement")
    shown = resolve(context.elements, reference)
    shown = context.find_in_file(one, reference) if shown is None else shown
    if shown is None:
        what = f"{reference!r}: the file has no such element" if reference else "something without a bpmnElement"
        context.note(one, f"the diagram shows {what}", "warning")
    elif one.tag == _SHAPE:
        shape = _shape(context, one, plane, shown)
        found.shapes += [shape] if shape is not None else []
    else:
        edge = _edge(context, one, plane, shown)
        found.edges += [edge] if edge is not None else []


def _shape(context: Context, one: Node, plane: int, shown: Node) -> Shape | None:
    bounds = label = None
    for part in one:
        if part.tag == _BOUNDS:
            bounds = _bounds(context, part)
        elif part.tag == _LABEL:
            label = _label(context, part)
    colours = len(attributes(one)) > 2
    if bounds is None:
        _note(context, one, "the shape has no bounds, so it is not drawn")
        return None
    return Shape(
        element=shown.get("id", ""),
        bounds=bounds,
        label=label,
        horizontal=boolean_attribute(context, one, "isHorizontal", True),
        expanded=boolean_attribute(context, one, "isExpanded"),
        marker_visible=boolean_attribute(context, one, "isMarkerVisible"),
        kind=local_name(shown),
        plane=plane,
        stroke=_colour(one, _STROKES) if colours else "",
        fill=_colour(one, _FILLS) if colours else "",
        name=shown.get("name", ""),
        band=one.get("participantBandKind", ""),
    )


def _edge(context: Context, one: Node, plane: int, shown: Node) -> Edge | None:
    points, label = [], None
    for part in one:
        if part.tag == _WAYPOINT:
            point = _point(context, part)
            points += [point] if point is not None else []
        elif part.tag == _LABEL:
            label = _label(context, part)
    if len(points) < 2:
        _note(context, one, "the edge has fewer than two way points, so it is not drawn")
        return None
    kind = local_name(shown)
    return Edge(
        element=shown.get("id", ""),
        waypoints=tuple(points),
        label=label,
        kind=kind,
        plane=plane,
        stroke=_colour(one, _STROKES) if len(attributes(one)) > 2 else "",
        directed=kind != "association" or shown.get("associationDirection", "None") != "None",
    )


def _label(context: Context, element: Node) -> Bounds | None:
    bounds = element.find(_BOUNDS)
    return _bounds(context, bounds) if bounds is not None else None


def _bounds(context: Context, element: Node) -> Bounds | None:
    x, y, width, height = (as_number(element.get(name) or "0") for name in ("x", "y", "width", "height"))
    if not -_FAR < x + y + width + height < _FAR:
        _note(context, element, f"bounds {', '.join(map(str, element.values()))}: expected four numbers")
        return None
    return Bounds(x, y, width, height)


def _point(context: Context, element: Node) -> tuple[float, float] | None:
    x, y = (as_number(element.get(name) or "0") for name in ("x", "y"))
    if not -_FAR < x + y < _FAR:
        _note(context, element, f"way point {', '.join(map(str, element.values()))}: expected two numbers")
        return None
    return x, y


def _colour(element: Node, names: tuple[str, ...]) -> str:
    return next((element.get(name, "") for name in names if element.get(name)), "")


def _note(context: Context, element: Node, text: str) -> None:
    holder: Node | None = element
    while holder is not None and holder.get("bpmnElement") is None:
        holder = holder.getparent()
    shown = holder.get("bpmnElement", "") if holder is not None else ""
    context.notes.append(Note("warning", f"diagram: {text}", shown, line_of(element)))
