"""Two versions of a model, compared: in words, as JSON, as a picture; and one version as text for ``git diff``.

What the model says is compared by `fame.bpmn.difference`. Extension elements and attributes that are not in it, those
of other tools and some of BPMN, are compared as XML, whatever the prefixes and the order of attributes, and so are
references to what the file does not have.
"""

from __future__ import annotations

import difflib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from fame.bpmn.difference import ElementChange, difference, elements_of, facts
from fame.bpmn.model import GATEWAYS, PLACES, TASKS, Artifact, Definitions, Edge, Element, Shape
from fame.bpmn.reader.document import read_tree
from fame.bpmn.reader.xml import BPMN, Node, ids_in, invented_id, is_reference, line_of, local_name, parse, text_of
from fame.dataclasses import dataclass, replace
from fame.text import printable

Drawn = TypeVar("Drawn", Shape, Edge)
_SIGNS = {"added": "+", "removed": "-", "changed": "~"}
COLOURS: Mapping[str, tuple[str, str]] = {
    "added": ("#1a7f37", "#e3f4e6"),
    "removed": ("#cf222e", "#ffebe9"),
    "changed": ("#9a6700", "#fff8c5"),
    "moved": ("#0969da", "#ddf4ff"),
}
"""(stroke, fill) of what differs in a picture."""
_OUTSIDE = ("structureRef", "implementationRef")
"""References to what a file need not have."""
_UNREAD: Mapping[str, str] = {
    "targetNamespace": "", "typeLanguage": "http://www.w3.org/2001/XMLSchema", "isClosed": "false",
    "processType": "None", "gatewayDirection": "Unspecified", "isImmediate": "", "startQuantity": "1",
    "completionQuantity": "1", "textFormat": "text/plain",
}  # fmt: skip
"""Attributes of BPMN that no model has -> what they are without being written."""
_ROOT = "definitions"
_SHOWN = "BPMNPlane bpmnElement"
_KNOWN = (f"{{{BPMN}}}", "{http://www.omg.org/spec/", "{http://www.w3.org/")


@dataclass(frozen=True, slots=True)
class ModelDifference:
    """Two versions of a file.

    changes   what was added, removed or changed, in the order of the new version, then what is gone, then elements of
              which only references differ
    moved     what is only drawn in another way
    foreign   what differs only in content of other tools: id -> the element
    faults    what cannot be executed in one version only: (sign, text)
    """

    old: Definitions
    new: Definitions
    changes: tuple[ElementChange, ...]
    moved: tuple[ElementChange, ...]
    foreign: Mapping[str, Element]
    faults: tuple[tuple[str, str], ...]

    @property
    def same(self) -> bool:
        """Whether nothing differs, the drawing included."""
        return not (self.changes or self.moved or self.foreign or self.faults)


def compare(old: Definitions, new: Definitions) -> ModelDifference:
    """Compare two versions of a file."""
    old, new = _with_ids(old, new)
    found, known = difference(old, new), {one.id: one for one in new.elements()}
    faults = [{(one.element, one.text) for each in file.processes for one in each.faults} for file in (old, new)]
    refused = {element for some in faults for element, _ in some}
    told = {one.element.id: one for one in found if one.how != "moved"}
    for id, values in _references_changed(old, new).items():
        change = told.get(id)
        if change is not None and change.how == "changed":
            told[id] = replace(change, values=(*change.values, *values))
        elif change is None and id not in refused:
            element = known.get(id) or Root(id=id, line=line_of(parse(new.source, new.file)) if new.source else 0)
            told[id] = ElementChange(element, "changed", tuple(name for name, _, _ in values), values=tuple(values))
    before, now = (_foreign(file, refused) for file in (old, new))
    foreign = {
        id: known.get(id, Element(id=id)) for id in (*now, *(before.keys() - now)) if before.get(id) != now.get(id)
    }
    return ModelDifference(
        old,
        new,
        tuple(told.values()),
        tuple(one for one in found if one.how == "moved" and one.element.id not in told),
        {id: one for id, one in foreign.items() if id not in told},
        tuple(("-", f"{id}: {text}") for id, text in sorted(faults[0] - faults[1]))
        + tuple(("+", f"{id}: {text}") for id, text in sorted(faults[1] - faults[0])),
    )


def _with_ids(*versions: Definitions) -> list[Definitions]:
    """Models whose elements without an id have one that does not depend on their place: the ends, or the name.

    No element of any version has it already.
    """
    roots = [parse(one.source, one.file) if one.source else None for one in versions]
    ids = Counter({id: 1 for root in roots if root is not None for id in ids_in(root)})
    return [_named(one, root, ids.copy()) for one, root in zip(versions, roots, strict=True)]


def _named(definitions: Definitions, root: Node | None, taken: Counter[str]) -> Definitions:
    before = len(taken)
    for element in root.iter(f"{{{BPMN}}}*") if root is not None else ():
        name = "_".join(filter(None, map(element.get, ("sourceRef", "targetRef", "name"))))
        if not element.get("id") and (name or local_name(element) in (*PLACES, *GATEWAYS, *TASKS)):
            element.set("id", invented_id(f"{local_name(element)}_{name}", taken))
    changed = root is not None and len(taken) > before
    return read_tree(root, definitions.source, definitions.file) if root is not None and changed else definitions


# ---- what the model does not say -------------------------------------------------------------------------------------

_Content = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Root(Element):
    """The root element of a file, which no model has."""

    @property
    def tag(self) -> str:
        """Its BPMN tag."""
        return "root"


def _homes(definitions: Definitions, root: Node, known: Collection[str] = ()) -> Iterator[tuple[Node, str]]:
    """Yield each element and the id of the element of the model that it is a part of, or else ``definitions``."""
    drawn = {one.id for one in definitions.elements()} | set(known)
    homes = dict[Node | None, str]()
    for element in root.iter("*"):
        id = element.get("id", "")
        homes[element] = id if id in drawn else homes.get(element.getparent(), _ROOT)
        yield element, homes[element]


_References = Mapping[tuple[str, str], Counter[tuple[str, bool]]]
"""Id of an element and name of a reference -> the ids, and whether they are told although no model has them."""


def _references(definitions: Definitions) -> _References:
    """The references of a file, and the attributes of other tools at its root."""
    found = defaultdict[tuple[str, str], Counter[tuple[str, bool]]](Counter)
    if not definitions.source:
        return found
    root = parse(definitions.source, definitions.file)
    ids = ids_in(root)
    for name, value in _foreign_attributes(root):
        found[_ROOT, name.rpartition("}")[2]][value, True] += 1
    homes = dict(_homes(definitions, root))
    for element in homes:
        for holder, name, text in _refers(element) if element.tag.startswith(_KNOWN) else ():
            id = text if text in ids else text.rpartition(":")[2]
            if id and name not in _OUTSIDE:
                home, missing = homes[holder], id not in ids
                name = name if holder.get("id") == home else f"{local_name(holder)} {name}"
                found[home, name][id + " (not in the file)" * missing, missing] += 1
    return found


def _refers(element: Node) -> Iterator[tuple[Node, str, str]]:
    """The references in the attributes and the text of an element: what refers, by which name, to what."""
    yield from ((element, str(name), str(value).strip()) for name, value in element.items() if is_reference(str(name)))
    tag, holder = local_name(element), element.getparent()
    if holder is not None and (tag.endswith(("Ref", "Refs")) or tag in ("incoming", "outgoing")):
        yield holder, tag, (element.text or "").strip()


def _references_changed(old: Definitions, new: Definitions) -> dict[str, list[tuple[str, str, str]]]:
    """By element, what refers to something that one of the versions does not have, or shows it: name, old, new."""
    before, now = _references(old), _references(new)
    found = dict[str, list[tuple[str, str, str]]]()
    for id, name in dict.fromkeys((*now, *before)):
        was, becomes = before.get((id, name), Counter()), now.get((id, name), Counter())
        gone, come = sorted(was - becomes), sorted(becomes - was)
        if any(told for _, told in (*gone, *come)) or (name == _SHOWN and gone and come):
            texts = [", ".join(text for text, _ in each) for each in (gone, come)]
            found.setdefault(id, []).append((name, texts[0], texts[1]))
    return found


def _foreign(definitions: Definitions, whole: Collection[str] = ()) -> dict[str, _Content]:
    """The content of other tools in each element that has some, and documentation that no model has, by id; all of
    those that cannot be executed (`whole`).

    What is in a part of an element (a data input, a timer) is that of the element.
    """
    found = dict[str, list[_Content]]()
    told = {one.id: one.documentation for one in definitions.elements()}
    root = parse(definitions.source, definitions.file) if definitions.source else None
    for element, home in _homes(definitions, root, whole) if root is not None else ():
        if not element.tag.startswith(f"{{{BPMN}}}"):
            continue
        holders = element.findall(f"{{{BPMN}}}extensionElements")
        content: list[_Content] = [] if element is root else sorted(_foreign_attributes(element))
        content += [_content(one) for holder in holders for one in holder]
        is_untold = local_name(element) == "documentation" and text_of(element).strip() not in told.get(home, "")
        content += [_content(element)] * (element.get("id", "") in whole or is_untold)
        if content:
            found.setdefault(home, []).extend(content)
    return {id: tuple(sorted(content, key=repr)) for id, content in found.items()}


def _foreign_attributes(element: Node) -> list[tuple[str, str]]:
    """Name with namespace, and value, of each attribute of another tool, and of those of BPMN that no model has."""
    named = ((str(name), str(value)) for name, value in element.items())
    return [
        (name, value)
        for name, value in named
        if (name[0] == "{" and not name.startswith(_KNOWN)) or _UNREAD.get(name, value) != value
    ]


def _content(element: Node) -> _Content:
    """An element with all that is in it, to be compared with another one."""
    attributes = sorted(
        (str(name), str(value).rpartition(":")[2] if is_reference(str(name)) else str(value))
        for name, value in element.items()
        if not str(name).startswith("{http://www.w3.org/")
    )
    text = " ".join((element.text or "").split()) if len(element) else (element.text or "").strip()
    return (element.tag, attributes, text, sorted((_content(one) for one in element), key=repr))


# ---- in words --------------------------------------------------------------------------------------------------------


def lines(found: ModelDifference) -> Iterator[str]:
    """Yield the comparison in lines of text."""
    for change in found.changes:
        yield f"{_SIGNS[change.how]} {_kind(change.element)} {change.element.display_name}  {_place(found, change)}"
        for name, old, new in change.values:
            yield from (f"    {line}" for line in _value(name, old, new))
    for sign, text in found.faults:
        yield f"{sign} cannot be executed: {text}"
    if found.foreign:
        names = ", ".join(one.display_name for one in found.foreign.values())
        number = _number(len(found.foreign), "element")
        yield f"{number} with other extensions or documentation, the same for FAME: {names}"
    if found.moved:
        names = ", ".join(one.element.display_name for one in found.moved)
        yield f"{_number(len(found.moved), 'shape')} moved: {names}"


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _kind(element: Element) -> str:
    return element.kind if isinstance(element, Artifact) else "lane" if type(element) is Element else element.tag


def _place(found: ModelDifference, change: ElementChange) -> str:
    file = (found.old if change.how == "removed" else found.new).file
    return f"{file}:{change.element.line}"


def _value(name: str, old: str, new: str) -> Iterator[str]:
    """A value that has changed: on one line, or line by line as ``diff`` shows it."""
    if "\n" not in old + new:
        yield f"{name}: {printable(old) or 'none'} → {printable(new) or 'none'}"
        return
    yield f"{name}:"
    for line in list(difflib.unified_diff(old.splitlines(), new.splitlines(), lineterm="", n=2))[2:]:
        yield f"  {printable(line)}"


def as_json(found: ModelDifference) -> dict[str, Any]:
    """Return the comparison as an object of JSON."""
    return {
        "same": found.same,
        "changes": [
            {
                "how": change.how,
                "tag": _kind(change.element),
                "id": change.element.id,
                "name": change.element.name,
                "file": (found.old if change.how == "removed" else found.new).file,
                "line": change.element.line,
                "values": [{"name": name, "old": old, "new": new} for name, old, new in change.values],
            }
            for change in found.changes
        ],
        "faults": [{"how": "added" if sign == "+" else "removed", "text": text} for sign, text in found.faults],
        "foreign": list(found.foreign),
        "moved": [one.element.id for one in found.moved],
    }


def model_text(definitions: Definitions) -> str:
    """Return what a model says, line by line in an order that does not depend on the file: ``git diff`` compares it."""
    (definitions,) = _with_ids(definitions)
    elements = [("", one) for one in (*definitions.participants, *definitions.message_flows, *definitions.artifacts)]
    for process in definitions.processes:
        elements += [*elements_of(process), *((process.id, lane) for lane in process.lanes)]
    text = list[str]()
    for scope, element in sorted(elements, key=lambda one: (one[0], one[1].id)):
        text.append(f"{_kind(element)} {element.display_name}{f' in {scope}' if scope else ''}")
        for name, value in facts(element).items():
            if name != "name":
                first, *rest = value.splitlines() or [""]
                text += (
                    [f"  {name}:", f"    {first}", *(f"    {line}" for line in rest)]
                    if rest
                    else [f"  {name}: {first}"]
                )
    text += [f"cannot be executed: {one.element}: {one.text}" for each in definitions.processes for one in each.faults]
    text += [f"content of other tools in {id}: {one}" for id, one in sorted(_foreign(definitions).items())]
    text += [
        f"{id}: {name}: {value}"
        for (id, name), values in sorted(_references(definitions).items())
        for value, told in sorted(values)
        if told or name == _SHOWN
    ]
    drawn = [(one.element, str(one.bounds)) for one in definitions.shapes]
    drawn += [(one.element, str(one.waypoints)) for one in definitions.edges]
    text += [f"drawn: {id} {place}" for id, place in sorted(drawn)]
    return "\n".join(map(printable, text)) + "\n"


# ---- as a picture ----------------------------------------------------------------------------------------------------


def picture(found: ModelDifference) -> str:
    """Return the new diagram as SVG, with what differs in colours, and what is gone where it was.

    Raises ModelError if neither version has a diagram.
    """
    from fame.bpmn.draw.diagram import draw

    how: dict[str, str] = {one.element.id: one.how for one in (*found.changes, *found.moved)}
    how = {**dict.fromkeys(found.foreign, "changed"), **how}
    planes = {number: id for number, id in enumerate(found.old.planes) if id in found.new.planes}

    def gone(drawn: Sequence[Drawn]) -> list[Drawn]:
        """What is no longer there, on the diagram of the new version that shows the same."""
        left = (one for one in drawn if how.get(one.element) == "removed" and one.plane in planes)
        return [replace(one, plane=found.new.planes.index(planes[one.plane])) for one in left]

    shapes = [
        _painted(one, how[one.element]) if one.element in how else one
        for one in (*found.new.shapes, *gone(found.old.shapes))
    ]
    edges = [
        replace(one, stroke=COLOURS[how[one.element]][0]) if one.element in how else one
        for one in (*found.new.edges, *gone(found.old.edges))
    ]
    counts = [f"{list(how.values()).count(word)} {word}" for word in COLOURS if word in how.values()]
    painted = replace(found.new, shapes=tuple(shapes), edges=tuple(edges))
    return draw(painted, notes=[", ".join(counts) or "no differences"])


def _painted(shape: Shape, how: str) -> Shape:
    """A shape in the colours of what became of it; one that others are drawn in is not filled."""
    stroke, fill = COLOURS[how]
    holds = shape.expanded or shape.kind in ("participant", "lane", "group")
    return replace(shape, stroke=stroke, fill=shape.fill if holds else fill)
