"""From a process model to a program: every element a node or a few, linked directly.

Each element has an *entry*, where tokens come in, and *exits*, whose `next` leads on. Around it stands what it needs: a
node that assigns its data objects before it, and one after it; a port for each flow into a join; a fork where several
flows leave. Sequence flows are nodes only in an observed program. What cannot be executed is refused here, by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NoReturn

from fame.bpmn import model
from fame.engine import activities, adhoc, elements, events, gateways, steps
from fame.engine.data import unfilled
from fame.engine.host import Compiled, Host
from fame.engine.state import Body, Node, Program, Step
from fame.errors import ModelError

Library = Callable[[str, str, model.CallActivity], tuple[model.Process, str]]
"""Finds a called process: (name, calling file, the call) -> the process and its file. Raises ModelError."""


def compile_program(
    process: model.Process, *, host: Host, library: Library, file: str = "", hash: str = "", observed: bool = False
) -> Program:
    """Compile a process and all that it calls.

    Raises ModelError (file, line, element) for what cannot be executed.
    """
    compiler = Compiler(Program(process.id, hash, observed), host, library)
    program = compiler.program
    program.instances = process.instances
    compiler.admit(process, file)
    program.body = compiler.body(process, file, top=True)
    number_keys(program.nodes)
    return program


def number_keys(nodes: Iterable[Node]) -> None:
    """Make keys differ: a called process may have ids of its caller's file."""
    seen: dict[str, int] = {}
    for node in nodes:
        seen[node.key] = seen.get(node.key, 0) + 1
        if seen[node.key] > 1:
            node.key += f"#{seen[node.key]}"


class Compiler:
    """What is shared while one program is compiled."""

    def __init__(self, program: Program, host: Host, library: Library) -> None:
        self.program, self.host, self.library, self.observed = program, host, library, program.observed
        self.called: dict[tuple[str, str], Body] = {}
        self.original = False  # whether the process at hand means suspension by interruption (DESIGN section 3)
        self.unfilled: tuple[str, ...] = ()  # its variables that a caught message may fill by their names alone

    # ---- nodes ---------------------------------------------------------------------------------------

    def node(self, element: model.Element, step: Step, file: str, *, part: str = "", counted: bool = False) -> Node:
        """A node of an element. `counted`: to pass it is to complete the element."""
        node = Node(element.id, f"{element.id}{part}", step, line=element.line, file=file)
        self.program.nodes.append(node)
        if self.observed:
            node.entered, node.left = (element.id, "enter", None), (element.id, "leave", None)
        if counted:
            node.index = node.slot = self.slot(element.id)
        return node

    def slot(self, element: str) -> int:
        """A new number under which completions of an element are counted."""
        self.program.elements.append(element)
        return len(self.program.elements) - 1

    def watch(self, node: Node, ends: bool = False) -> None:
        """In an observed program, let the element tell when a token enters and leaves it."""
        if self.observed:
            node.act, node.step = node.step, steps.observed_end if ends else steps.observed

    def expression(self, expression: model.Expression, element: model.Element, file: str) -> Compiled:
        """A condition or value, compiled."""
        return self.host.compile(expression, element=element.id, file=file)

    def optional(self, expression: model.Expression | None, element: model.Element, file: str) -> Compiled | None:
        """The same, where there need be none."""
        return None if expression is None else self.expression(expression, element, file)

    def assignments(
        self, pairs: Iterable[tuple[str, model.Expression]], element: model.Element, file: str
    ) -> tuple[tuple[str, Compiled], ...]:
        """Assignments, compiled."""
        return tuple((name, self.expression(source, element, file)) for name, source in pairs)

    # ---- bodies --------------------------------------------------------------------------------------

    def admit(self, process: model.Process, file: str) -> None:
        """Make a process the one at hand. Raises ModelError for one that has faults."""
        for fault in process.faults:
            raise ModelError(fault.text, file=file, line=fault.line, element=fault.element)
        self.program.sources.append(process)
        self.original, self.unfilled = process.semantics == "original", unfilled(process)

    def call(self, activity: model.CallActivity, file: str) -> Body:
        """The body of a called process; compiled once, so that a process may call itself."""
        process, home = self.library(activity.called, file, activity)
        key = (home, process.id)
        if key not in self.called:
            self.called[key] = Body(process.id)
            outside = self.original, self.unfilled
            self.admit(process, home)
            self.body(process, home, body=self.called[key])
            self.original, self.unfilled = outside
        return self.called[key]

    def body(
        self,
        owner: model.Process | model.SubProcess,
        file: str,
        *,
        top: bool = False,
        body: Body | None = None,
        outer: Wiring | None = None,
        handler: Wiring | None = None,
    ) -> Body:
        """Compile what a scope runs.

        `top`: of the process itself; `outer`: the wiring around it; `handler`: its own, if it is an event sub-process.
        """
        body = body or Body(owner.id)
        wiring = handler or Wiring(self, owner, file, outer)
        wiring.connect()
        body.armed = tuple(node for node in wiring.handlers if node.kind not in ("error", "escalation"))
        body.errors = tuple(node for node in wiring.handlers if node.kind == "error")
        body.escalations = tuple(node for node in wiring.handlers if node.kind == "escalation")
        body.queued, body.undo = tuple(wiring.queued), wiring.undo
        body.transaction = isinstance(owner, model.SubProcess) and owner.kind == "transaction"
        if top:
            self.starts(wiring, body, file)
        elif handler is None:
            self.open(owner.id, body, wiring.begin(body))
        return body

    def open(self, id: str, body: Body, begin: Node) -> None:
        """Let a body begin with arming what listens as long as it lives."""
        body.opening = begin
        if body.armed or body.queued:
            body.opening = Node(id, f"{id}/opening", activities.opening)
            body.opening.next = begin
            self.program.nodes.append(body.opening)

    def starts(self, wiring: Wiring, body: Body, file: str) -> None:
        """What starts the process itself: start events, gateways and receive tasks."""
        program = self.program
        for element in wiring.content.nodes:
            ways: list[Node] = []
            if isinstance(element, model.Event) and element.place == "start":
                ways = wiring.triggers.get(element.id, [])
            elif instantiates(element):
                ways = elements.instantiating(wiring, element)
            for whole in ways:
                for node in whole.alternatives or (whole,):
                    node.join = whole if whole.kind == "all" else node.join
                    self.starting(node, element, file)
        if (not program.starts and not program.timed) or wiring.none_starts():
            program.begin = wiring.begin(body)

    def starting(self, node: Node, element: model.FlowNode, file: str) -> None:
        """One trigger that starts the process."""
        program = self.program
        if node.topic:
            program.starts[node.topic] = (*program.starts.get(node.topic, ()), node)
        elif node.kind == "timer":
            program.timed = (*program.timed, node)
        elif node.kind == "condition":
            refuse("conditional events cannot start a process: there are no variables yet to be true of", element, file)
        else:
            refuse(f"{node.kind} events cannot start a process", element, file)


class Wiring:
    """One body, while its nodes are made and linked.

    `entries`, `exits` by element; `triggers` the trigger nodes of a start event; `handlers` the starts of event
    sub-processes, `undo` that of one for compensation; `undos` compensation events with activity and handler; `queued`
    catching events with a queue; `transaction`: whether it stands in one.
    """

    def __init__(
        self, compiler: Compiler, owner: model.Process | model.SubProcess, file: str, outer: Wiring | None = None
    ) -> None:
        self.compiler, self.file, content = compiler, file, owner.body
        self.owner, self.content = owner, content
        self.adhoc = owner if isinstance(owner, model.SubProcess) and owner.kind == "adhoc" else None
        transaction = isinstance(owner, model.SubProcess) and owner.kind == "transaction"
        self.transaction: bool = transaction or (outer is not None and outer.transaction)
        self.model = {node.id: node for node in content.nodes}
        self.flows = {flow.id: flow for flow in content.flows}
        self.objects: dict[str, model.DataObject] = {
            **(outer.objects if outer else {}),
            **{item.id: item for item in content.data_objects},
        }
        self.entries: dict[str, Node] = {}
        self.exits: dict[str, list[Node]] = {}
        self.main: dict[str, Node] = {}
        self.ports: dict[str, Node] = {}
        self.triggers: dict[str, list[Node]] = {}
        self.handlers: list[Node] = []
        self.queued: list[Node] = []
        self.alternatives: list[tuple[Node, model.Gateway]] = []
        self.boundaries: dict[str, list[Node]] = {}
        self.links: list[tuple[Node, str]] = []
        self.undos: list[tuple[str, Node, str]] = []
        self.undo: Node | None = None

    def connect(self) -> None:
        """Make all nodes, then link them."""
        for element in self.content.nodes:
            elements.make(self, element)
        for activity, nodes in self.boundaries.items():
            events.attach(self.main[activity], nodes)
        for activity, node, handler in self.undos:
            events.attach_undo(self, activity, node, handler)
        if self.adhoc is not None:
            adhoc.supervise(self)
        for element in self.content.nodes:
            if element.id in self.exits:
                self.lead_on(element)
        for gateway, element in self.alternatives:
            elements.link_alternatives(self, gateway, element)
        for node, target in self.links:
            node.next = self.entries[target]
        for element in self.content.nodes:
            if isinstance(element, model.Gateway) and element.kind in ("inclusive", "complex"):
                self.main[element.id].masks = elements.masks(self.content, element)

    def place(self, element: model.FlowNode, node: Node, exits: list[Node] | None = None) -> None:
        """Say which node is an element, and add the nodes that assign its data objects."""
        self.main[element.id] = self.entries[element.id] = node
        self.exits[element.id] = [node] if exits is None else exits
        takes = isinstance(element, model.Event) and element.place in ("start", "catch", "boundary")
        before = self.values(element.data_inputs) + pairs(element.copies_in)
        after = [] if takes else self.values(element.data_outputs) + pairs(element.copies_out)
        if isinstance(element, model.Event) and element.io is not None:
            after += pairs(element.io.outputs)
        if before:
            first = self.compiler.node(element, activities.assign, self.file, part="/inputs")
            first.inputs = self.compiler.assignments(before, element, self.file)
            first.next, first.guard, self.entries[element.id] = node, node, first
        required = self.required(element) if isinstance(element, model.Activity) else ()
        if (after or required) and self.exits[element.id]:
            last = self.compiler.node(element, activities.assign, self.file, part="/outputs")
            last.inputs, last.required = self.compiler.assignments(after, element, self.file), required
            last.guard = node
            for exit in self.exits[element.id]:
                exit.next = last
            self.exits[element.id] = [last]

    def required(self, activity: model.Activity) -> tuple[str, ...]:
        """The variables that an activity has to set: its own outputs, and those of the data objects it writes."""
        objects = (self.objects[id] for id in activity.data_outputs if id in self.objects)
        return tuple(dict.fromkeys([*activity.required, *(name for item in objects for name in item.names)]))

    def values(self, objects: Iterable[str]) -> list[tuple[str, model.Expression]]:
        """The assignments of data objects, by their ids; inner bodies see the objects of outer ones."""
        return [pair for id in objects if id in self.objects for pair in self.objects[id].values]

    def lead_on(self, element: model.FlowNode) -> None:
        """Link the exits of an element to where its sequence flows lead."""
        compiler, exits = self.compiler, self.exits[element.id]
        flows = [self.flows[id] for id in element.outgoing]
        default = getattr(element, "default", "")
        if isinstance(element, model.Gateway):
            self.lead_gateway(element, flows)
        elif not flows:
            self.link(exits, compiler.node(element, steps.end, self.file, part="/end"))
        elif len(flows) == 1 and flows[0].condition is None:
            self.link(exits, self.target(flows[0]))
        else:
            split = compiler.node(element, gateways.fork, self.file, part="/fork")
            if any(flow.condition is not None for flow in flows):
                split.step, split.guard = gateways.inclusive, self.main[element.id]
                self.branch(split, element, flows, default)
            else:
                split.out = tuple(self.target(flow) for flow in flows)
            self.link(exits, split)

    def lead_gateway(self, gateway: model.Gateway, flows: list[model.SequenceFlow]) -> None:
        """Link a gateway to what follows it."""
        node = self.main[gateway.id]
        if gateway.kind == "event":
            self.alternatives.append((node, gateway))
            return
        act = steps.pass_on
        if not flows:
            node.next = self.compiler.node(gateway, steps.end, self.file, part="/end")
        elif gateway.kind == "parallel":
            node.out, node.next = tuple(self.target(flow) for flow in flows), self.target(flows[0])
            act = gateways.fork if len(flows) > 1 else steps.pass_on
        elif len(flows) == 1 and flows[0].condition is None:
            node.next = self.target(flows[0])
        else:
            act = gateways.exclusive if gateway.kind == "exclusive" else gateways.inclusive
            self.branch(node, gateway, flows, gateway.default)
            if gateway.kind == "complex":
                asked = [flow for flow in flows if flow.id != gateway.default]
                node.resets = tuple(way for way, flow in zip(node.out, asked, strict=True) if asks_for_phase(flow))
                act = gateways.part if node.resets else act
        node.step = act
        self.compiler.watch(node)

    def branch(self, node: Node, element: model.Element, flows: list[model.SequenceFlow], default: str) -> None:
        """Conditions and targets, and the default flow apart."""
        node.out = tuple(
            (flow.condition and self.compiler.expression(flow.condition, element, self.file), self.target(flow))
            for flow in flows
            if flow.id != default
        )
        node.default = next((self.target(flow) for flow in flows if flow.id == default), None)

    def target(self, flow: model.SequenceFlow) -> Node:
        """Where a sequence flow leads: the port of a join, or the entry of an element."""
        entry = self.ports.get(flow.id) or self.entries.get(flow.target)
        if entry is None:
            refuse(f"a sequence flow cannot lead to {flow.target}", flow, self.file)
        if self.compiler.observed:
            passing = self.compiler.node(flow, steps.flow, self.file)
            passing.next, passing.entered = entry, (flow.id, "take", None)
            return passing
        return entry

    @staticmethod
    def link(exits: list[Node], following: Node) -> None:
        for exit in exits:
            exit.next = following

    def none_starts(self) -> list[model.Event]:
        """The none start events of the body."""
        return [
            node
            for node in self.content.nodes
            if isinstance(node, model.Event) and node.place == "start" and not node.definitions
        ]

    def begin(self, body: Body) -> Node:
        """Where the first token of the body goes: its none start event, else all that has no incoming flow."""
        starts = self.none_starts()
        if len(starts) > 1:
            refuse(f"{self.owner.id} has {len(starts)} none start events; one can begin it", starts[1], self.file)
        if starts and self.adhoc is None:
            return self.entries[starts[0].id]
        if any(isinstance(node, model.Event) and node.place == "start" for node in self.content.nodes):
            text = "has no none start event, so it cannot be called or entered"
            if self.adhoc is not None:
                text = "an ad-hoc sub-process has no start event: what no flow leads to begins"
            refuse(text, self.owner, self.file)
        first = [node for node in self.content.nodes if begins(node)]
        if not first:
            return self.nothing()
        if self.adhoc is not None:
            body.adhoc, opening = adhoc.open_with(self, self.adhoc, first)
            return opening
        if len(first) == 1:
            return self.entries[first[0].id]
        fork = self.compiler.node(first[0], gateways.fork, self.file, part="/begin")
        fork.out = tuple(self.entries[node.id] for node in first)
        return fork

    def nothing(self) -> Node:
        """Where the first token of a body goes that nothing begins: a sub-process with nothing in it ends at once."""
        if isinstance(self.owner, model.Process) or any(map(moves, self.content.nodes)):
            refuse("has nothing to begin with: add a start event", self.owner, self.file)
        return self.compiler.node(self.owner, steps.end, self.file, part="/empty")


def pairs(assignments: Iterable[model.Assignment]) -> list[tuple[str, model.Expression]]:
    """Assignments as pairs."""
    return [(item.target, item.source) for item in assignments]


def asks_for_phase(flow: model.SequenceFlow) -> bool:
    """Whether the condition of a flow that leaves a complex gateway tells its activation from its reset."""
    return flow.condition is not None and "waitingForStart" in flow.condition.text


def instantiates(node: model.FlowNode) -> bool:
    """Whether it is a gateway or receive task that starts a process."""
    return isinstance(node, model.Gateway | model.Task) and node.instantiate and not node.incoming


def begins(node: model.FlowNode) -> bool:
    """Whether an element starts by itself in a body without start event (standard 13.2)."""
    if node.incoming or (isinstance(node, model.Event) and node.place == "boundary"):
        return False
    if isinstance(node, model.Event) and node.definitions and isinstance(node.definitions[0], model.LinkDefinition):
        return node.place != "catch"
    return moves(node)


def moves(node: model.FlowNode) -> bool:
    """Whether tokens of the flow around it get to an element."""
    return not (isinstance(node, model.Activity) and (node.for_compensation or is_handler(node)))


def is_handler(node: model.FlowNode) -> bool:
    """Whether it is an event sub-process."""
    return isinstance(node, model.SubProcess) and node.triggered_by_event


def refuse(text: str, element: model.Element, file: str) -> NoReturn:
    """Refuse a model, by name."""
    raise ModelError(text, file=file, line=element.line, element=element.id)
