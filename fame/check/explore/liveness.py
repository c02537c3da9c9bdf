"""Variables that nothing reads any more: their values are forgotten, so that states differ only in what counts.

From an element at which a token waits a variable is *live* if a way leads to an element that reads it, without passing
one that certainly sets it before. A token may also come to boundary events and event sub-processes around it. What is
dead becomes unknown. A script that only changes a value in place, or counts, reads it: on one that is unknown it would
not fail. A variable is removed if no way leads to an element that reads it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from types import MappingProxyType

from fame.bpmn import model
from fame.check.explore.abstraction import Abstraction
from fame.check.explore.element_variables import taken
from fame.check.explore.graph import reachable
from fame.check.explore.remembering import key_of
from fame.check.expressions import expressions_in
from fame.engine.data import variable_name
from fame.errors import FameError
from fame.scripting.effects import effects_of, script_effects

Dead = tuple[frozenset[str], frozenset[str]]
"""Variables whose values are not read before they are set, and variables that are not read at all."""


class Liveness:
    """Which variables are dead while tokens wait at some elements of an abstract process.

    after     where a token goes from an element
    aside     where it may come if something happens at the element
    elements  all elements, of called processes too
    applies   whether tokens go only where these say
    """

    def __init__(self, home: model.Definitions, process: model.Process, abstract: Abstraction, kept: Set[str],
                 remembered: Mapping[str, Set[str]] = MappingProxyType({})) -> None:  # fmt: skip
        self._abstract, self._kept, self._matters, self._remembered = abstract, kept, abstract.matters, remembered
        self.after: dict[str, set[str]] = defaultdict(set)
        self.aside: dict[str, set[str]] = defaultdict(set)
        self._reads: dict[str, set[str]] = defaultdict(set)
        self._changes: dict[str, set[str]] = defaultdict(set)  # what a script reads that it has set before
        self._sets: dict[str, set[str]] = {}
        self._always: set[str] = {*abstract.facts.read}
        self._dead: dict[frozenset[str], Dead] = {}
        self._live_at: dict[str, Dead] = {}
        self.applies: bool = True
        self._open: list[tuple[str, str]] = []  # called processes around
        self._inner: set[str] = set()  # variables that scopes have of their own
        self._add(home, abstract.process(home, process).body, (), ())
        self.elements: Set[str] = self._sets.keys()
        for sets in self._sets.values():
            sets -= self._inner

    def dead(self, waiting: Iterable[str]) -> Dead:
        """Return the variables that nothing reads from now on before they are set, and those that
        nothing ever reads."""
        elements = frozenset(waiting)
        dead_and_unused = self._dead.get(elements)
        if dead_and_unused is None:
            dead_and_unused = (frozenset(), frozenset())
            if self.applies and elements and elements <= self._reads.keys():
                live, used = zip(*map(self._live, elements), strict=True)
                left = frozenset(self._kept - self._always)
                unused = left.difference(*used)
                dead = left.difference(*live)
                unused |= dead & self._remembered.keys()
                dead_and_unused = (dead - unused, unused)
            self._dead[elements] = dead_and_unused
        return dead_and_unused

    def _live(self, element: str) -> Dead:
        """The variables that are live while a token waits at an element, and those that an element behind it reads."""
        if element not in self._live_at:
            behind = reachable([element], lambda one: self.after[one] | self.aside[one])
            used = {name for one in behind for name in self._reads[one] | self._changes[one]} & self._kept
            live = frozenset(name for name in used if self._is_read(element, name))
            self._live_at[element] = (live, frozenset(used))
        return self._live_at[element]

    def _is_read(self, element: str, name: str) -> bool:
        """Whether a token may come from an element to one that reads a variable before it is set."""
        seen, pending = {element}, [element]
        while pending:
            at = pending.pop()
            if name in self._reads[at]:
                return True
            nexts = self.aside[at] if name in self._sets[at] else self.aside[at] | self.after[at]
            for after in nexts - seen:
                seen.add(after)
                pending.append(after)
        return False

    # ---- the elements --------------------------------------------------------------------------------

    def _add(
        self, home: model.Definitions, body: model.Body, leaving: tuple[str, ...], aside: tuple[str, ...],
        results: frozenset[str] = frozenset(), mapped: bool = False,
    ) -> None:  # fmt: skip
        """Add a body, behind whose end the elements `leaving` come; `aside` may come at any time.

        `results` are read at its end, if it is that of a called process. `mapped`: it has variables of its own.
        """
        aside = (*aside, *(one.id for one in body.nodes if one.triggered_by_event))
        boundary: dict[str, list[str]] = defaultdict(list)
        behind: dict[str, set[str]] = defaultdict(set)
        for node in body.nodes:
            if node.place == "boundary":
                boundary[node.attached_to].append(node.id)
        for flow in body.flows:
            behind[flow.source].add(flow.target)
        for node in body.nodes:
            self.applies &= _is_simple(node)
            around, follows = (*aside, *boundary[node.id]), behind[node.id] or {*leaving}
            loops, own = node.loop is not None, node.io is not None
            sets = set() if loops or mapped or own else {*_set_by(node, body)}
            sets |= {key for key, one in self._remembered.items() if one & sets}
            if isinstance(node.loop, model.MultiInstance):
                self._inner.add(node.loop.element_variable)
            self._sets[node.id] = self._sets.get(node.id, sets) & sets  # a process that is called twice
            self.aside[node.id] |= {*around}
            self._reads[node.id] |= {*_read_by(node, self._matters), *results}
            self.after[node.id] |= follows
            again = {node.id} if loops else set[str]()
            if node.body is not None:
                again |= {node.id} if node.triggered_by_event else set()
                self.after[node.id] |= {*_entries(node.body)}
                self._add(home, node.body, (*follows, *again), around, results, mapped or own)
            elif isinstance(node, model.CallActivity):
                self._add_called(home, node, (*follows, *again), around, results, mapped)
        for use in expressions_in(body):
            if isinstance(use.element, model.DataObject):
                if self._kept & {*use.element.names}:
                    self._always |= use.reads
            elif use.use != "payload":
                element = use.element.source if isinstance(use.element, model.SequenceFlow) else use.element.id
                changes = use.reads - use.effects.read_first if use.use == "script" else frozenset()
                self._reads[element] |= (use.reads - changes) | ({key_of(use.expression)} & self._remembered.keys())
                self._changes[element] |= changes

    def _add_called(
        self, home: model.Definitions, call: model.CallActivity, leaving: tuple[str, ...], aside: tuple[str, ...],
        results: frozenset[str], mapped: bool,
    ) -> None:  # fmt: skip
        try:
            there, process = self._abstract.library.find(home, call)
        except FameError:
            self.applies = False
            return
        key = (there.file, process.id)
        if key in self._open:  # it calls itself
            self.applies = False
            return
        body = self._abstract.process(there, process).body
        self.after[call.id] |= {*_entries(body)}
        sources = [item.source for item in (*(call.io.outputs if call.io else ()), *call.copies_out)]
        self._open.append(key)
        mapped |= call.io is not None or bool(call.copies_in or call.copies_out)
        self._add(there, body, leaving, aside, results.union(*(effects_of(one).reads for one in sources)), mapped)
        self._open.pop()


def _is_simple(node: model.FlowNode) -> bool:
    """Whether a token can go from an element only where flows, boundary events and event sub-processes lead."""
    if node.for_compensation or node.tag in ("transaction", "adHocSubProcess", "complexGateway"):
        return False
    if node.script is not None and node.script.language != "python":
        return False
    return not any(one.trigger in ("link", "compensate", "cancel") for one in node.definitions)


def _entries(body: model.Body) -> Sequence[str]:
    """The elements at which tokens come into a body."""
    targets = {flow.target for flow in body.flows}
    first = [node.id for node in body.nodes if node.id not in targets and node.place != "boundary"]
    return first or [node.id for node in body.nodes]


def _read_by(node: model.FlowNode, matters: Set[str]) -> Iterator[str]:
    """What an element reads besides its texts: output collections, correlation keys, payloads that matter."""
    if isinstance(node.loop, model.MultiInstance):
        yield node.loop.output_collection
    for topic, throws in node.topics():
        for name, source in node.keys_of(topic):
            yield from (name, name.partition(".")[0], *effects_of(source).reads)
        if throws and topic.payload is not None and topic.qualified in matters:
            yield from effects_of(topic.payload).reads
        elif not throws:
            yield from (name for item in topic.takes for name in effects_of(item.source).reads)


def _set_by(node: model.FlowNode, body: model.Body) -> Iterator[str]:
    """The variables that an element certainly sets if it completes."""
    if node.tag == "scriptTask" and node.script is not None:
        yield from script_effects(node).always
    elif len(node.definitions) == 1:
        for topic, throws in node.topics():
            name = variable_name(topic.name)
            if not throws and not topic.takes and taken(node, topic, body) == (name,):
                yield name
            yield from (item.target for item in topic.takes if effects_of(item.source).reads <= {"msg"})
