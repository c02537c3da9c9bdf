"""Explore a team's reachable states: make its robots, search for each delivery, and collect the findings."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Literal, get_args

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions, Element, Process
from fame.bpmn.pools import Pool, all_processes, shared_topics
from fame.check.explore.abstraction import STEP, Abstraction, abstraction
from fame.check.explore.faults import Faults
from fame.check.explore.findings import FAILING, KINDS, LEVELS, ExplorationReport, Finding, FindingKind
from fame.check.explore.graph import Explored
from fame.check.explore.growth import MOST_AT_ONE_PLACE, MOST_INSTANCES
from fame.check.explore.host import ExplorationHost, OutOfTimeError, never
from fame.check.explore.kinds import kinds_of
from fame.check.explore.local import Local
from fame.check.explore.product import Delivery, Options, Product, silent
from fame.check.explore.properties import PROOFS, Judged, Monitors, Watch, is_judged
from fame.check.explore.reduction import Reduction
from fame.check.explore.running_states import as_explored, real_program
from fame.check.explore.sampling import STEPS, Sampler, durations
from fame.check.explore.search import explore
from fame.check.explore.trace import Place, Runs
from fame.check.explore.transitions import FAULTS, MASK
from fame.check.explore.values import Values
from fame.check.expressions import expressions_in
from fame.dataclasses import dataclass, field, replace
from fame.engine import Program
from fame.engine.encoding import Data
from fame.errors import ModelError, expect
from fame.properties import Location, Property, compile, parse, vocabulary_of
from fame.rooms import WATCH

LIMIT = 200_000
"""States of all deliveries together, by default."""
DELIVERIES: tuple[Delivery, ...] = ("run", "fast")
"""What is explored by default, one after the other."""
SEARCHING = 0.7
"""Share of the time after which a search ends, so that some is left for samples."""
OF_WHOLE_MISSIONS: tuple[FindingKind, ...] = ("always-lost", "outside", "unneeded", "unstarted", "unreachable")
"""Kinds of findings that mean nothing if a mission is explored from its middle."""
_NAMES_ITSELF = re.compile(r"\brobot\b(?!\s*\.\s*(?:publish|subscribe|latest|call|act|now|date)\b)")
"""Texts by which a robot may know its own name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What to explore.

    delivery  ways of delivery, at least one, see `fame.check.explore.product`
    ordered   timers of a robot fire in the order of their durations, where that is known; else in any order
    faults    also explore what single faults lead to
    reduced   leave out orders of steps that make no difference
    limit     states, of all deliveries together
    seconds   time for all deliveries together, None for no bound
    sources   topics on which somebody outside of the team publishes
    properties  sentences that are judged
    variables  what the processes of robots start with, by robot
    samples   explore some parts besides if a limit ends a search
    first     explore these parts first, and end at the first error
    progress  called now and then with the number of states of a delivery, and of those still to be explored
    """

    delivery: tuple[Delivery, ...] = DELIVERIES
    ordered: bool = False
    faults: bool = False
    reduced: bool = True
    limit: int = LIMIT
    seconds: float | None = None
    sources: frozenset[str] = frozenset()
    properties: tuple[Property, ...] = ()
    variables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    samples: bool = True
    first: bool = False
    progress: Callable[[int, int], object] = silent


@dataclass(frozen=True, slots=True)
class Searched:
    """One search. `bound`: a limit of states or time has ended it, or it did not begin."""

    delivery: Delivery
    states: int
    transitions: int
    seconds: float
    cuts: tuple[str, ...]
    bound: bool = False
    faults: tuple[tuple[str, str, str], ...] = ()
    judged: tuple[Judged, ...] = ()


@dataclass(frozen=True, slots=True)
class Exploration:
    """The result of `explore_team` or `explore_from`.

    file        the model
    robots      robot -> pool
    findings    what was found, the worst first; each once, with the first delivery that shows it
    searches    one for each delivery
    local       robot -> number of its local states
    outside     topics on which anything may come from outside of the team
    widened     variables that have too many values, and so are unknown from some time on: (robot, name)
    seconds     of all searches (wall clock)
    sampled     what was explored besides, because a limit ended a search
    properties  what is known of each property, in all deliveries
    steps       (file, id) of the calls that were taken for one step each
    """

    file: str
    robots: Mapping[str, str]
    findings: tuple[Finding, ...]
    searches: tuple[Searched, ...]
    local: Mapping[str, int]
    outside: tuple[str, ...]
    seconds: float
    widened: tuple[tuple[str, str], ...] = ()
    sampled: tuple[str, ...] = ()
    properties: tuple[Judged, ...] = ()
    steps: tuple[tuple[str, str], ...] = ()

    @property
    def exhaustive(self) -> bool:
        """Whether all states were found, in every delivery that was asked for."""
        return not any(search.cuts for search in self.searches)

    @property
    def cuts(self) -> tuple[str, ...]:
        """Why it is not exhaustive."""
        return tuple(dict.fromkeys(cut for search in self.searches for cut in search.cuts))

    @property
    def status(self) -> Literal["completed", "partial", "failed"]:
        """``failed`` after an error that is not accepted, or if a property is refuted.

        ``partial``: neither, but not all was explored, or it is not known whether a property holds.
        """
        known = self.exhaustive and all(one.verdict != "not known" for one in self.properties)
        return "failed" if self.failed else "completed" if known else "partial"

    @property
    def failed(self) -> bool:
        """Whether an error was found, and not accepted, or a property is refuted."""
        refuted = any(one.verdict == "refuted" for one in self.properties)
        return refuted or any(one.level == "error" for one in self.findings)

    def partly(self) -> str:
        """Return what is known if no error was found, but not all is known."""
        if self.exhaustive:
            names = [one.name for one in self.properties if one.verdict == "not known"]
            return f"no error found, but it is not known whether {', '.join(names)} may be violated"
        return f"no error found in a partial search ({self.states:,} of unknown)"

    @property
    def states(self) -> int:
        """States of all searches."""
        return sum(search.states for search in self.searches)

    def summary(self) -> str:
        """Return the first line of a report."""
        spent = f"{self.states} states in {self.seconds:.1f} s"
        modes = " and ".join(search.delivery for search in self.searches)
        modes += ", only the order of fame run" if modes == "run" else ""
        if self.exhaustive:
            return f"{self.file}: all states explored ({', '.join(self.robots)}; delivery {modes}): {spent}"
        return f"{self.file}: NOT all states explored ({', '.join(self.cuts)}; delivery {modes}): {spent}"


class Team:
    """The robots of a collaboration, ready to be explored; local transitions are shared by all searches.

    kinds  robot -> its pool, by another name if others of the pool do not start alike (`kinds_of`)
    """

    received: set[tuple[str, str]]
    definitions: Definitions
    library: Library
    cast: dict[str, Pool]
    pools: list[Pool]
    kinds: dict[str, Pool]
    request: Request
    values: Values

    def __init__(
        self,
        definitions: Definitions,
        library: Library,
        cast: Mapping[str, Pool],
        request: Request,
        snapshots: Mapping[str, Data] = MappingProxyType({}),
    ) -> None:
        self.definitions, self.library, self.cast, self.request = definitions, library, dict(cast), request
        observed = any(data["observed"] for data in snapshots.values())
        self.pools = list({pool.name: pool for pool in cast.values()}.values())
        types = dict(shared_topics(definitions, self.pools, library))
        compiled = [compile(one, vocabulary_of(definitions, library, cast)) for one in request.properties]
        judged, watches = [one for one in compiled if is_judged(one)], list(_watches(definitions, library, cast))
        self.kinds = kinds_of(cast, request.variables)
        kinds = list({pool.name: pool for pool in self.kinds.values()}.values())
        reads = {pool.name: set[str]() for pool in kinds}
        for source in (source for one in judged for source in one.sources):
            reads[self.kinds[source.subject].name].add(source.name)
        read = frozenset[str]().union(*reads.values())
        parameters = frozenset(name for values in request.variables.values() for name in values)
        self.model: Abstraction = abstraction(
            definitions, kinds, library, types, given=bool(snapshots), read=read, parameters=parameters,
            named=codes_named(one.spec for one in (*judged, *(watch.monitor for watch in watches))),
        )  # fmt: skip
        self.values = Values()
        self.received = set[tuple[str, str]]()  # (process, topic) in any search so far
        self.robots: tuple[str, ...] = tuple(cast)
        self.places: dict[str, Place] = dict(_places(definitions, self.pools, library))
        self.alike: dict[str, bool] = {pool.name: not self._knows_itself(pool) for pool in kinds}
        events = frozenset((element, what) for one in judged for _, element, what in one.events)
        events = events.union(*(one.events for one in watches))
        observed |= bool(events)
        made: dict[str, Local] = {}
        self.locals: list[Local] = []
        for robot, pool in self.kinds.items():
            local = made.get(pool.name) if self.alike[pool.name] else None
            if local is None:
                host = ExplorationHost(robot, self.model, self.values, self.robots, request.ordered, events)
                local = Local(
                    definitions, pool, self.model, host,
                    observed=observed, reads=sorted(reads[pool.name]), parameters=request.variables.get(robot, {}),
                )  # fmt: skip
                made[pool.name] = local
            self.locals.append(local)
        several = {robot for robot, pool in cast.items() if pool.multi_instance}
        team = dict(zip(self.robots, self.locals, strict=True))
        self.monitors: Monitors | None = Monitors(compiled, team, several, watches) if compiled or watches else None
        self.given: dict[int, Data] = {
            place: as_explored(snapshots[robot], self._real(place, observed), self.locals[place].program)
            for place, robot in enumerate(self.robots)
            if robot in snapshots
        }

    @property
    def watched(self) -> frozenset[str]:
        """The signals of properties that robots watch."""
        return self.monitors.thrown if self.monitors is not None else frozenset()

    def _real(self, place: int, observed: bool) -> Program:
        """The program that a robot really runs, with the inside of behaviours."""
        process = self.cast[self.robots[place]].process
        return real_program(self.definitions, process, self.library, self.locals[place].host, observed=observed)

    def _knows_itself(self, pool: Pool) -> bool:
        """Whether a script or expression may read the name of its robot, or somebody addresses a robot by name."""
        bodies = self.model.bodies(self.definitions, pool.process)
        texts = (use.expression.text for body in bodies for use in expressions_in(body))
        return any(_NAMES_ITSELF.search(text) for text in texts) or any(
            use.addresses and use.catches for use in self.model.facts.types.values()
        )

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the places of robots that nothing tells apart."""
        found = []
        for name in dict.fromkeys(pool.name for pool in self.kinds.values()):
            places = tuple(place for place, robot in enumerate(self.robots) if self.kinds[robot].name == name)
            apart = self.monitors is not None and any(self.robots[place] in self.monitors.apart for place in places)
            if len(places) > 1 and self.alike[name] and not apart:
                found.append(places)
        return tuple(found)

    def required(self) -> tuple[tuple[int, ...], ...]:
        """Return the places of the robots of each pool of which one has to start, and none does by itself."""
        found = []
        for pool in self.pools:
            places = tuple(place for place, robot in enumerate(self.robots) if self.cast[robot].name == pool.name)
            if self.locals[places[0]].program.begin is None and not pool.process.optional:
                found.append(places)
        return tuple(found)

    def search(self, delivery: Delivery, limit: int, stop: Callable[[], bool]) -> tuple[Searched, list[Finding]]:
        """Explore with one delivery. Single faults are explored by themselves: they are ways out of a deadlock."""
        begun = time.perf_counter()
        report, cuts = self._report(delivery, limit, stop, faults=False)
        self._note_received(report)
        found, rows = report.findings(), list[tuple[str, str, Finding | None]]()
        judged = tuple(self.monitors.judge(report.runs, exhaustive=not cuts)) if self.monitors is not None else ()
        if self.request.faults:
            report, more = self._report(delivery, limit, stop, faults=True)
            cuts, rows = tuple(dict.fromkeys((*cuts, *more))), report.faults()
            found += [finding for _, _, finding in rows if finding is not None]
        spent, explored = time.perf_counter() - begun, report.explored
        table = tuple((name, delivery, outcome) for name, outcome, _ in rows)
        return Searched(delivery, len(explored.states), explored.transitions, spent, cuts,
                        bool(explored.cut), table, judged), found  # fmt: skip

    def after_failures(self, searched: Searched, limit: int, stop: Callable[[], bool]) -> Searched:
        """Return the search with only those proofs that also hold if services and actions fail
        where nothing catches that.

        Other proofs become "not known". What follows from such failures is explored for this alone: it is no finding.
        """
        entered = set[str]().union(*(local.states.visited for local in self.locals))
        left_out = sorted({element for element, _ in self.model.unhandled} & entered)
        proofs = [one for one in searched.judged if one.verdict in ("proved", "not triggered")]
        if not left_out or not proofs or self.monitors is None:
            return searched
        found: dict[str, Judged] = {}
        cuts: tuple[str, ...] = ("no budget is left",)
        if limit > 0 and not stop():
            report, cuts = self._report(searched.delivery, limit, stop, unhandled=True)
            found = {one.name: one for one in self.monitors.judge(report.runs, exhaustive=not cuts)}
        judged = []
        for one in searched.judged:
            other = found.get(one.name)
            if one not in proofs or (other is not None and other.verdict in ("proved", "not triggered")):
                judged.append(one)
                continue
            steps = other.run if other is not None else ()
            failed = [step.element for step in steps if (step.element, step.detail) in self.model.unhandled]
            names = " or ".join(self.places[each].display_name for each in dict.fromkeys(failed or left_out))
            why = f"{names} may fail, and nothing catches it"
            if other is None or other.verdict != "refuted":
                why += f"; what follows is not explored whole ({', '.join(cuts)})" if cuts else ""
            judged.append(replace(one, verdict="not known", text="; ".join(filter(None, (why, one.text)))))
        return replace(searched, judged=tuple(judged))

    def sample(self, stop: Callable[[], bool]) -> Iterator[tuple[str, list[Finding]]]:
        """Explore parts that a search may not have reached, each with its name, and what was found in it."""
        request = self.request
        steps = max(STEPS, request.limit // 20)
        bound, told = self._sampled("run", Sampler.schedule, steps, stop)
        followed = f", followed for {steps:,} steps" if bound and not stop() else ""
        yield f"the order of fame run{followed}", told
        counts = Counter(pool.name for pool in self.cast.values() if pool.multi_instance)
        for number in range(1, 1 if self.given else max(counts.values(), default=1)):
            if stop():
                break
            fewer = ", ".join(f"{name}={min(number, count)}" for name, count in counts.items())
            found, whole = self._with_fewer(number, steps, stop)
            yield (
                f"fewer robots ({fewer}{'' if whole else ', not all states'})",
                [replace(one, kind="fewer", text=f"with fewer robots ({fewer}): {one.text}") for one in found],
            )
            if found or not whole:
                break
        for delivery in request.delivery:
            yield f"random runs, delivery {delivery}", self._sampled(delivery, Sampler.wander, steps, stop)[1]

    def _sampled(
        self, delivery: Delivery, follow: Callable[[Sampler], Explored], steps: int, stop: Callable[[], bool]
    ) -> tuple[bool, list[Finding]]:
        """What happens in some runs, and whether they would go on."""
        options = Options(delivery=delivery, reduced=False, stop=stop, given=self.given)
        product = Product(self.robots, self.locals, options)
        bodies = (_elements(process) for _, process in all_processes(self.definitions, self.pools, self.library))
        sampler = Sampler(product, durations(bodies), stop, steps)
        with self._until(stop):
            try:
                follow(sampler)
            except OutOfTimeError:
                sampler.close()
        report = self._told(product, sampler.explored, exhaustive=False)
        self._note_received(report)
        found = [one for one in report.findings() if one.kind in (*FAILING, "error", "condition", "dropped")]
        return sampler.bound, found

    def _note_received(self, report: ExplorationReport) -> None:
        """Note which topics some robot of a process has received."""
        flags = report.product.flags
        self.received |= {(report.processes[robot], what) for kind, robot, what in flags if kind == "received"}

    def _with_fewer(self, number: int, steps: int, stop: Callable[[], bool]) -> tuple[list[Finding], bool]:
        """Errors of the team with at most `number` robots in each multi-instance pool, and whether these are all."""
        kept, counts = dict[str, Pool](), Counter[str]()
        for robot, pool in self.cast.items():
            counts[pool.name] += 1
            if counts[pool.name] <= number or not pool.multi_instance:
                kept[robot] = pool
        request = replace(self.request, faults=False, samples=False, properties=())
        searched, found = Team(self.definitions, self.library, kept, request).search("run", steps, stop)
        return [one for one in found if one.kind in FAILING and not one.accepted], not searched.cuts

    @contextmanager
    def _until(self, stop: Callable[[], bool]) -> Iterator[None]:
        """Let `stop` end a step, too, that would never end."""
        for local in self.locals:
            local.host.stop = stop
        try:
            yield
        finally:
            for local in self.locals:
                local.host.stop = never

    def _report(
        self, delivery: Delivery, limit: int, stop: Callable[[], bool], *, faults: bool = False, unhandled: bool = False
    ) -> tuple[ExplorationReport, tuple[str, ...]]:
        """What the states of the team say, and what was left out."""
        request = self.request
        options = Options(
            delivery=delivery, reduced=request.reduced, faults=faults, unhandled=unhandled, limit=limit,
            groups=self.groups() if request.reduced else (), stop=stop, given=self.given,
            required=() if self.given else self.required(), progress=request.progress,
            monitors=None if faults else self.monitors,
            acknowledged=frozenset(name for name, use in self.model.facts.types.items() if use.ttl),
        )  # fmt: skip
        product = Product(self.robots, self.locals, options)
        if request.reduced:
            reduction = Reduction(product)
            product.alone, product.first_arrivals = reduction.alone, reduction.first_arrivals
            if not faults:  # which may happen between
                product.settled, product.between = reduction.settled, reduction.between
        if faults:
            product.add_faults = Faults(product).add
        with self._until(stop):
            explored = explore(product)
        cuts = tuple(self._cuts(product, explored))
        return self._told(product, explored, exhaustive=not cuts), cuts

    def _told(self, product: Product, explored: Explored, *, exhaustive: bool) -> ExplorationReport:
        return ExplorationReport(
            Runs(product, explored, self.places),
            pools=tuple(pool.name for pool in self.cast.values()),
            starts=tuple(_starts(local) for local in self.locals),
            processes=tuple(pool.process.id for pool in self.cast.values()),
            accepts=accepted(self.definitions, self.pools, self.library),
            elements=tuple(
                frozenset(local.program.elements) & self.places.keys() & local.liveness.elements
                for local in self.locals
            ),
            exhaustive=exhaustive,
            sourceless=tuple(self._sourceless()),
        )

    def _sourceless(self) -> Iterator[tuple[int, str]]:
        """Signals in a collaboration that no robot throws, and of which neither model nor scenario has a source."""
        named = {one.id for home, process in all_processes(self.definitions, self.pools, self.library)
                 for one in _elements(process) if one.properties.get("outside")}  # fmt: skip
        nodes = [(place, node.id, node.catch.topic, local) for place, local in enumerate(self.locals)
                 for node in local.program.nodes if node.catch is not None]  # fmt: skip
        known = self.request.sources | self.watched | {topic for _, element, topic, _ in nodes if element in named}
        found = {(self.cast[self.robots[place]].name, topic): place for place, _, topic, local in reversed(nodes)
                 if topic[:1] == "/" and topic in local.outside
                 and topic not in known | local.program.messages}  # fmt: skip
        return ((place, topic) for (_, topic), place in found.items() if len(self.pools) > 1)

    def _cuts(self, product: Product, explored: Explored) -> Iterator[str]:
        """What was left out."""
        if explored.cut == "states":
            yield f"the limit of {self.request.limit} states is reached"
        elif explored.cut:
            yield f"the limit of {self.request.seconds:g} s is reached, which depends on the machine"
        if product.network.piles:
            yield "more messages under way than are kept apart"
        if product.further_faults:
            yield f"more than {FAULTS - 1} single faults"
        for local in dict.fromkeys(self.locals):
            if local.cut:
                yield f"too many decisions in one step of {local.robot}"
            if any(kind == "instances" for kind, _ in local.states.grown):
                yield f"more than {MOST_INSTANCES} instances on {local.robot}"
            if any(kind == "tokens" for kind, _ in local.states.grown):
                yield f"more than {MOST_AT_ONE_PLACE} tokens at one element of {local.robot}"
            if len(local) >= MASK:
                yield f"too many states of {local.robot}"


def _watches(definitions: Definitions, library: Library, cast: Mapping[str, Pool]) -> Iterator[Watch]:
    """The calls of ``watch_property`` in a team. Raises ConfigError for a wrong sentence."""
    for robot, pool in cast.items():
        for home, process in library.closure(definitions, pool.process):
            objects = {item.id: item for body in process.body.bodies() for item in body.data_objects}
            for node in process.body.walk():
                if isinstance(node, CallActivity) and node.called == WATCH:
                    given = {name: one for id in node.data_inputs for name, one in objects[id].values}
                    if {"property", "sentence"} <= given.keys():
                        name, sentence = given["property"].text, given["sentence"]
                        made = parse(sentence.text, Location(home.file, sentence.line), name)
                        yield Watch(compile(made, vocabulary_of(definitions, library, cast)), robot, node.id)


def codes_named(properties: Iterable[Property]) -> frozenset[str]:
    """Return the error codes that properties name."""
    return frozenset(event.code for one in properties for event in one.occurrences if event.code)


def explore_team(definitions: Definitions, library: Library, cast: Mapping[str, Pool], request: Request) -> Exploration:
    """Explore the robots of `cast` (robot -> pool).

    Raises ModelError for a model that cannot be compiled, ConfigError for a limit below 1 or no delivery.
    """
    begun = time.perf_counter()
    _expect_valid(request)
    return _explored(Team(definitions, library, cast, request), begun)


def explore_from(
    definitions: Definitions,
    library: Library,
    cast: Mapping[str, Pool],
    snapshots: Mapping[str, Data],
    request: Request,
) -> Exploration:
    """Explore what may follow from the states that robots are in, not from their starts.

    snapshots  robot -> what `fame.engine.snapshot` gave of its engine, in the program of this model (perhaps by
               `fame.engine.migration.migrate`), with values written by `fame.robot.stored_values.dump`. What is held
               goes on, what a migrated state lacks is armed. Robots without one start.

    No message is under way in the beginning, and of pending timers no times are known: they fire in any order. A
    behaviour that is being called may end at any time. Only findings about what happens from there on are given, not
    about signals or elements of the part that is over.

    Raises ModelError for a model that cannot be compiled, MissionError for a snapshot of another model, ConfigError for
    a limit below 1 or no delivery.
    """
    begun = time.perf_counter()
    _expect_valid(request)
    found = _explored(Team(definitions, library, cast, request, snapshots), begun)
    return replace(found, findings=tuple(one for one in found.findings if one.kind not in OF_WHOLE_MISSIONS))


def _expect_valid(request: Request) -> None:
    known = bool(request.delivery) and {*request.delivery} <= {*get_args(Delivery)}
    expect(known, "delivery", request.delivery, f"at least one of {', '.join(get_args(Delivery))}")
    expect(request.limit > 0, "limit", request.limit, "a number of states above 0")
    expect(request.seconds is None or request.seconds > 0, "seconds", request.seconds, "a number of seconds above 0")


def _explored(team: Team, begun: float) -> Exploration:
    """All searches of a team, which share its budget."""
    request = team.request
    left, searches, findings = request.limit, list[Searched](), dict[tuple[str, str], Finding]()

    def over(share: float) -> bool:
        return request.seconds is not None and time.perf_counter() - begun > share * request.seconds

    def stop() -> bool:
        return over(SEARCHING)

    def failed() -> bool:
        return request.first and any(one.level == "error" for one in findings.values())

    def take(found: Iterable[Finding]) -> None:
        for one in found:
            findings[_cause(one)] = min(findings.get(_cause(one), one), one, key=_rank)

    def sample(share: float) -> Iterator[str]:
        for name, found in team.sample(lambda: over(share)):
            take([one for one in found if not _is_known(one, findings.values())])
            yield name
            if failed():
                return

    sampled = [*sample(1 - SEARCHING)] if request.first else []
    for delivery in request.delivery:
        if failed() or left <= 0 or stop():
            why = "ended at the first error" if failed() else f"no budget is left for delivery {delivery}"
            unknown = tuple(Judged(one.name, one.sentence, "not known", why) for one in request.properties)
            searches.append(Searched(delivery, 0, 0, 0.0, (why,), bound=True, judged=unknown))
            continue
        searched, found = team.search(delivery, left, stop)
        searches.append(searched)
        left -= searched.states
        for other in [key for key, one in findings.items() if one.kind == "unreachable"]:
            del findings[other]  # what one delivery did not enter another may have; the last one knows all
        take(found)
    for place, one in enumerate(searches):  # afterwards: what is entered then is not entered without a failure
        searches[place] = team.after_failures(one, left, stop)
    if request.samples and not request.first and any(search.bound for search in searches):
        sampled += sample(1.0)
    partial = any(search.cuts for search in searches)
    unreachable = [] if partial else [one for one in findings.values() if one.kind == "unreachable"]
    kept = [_never(one, team.received, partial=partial) for one in findings.values() if one.kind != "unreachable"]
    kept += unreachable
    return Exploration(
        file=team.definitions.file,
        robots={robot: pool.name for robot, pool in team.cast.items()},
        findings=tuple(kept),
        searches=tuple(searches),
        local={local.robot: len(local) for local in dict.fromkeys(team.locals)},
        outside=tuple(sorted({topic for local in team.locals for topic in local.outside} - team.watched)),
        seconds=time.perf_counter() - begun,
        sampled=tuple(sampled),
        properties=tuple(_together(searches)),
        steps=tuple((name[0], name[2]) for name in map(_called, sorted(team.model.steps))),
        widened=tuple(
            (local.robot, name) for local in dict.fromkeys(team.locals) for name in sorted(local.states.widened)
        ),
    )


def _called(step: str) -> tuple[str, str, str]:
    """The file and the id of the call in the name of a step, and what is between them."""
    return step.removeprefix(STEP).rpartition(" ")


def _together(searches: Sequence[Searched]) -> Iterator[Judged]:
    """What is known of each property: refuted if one delivery refutes it, not known unless all deliveries tell."""
    for judged in zip(*(search.judged for search in searches), strict=True):
        first = min(judged, key=lambda one: PROOFS.index(one.verdict))
        if first.verdict == "not triggered" and any(one.verdict == "proved" for one in judged):
            first = next(one for one in judged if one.verdict == "proved")
        yield first


def _never(finding: Finding, received: Set[tuple[str, str]], *, partial: bool) -> Finding:
    """A finding; what is always lost in one delivery is only sometimes lost if another one brings it.

    After a partial search it is not known whether that is always so.
    """
    if finding.kind != "always-lost":
        return finding
    if (finding.processes[0], finding.text.partition(" ")[0]) in received:
        return replace(finding, kind="unneeded", text=finding.text.replace(" is always lost ", " is sometimes lost "))
    partly = " is lost in every explored delivery, in a partial search, "
    return replace(finding, text=finding.text.replace(" is always lost ", partly)) if partial else finding


def _is_known(finding: Finding, others: Iterable[Finding]) -> bool:
    """Whether robots wait at all elements of a deadlock that is known and not accepted."""
    places = set(finding.places)
    known = (one for one in others if one.kind in FAILING and not one.accepted)
    return finding.kind in FAILING and any(set(one.places) <= places for one in known)


def _cause(finding: Finding) -> tuple[str, str]:
    """What makes two findings of different deliveries the same one."""
    if finding.kind in FAILING:
        kind = "never" if finding.kind == "never" else "wait"
        return (kind, repr([place.element for place in finding.places] + [finding.accepted]))
    if finding.kind in ("always-lost", "unneeded", "growth", "fault"):
        return (finding.kind, finding.text)
    return (finding.kind, repr([place.element for place in finding.places]))


def _rank(finding: Finding) -> tuple[int, bool]:
    """Of the same findings of several deliveries the worst has the lowest rank, then one that leaves robots waiting."""
    return LEVELS.index(finding.level), not finding.robots


# ---- the model -------------------------------------------------------------------------------------------------------


def _places(definitions: Definitions, pools: Sequence[Pool], library: Library) -> Iterator[tuple[str, Place]]:
    for home, process in all_processes(definitions, pools, library):
        for element in _elements(process):
            yield element.id, Place(element.id, home.file, element.line, element.name)


def accepted(definitions: Definitions, pools: Sequence[Pool], library: Library) -> dict[str, dict[str, str]]:
    """Element or process -> the kinds of findings that it accepts, and why. Raises ModelError for an unknown kind."""
    found: dict[str, dict[str, str]] = {}
    for home, process in all_processes(definitions, pools, library):
        for element in _elements(process):
            for line in filter(str.strip, element.properties.get("accept", "").split(";")):
                kind, _, reason = (part.strip() for part in line.partition(":"))
                if kind not in KINDS:
                    text = (
                        f"accept: expected KIND: REASON, where KIND is one of {', '.join(KINDS)}; got {line.strip()!r}"
                    )
                    raise ModelError.at(element, text, file=home.file)
                found.setdefault(element.id, {})[kind] = reason or "in the model"
    return found


def _elements(process: Process) -> Iterable[Element]:
    return (process, *process.body.elements())


def _starts(local: Local) -> tuple[tuple[str, str], ...]:
    return tuple((node.id, topic) for topic, nodes in local.program.starts.items() for node in nodes)
