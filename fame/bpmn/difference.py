"""The semantic difference of two models: what was added, removed or changed, and what was only moved in the diagram.

Elements are the same if they have the same id. The order of a file, its line numbers and its layout mean nothing, but
for the order in which an exclusive gateway tries its conditions.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Literal

from fame.bpmn.model import (
    Assignment,
    Body,
    Definitions,
    Edge,
    Element,
    EventDefinition,
    Expression,
    Gateway,
    Process,
    Shape,
    SubProcess,
)
from fame.dataclasses import dataclass, field, fields, is_dataclass, replace

ORDER = "order of its conditions"
"""The name of what is changed where only the order of flows is."""
How = Literal["added", "removed", "changed", "moved"]
_SILENT = frozenset(("id", "line", "incoming", "outgoing", "faults", "lanes"))
"""Fields that tell a place in the file, or what flows and nodes tell, too."""


@dataclass(frozen=True, slots=True)
class ElementChange:
    """An element that differs.

    how      ``added``, ``removed``, ``changed``, or ``moved``: to another place of the diagram, with the same meaning
    what     the names of what has changed
    texts    scripts and expressions of the new model that the old one does not have there, and the other way round
    values   each value that has changed: its name, the old and the new value
    """

    element: Element
    how: How
    what: tuple[str, ...] = ()
    new_texts: tuple[str, ...] = ()
    old_texts: tuple[str, ...] = ()
    values: tuple[tuple[str, str, str], ...] = ()


def difference(old: Definitions, new: Definitions) -> list[ElementChange]:
    """Return the elements that differ: those of the new model in its order, then those that it no longer has."""
    before, now = _elements(old), _elements(new)
    changed = [change for id, element in now.items() if (change := _change(before.get(id), element)) is not None]
    places, told = (_places(old), _places(new)), {change.element.id for change in changed}
    drawn = {id: Element(id=id) for id in (*places[0], *places[1]) if id not in before and id not in now}
    kept = {id: element for id, (element, _) in now.items() if id in before} | drawn  # an association is only drawn
    moved = [
        ElementChange(element, "moved")
        for id, element in kept.items()
        if id not in told and places[0].get(id) != places[1].get(id)
    ]
    gone = [_made("removed", element, None) for id, (element, _) in before.items() if id not in now]
    return [*changed, *moved, *gone]


def _elements(definitions: Definitions) -> dict[str, tuple[Element, str]]:
    """Each element with the id of the process or sub-process that it is in."""
    found = dict[str, tuple[Element, str]]()
    for process in definitions.processes:
        for inner, element in elements_of(process):
            found.setdefault(element.id, (element, inner))
        found.update((lane.id, (lane, process.id)) for lane in process.lanes)
    artifacts = (replace(one, about=tuple(sorted(one.about))) for one in definitions.artifacts)
    for element in (*definitions.participants, *definitions.message_flows, *artifacts):
        found.setdefault(element.id, (element, ""))
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
    (old, outer), (new, inner) = before, now
    if type(old) is not type(new):
        return _made("changed", old, new, (f"{old.tag} to {new.tag}",), (("type", old.tag, new.tag),))
    what = list(ElementComparison().fields(old, new))
    values = list(_values(facts(old), facts(new)))
    orders = _orders(old, new)
    for name, before_it, now_it in (
        ("associations", _associations(old), _associations(new)),
        (ORDER, *orders),
        ("the sub-process that it is in", outer, inner),
    ):
        if before_it != now_it:
            what.append(name)
            values.append((name, before_it, now_it))
    return _made("changed", old, new, tuple(what), tuple(values)) if what else None


def _values(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Each fact that differs; the opposite of yes is no."""
    for name in dict.fromkeys((*old, *new)):
        before, now = old.get(name, ""), new.get(name, "")
        if before != now:
            yield name, before or "no" * (now == "yes"), now or "no" * (before == "yes")


def _associations(element: Element) -> str:
    """Those of compensation, in a process or sub-process."""
    pairs = sorted(element.body.associations) if isinstance(element, Process | SubProcess) else ()
    return ", ".join(map(" to ".join, pairs))


def _orders(*gateways: Element) -> tuple[str, str]:
    """The flows that both versions of an exclusive gateway have, in the order in which each tries their conditions."""
    tried = (one if isinstance(one, Gateway) and one.kind == "exclusive" else None for one in gateways)
    old, new = ([id for id in one.outgoing if id != one.default] if one is not None else [] for one in tried)
    return ", ".join(flow for flow in old if flow in new), ", ".join(flow for flow in new if flow in old)


def _made(
    how: How,
    old: Element | None,
    new: Element | None,
    what: tuple[str, ...] = (),
    values: tuple[tuple[str, str, str], ...] = (),
) -> ElementChange:
    before, now = _texts(old), _texts(new)
    element = new if new is not None else old
    assert element is not None
    fresh, gone = (tuple(one for one in some if one not in rest) for some, rest in ((now, before), (before, now)))
    return ElementChange(element, how, tuple(name.replace("_", " ") for name in what), fresh, gone, values)


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


# ---- an element in words ---------------------------------------------------------------------------------------------

_WORDS = {"definitions": "", "expression": "", "topic": "", "io": "", "values": "", "inputs": "input"}
_WORDS |= {"outputs": "output", "takes": "mapping of", "copies_in": "input", "copies_out": "output", "source": "from"}
_WORDS |= {"target": "to"}
_PLAIN = ("python", "template", "value", "payload")


def facts(element: Element) -> dict[str, str]:
    """Return what an element says, but where it stands: ``signal type``, ``input speed`` ... -> text."""
    found = dict[str, str]()
    for name, value in _facts(element):
        found[name] = f"{found[name]}, {value}" if name in found else value
    return found


def _facts(value: Any, *path: str) -> Iterator[tuple[str, str]]:
    name = " ".join(path)
    if isinstance(value, Expression):
        yield name, value.text
        if value.language not in _PLAIN:
            yield f"{name} language", value.language
    elif is_dataclass(value):
        if isinstance(value, EventDefinition):
            yield "event", value.trigger
            path = (value.trigger,)
        for one in fields(value):
            if one.compare and one.name not in _SILENT and not isinstance(inner := getattr(value, one.name), Body):
                word = _WORDS.get(one.name, one.name.replace("_", " "))
                yield from _facts(inner, *path, *filter(None, (word,)))
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _facts(inner, *path, str(key))
    elif isinstance(value, tuple):
        for one in value:
            named = (one.target, one.source) if isinstance(one, Assignment) else one
            pair = isinstance(named, tuple) and len(named) == 2 and isinstance(named[0], str)
            yield from _facts(named[1], *path, named[0]) if pair else _facts(named, *path)
    elif value:
        yield name, "yes" if value is True else str(value)


def _places(definitions: Definitions) -> dict[str, Shape | Edge]:
    """What each element looks like in the diagram."""
    shapes = {shape.element: replace(shape, name="", kind="") for shape in definitions.shapes}
    return shapes | {edge.element: replace(edge, kind="") for edge in definitions.edges}
