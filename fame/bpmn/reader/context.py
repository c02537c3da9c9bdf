"""What the readers of one file share: what is wrong and where, which ids are taken, what the file has at its root."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from fame.bpmn.model import Fault, Note
from fame.bpmn.reader.xml import Node, line_of, local_name, resolve
from fame.errors import ModelError

T = TypeVar("T")

_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_PARTS = ("Expression", "Definition", "Characteristics", "ondition", "Cardinality", "Duration", "Date", "Cycle", "Path")
"""Endings of tags within an event, activity or flow: modelers give such elements ids, and show them nowhere."""
_TYPE = re.compile(r"([A-Za-z]\w*)/(?:(msg|srv|action)/)?([A-Za-z]\w*)")


@dataclass(slots=True)
class Context:
    """Of one file.

    `roots`: signals, messages, errors ... by id; `language`: its expressionLanguage; `elements`: what has been read;
    `original`: it is one of the original FaMe's, by its looks; `associations`: those that begin at an element, by its
    id; `faults`: why what is being read cannot be executed.
    """

    file: str
    roots: dict[str, Node] = field(default_factory=dict)
    language: str = ""
    original: bool = False
    notes: list[Note] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    associations: dict[str, list[Node]] = field(default_factory=dict)
    _ids: dict[str, Node] | None = None
    elements: dict[str, Node] = field(default_factory=dict)

    def error(self, element: Node, text: str) -> ModelError:
        """The error to raise at an element."""
        id, name = id_and_name(element)
        return ModelError(text, file=self.file, line=line_of(element), element=id, name=name)

    def fault(self, element: Node, text: str) -> None:
        """Something that is wrong with an element: its process can be read, drawn and written, but not executed."""
        id, name = id_and_name(element)
        self.faults.append(Fault(text, id, line_of(element), name))

    def take_faults(self) -> tuple[Fault, ...]:
        """Those found since this was last asked, in the order of their lines."""
        found, self.faults = sorted(self.faults, key=lambda one: one.line), []
        return tuple(dict.fromkeys(found))

    def note(
        self, element: Node, text: str, level: Literal["warning", "note", "reading"] = "note", quirk: bool = False
    ) -> None:
        """Something to tell that stops nothing."""
        id, name = id_and_name(element)
        self.notes.append(Note(level, text, id, line_of(element), quirk, name))

    def quirk(self, element: Node, text: str) -> None:
        """A habit of the tool that wrote the file, and what it is read as: told to those who ask for it."""
        self.note(element, text, "reading", quirk=True)

    def register(self, element: Node) -> str:
        """Its id, now taken; made from tag and line where the standard lets it have none."""
        id = element.get("id") or self._made_up(element)
        other = self.elements.setdefault(id, element)
        if other is not element:
            text = f"two elements have this id, the other one in line {line_of(other)}: ids are unique"
            raise self.error(element, text)
        return id

    def _made_up(self, element: Node) -> str:
        stem, number = f"{local_name(element)}_{line_of(element)}", 1
        id = stem
        while id in self.elements:
            number += 1
            id = f"{stem}_{number}"
        element.set("id", id)
        return id

    def add_association(self, association: Node) -> None:
        """Find it by the element that it begins at from now on."""
        source = association.get("sourceRef", "").strip()
        for id in {source, source.rpartition(":")[2]}:
            self.associations.setdefault(id, []).append(association)

    def find_in_file(self, element: Node, reference: str | None) -> Node | None:
        """What a reference names in the whole file of an element, read or not."""
        if self._ids is None:
            found = list(element.getroottree().getroot().iter("*"))
            self._ids = {id: one for one in reversed(found) if (id := one.get("id"))}
        return resolve(self._ids, reference)

    def root(self, reference: str | None) -> Node | None:
        """The root element that a reference names, if there is one."""
        return resolve(self.roots, reference)


def id_and_name(element: Node) -> tuple[str, str]:
    """Id and name of the nearest element that modelers show, else of any around it that has an id, else its tag."""
    shown, root = None, element.getroottree().getroot()
    for one in (element, *element.iterancestors()):
        if one.get("id") and one is not root:
            shown = one
            if not local_name(one).endswith(_PARTS):
                break
    return (shown.get("id", ""), shown.get("name", "")) if shown is not None else (f"<{local_name(element)}>", "")


def boolean_attribute(context: Context, element: Node, name: str, default: bool = False) -> bool:
    """An attribute of type xsd:boolean."""
    text = element.get(name)
    if text is None:
        return default
    if text.strip() not in _BOOLEANS:
        context.fault(element, f"{name}={text!r}: expected true or false")
    return _BOOLEANS.get(text.strip(), default)


def boolean_property(context: Context, element: Node, name: str, text: str) -> bool:
    """A property that is true or false."""
    if text.strip().lower() not in _BOOLEANS:
        context.fault(element, f"property {name}={text!r}: expected true or false")
    return _BOOLEANS.get(text.strip().lower(), False)


def whole_number(context: Context, element: Node, name: str, text: str, least: int) -> int:
    """A property or attribute that is a whole number of at least `least`."""
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if number < least:
        context.fault(element, f"{name}={text!r}: expected a whole number, {least} or more")
    return max(number, least)


def message_type(context: Context, element: Node, text: str, kind: str = "msg") -> str | None:
    """A message or service type as ``pkg/msg/Type``; ``pkg/Type`` is taken as that."""
    match = _TYPE.fullmatch(text.strip())
    if match is None:
        context.fault(element, f"type={text!r}: expected pkg/{kind}/Type, such as std_msgs/msg/String")
        return None
    return f"{match[1]}/{match[2] or kind}/{match[3]}"


def is_message_type(text: str) -> bool:
    """Whether a text looks like a full message type, ``pkg/msg/Type``."""
    match = _TYPE.fullmatch(text.strip())
    return match is not None and match[2] is not None
