"""The findings of an exploration: one per cause, each with the shortest run to it.

The first three kinds fail a check: a ``deadlock``, a mission that can ``never`` complete, a ``lost`` signal that a
robot waits for afterwards; and an ``error`` that nothing catches, unless whether it is raised is unknown and a run may
complete without it. What waits forever after such an error is part of its finding. Warnings are signals that are
``always-lost`` or that nothing throws (``outside``), ``dropped`` triggers, pools that may not have started at the end
(``unstarted``), ``unreachable`` elements, other errors, conditions that fail (``condition``), ``growth`` without bound,
and a single ``fault`` that leaves others waiting forever. A ``run`` of the scenario that fails or does not end is an
error too. What has no consequence is a note.

An element or process with property ``accept`` = ``<kind>: <reason>`` accepts a finding about it. If robots wait
forever, each element at which one of them waits, or its process, has to accept that.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from itertools import groupby
from typing import Literal

from fame.check.explore.faults import outcomes
from fame.check.explore.graph import Explored
from fame.check.explore.host import Stop, never
from fame.check.explore.product import Product, SingleFault
from fame.check.explore.trace import Place, Runs, Step, TracedRun, waiting
from fame.check.explore.values import MARK
from fame.dataclasses import dataclass, field, replace

FindingKind = Literal[
    "deadlock", "never", "lost", "always-lost", "outside", "dropped", "unstarted", "unreachable", "error", "condition",
    "growth", "fault", "unneeded", "fewer", "run",
]  # fmt: skip
FAILING: tuple[FindingKind, ...] = ("deadlock", "never", "lost")
"""The kinds that always make a check fail: robots wait forever."""
LEVELS = ("error", "warning", "note")
"""How bad a finding is, the worst first."""
Cause = frozenset[tuple[str, str]]
"""At which elements robots of which pool wait forever; "" for those that go on."""
KINDS: tuple[FindingKind, ...] = (
    *FAILING, "run", "always-lost", "outside", "dropped", "unstarted", "unreachable", "error", "condition", "growth",
    "fault", "fewer", "unneeded",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that may happen in a mission.

    kind      see `fame.check.explore.findings`
    text      one line
    places    the elements that it is about
    processes ids of the processes that it is about
    run       the steps of the shortest run to it
    doomed    number of steps after which the mission cannot complete any more; None if it can, or if that is unknown
    delivery  how messages were delivered in that run
    accepted  why the model accepts it, empty if it does not
    robots    those that wait forever, as they are called in the run
    certain   an error that is raised whatever the unknown values are, or without which no run completes
    codes     the known codes of errors that are not caught
    """

    kind: FindingKind
    text: str
    places: tuple[Place, ...] = ()
    processes: tuple[str, ...] = ()
    run: tuple[Step, ...] = ()
    doomed: int | None = None
    delivery: str = "run"
    accepted: str = ""
    robots: tuple[str, ...] = ()
    certain: bool = False
    codes: tuple[str, ...] = ()

    def steps(self) -> Iterator[str]:
        """Yield its run, a numbered step a line; the same step several times in a row is one line."""
        if not self.run:
            yield "    (at once)"
        doomed = self.doomed
        for number, (text, group) in enumerate(groupby(self.run, key=str), 1):
            times = len(list(group))
            yield f"  {number:3}. {text}" + (f"  (x{times})" if times > 1 else "")
            if doomed is not None:
                doomed -= times
                if doomed < 0:
                    yield "       ---- from here on the mission cannot complete"
                    doomed = None

    @property
    def level(self) -> str:
        """``error``, ``warning`` or ``note``."""
        if self.accepted or self.kind == "unneeded":
            return "note"
        return "error" if self.kind in FAILING or self.certain else "warning"

    def __str__(self) -> str:
        accepted = f" (accepted: {self.accepted})" if self.accepted else ""
        return f"{self.level}: {self.text}{accepted}"


@dataclass(slots=True)
class ExplorationReport:
    """What is known of a team beside its states.

    pools      the pool of each robot, by place
    starts     what each robot waits for to start, if it does not by itself: (element, topic)
    processes  the process of each robot
    accepts    element or process -> the kinds of findings that its property `accept` names, and why
    elements   ids of the elements of each robot's program
    sourceless signals that nothing throws and of which the model names no source, with the place of a robot that waits
    stop       whether the time for findings is over: of many alike only the first one is then made
    left_out   how many were not looked into because of that
    """

    runs: Runs
    pools: tuple[str, ...]
    starts: tuple[tuple[tuple[str, str], ...], ...]
    processes: tuple[str, ...]
    accepts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    elements: tuple[frozenset[str], ...] = ()
    sourceless: tuple[tuple[int, str], ...] = ()
    exhaustive: bool = True
    stop: Stop = never
    left_out: Counter[str] = field(default_factory=Counter)

    @property
    def product(self) -> Product:
        return self.runs.product

    @property
    def explored(self) -> Explored:
        return self.runs.explored

    def findings(self) -> list[Finding]:
        """Return all findings, the worst first."""
        good = self.explored.completable()
        circling = self._circling(good)
        findings = [
            *self._stuck(good),
            *self._least("never", {cause: at for cause, at in circling.items() if not self.explored.layer(at)}, good),
            *self._not_started(),
            *self._signals(),
            *self._errors(circling, good),
            *self._unhandled(),
            *self._growth(),
            *self._from_nowhere(),
        ]
        findings += self._unreachable() if self.exhaustive and self.explored.states else ()
        delivery = self.product.options.delivery
        findings = [one if one.kind in FAILING else self._judged(replace(one, delivery=delivery)) for one in findings]
        return sorted(findings, key=lambda one: KINDS.index(one.kind))

    # ---- single faults -------------------------------------------------------------------------------

    def faults(self) -> list[tuple[str, str, Finding | None]]:
        """(fault, outcome, finding) of each single fault; without a finding if the others always can end."""
        good = self.explored.completable()
        rows: list[tuple[str, str, Finding | None]] = []
        for fault, at in outcomes(self.product, self.explored, good).items():
            if rows and self.stop():
                self.left_out["single faults"] += 1
                continue
            if at is None:
                rows.append((self._fault_name(fault), "the others complete", None))
                continue
            last = self._last_of(at)
            stuck, name = self._waiting("fault", last, good), self._fault_name(self._in_run(fault, last))
            if any(name == other for other, _, _ in rows):  # of another robot that is alike
                continue
            who = _after_title(stuck)
            rows.append((name, who, replace(stuck, kind="fault", text=f"{name}: {who}")))
        return rows

    def _last_of(self, at: int) -> int:
        """A deadlock that is reached from a state, else that state itself."""
        stuck = {*self.explored.stuck}
        return at if at in stuck else next((after for after in self.explored.reached_from(at) if after in stuck), at)

    def _in_run(self, fault: SingleFault, at: int) -> SingleFault:
        """The fault with the robot by its name in the run to a state: equal robots change places."""
        steps, after, _ = self.runs.to(at)
        states = self.explored.states
        happened = (
            step
            for step, one in zip(steps, after, strict=True)
            for number in one
            if self.product.fault_of(states[number])
        )
        kind, who, *details = fault
        robot = next((step.robot for step in happened if step.kind in ("die", "block", "fail", "loss")), who)
        return (kind, who, robot) if kind in ("message", "expiry") else (kind, robot, *details)

    def _fault_name(self, fault: tuple[str, ...]) -> str:
        kind, *details = fault
        if kind == "engine":
            return f"{details[0]}'s engine dies"
        if kind in ("message", "expiry"):
            return f"{details[0]} to {details[1]} {'is lost' if kind == 'message' else 'expires'}"
        robot, element, code = details
        place = self.runs.place(element)
        return f"{robot}'s {place.display_name} " + (f"fails: {_together([code])}" if code else "never ends")

    def _judged(self, finding: Finding) -> Finding:
        """The finding, accepted if the model says so."""
        elements = [*(place.element for place in finding.places), *finding.processes]
        reason = next(filter(None, (self.accepts.get(one, {}).get(finding.kind) for one in elements)), "")
        return replace(finding, accepted=reason) if reason else finding

    # ---- robots that wait forever -------------------------------------------------------------------

    def _stuck(self, good: bytearray) -> Iterator[Finding]:
        """Deadlocks: one for each set of elements at which robots wait, and none for one that contains another."""
        causes: dict[Cause, int] = {}
        for at in self.explored.stuck:
            if not self.product.fault_of(self.explored.states[at]) and not self.explored.layer(at):
                causes.setdefault(self._cause(at), at)
        yield from self._least("deadlock", causes, good)

    def _without_loss(self, cause: Cause, finding: Finding, good: bytearray) -> Finding:
        """A deadlock at the same elements that nothing lost has led to, if only lost signals are accepted there."""
        if finding.kind != "lost" or not finding.accepted:
            return finding
        known = {at for at in self.explored.stuck if not self.explored.layer(at) and self._cause(at) == cause}
        waits = [found for at in known for _, found in waiting(self.product, self.explored.states[at])]
        way = self.runs.without_loss({topic for found in waits for _, topic in found}, known)
        other = self._waiting("deadlock", way[-1], good, self.runs.along(way)) if way else finding
        return finding if other.accepted else other

    def _least(self, kind: FindingKind, causes: Mapping[Cause, int], good: bytearray) -> Iterator[Finding]:
        """The findings of some causes, accepted ones and others, each without those whose cause contains another.

        The least come first, which are the ones that another can contain: the time may be over before the last.
        """
        findings: dict[Cause, Finding] = {}
        for cause in sorted(causes, key=len):
            if findings and self.stop():
                self.left_out["states in which robots wait forever"] += 1
                continue
            finding = self._without_loss(cause, self._waiting(kind, causes[cause], good), good)
            accepted = bool(finding.accepted)
            if not any(other < cause and bool(known.accepted) == accepted for other, known in findings.items()):
                findings[cause] = finding
        yield from (findings[cause] for cause in causes if cause in findings)

    def _cause(self, at: int, moving: Set[int] = frozenset()) -> Cause:
        """At which elements robots of which pool wait in a state."""
        state = self.explored.states[at]
        cause = {(self.pools[robot], "" if robot in moving else element)
                 for robot, waits in waiting(self.product, state) for element, _ in waits or (("-", ""),)}  # fmt: skip
        return frozenset(cause)

    def _not_started(self) -> Iterator[Finding]:
        """Pools that have to start, and may not have at the end."""
        for place, pool in enumerate(self.product.options.required):
            states = self.explored.states
            final = (at for at in self.explored.final if not self.explored.layer(at))
            ended = (at for at in final if not states[at] >> self.product.mark_shift + place & 1)
            at = next((at for at in ended if not self.product.fault_of(states[at])), None)
            if at is not None:
                name, starts = self.pools[pool[0]], self.starts[pool[0]]
                where = ", ".join(self._wait(element, topic) for element, topic in starts)
                text = f"{name} may never start: the mission can end while it still waits at {where}"
                places = tuple(self.runs.place(element) for element, _ in starts)
                yield Finding("unstarted", text, places, (self.processes[pool[0]],), tuple(self.runs.to(at).steps))

    def _waiting(self, kind: FindingKind, at: int, good: bytearray, run: TracedRun | None = None) -> Finding:
        """A finding about a state in which robots wait forever, accepted as `acceptance` says."""
        state = self.explored.states[at]
        steps, after, names = run or self.runs.to(at)
        doomed = next((number for number, one in enumerate(after) if one and not any(good[each] for each in one)), None)
        waits = waiting(self.product, state)
        topics = {topic for _, found in waits for _, topic in found if topic}
        missed = [step.detail for step in steps if step.kind == "miss" and step.detail in topics]
        if missed and kind == "deadlock":
            kind = "lost"
        parts = []
        for robot, places_of_wait in waits:
            where = ", ".join(self._wait(element, topic) for element, topic in dict.fromkeys(places_of_wait))
            parts.append(f"{names[robot]} waits at {where}" if where else f"{names[robot]} has no token that can move")
        after_all = {
            "deadlock": ", and nothing will come" if topics else "",
            "lost": f", and {', '.join(dict.fromkeys(missed))} was lost on a robot that needed it",
        }.get(kind, "")
        title = {"lost": "lost signal", "never": "can never complete"}.get(kind, "deadlock")
        if kind == "never" and not any(good[: self.explored.begun]):
            title = "no run completes"
        places = tuple(self.runs.place(element) for _, found in waits for element, _ in dict.fromkeys(found))
        processes = tuple(dict.fromkeys(self.processes[robot] for robot, _ in waits))
        robots = [([element for element, _ in found], self.processes[robot]) for robot, found in waits]
        return Finding(kind, f"{title}: {'; '.join(parts)}{after_all}", tuple(dict.fromkeys(places)), processes,
                       tuple(steps), doomed, self.product.options.delivery,
                       acceptance(self.accepts, robots, (kind, "deadlock") if kind == "lost" else (kind,)),
                       tuple(names[robot] for robot, _ in waits))  # fmt: skip

    def _wait(self, element: str, topic: str) -> str:
        return self.runs.place(element).display_name + (f" for {topic}" if topic else "")

    def _circling(self, good: bytearray) -> dict[Cause, int]:
        """Cause of a mission that goes on and can never complete -> such a state, in which the fewest robots run.

        Neither an end nor a deadlock can be reached from there, nor a certain error.
        """
        explored = self.explored
        count = len(explored.offsets) - 1
        doomed = [at for at in range(count) if not good[at] and not self.product.fault_of(explored.states[at])]
        if not doomed:
            return {}
        certain = self.product.certain
        failing = {at for at, errors, _ in explored.failures if certain.intersection(errors)}
        leads = explored.leading_to([*explored.stuck, *(failing | explored.fatal) - {-1}])
        circling: dict[Cause, int] = {}
        for bottom in explored.bottoms(at for at in doomed if not leads[at]):
            at = min(bottom, key=lambda one: (len(waiting(self.product, explored.states[one])), one))
            there = self.product.locals_of(explored.states[at])
            others = [self.product.locals_of(explored.states[one]) for one in bottom]
            moving = {robot for robot, old in enumerate(there) if any(other[robot] != old for other in others)}
            cause = self._cause(at, moving)
            circling[cause] = min(at, circling.get(cause, at))
        return circling

    # ---- signals, errors, elements -------------------------------------------------------------------

    def _signals(self) -> Iterator[Finding]:
        flags, product = self.product.flags, self.product
        by_pool: dict[tuple[str, str, str], list[int]] = defaultdict(list)
        for kind, robot, what in flags:
            by_pool[kind, self.pools[robot], what].append(robot)
        for (kind, pool, what), robots in by_pool.items():
            seen = min((flags[kind, robot, what] for robot in robots), key=lambda one: one.at)
            run = tuple(self.runs.seen(seen)) if kind in ("lost", "dropped", "escalation", "condition") else ()
            who = _names([product.robots[robot] for robot in robots])
            process = (self.processes[robots[0]],)
            catchers = self._catchers(robots[0], what)
            if kind == "lost":
                received = ("received", pool, what) in by_pool
                text = f"{what} is {'sometimes' if received else 'always'} lost on {who}, which does not listen then"
                yield Finding("unneeded" if received else "always-lost", text, catchers, process, run)
            elif kind == "unneeded" and ("received", pool, what) not in by_pool and ("lost", pool, what) not in by_pool:
                yield Finding("unneeded", f"{what} reaches {who} only when it does not run", catchers, process)
            elif kind == "dropped":
                place = self.runs.place(what)
                text = f"a trigger of {place.display_name} is dropped on {who}: an instance runs already"
                yield Finding("dropped", text, (place,), process, run)
            elif kind == "escalation":
                place = self.runs.place(what)
                yield Finding(
                    "error", f"{who}: escalation at {place.display_name} is not caught", (place,), process, run
                )
            elif kind == "condition":
                element, _, why = what.partition("\n")
                place = self.runs.place(element)
                yield Finding("condition", f"{who}: {place.display_name}: {why}", (place,), process, run)

    def _from_nowhere(self) -> Iterator[Finding]:
        """Signals without a declared source: they are assumed to come from outside at any time."""
        for robot, topic in self.sourceless:
            places = self._catchers(robot, topic)
            where = ", ".join(place.display_name for place in places)
            text = f"{self.pools[robot]}: no robot throws {topic} for {where}; its property outside would name a source"
            yield Finding("outside", text, places, (self.processes[robot],))

    def _catchers(self, robot: int, topic: str) -> tuple[Place, ...]:
        nodes = self.product.locals[robot].program.nodes
        ids = dict.fromkeys(node.id for node in nodes if node.catch is not None and node.catch.topic == topic)
        return tuple(self.runs.place(element) for element in ids)

    def _errors(self, circling: Mapping[Cause, int], good: bytearray) -> Iterator[Finding]:
        """Errors that are not caught: one finding per element, with what waits forever after them."""
        errors: dict[tuple[str, str], list[tuple[int, str]]] = defaultdict(list)
        for kind, robot, what in self.product.flags:
            if kind == "error":
                element, _, why = what.partition("\n")
                errors[self.pools[robot], element].append((robot, why))
        fatal = {(self.pools[robot], element) for robot, element in self.product.certain} | {
            (self.pools[robot], element) for at, failed, _ in self.explored.failures if at in self.explored.fatal
            for robot, element in failed
        }  # fmt: skip
        consequence = self._consequences(circling, good)
        for (pool, element), raised in errors.items():
            first = min(
                (self.product.flags["error", robot, f"{element}\n{why}"] for robot, why in raised),
                key=lambda one: one.at,
            )
            who = _names([self.product.robots[robot] for robot, _ in raised])
            place = self.runs.place(element)
            text = f"{who}: {place.display_name} fails: {_together(why for _, why in raised)}"
            made = Finding("error", text, (place,), (self.processes[raised[0][0]],), certain=(pool, element) in fatal,
                           codes=tuple(one for one in _codes(why for _, why in raised) if MARK not in one))  # fmt: skip
            after = consequence((pool, element))
            if after is None:
                yield replace(made, run=tuple(self.runs.seen(first)))
            else:
                yield replace(made, text=f"{text}; then {_after_title(after)}", run=after.run, doomed=after.doomed,
                              robots=after.robots)  # fmt: skip

    def _unhandled(self) -> Iterator[Finding]:
        """Services and actions that were begun, whose failure nothing catches; what follows is a single fault."""
        for pool in dict.fromkeys(self.pools):
            robots = [robot for robot, one in enumerate(self.pools) if one == pool]
            for element, code in sorted(self.product.locals[robots[0]].unhandled):
                there = [one for one in robots if element in self.product.locals[one].states.visited]
                if there:
                    place, who = self.runs.place(element), _names([self.product.robots[one] for one in there])
                    error = f"error {code.replace(MARK, 'unknown')}"
                    text = f"{who}: {place.display_name} may fail: {error} would not be caught"
                    yield Finding("error", text, (place,), (self.processes[robots[0]],))

    def _consequences(
        self, circling: Mapping[Cause, int], good: bytearray
    ) -> Callable[[tuple[str, str]], Finding | None]:
        """A function of (pool, element) of an error, which gives what waits forever after it, None if nothing does.

        What waits forever without this error, too, does not count. Of several, that after the fewest errors is given.
        """
        explored = self.explored
        hits = {at: self._cause(at) for at in explored.stuck}
        hits |= {at: cause for cause, at in circling.items()}
        layers: dict[int, set[Cause]] = defaultdict(set)
        for at, cause in hits.items():
            layers[explored.layer(at)].add(cause)

        def is_new(layer: int, cause: Cause) -> bool:
            """Whether a cause does not already occur after fewer errors."""
            between = [other for below in range(1, layer) for other in layers.get(below, ())]
            return not any(other <= cause for other in layers.get(0, ())) and not any(
                other <= cause or cause <= other for other in between
            )

        causes = set[tuple[int, Cause]]()
        for layer, cause in ((layer, cause) for layer, some in layers.items() if layer for cause in some):
            if causes and self.stop():
                self.left_out["states after errors in which robots wait forever"] += 1
            elif is_new(layer, cause):
                causes.add((layer, cause))
        new = {at for at, cause in hits.items() if (explored.layer(at), cause) in causes}
        leads = explored.leading_to(new)
        sources: dict[tuple[str, str], dict[int, int]] = defaultdict(dict)  # error -> state after it -> state before it
        for source, errors, numbers in explored.failures:
            for robot, element in errors:
                for number in numbers:
                    if leads[number] and explored.layer(number) > explored.layer(source):  # not so without it
                        sources[self.pools[robot], element].setdefault(number, source)

        def consequence(error: tuple[str, str]) -> Finding | None:
            after = sources[error]
            lowest = min(map(explored.layer, after), default=0)
            way = explored.shortest([at for at in after if explored.layer(at) == lowest], new)
            if not way:
                return None
            run = self.runs.along([*self.runs.chain(after[way[0]]), *way], error[1])
            at = way[-1]
            return self._waiting("deadlock" if at in explored.stuck else "never", at, good, run)

        return consequence

    def _growth(self) -> Iterator[Finding]:
        locals_ = {id(local): local for local in self.product.locals}.values()
        for local in locals_:
            for kind, what in sorted(local.states.grown):
                place = self.runs.place(what)
                more = "instances of" if kind == "instances" else "tokens at"
                text = f"{local.robot}: the number of {more} {place.display_name} grows without bound"
                yield Finding("growth", text, (place,), (local.program.process,))
        for sender, topic, receiver in sorted(self.product.network.piles):
            robots = self.product.robots
            text = f"messages on {topic} from {robots[sender]} to {robots[receiver]} pile up without bound"
            yield Finding("growth", text, (), (self.processes[sender],))

    def _unreachable(self) -> Iterator[Finding]:
        """Elements that no robot of a pool ever enters."""
        visited: dict[str, set[str]] = defaultdict(set)
        for pool, local in zip(self.pools, self.product.locals, strict=True):
            visited[pool] |= local.states.visited
        for pool in dict.fromkeys(self.pools):
            robot = self.pools.index(pool)
            missing = [one for one in sorted(self.elements[robot]) if one not in visited[pool]]
            if missing and visited[pool]:
                places = tuple(self.runs.place(one) for one in missing)
                names = ", ".join(place.display_name for place in places)
                text = (
                    f"{pool}: {names} can never be entered" if len(missing) == 1 else f"{pool}: never entered: {names}"
                )
                yield Finding("unreachable", text, places, (self.processes[robot],))


def _after_title(finding: Finding) -> str:
    """The text of a finding about what robots do forever, without its title and reason."""
    text = finding.text.partition(": ")[2].removesuffix(", and nothing will come")
    return text.partition(", and /")[0] + (", forever" if finding.kind != "never" else ", and never complete")


def acceptance(
    accepts: Mapping[str, Mapping[str, str]], robots: Iterable[tuple[Sequence[str], str]], kinds: Sequence[str]
) -> str:
    """Return why robots may wait at elements, each robot with its process; empty if not all of it is accepted.

    What an element accepts says nothing about the others of its robot: these may be stuck.
    """

    def reason(one: str) -> str:
        return next((accepts[one][kind] for kind in kinds if kind in accepts.get(one, {})), "")

    reasons = [reason(one) or reason(process) for elements, process in robots for one in elements or (process,)]
    return "; ".join(dict.fromkeys(reasons)) if all(reasons) else ""


def _names(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))


_CODE = re.compile(r"error (.*) was not caught(?:; called at .*)?", re.DOTALL)


def _codes(reasons: Iterable[str]) -> list[str]:
    """The codes in the reasons of one element, each once."""
    return sorted({match[1] for match in map(_CODE.fullmatch, reasons) if match is not None})


def _together(reasons: Iterable[str]) -> str:
    """The reasons of one element, each once, without where the mission called it."""
    every = list(reasons)
    codes = _codes(every)
    others = [*dict.fromkeys(one.partition("; called at ")[0] for one in every if not _CODE.fullmatch(one))]
    if codes:
        word = "errors" if len(codes) > 1 else "error"
        others.insert(0, f"{word} {', '.join(codes).replace(MARK, 'unknown')} not caught")
    return "; ".join(others[:3])
