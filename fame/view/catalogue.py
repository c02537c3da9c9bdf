"""The models of a run for the page: their elements, numbered across all files, and their drawings.

Events name elements by id, and files that call each other may use an id twice. The page therefore gets every element as
a number. A *plane* is one drawing: a diagram of a file, or the inside of a collapsed sub-process.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

from fame.bpmn.draw.diagram import Drawing, draw_planes
from fame.bpmn.library import BUILT_IN, Find
from fame.bpmn.model import (
    Body,
    CallActivity,
    Definitions,
    Element,
    FlowNode,
    Human,
    Process,
    SequenceFlow,
    Task,
    TimerDefinition,
)
from fame.clock import SECOND
from fame.errors import ModelError
from fame.iso8601 import parse_duration
from fame.view.forms import task_fields, topic_fields

NOWHERE = -1
"""The number of a plane or element that does not exist."""
_PROGRESS = (
    "distance_remaining", "number_of_poses_remaining", "time_left", "distance_traveled", "angular_distance_traveled",
    "x_goal",
)  # fmt: skip
"""Variables that say how far an activity has come: feedback of actions, and the goal of a way."""


class CatalogueEntry(NamedTuple):
    """An element of a file. `body`: the number of the process or sub-process that it is in."""

    file: int
    element: Element
    body: int


class Catalogue:
    """The elements and drawings of some models; the first of them is the mission.

    elements  all processes, flow nodes, sequence flows and pools, by number
    drawings  of each plane
    called    call activity -> the process that it calls, both by number
    """

    def __init__(self, files: Sequence[Definitions], find: Find | None = None) -> None:
        self._find = find
        self.files: tuple[Definitions, ...] = ()
        self.elements: list[CatalogueEntry] = []
        self.called: dict[int, int] = {}
        self.drawings: list[Drawing] = []
        self._planes: list[tuple[int, str]] = []
        self._number: dict[tuple[int, str], int] = {}
        self._by_id: dict[str, list[int]] = {}
        self._plane_of: dict[int, int] = {}
        self.extend(files)

    def extend(self, files: Sequence[Definitions], find: Find | None = None) -> None:
        """Add files, also later versions of those that there are; the numbers of earlier files do not change."""
        first, self._find = len(self.files), find or self._find
        self.files += tuple(files)
        for file, definitions in enumerate(files, first):
            for process in definitions.processes:
                number = self._add(file, process, NOWHERE)
                self._add_body(file, process.body, number)
                for lane in process.lanes:
                    self._add(file, lane, NOWHERE)
            for pool in definitions.participants:
                self._add(file, pool, NOWHERE)
        for file, definitions in enumerate(files, first):
            self._draw(file, definitions)
        self._link_calls()

    # ---- looking up --------------------------------------------------------------------------------------------------

    def plane_of(self, process: int) -> int:
        """Return the plane that shows a process, by its number."""
        file, element, _ = self.elements[process]
        for node in element.body.nodes if isinstance(element, Process) else ():
            plane = self._plane_of.get(self._number[file, node.id])
            if plane is not None:
                return plane
        return NOWHERE

    def pool_of(self, process: int) -> int:
        """Return the pool that a process belongs to, by its number."""
        file, element, _ = self.elements[process]
        pools = (pool for pool in self.files[file].participants if pool.process == element.id)
        return next((self._number[file, pool.id] for pool in pools), NOWHERE)

    def starts_of(self, process: int) -> list[int]:
        """Return the events of which a process waits for one before it begins; none if it begins at once."""
        file, element, _ = self.elements[process]
        starts = element.body.events("start") if isinstance(element, Process) else ()
        return [self._number[file, event.id] for event in starts] if all(event.definitions for event in starts) else []

    def number(self, file: int, id: str) -> int:
        """Return the number of an element of a file, which is added if the file does not have it."""
        found = self._number.get((file, id))
        return found if found is not None else self._add(file, Element(id=id), NOWHERE)

    def find(self, file: int, id: str) -> int:
        """Return the number of an element of a file; NOWHERE if the file does not have it."""
        return self._number.get((file, id), NOWHERE)

    def candidates(self, id: str) -> Sequence[int]:
        """Return the elements with an id, in the order of the files."""
        return self._by_id.get(id, ())

    def tasks(self, id: str) -> list[Human]:
        """Return what the tasks with an id say of people."""
        elements = (self.elements[number].element for number in self.candidates(id))
        return [element.human for element in elements if isinstance(element, Task)]

    def types_json(self) -> dict[str, Any]:
        """Return the fields of the message of each topic, for a form."""
        return topic_fields(entry.element for entry in self.elements if isinstance(entry.element, FlowNode))

    # ---- for the page ------------------------------------------------------------------------------------------------

    def elements_json(self, start: int = 0) -> list[dict[str, Any]]:
        """Return the elements from a number on, fit for JSON; empty values are left out."""
        return [self._element_json(number) for number in range(start, len(self.elements))]

    def planes_json(self) -> list[dict[str, Any]]:
        """Return the planes: file, title, the process or sub-process that each shows, and what encloses it."""
        found = []
        for file, id in self._planes:
            number = self._number.get((file, id), NOWHERE)
            title = self.elements[number].element.label if number != NOWHERE else ""
            name = PurePath(self.files[file].file).name
            found.append({"file": name, "title": title or PurePath(name).stem, "shows": number, "of": file})
        return found

    def plane_json(self, plane: int) -> dict[str, Any]:
        """Return one drawing: its SVG, and where its shapes and flows are, by number of the
        element. Raises LookupError."""
        if not 0 <= plane < len(self.drawings):
            raise LookupError(plane)
        file, drawing = self._planes[plane][0], self.drawings[plane]
        shapes = {str(self.number(file, id)): list(box) for id, box in drawing.boxes.items()}
        edges = {str(self.number(file, id)): [list(point) for point in line] for id, line in drawing.lines.items()}
        return {
            "svg": drawing.svg,
            "width": drawing.width,
            "height": drawing.height,
            "shapes": shapes,
            "edges": edges,
            "frames": [self.number(file, id) for id in drawing.frames],
        }

    def _element_json(self, number: int) -> dict[str, Any]:
        file, element, body = self.elements[number]
        called = self.called.get(number, NOWHERE)
        values: dict[str, Any] = {
            "id": element.id,
            "name": " ".join(element.name.split()),
            "tag": element.tag,
            "file": file,
            "body": body,
            "plane": self._plane_of.get(number, NOWHERE),
            "calls": called,
            "doc": element.documentation,
        }
        if called != NOWHERE and self.elements[called].file != file:
            target = self.elements[called]
            place = (
                "FAME's own library"
                if _is_own(self.files[target.file])
                else PurePath(self.files[target.file].file).name
            )
            values["source"] = f"calls {target.element.id} of {place}"
        if isinstance(element, SequenceFlow):
            values["condition"] = element.condition.text if element.condition is not None else ""
        if isinstance(element, FlowNode):
            values["topics"] = [
                [topic.qualified, "throw" if throws else "catch", *([topic.label] if topic.is_renamed else [])]
                for topic, throws in element.topics()
            ]
            values["script"] = element.script.text if element.script is not None else ""
            values["uses"] = _progress_names(element)
            inside = self._body(body)
            values["form"] = task_fields(element, inside, self.files[file])
            if isinstance(element, Task):
                values["users"], values["groups"] = list(element.human.users), list(element.human.groups)
            if due := _due(element, inside):
                values["due"] = due
        if called != NOWHERE or (isinstance(element, FlowNode) and element.body is not None):
            values["inside"] = self._plane_inside(number)
        return {key: value for key, value in values.items() if value not in ("", [], NOWHERE)}

    def _plane_inside(self, number: int) -> int:
        """The plane that shows what is inside a call activity or collapsed sub-process."""
        file, element, _ = self.elements[number]
        if (file, element.id) in self._planes:
            return self._planes.index((file, element.id))
        process = self.called.get(number)
        return self.plane_of(process) if process is not None else NOWHERE

    def _body(self, number: int) -> Body | None:
        """What is inside a process or sub-process."""
        owner = self.elements[number].element if number != NOWHERE else None
        return owner.body if isinstance(owner, Process | FlowNode) else None

    # ---- building ----------------------------------------------------------------------------------------------------

    def _add(self, file: int, element: Element, body: int) -> int:
        number = self._number.setdefault((file, element.id), len(self.elements))
        if number == len(self.elements):
            self.elements.append(CatalogueEntry(file, element, body))
            self._by_id.setdefault(element.id, []).append(number)
        return number

    def _add_body(self, file: int, body: Body, owner: int) -> None:
        stack = [(body, owner)]
        for inner, around in stack:
            for node in inner.nodes:
                number = self._add(file, node, around)
                if node.body is not None:
                    stack.append((node.body, number))
            for flow in inner.flows:
                self._add(file, flow, around)

    def _draw(self, file: int, definitions: Definitions) -> None:
        try:
            drawings = draw_planes(definitions)
        except ModelError:  # the file has no diagram: the page lists its elements
            return
        for drawing in drawings:
            self._planes.append((file, drawing.element))
            self.drawings.append(drawing)
            for id in (*drawing.boxes, *drawing.lines):
                number = self._number.get((file, id))
                if number is not None:
                    self._plane_of.setdefault(number, len(self._planes) - 1)

    def _link_calls(self) -> None:
        for number, (file, element, _) in enumerate(tuple(self.elements)):
            if isinstance(element, CallActivity) and element.called:
                target = self._found(file, element) if self._find is not None else self._called(file, element.called)
                if target is not None:
                    self.called[number] = target

    def _found(self, file: int, call: CallActivity) -> int | None:
        try:
            target = self._find(self.files[file], call) if self._find is not None else None
        except ModelError:  # a finding of the check
            return None
        if target is None:
            return None
        places = [place for place, one in enumerate(self.files) if one.file == target[0].file]
        place = file if file in places else max(places, default=NOWHERE)  # of several versions its own, or the last
        return self._number.get((place, target[1].id))

    def _called(self, file: int, called: str) -> int | None:
        """The process that is called, if one of the files has it, the caller's first: recordings have no folders."""
        for place in (file, *range(len(self.files))):
            number = self._number.get((place, called))
            if number is not None and isinstance(self.elements[number].element, Process):
                return number
        for place, definitions in enumerate(self.files):
            if PurePath(definitions.file).stem == called and len(definitions.processes) == 1:
                return self._number[place, definitions.processes[0].id]
        return None


def _progress_names(node: FlowNode) -> list[str]:
    """The variables of progress (`_PROGRESS`) that an element names."""
    texts = [expression.text for expression, _ in node.texts()]
    words = " ".join((*texts, *node.properties.values()))
    return [name for name in _PROGRESS if name in words]


def _due(node: FlowNode, inside: Body | None) -> float:
    """The seconds until the first interrupting boundary timer of an activity, if that is a literal; else 0."""
    events = inside.boundary(node.id) if inside is not None else ()
    found = [_seconds(timer) for event in events if event.interrupting for timer in event.defined(TimerDefinition)]
    return min(filter(None, found), default=0.0)


def _seconds(timer: TimerDefinition) -> float:
    """The seconds of a literal duration without months and years; 0 for other timers."""
    try:
        duration = parse_duration(timer.expression.text) if timer.kind == "duration" and timer.expression else None
    except ValueError:  # an expression
        return 0.0
    return duration.rest / SECOND if duration is not None and not duration.months else 0.0


def _is_own(definitions: Definitions) -> bool:
    """Whether a file is one of FAME's own library; a recording has only its name and content."""
    name = PurePath(definitions.file).name
    return any((folder / name).is_file() and (folder / name).read_bytes() == definitions.source for folder in BUILT_IN)
