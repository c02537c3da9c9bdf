"""Variables and payloads that decide something; the values of all others are left out of an exploration.

A variable decides something if a condition, timer, loop or mapping reads it, a script that another robot or an error
event may notice, or a property. What its value is computed from decides something, too: that is the least set that
contains both, over the links from what a text reads to what it sets, and over the payloads of signals between robots.

A link too many costs states, a link too few would hide runs. So a script that cannot be divided into statements links
all that it reads to all that it sets, and a text that looks as if it raises counts as one that does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from fame.bpmn import model
from fame.check.explore.aliases import SHARED
from fame.check.explore.element_variables import results_read, taken
from fame.check.explore.slicing import Dependency, links
from fame.check.explore.team_facts import TeamFacts
from fame.check.expressions import ExpressionUse, expressions_in
from fame.dataclasses import dataclass, field
from fame.scripting.effects import effects_of

_NOTICED = ("raise", "throw", "assert", "signal(")
"""Words of scripts that may do more than set variables."""


@dataclass(slots=True)
class _Flow:
    """How values flow in the processes of one pool.

    needed    variables that decide something by themselves
    links     (reads, writes) of each text
    payloads  (topic, what its payload reads)
    topics    those whose payload decides something by itself
    takes     (topic, what is read with its message, the variables that the message sets)
    """

    needed: set[str] = field(default_factory=set)
    links: list[Dependency] = field(default_factory=list)
    payloads: list[tuple[str, frozenset[str]]] = field(default_factory=list)
    topics: set[str] = field(default_factory=set)
    takes: list[tuple[str, frozenset[str], frozenset[str]]] = field(default_factory=list)


def needed_by_statements(facts: TeamFacts, caught: Set[str], bodies: Sequence[model.Body]) -> frozenset[str]:
    """Return what may decide something in any pool, if each statement of a script is looked at by itself.

    All pools are taken as one, since robots of several pools may run the same called process.
    """
    flow = _Flow({*facts.read}, [*facts.aliases.links(bodies)])
    _add_bodies(flow, facts, caught, bodies, divided=True)
    return _fixed_point({"": flow})[0][""]


def decisive(
    facts: TeamFacts, caught: Set[str], bodies: Mapping[str, Sequence[model.Body]]
) -> tuple[dict[str, frozenset[str]], frozenset[str]]:
    """Return pool -> its variables that decide something, and the topics whose payloads do.

    `caught`: scripts whose failures may decide something.
    """
    flows = {pool: _Flow({*facts.read}) for pool in bodies}
    for pool, flow in flows.items():
        _add_bodies(flow, facts, caught, bodies[pool])
    return _fixed_point(flows)


def _fixed_point(flows: Mapping[str, _Flow]) -> tuple[dict[str, frozenset[str]], frozenset[str]]:
    kept = {pool: set(flow.needed) for pool, flow in flows.items()}
    topics = set[str]().union(*(flow.topics for flow in flows.values()))
    size = -1
    while size < (size := sum(map(len, kept.values())) + len(topics)):
        for pool, flow in flows.items():
            names = kept[pool]
            names.update(*(reads for reads, writes in flow.links if writes & names))
            for topic, reads, targets in flow.takes:
                if targets & names:
                    topics.add(topic)
                    names |= reads - {"msg"}
            names.update(*(reads for topic, reads in flow.payloads if topic in topics))
    return {pool: frozenset(names) for pool, names in kept.items()}, frozenset(topics)


def _add_bodies(
    flow: _Flow, facts: TeamFacts, caught: Set[str], bodies: Sequence[model.Body], *, divided: bool = False
) -> None:
    """Add what flows in bodies. `divided`: in each statement of a script that is not taken as a whole."""
    for body in bodies:
        for use in expressions_in(body):
            if use.use == "script":
                _add_script(flow, use, facts, caught=use.element.id in caught, divided=divided)
            elif isinstance(use.element, model.DataObject) and use.use == "value":
                flow.links.append((use.reads, frozenset(use.element.names)))
            elif use.use in ("condition", "timer", "mapping", "value"):
                flow.needed |= use.reads
        for node in body.nodes:
            _add_topics(flow, node, body, noticed=node.id in caught)
            flow.needed |= {*results_read(node)}
            if isinstance(node.loop, model.MultiInstance):
                flow.needed |= {node.loop.output_collection} - {""}


def _add_script(flow: _Flow, use: ExpressionUse, facts: TeamFacts, *, caught: bool, divided: bool) -> None:
    publishes = {*use.effects.publishes} & (facts.shared | facts.types.keys())
    if publishes or caught or any(word in use.expression.text for word in _NOTICED):
        flow.needed |= use.reads
    calls = not facts.aliases.holders.isdisjoint(use.reads)
    if calls:
        flow.links.append((use.reads, facts.leaked))
    if divided and not caught and not calls:
        flow.links += links(use.expression)
    else:
        marked = use.expression.text.startswith(SHARED)  # by `Aliases.marked`, with what it may change besides
        changes = use.effects.may_change if marked else use.effects.reaches
        flow.links.append((use.reads, use.effects.writes | changes))


def _add_topics(flow: _Flow, node: model.FlowNode, body: model.Body, *, noticed: bool) -> None:
    """Add what flows by topics. `noticed`: an error event may catch that a payload does not fit its type."""
    keys = {name for topic, _ in node.topics() for name, _ in node.keys_of(topic)}
    flow.needed |= keys
    for topic, throws in node.topics():
        if not throws:
            reads = frozenset(name for item in topic.takes for name in effects_of(item.source).reads)
            flow.takes.append((topic.qualified, reads, frozenset(taken(node, topic, body)) | keys))
        elif topic.payload is not None:
            flow.payloads.append((topic.qualified, effects_of(topic.payload).reads))
            flow.topics.update((topic.qualified,) if noticed else ())
