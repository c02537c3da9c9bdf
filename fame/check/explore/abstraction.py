"""The abstraction of a team: its processes as they are explored, without what decides nothing.

Theory of operation. Each process is rewritten, and the engine executes the result as it executes any process:

1. `team_facts` reads all processes: their topics and codes, and what is known of their variables.
2. A call of a behaviour of which nobody notices the inside (`behaviours`) becomes a step, as a service is one: it ends
   at some time, or raises one of the error codes that it can (`failures`). What it sets is unknown.
3. What is left is rewritten once more, now that it is known what decides something: scripts lose the statements that
   set no such variable, and operations on what is unknown anyway. `decisive` names the variables that are kept.

The result does all that the processes can do, and more: what is left out is replaced by any time, any outcome, or an
unknown value. In doubt something counts as deciding, which costs states; docs/abstraction.md lists what is not found.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from fame.bpmn import model
from fame.bpmn.library import Library
from fame.bpmn.linked_forms import form_of
from fame.bpmn.model.forms import is_whole
from fame.bpmn.pools import Pool, all_processes
from fame.bpmn.topics import TopicUse
from fame.check.explore.aliases import changes_in_place
from fame.check.explore.behaviours import is_step
from fame.check.explore.counting import without_items
from fame.check.explore.decisive import decisive, needed_by_statements
from fame.check.explore.element_variables import assigned_by, changed_by, written_by, written_objects
from fame.check.explore.error_codes import computed_codes
from fame.check.explore.failures import Failures, Guarded, in_order
from fame.check.explore.mismatches import Kinds, kinds_in
from fame.check.explore.slicing import may_fail, skipped, sliced, without_operations
from fame.check.explore.team_facts import TeamFacts, facts_of
from fame.check.explore.values import MARK
from fame.check.expressions import cover_all
from fame.dataclasses import dataclass, field, fields, replace
from fame.engine.data import variable_name
from fame.errors import FameError
from fame.scripting.effects import effects_of, script_effects

_TEXT = model.Expression(MARK, "template")
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
    open     whether it may set any other variable, too
    """

    writes: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    used: tuple[str, ...] = ()
    codes: tuple[str, ...] = ()
    emits: tuple[tuple[str, bool], ...] = ()
    open: bool = False


def step_name(file: str, element: str) -> str:
    """Return the name of the step of a behaviour, service or action."""
    return f"{STEP}{file} {element}"


@dataclass(slots=True)
class Abstraction:
    """The processes of a team as they are explored.

    needed   variables without which a script or expression that decides something could not run; None: not yet known
    kept     pool -> its variables that decide something
    matters  topics whose payload decides something
    steps    what each step does, by its name
    caught   scripts with an error event at their task, at a sub-process around it, or in one
    guarded  scripts, timers and gateways whose exceptions an error event may catch
    risky    scripts that may raise something on values of the kind that they expect, timers, and gateways of `guarded`
    asks     script that waits for actions and services -> the codes with which it may fail because of them
    computed (throwing event, text of its computed code) -> the named codes that it may have
    counts   (element, text) of a collection or cardinality -> whether it is a cardinality
    skipped  script -> a statement that is left out although it may raise
    payloads (throwing event, text of its payload) -> topic, where no error event catches that it does not fit
    given    task -> the variables that a person sets who completes it: of its form, and of the data that it writes
    formless tasks without a form that is known: a person may set any other variable, too

    originals script task -> its scripts as they are in the model, of each task with this id
    uses     (element, text) of conditions, mappings and payloads that fail if a value does not fit -> their use

    Elements are known by their ids alone, so that what two processes with one id add is joined.
    """

    library: Library
    facts: TeamFacts
    failures: Failures
    kinds: Kinds
    needed: frozenset[str] | None = None
    kept: Mapping[str, frozenset[str]] = field(default_factory=dict)
    matters: frozenset[str] = frozenset()
    steps: dict[str, AbstractStep] = field(default_factory=dict)
    caught: set[str] = field(default_factory=set)
    guarded: set[str] = field(default_factory=set)
    risky: set[str] = field(default_factory=set)
    asks: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    computed: dict[tuple[str, str], Collection[str]] = field(default_factory=dict)
    counts: dict[tuple[str, str], bool] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    payloads: dict[tuple[str, str], str] = field(default_factory=dict)
    given: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    formless: set[str] = field(default_factory=set)
    originals: dict[str, dict[model.Expression, None]] = field(default_factory=lambda: defaultdict(dict))
    uses: dict[tuple[str, str], str] = field(default_factory=dict)
    _homes: dict[str, model.Definitions] = field(default_factory=dict)
    _rewritten: dict[tuple[str, int], tuple[model.Process, model.Process]] = field(default_factory=dict)

    def process(self, home: model.Definitions, process: model.Process) -> model.Process:
        """Return a process without the inside of behaviours."""
        key = (home.file, id(process))  # not its id: robots of a pool may have different processes of one id
        if key not in self._rewritten:
            self._homes[home.file] = home
            # Who calls it is not asked: any error event that catches what scripts raise may be at the call.
            guarded = not self.facts.catches.isdisjoint({"", "script", "no_flow"}) and process.id in self.facts.called
            body = _Rewriter(self, home).body(process.body, guarded)
            self._rewritten[key] = process, replace(process, body=body)  # the first keeps the key's object alive
        return self._rewritten[key][1]

    def find(self, name: str, file: str, call: model.CallActivity) -> tuple[model.Process, str]:
        """Find a called process that is not a step (the library of the compiler)."""
        home, process = self.library.find(self._homes[file], call)
        return self.process(home, process), home.file

    def bodies(self, home: model.Definitions, process: model.Process) -> list[model.Body]:
        """Return all bodies of an abstract process and of what it calls."""
        bodies, seen = list[model.Body](), set[tuple[str, int]]()
        pending = [(home, process)]
        while pending:
            home, process = pending.pop()
            if (home.file, id(process)) in seen:
                continue
            seen.add((home.file, id(process)))
            body = self.process(home, process).body
            bodies += body.bodies()
            pending += [self.library.find(home, call) for call in body.calls()]
        return bodies


def abstraction(
    definitions: model.Definitions,
    pools: Sequence[Pool],
    library: Library,
    types: Mapping[str, TopicUse],
    *,
    given: bool = False,
    read: frozenset[str] = frozenset(),
    parameters: Mapping[str, Collection[Any]] = MappingProxyType({}),
    named: frozenset[str] = frozenset(),
) -> Abstraction:
    """Return the abstraction of a team. Raises ModelError for calls of unknown processes.

    types       the topics of the team
    given       some robots go on from snapshots, so that variables may have values which nothing in the model gives
    read        variables that properties read: they count as what decides something
    parameters  variables with which a process starts, and their values
    named       error codes that properties name
    """
    homes = [*all_processes(definitions, pools, library)]
    processes = [process for _, process in homes]
    kinds = _kinds(homes, types, parameters, given=given)
    facts = facts_of(processes, types, given=given, read=read, parameters=parameters.keys(), named=named)  # fmt: skip
    first = Abstraction(library, facts, Failures(library, facts), kinds)
    bodies = [body for pool in pools for body in first.bodies(definitions, pool.process)]
    needed = needed_by_statements(facts, first.caught, bodies)
    rewritten = Abstraction(library, facts, Failures(library, facts), kinds, needed)
    by_pool = {pool.name: rewritten.bodies(definitions, pool.process) for pool in pools}
    rewritten.kept, rewritten.matters = decisive(facts, rewritten.caught, by_pool)
    return rewritten


@dataclass(frozen=True, slots=True)
class _Rewriter:
    """Rewrites the bodies of one file, and notes in the abstraction what their steps and scripts do."""

    to: Abstraction
    home: model.Definitions

    def body(self, body: model.Body, inside: bool) -> model.Body:
        """Return a body as it is explored; `inside`: whether an error event is around it."""
        handlers = (node.body for node in body.nodes if node.triggered_by_event and node.body is not None)
        inside |= any(start.defined(model.ErrorDefinition) for handler in handlers for start in handler.nodes)
        hosts = frozenset(node.attached_to for node in body.nodes if node.defined(model.ErrorDefinition))
        within = Guarded(body, inside, hosts)
        return replace(body, nodes=tuple(self._node(node, within) for node in body.nodes))

    def _node(self, node: model.FlowNode, guarded: Guarded) -> model.FlowNode:
        self._note_texts(node, guarded)
        if isinstance(loop := node.loop, model.MultiInstance):
            texts = ((loop.collection, False), (loop.cardinality, True))
            self.to.counts |= {(node.id, text.text): number for text, number in texts if text is not None}
        match node:
            case model.SubProcess():
                return replace(node, body=self.body(node.body, node in guarded))
            case model.CallActivity():
                return self._call(node, guarded)
            case model.Gateway():
                if self._is_noticed(node, guarded, "script"):
                    self.to.risky.add(node.id)
                    self.to.guarded.add(node.id)
                return node if self._is_noticed(node, guarded, "no_flow") else _with_way_out(node, guarded.body)
            case model.Event():
                return self._event(node, guarded)
            case model.Task(kind="script", script=model.Expression() as script):
                return self._script(node, script, guarded)
            case model.Task(kind="service"):
                self.to.steps[step_name(self.home.file, node.id)] = self._service(node, guarded)
            case model.Task(kind="user" | "manual"):
                self.to.given[node.id] |= _asked_by(self.home, node).union(written_objects(node, guarded.body))
                self.to.formless.update(() if is_whole(form_of(self.home, node.human)) else (node.id,))
        return node

    def _note_texts(self, node: model.FlowNode, guarded: Guarded) -> None:
        """Note the texts of an element that fail if a value does not fit, and whether an error event catches that."""
        if node.defined(model.ConditionalDefinition):  # it does not hold then
            return
        flows = [flow for flow in guarded.body.flows if flow.source == node.id]
        texts = [*node.texts(), *((flow.condition, "condition") for flow in flows if flow.condition is not None)]
        given = [value for item in guarded.body.data_objects if item.id in node.data_inputs
                 for name, value in item.values if value.text != f"${{{name}}}"]  # fmt: skip
        texts = [*(one for one in texts if one[1] != "script"), *((value, "value") for value in given)]
        self.to.uses.update(((node.id, text.text), use) for text, use in texts)
        if (texts and isinstance(node, model.Activity) and self.to.failures.exceptions_are_caught(node, guarded)) or (
            texts and not isinstance(node, model.Activity) and self._is_noticed(node, guarded, "script")
        ):
            self.to.guarded.add(node.id)

    def _is_noticed(self, node: model.FlowNode, guarded: Guarded, code: str) -> bool:
        """Whether an error event may catch it if an event or gateway fails with a code."""
        here = guarded.inside or (isinstance(node, model.Event) and node.attached_to in guarded.hosts)
        return here and not self.to.facts.catches.isdisjoint({"", code})

    def _event(self, event: model.Event, guarded: Guarded) -> model.Event:
        """An event whose error has a text that is not known: what texts for people read need not be kept."""
        facts = self.to.facts
        noticed = self._is_noticed(event, guarded, "script")
        if noticed:
            self.to.caught.add(event.id)
        if event.defined(model.TimerDefinition):
            self.to.risky.add(event.id)
            self.to.guarded.update((event.id,) if noticed else ())
        for topic, throws in event.topics():
            if throws and topic.payload is not None and effects_of(topic.payload).reads and not noticed:
                self.to.payloads[event.id, topic.payload.text] = topic.qualified
        for text, escalates in computed_codes(event):
            self.to.computed[event.id, text] = facts.escalations if escalates else facts.codes
        kept = (replace(one, message=_TEXT) if isinstance(one, model.ErrorDefinition) and one.message else one
                for one in event.definitions)  # fmt: skip
        return replace(event, definitions=tuple(kept))

    def _script(self, task: model.Task, script: model.Expression, guarded: Guarded) -> model.Task:
        """A script without what decides nothing. What it raises may decide something if an error event may notice."""
        facts, needed = self.to.facts, self.to.needed
        self.to.originals[task.id][script] = None
        original = script
        if may_fail(script):
            self.to.risky.add(task.id)
        if task in guarded or effects_of(script, script=True).fails:
            self.to.caught.add(task.id)
        if self.to.failures.exceptions_are_caught(task, guarded):
            self.to.guarded.add(task.id)
        self.to.asks[task.id] |= self.to.failures.of_script(task, guarded)
        caught = task.id in self.to.caught  # then what it computes may fail, and that decides something
        script = without_items(script, facts.counted, may_fail=caught)
        script = script if caught else without_operations(script, facts.unknown)
        if needed is not None:
            whole = caught or not facts.aliases.holders.isdisjoint(effects_of(script, script=True).reads)
            raises = may_fail(original) or self.to.kinds.mismatch(original, script=True)
            if not whole and raises and (statement := skipped(script, needed)):
                self.to.skipped[task.id] = statement
            script = facts.aliases.marked(script if whole else sliced(script, needed), needed)
        return replace(task, script=script)

    def _service(self, task: model.Task, guarded: Guarded) -> AbstractStep:
        """A service or action: its feedback comes at any time, its result at its end."""
        results = set[str]()
        if task.service is not None and task.io is not None and task.io.outputs:
            results = {"msg"}.union(*(effects_of(item.source).reads for item in task.io.outputs))
        elif task.service is not None and not task.result_variable:
            results = {*written_objects(task, guarded.body)} or {variable_name(task.service.name)}
        feedback = re.findall(r"\w+", task.properties.get("feedback", ""))
        codes = self.to.failures.of_service(task, guarded)
        return AbstractStep(writes=tuple(feedback), results=in_order(results), codes=in_order(codes))

    def _call(self, call: model.CallActivity, guarded: Guarded) -> model.FlowNode:
        """A call as a step, if what it calls is one."""
        try:
            called = self.to.library.find(self.home, call)
            if not is_step(self.to.library, *called, self.to.facts.shared):
                return call
        except FameError:  # the compiler refuses it
            return call
        inside = [*self.to.library.closure(*called)]
        processes = [process for _, process in inside]
        name, codes = step_name(self.home.file, call.id), self._codes_of_call(call, called, processes, guarded)
        self.to.steps[name] = replace(self._call_variables(call, inside), codes=codes)
        kept = {item.name: getattr(call, item.name) for item in fields(model.Activity)}
        return model.Task(kind="service", operation=name, **kept | {"io": None, "copies_out": (), "required": ()})

    def _codes_of_call(
        self, call: model.CallActivity, called: tuple[model.Definitions, model.Process],
        processes: Sequence[model.Process], guarded: Guarded,
    ) -> tuple[str, ...]:  # fmt: skip
        """The codes with which a call may fail: those of what it calls, and that of its mapping."""
        items = (*call.io.inputs, *call.io.outputs) if call.io is not None else ()
        mismatch = next(filter(None, (self.to.kinds.mismatch(item.source) for item in items)), "")
        return self.to.failures.of_call(call, called, processes, guarded, mismatch)

    def _call_variables(
        self, call: model.CallActivity, inside: Sequence[tuple[model.Definitions, model.Process]]
    ) -> AbstractStep:
        """What a call does to variables: with a mapping only its outputs are set, and only when it ends."""
        processes = [process for _, process in inside]
        asked = [_asked_by(home, node) for home, process in inside for node in process.body.walk()
                 if isinstance(node, model.Task) and node.kind in ("user", "manual")]  # fmt: skip
        writes = {name for process in processes for name in written_by(process)}.union(*asked)
        whole = all(is_whole(form_of(home, node.human)) for home, process in inside for node in process.body.walk()
                    if isinstance(node, model.Task) and node.kind in ("user", "manual"))  # fmt: skip
        is_open = not whole or any(script_effects(node).open for one in processes for node in one.body.walk())
        nodes = [node for process in processes for node in process.body.walk() if node.script is not None]
        in_place = {name for node in nodes if node.script for name, _ in changes_in_place(node.script)}
        changes = self._with_aliases(in_place.union(*map(changed_by, processes)))
        changes |= self.to.facts.leaked
        assigned = {name for process in processes for name in assigned_by(process)}
        used = assigned.union(*(self.to.facts.coarse.of((name, False)) for name in assigned))
        results = set[str]()
        if call.io is not None:
            if not call.io.all_in:  # what it is given may be a list that the caller has, too
                given = {name for item in call.io.inputs for name in effects_of(item.source).reads}
                beside = self._with_aliases(given) & changes
                changes, used = (given if names else set() for names in (changes, used))
                changes |= beside
            results = {item.target for item in call.io.outputs} | (writes if call.io.all_out else set())
            writes, is_open = set(), is_open and call.io.all_out
        return AbstractStep(in_order(writes), in_order(changes), in_order(results), in_order(used), open=is_open)

    def _with_aliases(self, names: Iterable[str]) -> set[str]:
        given = {*names}
        every = given.union(*(self.to.facts.aliases.of((name, False)) for name in given))
        return {*filter(str.isidentifier, every)}


def _kinds(
    homes: Sequence[tuple[model.Definitions, model.Process]],
    types: Mapping[str, TopicUse], parameters: Mapping[str, Collection[Any]], *, given: bool,
) -> Kinds:  # fmt: skip
    """The kinds of variables, of which nothing is known if a person may set any of them."""
    forms = [form_of(home, node.human) for home, process in homes for node in process.body.walk()
             if isinstance(node, model.Task) and node.kind in ("user", "manual")]  # fmt: skip
    fields_of_forms = [(one.key.partition(".")[0], "value" if "." in one.key else one.kind, one.required)
                       for form in forms for one in form if one.key]  # fmt: skip
    nothing = given or not all(map(is_whole, forms))
    return kinds_in([process for _, process in homes], types, parameters, fields_of_forms, nothing=nothing)


def _asked_by(home: model.Definitions, task: model.Task) -> set[str]:
    """The variables of the form of a task."""
    return {field.key.partition(".")[0] for field in form_of(home, task.human) if field.key}


def _with_way_out(gateway: model.Gateway, body: model.Body) -> model.Gateway:
    """A gateway of which one condition is always true: if no other one is, the last one is, on unknown values, too."""
    flows = [flow for flow in body.flows if flow.source == gateway.id]
    conditions = [flow.condition for flow in flows if flow.condition is not None]
    if gateway.kind != "exclusive" or gateway.default or len(conditions) < len(flows) or not cover_all(conditions):
        return gateway
    return replace(gateway, default=flows[-1].id)
