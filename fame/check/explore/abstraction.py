"""The abstraction of a model for an exploration: without work inside behaviours and variables that decide nothing.

A call of a behaviour that touches no topic of the team becomes a step: it ends at some time, or raises one of the error
codes that it can. Its results are unknown. What is left of the processes is executed by the engine as it is.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set

from fame.bpmn import model
from fame.bpmn.library import Library
from fame.bpmn.pools import Pool, all_processes
from fame.bpmn.topics import TopicUse
from fame.check.explore.aliases import SHARED, Aliases
from fame.check.explore.counting import list_uses, without_items
from fame.check.explore.slicing import assignments, links, sliced, unknown_part, without_operations
from fame.check.explore.values import MARK
from fame.check.expressions import cover_all, expressions_in
from fame.dataclasses import dataclass, field, fields, replace
from fame.engine.data import variable_name
from fame.errors import FameError
from fame.middleware.messages import is_action
from fame.scripting.effects import effects_of, script_effects
from fame.scripting.requests import STILL_RUNNING

Home = tuple[model.Definitions, model.Process]
STEP = "explored step "
"""Begins the names of the services that take the place of behaviours."""


@dataclass(frozen=True, slots=True)
class AbstractStep:
    """Something that takes time: a behaviour, a service, or a script that waits.

    writes   variables that it may set at any time: they are unknown from its beginning on
    changes  those whose values it may change in place: unknown, too, unless they are of a kind that cannot be changed
    results  variables that it sets when it completes
    used     others whose values it uses: they count as changed when it completes, which gives fewer states
    codes    error codes that it may raise
    emits    (topic, whether it is certain if it completes): what it has published when it ends
    """

    writes: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    used: tuple[str, ...] = ()
    codes: tuple[str, ...] = ()
    emits: tuple[tuple[str, bool], ...] = ()


@dataclass(slots=True)
class Abstraction:
    """The processes of a team as they are explored.

    types    the topics of the team
    shared   those that one robot may send and another, or itself, may take
    outside  those that only something outside of the team can send
    steps    what each step does, by its name
    kept     pool -> its variables that decide something
    matters  topics whose payload decides something
    counted  variables with lists of which only the length is read
    unknown  variables whose values are certainly unknown
    needed   variables without which a script or expression that decides something could not run; None: not yet known
    caught   scripts with an error event at their task, at a sub-process around it, or in one
    catches  the codes that error events catch; "": any
    named    the codes that properties name
    asks     script that waits for actions and services -> the codes with which it may fail because of them
    computed (throwing event, text of its computed code) -> the named codes that it may have
    unhandled  (element, code) of services, actions and behaviours with such inside: they may fail, nothing catches it
    escalations  the codes of escalations that are caught
    called   processes that calls lead to
    given    task -> the variables that a person sets who completes it: of its form, and of the data that it writes
    read     variables that properties read
    """

    library: Library
    types: Mapping[str, TopicUse]
    shared: frozenset[str] = frozenset()
    outside: frozenset[str] = frozenset()
    steps: dict[str, AbstractStep] = field(default_factory=dict)
    kept: dict[str, frozenset[str]] = field(default_factory=dict)
    matters: set[str] = field(default_factory=set)
    counted: frozenset[str] = frozenset()
    unknown: frozenset[str] = frozenset()
    needed: frozenset[str] | None = None
    caught: set[str] = field(default_factory=set)
    aliases: Aliases = field(default_factory=Aliases)
    catches: frozenset[str] = frozenset()
    named: frozenset[str] = frozenset()
    asks: dict[str, frozenset[str]] = field(default_factory=dict)
    computed: dict[tuple[str, str], Collection[str]] = field(default_factory=dict)
    escalations: frozenset[str] = frozenset()
    unhandled: set[tuple[str, str]] = field(default_factory=set)
    called: frozenset[str] = frozenset()
    given: dict[str, frozenset[str]] = field(default_factory=dict)
    read: frozenset[str] = frozenset()
    _homes: dict[str, model.Definitions] = field(default_factory=dict)
    _reduced: dict[tuple[str, int], tuple[model.Process, model.Process]] = field(default_factory=dict)

    @property
    def codes(self) -> tuple[str, ...]:
        """The error codes that somebody names, of which an unknown one may be any."""
        return tuple(sorted((self.catches | self.named) - {""}))

    def process(self, home: model.Definitions, process: model.Process) -> model.Process:
        """Return a process without the inside of behaviours. Robots of a pool may have different
        processes of one id."""
        key = (home.file, id(process))
        if key not in self._reduced:
            self._homes[home.file] = home
            around = "" in self.catches and process.id in self.called  # at the call, perhaps
            self._reduced[key] = process, replace(process, body=self._body(process.body, home, around))
        return self._reduced[key][1]

    def forget(self) -> None:
        """Drop the processes made so far: more is known of the team now."""
        self._reduced.clear()

    def find(self, name: str, file: str, call: model.CallActivity) -> tuple[model.Process, str]:
        """Find a called process that is not a step (the library of the compiler)."""
        home, process = self.library.find(self._homes[file], call)
        return self.process(home, process), home.file

    def bodies(self, home: model.Definitions, process: model.Process) -> list[model.Body]:
        """Return all bodies of an abstract process and of what it calls."""
        found, seen = list[model.Body](), set[tuple[str, int]]()
        pending = [(home, process)]
        while pending:
            home, process = pending.pop()
            if (home.file, id(process)) in seen:
                continue
            seen.add((home.file, id(process)))
            body = self.process(home, process).body
            found += body.bodies()
            pending += [self.library.find(home, call) for call in body.calls()]
        return found

    def _body(self, body: model.Body, home: model.Definitions, around: bool = False) -> model.Body:
        nodes: list[model.FlowNode] = []
        caught = {node.attached_to for node in body.nodes if node.defined(model.ErrorDefinition)}
        around |= any(start.defined(model.ErrorDefinition) for node in body.nodes
                      if node.triggered_by_event and node.body is not None for start in node.body.nodes)  # fmt: skip
        for node in body.nodes:
            if isinstance(node, model.SubProcess):
                node = replace(node, body=self._body(node.body, home, around or node.id in caught))
            elif isinstance(node, model.CallActivity):
                node = self._call(node, body, home, around)
            elif isinstance(node, model.Gateway):
                node = _with_way_out(node, body)
            elif isinstance(node, model.Event):
                node = _without_message(node)
                self.computed |= {(node.id, text): self.escalations if escalates else self.codes
                                  for text, escalates in _computed_in(node)}  # fmt: skip
            elif isinstance(node, model.Task) and node.kind == "script" and node.script is not None:
                if around or node.id in caught or effects_of(node.script, script=True).fails:
                    self.caught.add(node.id)
                self.asks[node.id] = self.asks.get(node.id, frozenset()) | self._asked(node, body, around)
                node = replace(node, script=self._script(node.script, node.id in self.caught))
            elif isinstance(node, model.Task) and node.kind == "service":
                self.steps[step_name(home.file, node.id)] = self._service(node, body, around)
            elif isinstance(node, model.Task) and node.kind in ("user", "manual"):
                self.given[node.id] = self.given.get(node.id, frozenset()) | {*_given(node, body)}
            nodes.append(node)
        return replace(body, nodes=tuple(nodes))

    def _script(self, script: model.Expression, caught: bool) -> model.Expression:
        """A script without what decides nothing; `caught`: what it raises may decide something."""
        script = without_operations(without_items(script, self.counted), self.unknown)
        if self.needed is None:
            return script
        return self.aliases.marked(script if caught else sliced(script, self.needed), self.needed)

    def _service(self, task: model.Task, body: model.Body, around: bool) -> AbstractStep:
        """A service or action, which may fail with the codes that error events of the team catch."""
        fails = {code for code in step_codes(task, None, body) if code != "script"}
        fails |= _fails(task, self.catches)
        named = _named(task, self.named) - fails
        if self._is_caught(task, body, around):
            fails |= {"service" if task.service is not None else "script", *named}
        else:
            fails |= self._unhandled(task, _fails(task, None) - fails, named)
        results = set[str]()
        if task.service is not None and task.io is not None and task.io.outputs:
            results = {"msg"}.union(*(effects_of(item.source).reads for item in task.io.outputs))
        elif task.service is not None and not task.result_variable:
            results = {name for item in body.data_objects if item.id in task.data_outputs for name in item.names}
            results = results or {variable_name(task.service.name)}
        feedback = re.findall(r"\w+", task.properties.get("feedback", ""))
        return AbstractStep(writes=tuple(feedback), results=tuple(sorted(results)), codes=tuple(sorted(fails)))

    def _asked(self, task: model.Task, body: model.Body, around: bool) -> set[str]:
        """The codes with which the actions and services of a script fail, as those of a service task do."""
        asked = {*script_effects(task).asked}
        fails = asked & self.catches
        named = (asked & self.named) - fails
        if asked and self._is_caught(task, body, around):
            return fails | named | {min(asked)}
        return fails | self._unhandled(task, asked - fails - {"canceled"}, named)

    def _is_caught(self, node: model.Activity, body: model.Body, around: bool) -> bool:
        """Whether an error event of any code is at an element, or around it."""
        at = (one for event in body.boundary(node.id) for one in event.defined(model.ErrorDefinition))
        return "" in self.catches and (around or any(not one.code for one in at))

    def _unhandled(self, node: model.Activity, codes: Set[str], named: Set[str] = frozenset()) -> set[str]:
        """Note one of the codes that nothing catches, which stands for all of them, and those that properties name."""
        found = {*sorted(codes, key=lambda code: (code != "service", code))[:1], *named}
        self.unhandled |= {(node.id, code) for code in found}
        return found

    def _with_aliases(self, names: Iterable[str]) -> set[str]:
        found = {*names}
        return found.union(*(self.aliases.of((name, False)) for name in found))

    def _call(
        self, call: model.CallActivity, body: model.Body, home: model.Definitions, around: bool
    ) -> model.FlowNode:
        try:
            called = self.library.find(home, call)
            closure = self.library.closure(*called)
        except FameError:  # the compiler refuses it
            return call
        if any(topic in self.shared for there, process in closure for topic, _ in _ends(there, process)):
            return call
        writes, results = {name for _, process in closure for name in _writes(process)}, set[str]()
        changes = self._with_aliases(name for _, process in closure for name in _may_change(process))
        used = self._with_aliases(name for _, process in closure for name in _may_set(process))
        if call.io is not None:
            if not call.io.all_in:
                given = {name for item in call.io.inputs for name in effects_of(item.source).reads}
                changes, used = (given if names else set() for names in (changes, used))
            results = writes if call.io.all_out else {item.target for item in call.io.outputs}
            writes = set()
        thrown = _thrown_in(self.library, *called, self.catches, set())
        codes = step_codes(call, thrown, body)
        others = self.named if thrown is None else _thrown_in(self.library, *called, self.named, set()) or set()
        named = {*others} - {*codes}
        inside = [one for _, called_process in closure for one in called_process.body.walk()]
        served = any(one.service is not None or script_effects(one).asked for one in inside)
        worked = any(one.operation and one.service is None for one in inside)
        own = {"service"} if served else {"script"} if worked else set[str]()
        any_code = thrown is None and any(map(_computes, inside))
        if self._is_caught(call, body, around):
            codes = (*(codes or own), *sorted(named))
        elif own or named or any_code:
            every = step_codes(call, _thrown_in(self.library, *called, None, set()), body) if served else own
            left = {*every} - {*codes} or ({MARK} if any_code else own - {*codes})
            codes = (*codes, *sorted(self._unhandled(call, left, named)))
        name = step_name(home.file, call.id)
        sorts = [tuple(sorted(names)) for names in (writes, changes, results, used)]
        self.steps[name] = AbstractStep(sorts[0], sorts[1], sorts[2], sorts[3], codes)
        kept = {item.name: getattr(call, item.name) for item in fields(model.Activity)}
        kept |= {"io": None, "copies_out": (), "required": ()}
        return model.Task(kind="service", operation=name, **kept)


def _given(task: model.Task, body: model.Body) -> Iterator[str]:
    """What a person fills in who completes a task."""
    yield from (field.key.partition(".")[0] for field in task.human.form if field.key)
    yield from (name for data in body.data_objects if data.id in task.data_outputs for name in data.names)


def step_name(file: str, element: str) -> str:
    """Return the name of the step of a behaviour, service or action."""
    return f"{STEP}{file} {element}"


def _caught_in(
    processes: Iterable[model.Process], kind: type[model.ErrorDefinition | model.EscalationDefinition]
) -> frozenset[str]:
    """The codes of errors or escalations that processes catch; "": any."""
    nodes = (node for process in processes for node in process.body.walk() if node.place in ("boundary", "start"))
    return frozenset(one.code or "" for node in nodes for one in node.defined(kind))


def _fails(task: model.Task, catches: Set[str] | None) -> set[str]:
    """The codes with which a service or action may fail, of those that are caught; ``errors`` names further ones.

    `catches` None: of all, without what only somebody else's request (``canceled``) or ``retry`` brings about.
    """
    if task.service is None:
        return {"script"} & catches if catches is not None else {"script"} if task.operation else set()
    others = dict(re.findall(r"(\w+)\s*:\s*([\w.]+)", task.properties.get("errors", "")))
    outcomes = {"service", "lost", "aborted", "canceled", "rejected"}
    if catches is None:
        outcomes = {"service", "aborted", "rejected"} if is_action(task.service.type or "") else {"service"}
        others.pop("canceled", None)
    outcomes |= {STILL_RUNNING} if "wait_cancelled" in task.properties else set()
    codes = (outcomes - others.keys()) | {*others.values()}
    return codes if catches is None else codes & catches


def _computes(node: model.FlowNode) -> bool:
    """Whether a script or end event raises an error with a code that it computes."""
    return script_effects(node).computes_code or (
        node.place == "end" and any(not escalates for _, escalates in _computed_in(node))
    )


def _named(task: model.Task, named: Set[str]) -> set[str]:
    """The codes with which a service or action may fail, of those that properties name."""
    if task.service is None:
        return {"script"} & named
    of_actions = set() if is_action(task.service.type or "") else {"aborted", "canceled", "rejected"}
    return _fails(task, named) - of_actions


def _computed_in(event: model.FlowNode) -> Iterator[tuple[str, bool]]:
    """The texts of computed codes that an event throws, and whether they are those of escalations."""
    for one in event.definitions:
        if isinstance(one, model.ErrorDefinition | model.EscalationDefinition) and one.computed is not None:
            yield one.computed.text, isinstance(one, model.EscalationDefinition)


def _without_message(event: model.Event) -> model.Event:
    """An event whose error has no text: texts for people decide nothing, and what they read need not be kept."""
    kept = (replace(one, message=None) if isinstance(one, model.ErrorDefinition) else one for one in event.definitions)
    return replace(event, definitions=tuple(kept))


def abstraction(
    definitions: model.Definitions,
    pools: Sequence[Pool],
    library: Library,
    types: Mapping[str, TopicUse],
    *,
    given: bool = False,
    read: frozenset[str] = frozenset(),
    parameters: frozenset[str] = frozenset(),
    named: frozenset[str] = frozenset(),
) -> Abstraction:
    """Return the abstraction of a team. Raises ModelError for calls of unknown processes.

    given       some robots go on from snapshots, so that variables may have values which nothing in the model gives
    read        variables that properties read: they count as what decides something
    parameters  variables with which a process starts
    named       error codes that properties name
    """
    thrown, caught = set[str](), set[str]()
    reached = all_processes(definitions, pools, library)
    for home, process in reached:
        for topic, throws in _ends(home, process):
            (thrown if throws else caught).add(topic)
    found = Abstraction(library, types, read=read, named=named)
    found.shared = frozenset(topic for topic in thrown & caught if topic[0] == "/")
    found.outside = frozenset(topic for topic in caught if topic[0] == "~" or topic not in thrown)
    processes = [process for _, process in reached]
    found.counted = _counted(processes) - read
    found.unknown = frozenset() if given else _unknown(processes, found.outside - thrown, parameters)
    found.called = frozenset(one.called for process in processes for one in process.body.calls())
    found.catches = _caught_in(processes, model.ErrorDefinition)
    found.escalations = _caught_in(processes, model.EscalationDefinition) - {""}
    bodies = {pool.name: found.bodies(definitions, pool.process) for pool in pools}
    found.aliases = Aliases(body for process in processes for body in process.body.bodies())
    found.needed = _needed(found, [body for inside in bodies.values() for body in inside])
    found.forget()
    bodies = {pool.name: found.bodies(definitions, pool.process) for pool in pools}
    _keep_what_decides(found, bodies)
    return found


def _with_way_out(gateway: model.Gateway, body: model.Body) -> model.Gateway:
    """A gateway of which one condition is always true: if no other one is, the last one is, on unknown values, too."""
    flows = [flow for flow in body.flows if flow.source == gateway.id]
    conditions = [flow.condition for flow in flows if flow.condition is not None]
    if gateway.kind != "exclusive" or gateway.default or len(conditions) < len(flows) or not cover_all(conditions):
        return gateway
    return replace(gateway, default=flows[-1].id)


# ---- topics and codes of behaviours ----------------------------------------------------------------------------------


def _ends(home: model.Definitions, process: model.Process) -> Iterator[tuple[str, bool]]:
    """(topic, whether it is thrown) of the events and scripts of a process."""
    for node in process.body.walk():
        for topic, throws in node.topics():
            yield topic.qualified, throws
        for one in script_effects(node).topics:
            if one.direction in ("publish", "subscribe"):
                yield one.qualified, one.direction == "publish"


def _writes(process: model.Process) -> Iterator[str]:
    """The variables that a called process may set."""
    for node in process.body.walk():
        yield from script_effects(node).writes
        if isinstance(node, model.Task) and node.result_variable:
            yield node.result_variable
        for topic, throws in node.topics():
            if not throws:
                yield from taken(node, topic, process.body)
    for body in process.body.bodies():
        for item in body.data_objects:
            yield from item.names


def _may_change(process: model.Process) -> Iterator[str]:
    """The variables whose values a called process may change in place."""
    for node in process.body.walk():
        yield from script_effects(node).changes | script_effects(node).may_change


def _may_set(process: model.Process) -> Iterator[str]:
    """The variables that scripts of a called process set, or may change in place."""
    for node in process.body.walk():
        yield from script_effects(node).writes | script_effects(node).may_change


def taken(node: model.FlowNode, topic: model.Topic, body: model.Body) -> tuple[str, ...]:
    """Return the variables that a caught message may set."""
    if topic.takes:
        return tuple(item.target for item in topic.takes)
    names = [name for item in body.data_objects if item.id in node.data_outputs for name in item.names]
    return (*names, variable_name(topic.name))


def step_codes(node: model.Activity, thrown: set[str] | None, body: model.Body) -> tuple[str, ...]:
    """Return the codes that a step may raise: those that it names, else those that its boundary events catch."""
    caught = [one.code for event in body.boundary(node.id) for one in event.defined(model.ErrorDefinition)]
    codes = set(thrown or ()) | {code for code in caught if code and (thrown is None or code in ("script", "no_flow"))}
    if None in caught and not codes:
        codes.add("script")
    return tuple(sorted(codes))


def _thrown_in(
    library: Library, home: model.Definitions, process: model.Process, catches: Set[str] | None, seen: set[str]
) -> set[str] | None:
    """The codes that leave a called process; None if it may raise any."""
    if process.id in seen:
        return set()
    seen.add(process.id)
    return _thrown_by(library, home, process.body, catches, seen)


def _thrown_by(
    library: Library, home: model.Definitions, body: model.Body, catches: Set[str] | None, seen: set[str]
) -> set[str] | None:
    caught: dict[str, set[str | None]] = defaultdict(set)
    for node in body.nodes:
        if node.place == "boundary":
            caught[node.attached_to] |= {one.code for one in node.defined(model.ErrorDefinition)}
        elif node.triggered_by_event and node.body is not None:
            starts = node.body.events("start")
            caught[""] |= {one.code for start in starts for one in start.defined(model.ErrorDefinition)}
    found: set[str] | None = set()
    for node in body.nodes:
        codes = _thrown_at(library, home, node, catches, seen)
        if codes is None and None not in caught[node.id]:
            found = None
        elif codes and found is not None and None not in caught[node.id]:
            found |= codes - caught[node.id]
    if None in caught[""]:
        return set()
    return None if found is None else found - caught[""]


def _thrown_at(
    library: Library, home: model.Definitions, node: model.FlowNode, catches: Set[str] | None, seen: set[str]
) -> set[str] | None:
    if node.body is not None:
        return _thrown_by(library, home, node.body, catches, seen)
    if isinstance(node, model.CallActivity):
        try:
            return _thrown_in(library, *library.find(home, node), catches, seen)
        except FameError:
            return None
    if node.place == "end":
        ends = node.defined(model.ErrorDefinition)
        return None if any(one.computed for one in ends) else {one.code for one in ends if one.code}
    if isinstance(node, model.Task) and (node.operation or node.kind == "service"):
        return _fails(node, catches) if node.service is not None else None
    effects = script_effects(node)
    if effects.codes is None:
        return None
    asked = effects.asked & catches if catches is not None else effects.asked - {"canceled"}
    return {*effects.codes, *asked, *(["script"] if effects.fails else [])}


# ---- variables that decide something ---------------------------------------------------------------------------------


@dataclass(slots=True)
class _Flow:
    """How values flow in one pool: (reads, writes) of each text; what is needed whatever it leads to."""

    needed: set[str] = field(default_factory=set)
    links: list[tuple[frozenset[str], frozenset[str]]] = field(default_factory=list)
    payloads: list[tuple[str, frozenset[str]]] = field(default_factory=list)
    takes: list[tuple[str, frozenset[str], frozenset[str]]] = field(default_factory=list)  # topic, reads, targets


def _needed(found: Abstraction, bodies: Sequence[model.Body]) -> frozenset[str]:
    """What `_keep_what_decides` will keep of any pool, if each statement of a script is looked at by itself."""
    return _decisive({"": _flow_of(found, bodies, divided=True)})[0][""]


def _keep_what_decides(found: Abstraction, bodies: Mapping[str, Sequence[model.Body]]) -> None:
    """Note what decides something: what a condition, time, loop or throwing script reads, and what leads to that."""
    found.kept, found.matters = _decisive({pool: _flow_of(found, inside) for pool, inside in bodies.items()})


def _decisive(flows: Mapping[str, _Flow]) -> tuple[dict[str, frozenset[str]], set[str]]:
    """Pool -> its variables that decide something or lead to one that does; the topics whose payloads do."""
    kept, matters = {pool: set(flow.needed) for pool, flow in flows.items()}, set[str]()
    size = -1
    while size < (size := sum(map(len, kept.values())) + len(matters)):
        for pool, flow in flows.items():
            names = kept[pool]
            names.update(*(reads for reads, writes in flow.links if writes & names))
            for topic, reads, targets in flow.takes:
                if targets & names:
                    matters.add(topic)
                    names |= reads - {"msg"}
            names.update(*(reads for topic, reads in flow.payloads if topic in matters))
    return {pool: frozenset(names) for pool, names in kept.items()}, matters


def _flow_of(found: Abstraction, bodies: Sequence[model.Body], *, divided: bool = False) -> _Flow:
    """How values flow; `divided`: in each statement of a script that is not taken as a whole."""
    flow = _Flow({*found.read}, [*found.aliases.links(bodies)] if divided else [])
    for body in bodies:
        for use in expressions_in(body):
            match use.use:
                case "condition" | "timer" | "mapping":
                    flow.needed |= use.reads
                case "value" if isinstance(use.element, model.DataObject):
                    flow.links.append((use.reads, frozenset(use.element.names)))
                case "value":
                    flow.needed |= use.reads
                case "script":
                    loud = {*use.effects.publishes} & (found.shared | found.types.keys())
                    caught = use.element.id in found.caught
                    if (
                        loud
                        or caught
                        or any(word in use.expression.text for word in ("raise", "throw", "assert", "signal("))
                    ):
                        flow.needed |= use.reads
                    changes = use.effects.may_change if use.expression.text.startswith(SHARED) else frozenset()
                    whole = (use.reads, use.effects.writes | changes)
                    flow.links += links(use.expression) if divided and not caught else (whole,)
        for node in body.nodes:
            _flow_of_topics(flow, node, body)
            if isinstance(node.loop, model.MultiInstance):
                flow.needed |= {node.loop.output_collection} - {""}
    return flow


def _flow_of_topics(flow: _Flow, node: model.FlowNode, body: model.Body) -> None:
    names = {name for topic, _ in node.topics() for name, _ in node.keys_of(topic)}
    flow.needed |= names
    for topic, throws in node.topics():
        if throws and topic.payload is not None:
            flow.payloads.append((topic.qualified, effects_of(topic.payload).reads))
        elif not throws:
            reads = frozenset(name for item in topic.takes for name in effects_of(item.source).reads)
            flow.takes.append((topic.qualified, reads, frozenset(taken(node, topic, body)) | names))


def _counted(processes: Iterable[model.Process]) -> frozenset[str]:
    """The variables with lists of which only the length is read: what they contain decides nothing."""
    counted, others = set[str](), set[str]()
    for process in processes:
        for body in process.body.bodies():
            for use in expressions_in(body):
                if use.expression.language == "python":
                    found = list_uses(use.expression, script=use.use == "script")
                    counted |= found[0]
                    others |= found[1]
                else:
                    others |= use.reads | use.effects.sets
            others |= {name for node in body.nodes for name in used_besides_texts(node, body)}
    return frozenset(counted - others)


def used_besides_texts(node: model.FlowNode, body: model.Body) -> Iterator[str]:
    """Yield the variables that an element uses besides its texts."""
    yield from node.sets()
    yield from node.io.sets() if node.io is not None else ()
    for topic, throws in node.topics():
        yield from (name for key, source in node.keys_of(topic) for name in (key, *effects_of(source).reads))
        if not throws:
            yield from taken(node, topic, body)
            yield from (name for item in topic.takes for name in effects_of(item.source).reads)


def _unknown(
    processes: Iterable[model.Process], outside: Set[str], parameters: Set[str] = frozenset()
) -> frozenset[str]:
    """The variables that only hold what comes from outside of the team, or what is computed from it."""
    values = defaultdict[str, list[ast.expr | None]](list)  # None: a value that may be known
    values |= {name: [None] for name in parameters}
    sources = set[str]()
    for process in processes:
        for body in process.body.bodies():
            for item in body.data_objects:
                for name, value in item.values:
                    values[name] += [] if value.text in ("", f"${{{name}}}") else [None]
            for node in body.nodes:
                if node.script is not None:
                    for name, assigned in assignments(node.script):
                        values[name].append(assigned)
                sensed = {variable_name(topic.name) for topic, throws in node.topics()
                          if not throws and topic.qualified in outside and not topic.takes}  # fmt: skip
                sources |= sensed
                for name in used_besides_texts(node, body):
                    values[name] += [] if name in sensed else [None]
    found = {name for name in sources if not values[name]}
    while grown := {
        name for name, all_values in values.items() if all_values and name not in found
        and all(one is not None and unknown_part(one, found) is not None for one in all_values)
    }:  # fmt: skip
        found |= grown
    return frozenset(found)
