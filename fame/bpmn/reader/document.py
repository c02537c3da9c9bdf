"""Reads a .bpmn file into the neutral model, and writes it back.

::

    xml            bytes -> a tree, from an untrusted source
    preparation    embedded processes and message flows, resolved in the tree
    document       the file: collaboration, processes, root elements
    diagrams       the diagram interchange: where elements are drawn
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

from fame.bpmn.model import Artifact, Definitions, Element, MessageFlow, Note, Participant, Process
from fame.bpmn.reader.connections import check_single_parts
from fame.bpmn.reader.context import Context, boolean_attribute, boolean_property, whole_number
from fame.bpmn.reader.data import data_elements, data_ids, data_variables, shared_stores
from fame.bpmn.reader.diagrams import read_diagrams
from fame.bpmn.reader.dialects import is_original_fame, note_misspelt_namespaces, read_extensions
from fame.bpmn.reader.dialects.extensions import Extensions
from fame.bpmn.reader.flow_nodes import ProcessContext, documentation
from fame.bpmn.reader.preparation import prepare
from fame.bpmn.reader.scope import read_body
from fame.bpmn.reader.xml import BPMN, Node, children, line_of, local_name, parse, parts_of, read_file, resolve, text_of
from fame.dataclasses import replace
from fame.errors import ConfigError, ModelError, expect
from fame.text import unreadable, write_file

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
    definitions = read_bytes((declaration + end + rest).encode(errors="surrogatepass"), file=file)
    return replace(definitions, sent=True) if sent else definitions


def read_bytes(source: bytes, *, file: str = "") -> Definitions:
    """As `read`, for the content as bytes."""
    return read_tree(parse(source, file), source, file)


def read_tree(root: Node, source: bytes, file: str) -> Definitions:
    """As `read`, for a parsed file without comments. Elements without an id get one in the tree."""
    context = Context(file)
    prepare(context, root)
    context.roots = {
        id: shared
        for shared in root.iterchildren(f"{{{BPMN}}}*")
        if (id := shared.get("id")) and local_name(shared) not in ("process", "collaboration")
    }
    note_misspelt_namespaces(context, root, source)
    context.language = root.get("expressionLanguage", "")
    context.original = is_original_fame(root)
    for shared in context.roots.values():
        context.register(shared)
    for association in root.iter(f"{{{BPMN}}}association"):
        context.add_association(association)
    processes = tuple(_process(context, process) for process in children(root, "process"))
    return _definitions(context, source, root, processes)


def _definitions(context: Context, source: bytes, root: Node, processes: tuple[Process, ...]) -> Definitions:
    participants, flows, artifacts, ids = [], [], list(_artifacts(context, root)), []
    for collaboration in children(root, "collaboration"):
        ids.append(context.register(collaboration))
        participants += [_participant(context, pool, processes) for pool in children(collaboration, "participant")]
        read = (_message_flow(context, flow) for flow in children(collaboration, "messageFlow"))
        flows += [flow for flow in read if flow is not None]
    for association in root.iter(f"{{{BPMN}}}association"):
        context.register(association)
    for name in _ROOTS_WITHOUT_EFFECT:
        for element in children(root, name):
            context.note(element, f"<{name}> has no effect", "warning")
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
    extensions, parts, stores = read_extensions(context, element), parts_of(element), [*shared_stores(context, element)]
    for store in stores:
        name = " ".join(store.get("name", "").split()) or store.get("id")
        context.note(element, f"the data store {name!r} is shared with another pool: each robot has its own copy")
    parts["dataStoreReference"] = [*parts.get("dataStoreReference", ()), *stores]
    data = data_elements(element, stores)
    instances, optional = extensions.take("instances"), extensions.take("optional")
    by_label = _choice(context, element, extensions, "topics", "signals", "labels") == "labels"
    semantics = _choice(context, element, extensions, "semantics", "standard", "original")
    fields = _choice(context, element, extensions, "fields", "associations", "prefix")
    process = ProcessContext(context, data_ids(data), data_variables(data), by_label)
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
        semantics="original" if semantics == "original" else "standard",
        by_prefix=context.original if fields is None else fields == "prefix",
        lanes=tuple(_lanes(context, element)),
        properties=extensions.remaining(),
    )


def _choice(context: Context, element: Node, extensions: Extensions, name: str, *choices: str) -> str | None:
    """The value of a property, or None. Anything but the choices is a fault."""
    given = extensions.take(name)
    if given is None:
        return None
    if given.value.strip() not in choices:
        context.fault(element, f"{name}={given.value!r}: expected {' or '.join(choices)}")
    return given.value.strip()


def _lanes(context: Context, process: Node) -> Iterator[Element]:
    for lane in process.iter(f"{{{BPMN}}}lane"):
        yield Element(
            id=context.register(lane), name=lane.get("name", ""), line=line_of(lane), documentation=documentation(lane)
        )


def _participant(context: Context, element: Node, processes: tuple[Process, ...]) -> Participant:
    reference = element.get("processRef", "").strip()
    process = resolve({process.id: process for process in processes}, reference)
    extensions = read_extensions(context, element)
    marks = [inner for inner in element.iterdescendants() if _is_multi_instance_mark(inner)]
    marked = bool(marks) or any(_MULTI_INSTANCE.search(name) for name in extensions.properties)
    return Participant(
        id=context.register(element),
        name=element.get("name", ""),
        line=line_of(element),
        documentation=documentation(element),
        process=process.id if process is not None else reference,
        multi_instance=marked,
        minimum=max([1, *_numbers(marks, "minimum")]),
        maximum=min(_numbers(marks, "maximum"), default=None),
        properties=extensions.remaining(),
    )


def _is_multi_instance_mark(element: Node) -> bool:
    """Whether an element marks a pool as multi-instance. A participantMultiplicity of at most one does not."""
    return _MULTI_INSTANCE.search(local_name(element)) is not None and element.get("maximum", "").strip() not in (
        "0",
        "1",
    )


def _numbers(marks: Sequence[Node], attribute: str) -> list[int]:
    """The numbers in an attribute of the marks; ``unbounded`` and the like are skipped."""
    texts = [mark.get(attribute, "").strip() for mark in marks]
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
    associations = root.iter(f"{{{BPMN}}}association")
    ends = [(association.get("sourceRef", ""), association.get("targetRef", "")) for association in associations]
    for annotation in root.iter(f"{{{BPMN}}}textAnnotation"):
        text, id = "\n".join(text_of(part) for part in children(annotation, "text")), annotation.get("id", "")
        about = tuple(source if target == id else target for source, target in ends if id and id in (source, target))
        line = line_of(annotation)
        yield Artifact(id=context.register(annotation), name=text, line=line, kind="annotation", about=about)
    values = {value.get("id", ""): value for value in root.iter(f"{{{BPMN}}}categoryValue")}
    for group in root.iter(f"{{{BPMN}}}group"):
        value = resolve(values, group.get("categoryValueRef"))
        name = value.get("value", "") if value is not None else group.get("name", "")
        yield Artifact(id=context.register(group), name=name, line=line_of(group), kind="group")


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
