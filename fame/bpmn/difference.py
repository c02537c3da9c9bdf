"""The semantic difference of two models: what was added, removed or changed, and what was only moved in the diagram.

Elements are the same if they have the same id. The order of a file, its line numbers and its layout mean nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Literal

from fame.bpmn.model import Body, Bounds, Definitions, Element, Process
from fame.dataclasses import dataclass, field, fields, is_dataclass

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
        for inner, element in elements_of(process):
            found.setdefault(element.id, (element, inner))
    return found


def elements_of(process: Process) -> Iterator[tuple[str, Element]]:
    """Yield a process and all its elements, each after the id of the process or sub-process that it is in."""
    yield "", process
    yield from _inside(process.body, process.id)


def _inside(body: Body, owner: str) -> Iterator[tuple[str, Element]]:
    for element in (*body.nodes, *body.flows, *body.data_objects):
        yield owner, element
    for node in body.nodes:
        if node.body is not None:
            yield from _inside(node.body, node.id)


def _change(before: tuple[Element, str] | None, now: tuple[Element, str]) -> ElementChange | None:
    if before is None:
        return _made("added", None, now[0])
    what = list(ElementComparison().fields(before[0], now[0]))
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


@dataclass(frozen=True, slots=True)
class ElementComparison:
    """Whether values of the model mean the same.

    ids      old id -> new id, of those that may have changed
    expect   the new dataclass that is expected for an old one
    silent   further fields that do not count
    """

    ids: Mapping[str, str] = field(default_factory=dict)
    expect: Callable[[Any], Any] = lambda value: value
    silent: Collection[str] = ()

    def fields(self, old: Any, new: Any) -> Iterator[str]:
        """Yield the names of the fields in which two dataclasses differ, but bodies."""
        old = self.expect(old)
        for name in {one.name: 0 for one in (*fields(old), *fields(new)) if one.compare}:
            before, now = getattr(old, name, None), getattr(new, name, None)
            counts = name not in _SILENT and name not in self.silent and not isinstance(before or now, Body)
            if counts and not self._same(before, now):
                yield name

    def _same(self, old: Any, new: Any) -> bool:
        if is_dataclass(old) and type(old) is type(new):
            return not any(self.fields(old, new))
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            return old.keys() == new.keys() and all(self._same(old[key], new[key]) for key in old)
        if isinstance(old, tuple | list) and isinstance(new, tuple | list):
            return len(old) == len(new) and all(map(self._same, old, new))
        return bool(old == new) or (isinstance(old, str) and new == self.ids.get(old))


def _places(definitions: Definitions) -> dict[str, Bounds | tuple[tuple[float, float], ...]]:
    return {shape.element: shape.bounds for shape in definitions.shapes} | {
        edge.element: edge.waypoints for edge in definitions.edges
    }
