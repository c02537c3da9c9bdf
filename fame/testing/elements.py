"""Elements of the processes that a robot runs, by label or id."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions, Element, FlowNode, Process
from fame.bpmn.pools import Pool
from fame.dataclasses import dataclass
from fame.errors import ConfigError, display_name


@dataclass(frozen=True, slots=True)
class ModelElement:
    """A flow node or sequence flow, with the file and the process that it is in."""

    file: str
    process: Process
    element: Element


class Elements:
    """The elements of each robot: those of its process and of all processes that this calls."""

    def __init__(self, definitions: Definitions, cast: Mapping[str, Pool], library: Library) -> None:
        self._library = library
        self._processes = {robot: library.closure(definitions, pool.process) for robot, pool in cast.items()}
        self._of = {
            robot: [ModelElement(home.file, process, element) for home, process in homes for element in parts(process)]
            for robot, homes in self._processes.items()
        }
        self._names = {
            robot: {one.element.id: one.element.name for one in reversed(elements)}
            for robot, elements in self._of.items()
        }

    def find(self, robot: str, name: str) -> frozenset[str]:
        """Return the ids of the elements with this id, else of those with this label.

        Raises ConfigError for an unknown one, with similar ones, and for one whose id another file has with another
        label: events do not say which of the two it was.
        """
        elements = self._of[robot]
        by_id = [one.element for one in elements if one.element.id == name]
        label = _plain(by_id[0].name if by_id else name)
        ids = {one.element.id for one in elements if _plain(one.element.name) == label} if not by_id else {name}
        if not ids:
            raise ConfigError(f"{robot} has no element {name!r}{self._similar(elements, name)}")
        for other in (one for one in elements if one.element.id in ids and _plain(one.element.name) != label):
            shown = f"{other.element.display_name} in {Path(other.file).name}"
            raise ConfigError(f"{name!r} {'is' if by_id else 'has'} the id of {shown}: rename one of them")
        return frozenset(ids)

    def may_contain(self, robot: str, ids: frozenset[str], inner: str) -> bool:
        """Return whether an element is inside one of these, a subprocess or what is called; true if not known."""
        if all(one.element.id != inner for one in self._of[robot]):
            return True  # of a process that is called by a computed name, or was sent later
        return any(
            node.id in ids and inner in self._content(home, node)
            for home, process in self._processes[robot]
            for node in process.body.walk()
        )

    def _content(self, home: Definitions, node: FlowNode) -> Iterator[str]:
        """The ids of all that is inside a flow node."""
        calls = [node] if isinstance(node, CallActivity) else []
        if node.body is not None:
            yield from (one.id for one in node.body.elements())
            calls += node.body.calls()
        for call in calls:
            if call.called and not call.refused:
                for _, process in self._library.closure(*self._library.find(home, call)):
                    yield from (one.id for one in process.body.elements())

    def label(self, robot: str, id: str) -> str:
        """Return the label of an element of a robot, on one line; empty if it has none."""
        return " ".join(self._names.get(robot, {}).get(id, "").split())

    def shown(self, robot: str, id: str) -> str:
        """Return an element of a robot as messages show it: its label and id."""
        return display_name(id, self._names.get(robot, {}).get(id, ""))

    def _similar(self, elements: Iterable[ModelElement], name: str) -> str:
        """``; did you mean ...?``, or some that it has."""
        known: dict[str, str] = {}
        for element in elements:
            for word in (element.element.name, element.element.id):
                if word:
                    known.setdefault(_plain(word), element.element.display_name)
        near = difflib.get_close_matches(_plain(name), known, 3, 0.5)
        if near:
            return f"; did you mean {' or '.join(dict.fromkeys(known[word] for word in near))}?"
        return f"; it has {', '.join(list(dict.fromkeys(known.values()))[:12]) or 'none'}"


def parts(process: Process) -> Iterator[Element]:
    """Yield all flow nodes and sequence flows of a process, at any depth."""
    for body in process.body.bodies():
        yield from body.nodes
        yield from body.flows


def _plain(name: str) -> str:
    return " ".join(name.split()).casefold()
