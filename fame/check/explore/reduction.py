"""Steps that need not be interleaved with others: they are explored alone.

Two kinds of steps of one robot may go first, because whatever else happens may as well happen afterwards:

- all its own steps, if no message has an effect on it now nor after any of them (it hears nothing, or drops all
  triggers, since its instances run already), and it sends nothing in them;
- one step of one token, if nothing can cancel that token, and the step touches no variable that another token may
  touch before (parallel branches commute).

Neither may send, report or start anything, nor change which messages the robot takes. The search explores such steps
alone only if each of them leads to a state that it has still to explore, so that nothing is put off forever; one that
changes nothing does not count. Which of its steps these are depends on the robot alone, so the search goes through all
of them at once where it can (`Reduction.ends`), and keeps only the states behind them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from fame.bpmn import model
from fame.check.explore.local import Local
from fame.check.explore.product import DEAD, Move, Product
from fame.check.expressions import expressions_in

MOST_BETWEEN = 1_000
"""Local states of one robot that are gone through at once."""


class Reduction:
    """Finds such steps of the robots of one product."""

    def __init__(self, product: Product) -> None:
        self.product = product
        structures = {id(local): Structure.of(local) for local in product.locals}
        self._structures = [structures[id(local)] for local in product.locals]
        self._ends: list[dict[int, tuple[int, ...]]] = [{DEAD: ()} for _ in product.locals]

    def moves(self, robot: int, state: int) -> tuple[Move, ...]:
        """The moves that may be explored alone in a local state; none if there are no such."""
        moves = self.product.own(robot, state)
        silent = [move for move in moves if self._is_silent(robot, state, move)]
        if not silent:
            return ()
        one = self._of_one_token(robot, state, moves, silent)
        if one or len(silent) < len(moves):
            return one
        views = self.product.locals[robot].views
        foreign = self._foreign(robot)
        return () if any(views[at].hears & foreign for at in (state, *(move.state for move in moves))) else moves

    def ends(self, robot: int, state: int) -> tuple[int, ...]:
        """The local states in which a robot is once it has gone all steps that may be explored alone; () if none may.

        Every way from each state between leads to one of them; else () as well, since somebody must come between.
        """
        found = self._ends[robot].get(state)
        if found is None:
            found = self._ends[robot][state] = self._new_ends(robot, state)
        return found

    def _new_ends(self, robot: int, state: int) -> tuple[int, ...]:
        after, pending, ends = dict[int, set[int]](), [state], list[int]()
        while pending:
            at = pending.pop()
            if at not in after and at not in ends:
                moves = self.moves(robot, at)
                if moves:
                    after[at] = {move.state for move in moves}
                    pending += sorted(after[at])
                else:
                    ends.append(at)
                if len(after) > MOST_BETWEEN:
                    return ()
        if not after:
            return ()
        leading = set(ends)
        while grown := {at for at in after.keys() - leading if after[at] & leading}:
            leading |= grown
        return tuple(sorted(ends)) if after.keys() <= leading else ()

    def path(self, robot: int, state: int, end: int) -> list[Move]:
        """The steps from a state to one of its `ends`."""
        before: dict[int, tuple[int, Move]] = {}
        pending = [state]
        for at in pending:
            for move in self.moves(robot, at) if end not in before else ():
                if move.state not in before and move.state != state:
                    before[move.state] = at, move
                    pending.append(move.state)
        found = list[Move]()
        while end != state:
            end, last = before[end]
            found.append(last)
        return found[::-1]

    def _is_silent(self, robot: int, state: int, move: Move) -> bool:
        """Whether nobody notices the move."""
        if move.sending or move.way.flags or move.way.begins or move.state == DEAD:
            return False
        before, after = (self.product.locals[robot].views[at] for at in (state, move.state))
        return before.instances == after.instances

    def _of_one_token(self, robot: int, state: int, moves: tuple[Move, ...], silent: list[Move]) -> tuple[Move, ...]:
        """All moves of one token that commute with whatever the others may do."""
        structure, views = self._structures[robot], self.product.locals[robot].views
        view = views[state]
        if structure is None:
            return ()
        elements = dict(zip(view.own, view.elements, strict=True))
        candidates = dict.fromkeys(move.stimulus[:2] for move in silent if move.stimulus[0] in ("end", "person"))
        for kind, key in candidates:
            own = tuple(move for move in moves if move.stimulus[:2] == (kind, key))
            element = elements[own[0].stimulus]
            if any(move not in silent or not move.way.quiet for move in own):
                continue
            if any(
                (views[move.state].hears, views[move.state].listeners) != (view.hears, view.listeners) for move in own
            ):
                continue
            reached = {one for move in own for one, _ in views[move.state].waiting}
            others = [one for one, _ in view.waiting]
            others.remove(element)
            if structure.commutes(element, reached - set(others), others):
                return own
        return ()

    def _foreign(self, robot: int) -> frozenset[str]:
        """The topics on which another robot may send to it."""
        topics = self.product.locals[robot].topics
        return frozenset(topic for topic in topics if topic[0] == "/") if self.product.count > 1 else frozenset()


@dataclass(slots=True)
class _Touched:
    """The variables that an element reads and writes."""

    reads: set[str] = field(default_factory=set)
    writes: set[str] = field(default_factory=set)

    def add(self, other: _Touched) -> None:
        self.reads |= other.reads
        self.writes |= other.writes

    def meets(self, other: _Touched) -> bool:
        """Whether the order of the two makes a difference."""
        return bool(self.writes & (other.reads | other.writes) or self.reads & other.writes)


class Structure:
    """The elements of a robot's process: what follows each, what it touches, in which sub-processes it is."""

    def __init__(self, local: Local) -> None:
        self._kept = local.kept
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
        """The structure of a process that calls no other; else None."""
        if any((isinstance(node, model.CallActivity | model.SubProcess) and node.loop is not None)
               or isinstance(node, model.CallActivity) for node in local.body.walk()):  # fmt: skip
            return None
        return cls(local)

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
                reads = use.reads if use.use != "script" else use.reads | use.writes
                self._touched[element].add(_Touched(set(reads) & self._kept, set(use.writes) & self._kept))
        for node in body.nodes:
            self._nodes[node.id] = node
            self._add_node(node, owner, around)
        if any(isinstance(use.element, model.Event) and use.use == "condition" for use in expressions_in(body)):
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
                if armed or isinstance(self._node_of(node.attached_to), model.SubProcess | None):
                    self._restless.add(node.attached_to)
        if isinstance(node, model.Task):
            if node.script is not None and node.script.language == "javascript":
                self._restless.add(owner)
            self._touched[node.id].writes |= {node.result_variable} & self._kept

    def _node_of(self, id: str) -> model.FlowNode | None:
        return self._nodes.get(id)

    def commutes(self, element: str, reached: set[str], others: list[str]) -> bool:
        """Whether a step of the token at an element, to where it waits next, commutes with what the others may do."""
        if element not in self._around or self._restless & {element, *self._around[element], ""}:
            return False
        passage = self._region(element, frozenset())
        if not reached <= passage | self._joins:
            return False
        touched = self._touches(passage)
        if not (touched.reads or touched.writes):
            return True
        before = frozenset(self._joins & self._beyond(element))
        return all(
            other in self._around and not touched.meets(self._touches(self._future(other, before))) for other in others
        )

    def _touches(self, elements: frozenset[str]) -> _Touched:
        found = _Touched()
        for one in elements:
            found.add(self._touched[one])
        return found

    def _region(self, element: str, stops: frozenset[str]) -> frozenset[str]:
        """The elements that a token at an element may pass until it waits, itself and those where it waits included."""
        found, pending = {element}, list(self._after[element])
        while pending:
            one = pending.pop()
            if one not in found and one not in self._joins:
                found.add(one)
                if not self._waits(one):
                    pending += self._after[one]
        return frozenset(found)

    def _waits(self, id: str) -> bool:
        node = self._nodes[id]
        if isinstance(node, model.Task):
            return node.kind != "plain" and not (node.script is not None and "await" not in node.script.text)
        if isinstance(node, model.Event):
            return node.place == "catch"
        return isinstance(node, model.SubProcess) or (isinstance(node, model.Gateway) and node.kind == "event")

    def _future(self, element: str, stops: frozenset[str]) -> frozenset[str]:
        """All elements that a token may ever pass, until joins that it cannot pass alone."""
        key = (element, stops)
        if key not in self._regions:
            found, pending = {element}, [element]
            while pending:
                for one in self._next(pending.pop()):
                    if one not in found and one not in stops:
                        found.add(one)
                        pending.append(one)
            self._regions[key] = frozenset(found)
        return self._regions[key]

    def _beyond(self, element: str) -> frozenset[str]:
        return self._future(element, frozenset())

    def _next(self, element: str) -> Iterator[str]:
        """What follows an element, into sub-processes and out of them."""
        yield from self._after[element]
        node = self._nodes[element]
        if isinstance(node, model.SubProcess):
            yield from (inner.id for inner in node.body.nodes)
        if self._around[element]:
            yield from self._after[self._around[element][0]]
