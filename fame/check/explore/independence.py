"""Independence of tokens: which steps of one token commute with whatever the other tokens of its robot may do."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn import model
from fame.check.explore.element_variables import used_besides_texts
from fame.check.explore.graph import reachable
from fame.check.explore.local import Local
from fame.check.expressions import expressions_in
from fame.dataclasses import dataclass, field


@dataclass(slots=True)
class _Touched:
    """The variables that an element reads and writes."""

    reads: set[str] = field(default_factory=set)
    writes: set[str] = field(default_factory=set)

    def add(self, other: _Touched) -> None:
        self.reads |= other.reads
        self.writes |= other.writes

    def meets(self, other: _Touched) -> bool:
        """Return whether the order of the two makes a difference."""
        return bool(self.writes & (other.reads | other.writes) or self.reads & other.writes)


class Structure:
    """The elements of a robot's process: what follows each, what it touches, in which sub-processes it is."""

    def __init__(self, local: Local) -> None:
        self._kept, self._host = local.kept, local.host
        self._after: dict[str, set[str]] = {}
        self._touched: dict[str, _Touched] = {}
        self._around: dict[str, tuple[str, ...]] = {}  # ids of the sub-processes around an element, inner first
        self._nodes: dict[str, model.FlowNode] = {}
        self._joins: set[str] = set()
        self._restless: set[str] = set()  # sub-processes in which a token may be cancelled, or inclusive joins are
        self._add(local.body, ())
        self._regions: dict[tuple[str, frozenset[str]], frozenset[str]] = {}

    @classmethod
    def of(cls, local: Local) -> Structure | None:
        """Return the structure of a process that calls no other; else None."""
        calls = any(local.body.calls())
        loops = any(node.body is not None and node.loop is not None for node in local.body.walk())
        return None if calls or loops else cls(local)

    def _add(self, body: model.Body, around: tuple[str, ...]) -> None:
        ids = [node.id for node in body.nodes]
        for id in ids:
            self._after.setdefault(id, set())
            self._touched[id] = _Touched()
            self._around[id] = around
        owner = around[0] if around else ""
        for flow in body.flows:
            self._after[flow.source].add(flow.target)
        for use in expressions_in(body):
            element = use.element.source if isinstance(use.element, model.SequenceFlow) else use.element.id
            if element in self._touched:
                reads = use.reads if use.use != "script" else use.reads | use.effects.sets
                writes = use.effects.writes | use.effects.may_change
                writes |= self._host.names if use.effects.open else frozenset()
                writes |= self._host.leaked if "(" in use.expression.text else frozenset()
                self._touched[element].add(_Touched(set(reads) & self._kept, set(writes) & self._kept))
        for node in body.nodes:
            self._nodes[node.id] = node
            self._touched[node.id].writes |= {*used_besides_texts(node, body)} & self._kept
            self._add_node(node, owner, around)
        if any(node.defined(model.ConditionalDefinition) for node in body.nodes):
            self._restless.add(owner)
        if body.data_objects:  # they assign variables where elements begin and end
            self._restless.add(owner)

    def _add_node(self, node: model.FlowNode, owner: str, around: tuple[str, ...]) -> None:
        if isinstance(node, model.SubProcess):
            if node.triggered_by_event or node.kind != "embedded":
                self._restless.add(owner)
            self._add(node.body, (node.id, *around))
        elif isinstance(node, model.Gateway):
            if node.kind in ("inclusive", "complex"):
                self._restless.add(owner)
            elif node.kind == "parallel" and len(node.incoming) > 1:
                self._joins.add(node.id)
        elif isinstance(node, model.Event):
            kinds = (model.TerminateDefinition, model.CancelDefinition, model.CompensateDefinition,
                     model.EscalationDefinition, model.LinkDefinition)  # fmt: skip
            if any(isinstance(one, kinds) for one in node.definitions):
                self._restless.add(owner)
            if node.place == "boundary":
                self._after[node.attached_to].add(node.id)
                armed = any(not isinstance(one, model.ErrorDefinition) for one in node.definitions)
                if armed or isinstance(self._nodes.get(node.attached_to), model.SubProcess | None):
                    self._restless.add(node.attached_to)
        if isinstance(node, model.Task):
            if node.script is not None and node.script.language == "javascript":
                self._restless.add(owner)
            given = self._host.names if node.id in self._host.formless else self._host.given.get(node.id, set())
            self._touched[node.id].writes |= {node.result_variable, *given} & self._kept

    def commutes(self, element: str, reached: set[str], others: list[str]) -> bool:
        """Return whether a step of the token at an element, to where it waits next, commutes with
        what the others may do."""
        if element not in self._around or self._restless & {element, *self._around[element], ""}:
            return False
        passage = self._region(element)
        if not reached <= passage | self._joins:
            return False
        touched = self._touches(passage)
        if not (touched.reads or touched.writes):
            return True
        before = frozenset(self._joins & self._future(element, frozenset()))
        return all(
            other in self._around and not touched.meets(self._touches(self._future(other, before))) for other in others
        )

    def _touches(self, elements: frozenset[str]) -> _Touched:
        touched = _Touched()
        for element in elements:
            touched.add(self._touched[element])
        return touched

    def _region(self, element: str) -> frozenset[str]:
        """The elements that a token at an element may pass until it waits, itself and those where it waits included."""

        def after(place: str) -> set[str]:
            return self._after[place] - self._joins if place == element or not self._waits(place) else set()

        return frozenset(reachable([element], after))

    def _waits(self, id: str) -> bool:
        node = self._nodes[id]
        if isinstance(node, model.Task):
            return node.kind != "plain" and not (node.script is not None and "await" not in node.script.text)
        return node.body is not None or node.tag in ("intermediateCatchEvent", "eventBasedGateway")

    def _future(self, element: str, stops: frozenset[str]) -> frozenset[str]:
        """All elements that a token may ever pass, until joins that it cannot pass alone."""
        key = (element, stops)
        if key not in self._regions:
            self._regions[key] = frozenset(reachable([element], lambda one: set(self._next(one)) - stops))
        return self._regions[key]

    def _next(self, element: str) -> Iterator[str]:
        """What follows an element, into sub-processes and out of them."""
        yield from self._after[element]
        node = self._nodes[element]
        if node.body is not None:
            yield from (inner.id for inner in node.body.nodes)
        if self._around[element]:
            yield from self._after[self._around[element][0]]
