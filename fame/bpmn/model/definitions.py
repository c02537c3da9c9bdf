"""Processes, collaborations, the diagram interchange, and the file that holds them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from fame.bpmn.model.elements import Element
from fame.bpmn.model.flow_nodes import Body
from fame.dataclasses import dataclass, field
from fame.errors import ModelError, UnavailableError, display_name


@dataclass(frozen=True, slots=True)
class ModelFault:
    """A reason why a process cannot be executed. `element` is the id of the element concerned, `name` its name."""

    text: str
    element: str = ""
    line: int = 0
    name: str = ""

    @property
    def display_name(self) -> str:
        """The element as messages show it."""
        return display_name(self.element, self.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Process(Element):
    """A process.

    instances   number of instances that may run at a time, None for no limit
    optional    a mission can be completed although the process has never started
    semantics   ``original``: interrupting event sub-processes suspend and resume, as in the original FaMe
    by_prefix   a message sets variables by their names where no data object is connected, as in the original FaMe
    faults      why the process cannot be executed, by line; the model leaves out the elements concerned
    """

    body: Body
    executable: bool = True
    instances: int | None = None
    optional: bool = False
    semantics: Literal["standard", "original"] = "standard"
    by_prefix: bool = False
    lanes: tuple[Element, ...] = ()
    faults: tuple[ModelFault, ...] = ()


# ---- collaboration ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Participant(Element):
    """A pool: one robot, or any number of robots if `multi_instance`.

    A pool without `process` is a black box; the file need not have the process. `minimum` is the number of robots of a
    run by default, `maximum` the largest number (None: no limit).
    """

    process: str = ""
    multi_instance: bool = False
    minimum: int = 1
    maximum: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageFlow(Element):
    """A message flow between pools or flow nodes of two pools."""

    source: str
    target: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact(Element):
    """A text annotation or a group; `name` is its text. `about`: the ids of the elements that it is associated with."""

    kind: Literal["annotation", "group"] = "annotation"
    about: tuple[str, ...] = ()


# ---- diagram interchange ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Bounds:
    """The box of a shape or label (px)."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Shape:
    """The shape of an element. `kind` is its BPMN tag, `plane` the index of its diagram; colours are those of CSS.

    `name` is that of the element, which may be absent from the rest of the model (conversations, choreographies).
    `band` is the participantBandKind of a participant in a choreography task.
    """

    element: str
    bounds: Bounds
    label: Bounds | None = None
    horizontal: bool = True
    expanded: bool = False
    marker_visible: bool = False
    kind: str = ""
    plane: int = 0
    stroke: str = ""
    fill: str = ""
    name: str = ""
    band: str = ""


@dataclass(frozen=True, slots=True)
class Edge:
    """The way points (x, y) of a flow or association (px). `kind`, `plane` and `stroke` are as for a shape.

    `directed`: an association with an arrow head.
    """

    element: str
    waypoints: tuple[tuple[float, float], ...]
    label: Bounds | None = None
    kind: str = ""
    plane: int = 0
    stroke: str = ""
    directed: bool = False


@dataclass(frozen=True, slots=True)
class Note:
    """A remark of the reader about the file, not an error.

    `level`: ``warning``, ``note``, or ``reading`` (shown only when explaining how the file is read). `quirk`: the file
    relies on a peculiarity of the tool that wrote it. `name` is that of the element.
    """

    level: Literal["warning", "note", "reading"]
    text: str
    element: str = ""
    line: int = 0
    quirk: bool = False
    name: str = ""

    @property
    def display_name(self) -> str:
        """The element as messages show it."""
        return display_name(self.element, self.name)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Definitions:
    """A .bpmn file. A notebook shows its diagram.

    source          the bytes of the file; `fame.write` writes them back, so that unknown content is kept
    collaboration   id of the collaboration; the parts of a split file share it
    artifacts       text annotations and groups, which are drawn only
    planes          id of the element that each diagram shows
    notes           remarks of the reader
    sent            it came as a message, so that there are no files beside it
    made            what was compiled of it, to be used again; a copy by `replace` begins without
    """

    file: str
    source: bytes
    processes: tuple[Process, ...] = ()
    collaboration: str = ""
    participants: tuple[Participant, ...] = ()
    message_flows: tuple[MessageFlow, ...] = ()
    shapes: tuple[Shape, ...] = ()
    edges: tuple[Edge, ...] = ()
    planes: tuple[str, ...] = ()
    artifacts: tuple[Artifact, ...] = ()
    notes: tuple[Note, ...] = ()
    sent: bool = field(default=False, compare=False)
    made: dict[Any, Any] = field(default_factory=dict, compare=False, init=False)

    @property
    def path(self) -> Path | None:
        """Its place on disk, None if it has none."""
        return Path(self.file) if self.file and not self.file.startswith("<") and not self.sent else None

    def process(self, id: str) -> Process | None:
        """Return the process with this id, None if the file does not have it."""
        return next((process for process in self.processes if process.id == id), None)

    @property
    def only_executable(self) -> Process | None:
        """The only process, or of several the only one that is executable and not called by another; None without."""
        found = [process for process in self.processes if process.executable or len(self.processes) == 1]
        if len(found) > 1:
            calls = [(process.id, getattr(node, "called", "")) for process in found for node in process.body.walk()]
            found = [one for one in found if not any(called == one.id != caller for caller, called in calls)]
        return found[0] if len(found) == 1 else None

    def elements(self) -> Iterator[Element]:
        """Yield all processes with their flow nodes, sequence flows and data objects, then pools, flows, artifacts."""
        for process in self.processes:
            yield process
            yield from process.body.elements()
        yield from self.participants
        yield from self.message_flows
        yield from self.artifacts

    def display_name(self, id: str) -> str:
        """Return the element with this id as messages show it; the id itself if the file does not have the element."""
        return next((element.display_name for element in self.elements() if element.id == id), id)

    def __repr__(self) -> str:
        processes = ", ".join(process.id for process in self.processes)
        return f"Definitions({self.file!r}, processes: {processes or 'none'})"

    def _repr_svg_(self) -> str | None:
        """Return the diagram as SVG, for notebooks; None if there is nothing to draw."""
        from fame.rooms import DRAW, load

        with suppress(ModelError, UnavailableError):
            return str(load(DRAW)(self))
        return None
