"""The semantic difference of two models: what was added, removed or changed, and what was only moved in the diagram.

Elements are the same if they have the same id. The order of a file, its line numbers and its layout mean nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Literal

from fame.bpmn.model import Body, Bounds, Definitions, Element, Process

How = Literal["added", "removed", "changed", "moved"]
_SILENT = frozenset(("id", "line", "incoming", "outgoing", "faults", "lanes"))
"""Fields that tell a place in the file, or what flows and nodes tell, too."""


@dataclass(frozen=True, slots=True)
class ElementChange:
    """An element that differs.

    how      ``added``, ``removed``, ``changed``, or ``moved``: to another place of the diagram, with the same meaning
    what     the names of what has changed
    texts    scripts and expressions of the new model that the old one does not have there, and the other way round
    """

    element: Element
    how: How
    what: tuple[str, ...] = ()
    new_texts: tuple[str, ...] = ()
    old_texts: tuple[str, ...] = ()


def difference(old: Definitions, new: Definitions) -> list[ElementChange]:
    """Return the elements that differ: those of the new model in its order, then those that it no longer has."""
    before, now = _elements(old), _elements(new)
    changed = [change for id, element in now.items() if (change := _change(before.get(id), element)) is not None]
    places, told = (_places(old), _places(new)), {change.element.id for change in changed}
    moved = [
        ElementChange(element, "moved")
        for id, (element, _) in now.items()
        if id in before and id not in told and places[0].get(id) != places[1].get(id)
    ]
    gone = [_made("removed", element, None) for id, (element, _) in before.items() if id not in now]
    return [*changed, *moved, *gone]


def _elements(definitions: Definitions) -> dict[str, tuple[Element, str]]:
    """Each element with the id of the process or sub-process that it is in."""
    found = dict[str, tuple[Element, str]]()
    for process in definitions.processes:
        found[process.id] = process, ""
        for inner, element in _inside(process.body, process.id):
            found.setdefault(element.id, (element, inner))
    return found


def _inside(body: Body, owner: str) -> Iterator[tuple[str, Element]]:
    for element in (*body.nodes, *body.flows, *body.data_objects):
        yield owner, element
    for node in body.nodes:
        if node.body is not None:
            yield from _inside(node.body, node.id)


def _change(before: tuple[Element, str] | None, now: tuple[Element, str]) -> ElementChange | None:
    if before is None:
        return _made("added", None, now[0])
    old, new = _content(before[0]), _content(now[0])
    what = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    if before[1] != now[1]:
        what.append("the sub-process that it is in")
    if type(before[0]) is not type(now[0]):
        what = [f"{before[0].tag} to {now[0].tag}"]
    return _made("changed", before[0], now[0], tuple(what)) if what else None


def _made(how: How, old: Element | None, new: Element | None, what: tuple[str, ...] = ()) -> ElementChange:
    before, now = _texts(old), _texts(new)
    element = new if new is not None else old
    assert element is not None
    fresh, gone = (tuple(one for one in some if one not in rest) for some, rest in ((now, before), (before, now)))
    return ElementChange(element, how, tuple(name.replace("_", " ") for name in what), fresh, gone)


def _texts(element: Element | None) -> list[str]:
    """Its scripts and expressions; those of a process belong to the elements in it."""
    return (
        [text.text for text, _ in element.texts()] if element is not None and not isinstance(element, Process) else []
    )


def _content(value: Any) -> dict[str, Any]:
    """What a dataclass means, by field."""
    return {
        one.name: _plain(found)
        for one in fields(value)
        if one.name not in _SILENT and not isinstance(found := getattr(value, one.name), Body)
    }


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, _content(value)
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, tuple | list) else value


def _places(definitions: Definitions) -> dict[str, Bounds | tuple[tuple[float, float], ...]]:
    return {shape.element: shape.bounds for shape in definitions.shapes} | {
        edge.element: edge.waypoints for edge in definitions.edges
    }
