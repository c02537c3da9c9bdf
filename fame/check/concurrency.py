"""Calls that may be in progress at the same time and share variables, so that each sees values of the other.

A call without a mapping shares the variables of its caller. What two of them set at the same time is safe if each reads
it in the same step only (a script without `await` runs to its end), if both set it to the same value, or if they only
count with it (``n = n + 1``). Messages that both catch are the same for both.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence, Set
from functools import cache, partial
from itertools import combinations, product

from fame.bpmn.model import Activity, Body, Event, Expression, FlowNode, Gateway, MultiInstance, SubProcess, Task
from fame.check.control_flow import forks
from fame.check.expressions import expressions_in
from fame.check.graph import FlowGraph, graph_of
from fame.check.scope import CheckedProcess, CheckScope, Finding
from fame.check.variables import assigned_objects, sets_something, sharing
from fame.dataclasses import dataclass, field
from fame.scripting.effects import effects_of, script_effects
from fame.scripting.python_effects import syntax_tree

_SHOWN = 3
"""Variables that a finding names."""


@dataclass(slots=True)
class _CallUse:
    """What a call, or a sub-process, does with the variables around it.

    given  name -> what its data objects set it to as it starts
    anew   name -> what it is set to inside: a constant or expression of a data object; empty: something else
    kept   names that are read in another step than they are set
    """

    given: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    anew: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    kept: set[str] = field(default_factory=set)

    def clashes(self, other: _CallUse) -> set[str]:
        """Return the variables of this call that the other one changes while it still needs them."""
        both = (name for name in self.sets() & other.sets() if name in self.kept)
        return {name for name in both if len(values := self._values(name) | other._values(name)) > 1 or "" in values}

    def sets(self) -> Set[str]:
        """Return the names that it sets."""
        return self.given.keys() | self.anew.keys()

    def _values(self, name: str) -> set[str]:
        return self.given.get(name, set()) | self.anew.get(name, set())


_UseOf = Callable[[str], _CallUse]
"""By the id of a call."""


def check_shared_variables(scope: CheckScope) -> Iterator[Finding]:
    """Find calls without a mapping that may be in progress at the same time and set the same variables; also the
    instances of a parallel multi-instance activity."""
    for process in scope.processes:
        calls = {call.id for call, callee in process.calls if callee is not None and call.io is None}
        use = cache(partial(_use, process))
        one_by_one = {id(node.body) for node in process.nodes() if isinstance(node, SubProcess) and node.sequential}
        for graph in map(graph_of, process.bodies()):
            if calls:
                yield from _pairs_in(process, graph, calls, use, id(graph.body) in one_by_one)
            yield from _instances_in(process, graph, calls, use)


def _pairs_in(
    process: CheckedProcess, graph: FlowGraph, sharing: Set[str], use: _UseOf, sequential: bool
) -> Iterator[Finding]:
    reported = set[str]()
    for one, other in _pairs(graph, sequential):
        for call, later in product(_calls(graph.nodes[one], sharing), _calls(graph.nodes[other], sharing)):
            names = use(call.id).clashes(use(later.id)) | use(later.id).clashes(use(call.id))
            if names and later.id not in reported:
                reported.add(later.id)
                text = f"may be in progress at the same time as {call.display_name}, and both set {_listed(names)}"
                yield process.finding("warning", f"{text}: give the calls mappings", later)


def _instances_in(process: CheckedProcess, graph: FlowGraph, sharing: Set[str], use: _UseOf) -> Iterator[Finding]:
    for node in graph.body.nodes:
        if not _is_parallel(node) or not (node.id in sharing or (isinstance(node, SubProcess) and node.io is None)):
            continue
        names = use(node.id).anew.keys() & use(node.id).kept - set(node.sets())
        before = (graph.nodes[id] for id in graph.before(node.id)) if names else ()
        names &= use(node.id).given.keys() | {name for other in before for name in _sets(other, sharing, use)}
        if names:
            text = f"its instances run at the same time and all set {_listed(names)}, which is set before"
            yield process.finding("warning", f"{text}: give it a mapping", node)


def _listed(names: Set[str]) -> str:
    more = [f"{len(names) - _SHOWN} more"] if len(names) > _SHOWN else []
    return ", ".join([f"`{name}`" for name in sorted(names)[:_SHOWN]] + more)


def _is_parallel(node: FlowNode) -> bool:
    return isinstance(node, Activity) and isinstance(node.loop, MultiInstance) and not node.loop.sequential


def _calls(node: FlowNode, sharing: Set[str]) -> Iterator[FlowNode]:
    """The calls in a node that share the variables of its body."""
    if node.id in sharing and not _is_parallel(node):
        yield node
    elif isinstance(node, SubProcess) and node.io is None and not _is_parallel(node):
        for inner in node.body.nodes:
            yield from _calls(inner, sharing)


# ---- what may be in progress at the same time ------------------------------------------------------------------------


def _pairs(graph: FlowGraph, sequential: bool) -> Iterator[tuple[str, str]]:
    """Yield the nodes of which tokens may be at both at the same time, in the order of the file.

    `sequential`: of an ad-hoc sub-process that does one after the other.
    """
    place = {node.id: number for number, node in enumerate(graph.body.nodes)}
    pairs = dict[tuple[str, str], None]()
    for branch, other in _branches(graph, sequential):
        for pair in ((a, b) for a in branch - other for b in other - branch):
            pairs[min(pair, key=place.__getitem__), max(pair, key=place.__getitem__)] = None
    yield from sorted(pairs, key=lambda pair: (place[pair[0]], place[pair[1]]))


def _branches(graph: FlowGraph, sequential: bool) -> Iterator[tuple[set[str], set[str]]]:
    """Yield two sets of nodes at which tokens may be at the same time, but for those that are in both."""
    if not graph.starts() and not sequential:
        yield from combinations([graph.reach([node.id], set()) for node in graph.beginnings()], 2)
    for node in graph.body.nodes:
        ways = [graph.flows[flow].target for flow in node.outgoing]
        inclusive = isinstance(node, Gateway) and node.kind == "inclusive"
        if len(ways) > 1 and (inclusive or forks(graph, node)):
            yield from combinations([graph.reach([way], {node.id}) for way in ways], 2)
        if isinstance(node, Event) and node.place == "boundary" and not node.interrupting:
            host = graph.nodes[node.attached_to]
            goes_on = graph.reach([graph.flows[flow].target for flow in host.outgoing], {host.id, node.id})
            yield {host.id} | goes_on, graph.reach(ways, {host.id, node.id})
        if isinstance(node, SubProcess) and node.triggered_by_event and not _interrupts(node.body):
            yield set(graph.nodes) - {node.id}, {node.id}


def _interrupts(body: Body) -> bool:
    return any(isinstance(node, Event) and node.place == "start" and node.interrupting for node in body.nodes)


# ---- what a call does with variables ---------------------------------------------------------------------------------


def _use(process: CheckedProcess, id: str) -> _CallUse:
    """The use of the variables around it by a call or sub-process, with all that it calls without a mapping."""
    use, assigned = _CallUse(), assigned_objects(process)
    node = next(node for node in process.nodes() if node.id == id)
    for body in process.bodies():
        _note_objects(use.given, body, set(node.data_inputs))
    if isinstance(node, SubProcess):
        for body in node.body.bodies():
            _note(use, body, assigned)
    inside = {inner.id for inner in node.body.walk()} if isinstance(node, SubProcess) else {id}
    for call, callee in process.calls:
        if call.id in inside and callee is not None and call.io is None:
            for member in sharing(callee):
                for body in member.bodies():
                    _note(use, body, assigned_objects(member))
    return use


def _note(use: _CallUse, body: Body, assigned: Set[str]) -> None:
    """Add what the elements of a body do."""
    _note_objects(use.anew, body, assigned)
    for node in body.nodes:
        for name, value in _results(node):
            use.anew[name].add(value)
    for text in expressions_in(body):
        script = text.use == "script"
        for name in _anew(text.expression, text.reads, text.effects.sets) if script else ():
            use.anew[name].add("")
        suspends = script and "await" in text.expression.text
        use.kept |= text.reads if suspends else text.reads - text.effects.sets


def _results(node: FlowNode) -> Iterator[tuple[str, str]]:
    """The variables that an element sets around it, but by a script or a caught message; with constants."""
    for item in node.io.outputs if node.io is not None else ():
        reads = effects_of(item.source).reads
        if item.target not in reads:
            yield item.target, "" if reads else item.source.text.strip()
    others = [item.target for item in (*node.copies_in, *node.copies_out)]
    if isinstance(node, Task):
        others += [node.result_variable, *(field.key.partition(".")[0] for field in node.human.form)]
    elif isinstance(node, Event):
        others += [name for definition in node.definitions for name in definition.sets()]
    others += [node.loop.output_collection] if isinstance(node.loop, MultiInstance) else []
    yield from ((name, "") for name in others if name)


def _note_objects(noted: dict[str, set[str]], body: Body, assigned: Set[str]) -> None:
    for item in body.data_objects:
        for name, value in item.values if item.id in assigned else ():
            if sets_something(name, value):
                noted[name].add(value.text.strip())


def _anew(script: Expression, reads: Set[str], writes: Set[str]) -> Set[str]:
    """The variables that a script sets to something that does not depend on their values."""
    tree = syntax_tree(script)
    if tree is None:
        return writes - reads
    anew = set[str]()
    for node in ast.walk(tree):
        targets, value = _assigned(node)
        used = {name.id for name in ast.walk(value) if isinstance(name, ast.Name)} if value is not None else set()
        anew |= {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)} - used
    return anew & writes


def _assigned(node: ast.AST) -> tuple[Sequence[ast.expr], ast.expr | None]:
    """The targets of a statement that sets variables, and where their values come from."""
    match node:
        case ast.Assign(targets=targets, value=value):
            return targets, value
        case ast.AnnAssign(target=target, value=value) if value is not None:
            return [target], value
        case (
            ast.NamedExpr(target=target, value=value)
            | ast.For(target=target, iter=value)
            | ast.AsyncFor(target=target, iter=value)
            | ast.withitem(optional_vars=ast.expr() as target, context_expr=value)
        ):
            return [target], value
    return (), None


def _sets(node: FlowNode, sharing: Set[str], use: _UseOf) -> Set[str]:
    """The variables that an element sets, by its script or its call."""
    if node.id in sharing:
        return use(node.id).sets()
    return {*node.sets(), *script_effects(node).sets}
