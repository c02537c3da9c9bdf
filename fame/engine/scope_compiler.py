"""Compiles a process model into a program: each element becomes one or a few nodes, linked directly.

Each element has an *entry*, its first node, and *exits*, whose `next` is the target of its sequence flow. Where needed
it also has nodes that assign its data objects before and after it, a port for each flow into a join, and a fork for
several outgoing flows. Sequence flows are nodes only in an observed program.

The family of an element makes its nodes (`Compiler.make`, a table in `fame.engine.compiler`). What a family can do only
when all nodes are made, or linked, is queued in `ScopeCompiler.when_made` and `when_linked`. An element that cannot be
executed is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

from fame.bpmn import model
from fame.engine import data, steps
from fame.engine.data import unfilled
from fame.engine.host import Host
from fame.engine.program import Body, Boundary, Compiled, FaultCatch, Node, Program, StepFunction
from fame.engine.steps import Assignments, Branch
from fame.errors import ModelError

FindProcess = Callable[[str, str, model.CallActivity], tuple[model.Process, str]]
"""Finds a called process: (name, calling file, the call) -> the process and its file. Raises ModelError."""

NESTED = 120
"""How deep sub-processes and called processes may be inside each other: the compiler goes into them recursively."""
TOO_DEEP = f"expected at most {NESTED} calls and sub-processes inside each other, got more"


class Compiler:
    """State of the compilation of one program.

    make      makes the nodes of one element
    called    the bodies of called processes, by file and id
    original  whether interruption means suspension in the current process (docs/semantics.md)
    unfilled  variables of the current process that a caught message can set by their names
    """

    program: Program
    host: Host
    library: FindProcess
    make: Callable[[ScopeCompiler, model.FlowNode], None]
    original: bool

    def __init__(
        self, program: Program, host: Host, library: FindProcess, make: Callable[[ScopeCompiler, model.FlowNode], None]
    ) -> None:
        self.program, self.host, self.library, self.make = program, host, library, make
        self.observed: bool = program.observed
        self.called: dict[tuple[str, str], Body] = {}
        self.original = False
        self.unfilled: tuple[str, ...] = ()

    def admit(self, process: model.Process, file: str) -> None:
        """Make a process the current one. Raises ModelError if it has faults."""
        for fault in process.faults:
            raise ModelError(fault.text, file=file, line=fault.line, element=fault.element, name=fault.name)
        self.program.sources.append(process)
        self.original, self.unfilled = process.semantics == "original", unfilled(process)


class ScopeCompiler:
    """Compiles one body: makes and links its nodes.

    entries, exits  by element; `main`: the node that an element is; `ports`: by flow
    triggers        the trigger nodes of each start event
    handlers        the starts of event sub-processes; `compensation`: that of one for compensation
    boundaries      boundary events by activity
    queued          catching events with a queue
    leads           links the outgoing flows of an element, for families that do it themselves
    compensated     the node that compensation refers to, if it is not the node of the element
    transaction     whether it is inside a transaction
    compensates     the bodies whose activities its compensation events undo
    depth           how many sub-processes and calls it is inside
    """

    compiler: Compiler
    file: str
    owner: model.Process | model.SubProcess
    content: model.Body

    def __init__(
        self,
        compiler: Compiler,
        owner: model.Process | model.SubProcess,
        file: str,
        outer: ScopeCompiler | None = None,
        body: Body | None = None,
        depth: int = 0,
    ) -> None:
        self.compiler, self.file, self.owner, self.content = compiler, file, owner, owner.body
        handled = outer is not None and isinstance(owner, model.SubProcess) and owner.triggered_by_event
        self.compensates: list[model.Body] = [owner.body, outer.content] if outer and handled else [owner.body]
        self.body: Body = body or Body(owner.id)
        self.body.transaction = isinstance(owner, model.SubProcess) and owner.kind == "transaction"
        self.depth: int = outer.inside(owner) if outer else depth
        self.transaction: bool = self.body.transaction or (outer is not None and outer.transaction)
        self.model: dict[str, model.FlowNode] = {node.id: node for node in self.content.nodes}
        self.flows: dict[str, model.SequenceFlow] = {flow.id: flow for flow in self.content.flows}
        self.objects: dict[str, model.DataObject] = {
            **(outer.objects if outer else {}),
            **{item.id: item for item in self.content.data_objects},
        }
        self.entries: dict[str, Node] = {}
        self.exits: dict[str, list[Node]] = {}
        self.main: dict[str, Node] = {}
        self.ports: dict[str, Node] = {}
        self.triggers: dict[str, list[Node]] = {}
        self.handlers: list[Node] = []
        self.compensation: Node | None = None
        self.boundaries: dict[str, list[Node]] = {}
        self.queued: list[Node] = []
        self.leads: dict[str, Callable[[list[model.SequenceFlow]], None]] = {}
        self.compensated: dict[str, Node] = {}
        self.when_made: list[Callable[[], object]] = []
        self.when_linked: list[Callable[[], object]] = []

    @property
    def runs_beside(self) -> bool:
        """Whether it is an event sub-process that does not interrupt its scope."""
        handler = isinstance(self.owner, model.SubProcess) and self.owner.triggered_by_event
        return handler and not any(event.interrupting for event in self.content.events("start"))

    # ---- nodes ---------------------------------------------------------------------------------------

    def node(self, element: model.Element, step: StepFunction, part: str = "", spec: Any = None) -> Node:
        """Make a node of an element; `part` distinguishes it from the element's other nodes."""
        node = Node(element.id, f"{element.id}{part}", step, line=element.line, file=self.file, spec=spec)
        self.compiler.program.nodes.append(node)
        if self.compiler.observed:
            node.entered, node.left = (element.id, "enter", None), (element.id, "leave", None)
        return node

    def counted(self, node: Node) -> Node:
        """Let this node count as completion of its element."""
        node.index = node.slot = self.slot(node.id)
        return node

    def slot(self, element: str) -> int:
        """Return a new index for counting completions of an element."""
        elements = self.compiler.program.elements
        elements.append(element)
        return len(elements) - 1

    def watch(self, node: Node, *, ends: bool = False) -> None:
        """In an observed program, notify observers when a token enters and leaves the element."""
        if self.compiler.observed:
            node.plain_step, node.step = node.step, steps.observed_end if ends else steps.observed

    def watch_event(self, node: Node) -> None:
        """Notify observers, as `watch` does, of an event that no token enters."""
        if self.compiler.observed:
            node.plain_step = steps.pass_on

    def passing(self, element: model.FlowNode) -> None:
        """Make an element that only passes tokens on."""
        node = self.counted(self.node(element, steps.pass_on))
        self.watch(node)
        self.place(element, node)

    # ---- texts ---------------------------------------------------------------------------------------

    def expression(self, expression: model.Expression, element: model.Element) -> Compiled:
        return self.compiler.host.compile(expression, element=element.id, file=self.file)

    def optional(self, expression: model.Expression | None, element: model.Element) -> Compiled | None:
        """Compile an expression that may be missing."""
        return None if expression is None else self.expression(expression, element)

    def assignments(
        self, pairs: Iterable[tuple[str, model.Expression]], element: model.Element
    ) -> tuple[tuple[str, Compiled], ...]:
        return tuple((name, self.expression(source, element)) for name, source in pairs)

    def mapping(self, items: Sequence[model.Assignment], element: model.Element) -> tuple[tuple[str, Compiled], ...]:
        """Compile the assignments of a mapping."""
        plain = self.assignments(((item.target, item.source) for item in items), element)
        return tuple(
            (name, data.with_inputs(plain[:place], source, in_order=True) if items[place].in_order else source)
            for place, (name, source) in enumerate(plain)
        )

    def refuse(self, text: str, element: model.Element) -> NoReturn:
        """Raise ModelError for an element."""
        raise ModelError.at(element, text, file=self.file)

    def inside(self, element: model.Element) -> int:
        """Return the depth of the body that an element opens. Raises ModelError if that is too deep."""
        if self.depth >= NESTED:
            self.refuse(TOO_DEEP, element)
        return self.depth + 1

    # ---- the body ------------------------------------------------------------------------------------

    def compile(self, before_links: Callable[[ScopeCompiler], object] = lambda context: None) -> Body:
        """Make all nodes, then link them; `before_links` may add to them in between. Raises ModelError."""
        for element in self.content.nodes:
            self.compiler.make(self, element)
        for activity, nodes in self.boundaries.items():
            _attach(self.main[activity], nodes)
        for finish in self.when_made:
            finish()
        before_links(self)
        for element in self.content.nodes:
            if element.id in self.exits:
                self._lead_on(element)
        for finish in self.when_linked:
            finish()
        body, handlers = self.body, self.handlers
        body.entries = {id: node for id, node in self.entries.items() if is_reached(self.model[id])}
        body.armed, body.errors, body.escalations = (
            _armed(handlers),
            _of("error", handlers),
            _of("escalation", handlers),
        )
        body.queued, body.compensation = tuple(self.queued), self.compensation
        return body

    def open_with(self, begin: Node, body: Body | None = None, id: str = "") -> None:
        """Set the first node of a body (by default its own), after a node that arms its event sub-processes."""
        body, id = body or self.body, id or self.owner.id
        body.opening = begin
        if body.armed or body.queued:
            body.opening = Node(id, f"{id}/opening", steps.arm_first)
            body.opening.next = begin
            self.compiler.program.nodes.append(body.opening)

    def place(self, element: model.FlowNode, node: Node, exits: list[Node] | None = None) -> None:
        """Register the node of an element, and add the nodes that assign its data objects."""
        self.main[element.id] = self.entries[element.id] = node
        self.exits[element.id] = [node] if exits is None else exits
        before = self._values(element.data_inputs, element.copies_in)
        required = self._required(element)
        if isinstance(element, model.Event):
            throws = element.place in ("throw", "end")
            after = self._values(element.data_outputs, element.copies_out) if throws else []
            if element.io is not None:
                after += _pairs(element.io.outputs)
        else:
            after = self._values(element.data_outputs, element.copies_out)
        if before:
            first = self.node(element, steps.assign, "/inputs", Assignments(self.assignments(before, element)))
            first.next, first.part_of, self.entries[element.id] = node, node, first
        if (after or required) and self.exits[element.id]:
            spec = Assignments(self.assignments(after, element), required)
            last = self.node(element, steps.assign, "/outputs", spec)
            last.part_of = node
            self.append(element.id, last)

    def append(self, element: str, last: Node) -> None:
        self.link(self.exits[element], last)
        self.exits[element] = [last]

    def _required(self, element: model.FlowNode) -> tuple[str, ...]:
        """Return the variables that an activity must set: its own outputs, and those of the data objects it writes."""
        if not isinstance(element, model.Activity) or not (element.required or element.data_outputs):
            return ()
        objects = (self.objects[id] for id in element.data_outputs if id in self.objects)
        return tuple(dict.fromkeys([*element.required, *(name for item in objects for name in item.names)]))

    def _values(
        self, objects: tuple[str, ...], copies: tuple[model.Assignment, ...]
    ) -> list[tuple[str, model.Expression]]:
        """Return the assignments of data objects, by their ids (also of outer bodies), then the copies."""
        if not objects and not copies:
            return []
        return [pair for id in objects if id in self.objects for pair in self.objects[id].values] + _pairs(copies)

    # ---- flows ---------------------------------------------------------------------------------------

    def _lead_on(self, element: model.FlowNode) -> None:
        """Link the exits of an element to the targets of its sequence flows."""
        exits = self.exits[element.id]
        flows = [self.flows[id] for id in element.outgoing]
        if element.id in self.leads:
            self.leads[element.id](flows)
        elif not flows:
            self.link(exits, self.node(element, steps.end, "/end"))
        elif len(flows) == 1 and flows[0].condition is None:
            self.link(exits, self.target(flows[0]))
        else:
            split = self.node(element, steps.fork, "/fork", spec := Branch())
            if any(flow.condition is not None for flow in flows):
                split.step, split.part_of = steps.inclusive, self.main[element.id]
                self.branch(spec, element, flows)
            else:
                spec.targets = tuple(self.target(flow) for flow in flows)
            self.link(exits, split)

    def branch(self, spec: Branch, element: model.FlowNode, flows: list[model.SequenceFlow]) -> None:
        """Set the conditions and targets, and the default flow, of a split."""
        default = element.default
        spec.ways = tuple(
            (self.optional(flow.condition, element), self.target(flow)) for flow in flows if flow.id != default
        )
        spec.default = next((self.target(flow) for flow in flows if flow.id == default), None)

    def target(self, flow: model.SequenceFlow) -> Node:
        """Return the target node of a sequence flow: the port of a join, or the entry of an element."""
        entry = self.ports.get(flow.id) or self.entries.get(flow.target)
        if entry is None:
            self.refuse(f"leads into the event sub-process {flow.target}: expected only its event to start it", flow)
        if self.compiler.observed:
            passing = self.node(flow, steps.flow)
            passing.next, passing.entered = entry, (flow.id, "take", None)
            return passing
        return entry

    @staticmethod
    def link(exits: list[Node], following: Node) -> None:
        """Link some nodes to the next one."""
        for exit in exits:
            exit.next = following

    # ---- start ---------------------------------------------------------------------------------------

    def none_starts(self) -> list[model.Event]:
        return [event for event in self.content.events("start") if not event.definitions]

    def begin(self) -> Node:
        """Return the first node of the body: its none start event, else a fork to elements without incoming flow."""
        starts = self.none_starts()
        if len(starts) > 1:
            self.refuse(f"{self.owner.id} has {len(starts)} none start events; expected at most one", starts[1])
        if starts:
            return self.entries[starts[0].id]
        first = self.without_start("has no none start event, so it cannot be called or entered")
        if not first:
            return self.nothing()
        if len(first) == 1:
            return self.entries[first[0].id]
        targets = tuple(self.entries[node.id] for node in first)
        return self.node(first[0], steps.fork, "/begin", Branch(targets=targets))

    def without_start(self, refusal: str) -> list[model.FlowNode]:
        """Return the elements that start a body, which must have no start event."""
        if self.content.events("start"):
            self.refuse(refusal, self.owner)
        return [node for node in self.content.nodes if begins(node)]

    def nothing(self) -> Node:
        """Return the first node of an empty sub-process, which ends at once."""
        if isinstance(self.owner, model.Process) or any(map(is_reached, self.content.nodes)):
            self.refuse("has no element to start with: add a start event", self.owner)
        return self.node(self.owner, steps.end, "/empty")


def _pairs(assignments: Iterable[model.Assignment]) -> list[tuple[str, model.Expression]]:
    """Return assignments as pairs of target and source."""
    return [(item.target, item.source) for item in assignments]


def _attach(activity: Node, nodes: list[Node]) -> None:
    """Set the boundary events of an activity."""
    boundary = boundary_of(activity)
    boundary.armed, boundary.cancels = _armed(nodes), _of("cancel", nodes)
    boundary.errors, boundary.escalations = _of("error", nodes), _of("escalation", nodes)


def _armed(nodes: list[Node]) -> tuple[Node, ...]:
    return tuple(node for node in nodes if node.catch is not None)


def _of(kind: str, nodes: list[Node]) -> tuple[Node, ...]:
    """Return the nodes that catch faults of a kind: ``error``, ``escalation`` or ``cancel``."""
    return tuple(node for node in nodes if isinstance(node.spec, FaultCatch) and node.spec.kind == kind)


def boundary_of(activity: Node) -> Boundary:
    """Return the boundary events of an activity; the first call creates them."""
    if activity.boundary is None:
        activity.boundary = Boundary()
    return activity.boundary


def instantiates(node: model.FlowNode) -> bool:
    """Return whether an element is a gateway or receive task that starts a process."""
    return node.instantiate and not node.incoming


def begins(node: model.FlowNode) -> bool:
    """Return whether an element starts a body without start event (standard 13.2)."""
    if node.incoming or (node.place == "catch" and links_of(node)):
        return False
    return is_reached(node)


def is_reached(node: model.FlowNode) -> bool:
    """Return whether a token can come to an element: no event sub-process, compensation handler or boundary event."""
    return not (node.for_compensation or node.triggered_by_event or node.place == "boundary")


def links_of(node: model.FlowNode) -> set[str]:
    """Return the names of the links that an event throws or catches."""
    return {each.name for each in node.defined(model.LinkDefinition)}


def jumping_to(content: model.Body, event: model.FlowNode) -> list[str]:
    """Return the ids of the throwing link events that jump to a catching one."""
    return [other.id for other in content.events("throw") if links_of(event) & links_of(other)]
