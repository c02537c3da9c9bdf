"""The search of a team with one way of delivery, and what is known after it.

What follows from a single fault, or from a failure that nothing catches, is explored by itself: such a failure is a way
out of a deadlock, and must not hide it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from fame.bpmn.model import FlowNode
from fame.check.explore.faults import Faults
from fame.check.explore.findings import ExplorationReport, Finding
from fame.check.explore.graph import Explored
from fame.check.explore.growth import MOST_AT_ONE_PLACE, MOST_INSTANCES
from fame.check.explore.host import Stop, never
from fame.check.explore.places import accepted, elements_of
from fame.check.explore.product import Delivery, Options, Product
from fame.check.explore.properties import Judged
from fame.check.explore.reduction import Reduction
from fame.check.explore.result import Searched
from fame.check.explore.search import explore
from fame.check.explore.team import Team
from fame.check.explore.trace import Runs
from fame.check.explore.transitions import FAULTS, MASK
from fame.dataclasses import dataclass, replace
from fame.engine.program import Node
from fame.scripting.effects import computed_topics

_HOLDING = ("proved", "not triggered")


@dataclass(slots=True)
class SearchBudget:
    """What searches share: how many states are left for them, and whether the time is over, also that for findings."""

    left: int
    stop: Stop
    stop_findings: Stop = never


def search(team: Team, delivery: Delivery, budget: SearchBudget) -> tuple[Searched, list[Finding]]:
    """Explore a team with one delivery, and where that is asked for, what single faults lead to."""
    begun = time.perf_counter()
    report, cuts = _explore(team, delivery, budget)
    searches = [report.explored]
    note_received(team, report)
    findings, faults = report.findings(), list[tuple[str, str, Finding | None]]()
    left_out = report.left_out
    judged = team.monitors.judge(report.runs, exhaustive=not cuts) if team.monitors is not None else ()
    if team.request.faults and budget.left <= 0:
        cuts = (*cuts, "no budget is left for single faults")
    elif team.request.faults:
        report, further_cuts = _explore(team, delivery, budget, faults=True)
        searches.append(report.explored)
        cuts, faults = tuple(dict.fromkeys((*cuts, *further_cuts))), report.faults()
        left_out += report.left_out
        findings += [finding for _, _, finding in faults if finding is not None]
    searched = Searched(
        delivery=delivery,
        states=sum(len(explored.states) for explored in searches),
        transitions=sum(explored.transitions for explored in searches),
        seconds=time.perf_counter() - begun,
        cuts=cuts,
        left_out=left_out_of(left_out),
        bound=bool(left_out) or any(explored.cut for explored in searches),
        faults=tuple((name, delivery, outcome) for name, outcome, _ in faults),
        judged=tuple(judged),
    )
    return searched, findings


def left_out_of(counts: Mapping[str, int]) -> tuple[str, ...]:
    """Return in words what findings were not made for lack of time."""
    return tuple(f"{number:,} {what} not looked into" for what, number in counts.items())


def after_failures(team: Team, searched: Searched, budget: SearchBudget) -> Searched:
    """Return the search with only those proofs that also hold if services, actions and scripts fail uncaught.

    Other proofs become "not known". What follows from such failures is explored for this alone: it is no finding.
    """
    entered = set[str]().union(*(local.states.visited | local.host.doubted.keys() for local in team.locals))
    may_fail = sorted({element for element, _ in team.model.failures.unhandled}.union(_supposed(team)) & entered)
    if not may_fail or team.monitors is None or not any(proof.verdict in _HOLDING for proof in searched.judged):
        return searched
    again = dict[str, Judged]()
    cuts: tuple[str, ...] = ("no budget is left",)
    left = budget.left
    if left > 0 and not budget.stop():
        report, cuts = _explore(team, searched.delivery, budget, unhandled=True)
        again = {judged.name: judged for judged in team.monitors.judge(report.runs, exhaustive=not cuts)}
    judged = (_after_failures(team, proof, again.get(proof.name), may_fail, cuts) for proof in searched.judged)
    return replace(searched, judged=tuple(judged), states=searched.states + left - budget.left)


def _supposed(team: Team) -> set[str]:
    """What fails only because it is not known that it does not."""
    return set[str]().union(*(local.host.supposed | local.host.doubted.keys() for local in team.locals))


def _after_failures(
    team: Team, proof: Judged, again: Judged | None, may_fail: Sequence[str], cuts: Sequence[str]
) -> Judged:
    """What is known of a property; `again`: what a search says in which services fail, as far as there was one."""
    if proof.verdict not in _HOLDING or (again is not None and again.verdict in _HOLDING):
        return proof
    run = again.run if again is not None else ()
    supposed = _supposed(team)
    unhandled = team.model.failures.unhandled | {(element, "script") for element in supposed}
    steps = [(step.element, step.detail) for step in run]
    chosen = [(element, "script") for step in run for element, way, _ in step.choices if way and element in supposed]
    failed = [one[0] for one in (*steps, *chosen) if one in unhandled]
    elements = dict.fromkeys(failed or may_fail)
    names = " or ".join(team.places[element].display_name for element in elements)
    why = f"{names} may fail, and nothing catches it"
    texts = {element: text for local in team.locals for element, text in local.host.doubted.items()}
    if where := " or ".join(f"`{texts[element]}`" for element in elements if element in texts):
        why += f", for example at {where}"
    if cuts and (again is None or again.verdict != "refuted"):
        why += f"; what follows is not explored whole ({', '.join(cuts)})"
    return replace(proof, verdict="not known", text="; ".join(filter(None, (why, proof.text))))


def note_received(team: Team, report: ExplorationReport) -> None:
    """Note which topics some robot of a process has received."""
    flags = report.product.flags
    team.received |= {(report.processes[robot], what) for kind, robot, what in flags if kind == "received"}


@contextmanager
def steps_end(team: Team, stop: Stop) -> Iterator[None]:
    """Let `stop` end a step, too, that would never end: it then raises OutOfTimeError."""
    for local in team.locals:
        local.host.stop = stop
    try:
        yield
    finally:
        for local in team.locals:
            local.host.stop = never


def _explore(
    team: Team, delivery: Delivery, budget: SearchBudget, *, faults: bool = False, unhandled: bool = False
) -> tuple[ExplorationReport, tuple[str, ...]]:
    """What the states of the team say, and what was left out."""
    request = team.request
    options = Options(
        delivery=delivery, reduced=request.reduced, faults=faults, unhandled=unhandled, limit=budget.left,
        groups=team.groups() if request.reduced else (), stop=budget.stop, given=team.given,
        required=() if team.given else team.required(), progress=request.progress,
        monitors=None if faults else team.monitors,
        acknowledged=frozenset(name for name, use in team.model.facts.types.items() if use.ttl),
    )  # fmt: skip
    product = Product(team.robots, team.locals, options)
    if request.reduced:
        reduction = Reduction(product)
        product.alone, product.first_arrivals = reduction.alone, reduction.first_arrivals
        if not faults:  # which may happen between
            product.settled, product.between = reduction.settled, reduction.between
    if faults:
        product.add_faults = Faults(product).add
    with steps_end(team, budget.stop):
        explored = explore(product)
    budget.left -= len(explored.states)
    cuts = tuple(_cuts(team, product, explored))
    return report_of(team, product, explored, budget.stop_findings, exhaustive=not cuts), cuts


def report_of(team: Team, product: Product, explored: Explored, stop: Stop, *, exhaustive: bool) -> ExplorationReport:
    """Return what explored states say about a team, as far as it can be told until `stop`."""
    return ExplorationReport(
        Runs(product, explored, team.places),
        pools=tuple(pool.name for pool in team.cast.values()),
        starts=tuple(_starts(local.program.starts) for local in team.locals),
        processes=tuple(pool.process.id for pool in team.cast.values()),
        accepts=accepted(team.definitions, team.pools, team.library),
        elements=tuple(
            frozenset(local.program.elements) & team.places.keys() & local.liveness.elements for local in team.locals
        ),
        exhaustive=exhaustive,
        sourceless=_sourceless(team),
        stop=stop,
    )


def _starts(starts: Mapping[str, Sequence[Node]]) -> tuple[tuple[str, str], ...]:
    """(element, topic) of what a robot waits for to start."""
    return tuple((node.id, topic) for topic, nodes in starts.items() for node in nodes)


def _sourceless(team: Team) -> tuple[tuple[int, str], ...]:
    """(place of a robot that waits for it, topic) of signals that no robot throws, and that nothing names a source of.

    A model of one pool says nothing about who is around it.
    """
    if len(team.pools) < 2:
        return ()
    elements = [element for _, element in elements_of(team.definitions, team.pools, team.library)]
    outside = {element.id for element in elements if element.properties.get("outside")}
    computed = computed_topics((element for element in elements if isinstance(element, FlowNode)), "publish")
    catches = [(place, node.id, node.catch.topic) for place, local in enumerate(team.locals)
               for node in local.program.nodes if node.catch is not None]  # fmt: skip
    known = team.request.sources | team.watched | {topic for _, element, topic in catches if element in outside}
    first = {
        (team.cast[team.robots[place]].name, topic): place
        for place, _, topic in reversed(catches)
        if topic[:1] == "/" and topic in team.locals[place].outside
        and topic not in known | team.locals[place].program.messages and not topic.startswith(computed)
    }  # fmt: skip
    return tuple((place, topic) for (_, topic), place in first.items())


def _cuts(team: Team, product: Product, explored: Explored) -> Iterator[str]:
    """Why not all states were explored."""
    if explored.cut == "states":
        yield f"the limit of {team.request.limit} states is reached"
    elif explored.cut:
        yield f"the limit of {team.request.seconds:g} s is reached, which depends on the machine"
    if product.network.piles:
        yield "more messages under way than are kept apart"
    if product.further_faults:
        yield f"more than {FAULTS - 1} single faults"
    for local in dict.fromkeys(team.locals):
        if local.cut:
            yield f"too many decisions in one step of {local.robot}"
        if any(kind == "instances" for kind, _ in local.states.grown):
            yield f"more than {MOST_INSTANCES} instances on {local.robot}"
        if any(kind == "tokens" for kind, _ in local.states.grown):
            yield f"more than {MOST_AT_ONE_PLACE} tokens at one element of {local.robot}"
        if len(local) >= MASK:
            yield f"too many states of {local.robot}"
