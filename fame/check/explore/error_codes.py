"""Error codes with which services, actions, scripts and called processes may fail.

Theory of operation. An exploration tries each failure once for each code, so it asks only for codes that make a
difference (`wanted`): those that an error event of the team catches, or a property names. None asks for all.

- What fails by itself: `service_codes` of a service or an action, `step_codes` of an activity that is one step.
- What leaves a called process: `thrown_by`, from inside out. End events, services and scripts throw; boundary events
  take away what they catch at their activity, error event sub-processes what they catch in their scope. What such a
  handler throws itself begins outside of that scope, which therefore does not catch it.

A set that is too large costs states, one that is too small hides a failure. So where nothing is known of what is
thrown (a called process that is not found, a code that is computed), it may be any.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Set

from fame.bpmn import model
from fame.bpmn.library import Library
from fame.dataclasses import dataclass, field
from fame.errors import FameError
from fame.robot.service_tasks import failure_codes
from fame.scripting.effects import script_effects

_Thrown = set[str] | None
"""Codes that may be thrown; None: any."""
_Caught = set[str | None]
"""Codes that are caught; with None among them, any."""
_BY_OTHERS = "canceled"
"""The code of a goal that somebody else cancels: nothing in the model or its world brings it about."""


def caught_codes(
    processes: Iterable[model.Process], kind: type[model.ErrorDefinition | model.EscalationDefinition]
) -> frozenset[str]:
    """Return the codes of errors or escalations that processes catch; "" stands for any."""
    nodes = (node for process in processes for node in process.body.walk() if node.place in ("boundary", "start"))
    return frozenset(event.code or "" for node in nodes for event in node.defined(kind))


def boundary_codes(node: model.FlowNode, body: model.Body) -> _Caught:
    """Return the codes that boundary events of an element catch."""
    return {error.code or None for event in body.boundary(node.id) for error in event.defined(model.ErrorDefinition)}


def service_codes(task: model.Task, wanted: Set[str] | None) -> set[str]:
    """Return the codes with which a service or action may fail.

    Of all codes (`wanted` is None) those are left out that only somebody else's request or an incident brings about.
    """
    if task.service is None:  # a Python function, or an external worker
        codes = {"script"} if task.operation or wanted is not None else set[str]()
        return codes if wanted is None else codes & wanted
    if wanted is not None:
        return failure_codes(task) & wanted
    return failure_codes(task, {_BY_OTHERS, *(["lost"] if task.properties.get("retry") == "ask" else [])})


def step_codes(node: model.Activity, thrown: Set[str] | None, body: model.Body) -> set[str]:
    """Return the codes that a step raises of which something comes.

    They are those thrown inside, and `script` and `no_flow` (of the engine) where a boundary event catches them. If any
    code may be thrown (`thrown` is None), they are all that boundary events name, and `script` stands for the others.
    """
    caught = boundary_codes(node, body)
    codes = {code for code in caught if code and (thrown is None or code in ("script", "no_flow"))}
    codes |= thrown or set()
    return codes or ({"script"} if None in caught else codes)


def computed_codes(event: model.FlowNode) -> Iterator[tuple[str, bool]]:
    """Yield the texts of computed codes that an event throws, and whether they are those of escalations."""
    for thrown in event.definitions:
        if isinstance(thrown, model.ErrorDefinition | model.EscalationDefinition) and thrown.computed is not None:
            yield thrown.computed.text, isinstance(thrown, model.EscalationDefinition)


def computes_code(node: model.FlowNode) -> bool:
    """Return whether a script or end event raises an error with a code that it computes."""
    ends = node.place == "end" and any(not escalates for _, escalates in computed_codes(node))
    return ends or script_effects(node).computes_code


def thrown_by(
    library: Library, home: model.Definitions, process: model.Process, wanted: Set[str] | None
) -> set[str] | None:
    """Return the codes that leave a called process; None if it may raise any."""
    return _Search(library, wanted).by_process(home, process)


_Key = tuple[str, str]
"""The file of a process, and its id."""


@dataclass(frozen=True, slots=True)
class _Search:
    """The search for the codes that leave a process, through the processes that it calls.

    known      what leaves processes, whatever catches it where they are called
    under_way  the processes that are being looked at, each called by the one before
    recursive  those of them that were met again inside: each adds nothing the second time
    """

    library: Library
    wanted: Set[str] | None
    known: dict[_Key, _Thrown] = field(default_factory=dict)
    under_way: set[_Key] = field(default_factory=set)
    recursive: set[_Key] = field(default_factory=set)

    def by_process(self, home: model.Definitions, process: model.Process) -> _Thrown:
        key = home.file, process.id
        if key in self.known:
            return self.known[key]
        if key in self.under_way:
            self.recursive.add(key)
            return set()
        self.under_way.add(key)
        codes = self._by_body(home, process.body)
        self.under_way.discard(key)
        self.recursive.discard(key)
        if not self.recursive:  # else a caller that is under way has added nothing yet: it is not all that leaves
            self.known[key] = codes
        return codes

    def _by_body(self, home: model.Definitions, body: model.Body) -> _Thrown:
        at_nodes, of_body = _handlers(body)
        leaving = {node.id: _uncaught(self._by_node(home, node), at_nodes[node.id]) for node in body.nodes}
        of_handlers = _union(leaving[node.id] for node in body.nodes if node.triggered_by_event)
        inside = _union(leaving[node.id] for node in body.nodes if not node.triggered_by_event)
        return _union((_uncaught(inside, of_body), of_handlers))

    def _by_node(self, home: model.Definitions, node: model.FlowNode) -> _Thrown:
        if node.body is not None:
            return self._by_body(home, node.body)
        if isinstance(node, model.CallActivity):
            try:
                return self.by_process(*self.library.find(home, node))
            except FameError:  # the compiler refuses it
                return None
        if node.place == "end":
            thrown = node.defined(model.ErrorDefinition)
            return None if any(error.computed for error in thrown) else {error.code for error in thrown if error.code}
        if isinstance(node, model.Task) and (node.operation or node.kind == "service"):
            return service_codes(node, self.wanted) if node.service is not None else None
        return self._by_script(node)

    def _by_script(self, node: model.FlowNode) -> _Thrown:
        effects = script_effects(node)
        if effects.codes is None:
            return None
        asked = effects.asked - {_BY_OTHERS} if self.wanted is None else effects.asked & self.wanted
        return {*effects.codes, *asked, *(["script"] if effects.fails else [])}


def _handlers(body: model.Body) -> tuple[Mapping[str, _Caught], _Caught]:
    """What boundary events catch, by activity, and what error event sub-processes of the scope do."""
    at_nodes, of_body = defaultdict[str, _Caught](set), _Caught()
    for node in body.nodes:
        if node.place == "boundary":
            at_nodes[node.attached_to] |= {error.code for error in node.defined(model.ErrorDefinition)}
        elif node.triggered_by_event and node.body is not None:
            starts = node.body.events("start")
            of_body |= {error.code for start in starts for error in start.defined(model.ErrorDefinition)}
    return at_nodes, of_body


def _uncaught(thrown: _Thrown, caught: _Caught) -> _Thrown:
    if None in caught:
        return set()
    return None if thrown is None else thrown - caught


def _union(parts: Iterable[_Thrown]) -> _Thrown:
    union = set[str]()
    for codes in parts:
        if codes is None:
            return None
        union |= codes
    return union
