"""Error codes with which services, actions and called processes may fail.

An exploration tries each code of a failure by itself, so only codes that make a difference are asked for (`wanted`):
those that an error event of the team catches, or a property names. None asks for all.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Set

from fame.bpmn import model
from fame.bpmn.library import Library
from fame.dataclasses import dataclass, field
from fame.errors import FameError, ModelError
from fame.middleware.messages import is_action
from fame.robot.service_tasks import error_codes
from fame.scripting.effects import script_effects
from fame.scripting.requests import STILL_RUNNING

_OF_ACTIONS = frozenset({"aborted", "canceled", "rejected"})
_BY_OTHERS = "canceled"
"""The code of a goal that somebody else cancels: nothing in the model or its world brings it about."""


def caught_codes(
    processes: Iterable[model.Process], kind: type[model.ErrorDefinition | model.EscalationDefinition]
) -> frozenset[str]:
    """Return the codes of errors or escalations that processes catch; "" stands for any."""
    nodes = (node for process in processes for node in process.body.walk() if node.place in ("boundary", "start"))
    return frozenset(event.code or "" for node in nodes for event in node.defined(kind))


def boundary_codes(node: model.FlowNode, body: model.Body) -> set[str | None]:
    """Return the codes that boundary events of an element catch; None: any."""
    return {error.code or None for event in body.boundary(node.id) for error in event.defined(model.ErrorDefinition)}


def service_codes(task: model.Task, wanted: Set[str] | None) -> set[str]:
    """Return the codes with which a service or action may fail; its property ``errors`` renames outcomes.

    Of all codes (`wanted` is None) those are left out that only somebody else's request or ``retry`` brings about.
    """
    if task.service is None:  # of a Python function, or of an external worker
        codes = {"script"} if task.operation or wanted is not None else set[str]()
        return codes if wanted is None else codes & wanted
    renamed = _renamed(task)
    outcomes = {"service", "lost", *_OF_ACTIONS}
    if wanted is None:
        outcomes = {"service", "aborted", "rejected"} if is_action(task.service.type or "") else {"service"}
        renamed.pop(_BY_OTHERS, None)
    outcomes |= {STILL_RUNNING} if "wait_cancelled" in task.properties else set()
    codes = (outcomes - renamed.keys()) | {*renamed.values()}
    return codes if wanted is None else codes & wanted


def _renamed(task: model.Task) -> dict[str | int, str]:
    """The property ``errors`` as the robot reads it; nothing if it refuses it."""
    try:
        return {**error_codes(task)}
    except ModelError:
        return {}


def named_service_codes(task: model.Task, named: Set[str]) -> set[str]:
    """Return the codes with which a service or action may fail, of those that properties name."""
    if task.service is None:
        return {"script"} & named
    return service_codes(task, named) - (set() if is_action(task.service.type or "") else _OF_ACTIONS)


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
    return _Thrown(library, wanted).by_process(home, process)


_Key = tuple[str, str]
"""The file of a process, and its id."""


@dataclass(frozen=True, slots=True)
class _Thrown:
    """The codes that leave processes and bodies.

    known  of processes, each of which is looked at once, whatever catches its codes where it is called
    open   those under way: one that calls itself adds nothing the second time
    cut    those of them that were met again: what depends on that is not known yet for other callers
    """

    library: Library
    wanted: Set[str] | None
    known: dict[_Key, set[str] | None] = field(default_factory=dict)
    open: set[_Key] = field(default_factory=set)
    cut: set[_Key] = field(default_factory=set)

    def by_process(self, home: model.Definitions, process: model.Process) -> set[str] | None:
        key = home.file, process.id
        if key in self.known:
            return self.known[key]
        if key in self.open:
            self.cut.add(key)
            return set()
        self.open.add(key)
        codes = self._by_body(home, process.body)
        self.open.discard(key)
        self.cut.discard(key)
        if not self.cut:
            self.known[key] = codes
        return codes

    def _by_body(self, home: model.Definitions, body: model.Body) -> set[str] | None:
        at_nodes, of_body = _handlers(body)
        codes = {node.id: _uncaught(self._by_node(home, node), at_nodes[node.id]) for node in body.nodes}
        inside = _joined(codes[node.id] for node in body.nodes if not node.triggered_by_event)
        # The error of a handler starts outside of the scope that it handles.
        of_handlers = _joined(codes[node.id] for node in body.nodes if node.triggered_by_event)
        return _joined((_uncaught(inside, of_body), of_handlers))

    def _by_node(self, home: model.Definitions, node: model.FlowNode) -> set[str] | None:
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

    def _by_script(self, node: model.FlowNode) -> set[str] | None:
        effects = script_effects(node)
        if effects.codes is None:
            return None
        asked = effects.asked - {_BY_OTHERS} if self.wanted is None else effects.asked & self.wanted
        return {*effects.codes, *asked, *(["script"] if effects.fails else [])}


def _handlers(body: model.Body) -> tuple[Mapping[str, set[str | None]], set[str | None]]:
    """The codes that boundary events catch, by activity, and those that error event sub-processes do; None: any."""
    at_nodes, of_body = defaultdict[str, set[str | None]](set), set[str | None]()
    for node in body.nodes:
        if node.place == "boundary":
            at_nodes[node.attached_to] |= {error.code for error in node.defined(model.ErrorDefinition)}
        elif node.triggered_by_event and node.body is not None:
            starts = node.body.events("start")
            of_body |= {error.code for start in starts for error in start.defined(model.ErrorDefinition)}
    return at_nodes, of_body


def _uncaught(codes: set[str] | None, caught: set[str | None]) -> set[str] | None:
    """Those of thrown codes that are not caught; None: any."""
    return set() if None in caught else None if codes is None else codes - caught


def _joined(parts: Iterable[set[str] | None]) -> set[str] | None:
    joined = set[str]()
    for codes in parts:
        if codes is None:
            return None
        joined |= codes
    return joined
