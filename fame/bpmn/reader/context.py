"""The state that the readers of one file share: faults and notes, registered ids, root elements."""

from __future__ import annotations

import re
from collections import Counter
from typing import Literal, TypeVar

from fame.bpmn.model import ModelFault, Note
from fame.bpmn.reader.xml import Node, ids_in, invented_id, line_of, local_name, resolve
from fame.dataclasses import dataclass, field
from fame.errors import ModelError

T = TypeVar("T")

_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_PARTS = ("Expression", "Definition", "Characteristics", "ondition", "Cardinality", "Duration", "Date", "Cycle", "Path")
"""Endings of tags inside an event, activity or flow: these elements have ids that modelers do not show."""
_TYPE = re.compile(r"([A-Za-z]\w*)/(?:(msg|srv|action)/)?([A-Za-z]\w*)")


@dataclass(slots=True)
class Context:
    """The state of reading one file.

    roots          signals, messages, errors ... by id
    language       the expressionLanguage of the file
    original       whether it is a file of the original FaMe
    notes          remarks about the file
    faults         reasons why the process that is being read cannot be executed
    associations   id -> the associations that start there
    elements       id -> the elements read so far
    """

    file: str
    roots: dict[str, Node] = field(default_factory=dict)
    language: str = ""
    original: bool = False
    notes: list[Note] = field(default_factory=list)
    faults: list[ModelFault] = field(default_factory=list)
    associations: dict[str, list[Node]] = field(default_factory=dict)
    _ids: dict[str, Node] | None = None
    _taken: Counter[str] | None = None
    elements: dict[str, Node] = field(default_factory=dict)

    def error(self, element: Node, text: str) -> ModelError:
        """Return the ModelError of an element, to be raised."""
        id, name = id_and_name(element)
        return ModelError(text, file=self.file, line=line_of(element), element=id, name=name)

    def fault(self, element: Node, text: str) -> None:
        """Record a fault: the process can be read, drawn and written, but not executed."""
        id, name = id_and_name(element)
        self.faults.append(ModelFault(text, id, line_of(element), name))

    def take_faults(self) -> tuple[ModelFault, ...]:
        """Return the faults since the last call, by line, and clear them."""
        found, self.faults = sorted(self.faults, key=lambda one: one.line), []
        return tuple(dict.fromkeys(found))

    def note(
        self, element: Node, text: str, level: Literal["warning", "note", "reading"] = "note", quirk: bool = False
    ) -> None:
        """Record a remark that does not prevent execution."""
        id, name = id_and_name(element)
        self.notes.append(Note(level, text, id, line_of(element), quirk, name))

    def quirk(self, element: Node, text: str) -> None:
        """Record how a peculiarity of the tool that wrote the file is read."""
        self.note(element, text, "reading", quirk=True)

    def register(self, element: Node) -> str:
        """Register an element and return its id, generated from tag and line if it has none.

        Raises ModelError if another element has the id.
        """
        id = element.get("id") or self._generate_id(element)
        other = self.elements.setdefault(id, element)
        if other is not element:
            text = f"two elements have this id, the other in line {line_of(other)}: ids must be unique"
            raise self.error(element, text)
        return id

    def _generate_id(self, element: Node) -> str:
        if self._taken is None:
            self._taken = ids_in(element.getroottree().getroot())
        id = invented_id(f"{local_name(element)}_{line_of(element)}", self._taken)
        element.set("id", id)
        return id

    def add_association(self, association: Node) -> None:
        """Register an association under the id of its source."""
        source = association.get("sourceRef", "").strip()
        for id in {source, source.rpartition(":")[2]}:
            self.associations.setdefault(id, []).append(association)

    def find_in_file(self, element: Node, reference: str | None) -> Node | None:
        """Return the element of the whole file that a reference names, also if it has not been read."""
        if self._ids is None:
            found = list(element.getroottree().getroot().iter("*"))
            self._ids = {id: one for one in reversed(found) if (id := one.get("id"))}
        return resolve(self._ids, reference)

    def root(self, reference: str | None) -> Node | None:
        """Return the root element that a reference names, or None."""
        return resolve(self.roots, reference)


def id_and_name(element: Node) -> tuple[str, str]:
    """Id and name of the nearest ancestor (or the element itself) that modelers show, or its tag if none has an id."""
    shown, root = None, element.getroottree().getroot()
    for one in (element, *element.iterancestors()):
        if one.get("id") and one is not root:
            shown = one
            if not local_name(one).endswith(_PARTS):
                break
    return (shown.get("id", ""), shown.get("name", "")) if shown is not None else (f"<{local_name(element)}>", "")


def boolean_attribute(context: Context, element: Node, name: str, default: bool = False) -> bool:
    """Return an attribute of type xsd:boolean. Another value is a fault."""
    text = element.get(name)
    if text is None:
        return default
    if text.strip() not in _BOOLEANS:
        context.fault(element, f"{name}={text!r}: expected true or false")
    return _BOOLEANS.get(text.strip(), default)


def boolean_property(context: Context, element: Node, name: str, text: str) -> bool:
    """Return an extension property that is true or false. Another value is a fault."""
    if text.strip().lower() not in _BOOLEANS:
        context.fault(element, f"property {name}={text!r}: expected true or false")
    return _BOOLEANS.get(text.strip().lower(), False)


def whole_number(context: Context, element: Node, name: str, text: str, least: int) -> int:
    """Return a property or attribute that is a whole number. A number below `least` is a fault."""
    number = int(text) if re.fullmatch(r"\s*[+-]?[0-9]{1,18}\s*", text) else least - 1  # Python also reads 1_0
    if number < least:
        context.fault(element, f"{name}={text!r}: expected a whole number, {least} or more")
    return max(number, least)


def message_type(context: Context, element: Node, text: str, kind: str = "msg") -> str | None:
    """Return a message, service or action type as ``pkg/msg/Type``; ``pkg/Type`` is completed with `kind`.

    None for another text, which is a fault.
    """
    match = _TYPE.fullmatch(text.strip())
    if match is None:
        context.fault(element, f"type={text!r}: expected pkg/{kind}/Type, such as std_msgs/msg/String")
        return None
    return f"{match[1]}/{match[2] or kind}/{match[3]}"


def is_message_type(text: str) -> bool:
    """Return whether a text has the form of a full type, ``pkg/msg/Type``."""
    match = _TYPE.fullmatch(text.strip())
    return match is not None and match[2] is not None
